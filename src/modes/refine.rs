//! Each picked peak refined to a natural frequency, damping ratio and standard errors.

use super::band::{Band, Coefficients};
use super::likelihood::{self, Parameters, Value};
use super::optimum::{Optimum, golden, maximise};
use super::posterior::moments;
use super::{Mask, Resonance};
use crate::record::{Excitation, Record};
use crate::spectrum::{Peak, Transforms};
use realfft::num_complex::Complex;

/// Half width of a band in half-power half-widths of its peak: beyond 8 the band holds less than a
/// tenth more of what there is to know about the frequency (bandwidth factor 0.84, Au 2014).
const HALF_WIDTHS: f64 = 8.0;
/// Width of a cell of lines as a share of its distance from the peak (at least the core's half width):
/// the mean of a Lorentzian over such a cell is its value at the middle to 0.3 %.
const CELL: f64 = 0.1;
/// Fewest lines to either side of the peak: the noise floor must be known from lines that the mode does
/// not reach, or excitation that goes on during a decay is taken for noise.
const LEAST_LINES: f64 = 40.0;
/// A band never reaches further than this share of the peak's frequency.
const WIDEST: f64 = 0.35;
/// Twice the log-likelihood gain over noise that a peak needs beyond that of the search over lines.
const LEAST_EVIDENCE: f64 = 16.0;
/// Twice the log-likelihood gain over a pure sine that a resonance needs: two parameters more, and
/// chi-square(2) exceeds 9.2 in 1 % of sines.
const LEAST_OVER_SINE: f64 = 9.2;
/// Damping below which nothing in a building vibrates: such a peak is a line.
const LEAST_DAMPING: f64 = 2e-4;

/// What the refinement of a record's peaks gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The resonances, ascending in frequency; lines are among them, marked.
    pub resonances: Vec<Resonance>,
}

/// A maximum of the likelihood, with the band it was found in.
struct Found {
    band: Band,
    top: Optimum,
    half_width_hz: f64,
}

/// One fitted peak.
#[derive(Debug, Clone, Copy)]
struct Fit {
    resonance: Resonance,
    parameters: Parameters,
    value: Value,
    half_width_hz: f64,
}

/// Fits a resonance to the raw Fourier coefficients around each peak; peaks that turn out to be
/// noise, or part of a resonance already fitted, are left out.
///
/// The highest peaks come first; what a lower one shows must stand above the skirts of those already
/// fitted. `line_hz` is the line distance of the spectrum the peaks were picked from. A free decay is
/// used from its largest deflection on.
pub fn refine(
    transforms: &Transforms,
    record: &Record,
    peaks: &[Peak],
    masks: &[Mask],
    line_hz: f64,
) -> Refinement {
    let excitation = record.excitation.unwrap_or(Excitation::Ambient);
    let samples = match excitation {
        Excitation::Ambient => &record.samples[..],
        Excitation::FreeDecay => &record.samples[largest_deflection(&record.samples)..],
    };
    let coefficients = Coefficients::of(transforms, record.fs_hz, samples);
    let context = Context {
        coefficients: &coefficients,
        excitation,
        masks,
        line_hz,
        nyquist_hz: 0.5 * record.fs_hz,
    };
    let mut by_height: Vec<usize> = (0..peaks.len()).collect();
    by_height.sort_by(|&a, &b| peaks[b].height_db.total_cmp(&peaks[a].height_db));
    // Where the peaks are, by curvature alone; then, each beside all others, their errors.
    let mut fits: Vec<Fit> = Vec::new();
    let mut maxima: Vec<Found> = Vec::new();
    for &i in &by_height {
        let peak_hz = peaks[i].frequency_hz;
        if fits.iter().any(|fit| context.same(fit, peak_hz)) {
            continue;
        }
        let found = context.maximum(peak_hz, None, &fits, None);
        if let Some((found, fit)) =
            found.and_then(|found| context.provisional(&found).map(|fit| (found, fit)))
            && !fits
                .iter()
                .any(|other| context.same(other, fit.resonance.frequency_hz))
        {
            fits.push(fit);
            maxima.push(found);
        }
    }
    let mut resonances: Vec<Resonance> = maxima
        .iter()
        .enumerate()
        .filter_map(|(n, found)| {
            let others: Vec<Fit> = (0..fits.len()).filter(|&m| m != n).map(|m| fits[m]).collect();
            let fit = if context.disturbed(&fits[n], &others) {
                let at = fits[n].parameters;
                let level = Some(fits[n].value.noise);
                context.with_errors(&context.maximum(at.frequency_hz, Some(at), &others, level)?)
            } else {
                context.with_errors(found)
            };
            fit.map(|fit| fit.resonance)
        })
        .collect();
    resonances.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    Refinement { resonances }
}

