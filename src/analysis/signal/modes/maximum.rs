//! The likelihood's maximum at a peak, with the band and the start that fit it.

use super::Mask;
use super::band::Band;
use super::fit::{Aim, Fit, HALF_WIDTHS, LEAST_LINES, Stretch, pull, skirt};
use super::likelihood::{self, Parameters, Start};
use super::parts::Beginning;
use super::posterior::moments;
use super::softening::{FIT_SD, Softening};
use super::subband::{Pole, Subband};
use crate::numerics::optimum::{Optimum, golden, maximise, maximise_from};
use nalgebra::Matrix4;

/// Width of a cell of lines as a share of its distance from the peak (at least the core's half width):
/// the mean of a Lorentzian over such a cell is its value at the middle to 0.3 %.
const CELL: f64 = 0.1;
/// Power at the beginning of a stretch over a stationary response's, beyond which a free start is tried: a
/// stationary response reaches it once in 50 times, and a decay worth a free start has ten times as much.
const START_EXCESS: f64 = 4.0;
/// The same, beyond which no stationary fit is tried: even gusts with a standard deviation of 1.2 of ln amplitude
/// stay a factor of ten below.
const SURE_EXCESS: f64 = 1000.0;
/// Damping that the first band of a peak is made for.
pub(super) const FIRST_DAMPING: f64 = 0.01;
/// Log-posterior gain a free start must bring.
const FREE_GAIN: f64 = 10.0;

/// Relative error of a frequency below which softening can matter: the prior's softening moves the frequency
/// by some 1e-4.
const SOFTENING_MATTERS: f64 = 5e-4;
/// Twice the log-posterior gain by softening above which a decay counts as softening where only its shape
/// matters: two standard deviations.
const MOVES: f64 = 4.0;

/// A maximum of the likelihood, with the band it was found in.
pub struct Found {
    /// Band in which it was found.
    pub band: Band,
    /// Maximum with its curvature.
    pub top: Optimum,
    /// Start assumed.
    pub start: Start,
    /// Half width of the band asked for \[Hz\].
    pub half_width_hz: f64,
    /// The maximum of a decay over frequency, ln damping, ln ratio and softening (in [`FIT_SD`]), the slope
    /// as in `top`; `None` where its frequency does not visibly move.
    pub softened: Option<Optimum>,
}

impl Found {
    /// The parameters at the maximum.
    pub fn parameters(&self) -> Parameters {
        let linear = Parameters::from_array(self.top.at, 0.0);
        self.softened.map_or(linear, |top| softened_at(&top.at, linear))
    }

    /// True if it lies at the band's edge: it is that of a peak outside, and where the likelihood ends passes for a curvature.
    pub fn is_at_edge(&self) -> bool {
        !self.band.holds(self.parameters().frequency_hz)
    }

    /// The covariance at the maximum.
    pub fn covariance(&self) -> &Matrix4<f64> {
        &self.softened.as_ref().unwrap_or(&self.top).covariance
    }
}

