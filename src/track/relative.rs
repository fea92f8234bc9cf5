//! The relative force of one record: approximate Bayesian computation on the shift from the baseline.

use super::{Baseline, Observation};
use crate::forward::ForwardModel;
use serde::{Deserialize, Serialize};

/// Mean, spread and 95 % interval of one quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// 2.5 % quantile.
    pub q025: f64,
    /// 97.5 % quantile.
    pub q975: f64,
}

/// By how much one mode lies off the best change of axial force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Misfit {
    /// Mode order, from 1.
    pub order: usize,
    /// z_n - s_n delta: what the change of force leaves unexplained in ln f.
    pub residual: f64,
    /// Standard error of z_n from this record's frequency alone.
    pub sd: f64,
}

/// What one record says about N_t / N_0 at its own temperature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Relative {
    /// Posterior of N_t / N_0.
    pub ratio: Interval,
    /// Posterior of N_t \[N\], jointly with the static parameters.
    pub force_n: Interval,
    /// delta: posterior mean of u = ln(N_t / N_0).
    pub log_ratio: f64,
    /// Posterior standard deviation of u.
    pub log_sd: f64,
    /// The part of it that is new with every record: from this record's frequency errors alone.
    pub record_sd: f64,
    /// Q: squared misfit of the modes to a change of axial force, chi-square with `freedom` degrees of freedom.
    pub q: f64,
    /// Measured modes less one.
    pub freedom: usize,
    /// P(chi-square > Q): small if the change is not axial. One if there is a single mode.
    pub not_axial_p: f64,
    /// The misfit, mode by mode.
    pub misfit: Vec<Misfit>,
    /// Effective number of draws.
    pub ess: f64,
    /// Draws of (particle, u).
    pub draws: usize,
}

/// Why a record has no relative force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoRelative {
    /// None of its modes is in the baseline.
    NoCommonMode,
    /// It differs by more than the model was prepared for.
    OutsideRange,
}

/// A baseline ready for records: how each particle's log-frequencies move with u.
#[derive(Debug, Clone)]
pub struct Shift {}

impl Shift {
    /// Prepares; particles the model has no answer for are left out.
    pub fn new(_baseline: &Baseline, _model: &dyn ForwardModel) -> Self {
        todo!()
    }

    /// P(misfit at least this large | the change is axial) for the combined misfit of several records, at a mean
    /// change N_t / N_0 - 1 of `delta`.
    pub fn not_axial_p(&self, _delta: f64, _misfit: &[Misfit]) -> f64 {
        todo!()
    }

    /// The relative force of one record.
    ///
    /// # Errors
    /// Why there is none.
    pub fn relative(&self, _observation: &Observation, _seed: u64) -> Result<Relative, NoRelative> {
        todo!()
    }
}
