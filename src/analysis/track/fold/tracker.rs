//! The fold: one `step` per record, in order of arrival.

use super::explain::explain;
use super::plan::TrackPlan;
use super::provisional::Provisionals;
use super::state::{Opening, State};
use super::verdict::{Input, RodState, Verdict};
use super::{growth, monitor, wording};
use crate::identify::Plan;
use crate::signal::record::{Reading, RodId, Timestamp};
use crate::track::alarm::{AlarmEvent, Board, Cause, Kind, Known, Standing};
use crate::track::drift::others::Others;
use crate::track::drift::watch::Witness;
use crate::track::plausibility::{JUMP_S, Peer};
use crate::track::relative::Shift;
use crate::track::settings::{AlarmSettings, TrackSettings};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Number of records in a row that show a certain loss.
pub(super) const LOSS_RECORDS: usize = 2;

/// Least silence worth an alarm, in usual distances between records.
pub const SILENCE_INTERVALS: f64 = 3.5;

/// One rod's fold: its state and the data derived from it.
#[derive(Clone)]
pub struct Tracker {
    pub(crate) plan: Arc<TrackPlan>,
    pub(crate) state: State,
    /// The baseline, prepared for records.
    pub(crate) shift: Option<Shift>,
    /// The provisional baseline, prepared for records.
    pub(crate) early_shift: Option<Shift>,
    /// Provisional baselines of fewer records than one is made of.
    pub(crate) provisionals: Provisionals,
    /// True if the record at hand may be another rod's, by its frequencies.
    pub(super) shows_another: bool,
    /// Alarm events not yet taken.
    pub(super) news: Vec<AlarmEvent>,
}

impl Tracker {
    /// A tracker of a rod alone, with the usual settings.
    pub fn of(plan: &Plan) -> Self {
        let plan = TrackPlan::of(plan, TrackSettings::default(), AlarmSettings::default());
        Self::new(Arc::new(plan))
    }

    /// A tracker of a rod without records.
    pub fn new(plan: Arc<TrackPlan>) -> Self {
        let state = plan.blank();
        Self {
            plan,
            state,
            shift: None,
            early_shift: None,
            provisionals: Provisionals::default(),
            shows_another: false,
            news: Vec::new(),
        }
    }

    /// Resumes from a state. If the meaning of the numbers has changed since, a new segment begins and the
    /// alarms' conditions end, but for silence; unacknowledged alarms stay active.
    pub fn resume(plan: Arc<TrackPlan>, state: State) -> (Self, Vec<AlarmEvent>) {
        let shift = state
            .segment
            .baseline
            .as_ref()
            .map(|baseline| plan.shift(baseline));
        let mut tracker = Self {
            plan,
            state,
            shift,
            early_shift: None,
            provisionals: Provisionals::default(),
            shows_another: false,
            news: Vec::new(),
        };
        if tracker.state.is_untouched() {
            tracker.state.segment.key = tracker.plan.key().to_owned();
        } else if tracker.state.segment.key != tracker.plan.key() {
            tracker.open_segment(Opening::Changed, false, tracker.state.latest);
        } else {
            monitor::rewatch(&mut tracker);
        }
        let events = tracker.take_news();
        (tracker, events)
    }

    /// Continues a state that was shelved for other settings, now that its own settings are back: the
    /// conditions of the present alarms end, but for silence; unacknowledged alarms stay active.
    pub fn take_up(plan: Arc<TrackPlan>, shelved: State, now: State) -> (Self, Vec<AlarmEvent>) {
        let mut present = now;
        let mut board = Board::new(&present.rod, present.segment.number, &mut present.alarms);
        if let Some(time) = present.latest {
            board.clear_all_but_silence(time);
        }
        let mut events = board.into_events();
        let (tracker, more) = Self::resume(plan, shelved.back_after(&present));
        events.extend(more);
        (tracker, events)
    }

    /// Plan of the tracking.
    pub fn plan(&self) -> &TrackPlan {
        &self.plan
    }

    /// State that must survive a restart.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// This rod as a peer for other rods' records.
    pub fn as_peer(&self) -> Peer {
        self.state.plausibility.as_peer(&self.state.rod)
    }

    /// Begins a new baseline on request. If recent records were older than periods already closed, the clock
    /// was wrong before, and time starts again too. `time`: event time; by default the latest record's.
    pub fn rebaseline(&mut self, time: Option<Timestamp>) -> Vec<AlarmEvent> {
        let is_behind = self.state.plausibility.is_behind(self.plan.alarm.sensor_records);
        self.open_segment(Opening::Requested, is_behind, time.or(self.state.latest));
        self.take_news()
    }

