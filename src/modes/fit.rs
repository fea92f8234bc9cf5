//! One stretch of a record: a resonance fitted to the raw Fourier coefficients around each peak.

use super::band::{Band, Coefficients};
use super::dispersion::{Dispersion, dispersion};
use super::likelihood::{self, Parameters, Start, Value};
use super::optimum::{Optimum, golden, maximise};
use super::parts::Beginning;
use super::posterior::moments;
use super::subband::{Pole, Subband};
use super::{Mask, Resonance};
use crate::spectrum::Transforms;
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
/// Power at the beginning of a stretch over a stationary response's, beyond which a free start is tried: a
/// stationary one reaches it once in 50 times, a decay worth a free start has ten times as much.
const START_EXCESS: f64 = 4.0;
/// Log-posterior gain a free start must bring.
const FREE_GAIN: f64 = 10.0;

/// Log odds that a peak of too little damping to tell is foreign.
const UNDECIDED_LOG_ODDS: f64 = 0.7;
/// Unevenness of the amplitude below which a peak may be a tone: noise 20 dB below one makes 1.02.
const TONE_UNEVENNESS: f64 = 1.25;

/// Where a resonance is, before its errors.
pub struct Place {
    /// The fit with the errors its curvature promises.
    pub fit: Fit,
    found: Found,
}

/// A maximum of the likelihood, with the band it was found in.
struct Found {
    band: Band,
    top: Optimum,
    start: Start,
    half_width_hz: f64,
}

/// One fitted peak.
#[derive(Debug, Clone, Copy)]
pub struct Fit {
    /// What it says.
    pub resonance: Resonance,
    /// Where the likelihood is highest.
    pub parameters: Parameters,
    /// The state it began with.
    pub start: Start,
    value: Value,
    half_width_hz: f64,
    /// Middle and half width of the band fitted \[Hz\].
    band_hz: (f64, f64),
}

impl Fit {
    /// The fitted pole.
    pub fn pole(&self) -> Pole {
        Pole {
            frequency_hz: self.resonance.frequency_hz,
            damping: self.resonance.damping,
        }
    }
}

/// Where a resonance is looked for.
#[derive(Debug, Clone, Copy)]
pub struct Aim {
    /// The peak \[Hz\].
    pub peak_hz: f64,
    /// What a fit to another stretch of the record found.
    pub before: Option<Parameters>,
}

/// One stretch of a record, its Fourier coefficients, and what is known before any fit.
pub struct Stretch<'a> {
    /// Transforms planned before.
    pub transforms: &'a Transforms,
    /// The stretch itself.
    pub coefficients: Coefficients,
    /// Its beginning.
    pub beginning: Beginning,
    /// Bands not looked at.
    pub masks: &'a [Mask],
    /// Line distance of the spectrum the peaks were picked from \[Hz\].
    pub line_hz: f64,
    /// Half the sample rate \[Hz\].
    pub nyquist_hz: f64,
}

