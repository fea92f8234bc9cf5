//! Picture of one record: its waveform, its spectrum with the peaks found and, if it gave a force, prior against posterior
//! of each uncertain quantity; small enough to be kept for the report.

use crate::findings::{self, CERTAIN, Candidate, Multiple, Nature, Peak};
use crate::identify::{Identification, Measurement};
use crate::inference::{Posterior, VarianceShares};
use crate::outcome::{Outcome, Rejected};
use crate::rod::beam::Quantity;
use crate::rod::prior::{Prior, RodPrior};
use crate::signal::modes::{Labels, Mode, Motion};
use crate::signal::record::{Envelope, Rejection, Timestamp};
use crate::signal::spectrum::Spectrum;
use serde::{Deserialize, Serialize};

/// Most points of a kept spectrum.
const SPECTRUM_POINTS: usize = 1200;
/// End of a kept spectrum, as a multiple of the highest labelled mode, or of the highest peak where none is
/// labelled.
const BEYOND_HIGHEST: f64 = 1.5;
/// Points of a kept density.
const DENSITY_POINTS: usize = 96;
/// Span of a kept density, in standard deviations of its prior to either side.
const DENSITY_SPAN_SD: f64 = 3.5;
/// Level shown for a power of zero \[dB\].
const SILENCE_DB: f64 = -400.0;

/// View of one record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Time of the first sample.
    pub start: Timestamp,
    /// Length of the record \[s\].
    pub duration_s: f64,
    /// Sample rate \[Hz\].
    pub fs_hz: f64,
    /// The record's seed, as sixteen hexadecimal digits: JSON readers round larger integers. Empty without a force.
    pub seed: String,
    /// The samples; `None` for records of older programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waveform: Option<Envelope>,
    /// Welch's power spectral density.
    pub curve: Curve,
    /// The resonances found, ascending in frequency.
    pub peaks: Vec<PeakMark>,
    /// The uncertain quantities, axial force first; none without a force.
    pub densities: Vec<Density>,
    /// The sources of the force's variance; `None` for records of older programs, or without a force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hangs_on: Option<VarianceShares>,
    /// The motion that was recognised; `None` for records of older programs.
    #[serde(default, rename = "excitation", skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
    /// Probability that the orders of the modes are right, if they were found and not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label_probability: Option<f64>,
    /// Assignments of peaks to modes, where none is certain; likeliest first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub candidates: Vec<Candidate>,
    /// The reason why there is no force, if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rejection: Option<Reason>,
}

/// The reason why a record gives no force.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reason {
    /// Short name: `no-label`.
    pub code: String,
    /// Reason in words, with the remedy.
    pub message: String,
}

/// A power spectral density at evenly spaced frequencies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Frequency of the first point \[Hz\].
    pub first_hz: f64,
    /// Distance of neighbouring points \[Hz\].
    pub step_hz: f64,
    /// Ten times the decimal logarithm of the density in unit^2/Hz \[dB\]; the largest among the lines of
    /// each point.
    pub level_db: Vec<f64>,
}

/// A resonance of the spectrum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PeakMark {
    /// Its frequency \[Hz\].
    pub frequency_hz: f64,
    /// Mode order, if it was given one.
    pub order: Option<usize>,
    /// True if it is a pure sine: interference.
    pub line: bool,
    /// Standard error of the frequency \[Hz\]; this and the following fields are missing in records of older
    /// programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sd_hz: Option<f64>,
    /// Damping ratio \[-\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
    /// Standard error of the damping ratio \[-\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping_sd: Option<f64>,
    /// Height over the noise floor \[dB\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level_db: Option<f64>,
    /// Nature of the peak.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub taken_for: Option<Nature>,
    /// Peak of which it is a multiple.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub multiple_of: Option<Multiple>,
}

