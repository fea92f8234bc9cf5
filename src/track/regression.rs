//! What temperature explains of delta: recursive Bayesian regression over a grid of lags and
//! autocorrelations, with predictive residuals that are N(0, 1) without a change.

use serde::{Deserialize, Serialize};

/// One period as the regression sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistic<'a> {
    /// Periods since 1970.
    pub period: i64,
    /// delta.
    pub delta: f64,
    /// Standard error of delta from frequency errors.
    pub sd: f64,
    /// Low-passed temperature less the reference \[K\], one per lag; empty without compensation.
    pub warmer_k: &'a [f64],
}

/// What is known beforehand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegressionPrior {
    /// Mean of beta = -kappa E A alpha / N_0 \[1/K\].
    pub slope_mean: f64,
    /// Its standard deviation \[1/K\].
    pub slope_sd: f64,
    /// Standard deviation of the intercept \[-\].
    pub intercept_sd: f64,
    /// How many lags there are; zero: no compensation.
    pub lags: usize,
}

/// What the regression expects of a period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Predictive mean of delta.
    pub mean: f64,
    /// Predictive standard deviation.
    pub sd: f64,
    /// Share of the predictive variance that is uncertainty of the coefficients.
    pub leverage: f64,
    /// What temperature alone explains: beta (T - T_ref), posterior mean.
    pub thermal: f64,
    /// Standard deviation of intercept + thermal part.
    pub thermal_sd: f64,
    /// Posterior mean of the intercept.
    pub intercept: f64,
}

/// The regressions over the grid, each with its weight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Regression {}

impl Regression {
    /// Before any data.
    pub fn new(_prior: &RegressionPrior) -> Self {
        todo!()
    }

    /// Periods learned from.
    pub fn periods(&self) -> usize {
        todo!()
    }

    /// What is expected of a period.
    pub fn predict(&self, _statistic: &Statistic) -> Prediction {
        todo!()
    }

    /// r = Phi^-1(F(delta)): the predictive residual.
    pub fn residual(&self, _statistic: &Statistic) -> f64 {
        todo!()
    }

    /// Learns a period.
    pub fn update(&mut self, _statistic: &Statistic) {
        todo!()
    }

    /// Posterior mean and standard deviation of beta \[1/K\].
    pub fn slope(&self) -> (f64, f64) {
        todo!()
    }

    /// Posterior weight of each lag, summing to one.
    pub fn lag_weights(&self) -> Vec<f64> {
        todo!()
    }

    /// Posterior mean of the AR(1) coefficient between neighbouring periods.
    pub fn autocorrelation(&self) -> f64 {
        todo!()
    }

    /// Posterior mean of the noise standard deviation of one period.
    pub fn noise_sd(&self) -> f64 {
        todo!()
    }
}
