//! Germs: the standard normal variables in which the Hermite chaos expands the uncertain quantities.

use crate::rod::beam::Quantity;
use crate::rod::prior::{Prior, RodPrior};
use statrs::distribution::{Continuous, ContinuousCDF, Normal};

/// One uncertain quantity of a rod and its map to a standard normal variable z.
///
/// Truncated normal: `z = (v - mean) / sd`, linear as in the paper, so that z is normal truncated where v
/// reaches zero. Log-normal: `z = ln(v / median) / log_sd`. All that end on both sides: `z = Phi^-1(F(v))`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Germ {
    /// Index of the quantity in `theta`.
    pub index: usize,
    /// Quantity described by the germ.
    pub quantity: Quantity,
    prior: Prior,
}

impl Germ {
    /// The germs of a rod: one per quantity that is not fixed, in the order of `theta`.
    pub fn of(prior: &RodPrior) -> Vec<Self> {
        let quantities = prior.parameterisation().quantities();
        let all = prior.priors().iter().zip(quantities).enumerate();
        all.filter(|(_, (prior, _))| !prior.is_fixed())
            .map(|(index, (&prior, &quantity))| Self {
                index,
                quantity,
                prior,
            })
            .collect()
    }

    /// The germ of a value; not finite where the value is outside the prior's support.
    #[inline]
    pub fn germ(&self, value: f64) -> f64 {
        match self.prior {
            Prior::Fixed { .. } => 0.0,
            Prior::TruncatedNormal { mean, sd } => (value - mean) / sd,
            Prior::LogNormal { median, log_sd } => libm::log(value / median) / log_sd,
            bounded => of_share(bounded.share(value).unwrap_or(f64::NAN)),
        }
    }

    /// The value of a germ.
    pub fn value(&self, z: f64) -> f64 {
        match self.prior {
            Prior::Fixed { value } => value,
            Prior::TruncatedNormal { mean, sd } => mean + sd * z,
            Prior::LogNormal { median, log_sd } => median * libm::exp(log_sd * z),
            bounded => bounded.at_share(Normal::standard().cdf(z)).unwrap_or(f64::NAN),
        }
    }

    /// The derivative of the germ by the value's natural logarithm, where the germ is `z` and the value `value`.
    pub fn by_log_value(&self, z: f64, value: f64) -> f64 {
        match self.prior {
            Prior::Fixed { .. } => 0.0,
            Prior::TruncatedNormal { sd, .. } => value / sd,
            Prior::LogNormal { log_sd, .. } => 1.0 / log_sd,
            Prior::Uniform { low, high } => value / (high - low) / Normal::standard().pdf(z),
            Prior::LogUniform { low, high } => 1.0 / libm::log(high / low) / Normal::standard().pdf(z),
            Prior::Fixity(fixity) => fixity.share_by_log(value) / Normal::standard().pdf(z),
        }
    }

    /// The germ below which the value would not be positive; minus infinity if there is none.
    pub fn lowest(&self) -> f64 {
        match self.prior {
            Prior::TruncatedNormal { mean, sd } => -mean / sd,
            _ => f64::NEG_INFINITY,
        }
    }
}

/// The germ of a share of the distribution; not a number outside 0 to 1.
fn of_share(share: f64) -> f64 {
    if (0.0..=1.0).contains(&share) {
        Normal::standard().inverse_cdf(share)
    } else {
        f64::NAN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn germs_go_there_and_back() {
        let priors = [
            Prior::TruncatedNormal { mean: 8e5, sd: 1.6e5 },
            Prior::LogNormal {
                median: 0.07,
                log_sd: 0.2,
            },
            Prior::Uniform { low: 2.0, high: 5.0 },
            Prior::LogUniform { low: 2.0, high: 50.0 },
            Prior::Fixity(crate::rod::fixity::Fixity {
                low: 0.1,
                high: 0.99,
                ends: 3.0,
                unit_n_m: 4.0,
            }),
        ];
        for prior in priors {
            let germ = Germ {
                index: 0,
                quantity: Quantity::AxialForce,
                prior,
            };
            for z in [-2.5, -0.3, 0.0, 1.7] {
                let value = germ.value(z);
                // The inverse of the normal distribution function is good to about 1e-11.
                assert!((germ.germ(value) - z).abs() < 1e-9);
                let h = 1e-5f64;
                let slope = (germ.germ(value * h.exp()) - germ.germ(value * (-h).exp())) / (2.0 * h);
                assert!((germ.by_log_value(z, value) / slope - 1.0).abs() < 1e-4);
            }
        }
        assert_eq!(Germ::of(&RodPrior::todi()).len(), 6);
    }
}
