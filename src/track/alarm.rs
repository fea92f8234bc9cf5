//! Alarms: their kinds, and how they are raised, repeated, acknowledged and cleared.

use super::change::Change;
use crate::record::{RodId, Timestamp};
use serde::{Deserialize, Serialize};
use std::fmt;

/// What an alarm is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The force changed: a chart crossed its limit and the modes agree that it is axial.
    Drift,
    /// P(loss > limit | data) exceeds the stated probability.
    Limit,
    /// The frequencies changed in a way no change of axial force explains.
    NotAxial,
    /// The frequencies are not those of a rod the model allows.
    Conflict,
    /// Records are rejected, or implausible for the sensor: unit, clock, channel.
    Sensor,
    /// No record for too long.
    NoData,
    /// Force or temperature lies beyond what was learned.
    OutsideTraining,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 7] = [
        Self::Drift,
        Self::Limit,
        Self::NotAxial,
        Self::Conflict,
        Self::Sensor,
        Self::NoData,
        Self::OutsideTraining,
    ];

    /// The name in JSON and tables.
    pub fn code(self) -> &'static str {
        match self {
            Self::Drift => "drift",
            Self::Limit => "limit",
            Self::NotAxial => "not-axial",
            Self::Conflict => "conflict",
            Self::Sensor => "sensor",
            Self::NoData => "no-data",
            Self::OutsideTraining => "outside-training",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.code())
    }
}

/// A condition of one rod that somebody must know of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// Unique and repeatable: the same condition found again from the same records has the same id.
    pub id: String,
    /// The rod.
    pub rod: RodId,
    /// What it is about.
    pub kind: Kind,
    /// When it was raised, in event time.
    pub raised: Timestamp,
    /// One sentence for people.
    pub message: String,
    /// Onset, size and rate, for a drift.
    pub change: Option<Change>,
    /// When it was acknowledged, if it was.
    pub acknowledged: Option<Timestamp>,
    /// When the condition ended, if it did.
    pub cleared: Option<Timestamp>,
    /// When somebody was last told.
    pub told: Timestamp,
}

/// What happened to an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum What {
    /// It is new.
    Raised,
    /// It still stands and nobody acknowledged it.
    Repeated,
    /// Somebody acknowledged it.
    Acknowledged,
    /// Its condition ended.
    Cleared,
}

/// News about an alarm: one row of the outbox.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmEvent {
    /// What happened.
    pub what: What,
    /// When, in event time.
    pub time: Timestamp,
    /// The alarm as it then was.
    pub alarm: Alarm,
}
