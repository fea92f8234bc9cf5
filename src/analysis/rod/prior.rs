//! Prior distributions of a rod's parameters (paper, Table 1) and the prior of a whole rod.

use super::beam::{Parameterisation, Quantity};
use super::fixity::Fixity;
use rand::Rng;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

/// The prior distribution of one positive quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "distribution")]
pub enum Prior {
    /// A value known exactly.
    Fixed {
        /// Constant value of the samples, SI.
        value: f64,
    },
    /// A normal distribution truncated to positive values; `mean` and `sd` are those of the
    /// untruncated normal, as in the paper's Table 1.
    TruncatedNormal {
        /// Mean before truncation, SI.
        mean: f64,
        /// Standard deviation before truncation, SI.
        sd: f64,
    },
    /// A log-normal distribution.
    LogNormal {
        /// Median, SI.
        median: f64,
        /// Standard deviation of the natural logarithm.
        log_sd: f64,
    },
    /// A uniform distribution.
    Uniform {
        /// Lower end, SI.
        low: f64,
        /// Upper end, SI.
        high: f64,
    },
    /// A distribution uniform in the logarithm: every doubling is as likely.
    LogUniform {
        /// Lower end, SI.
        low: f64,
        /// Upper end, SI.
        high: f64,
    },
    /// The stiffness of a support of which the fixity is given.
    Fixity(Fixity),
}

/// A number is a value known exactly, SI.
impl From<f64> for Prior {
    fn from(value: f64) -> Self {
        Self::Fixed { value }
    }
}

impl Prior {
    /// A normal distribution truncated to positive values, with this mean (SI) and coefficient of variation.
    pub fn normal(mean: f64, cv: f64) -> Self {
        Self::TruncatedNormal { mean, sd: cv * mean }
    }

    /// A log-normal distribution; `log_sd` is the standard deviation of the natural logarithm.
    pub fn log_normal(median: f64, log_sd: f64) -> Self {
        Self::LogNormal { median, log_sd }
    }

    /// Every value between two is equally likely.
    pub fn uniform(low: f64, high: f64) -> Self {
        Self::Uniform { low, high }
    }

    /// Every doubling between two values is equally likely.
    pub fn log_uniform(low: f64, high: f64) -> Self {
        Self::LogUniform { low, high }
    }

    /// A support between a hinge (0) and a clamp (1): every fixity k / (k + 3 EI / l) between two, at most
    /// [`Fixity::MOST`], is equally likely.
    pub fn fixity(low: f64, high: f64) -> Self {
        Self::Fixity(Fixity {
            low,
            high,
            ends: 1.0,
            // Set by RodPrior::new once the other priors are known.
            unit_n_m: 1.0,
        })
    }

    /// One draw, SI. Redraws while a truncated normal is not positive, so that the number of random
    /// numbers used may vary.
    pub fn sample<R: Rng + ?Sized>(&self, generator: &mut R) -> f64 {
        match *self {
            Self::Fixed { value } => value,
            Self::TruncatedNormal { mean, sd } => loop {
                let z: f64 = StandardNormal.sample(generator);
                let value = mean + sd * z;
                if value > 0.0 {
                    return value;
                }
            },
            Self::LogNormal { median, log_sd } => {
                let z: f64 = StandardNormal.sample(generator);
                median * libm::exp(log_sd * z)
            }
            Self::Uniform { low, high } => low + (high - low) * generator.random::<f64>(),
            Self::LogUniform { low, high } => {
                low * libm::exp(libm::log(high / low) * generator.random::<f64>())
            }
            Self::Fixity(fixity) => fixity.sample(generator),
        }
    }

    /// Natural logarithm of the density up to a constant; minus infinity outside the support. Zero
    /// for the fixed value itself.
    pub fn log_density(&self, value: f64) -> f64 {
        match *self {
            Self::Fixed { value: fixed } if value == fixed => 0.0,
            Self::TruncatedNormal { mean, sd } if value > 0.0 => -0.5 * ((value - mean) / sd).powi(2),
            Self::LogNormal { median, log_sd } if value > 0.0 => {
                -libm::log(value) - 0.5 * (libm::log(value / median) / log_sd).powi(2)
            }
            Self::Uniform { low, high } if (low..=high).contains(&value) => 0.0,
            Self::LogUniform { low, high } if (low..=high).contains(&value) => -libm::log(value),
            Self::Fixity(fixity) => fixity.log_density(value),
            _ => f64::NEG_INFINITY,
        }
    }

    /// Representative value of the distribution: the mean before truncation, the median of a log-normal, a
    /// log-uniform and a fixity, the middle of a uniform.
    pub fn centre(&self) -> f64 {
        match *self {
            Self::Fixed { value } => value,
            Self::TruncatedNormal { mean, .. } => mean,
            Self::LogNormal { median, .. } => median,
            Self::Uniform { low, high } => 0.5 * (low + high),
            Self::LogUniform { low, high } => (low * high).sqrt(),
            Self::Fixity(fixity) => fixity.at_share(0.5),
        }
    }

