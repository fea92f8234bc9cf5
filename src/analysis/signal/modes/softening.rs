//! Softening shared by the modes of a record: how far their frequencies move with amplitude.
//!
//! The information of one decay on its own softening `b` depends on its level and damping; all decays of a
//! record together show if the rod softens at all, and about how much. With probability 1/2 a rod at small
//! swings does not soften at all; else the `b` are normal about zero with a standard deviation `tau` that is
//! itself unknown, even in its logarithm from 1e-5 to 1e-3, and four fifths of their variance are common to all
//! modes: what lowers one lowers the others. A record whose clearest modes keep their frequency to 1e-6 so
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
/// Share of `tau^2` that is common to all modes of a record: supports that slip lower every mode, a rod that stretches raises every one.
const COMMON: f64 = 0.8;
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
    taus: Vec<Level>,
}

/// One value of `tau` and what the record's decays say of their common softening there.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Level {
    /// Variance of a decay's own part.
    own: f64,
    /// Posterior mean and variance of the common part.
    common: (f64, f64),
    /// Posterior probability; its logarithm up to a constant at first.
    weight: f64,
}

impl Level {
    /// With the prior probability `share`, from values and precisions: `v_i = mu + e_i` with `mu ~ N(0, COMMON tau^2)` and independent
    /// `e_i`, whose covariance, a diagonal and a constant, is inverted in closed form.
    fn of(tau: f64, share: f64, seen: &[(f64, f64)]) -> Self {
        let (own, common) = ((1.0 - COMMON) * tau * tau, COMMON * tau * tau);
        let (mut information, mut cross, mut log) = (0.0, 0.0, 0.0);
        for (value, precision) in seen {
            let variance = 1.0 / precision + own;
            information += 1.0 / variance;
            cross += value / variance;
            log -= 0.5 * (variance.ln() + value * value / variance);
        }
        let factor = 1.0 + common * information;
        let variance = common / factor;
        log += 0.5 * (variance * cross * cross - factor.ln());
        Self {
            own,
            common: (variance * cross, variance),
            weight: share.ln() + log,
        }
    }
}

impl Scale {
    /// Infers the scale from all decays of a record.
    pub fn of<'a>(all: impl Iterator<Item = &'a Softening>) -> Self {
        let ratio = (TAUS.1 / TAUS.0).powf(1.0 / (STEPS - 1) as f64);
        let any = (0..STEPS).map(|i| (TAUS.0 * ratio.powi(i as i32), (1.0 - LINEAR) / STEPS as f64));
        let seen: Vec<(f64, f64)> = all.map(Softening::seen).collect();
        let mut taus: Vec<Level> = std::iter::once((0.0, LINEAR))
            .chain(any)
            .map(|(tau, share)| Level::of(tau, share, &seen))
            .collect();
        let most = taus.iter().map(|t| t.weight).fold(f64::NEG_INFINITY, f64::max);
        let total: f64 = taus.iter().map(|t| (t.weight - most).exp()).sum();
        for level in &mut taus {
            level.weight = (level.weight - most).exp() / total;
        }
        Self { taus }
    }

    /// Mean and variance of one decay's softening, and the part of the variance shared with the other decays
    /// of its mode, which the prior, not the decay, decides.
    fn posterior(&self, one: &Softening) -> (f64, f64, f64) {
        let (value, precision) = one.seen();
        let (mut mean, mut square, mut shared) = (0.0, 0.0, 0.0);
        for level in &self.taus {
            let (common, common_variance) = level.common;
            // The decay's share in its own error; finite where `tau` is zero.
            let kept = 1.0 / (1.0 + precision * level.own);
            let at = kept * (common + precision * level.own * value);
            let (own, common) = (level.own * kept, kept * kept * common_variance);
            mean += level.weight * at;
            square += level.weight * (own + common + at * at);
            shared += level.weight * (own * kept + common);
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
        near(told(&[clean, clean, clean, weak]).1, 3.78e-7);
        near(told(&[clean, clean, clean]).1, 9.46e-8);
        let (mean, sd) = told(&[falling, weak]);
        near(mean, 1.80e-4);
        near(sd, 2.10e-4);
        let (mean, sd) = told(&[weak, falling]);
        near(mean, 4e-4);
        near(sd, 2e-6);
        // Three that agree are surer of their sign than each alone: 7.90e-5 and 4.08e-5 with nothing in common.
        let (mean, sd) = told(&[seen(1e-4, 4e-5); 3]);
        near(mean, 8.72e-5);
        near(sd, 3.35e-5);
    }
}
