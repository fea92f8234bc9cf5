//! The records of one decorrelation period as one statistic, and what the charts made of it.

use super::relative::Misfit;
use crate::record::Timestamp;
use serde::{Deserialize, Serialize};

/// One period of one rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Period {
    /// Periods since 1970.
    pub index: i64,
    /// Its beginning.
    pub start: Timestamp,
    /// Records in it.
    pub records: usize,
    /// delta: combined ln(N_t / N_0).
    pub delta: f64,
    /// Standard error of delta from the frequency errors of its records.
    pub delta_sd: f64,
    /// Temperatures beside delta \[degC\], one per thermal lag; `None` if not known.
    pub lagged_c: Option<Vec<f64>>,
    /// The misfit of the modes, combined.
    pub misfit: Vec<Misfit>,
    /// P(misfit at least this large | the change is axial).
    pub not_axial_p: f64,
    /// What the regression and the charts made of it; `None` while it could not be compensated.
    pub charted: Option<Charted>,
}

/// A period's place on the charts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Charted {
    /// Predictive mean of delta from all periods before.
    pub expected: f64,
    /// Predictive standard deviation.
    pub expected_sd: f64,
    /// r: standard normal without a change.
    pub residual: f64,
    /// Share of the predictive variance that is uncertainty of the regression rather than noise.
    pub leverage: f64,
    /// ln(N_t / N_0) at the reference temperature: delta less what the temperature explains.
    pub at_reference: f64,
    /// Its standard error: measurement, noise and regression.
    pub at_reference_sd: f64,
    /// The low-passed temperature, averaged over the lags' weights \[degC\].
    pub temperature_c: f64,
    /// The charts after this period: [chart][0 up, 1 down]; `None` while learning.
    pub cusum: Option<[[f64; 2]; 2]>,
}