/// Prior and posterior density of one quantity at the same evenly spaced values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Density {
    /// The quantity's key, with its unit: `axial_force_n`.
    pub quantity: String,
    /// The first value, SI.
    pub low: f64,
    /// The last value, SI.
    pub high: f64,
    /// Prior density times (high - low).
    pub prior: Vec<f64>,
    /// Posterior density times (high - low).
    pub posterior: Vec<f64>,
    /// Prior mean and standard deviation (before truncation), SI.
    pub prior_mean_sd: (f64, f64),
    /// Posterior mean and standard deviation, SI.
    pub posterior_mean_sd: (f64, f64),
}

impl Snapshot {
    /// View of a record's result; `None` for frequencies measured elsewhere, and for a refused record without
    /// samples.
    pub fn of_outcome(prior: &RodPrior, outcome: &Outcome) -> Option<Self> {
        match outcome {
            Outcome::Identified(identification) => Self::of(prior, identification),
            Outcome::Tabulated(_) => None,
            Outcome::Rejected(rejected) => Self::of_rejected(rejected),
        }
    }

    /// View of an identified record; `None` for frequencies measured elsewhere, which have no spectrum.
    pub fn of(prior: &RodPrior, identification: &Identification) -> Option<Self> {
        let measurement = identification.measurement.as_ref()?;
        let modes = &identification.modes;
        let highest_hz = modes
            .iter()
            .fold(0.0_f64, |high, mode| high.max(mode.frequency_hz));
        Some(Self {
            seed: format!("{:016x}", identification.posterior.seed),
            densities: densities(prior, &identification.posterior),
            hangs_on: identification.hangs_on.clone(),
            ..Self::of_measurement(
                measurement,
                modes,
                identification.labels.as_ref(),
                BEYOND_HIGHEST * highest_hz,
            )
        })
    }

    /// View of a refused record; `None` if it has no samples or no time.
    pub fn of_rejected(rejected: &Rejected) -> Option<Self> {
        let reason = Reason {
            code: rejected.rejection.code().to_owned(),
            message: rejected.rejection.to_string(),
        };
        let seen = match &rejected.measurement {
            Some(measurement) => {
                let peaks = measurement.resonances.iter().map(|peak| peak.frequency_hz);
                let high_hz = match (peaks.reduce(f64::max), &rejected.rejection) {
                    (Some(highest_hz), _) => BEYOND_HIGHEST * highest_hz,
                    (None, Rejection::NoPeak { high_hz, .. }) => *high_hz,
                    (None, _) => 0.5 * measurement.fs_hz,
                };
                Self::of_measurement(measurement, &[], rejected.labels.as_ref(), high_hz)
            }
            None => Self {
                start: rejected.start?,
                duration_s: rejected.duration_s?,
                fs_hz: rejected.fs_hz?,
                seed: String::new(),
                waveform: Some(rejected.waveform.clone()?),
                curve: Curve {
                    first_hz: 0.0,
                    step_hz: 0.0,
                    level_db: Vec::new(),
                },
                peaks: Vec::new(),
                densities: Vec::new(),
                hangs_on: None,
                motion: None,
                label_probability: None,
                candidates: Vec::new(),
                rejection: None,
            },
        };
        Some(Self {
            rejection: Some(reason),
            // A probability belongs to reported orders; here there are none.
            label_probability: None,
            ..seen
        })
    }