impl Stretch<'_> {
    /// Where the resonances are, by curvature alone: one entry per aim, `None` where a peak is noise or part
    /// of a resonance already fitted. Aims come in descending height: what a lower one shows must stand
    /// above the skirts of those before.
    pub fn places(&self, aims: &[Aim]) -> Vec<Option<Place>> {
        let mut fits: Vec<Fit> = Vec::new();
        let mut places = Vec::with_capacity(aims.len());
        for &aim in aims {
            let place = if fits.iter().any(|fit| self.same(fit, aim.peak_hz)) {
                None
            } else {
                self.best(aim, &fits)
                    .and_then(|found| Some((self.provisional(&found)?, found)))
                    .filter(|(fit, _)| {
                        !fits
                            .iter()
                            .any(|other| self.same(other, fit.resonance.frequency_hz))
                    })
            };
            places.push(place.map(|(fit, found)| {
                fits.push(fit);
                Place { fit, found }
            }));
        }
        places
    }

    /// The resonances found, each beside all others, with their errors.
    pub fn with_errors(&self, places: &[Option<Place>]) -> Vec<Option<Fit>> {
        let fits: Vec<(usize, Fit)> = places
            .iter()
            .enumerate()
            .filter_map(|(n, place)| Some((n, place.as_ref()?.fit)))
            .collect();
        places
            .iter()
            .enumerate()
            .map(|(n, place)| {
                let place = place.as_ref()?;
                let others: Vec<Fit> = fits
                    .iter()
                    .filter(|(m, _)| *m != n)
                    .map(|(_, fit)| *fit)
                    .collect();
                if self.disturbed(&place.fit, &others) {
                    let aim = Aim {
                        peak_hz: place.fit.parameters.frequency_hz,
                        before: Some(place.fit.parameters),
                    };
                    let level = Some(place.fit.value.noise);
                    self.judged(&self.maximum(aim, place.found.start, &others, level)?, &others)
                } else {
                    self.judged(&place.found, &others)
                }
            })
            .collect()
    }

    /// The series of a resonance, less the transients of the others and what is smooth across its band; `half_hz` to either side as far as its
    /// neighbours and masks allow.
    pub fn subband(&self, fit: &Fit, half_hz: f64, others: &[Fit]) -> Option<Subband> {
        let f = fit.resonance.frequency_hz;
        let limits = self.limits(f, others);
        let half = half_hz.max(LEAST_LINES / self.coefficients.duration_s);
        let (low, high) = ((f - half).max(limits.0), (f + half).min(limits.1));
        if self.masks.iter().any(|m| m.low_hz < high && m.high_hz > low) {
            return None;
        }
        Subband::of(
            self.transforms,
            &self.coefficients,
            (low, high),
            fit.pole(),
            |f| {
                let (middle, half) = fit.band_hz;
                let [level, slope] = fit.value.smooth;
                others.iter().map(|other| pull(other, f)).sum::<Complex<f64>>()
                    + level
                    + slope * ((f - middle) / half)
            },
        )
    }

    /// The maximum with the start that the stretch itself calls for.
    fn best(&self, aim: Aim, others: &[Fit]) -> Option<Found> {
        match self.beginning {
            Beginning::Known(start) => self.maximum(aim, start, others, None),
            Beginning::Tested => {
                let Some(stationary) = self.maximum(aim, Start::Stationary, others, None) else {
                    return self.maximum(aim, Start::Free, others, None);
                };
                Some(self.free(&stationary, others).unwrap_or(stationary))
            }
        }
    }

    /// The fit with a free start if it is worth more than the stationary one.
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
        let parameters = Parameters::from_array(stationary.top.at);
        let start = self.start(&stationary.band, parameters.frequency_hz, Start::Free)?;
        let top = self.climb(&stationary.band, start, Start::Free)?;
        let p = Parameters::from_array(top.at);
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

    /// Whether a peak at `frequency_hz` is part of a resonance already fitted.
    pub fn same(&self, fit: &Fit, frequency_hz: f64) -> bool {
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
        (level, start): (Option<f64>, Start),
    ) -> Band {
        let half = half.max(LEAST_LINES / self.coefficients.duration_s);
        let (low, high) = ((centre - half).max(limits.0), (centre + half).min(limits.1));
        // A pull stands far above the noise: what a cell smooths would look like noise.
        let decays = start == Start::Free || others.iter().any(|other| other.start == Start::Free);
        let width = |f: f64| match decays {
            false => CELL * (f - centre).abs().max(core),
            true => 0.0,
        };
        let mut band = self.coefficients.band(low, high, self.masks, width);
        let level = level.unwrap_or_else(|| band.quiet_level());
        for other in others {
            subtract(&mut band, other, level);
        }
        band
    }

    /// The likelihood's maximum at a peak; `before` and `level` are its place and the noise floor if an
    /// earlier fit found them.
    fn maximum(
        &self,
        Aim { peak_hz, before }: Aim,
        start_of: Start,
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
        let mut band = self.band((peak_hz, half, core), limits, others, (level, start_of));
        let mut start = match before {
            Some(before) => before,
            None => self.start(&band, peak_hz, start_of)?,
        };
        for last in [false, false, true] {
            let top = self.climb(&band, start, start_of)?;
            let p = Parameters::from_array(top.at);
            let gamma = p.log_damping.exp() * p.frequency_hz;
            let wanted = HALF_WIDTHS * gamma;
            let next = self.band((p.frequency_hz, wanted, gamma), limits, others, (level, start_of));
            let ratio = next.lines / band.lines.max(1.0);
            if last || (0.45..1.6).contains(&ratio) {
                return Some(Found {
                    band,
                    top,
                    start: start_of,
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
        self.credible(found, Parameters::from_array(found.top.at), sd(0), sd(1))
    }

    /// The fit at a maximum with its standard errors, and what it was taken for.
    fn judged(&self, found: &Found, others: &[Fit]) -> Option<Fit> {
        let (p, sd, log_sd) = self.errors(found);
        let mut fit = self.credible(found, p, sd, log_sd)?;
        let gamma = p.log_damping.exp() * p.frequency_hz;
        let series = self.subband(&fit, HALF_WIDTHS * gamma, others);
        let scatter = series
            .as_ref()
            .and_then(|series| dispersion(series, fit.pole(), fit.value.noise, p.log_ratio.exp()))
            .unwrap_or(Dispersion::UNKNOWN);
        fit.resonance.frequency_sd_hz *= scatter.factor;
        fit.resonance.misfit = scatter.misfit;
        let over_sine = self.over_sine(&found.band, &fit)?;
        let verdict = tone(
            over_sine,
            p.log_damping,
            log_sd,
            series.map_or(1.0, |s| s.unevenness()),
        );
        fit.resonance.line = verdict == Tone::Sure;
        fit.resonance.foreign_log_odds = verdict.log_odds();
        Some(fit)
    }

    /// The best of a coarse grid of parameters around a picked peak.
    fn start(&self, band: &Band, peak_hz: f64, start: Start) -> Option<Parameters> {
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

    /// The posterior's maximum near `from`.
    fn climb(&self, band: &Band, from: Parameters, start: Start) -> Option<Optimum> {
        let gamma = from.log_damping.exp() * from.frequency_hz;
        let reach = [gamma.max(0.5 / band.duration_s), 1.0, 2.0, 1.0];
        maximise(|x| log_posterior(band, start, x), from.to_array(), reach)
    }

    /// The parameters and the standard errors of frequency and log damping: the optimum with its
    /// curvature where the record determines damping and excitation well, else the posterior's mean
    /// and standard deviation (few independent fluctuations: the curvature alone would promise too
    /// much).
    fn errors(&self, found: &Found) -> (Parameters, f64, f64) {
        let log_posterior = |x: &[f64; 4]| log_posterior(&found.band, found.start, x);
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
        (Parameters::from_array(at), sd(0) * (1.0 + 0.6 * scale), sd(1))
    }

    /// The fit at parameters `p` unless noise explains the peak as well.
    fn credible(&self, found: &Found, p: Parameters, sd: f64, log_sd: f64) -> Option<Fit> {
        let band = &found.band;
        let value = likelihood::resonance(band, found.start, &p)?;
        let noise = likelihood::noise_only(band, p.slope)?.max(likelihood::noise_only(band, 0.0)?);
        let evidence = 2.0 * (value.log_profile - noise);
        let lines_searched = self.nyquist_hz * band.duration_s;
        if !(evidence > LEAST_EVIDENCE + 2.0 * lines_searched.ln() && sd.is_finite()) {
            return None;
        }
        let damping = p.log_damping.exp();
        let transient = value.transient.norm_sqr() / value.noise;
        Some(Fit {
            resonance: Resonance {
                frequency_hz: p.frequency_hz,
                frequency_sd_hz: sd,
                damping,
                damping_log_sd: log_sd,
                peak_to_noise: p.log_ratio.exp() + transient,
                evidence,
                line: false,
                misfit: 0.0,
                foreign_log_odds: 0.0,
            },
            parameters: p,
            start: found.start,
            value,
            half_width_hz: found.half_width_hz.max(2.0 * damping * p.frequency_hz),
            band_hz: (band.middle_hz, band.half_width_hz),
        })
    }

    /// Twice the log-likelihood gain of a fit over a pure sine at its best.
    fn over_sine(&self, band: &Band, fit: &Fit) -> Option<f64> {
        let p = &fit.parameters;
        let reach = 0.75 / band.duration_s;
        let sine_at = |f: f64| {
            let flat = likelihood::sine(band, f, 0.0);
            let sloped = likelihood::sine(band, f, p.slope);
            flat.into_iter().chain(sloped).reduce(f64::max)
        };
        let sine_hz = golden(sine_at, p.frequency_hz - reach, p.frequency_hz + reach, 20);
        Some(2.0 * (fit.value.log_profile - sine_at(sine_hz)?))
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
fn subtract(band: &mut Band, other: &Fit, level: f64) {
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

fn log_posterior(band: &Band, start: Start, x: &[f64; 4]) -> Option<f64> {
    likelihood::resonance(band, start, &Parameters::from_array(*x)).map(|v| v.log_posterior)
}

/// Whether a peak is a pure tone of some machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tone {
    No,
    Undecided,
    Sure,
}

impl Tone {
    /// Log odds of its being foreign: ten to one for a tone, for a record may be too short for a mode's damping.
    fn log_odds(self) -> f64 {
        match self {
            Self::No => 0.0,
            Self::Undecided => UNDECIDED_LOG_ODDS,
            Self::Sure => std::f64::consts::LN_10,
        }
    }
}

/// The verdict on a peak from its log-likelihood gain over a sine (doubled), its log damping with standard
/// error, and the unevenness of its amplitude.
fn tone(over_sine: f64, log_damping: f64, log_sd: f64, unevenness: f64) -> Tone {
    let least = LEAST_DAMPING.ln();
    let decays = log_damping - 2.0 * log_sd > least && over_sine > LEAST_OVER_SINE;
    let steady = over_sine < LEAST_OVER_SINE || log_damping + log_sd < least;
    if decays {
        Tone::No
    } else if steady && unevenness < TONE_UNEVENNESS {
        Tone::Sure
    } else {
        Tone::Undecided
    }
}