impl Stretch<'_> {
    /// Maximum with the start that fits the stretch.
    pub(super) fn best(&self, aim: Aim, others: &[Fit]) -> Option<Found> {
        match self.beginning {
            Beginning::Known(start) => self.maximum(aim, start, others, None),
            Beginning::Tested => {
                if self.surely_decays(aim.peak_hz, others)
                    && let Some(free) = self.maximum(aim, Start::Free, others, None)
                {
                    return Some(free);
                }
                let Some(stationary) = self.maximum(aim, Start::Stationary, others, None) else {
                    return self.maximum(aim, Start::Free, others, None);
                };
                Some(self.free(&stationary, others).unwrap_or(stationary))
            }
        }
    }

    /// True if the peak's motion begins so far above what goes on that a stationary fit need not be tried.
    ///
    /// Judged before any fit, so only while the transients of all stronger modes are known: what leaks from them lies at
    /// the beginning, too.
    fn surely_decays(&self, peak_hz: f64, others: &[Fit]) -> bool {
        if others.iter().any(|other| other.start != Start::Free) {
            return false;
        }
        let limits = self.limits(peak_hz, others);
        let (low, high) = self.span(peak_hz, HALF_WIDTHS * FIRST_DAMPING * peak_hz, limits);
        if self.masks.iter().any(|m| m.low_hz < high && m.high_hz > low) {
            return false;
        }
        let pole = Pole {
            frequency_hz: peak_hz,
            damping: FIRST_DAMPING,
        };
        let transients = |f| others.iter().map(|other| pull(other, f)).sum();
        Subband::of(
            self.transforms,
            &self.coefficients,
            (low, high),
            pole,
            transients,
            |_, _| 1.0,
        )
        .and_then(|series| series.start_excess())
        .is_some_and(|excess| excess > SURE_EXCESS)
    }

    /// Fit with a free start, if it gains enough over the stationary one.
    fn free(&self, stationary: &Found, others: &[Fit]) -> Option<Found> {
        let fit = self.provisional(stationary)?;
        let series = self.subband(
            &fit,
            HALF_WIDTHS * fit.resonance.damping * fit.resonance.frequency_hz,
            others,
        )?;
        if series.start_excess()? < START_EXCESS {
            return None;
        }
        let parameters = stationary.parameters();
        let start = self.start(&stationary.band, parameters.frequency_hz, Start::Free)?;
        let top = self.climb(&stationary.band, start, Start::Free)?;
        let p = Parameters::from_array(top.at, 0.0);
        let value = likelihood::resonance(&stationary.band, Start::Free, &p)?;
        // The free start has one datum less: its density lacks one factor of the noise level.
        let gain = value.log_posterior - value.quad.ln() - stationary.top.value;
        if gain < FREE_GAIN {
            return None;
        }
        let aim = Aim {
            peak_hz: p.frequency_hz,
            before: Some(p),
        };
        self.maximum(aim, Start::Free, others, Some(value.noise))
    }

    /// Ends of the band around `centre` \[Hz\], `half` to either side if that is enough lines, and within the limits.
    fn span(&self, centre: f64, half: f64, limits: (f64, f64)) -> (f64, f64) {
        let half = half.max(LEAST_LINES / self.coefficients.duration_s);
        ((centre - half).max(limits.0), (centre + half).min(limits.1))
    }

    /// The band around `centre`; `core` is the half width within which it must stay fine.
    fn band(
        &self,
        (centre, half, core): (f64, f64, f64),
        limits: (f64, f64),
        others: &[Fit],
        (level, start): (Option<f64>, Start),
    ) -> Band {
        let (low, high) = self.span(centre, half, limits);
        // A pull is far above the noise: the detail that a cell smooths would look like noise.
        let decays = start == Start::Free || others.iter().any(|other| other.start == Start::Free);
        let width = |f: f64| match decays {
            false => CELL * (f - centre).abs().max(core),
            true => 0.0,
        };
        let left_out: Vec<Mask> = self.left_out().collect();
        let mut band = self.coefficients.band(low, high, &left_out, width);
        let level = level.unwrap_or_else(|| band.quiet_level());
        for other in others {
            subtract(&mut band, other, level);
        }
        band
    }

    /// Number of lines of the band around `centre`.
    fn lines(&self, centre: f64, half: f64, limits: (f64, f64)) -> f64 {
        let (low, high) = self.span(centre, half, limits);
        let left_out: Vec<Mask> = self.left_out().collect();
        self.coefficients.count(low, high, &left_out) as f64
    }

    /// Maximum of the likelihood at a peak; `before` and `level` are the parameters and the noise floor of an
    /// earlier fit, if any.
    pub(super) fn maximum(
        &self,
        Aim { peak_hz, before }: Aim,
        start_of: Start,
        others: &[Fit],
        level: Option<f64>,
    ) -> Option<Found> {
        let limits = self.limits(peak_hz, others);
        let mut half = HALF_WIDTHS * FIRST_DAMPING * peak_hz;
        let mut core = 0.5 * self.line_hz;
        if let Some(before) = before {
            core = before.log_damping.exp() * before.frequency_hz;
            half = HALF_WIDTHS * core;
        }
        let mut band = self.band((peak_hz, half, core), limits, others, (level, start_of));
        let mut start = match before {
            Some(before) => before,
            None => self.start(&band, peak_hz, start_of)?,
        };
        for last in [false, false, true] {
            let top = self.climb(&band, start, start_of)?;
            let p = Parameters::from_array(top.at, start.softening);
            let gamma = p.log_damping.exp() * p.frequency_hz;
            let wanted = HALF_WIDTHS * gamma;
            let ratio = || self.lines(p.frequency_hz, wanted, limits) / band.lines.max(1.0);
            if last || (0.45..1.6).contains(&ratio()) {
                let found = Found {
                    band,
                    top,
                    start: start_of,
                    half_width_hz: half,
                    softened: None,
                };
                return Some(match start_of {
                    Start::Stationary => found,
                    // If the frequency does not move, the part subtracted in other bands is right without it.
                    Start::Free => {
                        let step = first_step(&found, start.softening)
                            .filter(|step| start.softening != 0.0 || step.score > MOVES);
                        let softened = step.and_then(|step| softened(&found, &step));
                        Found { softened, ..found }
                    }
                });
            }
            band = self.band((p.frequency_hz, wanted, gamma), limits, others, (level, start_of));
            (half, start) = (wanted, p);
        }
        None
    }

    /// Best point of a coarse grid of parameters around a picked peak.
    pub(super) fn start(&self, band: &Band, peak_hz: f64, start: Start) -> Option<Parameters> {
        let near = 1.5 * self.line_hz;
        let highest = band
            .cells()
            .filter(|c| (c.frequency_hz - peak_hz).abs() <= near)
            .max_by(|a, b| (a.power / a.lines).total_cmp(&(b.power / b.lines)))
            .map_or(peak_hz, |c| c.frequency_hz);
        let ratios = match start {
            Start::Stationary => [2.0, 6.0, 10.0],
            Start::Free => [-1.0, 3.0, 7.0],
        };
        let mut best: Option<(f64, Parameters)> = None;
        for log_damping in [-7.4, -6.0, -4.8, -3.7] {
            for log_ratio in ratios {
                for frequency_hz in [peak_hz, highest, 0.5 * (peak_hz + highest)] {
                    let p = Parameters {
                        frequency_hz,
                        log_damping,
                        log_ratio,
                        slope: 0.0,
                        softening: 0.0,
                    };
                    let Some(value) = likelihood::resonance(band, start, &p) else {
                        continue;
                    };
                    if best.is_none_or(|(b, _)| value.log_posterior > b) {
                        best = Some((value.log_posterior, p));
                    }
                }
            }
        }
        let (_, mut p) = best?;
        let gamma = p.log_damping.exp() * p.frequency_hz;
        let reach = gamma.max(0.6 / band.duration_s);
        p.frequency_hz = golden(
            |frequency_hz| {
                let p = Parameters { frequency_hz, ..p };
                likelihood::resonance(band, start, &p).map(|v| v.log_posterior)
            },
            p.frequency_hz - reach,
            p.frequency_hz + reach,
            12,
        );
        Some(p)
    }

    /// Maximum of the posterior near `from`.
    pub(super) fn climb(&self, band: &Band, from: Parameters, start: Start) -> Option<Optimum> {
        let gamma = from.log_damping.exp() * from.frequency_hz;
        let reach = [gamma.max(0.5 / band.duration_s), 1.0, 2.0, 1.0];
        maximise(
            |x| log_posterior(band, start, x, from.softening),
            from.to_array(),
            reach,
        )
    }

    /// The parameters and the standard errors of frequency and log damping: the optimum with its
    /// curvature where the record determines damping and excitation well, else the posterior's mean
    /// and standard deviation (few independent fluctuations: the curvature alone gives too small an error).
    /// For a decay that may soften, the error is conditional on the softening, which is returned too.
    pub(super) fn errors(&self, found: &Found) -> (Parameters, f64, f64, Option<Softening>) {
        let top = found
            .softened
            .or_else(|| softened(found, &first_step(found, 0.0)?));
        if let Some(top) = &top {
            let linear = Parameters::from_array(found.top.at, 0.0);
            let posterior = moments(|x| softened_posterior(&found.band, x, linear), top);
            let (at, covariance) = posterior.map_or((top.at, top.covariance), |p| (p.mean, p.covariance));
            let wider = 1.0 + 0.6 * covariance[(2, 2)].min(0.15);
            let slope = covariance[(0, 3)] / covariance[(3, 3)];
            let at_softening = (covariance[(0, 0)] - slope * covariance[(0, 3)]).max(0.0);
            let softening = Softening {
                share: FIT_SD * at[3],
                variance: (wider * FIT_SD).powi(2) * covariance[(3, 3)],
                slope_hz: slope / FIT_SD,
            };
            return (
                softened_at(&at, linear),
                wider * at_softening.sqrt(),
                covariance[(1, 1)].sqrt(),
                Some(softening),
            );
        }
        let log_posterior = |x: &[f64; 4]| log_posterior(&found.band, found.start, x, 0.0);
        let top = &found.top;
        let (mut at, mut covariance) = (top.at, top.covariance);
        let wide = |i: usize, limit: f64| top.covariance[(i, i)] > limit * limit;
        let posterior = match found.start {
            Start::Free => moments(log_posterior, top),
            Start::Stationary if wide(1, 0.12) || wide(2, 0.7) => moments(log_posterior, top),
            Start::Stationary => None,
        };
        if let Some(posterior) = posterior {
            (at, covariance) = (posterior.mean, posterior.covariance);
        }
        // The frequency's error scales with a variance known only as well as `scale` (of its logarithm):
        // the 95 % point of a t with 2/scale degrees of freedom over the normal's, to first order.
        let scale = match found.start {
            Start::Stationary => covariance[(1, 1)].min(0.5),
            Start::Free => covariance[(2, 2)].min(0.15),
        };
        let sd = |i: usize| covariance[(i, i)].sqrt();
        (
            Parameters::from_array(at, 0.0),
            sd(0) * (1.0 + 0.6 * scale),
            sd(1),
            None,
        )
    }
}

