//! One stretch of a record: a resonance fitted to the raw Fourier coefficients around each peak.

use super::band::{Band, Coefficients};
use super::dispersion::{Dispersion, dispersion};
use super::likelihood::{self, Parameters, Start, Value};
use super::maximum::Found;
use super::parts::Beginning;
use super::softened::Softened;
use super::softening::Softening;
use super::subband::{Pole, Subband};
use super::tone::{Tone, tone};
use super::tone_beside::SteadyTone;
use super::{Mask, Resonance};
use crate::numerics::optimum::golden;
use crate::signal::spectrum::Transforms;
use rustfft::num_complex::Complex;

/// Half width of a band in half-power half-widths of its peak: beyond 8 the band holds less than a
/// tenth more of the information on the frequency (bandwidth factor 0.84, Au 2014).
pub(super) const HALF_WIDTHS: f64 = 8.0;
/// Fewest lines to either side of the peak: the noise floor must be known from lines that the mode does
/// not reach, or excitation that goes on during a decay is taken for noise.
pub(super) const LEAST_LINES: f64 = 40.0;
/// A band never reaches further than this share of the peak's frequency.
const WIDEST: f64 = 0.35;
/// Least evidence of a peak: twice its log-likelihood gain over noise, beyond the gain of the search over
/// lines.
const LEAST_EVIDENCE: f64 = 16.0;
/// Location of a resonance, before its errors.
pub struct Place {
    /// Fit with the errors that its curvature gives.
    pub fit: Fit,
    found: Found,
}

/// One fitted peak.
#[derive(Debug, Clone, Copy)]
pub struct Fit {
    /// Resonance found.
    pub resonance: Resonance,
    /// Parameters of highest likelihood.
    pub parameters: Parameters,
    /// Start that the fit assumed.
    pub start: Start,
    pub(super) value: Value,
    half_width_hz: f64,
    /// Factor by which gusts inflate a log-likelihood gain.
    pub(super) spread: f64,
    /// Softening of a decay with its transient; `None` for other motion.
    pub(super) softening: Option<Softening>,
    softened: Option<Softened>,
    /// Part of the frequency's error that all decays of the mode share \[Hz\].
    pub(super) shared_sd_hz: f64,
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

    /// True if the other's peak lies within the half width of the band that was wanted for this one.
    fn is_near(&self, other: &Self) -> bool {
        (other.resonance.frequency_hz - self.resonance.frequency_hz).abs() < self.half_width_hz
    }

    /// Transient of a softened decay at `f` less that of a linear decay of the same beginning.
    fn beyond_linear(&self, f: f64) -> Complex<f64> {
        self.softened.map_or(Complex::default(), |softened| {
            let phase = self.parameters.softening / self.resonance.damping;
            let linear = likelihood::shape(self.resonance.frequency_hz, self.resonance.damping, f);
            self.value.transient * (softened.at(f) - Complex::from_polar(1.0, phase) * linear)
        })
    }
}

/// Starting point of a fit.
#[derive(Debug, Clone, Copy)]
pub struct Aim {
    /// Frequency of the peak \[Hz\].
    pub peak_hz: f64,
    /// Parameters found in another stretch of the record.
    pub before: Option<Parameters>,
}

/// One stretch of a record: its Fourier coefficients, and what is known before any fit.
pub struct Stretch<'a> {
    /// Transform plans, shared.
    pub transforms: &'a Transforms,
    /// Fourier coefficients of the stretch.
    pub coefficients: Coefficients,
    /// Motion at the beginning of the stretch.
    pub beginning: Beginning,
    /// Bands that are left out.
    pub masks: &'a [Mask],
    /// Steady tones that were subtracted from the samples.
    pub tones: &'a [SteadyTone],
    /// Line distance of the spectrum the peaks were picked from \[Hz\].
    pub line_hz: f64,
    /// Half the sample rate \[Hz\].
    pub nyquist_hz: f64,
}

