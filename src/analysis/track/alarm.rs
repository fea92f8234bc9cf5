//! Alarms: kinds, raising, repetition, acknowledgement and clearing.

pub mod change;

use super::alarm::change::Change;
use super::alternatives::Explained;
use super::drift::watch::Witness;
use super::plausibility::JUMP_S;
use crate::numerics::random;
use crate::signal::record::{RodId, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
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
}

impl Kind {
    /// Every kind of alarm.
    pub const ALL: [Self; 8] = [
        Self::Drift,
        Self::Common,
        Self::Limit,
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
            Self::NotAxial => "not-axial",
            Self::Conflict => "conflict",
            Self::Sensor => "sensor",
            Self::NoData => "no-data",
            Self::OutsideTraining => "outside-training",
        }
    }

    /// True if the alarm concerns the rod and therefore stays active until acknowledged, even if its
    /// condition ends; alarms about the measurement end with their condition.
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

/// Condition that is checked repeatedly. Two of them may cause one kind of alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The loss at the reference temperature exceeds the limit.
    Limit,
    /// A record shows a loss beyond the limit that nothing else explains.
    Loss,
    /// The change that the charts found is still significant over all periods together.
    Change,
    /// A period's misfit is not that of an axial change.
    Misfit,
    /// A change found by the evidence is not one of the axial force.
    Pattern,
    /// A record's conflict with the model.
    Conflict,
    /// A record cannot be used.
    Unusable,
    /// A record comes without a credible temperature.
    NoTemperature,
    /// A record differs from the baseline by more than the prepared range.
    OutsideRange,
    /// The temperature is far outside the learned range.
    Unlearned,
}

impl Cause {
    /// Every cause.
    const ALL: [Self; 10] = [
        Self::Limit,
        Self::Loss,
        Self::Change,
        Self::Misfit,
        Self::Pattern,
        Self::Conflict,
        Self::Unusable,
        Self::NoTemperature,
        Self::OutsideRange,
        Self::Unlearned,
    ];

    /// Kind of alarm that it raises.
    pub fn kind(self) -> Kind {
        match self {
            Self::Limit | Self::Loss => Kind::Limit,
            Self::Change => Kind::Drift,
            Self::Misfit | Self::Pattern => Kind::NotAxial,
            Self::Conflict => Kind::Conflict,
            Self::Unusable | Self::NoTemperature => Kind::Sensor,
            Self::OutsideRange | Self::Unlearned => Kind::OutsideTraining,
        }
    }
}

/// Counts of how often in a row a condition was found, and found absent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    held: usize,
    absent: usize,
    /// True if it was found to hold and has not ended since.
    stands: bool,
}

/// State of a condition by its run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// It holds.
    Holds,
    /// It has ended, and so has every other cause of its kind of alarm.
    Over,
    /// Too few in a row to decide, or another cause still holds.
    Undecided,
}

/// Runs of all conditions.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Watches(BTreeMap<Cause, Run>);

impl Watches {
    /// Adds one check of a condition: it holds (`Some(true)`), it is absent (`Some(false)`), or it lies
    /// between the raising and the clearing level (`None`), which breaks both runs.
    pub fn look(&mut self, cause: Cause, holds: Option<bool>, raise: usize, clear: usize) -> Finding {
        let run = self.0.entry(cause).or_default();
        (run.held, run.absent) = match holds {
            Some(true) => (run.held.saturating_add(1), 0),
            Some(false) => (0, run.absent.saturating_add(1)),
            None => (0, 0),
        };
        if run.held >= raise {
            run.stands = true;
            Finding::Holds
        } else if run.absent >= clear {
            run.stands = false;
            if self.any_stands(cause.kind()) {
                Finding::Undecided
            } else {
                Finding::Over
            }
        } else {
            Finding::Undecided
        }
    }

    /// Notes that a condition holds from now on, whatever its state was.
    pub fn begin(&mut self, cause: Cause) {
        self.0.insert(
            cause,
            Run {
                stands: true,
                ..Run::default()
            },
        );
    }

    /// Notes that a condition is over.
    pub fn end(&mut self, cause: Cause) {
        self.0.remove(&cause);
    }

    /// True if a condition was found to hold and has not ended since.
    pub fn stands(&self, cause: Cause) -> bool {
        self.0.get(&cause).is_some_and(|run| run.stands)
    }

    /// True if a cause of this kind of alarm was found to hold and has not ended since.
    fn any_stands(&self, kind: Kind) -> bool {
        let of_kind = Cause::ALL.iter().filter(|cause| cause.kind() == kind);
        of_kind
            .filter_map(|cause| self.0.get(cause))
            .any(|run| run.stands)
    }
}

/// Details of the change behind an alarm.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Known {
    /// Onset, size and rate.
    pub change: Option<Change>,
    /// Detectors behind the drift.
    pub witness: Option<Witness>,
    /// The kinds of change that may have moved the modes.
    pub alternatives: Option<Explained>,
}