/// Where the first half of the samples deviates most from the mean of all.
pub(super) fn largest_deflection(samples: &[f64]) -> usize {
    let mean = samples.iter().sum::<f64>() / samples.len().max(1) as f64;
    let (mut at, mut largest) = (0, 0.0);
    for (i, x) in samples[..samples.len() / 2].iter().enumerate() {
        if (x - mean).abs() > largest {
            (at, largest) = (i, (x - mean).abs());
        }
    }
    at
}

struct Context<'a> {
    coefficients: &'a Coefficients,
    excitation: Excitation,
    masks: &'a [Mask],
    line_hz: f64,
    nyquist_hz: f64,
}

impl Context<'_> {
    /// Whether a peak at `frequency_hz` is part of a resonance already fitted.
    fn same(&self, fit: &Fit, frequency_hz: f64) -> bool {
        let r = &fit.resonance;
        let near = (1.5 * r.damping * r.frequency_hz).max(1.5 * self.line_hz);
        (frequency_hz - r.frequency_hz).abs() < near
    }

    /// How far the band of a peak may reach: half way to the nearest resonances already fitted.
    fn limits(&self, peak_hz: f64, others: &[Fit]) -> (f64, f64) {
        let (mut low, mut high) = ((1.0 - WIDEST) * peak_hz, (1.0 + WIDEST) * peak_hz);
        for other in others {
            let middle = 0.5 * (other.resonance.frequency_hz + peak_hz);
            if middle < peak_hz {
                low = low.max(middle);
            } else {
                high = high.min(middle);
            }
        }
        (low, high.min(0.98 * self.nyquist_hz))
    }

    /// The band around `centre`; `core` is the half width within which it must stay fine.
    fn band(
        &self,
        (centre, half, core): (f64, f64, f64),
        limits: (f64, f64),
        others: &[Fit],
        level: Option<f64>,
    ) -> Band {
        let half = half.max(LEAST_LINES / self.coefficients.duration_s);
        let (low, high) = ((centre - half).max(limits.0), (centre + half).min(limits.1));
        let width = |f: f64| match self.excitation {
            Excitation::Ambient => CELL * (f - centre).abs().max(core),
            // The pull stands far above the noise: what a cell smooths would look like noise.
            Excitation::FreeDecay => 0.0,
        };
        let mut band = self.coefficients.band(low, high, self.masks, width);
        let level = level.unwrap_or_else(|| band.quiet_level());
        for other in others {
            subtract(&mut band, other, self.excitation, level);
        }
        band
    }

    /// The likelihood's maximum at a peak; `before` and `level` are its place and the noise floor if an
    /// earlier fit found them.
    fn maximum(
        &self,
        peak_hz: f64,
        before: Option<Parameters>,
        others: &[Fit],
        level: Option<f64>,
    ) -> Option<Found> {
        let limits = self.limits(peak_hz, others);
        let mut half = HALF_WIDTHS * 0.01 * peak_hz;
        let mut core = 0.5 * self.line_hz;
        if let Some(before) = before {
            core = before.log_damping.exp() * before.frequency_hz;
            half = HALF_WIDTHS * core;
        }
        let mut band = self.band((peak_hz, half, core), limits, others, level);
        let mut start = match before {
            Some(before) => before,
            None => self.start(&band, peak_hz)?,
        };
        for last in [false, false, true] {
            let top = self.climb(&band, start)?;
            let p = Parameters::from_array(top.at);
            let gamma = p.log_damping.exp() * p.frequency_hz;
            let wanted = HALF_WIDTHS * gamma;
            let next = self.band((p.frequency_hz, wanted, gamma), limits, others, level);
            let ratio = next.lines / band.lines.max(1.0);
            if last || (0.45..1.6).contains(&ratio) {
                return Some(Found {
                    band,
                    top,
                    half_width_hz: half,
                });
            }
            (half, band, start) = (wanted, next, p);
        }
        None
    }

    /// The fit at a maximum with the errors that its curvature promises.
    fn provisional(&self, found: &Found) -> Option<Fit> {
        let sd = |i: usize| found.top.covariance[(i, i)].sqrt();
        self.judge(
            &found.band,
            Parameters::from_array(found.top.at),
            sd(0),
            sd(1),
            found.half_width_hz,
        )
    }

    /// The fit at a maximum with its standard errors.
    fn with_errors(&self, found: &Found) -> Option<Fit> {
        let (p, sd, log_sd) = self.errors(&found.band, &found.top);
        self.judge(&found.band, p, sd, log_sd, found.half_width_hz)
    }

    /// The best of a coarse grid of parameters around a picked peak.
    fn start(&self, band: &Band, peak_hz: f64) -> Option<Parameters> {
        let near = 1.5 * self.line_hz;
        let highest = band
            .cells()
            .filter(|c| (c.frequency_hz - peak_hz).abs() <= near)
            .max_by(|a, b| (a.power / a.lines).total_cmp(&(b.power / b.lines)))
            .map_or(peak_hz, |c| c.frequency_hz);
        let ratios = match self.excitation {
            Excitation::Ambient => [2.0, 6.0, 10.0],
            Excitation::FreeDecay => [-1.0, 3.0, 7.0],
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
                    };
                    let Some(value) = likelihood::resonance(band, self.excitation, &p) else {
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
                likelihood::resonance(band, self.excitation, &p).map(|v| v.log_posterior)
            },
            p.frequency_hz - reach,
            p.frequency_hz + reach,
            12,
        );
        Some(p)
    }

    /// The posterior's maximum near `start`.
    fn climb(&self, band: &Band, start: Parameters) -> Option<Optimum> {
        let gamma = start.log_damping.exp() * start.frequency_hz;
        let reach = [gamma.max(0.5 / band.duration_s), 1.0, 2.0, 1.0];
        maximise(|x| self.log_posterior(band, x), start.to_array(), reach)
    }

    fn log_posterior(&self, band: &Band, x: &[f64; 4]) -> Option<f64> {
        likelihood::resonance(band, self.excitation, &Parameters::from_array(*x)).map(|v| v.log_posterior)
    }

    /// The parameters and the standard errors of frequency and log damping: the optimum with its
    /// curvature where the record determines damping and excitation well, else the posterior's mean
    /// and standard deviation (few independent fluctuations: the curvature alone would promise too
    /// much).
    fn errors(&self, band: &Band, found: &Optimum) -> (Parameters, f64, f64) {
        let log_posterior = |x: &[f64; 4]| self.log_posterior(band, x);
        let (mut at, mut covariance) = (found.at, found.covariance);
        let wide = |i: usize, limit: f64| found.covariance[(i, i)] > limit * limit;
        let posterior = match self.excitation {
            Excitation::FreeDecay => moments(log_posterior, found),
            Excitation::Ambient if wide(1, 0.12) || wide(2, 0.7) => moments(log_posterior, found),
            Excitation::Ambient => None,
        };
        if let Some(posterior) = posterior {
            (at, covariance) = (posterior.mean, posterior.covariance);
        }
        // The frequency's error scales with a variance known only as well as `scale` (of its logarithm):
        // the 95 % point of a t with 2/scale degrees of freedom over the normal's, to first order.
        let scale = match self.excitation {
            Excitation::Ambient => covariance[(1, 1)].min(0.5),
            Excitation::FreeDecay => covariance[(2, 2)].min(0.15),
        };
        let sd = |i: usize| covariance[(i, i)].sqrt();
        (Parameters::from_array(at), sd(0) * (1.0 + 0.6 * scale), sd(1))
    }

    /// Whether the fit is a resonance, a line, or nothing (`None`).
    fn judge(&self, band: &Band, p: Parameters, sd: f64, log_sd: f64, half_width_hz: f64) -> Option<Fit> {
        let value = likelihood::resonance(band, self.excitation, &p)?;
        let noise = likelihood::noise_only(band, p.slope)?.max(likelihood::noise_only(band, 0.0)?);
        let evidence = 2.0 * (value.log_profile - noise);
        let lines_searched = self.nyquist_hz * band.duration_s;
        if !(evidence > LEAST_EVIDENCE + 2.0 * lines_searched.ln() && sd.is_finite()) {
            return None;
        }
        let reach = 0.75 / band.duration_s;
        let sine_at = |f: f64| {
            let flat = likelihood::sine(band, f, 0.0);
            let sloped = likelihood::sine(band, f, p.slope);
            flat.into_iter().chain(sloped).reduce(f64::max)
        };
        let sine_hz = golden(sine_at, p.frequency_hz - reach, p.frequency_hz + reach, 20);
        let over_sine = 2.0 * (value.log_profile - sine_at(sine_hz)?);
        let damping = p.log_damping.exp();
        let undamped = (p.log_damping + log_sd).exp() < LEAST_DAMPING;
        let gamma = damping * p.frequency_hz;
        let transient = value.transient.norm_sqr() / value.noise;
        Some(Fit {
            resonance: Resonance {
                frequency_hz: p.frequency_hz,
                frequency_sd_hz: sd,
                damping,
                damping_log_sd: log_sd,
                peak_to_noise: p.log_ratio.exp() + transient,
                evidence,
                line: over_sine < LEAST_OVER_SINE || undamped,
                misfit: 0.0,
                foreign_log_odds: 0.0,
            },
            parameters: p,
            value,
            half_width_hz: half_width_hz.max(2.0 * gamma),
        })
    }

    /// Whether other modes lift the band of `fit` by more than a fifth of its noise floor.
    fn disturbed(&self, fit: &Fit, others: &[Fit]) -> bool {
        let f = fit.resonance.frequency_hz;
        [f - fit.half_width_hz, f, f + fit.half_width_hz]
            .iter()
            .any(|&f| {
                let lifted: f64 = others.iter().map(|other| skirt(other, f)).sum();
                let pulled: f64 = others.iter().map(|other| pull(other, f).norm_sqr()).sum();
                lifted + pulled > 0.2 * fit.value.noise
            })
    }
}

/// The random part of another mode's spectrum at `f`.
fn skirt(other: &Fit, f: f64) -> f64 {
    let h = likelihood::shape(other.resonance.frequency_hz, other.resonance.damping, f);
    other.value.noise * other.parameters.log_ratio.exp() * h.norm_sqr()
}

/// The transient of another mode at `f`.
fn pull(other: &Fit, f: f64) -> Complex<f64> {
    other.value.transient * likelihood::shape(other.resonance.frequency_hz, other.resonance.damping, f)
}

/// Takes another mode out of a band: its transient (free decays) from the coefficients, its random
/// skirt into the shape of the noise floor, of which `level` is the height without it.
fn subtract(band: &mut Band, other: &Fit, excitation: Excitation, level: f64) {
    band.for_each(|cell| {
        if excitation == Excitation::FreeDecay {
            // The cells of a free decay hold one line each.
            let c = pull(other, cell.frequency_hz);
            cell.re -= c.re;
            cell.im -= c.im;
            cell.power = cell.re * cell.re + cell.im * cell.im;
        }
        cell.floor += skirt(other, cell.frequency_hz) / level;
    });
}