    /// Fault that keeps this from being a distribution of a positive quantity; `None` if there is none.
    pub fn fault(&self) -> Option<&'static str> {
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        match *self {
            Self::Fixed { value } if !(value >= 0.0 && finite(&[value])) => {
                Some("a fixed value must be zero or positive")
            }
            Self::TruncatedNormal { mean, sd } if !(finite(&[mean, sd]) && sd > 0.0) => {
                Some("a normal needs a finite mean and a positive standard deviation")
            }
            // Further out fewer than one draw in seven hundred would be positive.
            Self::TruncatedNormal { mean, sd } if mean < -3.0 * sd => {
                Some("the mean lies more than three standard deviations below zero")
            }
            Self::LogNormal { median, log_sd }
                if !(finite(&[median, log_sd]) && median > 0.0 && log_sd > 0.0) =>
            {
                Some("a log-normal needs a positive median and a positive log standard deviation")
            }
            Self::Uniform { low, high } if !(finite(&[low, high]) && low >= 0.0 && high > low) => {
                Some("a uniform needs 0 <= low < high")
            }
            Self::LogUniform { low, high } if !(finite(&[low, high]) && low > 0.0 && high > low) => {
                Some("a log-uniform needs 0 < low < high")
            }
            Self::Fixity(fixity) => fixity.fault(),
            _ => None,
        }
    }

    /// Mean and standard deviation, SI; those before truncation for a truncated normal.
    pub fn mean_and_sd(&self) -> (f64, f64) {
        match *self {
            Self::Fixed { value } => (value, 0.0),
            Self::TruncatedNormal { mean, sd } => (mean, sd),
            Self::LogNormal { median, log_sd } => {
                let mean = median * (0.5 * log_sd * log_sd).exp();
                (mean, mean * (log_sd * log_sd).exp_m1().sqrt())
            }
            Self::Uniform { low, high } => (0.5 * (low + high), (high - low) / 12f64.sqrt()),
            Self::LogUniform { low, high } => {
                let logarithm = libm::log(high / low);
                let mean = (high - low) / logarithm;
                let square = (high - low) * (high + low) / (2.0 * logarithm);
                (mean, (square - mean * mean).max(0.0).sqrt())
            }
            Self::Fixity(fixity) => fixity.mean_and_sd(),
        }
    }

    /// True if the quantity is known exactly.
    pub fn is_fixed(&self) -> bool {
        matches!(self, Self::Fixed { .. })
    }
}

/// The independent priors of all quantities of one rod, in the order of its parameterisation.
#[derive(Debug, Clone, PartialEq)]
pub struct RodPrior {
    parameterisation: Parameterisation,
    priors: Vec<Prior>,
}

impl RodPrior {
    /// One prior per quantity of `parameterisation`, in its order, fixities in place; `None` if the number differs.
    pub fn new(parameterisation: Parameterisation, priors: Vec<Prior>) -> Option<Self> {
        let is_complete = priors.len() == parameterisation.len();
        is_complete.then(|| {
            let own = Self {
                parameterisation,
                priors,
            };
            own.with_fixities_in_place()
        })
    }

    /// The same with the stiffness of fixity one half, 3 EI / l, taken at the centre of the other priors wherever a support is given
    /// by its fixity.
    #[must_use]
    pub fn with_fixities_in_place(mut self) -> Self {
        let beam = self.parameterisation.beam(&self.centre());
        let unit = 3.0 * beam.flexural_rigidity_n_m2 / beam.length_m;
        for prior in &mut self.priors {
            if let Prior::Fixity(fixity) = prior {
                fixity.unit_n_m = unit;
            }
        }
        self
    }

    /// Meaning of the entries.
    pub fn parameterisation(&self) -> &Parameterisation {
        &self.parameterisation
    }

    /// The priors in the order of the parameterisation.
    pub fn priors(&self) -> &[Prior] {
        &self.priors
    }

    /// The prior of one quantity, if this section has it.
    pub fn of(&self, quantity: Quantity) -> Option<&Prior> {
        self.parameterisation.index(quantity).map(|i| &self.priors[i])
    }

    /// Draws one parameter vector into `theta` (one entry per quantity).
    pub fn sample<R: Rng + ?Sized>(&self, generator: &mut R, theta: &mut [f64]) {
        for (prior, value) in self.priors.iter().zip(theta) {
            *value = prior.sample(generator);
        }
    }

    /// The sum of the log densities of all entries of `theta`.
    pub fn log_density(&self, theta: &[f64]) -> f64 {
        self.priors
            .iter()
            .zip(theta)
            .map(|(prior, &value)| prior.log_density(value))
            .sum()
    }

    /// The sum of the log densities of all entries of `theta` in the coordinates of a random walk.
    pub fn log_density_of_walk(&self, theta: &[f64]) -> f64 {
        self.priors
            .iter()
            .zip(theta)
            .map(|(prior, &value)| prior.log_density_of_walk(value))
            .sum()
    }