/// Active alarms of one rod, with their changes since the last check.
pub struct Board<'a> {
    rod: &'a RodId,
    segment: u32,
    alarms: &'a mut Vec<Alarm>,
    events: Vec<AlarmEvent>,
    /// Another explanation of the rod's alarms, as a sentence.
    proviso: Option<String>,
}

impl<'a> Board<'a> {
    /// The board of a rod.
    pub fn new(rod: &'a RodId, segment: u32, alarms: &'a mut Vec<Alarm>) -> Self {
        Self {
            rod,
            segment,
            alarms,
            events: Vec::new(),
            proviso: None,
        }
    }

    /// Adds a sentence with another explanation to the rod's alarms from now on.
    pub fn qualify(&mut self, proviso: String) {
        self.proviso = Some(proviso);
    }

    /// True if an alarm of this kind is active and its condition holds.
    pub fn holds(&self, kind: Kind) -> bool {
        self.alarms
            .iter()
            .any(|alarm| alarm.kind == kind && alarm.cleared.is_none())
    }

    /// Raises an alarm unless one of its kind holds already; one that is active only for lack of
    /// acknowledgement does not prevent the new one.
    pub fn raise(&mut self, kind: Kind, time: Timestamp, message: String, known: Known) {
        self.raise_late(kind, time, time, message, known);
    }

    /// Raises an alarm with a time before its notification.
    pub fn raise_late(
        &mut self,
        kind: Kind,
        time: Timestamp,
        told: Timestamp,
        message: String,
        known: Known,
    ) {
        if self.holds(kind) {
            return;
        }
        let message = match &self.proviso {
            Some(proviso) if kind.is_latched() => format!("{message}; {proviso}"),
            _ => message,
        };
        let alarm = Alarm {
            change: known.change,
            witness: known.witness,
            alternatives: known.alternatives,
            told,
            ..Alarm::new(self.rod, kind, self.segment, time, message)
        };
        self.tell(What::Raised, time, alarm.clone());
        self.alarms.push(alarm);
    }

    /// Repeats alarms with details known since.
    pub fn tell_again(
        &mut self,
        time: Timestamp,
        message: &str,
        known: &Known,
        concerns: impl Fn(&Alarm) -> bool,
    ) {
        let mut renewed = Vec::new();
        for alarm in self.alarms.iter_mut().filter(|alarm| concerns(alarm)) {
            message.clone_into(&mut alarm.message);
            if let Some(proviso) = self.proviso.as_ref().filter(|_| alarm.kind.is_latched()) {
                alarm.message = format!("{message}; {proviso}");
            }
            alarm.change.clone_from(&known.change);
            alarm.witness = known.witness;
            alarm.alternatives.clone_from(&known.alternatives);
            alarm.told = time;
            renewed.push(alarm.clone());
        }
        for alarm in renewed {
            self.tell(What::Repeated, time, alarm);
        }
    }

    /// Ends the condition of the alarms of this kind.
    pub fn clear(&mut self, kind: Kind, time: Timestamp) {
        self.clear_where(|alarm| alarm.kind == kind, time);
    }

    /// Ends the condition of every alarm.
    pub fn clear_all(&mut self, time: Timestamp) {
        self.clear_where(|_| true, time);
    }

    fn clear_where(&mut self, ends: impl Fn(&Alarm) -> bool, time: Timestamp) {
        for index in 0..self.alarms.len() {
            let alarm = &mut self.alarms[index];
            if alarm.cleared.is_none() && ends(alarm) {
                alarm.cleared = Some(time);
                let alarm = alarm.clone();
                self.tell(What::Cleared, time, alarm);
            }
        }
        self.alarms.retain(|alarm| !alarm.is_over());
    }

    /// Acknowledges the alarm with this id; returns true if there was one to acknowledge.
    pub fn acknowledge(&mut self, id: &str, time: Timestamp) -> bool {
        let found = self
            .alarms
            .iter_mut()
            .find(|alarm| alarm.id == id && alarm.acknowledged.is_none());
        let Some(alarm) = found else { return false };
        alarm.acknowledged = Some(time);
        let alarm = alarm.clone();
        self.tell(What::Acknowledged, time, alarm);
        self.alarms.retain(|alarm| !alarm.is_over());
        true
    }

    /// Repeats alarms not acknowledged for `repeat_s`; `renew` may update an alarm first. A notification far
    /// in the future came from a wrong clock.
    pub fn repeat(&mut self, time: Timestamp, repeat_s: f64, mut renew: impl FnMut(&mut Alarm)) {
        for index in 0..self.alarms.len() {
            let alarm = &mut self.alarms[index];
            if alarm.is_due(time, repeat_s) {
                alarm.told = time;
                if alarm.cleared.is_none() {
                    renew(alarm);
                    if let Some(proviso) = self.proviso.as_ref().filter(|_| alarm.kind.is_latched())
                        && !alarm.message.ends_with(proviso)
                    {
                        alarm.message = format!("{}; {proviso}", alarm.message);
                    }
                }
                let alarm = alarm.clone();
                self.tell(What::Repeated, time, alarm);
            }
        }
    }