    /// View of a measurement up to a frequency \[Hz\], with the labelled modes.
    pub fn of_measurement(
        measurement: &Measurement,
        modes: &[Mode],
        labels: Option<&Labels>,
        high_hz: f64,
    ) -> Self {
        let is_certain = |labels: &&Labels| !modes.is_empty() && labels.probability >= CERTAIN;
        Self {
            start: measurement.start,
            duration_s: measurement.duration_s,
            fs_hz: measurement.fs_hz,
            seed: String::new(),
            waveform: Some(measurement.waveform.clone()),
            curve: Curve::of(&measurement.spectrum, high_hz),
            peaks: findings::peaks(measurement, modes)
                .iter()
                .zip(&measurement.resonances)
                .map(|(peak, resonance)| PeakMark::of(peak, resonance.line))
                .filter(|peak| peak.frequency_hz <= high_hz)
                .collect(),
            densities: Vec::new(),
            hangs_on: None,
            motion: Some(measurement.motion.clone()),
            label_probability: labels.map(|labels| labels.probability),
            candidates: labels
                .filter(|labels| !is_certain(labels))
                .map(Candidate::all)
                .unwrap_or_default(),
            rejection: None,
        }
    }
}

impl PeakMark {
    fn of(peak: &Peak, line: bool) -> Self {
        Self {
            frequency_hz: peak.frequency_hz,
            order: peak.order,
            line,
            sd_hz: Some(peak.sd_hz),
            damping: Some(peak.damping),
            damping_sd: peak.damping_sd,
            level_db: Some(peak.level_db),
            taken_for: Some(peak.taken_for),
            multiple_of: peak.multiple_of,
        }
    }

    /// Nature of the peak in words.
    pub fn said(&self) -> String {
        match (self.taken_for, self.order) {
            (Some(nature), order) => findings::said(nature, order, self.multiple_of),
            (None, Some(order)) => format!("mode {order}"),
            (None, None) if self.line => "tone".to_owned(),
            (None, None) => "not of the rod".to_owned(),
        }
    }
}

impl Curve {
    /// The spectrum up to a frequency \[Hz\], without its line at 0 Hz.
    fn of(spectrum: &Spectrum, high_hz: f64) -> Self {
        let last = ((high_hz / spectrum.df_hz) as usize).clamp(1, spectrum.psd.len().max(2) - 1);
        let lines = spectrum.psd.get(1..=last).unwrap_or(&[]);
        let group = lines.len().div_ceil(SPECTRUM_POINTS).max(1);
        let level_db = lines
            .chunks(group)
            .map(|lines| {
                let largest = lines.iter().fold(0.0_f64, |largest, &psd| largest.max(psd));
                rounded((10.0 * libm::log10(largest)).max(SILENCE_DB), 100.0)
            })
            .collect();
        Self {
            first_hz: (1.0 + 0.5 * (group - 1) as f64) * spectrum.df_hz,
            step_hz: group as f64 * spectrum.df_hz,
            level_db,
        }
    }

    /// Frequency of point `i` \[Hz\].
    pub fn frequency_hz(&self, i: usize) -> f64 {
        self.first_hz + i as f64 * self.step_hz
    }
}

fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

fn densities(prior: &RodPrior, posterior: &Posterior) -> Vec<Density> {
    let quantities = posterior.parameterisation.quantities();
    let width = quantities.len();
    quantities
        .iter()
        .zip(prior.priors())
        .enumerate()
        .filter(|(_, (_, prior))| !prior.is_fixed())
        .map(|(column, (quantity, prior))| {
            let values = posterior.particles.iter().skip(column).step_by(width).copied();
            let weights = &posterior.weights;
            match prior {
                // The stiffness itself has no scale that shows both hinge and clamp.
                Prior::Fixity(fixity) => {
                    let before = Before {
                        mean_sd: fixity.fixity_mean_and_sd(),
                        span: (0.0, 1.0),
                        density: &|value| fixity.density_of_fixity(value),
                    };
                    density(
                        fixity_key(*quantity),
                        &before,
                        values.map(|k| fixity.of(k)),
                        weights,
                    )
                }
                _ => of_quantity(quantity.key(), prior, values, weights),
            }
        })
        .collect()
}

/// Key under which the fixity of a support is shown.
fn fixity_key(support: Quantity) -> &'static str {
    match support {
        Quantity::SpringLeft => "fixity_left",
        _ => "fixity_right",
    }
}