    /// The vector of centres ([`Prior::centre`]).
    pub fn centre(&self) -> Vec<f64> {
        self.priors.iter().map(Prior::centre).collect()
    }

    /// The rod of the paper (Table 1): square section, 14 m, everything else uncertain.
    pub fn todi() -> Self {
        Self {
            parameterisation: Parameterisation::new(super::beam::Section::Square),
            priors: vec![
                Prior::normal(800e3, 0.20),
                Prior::normal(2.0e11, 0.30),
                Prior::normal(7500.0, 0.10),
                Prior::normal(0.07, 0.10),
                Prior::normal(400e3, 0.30),
                Prior::normal(400e3, 0.30),
                Prior::from(14.0),
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_distribution_of_a_positive_quantity_is_named() {
        let todi = RodPrior::todi();
        assert!(todi.priors().iter().all(|prior| prior.fault().is_none()));
        let normal = |mean, sd| Prior::TruncatedNormal { mean, sd };
        let uniform = |low, high| Prior::Uniform { low, high };
        let log_normal = |median, log_sd| Prior::LogNormal { median, log_sd };
        let fixity = |low, high, ends, unit_n_m| {
            Prior::Fixity(Fixity {
                low,
                high,
                ends,
                unit_n_m,
            })
        };
        for bad in [
            Prior::Fixed { value: -1.0 },
            Prior::Fixed { value: f64::NAN },
            normal(1.0, 0.0),
            normal(f64::INFINITY, 1.0),
            // Would be redrawn for ever.
            normal(-40.0, 1.0),
            log_normal(0.0, 1.0),
            log_normal(1.0, -1.0),
            uniform(2.0, 2.0),
            uniform(-1.0, 2.0),
            uniform(0.0, f64::INFINITY),
            Prior::LogUniform { low: 0.0, high: 1.0 },
            Prior::LogUniform { low: 2.0, high: 2.0 },
            fixity(0.0, 1.0, 1.0, 1.0),
            fixity(0.5, 0.4, 1.0, 1.0),
            fixity(0.0, 0.9, 0.0, 1.0),
            fixity(0.0, 0.9, 1.0, f64::NAN),
        ] {
            assert!(bad.fault().is_some(), "{bad:?}");
        }
        assert!(Prior::Fixed { value: 0.0 }.fault().is_none());
        assert!(normal(0.0, 1.0).fault().is_none());
        assert!(uniform(0.0, 2.0).fault().is_none());
    }

    #[test]
    fn a_fixity_is_in_place_once_the_rod_is_whole() {
        let todi = RodPrior::todi();
        let mut priors = todi.priors().to_vec();
        (priors[4], priors[5]) = (Prior::fixity(0.0, 0.9), Prior::fixity(0.2, 0.9));
        let rod = RodPrior::new(*todi.parameterisation(), priors).unwrap();
        let beam = rod.parameterisation().beam(&rod.centre());
        let unit = 3.0 * beam.flexural_rigidity_n_m2 / 14.0;
        // Fixity 0.45 and 0.55 are the medians.
        for (i, fixity) in [(4, 0.45), (5, 0.55)] {
            let expected = unit * fixity / (1.0 - fixity);
            assert!((rod.priors()[i].centre() / expected - 1.0).abs() < 1e-12);
        }
        assert_eq!(rod.clone().with_fixities_in_place(), rod);
    }

    #[test]
    fn draws_have_the_density_they_claim() {
        // Means by the trapezoidal rule on the density against means of draws.
        let priors = [
            Prior::TruncatedNormal { mean: 0.5, sd: 1.0 },
            Prior::LogNormal {
                median: 1.0,
                log_sd: 0.4,
            },
            Prior::Uniform { low: 1.0, high: 4.0 },
            Prior::LogUniform { low: 0.5, high: 4.0 },
            Prior::Fixity(Fixity {
                low: 0.1,
                high: 0.8,
                ends: 1.0,
                unit_n_m: 1.0,
            }),
        ];
        for prior in priors {
            let (mut mass, mut moment) = (0.0, 0.0);
            for i in 1..100_000 {
                let x = i as f64 * 1e-4;
                let density = libm::exp(prior.log_density(x));
                mass += density;
                moment += density * x;
            }
            let mut generator = crate::numerics::random::stream(9, 0);
            let count = 200_000;
            let mean = (0..count).map(|_| prior.sample(&mut generator)).sum::<f64>() / f64::from(count);
            let claimed = prior.mean_and_sd().0;
            if !matches!(prior, Prior::TruncatedNormal { .. }) {
                assert!((claimed - moment / mass).abs() < 1e-3 * claimed, "{prior:?}");
            }
            // Standard deviations below 0.95: four standard errors of the mean.
            assert!(
                (mean - moment / mass).abs() < 4.0 * 0.95 / f64::from(count).sqrt(),
                "{prior:?}"
            );
        }
    }
}
