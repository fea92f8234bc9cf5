//! Softening shared by the modes of a record: how far their frequencies move with amplitude.
//!
//! The information of one decay on its own softening `b` depends on its level and damping; all decays of a
//! record together show if the rod softens at all, and about how much. With probability 1/2 a rod at small
//! swings does not soften at all; else the `b` are normal about zero with a standard deviation `tau` that is
//! itself unknown, even in its logarithm from 1e-5 to 1e-3. A record whose clearest modes keep their frequency to 1e-6 so
//! vouches for its weak ones, and one whose clearest mode falls by 0.1 % widens the errors of all. Without
//! the first possibility the errors of clean decays are those of a rod that may always soften by a little
//! less than can be seen: twice their scatter.

use super::fit::Fit;

/// Standard deviation of the softening while a decay is fitted: wider than any plausible value.
pub(super) const FIT_SD: f64 = 1e-3;
/// Smallest and largest `tau`: what a force would not show (a shift of 2e-5 of it), and about the most of a rod in
/// service. With a smaller one, a softening a little less than can be seen would always be allowed.
const TAUS: (f64, f64) = (1e-5, 1e-3);
/// Number of values of `tau`, a factor of 1.5 apart.
const STEPS: usize = 12;
/// Prior probability that nothing softens: `tau` is zero.
const LINEAR: f64 = 0.5;

/// Softening estimated from one decay alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Softening {
    /// Share by which the frequency is lower at the decay's beginning, with `FIT_SD` as its prior standard
    /// deviation.
    pub share: f64,
    /// Variance of `share`.
    pub variance: f64,
    /// Change of the frequency with `share` \[Hz\].
    pub slope_hz: f64,
}

impl Softening {
    /// Value and precision without the prior.
    fn seen(&self) -> (f64, f64) {
        let precision = (1.0 / self.variance - FIT_SD.powi(-2)).max(1e-3 * FIT_SD.powi(-2));
        (self.share / (self.variance * precision), precision)
    }
}

/// Posterior probabilities of `tau`.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale {
    taus: Vec<(f64, f64)>,
}

impl Scale {
    /// Infers the scale from all decays of a record.
    pub fn of<'a>(all: impl Iterator<Item = &'a Softening> + Clone) -> Self {
        let ratio = (TAUS.1 / TAUS.0).powf(1.0 / (STEPS - 1) as f64);
        let any = (0..STEPS).map(|i| (TAUS.0 * ratio.powi(i as i32), (1.0 - LINEAR) / STEPS as f64));
        let mut taus: Vec<(f64, f64)> = std::iter::once((0.0, LINEAR))
            .chain(any)
            .map(|(tau, share)| {
                let log: f64 = all
                    .clone()
                    .map(|one| {
                        let (value, precision) = one.seen();
                        let variance = 1.0 / precision + tau * tau;
                        -0.5 * (variance.ln() + value * value / variance)
                    })
                    .sum();
                (tau, share.ln() + log)
            })
            .collect();
        let most = taus.iter().map(|t| t.1).fold(f64::NEG_INFINITY, f64::max);
        let total: f64 = taus.iter().map(|t| (t.1 - most).exp()).sum();
        for (_, log) in &mut taus {
            *log = (*log - most).exp() / total;
        }
        Self { taus }
    }

    /// Mean and variance of one decay's softening, and the part of the variance shared with the other decays
    /// of its mode, which the prior, not the decay, decides.
    fn posterior(&self, one: &Softening) -> (f64, f64, f64) {
        let (value, precision) = one.seen();
        let (mut mean, mut square, mut shared) = (0.0, 0.0, 0.0);
        for &(tau, weight) in &self.taus {
            // Finite where `tau` is zero.
            let variance = tau * tau / (1.0 + precision * tau * tau);
            let at = value * precision * variance;
            mean += weight * at;
            square += weight * (variance + at * at);
            shared += weight * variance / (1.0 + precision * tau * tau);
        }
        (mean, (square - mean * mean).max(0.0), shared)
    }

    /// Moves the frequency of a fit to zero amplitude, averaged over its softening.
    pub fn settle(&self, fit: &mut Fit) {
        let Some(softening) = fit.softening else { return };
        let (mean, variance, shared) = self.posterior(&softening);
        let r = &mut fit.resonance;
        let shared = shared.min(variance);
        r.frequency_hz += softening.slope_hz * (mean - softening.share);
        r.frequency_sd_hz = r
            .frequency_sd_hz
            .hypot(softening.slope_hz * (variance - shared).sqrt());
        fit.shared_sd_hz = softening.slope_hz.abs() * shared.sqrt();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A decay that measures the softening `share` with standard deviation `sd`, before the prior.
    fn seen(share: f64, sd: f64) -> Softening {
        let precision = sd.powi(-2);
        let variance = 1.0 / (precision + FIT_SD.powi(-2));
        Softening {
            share: share * precision * variance,
            variance,
            slope_hz: 1.0,
        }
    }

    /// Mean and standard deviation for the last decay.
    fn told(all: &[Softening]) -> (f64, f64) {
        let (mean, variance, _) = Scale::of(all.iter()).posterior(&all[all.len() - 1]);
        (mean, variance.sqrt())
    }

    #[test]
    fn clean_decays_take_the_doubt_from_weak_ones_and_a_falling_one_gives_it_to_all() {
        let (weak, clean, falling) = (seen(0.0, 3e-4), seen(0.0, 2e-6), seen(4e-4, 2e-6));
        // The sums in closed form by numpy.
        let near = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 0.05, "{found:e}");
        near(told(&[weak]).1, 8.7e-5);
        near(told(&[clean, clean, clean, weak]).1, 4.23e-7);
        near(told(&[clean, clean, clean]).1, 5.87e-8);
        near(told(&[falling, weak]).1, 2.31e-4);
        let (mean, sd) = told(&[weak, falling]);
        near(mean, 4e-4);
        near(sd, 2e-6);
    }
}
