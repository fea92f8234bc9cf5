//! The baseline: mean log-frequencies of the first records and particles of the static parameters.

use super::Observation;
use crate::bayes::RodPrior;
use crate::forward::ForwardModel;
use crate::record::Timestamp;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The mean log-frequency of one mode over the baseline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BaselineMode {
    /// Mode order, from 1.
    pub order: usize,
    /// ybar_n: ln f at the baseline's mean force, f in Hz.
    pub log_frequency: f64,
    /// Its standard error.
    pub log_sd: f64,
    /// Records of the baseline in which the mode was measured.
    pub records: usize,
}

/// What later records are compared with (design 4.5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// Start of the first record.
    pub first: Timestamp,
    /// Start of the last record.
    pub last: Timestamp,
    /// How many records.
    pub records: usize,
    /// The modes, ascending in order.
    pub modes: Vec<BaselineMode>,
    /// By how much the scatter of the frequencies exceeds their standard errors, as a factor on the
    /// standard error, at least one.
    pub overdispersion: f64,
    /// Parameter vectors of equal weight, row-major (particles x quantities), SI: the posterior of the
    /// static parameters and of N_0 given the mean frequencies.
    pub particles: Vec<f64>,
    /// Smallest and largest root mean square of the records' samples, SI of their unit.
    pub rms: (f64, f64),
    /// How far the mean frequencies lie from what the model can produce within its discrepancy, as
    /// the smallest chi over the particles.
    pub misfit: f64,
}

/// Why records give no baseline.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum BaselineFault {
    /// No mode was measured often enough.
    #[error("no mode was measured in at least half of {records} records")]
    NoMode {
        /// How many records.
        records: usize,
    },
    /// No parameters of the rod give such frequencies.
    #[error("no rod the prior allows has these frequencies")]
    NoParticle,
}

impl Baseline {
    /// Learns from records in event order. `discrepancy`: relative, one per mode order from 1.
    ///
    /// # Errors
    /// The records do not agree on any mode, or no rod has such frequencies.
    pub fn learn(
        _observations: &[Observation],
        _prior: &RodPrior,
        _model: &dyn ForwardModel,
        _discrepancy: &[f64],
        _particles: usize,
        _seed: u64,
    ) -> Result<Self, BaselineFault> {
        todo!()
    }
}
