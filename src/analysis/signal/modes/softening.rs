//! Softening shared by the modes of a record: how far their frequencies move with amplitude.
//!
//! The information of one decay on its own softening `b` depends on its level and damping; all decays of a
//! record together show if the rod softens at all, and about how much. With probability 0.6 a rod at small
//! swings does not soften at all; else the `b` are normal about zero with a standard deviation `tau` that is
//! itself unknown, even in its logarithm from 2e-5 to 1e-3, and four fifths of their variance are common to all
//! modes: what lowers one lowers the others. A record whose clearest modes keep their frequency to 1e-6 so
//! vouches for its weak ones, and one whose clearest mode falls by 0.1 % widens the errors of all. Without
//! the first possibility the errors of clean decays are those of a rod that may always soften by a little
//! less than can be seen: twice their scatter.

use super::fit::Fit;
use statrs::function::erf::erf;

/// Standard deviation of the softening while a decay is fitted: wider than any plausible value.
pub(super) const FIT_SD: f64 = 1e-3;
/// Smallest and largest `tau`: what a force would not show (a shift of 4e-5 of it), and about the most of a rod in
/// service. With a smaller one, a softening a little less than can be seen would always be allowed.
const TAUS: (f64, f64) = (2e-5, 1e-3);
/// Number of values of `tau`, a factor of 1.5 apart.
const STEPS: usize = 12;
/// Share of `tau^2` that is common to all modes of a record: supports that slip lower every mode, a rod that stretches raises every one.
const COMMON: f64 = 0.8;
/// Halvings of an interval of up to 1e4 standard deviations: to 1e-5 of one.
const HALVINGS: usize = 30;
/// Prior probability that nothing softens: `tau` is zero.
const LINEAR: f64 = 0.6;

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

    /// Moves the frequency of a fit to zero amplitude, averaged over its softening.
    pub fn settle(&self, fit: &mut Fit) {
        let Some(softening) = fit.softening else { return };
        let r = &mut fit.resonance;
        let doubt = self.doubt(&softening, r.frequency_sd_hz);
        r.frequency_hz += softening.slope_hz * (doubt.mean - softening.share);
        r.frequency_sd_hz = r.frequency_sd_hz.hypot(doubt.own_sd_hz);
        fit.shared_sd_hz = doubt.shared_sd_hz;
    }

    /// One decay's softening, and the errors it adds to a frequency that is known to `sd_hz` without it.
    ///
    /// The posterior is a mixture of a narrow peak (nothing softens) and wide tails. The errors are those of the normal law with the same
    /// 95 % interval: the mixture's own standard deviation follows the tails, however improbable they are.
    fn doubt(&self, softening: &Softening, sd_hz: f64) -> Doubt {
        let parts = self.parts(softening);
        let over = |of: &dyn Fn(&Part) -> f64| parts.iter().map(|part| part.weight * of(part)).sum::<f64>();
        let mean = over(&|part| part.mean);
        let variance = over(&|part| part.variance + (part.mean - mean).powi(2));
        let slope = softening.slope_hz;
        let laws: Vec<Law> = parts
            .iter()
            .map(|part| Law {
                weight: part.weight,
                mean: slope * (part.mean - mean),
                sd: sd_hz.hypot(slope * part.variance.sqrt()),
            })
            .collect();
        let added = (normal_sd(&laws).powi(2) - sd_hz * sd_hz).max(0.0);
        let shared = if variance > 0.0 {
            (over(&|part| part.shared) / variance).min(1.0)
        } else {
            0.0
        };
        Doubt {
            mean,
            own_sd_hz: (added * (1.0 - shared)).sqrt(),
            shared_sd_hz: (added * shared).sqrt(),
        }
    }

    /// Posterior of one decay's softening, for each value of `tau`.
    fn parts(&self, one: &Softening) -> Vec<Part> {
        let (value, precision) = one.seen();
        let part = |level: &Level| {
            let (common, common_variance) = level.common;
            // The decay's share in its own error; finite where `tau` is zero.
            let kept = 1.0 / (1.0 + precision * level.own);
            let (own, common_variance) = (level.own * kept, kept * kept * common_variance);
            Part {
                weight: level.weight,
                mean: kept * (common + precision * level.own * value),
                variance: own + common_variance,
                shared: own * kept + common_variance,
            }
        };
        self.taus.iter().map(part).collect()
    }
}

/// A decay's softening at one value of `tau`.
struct Part {
    weight: f64,
    mean: f64,
    variance: f64,
    /// The part of the variance that the prior, not the decay, decides: the other decays of the mode share it.
    shared: f64,
}

/// A decay's softening and what it adds to the error of its frequency.
struct Doubt {
    mean: f64,
    own_sd_hz: f64,
    /// The part that all decays of the mode share.
    shared_sd_hz: f64,
}

/// One normal law of a mixture.
struct Law {
    weight: f64,
    mean: f64,
    sd: f64,
}

/// Standard deviation of the normal law whose central 95 % interval is as wide as that of a mixture about zero.
fn normal_sd(mixture: &[Law]) -> f64 {
    const INSIDE: f64 = 0.95;
    /// Half width of the interval in standard deviations.
    const HALF_WIDTH: f64 = 1.959_963_984_540_054;
    let inside = |half: f64| {
        let one = |law: &Law| {
            let scale = law.sd * std::f64::consts::SQRT_2;
            0.5 * law.weight * (erf((half - law.mean) / scale) + erf((half + law.mean) / scale))
        };
        mixture.iter().map(one).sum::<f64>()
    };
    let widest = mixture
        .iter()
        .map(|law| law.mean.abs() + 4.0 * law.sd)
        .fold(0.0, f64::max);
    let (mut low, mut high) = (0.0, widest);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if inside(middle) < INSIDE {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high) / HALF_WIDTH
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

    /// Mean softening of the last decay, and the error that is added to 1e-6.
    fn told(all: &[Softening]) -> (f64, f64) {
        let doubt = Scale::of(all.iter()).doubt(&all[all.len() - 1], 1e-6);
        (doubt.mean, doubt.own_sd_hz.hypot(doubt.shared_sd_hz))
    }

    #[test]
    fn clean_decays_take_the_doubt_from_weak_ones_and_a_falling_one_gives_it_to_all() {
        let (weak, clean, falling) = (seen(0.0, 3e-4), seen(0.0, 2e-6), seen(4e-4, 2e-6));
        // By numpy, with covariance matrices of all decays. The least error added is 0.027 of the 1e-6: what is left of the halvings, some
        // 1e-6 of that, comes 1400 times as large.
        let near = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 0.02, "{found:e}");
        near(told(&[weak]).1, 9.617e-5);
        near(told(&[clean, clean, clean, weak]).1, 4.25e-8);
        near(told(&[clean, clean, clean]).1, 2.68e-8);
        let (mean, sd) = told(&[falling, weak]);
        near(mean, 1.812e-4);
        near(sd, 2.134e-4);
        let (mean, sd) = told(&[weak, falling]);
        near(mean, 4e-4);
        near(sd, 2e-6);
        // Three that agree are surer of their sign than each alone: 7.89e-5 and 4.05e-5 with nothing in common.
        let (mean, sd) = told(&[seen(1e-4, 4e-5); 3]);
        near(mean, 8.729e-5);
        near(sd, 3.360e-5);
    }
}
