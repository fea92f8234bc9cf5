//! Result of one record, and the changes it made.

use crate::signal::record::{Reading, Timestamp};
use crate::track::alarm::{Alarm, AlarmEvent};
use crate::track::drift::period::Period;
use crate::track::observation::Observation;
use crate::track::plausibility::Doubt;
use crate::track::relative::{Interval, Relative};
use serde::{Deserialize, Serialize};

/// Input of tracking from one record.
#[derive(Debug, Clone, PartialEq)]
pub enum Input {
    /// The record gave frequencies.
    Identified(Observation),
    /// The record gave no frequencies.
    Rejected {
        /// Time of the first sample, if known.
        start: Option<Timestamp>,
        /// The reason, for people.
        reason: String,
        /// Temperature readings that came with it.
        readings: Vec<Reading>,
    },
    /// It says nothing of the rod: its temperature readings alone count.
    Readings(Vec<Reading>),
}

/// State of a rod.
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
    /// Tracked, without an active alarm.
    Monitoring,
    /// Tracked, with an active alarm.
    Alarm,
    /// Not tracked.
    NotMonitoring {
        /// Reason.
        reason: String,
    },
}

impl RodState {
    /// Name in JSON and tables.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Learning { .. } => "learning",
            Self::Monitoring => "monitoring",
            Self::Alarm => "alarm",
            Self::NotMonitoring { .. } => "not-monitoring",
        }
    }
}

/// Reason why a record does not count on the charts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SetAside {
    /// Its period was closed already.
    Late,
    /// There is a record of the same time already.
    SameTime,
    /// Its amplitude is far from all seen before.
    Amplitude,
    /// Its time is far ahead.
    Clock,
    /// Its frequencies, or its samples, are another rod's.
    Channel,
    /// None of its modes is in the baseline.
    NoCommonMode,
    /// It differs from the baseline by more than the prepared range.
    OutsideRange,
}

impl SetAside {
    /// Name in JSON and tables.
    pub fn code(self) -> &'static str {
        match self {
            Self::Late => "late",
            Self::SameTime => "same-time",
            Self::Amplitude => "amplitude",
            Self::Clock => "clock",
            Self::Channel => "channel",
            Self::NoCommonMode => "no-common-mode",
            Self::OutsideRange => "outside-range",
        }
    }
}

impl From<&Doubt> for SetAside {
    fn from(doubt: &Doubt) -> Self {
        match doubt {
            Doubt::Amplitude => Self::Amplitude,
            Doubt::Clock => Self::Clock,
            Doubt::Channel(_) | Doubt::Copy(_) => Self::Channel,
        }
    }
}

/// Changes made by one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// State of the rod after it.
    pub state: RodState,
    /// Number of its segment.
    pub segment: u32,
    /// N_t / N_0 and N_t at the measured temperature.
    pub relative: Option<Relative>,
    /// The same at the reference temperature; `None` while unknown: the output is then
    /// uncompensated.
    pub at_reference: Option<AtReference>,
    /// Reason why the record does not count, if it does not.
    pub set_aside: Option<SetAside>,
    /// Periods that it closed.
    pub closed: Vec<Period>,
    /// Alarm events, in order.
    pub events: Vec<AlarmEvent>,
    /// Active alarms after it.
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
