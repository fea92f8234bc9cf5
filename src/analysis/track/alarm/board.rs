//! The board of one rod's active alarms: raises, clears, acknowledges and repeats them.

use super::change::Change;
use super::{Alarm, AlarmEvent, Kind, What};
use crate::signal::record::{RodId, Timestamp};
use crate::track::alternatives::Explained;
use crate::track::drift::watch::Witness;

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

    /// Reports an alarm that has become another: once more if it is not acknowledged, else as a new one in its place.
    pub fn tell_anew(&mut self, kind: Kind, time: Timestamp, message: String, known: Known) {
        let is_active = |alarm: &Alarm| alarm.kind == kind && alarm.cleared.is_none();
        let is_open = |alarm: &Alarm| is_active(alarm) && alarm.acknowledged.is_none();
        if self.alarms.iter().any(is_open) {
            self.tell_again(time, &message, &known, is_open);
        } else {
            self.clear_where(is_active, time);
            self.raise(kind, time, message, known);
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

    /// Ends the condition of every alarm but of silence, which no settings end.
    pub fn clear_all_but_silence(&mut self, time: Timestamp) {
        self.clear_where(|alarm| alarm.kind != Kind::NoData, time);
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
                        && !alarm.message.contains(proviso)
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
    fn what_became_another_is_told_once_more_or_in_its_place() {
        let rod = RodId("r".into());
        let mut alarms = Vec::new();
        let mut board = Board::new(&rod, 1, &mut alarms);
        board.raise(Kind::Drift, day(0), "fell".into(), Known::default());
        board.tell_anew(Kind::Drift, day(1), "fell more".into(), Known::default());
        let first = board.into_events()[0].alarm.id.clone();
        assert_eq!((alarms.len(), &alarms[0].id), (1, &first));
        let mut board = Board::new(&rod, 1, &mut alarms);
        assert!(board.acknowledge(&first, day(2)));
        board.tell_anew(Kind::Drift, day(3), "fell still more".into(), Known::default());
        let told: Vec<(What, bool)> = board
            .into_events()
            .iter()
            .map(|event| (event.what, event.alarm.id == first))
            .collect();
        assert_eq!(
            told,
            [
                (What::Acknowledged, true),
                (What::Cleared, true),
                (What::Raised, false)
            ]
        );
        assert_eq!((alarms.len(), alarms[0].acknowledged), (1, None));
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
}
