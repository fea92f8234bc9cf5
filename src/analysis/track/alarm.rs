//! Alarms: their kinds, and how they are raised, repeated, acknowledged and cleared.

pub mod change;

use super::alarm::change::Change;
use super::alternatives::Explained;
use super::drift::watch::Witness;
use super::plausibility::JUMP_S;
use crate::analysis::numerics::random;
use crate::analysis::signal::record::{RodId, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// What an alarm is about.
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
    /// Force or temperature lies beyond what was learned.
    OutsideTraining,
}

impl Kind {
    /// Every kind.
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

    /// The name in JSON and tables.
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

    /// Whether it speaks of the rod and therefore stands until somebody acknowledges it, even if its condition
    /// ends; the others speak of the measurement and go with their condition.
    pub fn is_latched(self) -> bool {
        matches!(self, Self::Drift | Self::Common | Self::Limit | Self::NotAxial)
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
    /// Who says so, for a drift.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub witness: Option<Witness>,
    /// The kinds of change that may have moved the modes, of a drift or where none is axial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alternatives: Option<Explained>,
    /// When it was acknowledged, if it was.
    pub acknowledged: Option<Timestamp>,
    /// When the condition ended, if it did.
    pub cleared: Option<Timestamp>,
    /// When somebody was last told.
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

    /// Whether nobody acknowledged it, and nobody was told for `repeat_s`.
    pub fn is_due(&self, time: Timestamp, repeat_s: f64) -> bool {
        let passed_s = time.seconds_since(self.told);
        self.acknowledged.is_none() && (passed_s >= repeat_s || passed_s < -JUMP_S)
    }

    /// Whether it is over: its condition ended and, if it is latched, somebody knows.
    pub fn is_over(&self) -> bool {
        self.cleared.is_some() && (self.acknowledged.is_some() || !self.kind.is_latched())
    }
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

impl What {
    /// The name in JSON and tables.
    pub fn code(self) -> &'static str {
        match self {
            Self::Raised => "raised",
            Self::Repeated => "repeated",
            Self::Acknowledged => "acknowledged",
            Self::Cleared => "cleared",
        }
    }
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

/// What is looked at again and again. Two of them may be the cause of one kind of alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The loss at the reference temperature exceeds the limit.
    Limit,
    /// A record shows a loss beyond the limit that nothing else explains.
    Loss,
    /// What the charts told is still a change when all periods are looked at together.
    Change,
    /// A period's misfit is not that of an axial change.
    Misfit,
    /// A change that the evidence told is none of the axial force.
    Pattern,
    /// A record's conflict with the model.
    Conflict,
    /// A record cannot be used.
    Unusable,
    /// A record comes without a temperature that can be believed.
    NoTemperature,
    /// A record differs from the baseline by more than the model was prepared for.
    OutsideRange,
    /// The temperature is far from all learned.
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

    /// The kind of alarm it raises.
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

/// How often in a row a condition was found, and found absent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    held: usize,
    absent: usize,
    /// Whether it was found to hold and not to be over since.
    stands: bool,
}

/// What a condition's run says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// It holds.
    Holds,
    /// It is over, and so is every other cause of its kind of alarm.
    Over,
    /// Not enough in a row to say either, or another cause goes on.
    Undecided,
}

/// The runs of all conditions.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Watches(BTreeMap<Cause, Run>);

impl Watches {
    /// Takes one more look at a condition: it holds (`Some(true)`), it is absent (`Some(false)`), or lies between the
    /// level that raises and the level that clears (`None`), which breaks both runs.
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

    /// Notes that a condition holds from now on, whatever it was before.
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

    /// True if a condition was found to hold and not to be over since.
    pub fn stands(&self, cause: Cause) -> bool {
        self.0.get(&cause).is_some_and(|run| run.stands)
    }

    /// Whether a cause of this kind of alarm was found to hold and not to be over since.
    fn any_stands(&self, kind: Kind) -> bool {
        let of_kind = Cause::ALL.iter().filter(|cause| cause.kind() == kind);
        of_kind
            .filter_map(|cause| self.0.get(cause))
            .any(|run| run.stands)
    }
}

/// Knowledge of the change an alarm is about.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Known {
    /// Onset, size and rate.
    pub change: Option<Change>,
    /// Who says so.
    pub witness: Option<Witness>,
    /// The kinds of change that may have moved the modes.
    pub alternatives: Option<Explained>,
}

/// The alarms of one rod that stand, and the news about them since the last look.
pub struct Board<'a> {
    rod: &'a RodId,
    segment: u32,
    alarms: &'a mut Vec<Alarm>,
    events: Vec<AlarmEvent>,
    /// What else explains what is told of the rod.
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

    /// Adds a sentence to what is told of the rod itself from now on: what else explains it.
    pub fn qualify(&mut self, proviso: String) {
        self.proviso = Some(proviso);
    }

    /// Whether an alarm of this kind stands and its condition holds.
    pub fn holds(&self, kind: Kind) -> bool {
        self.alarms
            .iter()
            .any(|alarm| alarm.kind == kind && alarm.cleared.is_none())
    }

    /// Raises an alarm unless one of its kind holds already; one that stands only because nobody acknowledged
    /// it is joined by the new one.
    pub fn raise(&mut self, kind: Kind, time: Timestamp, message: String, known: Known) {
        self.raise_late(kind, time, time, message, known);
    }

    /// Raises an alarm of an earlier time than the one at which it is told.
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

    /// Tells the alarms of which more is known by now again.
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

    /// Acknowledges the alarm with this id; whether there was one to acknowledge.
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

    /// Tells again what nobody acknowledged for `repeat_s`; `renew` may bring an alarm up to date first. What was told far
    /// in the future was told by a wrong clock.
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

    /// The news.
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
