//! Onset, size and rate of a change, with credible intervals.

use super::relative::Interval;
use crate::record::Timestamp;
use serde::{Deserialize, Serialize};

/// One period of the series searched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Its beginning.
    pub start: Timestamp,
    /// delta.
    pub delta: f64,
    /// Low-passed temperature less the reference \[K\]; zero without compensation.
    pub warmer_k: f64,
}

/// What is known about a change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Median of the onset's posterior.
    pub onset: Timestamp,
    /// 95 % interval of the onset.
    pub onset_q025: Timestamp,
    /// 95 % interval of the onset.
    pub onset_q975: Timestamp,
    /// Relative change of force up to the last period \[-\].
    pub size: Interval,
    /// Relative change per year while it lasts, if it is a ramp \[1/year\].
    pub rate_per_year: Interval,
    /// Probability that it is a step rather than a ramp.
    pub step_probability: f64,
}

/// Finds the change in a series in time order; `autocorrelation` is that between neighbours. `None` if there
/// are too few periods.
pub fn estimate(_series: &[Sample], _autocorrelation: f64) -> Option<Change> {
    None
}