impl Stretch<'_> {
    /// Locations of the resonances, by curvature alone: one entry per aim, `None` where a peak is noise or
    /// part of a resonance already fitted. Aims come in descending height: a lower one must rise above the
    /// skirts of those before.
    pub fn places(&self, aims: &[Aim]) -> Vec<Option<Place>> {
        let mut fits: Vec<Fit> = Vec::new();
        let mut places = Vec::with_capacity(aims.len());
        for &aim in aims {
            let place = if fits.iter().any(|fit| self.same(fit, aim.peak_hz)) {
                None
            } else {
                self.best(aim, &fits)
                    .filter(|found| !found.is_at_edge())
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

    /// Fits of the resonances found, each with all others taken into account, with their errors.
    pub fn with_errors(&self, places: &[Option<Place>]) -> Vec<Option<Fit>> {
        let mut fits: Vec<Option<Fit>> = places
            .iter()
            .map(|place| place.as_ref().map(|place| place.fit))
            .collect();
        let mut judged = Vec::with_capacity(places.len());
        for (n, place) in places.iter().enumerate() {
            let others: Vec<Fit> = fits
                .iter()
                .enumerate()
                .filter(|(m, _)| *m != n)
                .filter_map(|(_, fit)| *fit)
                .collect();
            let higher: Vec<Fit> = fits[..n].iter().flatten().copied().collect();
            let fit = place
                .as_ref()
                .and_then(|place| self.with_error(place, &others, &higher));
            // A fit that was made alone may have spanned a tone and a mode. The mode is judged beside the tone, not beside the span;
            // and beside nothing that is none.
            if fit.is_none_or(|fit| fit.resonance.line) {
                fits[n] = fit;
            }
            judged.push(fit);
        }
        judged
    }

    /// Fit of a place beside the `others`, of which some have `higher` peaks.
    fn with_error(&self, place: &Place, others: &[Fit], higher: &[Fit]) -> Option<Fit> {
        if !self.disturbed(&place.fit, others) {
            return self.judged(&place.found, others);
        }
        let aim = Aim {
            peak_hz: place.fit.parameters.frequency_hz,
            before: Some(place.fit.parameters),
        };
        let level = Some(place.fit.value.noise);
        let found = self.maximum(aim, place.found.start, others, level)?;
        if !found.is_at_edge() {
            return self.judged(&found, others);
        }
        // Driven to the edge by lower peaks alone, which are parts of its skirts, it keeps the fit that it had without them.
        let is_highest = !higher.iter().any(|other| place.fit.is_near(other));
        is_highest.then(|| self.judged(&place.found, others))?
    }

    /// Time series of a resonance, less the transients of the others and all that is smooth across its band;
    /// `half_hz` to either side as far as its neighbours and masks allow.
    pub fn subband(&self, fit: &Fit, half_hz: f64, others: &[Fit]) -> Option<Subband> {
        let (middle, half) = fit.band_hz;
        let [level, slope] = fit.value.smooth;
        let smooth = |f| level + slope * ((f - middle) / half) + fit.beyond_linear(f);
        self.band_series(fit, (half_hz, half_hz), others, smooth, |_, _| 1.0)
    }

    /// Time series of a band about a resonance, so far below and above it, weighted for its pole; less the transients of `others` and
    /// `smooth`, times `gain` ([`Subband::of`]).
    pub(super) fn band_series(
        &self,
        fit: &Fit,
        (below_hz, above_hz): (f64, f64),
        others: &[Fit],
        smooth: impl Fn(f64) -> Complex<f64>,
        gain: impl Fn(f64, f64) -> f64,
    ) -> Option<Subband> {
        let f = fit.resonance.frequency_hz;
        let limits = self.limits(f, others);
        let least = LEAST_LINES / self.coefficients.duration_s;
        let (low, high) = (f - below_hz.max(least), f + above_hz.max(least));
        let (low, high) = (low.max(limits.0), high.min(limits.1));
        if self.masks.iter().any(|m| m.low_hz < high && m.high_hz > low) {
            return None;
        }
        Subband::of(
            self.transforms,
            &self.coefficients,
            (low, high),
            fit.pole(),
            |f| others.iter().map(|other| pull(other, f)).sum::<Complex<f64>>() + smooth(f),
            gain,
        )
    }

    /// True if a peak at `frequency_hz` is part of a resonance already fitted.
    pub fn same(&self, fit: &Fit, frequency_hz: f64) -> bool {
        let r = &fit.resonance;
        let near = (1.5 * r.damping * r.frequency_hz).max(1.5 * self.line_hz);
        (frequency_hz - r.frequency_hz).abs() < near
    }

    /// Limits of the band of a peak \[Hz\]: half way to the nearest resonances already fitted.
    pub(super) fn limits(&self, peak_hz: f64, others: &[Fit]) -> (f64, f64) {
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

    /// Fit at a maximum with the errors that its curvature gives.
    pub(super) fn provisional(&self, found: &Found) -> Option<Fit> {
        let sd = |i: usize| found.covariance()[(i, i)].sqrt();
        self.credible(found, found.parameters(), sd(0), sd(1))
    }

    /// Fit at a maximum with its standard errors, classified as resonance or tone.
    fn judged(&self, found: &Found, others: &[Fit]) -> Option<Fit> {
        let (p, sd, log_sd, softening) = self.errors(found);
        let mut fit = self.credible(found, p, sd, log_sd)?;
        let gamma = p.log_damping.exp() * p.frequency_hz;
        let series = self.subband(&fit, HALF_WIDTHS * gamma, others);
        let scatter = series
            .as_ref()
            .and_then(|series| dispersion(series, fit.pole(), fit.value.noise, p.log_ratio.exp()))
            .unwrap_or(Dispersion::UNKNOWN);
        fit.resonance.frequency_sd_hz *= scatter.factor;
        fit.resonance.misfit = scatter.misfit;
        fit.spread = scatter.factor * scatter.factor;
        fit.softening = softening.map(|s| Softening {
            variance: fit.spread * s.variance,
            ..s
        });
        let over_sine = self.over_sine(&found.band, &fit)?;
        let verdict = tone(
            over_sine,
            p.log_damping,
            log_sd,
            series.map_or(1.0, |s| s.unevenness(fit.pole())),
        );
        fit.resonance.line = verdict == Tone::Sure;
        fit.resonance.foreign_log_odds = verdict.log_odds();
        Some(fit)
    }

    /// True if twice a log-likelihood gain over noise is more than the search over all lines finds by chance.
    pub(super) fn is_evident(&self, gain: f64) -> bool {
        let lines_searched = self.nyquist_hz * self.coefficients.duration_s;
        gain > LEAST_EVIDENCE + 2.0 * lines_searched.ln()
    }

    /// Bands whose lines no fit uses: masks, and the lines of subtracted tones.
    pub(super) fn left_out(&self) -> impl Iterator<Item = Mask> {
        let duration_s = self.coefficients.duration_s;
        let cores = self.tones.iter().map(move |tone| tone.core(duration_s));
        self.masks.iter().copied().chain(cores)
    }

    /// Fit at parameters `p`, or `None` if noise explains the peak as well.
    fn credible(&self, found: &Found, p: Parameters, sd: f64, log_sd: f64) -> Option<Fit> {
        let band = &found.band;
        let value = likelihood::resonance(band, found.start, &p)?;
        let noise = likelihood::noise_only(band, p.slope)?.max(likelihood::noise_only(band, 0.0)?);
        let evidence = 2.0 * (value.log_profile - noise);
        if !(self.is_evident(evidence) && sd.is_finite()) {
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
            spread: 1.0,
            softening: None,
            softened: (p.softening != 0.0)
                .then(|| Softened::new(p.frequency_hz, damping, p.softening, self.coefficients.duration_s))
                .flatten(),
            shared_sd_hz: 0.0,
            half_width_hz: found.half_width_hz.max(2.0 * damping * p.frequency_hz),
            band_hz: (band.middle_hz, band.half_width_hz),
        })
    }

    /// Twice the log-likelihood gain of a fit over the best pure sine.
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

    /// True if other modes lift the band of `fit` by more than a fifth of its noise floor.
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

/// Random part of another mode's spectrum at `f`.
pub(super) fn skirt(other: &Fit, f: f64) -> f64 {
    let h = likelihood::shape(other.resonance.frequency_hz, other.resonance.damping, f);
    other.value.noise * other.parameters.log_ratio.exp() * h.norm_sqr()
}

/// The transient of another mode at `f`.
pub(super) fn pull(other: &Fit, f: f64) -> Complex<f64> {
    let shape = match &other.softened {
        Some(softened) => softened.at(f),
        None => likelihood::shape(other.resonance.frequency_hz, other.resonance.damping, f),
    };
    other.value.transient * shape
}
