//! Onset, size and shape of a change from the onset particles.

use super::detector::{Detector, Particle, Shape, ln_sum};
use super::onset;
use serde::{Deserialize, Serialize};

/// Quantiles of the intervals reported.
const QUANTILES: [f64; 2] = [0.025, 0.975];
/// Standard normal quantile of 97.5 %.
const Z: f64 = 1.959_963_984_540_054;

/// Posterior of a change, given that there is one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Onset \[d\]: median of its posterior.
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

/// One component of a mixture of normal laws.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Normal {
    weight: f64,
    mean: f64,
    sd: f64,
}

impl Particle {
    /// Law of the change by a day, c of this mean and standard deviation.
    fn part(&self, day: f64, weight: f64, (mean, sd): (f64, f64)) -> Normal {
        let h = self.shape.regressor(day - self.onset);
        Normal {
            weight,
            mean: h * mean,
            sd: h * sd,
        }
    }
}

impl Detector {
    /// Weights of the onset particles by changes that began after a time \[d\], their sum one; `None` before the first is born.
    fn shares(&self, after: Option<f64>) -> Option<Vec<f64>> {
        let weights = self.weights_since(after);
        let total = ln_sum(weights.clone());
        let is_told = !self.particles.is_empty() && total.is_finite();
        is_told.then(|| weights.map(|weight| libm::exp(weight - total)).collect())
    }

    /// Mean of a change alone, as [`Detector::change_since`] has it.
    pub(super) fn size_since(&self, after: Option<f64>) -> Option<f64> {
        let (day, weights) = (self.last_day()?, self.shares(after)?);
        let parts = self.particles.iter().zip(weights);
        let parts: Vec<Normal> = parts
            .map(|(particle, weight)| particle.part(day, weight, particle.bank.change()))
            .collect();
        Some(moments(&parts).0)
    }

    /// Earliest credible onset \[d\] and mean of a change alone, as [`Detector::change_since`] has them.
    pub(super) fn movement_since(&self, after: Option<f64>, from: Option<f64>) -> Option<(f64, f64)> {
        let (day, weights) = (self.last_day()?, self.shares(after)?);
        let particles = || self.particles.iter().zip(&weights);
        let parts: Vec<Normal> = particles()
            .map(|(particle, &weight)| particle.part(day, weight, particle.bank.change()))
            .collect();
        let onsets: Vec<_> = particles()
            .map(|(particle, weight)| (particle.onsets.after(from), *weight))
            .collect();
        let onsets: Vec<_> = onsets.iter().map(|(law, weight)| (law, *weight)).collect();
        let [first] = onset::quantiles(&onsets, [QUANTILES[0]]);
        Some((first, moments(&parts).0))
    }

    /// Probability that a change goes on since before the first period; zero where a later onset is likelier, since the onset's interval
    /// would reach over all the time for it.
    fn standing_share(&self, after: Option<f64>) -> f64 {
        let Some(ramp) = self.standing.as_ref().filter(|_| after.is_none()) else {
            return 0.0;
        };
        let later = ln_sum(self.weights());
        let share = (1.0 + libm::exp(later - ramp.ln_part())).recip();
        if share > 0.5 { share } else { 0.0 }
    }

    /// Posterior of a change over the onset particles; `None` before the first is born.
    pub fn change(&self) -> Option<Change> {
        self.change_since(None, None)
    }

    /// Posterior of a change, its evidence by onsets after a time \[d\] and its onset after another, not later one.
    pub fn change_since(&self, after: Option<f64>, from: Option<f64>) -> Option<Change> {
        let (day, weights) = (self.last_day()?, self.shares(after)?);
        let particles = self.particles.iter().zip(weights);
        let standing = self.standing_share(after);
        let changes: Vec<(&Particle, f64)> = particles
            .map(|(particle, weight)| (particle, (1.0 - standing) * weight))
            .chain(self.standing.iter().map(|ramp| (ramp, standing)))
            .filter(|(_, weight)| *weight > 0.0)
            .collect();
        let mut parts = Vec::with_capacity(changes.len());
        let mut rates = Vec::new();
        let mut onsets = Vec::with_capacity(changes.len());
        let mut ramp_probability = 0.0;
        for (particle, weight) in changes {
            let (mean, sd) = particle.bank.change();
            parts.push(particle.part(day, weight, (mean, sd)));
            onsets.push((particle.onsets.after(from), weight));
            if particle.shape == Shape::Ramp {
                ramp_probability += weight;
                rates.push(Normal { weight, mean, sd });
            }
        }
        let (size, size_sd) = moments(&parts);
        let onsets: Vec<_> = onsets.iter().map(|(law, weight)| (law, *weight)).collect();
        let [first, onset, last] = onset::quantiles(&onsets, [QUANTILES[0], 0.5, QUANTILES[1]]);
        Some(Change {
            onset,
            onset_interval: [first, last],
            size,
            size_sd,
            size_interval: interval(&parts),
            ramp_probability,
            rate_per_year: (ramp_probability > 0.0).then(|| moments(&rates)),
        })
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

fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}