    /// Acknowledges an alarm; returns the events, none if there is no such alarm or it was acknowledged
    /// before.
    pub fn acknowledge(&mut self, id: &str, time: Timestamp) -> Vec<AlarmEvent> {
        self.on_board(|board| board.acknowledge(id, time));
        self.take_news()
    }

    /// Checks the clock without a record: raises the alarm of missing data. The clock repeats unacknowledged
    /// alarms only in such a silence: while records come, they do it at their times, as in a replay.
    pub fn look_at_clock(&mut self, now: Timestamp) -> Vec<AlarmEvent> {
        self.look_for_silence(now);
        self.repeat_in_silence(now)
    }

    /// Checks the clock before the first record, which has been expected since `awaited`: raises the alarm of
    /// missing data if it does not come.
    pub fn await_first(&mut self, now: Timestamp, awaited: Timestamp) -> Vec<AlarmEvent> {
        let from = awaited.plus_seconds(self.plan.alarm.silence_s);
        if now > from {
            let message = format!(
                "never seen: no usable record since the rod was configured, {awaited}; look at its sensor, its sender and the \
                 topic of its channel"
            );
            self.on_board(|board| board.raise_late(Kind::NoData, from, now, message, Known::default()));
        }
        self.repeat_in_silence(now)
    }

    fn repeat_in_silence(&mut self, now: Timestamp) -> Vec<AlarmEvent> {
        let repeat_s = self.plan.alarm.repeat_s;
        self.on_board(|board| {
            if board.holds(Kind::NoData) {
                board.repeat(now, repeat_s, |_| ());
            }
        });
        self.take_news()
    }

    /// Takes temperatures that belong to no record; returns true if any were new. Those not later than the
    /// low passes' last reading, and those dated by a wrong clock, are left out.
    pub fn take_readings(&mut self, readings: &[Reading]) -> bool {
        let known = |state: &State| {
            (
                state.readings.len(),
                state.filters.clone(),
                state.thermometer.clone(),
            )
        };
        let before = known(&self.state);
        self.keep_readings(readings);
        known(&self.state) != before
    }

    /// Takes one record of a rod without others. `peers`: rods whose channels may be mistaken for its own.
    pub fn step(&mut self, input: &Input, peers: &[Peer]) -> Verdict {
        self.step_beside(input, peers, &Others::default())
    }

    /// Takes one record of one of a site's rods; `None` if the site does not have it.
    pub fn step_among(trackers: &mut BTreeMap<RodId, Self>, rod: &RodId, input: &Input) -> Option<Verdict> {
        let (rod, mut tracker) = trackers.remove_entry(rod)?;
        let peers: Vec<Peer> = trackers.values().map(Self::as_peer).collect();
        let others = Others::new(trackers.values().map(Self::state));
        let verdict = tracker.step_beside(input, &peers, &others);
        trackers.insert(rod, tracker);
        Some(verdict)
    }

    /// Takes one record of a rod with the others of its site.
    pub fn step_beside(&mut self, input: &Input, peers: &[Peer], others: &Others) -> Verdict {
        let alone = Others::default();
        let others = if self.plan.alarm.compare_rods {
            others
        } else {
            &alone
        };
        let mut verdict = Verdict {
            state: RodState::Monitoring,
            segment: self.state.segment.number,
            relative: None,
            at_reference: None,
            set_aside: None,
            closed: Vec::new(),
            events: Vec::new(),
            alarms: Vec::new(),
        };
        match input {
            Input::Rejected {
                start,
                reason,
                readings,
            } => {
                self.keep_readings(readings);
                if let Some(time) = start.or(self.state.latest) {
                    self.unusable(reason, self.known_at(time));
                }
            }
            Input::Readings(readings) => self.keep_readings(readings),
            Input::Identified(observation) => self.take(observation, peers, others, &mut verdict),
        }
        if let Some(time) = self.state.latest {
            self.repeat(time);
        }
        verdict.segment = self.state.segment.number;
        verdict.events = self.take_news();
        verdict.alarms = self.state.alarms.clone();
        verdict.state = self.rod_state();
        verdict
    }

    /// State of the rod.
    pub fn rod_state(&self) -> RodState {
        let track = &self.plan.track;
        self.state
            .standing(track.baseline_records, track.learning_periods)
    }

    /// Begins the next segment: the conditions of all alarms end at `time`, but for silence where settings alone changed.
    pub(crate) fn open_segment(&mut self, reason: Opening, anew_in_time: bool, time: Option<Timestamp>) {
        if let Some(time) = time {
            self.on_board(|board| match reason {
                Opening::Changed => board.clear_all_but_silence(time),
                Opening::First | Opening::Requested | Opening::Clock => board.clear_all(time),
            });
        }
        let key = self.plan.key().to_owned();
        self.state = self.state.next_segment(reason, key, anew_in_time);
        self.shift = None;
        self.early_shift = None;
        self.provisionals = Provisionals::default();
    }