    /// Changes of alarms, in order.
    pub fn into_events(self) -> Vec<AlarmEvent> {
        self.events
    }

    fn tell(&mut self, what: What, time: Timestamp, alarm: Alarm) {
        self.events.push(AlarmEvent { what, time, alarm });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY_S: f64 = 86_400.0;

    fn day(number: i64) -> Timestamp {
        Timestamp::from_nanos(number * 86_400_000_000_000)
    }

    #[test]
    fn a_latched_alarm_outlives_its_condition_until_acknowledged() {
        let rod = RodId("r".into());
        let mut alarms = Vec::new();
        let mut board = Board::new(&rod, 1, &mut alarms);
        board.raise(Kind::Drift, day(1), "fell".into(), Known::default());
        board.raise(Kind::Drift, day(2), "fell more".into(), Known::default());
        board.raise(Kind::NoData, day(2), "silent".into(), Known::default());
        board.clear(Kind::Drift, day(3));
        board.clear(Kind::NoData, day(3));
        let events = board.into_events();
        let told: Vec<(What, Kind)> = events.iter().map(|e| (e.what, e.alarm.kind)).collect();
        assert_eq!(
            told,
            [
                (What::Raised, Kind::Drift),
                (What::Raised, Kind::NoData),
                (What::Cleared, Kind::Drift),
                (What::Cleared, Kind::NoData),
            ]
        );
        assert_eq!(alarms.len(), 1);
        let id = alarms[0].id.clone();
        assert_eq!(id, events[0].alarm.id);
        let mut board = Board::new(&rod, 1, &mut alarms);
        assert!(board.acknowledge(&id, day(4)) && !board.acknowledge(&id, day(5)));
        assert_eq!(board.into_events().len(), 1);
        assert!(alarms.is_empty());
    }

    #[test]
    fn what_nobody_acknowledged_is_told_again_and_no_more_afterwards() {
        let rod = RodId("r".into());
        let mut alarms = Vec::new();
        let mut board = Board::new(&rod, 1, &mut alarms);
        board.raise(Kind::Limit, day(0), "loss".into(), Known::default());
        for number in 1..=15 {
            board.repeat(day(number), 7.0 * DAY_S, |alarm| alarm.message += "!");
        }
        let events = board.into_events();
        assert_eq!(events.len(), 3);
        assert_eq!(events[2].alarm.message, "loss!!");
        let id = alarms[0].id.clone();
        let mut board = Board::new(&rod, 1, &mut alarms);
        board.acknowledge(&id, day(16));
        board.repeat(day(40), 7.0 * DAY_S, |_| ());
        assert_eq!(board.into_events().len(), 1);
    }

    #[test]
    fn a_condition_needs_a_run_to_raise_and_a_run_to_clear() {
        let mut watches = Watches::default();
        let mut look = |holds| watches.look(Cause::Limit, holds, 2, 3);
        assert_eq!(look(Some(true)), Finding::Undecided);
        assert_eq!(look(None), Finding::Undecided);
        assert_eq!(look(Some(true)), Finding::Undecided);
        assert_eq!(look(Some(true)), Finding::Holds);
        assert_eq!(look(Some(false)), Finding::Undecided);
        assert_eq!(look(Some(false)), Finding::Undecided);
        assert_eq!(look(Some(false)), Finding::Over);
    }

    #[test]
    fn an_alarm_of_two_causes_ends_with_the_last_of_them() {
        let mut watches = Watches::default();
        assert_eq!(watches.look(Cause::Unusable, Some(true), 1, 2), Finding::Holds);
        assert_eq!(
            watches.look(Cause::NoTemperature, Some(true), 1, 2),
            Finding::Holds
        );
        for _ in 0..2 {
            assert_eq!(
                watches.look(Cause::Unusable, Some(false), 1, 2),
                Finding::Undecided
            );
        }
        assert_eq!(
            watches.look(Cause::NoTemperature, Some(false), 1, 2),
            Finding::Undecided
        );
        assert_eq!(
            watches.look(Cause::NoTemperature, Some(false), 1, 2),
            Finding::Over
        );
    }

    #[test]
    fn what_a_wrong_clock_told_in_the_future_is_told_again_now() {
        let alarm = Alarm::new(&RodId("r".into()), Kind::Drift, 1, day(50_000), "fell".into());
        assert!(alarm.is_due(day(20_000), 7.0 * DAY_S));
    }
}
