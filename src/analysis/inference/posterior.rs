//! A posterior as a weighted sample of parameter vectors, with the figures to judge and repeat it.

use super::{Adjustment, Method, Withheld};
use crate::numerics::diagnostics;
use crate::numerics::json_number::nan_if_null;
use crate::rod::beam::{Parameterisation, Quantity};
use serde::{Deserialize, Serialize};

/// Reason why a sequence of populations ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stop {
    /// The wanted tolerance was reached.
    TargetReached,
    /// Too few proposals were accepted to go on.
    AcceptanceTooLow,
    /// The allowed number of model evaluations was used up.
    BudgetUsed,
    /// The allowed number of populations was reached.
    MaxGenerations,
    /// The tolerance no longer shrank noticeably.
    Stalled,
}

/// A weighted sample from the posterior of a rod's parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    /// Meaning of the entries of a particle.
    pub parameterisation: Parameterisation,
    /// Parameter vectors, row-major (accepted x quantities), SI.
    pub particles: Vec<f64>,
    /// One weight per particle; they sum to one.
    pub weights: Vec<f64>,
    /// Tolerance: the largest accepted distance, in the unit of the distance.
    pub epsilon: f64,
    /// Number of draws of the generative model.
    pub draws: usize,
    /// Number of accepted draws: the particles.
    pub accepted: usize,
    /// Number of draws for which the forward model had no answer.
    pub invalid: usize,
    /// Effective sample size 1 / sum w^2.
    pub ess: f64,
    /// Seed of the record.
    pub seed: u64,
    /// Method of proposing draws.
    pub method: Method,
    /// Adjustment made to the accepted draws.
    pub adjustment: Adjustment,
    /// Reason why an adjustment asked for was withheld.
    pub withheld: Option<Withheld>,
    /// Reason why a sequence of populations ended; `None` for rejection.
    pub stop: Option<Stop>,
}

/// Mean, spread and quantiles of one quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Marginal {
    /// Mean, SI.
    pub mean: f64,
    /// Standard deviation, SI.
    pub sd: f64,
    /// Coefficient of variation sd / mean.
    #[serde(deserialize_with = "nan_if_null")]
    pub cv: f64,
    /// 2.5 % quantile, SI.
    pub q025: f64,
    /// Median, SI.
    pub q50: f64,
    /// 97.5 % quantile, SI.
    pub q975: f64,
    /// Monte Carlo standard error of the mean, SI.
    #[serde(deserialize_with = "nan_if_null")]
    pub mean_error: f64,
}

impl Marginal {
    /// Ends of the 95 % interval, SI.
    pub fn interval(&self) -> [f64; 2] {
        [self.q025, self.q975]
    }
}

impl Posterior {
    /// Values of one quantity, one per particle; `None` if the section does not have it.
    pub fn values(&self, quantity: Quantity) -> Option<Vec<f64>> {
        Some(self.column(self.parameterisation.index(quantity)?))
    }

    /// Values of the entry at `column` of every particle.
    fn column(&self, column: usize) -> Vec<f64> {
        let width = self.parameterisation.len();
        let values = self.particles.iter().skip(column);
        values.step_by(width).copied().collect()
    }

    /// Posterior mean of one quantity.
    pub fn mean(&self, quantity: Quantity) -> Option<f64> {
        Some(diagnostics::mean(&self.values(quantity)?, &self.weights))
    }

    /// Posterior standard deviation of one quantity.
    pub fn sd(&self, quantity: Quantity) -> Option<f64> {
        Some(diagnostics::sd(&self.values(quantity)?, &self.weights))
    }

    /// Posterior coefficient of variation of one quantity.
    pub fn cv(&self, quantity: Quantity) -> Option<f64> {
        Some(self.sd(quantity)? / self.mean(quantity)?)
    }

    /// Posterior quantile of one quantity, `share` from 0 to 1.
    pub fn quantile(&self, quantity: Quantity, share: f64) -> Option<f64> {
        let values = self.values(quantity)?;
        Some(diagnostics::quantiles(&values, &self.weights, &[share])[0])
    }

    /// Mean, spread and quantiles of one quantity at once.
    pub fn marginal(&self, quantity: Quantity) -> Option<Marginal> {
        Some(self.marginal_at(self.parameterisation.index(quantity)?))
    }

    /// Mean, spread and quantiles of the entry at `column` of a particle.
    pub(crate) fn marginal_at(&self, column: usize) -> Marginal {
        let values = self.column(column);
        let mean = diagnostics::mean(&values, &self.weights);
        let sd = diagnostics::sd(&values, &self.weights);
        let quantiles = diagnostics::quantiles(&values, &self.weights, &[0.025, 0.5, 0.975]);
        Marginal {
            mean,
            sd,
            cv: sd / mean,
            q025: quantiles[0],
            q50: quantiles[1],
            q975: quantiles[2],
            mean_error: diagnostics::mean_error(&values, &self.weights),
        }
    }
}
