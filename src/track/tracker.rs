//! The fold: one `step` per record, in the order records come.

use super::relative::{Interval, Relative};
use super::{Alarm, AlarmEvent, Observation, Period, State};
use crate::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};

/// What came of one record, as tracking sees it.
#[derive(Debug, Clone, PartialEq)]
pub enum Input {
    /// It gave frequencies.
    Identified(Observation),
    /// It gave none.
    Rejected {
        /// Time of the first sample, if known.
        start: Option<Timestamp>,
        /// The reason's code.
        code: &'static str,
        /// Temperature readings that came with it.
        readings: Vec<Reading>,
    },
}

/// How a rod stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum RodState {
    /// Baseline or regression are still being learned.
    Learning {
        /// Records of the baseline so far.
        records: usize,
        /// Periods learned so far.
        periods: usize,
    },
    /// Followed, and nothing is wrong.
    Monitoring,
    /// Followed, and an alarm stands that nobody acknowledged or that still holds.
    Alarm,
    /// Not followed.
    NotMonitoring {
        /// Why.
        reason: String,
    },
}

/// What one record changed.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// How the rod stands after it.
    pub state: RodState,
    /// The segment it belongs to.
    pub segment: u32,
    /// N_t / N_0 and N_t at the measured temperature.
    pub relative: Option<Relative>,
    /// The same at the reference temperature; `None` while that cannot be said.
    pub at_reference: Option<AtReference>,
    /// Why the record is not followed, if it is not.
    pub set_aside: Option<&'static str>,
    /// Periods that closed.
    pub closed: Vec<Period>,
    /// What happened to alarms.
    pub events: Vec<AlarmEvent>,
    /// Alarms that stand.
    pub alarms: Vec<Alarm>,
}

/// Force and relative force at the reference temperature.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AtReference {
    /// The reference temperature \[degC\].
    pub temperature_c: f64,
    /// N_t / N_0.
    pub ratio: Interval,
    /// N_t \[N\].
    pub force_n: Interval,
}

/// One rod's fold: what it remembers and what follows from it.
pub struct Tracker {
    state: State,
}

impl Tracker {
    /// What must survive a restart.
    pub fn state(&self) -> &State {
        &self.state
    }
}
