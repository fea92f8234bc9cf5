//! The rod's temperature from the thermometer's: first-order lags.

use crate::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};

/// The thermal lags tried \[s\]: a bar of 7 cm follows the air by about two hours.
pub const LAGS_S: [f64; 6] = [0.0, 3600.0, 7200.0, 14_400.0, 28_800.0, 57_600.0];

/// First-order low passes dT_lag/dt = (T - T_lag) / lag, one per lag, run along the readings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Thermal {
    /// The lags \[s\].
    pub lags_s: Vec<f64>,
    /// Time of the last reading.
    pub time: Option<Timestamp>,
    /// The last reading \[degC\].
    pub last_c: f64,
    /// The low-passed temperatures at that time \[degC\].
    pub lagged_c: Vec<f64>,
}

impl Thermal {
    /// Low passes that have seen nothing.
    pub fn new(_lags_s: Vec<f64>) -> Self {
        todo!()
    }

    /// Takes a reading; one that is not later than the last is left out.
    pub fn push(&mut self, _reading: Reading) {
        todo!()
    }

    /// The low-passed temperatures \[degC\], one per lag, at a time not before the last reading; `None` if the last
    /// reading is too old to say.
    pub fn at(&self, _time: Timestamp) -> Option<Vec<f64>> {
        todo!()
    }
}
