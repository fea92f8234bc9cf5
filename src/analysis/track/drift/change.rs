//! Onset, size and shape of a change from the onset particles, the change since commissioning, and ratios at the reference.

use super::bank::{Row, Seen, ln_sum};
use super::detector::{Detector, Shape};
use serde::{Deserialize, Serialize};

/// Quantiles of the intervals that are told.
const QUANTILES: [f64; 2] = [0.025, 0.975];
/// Standard normal quantile of the same.
const Z: f64 = 1.959_963_984_540_054;

/// Posterior of a change, given that there is one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Onset \[d\]: posterior mean.
    pub onset: f64,
    /// 95 % interval of the onset \[d\].
    pub onset_interval: [f64; 2],
    /// Change of the ratio up to the last period: mean.
    pub size: f64,
    /// Its standard deviation.
    pub size_sd: f64,
    /// Its 95 % interval.
    pub size_interval: [f64; 2],
    /// Probability of a ramp, rather than a step.
    pub ramp_probability: f64,
    /// Change in a year if it is a ramp: mean and standard deviation; `None` without ramps.
    pub rate_per_year: Option<(f64, f64)>,
}

/// A quantity with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Central 95 % interval.
    pub interval: [f64; 2],
}

impl Estimate {
    fn of(parts: &[Normal]) -> Self {
        let (mean, sd) = moments(parts);
        Self {
            mean,
            sd,
            interval: interval(parts),
        }
    }
}

/// One component of a mixture of normal laws.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Normal {
    weight: f64,
    mean: f64,
    sd: f64,
}

impl Detector {
    /// Posterior of a change over the onset particles; `None` before the first is born.
    pub fn change(&self) -> Option<Change> {
        let day = self.last_day()?;
        let total = ln_sum(self.weights());
        if self.particles.is_empty() || !total.is_finite() {
            return None;
        }
        let weights: Vec<f64> = self.weights().map(|weight| libm::exp(weight - total)).collect();
        let mut parts = Vec::with_capacity(weights.len());
        let mut rates = Vec::new();
        let mut onsets = Vec::with_capacity(weights.len());
        let (mut onset, mut ramp_probability) = (0.0, 0.0);
        for (particle, &weight) in self.particles.iter().zip(&weights) {
            let (mean, sd) = particle.bank.change();
            let h = particle.shape.regressor(day - particle.onset);
            parts.push(Normal {
                weight,
                mean: h * mean,
                sd: h * sd,
            });
            onset += weight * particle.onset;
            onsets.push((particle.onsets, weight));
            if particle.shape == Shape::Ramp {
                ramp_probability += weight;
                rates.push(Normal { weight, mean, sd });
            }
        }
        let (size, size_sd) = moments(&parts);
        Some(Change {
            onset,
            onset_interval: onset_interval(&onsets),
            size,
            size_sd,
            size_interval: interval(&parts),
            ramp_probability,
            rate_per_year: (ramp_probability > 0.0).then(|| moments(&rates)),
        })
    }

    /// Change since commissioning ended, at the reference columns; `None` before.
    ///
    /// The average over a level that wanders by 1 % a year, with its evidence, and the onset particles, each with the
    /// odds of one onset in `limit` periods. Errors of the coefficients and of the fluctuation are in it.
    pub fn since(&self, limit: f64) -> Option<Estimate> {
        let since = self.since.as_ref()?;
        let day = self.last_day()?;
        let rare = libm::log(limit.max(1.0));
        let ln_weights = self
            .weights()
            .map(|weight| weight - rare)
            .chain([since.ln_weight]);
        let total = ln_sum(ln_weights.clone());
        let mut parts = Vec::with_capacity(self.particles.len() + 1);
        for (particle, ln_weight) in self.particles.iter().zip(ln_weights) {
            let (mean, sd) = particle.bank.change();
            let h = |day: f64| match day < particle.onset {
                true => 0.0,
                false => particle.shape.regressor(day - particle.onset),
            };
            let h = h(day) - h(since.day);
            parts.push(Normal {
                weight: libm::exp(ln_weight - total),
                mean: h * mean,
                sd: h * sd,
            });
        }
        let (mean, sd) = since.bank.change();
        parts.push(Normal {
            weight: libm::exp(since.ln_weight - total),
            mean,
            sd,
        });
        Some(Estimate::of(&parts))
    }

    /// Ratio of a record or period at the reference columns and its standard deviation, which holds the measurement, the
    /// fluctuation and the coefficients, not the level; `None` for a period that cannot be used.
    pub fn compensate(&self, seen: &Seen) -> Option<(f64, f64)> {
        let row = Row::new(&self.prior, seen)?;
        let mut null = self.null.clone();
        null.advance(&self.prior, &self.passage(seen.day));
        let (explained, sd) = null.explained(&row);
        Some((row.ratio - explained, sd))
    }
}

/// Mean and standard deviation of a mixture.
fn moments(parts: &[Normal]) -> (f64, f64) {
    let total: f64 = parts.iter().map(|part| part.weight).sum();
    let mean = parts.iter().map(|part| part.weight * part.mean).sum::<f64>() / total;
    let off = |part: &Normal| part.sd * part.sd + (part.mean - mean) * (part.mean - mean);
    let variance = parts.iter().map(|part| part.weight * off(part)).sum::<f64>() / total;
    (mean, variance.sqrt())
}

/// Central 95 % interval of a mixture, by bisection of its distribution function.
fn interval(parts: &[Normal]) -> [f64; 2] {
    let total: f64 = parts.iter().map(|part| part.weight).sum();
    let below = |x: f64| {
        let below =
            |part: &Normal| part.weight * normal_cdf((x - part.mean) / part.sd.max(f64::MIN_POSITIVE));
        parts.iter().map(below).sum::<f64>() / total
    };
    let reach = |sign: f64| parts.iter().map(move |part| part.mean + sign * 2.0 * Z * part.sd);
    let low = reach(-1.0).fold(f64::INFINITY, f64::min);
    let high = reach(1.0).fold(f64::NEG_INFINITY, f64::max);
    QUANTILES.map(|quantile| {
        let (mut low, mut high) = (low, high);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            *(if below(middle) < quantile {
                &mut low
            } else {
                &mut high
            }) = middle;
        }
        0.5 * (low + high)
    })
}

/// Central 95 % interval of the onset: particles stand for the onsets merged into them.
fn onset_interval(onsets: &[([f64; 2], f64)]) -> [f64; 2] {
    let mut sorted = onsets.to_vec();
    sorted.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
    let mut below = 0.0;
    let mut bounds = [sorted[0].0[0], sorted[sorted.len() - 1].0[1]];
    for (range, weight) in &sorted {
        if below <= QUANTILES[0] && below + weight > QUANTILES[0] {
            bounds[0] = range[0];
        }
        if below < QUANTILES[1] && below + weight >= QUANTILES[1] {
            bounds[1] = range[1];
        }
        below += weight;
    }
    [bounds[0], bounds[1].max(bounds[0])]
}

fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}
