//! Alarms: kinds, raising, repetition, acknowledgement and clearing.

mod board;
mod cause;
pub mod change;

pub use board::{Board, Known};
pub use cause::{Cause, Run, Standing, Watches};

use super::alarm::change::Change;
use super::alternatives::Explained;
use super::drift::watch::Witness;
use super::plausibility::JUMP_S;
use crate::numerics::random;
use crate::signal::record::{RodId, Timestamp};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Kind of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The force changed: the evidence crossed its limit and the modes agree that it is axial.
    Drift,
    /// Rods of the site moved together: thermometer, weather, or the whole structure.
    Common,
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
    /// Force or temperature lies outside the learned range.
    OutsideTraining,
    /// One record shows a loss beyond the limit: the force fell, or the record is wild. The next one decides.
    Suspected,
}

impl Kind {
    /// Every kind of alarm.
    pub const ALL: [Self; 9] = [
        Self::Drift,
        Self::Common,
        Self::Limit,
        Self::Suspected,
        Self::NotAxial,
        Self::Conflict,
        Self::Sensor,
        Self::NoData,
        Self::OutsideTraining,
    ];

    /// Name in JSON and tables.
    pub fn code(self) -> &'static str {
        match self {
            Self::Drift => "drift",
            Self::Common => "common",
            Self::Limit => "limit",
            Self::Suspected => "suspected",
            Self::NotAxial => "not-axial",
            Self::Conflict => "conflict",
            Self::Sensor => "sensor",
            Self::NoData => "no-data",
            Self::OutsideTraining => "outside-training",
        }
    }

    /// True if the alarm concerns the rod and therefore stays active until acknowledged, even if its
    /// condition ends; alarms about the measurement, or about one record, end with their condition.
    pub fn is_latched(self) -> bool {
        matches!(self, Self::Drift | Self::Common | Self::Limit | Self::NotAxial)
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.code())
    }
}

/// A condition of one rod that a person must be notified of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// Unique and reproducible id: the same condition found again from the same records has the same id.
    pub id: String,
    /// Id of the rod.
    pub rod: RodId,
    /// Kind of the alarm.
    pub kind: Kind,
    /// Time of raising, in event time.
    pub raised: Timestamp,
    /// One sentence for people.
    pub message: String,
    /// Onset, size and rate, for a drift.
    pub change: Option<Change>,
    /// Witness of a drift: the detectors behind it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub witness: Option<Witness>,
    /// The kinds of change that may have moved the modes, for a drift, or where none is axial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alternatives: Option<Explained>,
    /// Time of its acknowledgement, if acknowledged.
    pub acknowledged: Option<Timestamp>,
    /// Time of the end of its condition, if ended.
    pub cleared: Option<Timestamp>,
    /// Time of the last notification.
    pub told: Timestamp,
}

impl Alarm {
    /// A new alarm; rod, kind, segment and time make its id.
    pub fn new(rod: &RodId, kind: Kind, segment: u32, raised: Timestamp, message: String) -> Self {
        let id = random::seed(&[
            b"alarm",
            rod.0.as_bytes(),
            kind.code().as_bytes(),
            &segment.to_le_bytes(),
            &raised.as_nanos().to_le_bytes(),
        ]);
        Self {
            id: format!("{id:016x}"),
            rod: rod.clone(),
            kind,
            raised,
            message,
            change: None,
            witness: None,
            alternatives: None,
            acknowledged: None,
            cleared: None,
            told: raised,
        }
    }

    /// Latest credible onset of its change \[d\].
    pub(crate) fn latest_onset(&self) -> f64 {
        let onset = self.change.as_ref().map(|change| change.onset_q975);
        onset.unwrap_or(self.raised).days()
    }

    /// True if it is not acknowledged and was not repeated for `repeat_s`.
    pub fn is_due(&self, time: Timestamp, repeat_s: f64) -> bool {
        let passed_s = time.seconds_since(self.told);
        self.acknowledged.is_none() && (passed_s >= repeat_s || passed_s < -JUMP_S)
    }

    /// True if it is over: its condition ended and, if it is latched, it is acknowledged.
    pub fn is_over(&self) -> bool {
        self.cleared.is_some() && (self.acknowledged.is_some() || !self.kind.is_latched())
    }
}

/// Kind of a change of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum What {
    /// It is new.
    Raised,
    /// It is still active and not acknowledged.
    Repeated,
    /// It was acknowledged.
    Acknowledged,
    /// Its condition ended.
    Cleared,
}

impl What {
    /// Name in JSON and tables.
    pub fn code(self) -> &'static str {
        match self {
            Self::Raised => "raised",
            Self::Repeated => "repeated",
            Self::Acknowledged => "acknowledged",
            Self::Cleared => "cleared",
        }
    }
}

/// A change of an alarm: one row of the outbox.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmEvent {
    /// Kind of the change.
    pub what: What,
    /// Time of the change, in event time.
    pub time: Timestamp,
    /// The alarm after the change.
    pub alarm: Alarm,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_wrong_clock_told_in_the_future_is_told_again_now() {
        const DAY_NS: i64 = 86_400_000_000_000;
        let alarm = Alarm::new(
            &RodId("r".into()),
            Kind::Drift,
            1,
            Timestamp::from_nanos(50_000 * DAY_NS),
            "fell".into(),
        );
        assert!(alarm.is_due(Timestamp::from_nanos(20_000 * DAY_NS), 7.0 * 86_400.0));
    }
}