/// Removes another mode from a band: its transient (free decays) from the coefficients, its random skirt into
/// the shape of the noise floor, of which `level` is the height without it.
pub(super) fn subtract(band: &mut Band, other: &Fit, level: f64) {
    band.for_each(|cell| {
        if other.start == Start::Free {
            // The cells beside a free decay hold one line each.
            let c = pull(other, cell.frequency_hz);
            cell.re -= c.re;
            cell.im -= c.im;
            cell.power = cell.re * cell.re + cell.im * cell.im;
        }
        cell.floor += skirt(other, cell.frequency_hz) / level;
    });
}

fn log_posterior(band: &Band, start: Start, x: &[f64; 4], softening: f64) -> Option<f64> {
    likelihood::resonance(band, start, &Parameters::from_array(*x, softening)).map(|v| v.log_posterior)
}

/// The parameters of a decay at frequency, ln damping, ln ratio and softening (in [`FIT_SD`]); the rest as in `p`.
fn softened_at(x: &[f64; 4], p: Parameters) -> Parameters {
    Parameters {
        frequency_hz: x[0],
        log_damping: x[1],
        log_ratio: x[2],
        softening: FIT_SD * x[3],
        ..p
    }
}

/// Newton's step from a decay's maximum at some softening towards its best one.
struct FirstStep {
    /// Frequency, ln damping, ln ratio and softening (in [`FIT_SD`]) after it.
    at: [f64; 4],
    /// About half the standard deviation of each, the others fixed.
    step: [f64; 4],
    /// Twice the log-posterior gain of the step.
    score: f64,
}

