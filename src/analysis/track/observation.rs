//! Input of tracking from one record.

use crate::identify::Identification;
use crate::signal::modes::Mode;
use crate::signal::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};

/// One natural frequency as input of tracking.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LogMode {
    /// Mode order, from 1.
    pub order: usize,
    /// ln f, f in Hz.
    pub log_frequency: f64,
    /// Standard error of ln f: sd_f / f.
    pub log_sd: f64,
}

impl From<&Mode> for LogMode {
    fn from(mode: &Mode) -> Self {
        Self {
            order: mode.order,
            log_frequency: libm::log(mode.frequency_hz),
            log_sd: mode.sd_hz / mode.frequency_hz,
        }
    }
}

/// Input of tracking from one identified record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Time of the first sample.
    pub start: Timestamp,
    /// Length of the record \[s\].
    pub duration_s: f64,
    /// The measured modes, ascending in order.
    pub modes: Vec<LogMode>,
    /// Temperature readings since the rod's previous record, its own included, ascending in time.
    pub readings: Vec<Reading>,
    /// Root mean square of the samples, SI of their unit; 0 where it is not judged.
    pub rms: f64,
    /// Conflict with the model, in standard deviations.
    pub conflict: f64,
}

impl Observation {
    /// Observation of an identified record; `None` for frequencies measured elsewhere, which have no time.
    pub fn of(identification: &Identification) -> Option<Self> {
        let measurement = identification.measurement.as_ref()?;
        // Another sensor has another place, and may have another unit.
        let is_first = identification.joint.as_ref().is_none_or(|joint| joint.lead == 0);
        Some(Self {
            start: measurement.start,
            duration_s: measurement.duration_s,
            modes: identification.modes.iter().map(LogMode::from).collect(),
            readings: measurement.readings.clone(),
            rms: if is_first { measurement.rms } else { 0.0 },
            conflict: identification.conflict.score,
        })
    }

    /// Observation of a minute with nothing but modes.
    pub fn of_modes(start: Timestamp, modes: Vec<LogMode>) -> Self {
        Self {
            start,
            duration_s: 60.0,
            modes,
            readings: Vec::new(),
            rms: 1e-5,
            conflict: 0.0,
        }
    }

    /// The mode of this order, if it was measured.
    pub fn mode(&self, order: usize) -> Option<&LogMode> {
        self.modes.iter().find(|mode| mode.order == order)
    }
}