    /// Lets `act` write on the board of alarms.
    pub(crate) fn on_board<R>(&mut self, act: impl FnOnce(&mut Board<'_>) -> R) -> R {
        let state = &mut self.state;
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        if let Some(rod) = state.plausibility.alike() {
            board.qualify(format!(
                "the frequencies are those of rod {rod}, too: either this is so, or the channel carries the signal of {rod}; check which sensor is on which channel"
            ));
        }
        let result = act(&mut board);
        self.news.extend(board.into_events());
        result
    }

    fn take_news(&mut self) -> Vec<AlarmEvent> {
        std::mem::take(&mut self.news)
    }

    /// The event time at which something becomes known with a record that claims to be of `time`: the time of
    /// a clock that is behind or far ahead is not used.
    pub(crate) fn known_at(&self, time: Timestamp) -> Timestamp {
        match self.state.latest {
            Some(latest) if !(0.0..=JUMP_S).contains(&time.seconds_since(latest)) => latest,
            _ => time,
        }
    }

    /// Checks a condition, and raises or ends its alarm.
    pub(crate) fn look(
        &mut self,
        cause: Cause,
        holds: Option<bool>,
        time: Timestamp,
        message: impl FnOnce() -> String,
    ) {
        match self.find(cause, holds) {
            Standing::Holds => {
                self.on_board(|board| board.raise(cause.kind(), time, message(), Known::default()))
            }
            Standing::Over => self.on_board(|board| board.clear(cause.kind(), time)),
            Standing::Undecided => {}
        }
    }

    /// Checks a condition.
    pub(crate) fn find(&mut self, cause: Cause, holds: Option<bool>) -> Standing {
        let alarm = &self.plan.alarm;
        let raise = match cause {
            Cause::Unusable | Cause::NoTemperature => alarm.sensor_records,
            Cause::Loss | Cause::Further => LOSS_RECORDS.min(alarm.confirm),
            Cause::Suspicion => 1,
            _ => alarm.confirm,
        };
        let clear = if cause == Cause::Suspicion {
            1
        } else {
            alarm.confirm
        };
        self.state.watches.look(cause, holds, raise, clear)
    }

    /// Handles a record that could not be used.
    pub(crate) fn unusable(&mut self, reason: &str, time: Timestamp) {
        let patience = self.plan.alarm.sensor_records;
        self.look(Cause::Unusable, Some(true), time, || {
            format!("{patience} records in a row could not be used, the last because {reason}")
        });
    }

    /// Raises the alarm of missing data if there has been none for too long by `time`.
    pub(crate) fn look_for_silence(&mut self, time: Timestamp) {
        let Some(latest) = self.state.latest else { return };
        let usual_s = self.state.usual_s().unwrap_or(0.0);
        let from = latest.plus_seconds(self.plan.alarm.silence_s.max(SILENCE_INTERVALS * usual_s));
        if time > from {
            let message = format!(
                "no usable record since {latest}; look at its sensor (power, aim, cable), its sender and the topic of its channel"
            );
            self.on_board(|board| board.raise_late(Kind::NoData, from, time, message, Known::default()));
        }
    }

    /// Repeats unacknowledged alarms; a drift with its present size.
    fn repeat(&mut self, time: Timestamp) {
        let repeat_s = self.plan.alarm.repeat_s;
        let mut alarms = self.state.alarms.iter();
        if !alarms.any(|alarm| alarm.is_due(time, repeat_s)) {
            return;
        }
        let mut drifts = self.state.alarms.iter().filter(|alarm| alarm.kind == Kind::Drift);
        let renewed = if drifts.any(|alarm| alarm.is_due(time, repeat_s)) {
            let mut active = self.state.alarms.iter();
            let told = active.find(|alarm| alarm.kind == Kind::Drift && alarm.cleared.is_none());
            growth::change_since_told(self, told.and_then(|alarm| alarm.change.as_ref())).map(|change| {
                let alternatives = explain(self, &change, None);
                (change, alternatives)
            })
        } else {
            None
        };
        self.on_board(|board| {
            board.repeat(time, repeat_s, |alarm| {
                if let (Kind::Drift, Some((change, alternatives))) = (alarm.kind, &renewed) {
                    let witness = alarm.witness.unwrap_or(Witness::Alone);
                    alarm.message = wording::drift_message(change, witness, alternatives.as_ref());
                    alarm.change = Some(change.clone());
                    alarm.alternatives.clone_from(alternatives);
                }
            });
        });
    }
}