/// Newton step from the maximum at the softening `before`; damping and ratio, on which it hardly depends, are
/// fixed. `None` where the frequency is not known well enough for softening to matter.
fn first_step(found: &Found, before: f64) -> Option<FirstStep> {
    let p = Parameters::from_array(found.top.at, before);
    let sd = |i: usize| found.top.covariance[(i, i)].sqrt();
    if found.start != Start::Free || sd(0) > SOFTENING_MATTERS * p.frequency_hz {
        return None;
    }
    let from = [p.frequency_hz, p.log_damping, p.log_ratio, before / FIT_SD];
    let value = |hz: f64, share: f64| {
        softened_posterior(&found.band, &[from[0] + hz, from[1], from[2], from[3] + share], p)
    };
    let hz = 0.5 * sd(0);
    let share = (3.0 * hz / p.frequency_hz / FIT_SD).min(0.2);
    let (here, low, high) = (value(0.0, 0.0)?, value(0.0, -share)?, value(0.0, share)?);
    let gradient = (high - low) / (2.0 * share);
    let bend = (2.0 * here - high - low) / (share * share);
    let corners = value(hz, share)? + value(-hz, -share)?;
    let mixed = (corners - value(hz, 0.0)? - value(-hz, 0.0)? - low - high + 2.0 * here) / (2.0 * hz * share);
    let variance = sd(0) * sd(0);
    let information = bend - variance * mixed * mixed;
    let (moved, score) = if information > 0.0 {
        let moved = (gradient / information).clamp(-1.0, 1.0);
        (moved, gradient * moved)
    } else {
        (0.0, f64::INFINITY)
    };
    let at = [
        from[0] + variance * mixed * moved,
        from[1],
        from[2],
        from[3] + moved,
    ];
    let is_better = softened_posterior(&found.band, &at, p).is_some_and(|value| value > here);
    let step = if bend > 0.0 { 0.5 / bend.sqrt() } else { share };
    Some(FirstStep {
        at: if is_better { at } else { from },
        step: [hz, (0.5 * sd(1)).min(0.2), (0.5 * sd(2)).min(0.4), step.min(0.2)],
        score,
    })
}

/// Maximum of a decay over the softening as well.
fn softened(found: &Found, from: &FirstStep) -> Option<Optimum> {
    let p = Parameters::from_array(found.top.at, 0.0);
    let gamma = p.log_damping.exp() * p.frequency_hz;
    let reach = [gamma.max(0.5 / found.band.duration_s), 1.0, 2.0, 1.0];
    maximise_from(
        |x| softened_posterior(&found.band, x, p),
        from.at,
        reach,
        from.step,
        3.0,
    )
}

fn softened_posterior(band: &Band, x: &[f64; 4], p: Parameters) -> Option<f64> {
    let value = likelihood::resonance(band, Start::Free, &softened_at(x, p))?;
    Some(value.log_posterior - 0.5 * x[3] * x[3])
}