/// Prior of a quantity, as it is drawn.
struct Before<'a> {
    mean_sd: (f64, f64),
    /// The first and last value shown.
    span: (f64, f64),
    density: &'a dyn Fn(f64) -> f64,
}

fn of_quantity(
    quantity: &str,
    prior: &Prior,
    values: impl Iterator<Item = f64> + Clone,
    weights: &[f64],
) -> Density {
    let (mean, sd) = prior.mean_and_sd();
    let span = match *prior {
        // The prior spans decades: the range left by the posterior is shown, with as much again around it.
        Prior::LogUniform { low, high } => {
            let (least, most) = values.clone().fold((high, low), |(least, most), value| {
                (least.min(value), most.max(value))
            });
            let room = 0.5 * (most - least).max(1e-6 * high);
            ((least - room).max(low), (most + room).min(high))
        }
        _ => (
            (mean - DENSITY_SPAN_SD * sd).max(0.0),
            mean + DENSITY_SPAN_SD * sd,
        ),
    };
    let before = Before {
        mean_sd: (mean, sd),
        span,
        density: &|value| libm::exp(prior.log_density(value)),
    };
    density(quantity, &before, values, weights)
}

/// Prior by its closed form; posterior by a Gaussian kernel of Silverman's width
/// 0.9 sd ess^(-1/5) on linearly binned particles. Both are scaled to one over the span shown.
fn density(
    quantity: &str,
    before: &Before<'_>,
    values: impl Iterator<Item = f64> + Clone,
    weights: &[f64],
) -> Density {
    let (prior_mean, prior_sd) = before.mean_sd;
    let (low, high) = before.span;
    let step = (high - low) / (DENSITY_POINTS - 1) as f64;

    let mut mass = vec![0.0; DENSITY_POINTS];
    let (mut sum, mut squares, mut concentration) = (0.0, 0.0, 0.0);
    for (value, weight) in values.zip(weights) {
        let offset = value - prior_mean;
        sum += weight * offset;
        squares += weight * offset * offset;
        concentration += weight * weight;
        let place = (value - low) / step;
        if place >= 0.0 && place < (DENSITY_POINTS - 1) as f64 {
            let (i, share) = (place as usize, place.fract());
            mass[i] += weight * (1.0 - share);
            mass[i + 1] += weight * share;
        }
    }
    let sd = (squares - sum * sum).max(0.0).sqrt();
    let width = (0.9 * sd * concentration.powf(0.2) / step).max(0.5);
    let reach = (4.0 * width).ceil() as usize;
    let kernel: Vec<f64> = (0..=reach)
        .map(|j| libm::exp(-0.5 * (j as f64 / width).powi(2)))
        .collect();
    let smooth = |i: usize| -> f64 {
        let from = i.saturating_sub(reach);
        let to = (i + reach).min(DENSITY_POINTS - 1);
        (from..=to).map(|j| mass[j] * kernel[i.abs_diff(j)]).sum()
    };
    Density {
        quantity: quantity.to_owned(),
        low,
        high,
        prior: scaled((0..DENSITY_POINTS).map(|i| (before.density)(low + i as f64 * step))),
        posterior: scaled((0..DENSITY_POINTS).map(smooth)),
        prior_mean_sd: (prior_mean, prior_sd),
        posterior_mean_sd: (prior_mean + sum, sd),
    }
}

/// Scales values so that their mean over the span is one, ignoring the end weights of the trapezoidal rule.
fn scaled(values: impl Iterator<Item = f64>) -> Vec<f64> {
    // The prior's density may be infinite or not a number at the very ends (log-normal at zero).
    let values: Vec<f64> = values
        .map(|value| if value.is_finite() { value } else { 0.0 })
        .collect();
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let factor = if mean > 0.0 { mean.recip() } else { 0.0 };
    values.iter().map(|value| rounded(value * factor, 1e4)).collect()
}

#[cfg(test)]
mod tests;
