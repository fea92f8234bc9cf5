//! One period of one rod as a bank takes it, and the law by which a bank predicted it.

use super::filters::FILTERS_D;
use super::prior::BankPrior;
use super::unread::Covariance;
use serde::{Deserialize, Serialize};

/// Index of the first column in the state, after change and intercept; the filters are the first.
pub(super) const COLUMNS: usize = 2;
/// Share of the noise variance that does not follow the stated error.
const UNSTATED: f64 = 0.3;
/// Largest credible column; larger ones are faults.
const GREATEST: f64 = 1e6;
/// Range to which ratios are limited.
const RATIOS: [f64; 2] = [-1.0, 10.0];
/// Upper limit of stated errors, in typical ones.
const GREATEST_ERROR: f64 = 1e6;

/// Input of a bank for one period of one rod.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen<'a> {
    /// Event time \[d\]; real gaps count.
    pub day: f64,
    /// Start of its first record \[d\].
    pub began: f64,
    /// Mean time of its records \[d\].
    pub measured: f64,
    /// N_t / N_0 - 1.
    pub ratio: f64,
    /// Stated standard error of the ratio.
    pub sd: f64,
    /// Regressors, as many as the prior has columns.
    pub columns: &'a [f64],
    /// Covariance of the errors of the filters among the columns by what the temperature did since its last reading \[K^2\]; `None`
    /// without filters, or where readings are dense.
    pub unread_k2: Option<&'a Covariance>,
}

/// Predictive law of a period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Law {
    /// Mean of the ratio.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Share of the variance that is uncertainty of the coefficients, of the level with them.
    pub leverage: f64,
}

impl Law {
    /// The ratio in standard deviations from the mean.
    pub fn residual(&self, ratio: f64) -> f64 {
        (ratio - self.mean) / self.sd
    }
}

/// A prepared period.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    pub ratio: f64,
    /// Variance of its error, in noise variances.
    pub error: f64,
    /// Regressors of the whole state.
    pub x: Vec<f64>,
    /// Variance of the ratio by what the temperature did since its last reading.
    pub unread: f64,
}

impl Row {
    /// Prepares a period; `None` if a filter cannot take it: not finite, wrong number of columns,
    /// unreasonable regressors.
    pub fn new(prior: &BankPrior, seen: &Seen) -> Option<Self> {
        let is_sane = seen.day.is_finite()
            && seen.began.is_finite()
            && seen.measured.is_finite()
            && seen.ratio.is_finite()
            && seen.sd.is_finite()
            && seen.columns.len() == prior.columns.len()
            && seen.columns.iter().all(|x| x.abs() <= GREATEST)
            && seen.unread_k2.is_none_or(|unread_k2| {
                let sane = |unread_k2: &f64| unread_k2.abs() <= GREATEST;
                seen.columns.len() >= FILTERS_D.len() && unread_k2.iter().flatten().all(sane)
            });
        if !is_sane {
            return None;
        }
        let share = (seen.sd / prior.stated_sd).clamp(0.0, GREATEST_ERROR);
        let mut x = Vec::with_capacity(seen.columns.len() + 4);
        x.extend([0.0, 1.0]);
        x.extend_from_slice(seen.columns);
        x.extend([1.0, 1.0]);
        Some(Self {
            ratio: seen.ratio.clamp(RATIOS[0], RATIOS[1]),
            error: UNSTATED + (1.0 - UNSTATED) * share * share,
            x,
            unread: 0.0,
        })
    }

    /// Sets the onset's regressor.
    pub fn with_onset(&mut self, h: f64) -> &Self {
        self.x[0] = h;
        self
    }
}
