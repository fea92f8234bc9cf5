//! The fold: one `step` per record, in the order records come.

use super::alarm::{Alarm, AlarmEvent, Board, Finding, Kind};
use super::period::{self, Pending, Period};
use super::plan::TrackPlan;
use super::plausibility::{self, Doubt, Peer};
use super::relative::{Interval, NoRelative, Relative, Shift};
use super::state::{Opening, State};
use super::{Observation, monitor};
use crate::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Periods the regression must have learned before force is referred to another temperature.
const FEWEST_PERIODS: usize = 10;

/// Silence worth an alarm is at least this many times the usual distance between records.
const SILENCE_INTERVALS: f64 = 3.0;

/// What came of one record, as tracking sees it.
#[derive(Debug, Clone, PartialEq)]
pub enum Input {
    /// It gave frequencies.
    Identified(Observation),
    /// It gave none.
    Rejected {
        /// Time of the first sample, if known.
        start: Option<Timestamp>,
        /// The reason, for people.
        reason: String,
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
    /// Followed, and an alarm stands.
    Alarm,
    /// Not followed.
    NotMonitoring {
        /// Why.
        reason: String,
    },
}

impl RodState {
    /// The name in JSON and tables.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Learning { .. } => "learning",
            Self::Monitoring => "monitoring",
            Self::Alarm => "alarm",
            Self::NotMonitoring { .. } => "not-monitoring",
        }
    }
}

/// Why a record does not count on the charts, if it does not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SetAside {
    /// Its period was closed already.
    Late,
    /// Its amplitude is far from all seen before.
    Amplitude,
    /// Its time is far ahead.
    Clock,
    /// Its frequencies are another rod's.
    Channel,
    /// None of its modes is in the baseline.
    NoCommonMode,
    /// It differs from the baseline by more than the model was prepared for.
    OutsideRange,
}

impl SetAside {
    /// The name in JSON and tables.
    pub fn code(self) -> &'static str {
        match self {
            Self::Late => "late",
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
            Doubt::Channel(_) => Self::Channel,
        }
    }
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
    /// The same at the reference temperature; `None` while that cannot be said: the output is then
    /// uncompensated.
    pub at_reference: Option<AtReference>,
    /// Why the record does not count, if it does not.
    pub set_aside: Option<SetAside>,
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
    pub(super) plan: Arc<TrackPlan>,
    pub(super) state: State,
    /// The baseline, made ready for records.
    pub(super) shift: Option<Shift>,
}

impl Tracker {
    /// A rod of which nothing is known yet.
    pub fn new(plan: Arc<TrackPlan>) -> Self {
        let state = plan.blank();
        Self {
            plan,
            state,
            shift: None,
        }
    }

    /// Goes on where a state left off. If what gives the numbers their meaning has changed since, a new segment begins
    /// and the alarms' conditions end; what nobody acknowledged goes on standing.
    pub fn resume(plan: Arc<TrackPlan>, state: State) -> (Self, Vec<AlarmEvent>) {
        let shift = state
            .segment
            .baseline
            .as_ref()
            .map(|baseline| plan.shift(baseline));
        let mut tracker = Self { plan, state, shift };
        let mut events = Vec::new();
        if tracker.state.segment.key != tracker.plan.key() {
            let time = tracker.state.latest;
            events = tracker.open_segment(Opening::Changed, time);
        }
        (tracker, events)
    }

    /// What it depends on besides its records.
    pub fn plan(&self) -> &TrackPlan {
        &self.plan
    }

    /// What must survive a restart.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// This rod as other rods' records are compared with.
    pub fn as_peer(&self) -> Peer {
        Peer {
            rod: self.state.rod.clone(),
            latest: self.state.latest,
            modes: self.state.latest_modes.clone(),
        }
    }

    /// Begins a new baseline because somebody asked for it. `time`: event time; by default the latest record's.
    pub fn rebaseline(&mut self, time: Option<Timestamp>) -> Vec<AlarmEvent> {
        let time = time.or(self.state.latest);
        self.open_segment(Opening::Requested, time)
    }

    /// Somebody knows of an alarm; the news, none if there is no such alarm or it was acknowledged before.
    pub fn acknowledge(&mut self, id: &str, time: Timestamp) -> Vec<AlarmEvent> {
        let state = &mut self.state;
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        board.acknowledge(id, time);
        board.into_events()
    }

    /// Looks at the clock without a record: tells when there is no data.
    pub fn look_at_clock(&mut self, now: Timestamp) -> Vec<AlarmEvent> {
        let repeat_s = self.plan.alarm.repeat_s;
        let due = self.silent_from().filter(|from| now > *from);
        let state = &mut self.state;
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        if let Some(from) = due {
            raise_silence(&mut board, state.latest, from);
        }
        board.repeat(now, repeat_s, |_| ());
        board.into_events()
    }

    /// Takes temperatures that came with no record; whether any of them is new. Those not later than what the low
    /// passes have seen, and those a wrong clock dated, are left out.
    pub fn take_readings(&mut self, readings: &[Reading]) -> bool {
        let state = &self.state;
        let (seen, latest) = (state.thermal.time, state.latest);
        let is_plausible = |reading: &&Reading| {
            seen.is_none_or(|seen| seen < reading.time)
                && latest.is_none_or(|latest| !plausibility::is_far_ahead(reading.time, latest))
        };
        let plausible: Vec<Reading> = readings.iter().filter(is_plausible).copied().collect();
        let before = self.state.readings.len();
        self.keep_readings(&plausible);
        self.state.readings.len() > before
    }

    /// Takes one record. `peers`: the other rods of the site.
    pub fn step(&mut self, input: &Input, peers: &[Peer]) -> Verdict {
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
        let time = match input {
            Input::Rejected {
                start,
                reason,
                readings,
            } => {
                self.keep_readings(readings);
                let time = start.or(self.state.latest);
                if let Some(time) = time {
                    verdict.events.extend(self.trouble(reason, time));
                }
                time
            }
            Input::Identified(observation) => {
                self.identified(observation, peers, &mut verdict);
                Some(observation.start)
            }
        };
        if let Some(time) = time.filter(|_| verdict.set_aside != Some(SetAside::Clock)) {
            verdict.events.extend(self.repeat(time));
        }
        verdict.alarms = self.state.alarms.clone();
        verdict.state = self.rod_state();
        verdict
    }

    /// How the rod stands.
    pub fn rod_state(&self) -> RodState {
        let state = &self.state;
        let measurement = |kind: Kind| matches!(kind, Kind::Sensor | Kind::NoData);
        if state.alarms.iter().any(|alarm| !measurement(alarm.kind)) {
            return RodState::Alarm;
        }
        let not_monitoring = |reason: &str| RodState::NotMonitoring {
            reason: reason.to_owned(),
        };
        if let Some(alarm) = state.alarms.first() {
            return not_monitoring(&alarm.message);
        }
        if state.segment.baseline.is_none() {
            if let Some(fault) = &state.segment.fault {
                return not_monitoring(&format!("no baseline: {fault}"));
            }
            return RodState::Learning {
                records: state.learning.len(),
                periods: 0,
            };
        }
        match &state.regression {
            None if state.periods.is_empty() => RodState::Learning {
                records: self.plan.track.baseline_records,
                periods: 0,
            },
            None => not_monitoring(
                "uncompensated: no temperature, so a change of temperature cannot be told from a change of force",
            ),
            Some(regression) if regression.periods() < self.plan.track.learning_periods => {
                RodState::Learning {
                    records: self.plan.track.baseline_records,
                    periods: regression.periods(),
                }
            }
            Some(_) => RodState::Monitoring,
        }
    }

    fn open_segment(&mut self, reason: Opening, time: Option<Timestamp>) -> Vec<AlarmEvent> {
        let next = self
            .state
            .next_segment(reason, self.plan.key().to_owned(), self.plan.lags_s());
        self.state = next;
        self.shift = None;
        let state = &mut self.state;
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        if let Some(time) = time {
            board.clear_all(time);
        }
        board.into_events()
    }

    fn identified(&mut self, observation: &Observation, peers: &[Peer], verdict: &mut Verdict) {
        let time = observation.start;
        let state = &mut self.state;
        let latest = state.latest.map(|time| (time, &state.latest_modes[..]));
        let patience = self.plan.alarm.sensor_records;
        if let Some(doubt) = state.plausibility.doubt(observation, latest, peers, patience) {
            let aside = SetAside::from(&doubt);
            verdict.set_aside = Some(aside);
            if aside != SetAside::Clock {
                self.keep_readings(&observation.readings);
            }
            // A clock that is wrong dates nothing.
            let told = if aside == SetAside::Clock {
                self.state.latest
            } else {
                Some(time)
            };
            let events = self.trouble(&doubt.message(), told.unwrap_or(time));
            verdict.events.extend(events);
            return;
        }
        verdict.events.extend(self.end_of_silence(time));
        self.keep_readings(&observation.readings);
        let state = &mut self.state;
        let is_late = state
            .closed
            .is_some_and(|closed| period::index_of(time, self.plan.track.period_s) <= closed);
        if is_late {
            verdict.set_aside = Some(SetAside::Late);
            if let Some(Ok(relative)) = self.relative(observation) {
                verdict.relative = Some(relative);
            }
            let reason = "it is older than periods already closed: the clock was set back, or recordings come out of order";
            let told = self.state.latest.unwrap_or(time);
            verdict.events.extend(self.trouble(reason, told));
            return;
        }
        state.plausibility.believe(observation);
        let is_newest = state.latest.is_none_or(|latest| latest <= time);
        if is_newest {
            state.latest = Some(time);
        }
        verdict.events.extend(self.look_at_conflict(observation));
        if self.shift.is_none() {
            self.remember_modes(observation, is_newest);
            verdict.events.extend(self.sensor_is_fine(time));
            self.wait_for_baseline(observation);
        } else {
            match self.relative(observation) {
                Some(Ok(relative)) => {
                    verdict.at_reference = self.at_reference(observation, &relative);
                    self.await_period(Pending::new(observation, &relative));
                    verdict.relative = Some(relative);
                    self.remember_modes(observation, is_newest);
                    verdict.events.extend(self.sensor_is_fine(time));
                }
                Some(Err(NoRelative::OutsideRange)) => {
                    verdict.set_aside = Some(SetAside::OutsideRange);
                    verdict.events.extend(self.outside_range(time));
                }
                Some(Err(NoRelative::NoCommonMode)) => {
                    verdict.set_aside = Some(SetAside::NoCommonMode);
                    verdict
                        .events
                        .extend(self.trouble("none of its modes is in the baseline", time));
                }
                None => {}
            }
        }
        let (closed, events) = self.close_periods();
        verdict.closed = closed;
        verdict.events.extend(events);
    }

    fn remember_modes(&mut self, observation: &Observation, is_newest: bool) {
        if is_newest {
            self.state.latest_modes.clone_from(&observation.modes);
        }
    }

    /// Keeps readings, ascending in time, each time once.
    fn keep_readings(&mut self, readings: &[Reading]) {
        let kept = &mut self.state.readings;
        for reading in readings {
            let at = kept.partition_point(|known| known.time < reading.time);
            if kept.get(at).is_none_or(|known| known.time != reading.time) {
                kept.insert(at, *reading);
            }
        }
    }

    /// Puts an observation to those that wait for the baseline, and learns it when there are enough and none of
    /// them can come late any more.
    fn wait_for_baseline(&mut self, observation: &Observation) {
        let state = &mut self.state;
        let at = state
            .learning
            .partition_point(|known| known.start <= observation.start);
        state.learning.insert(at, observation.clone());
        let wanted = self.plan.track.baseline_records;
        let Some(last) = state.learning.get(wanted - 1) else {
            return;
        };
        let window_s = self.plan.track.reorder_window_s;
        if state
            .latest
            .is_none_or(|latest| latest.seconds_since(last.start) < window_s)
        {
            return;
        }
        match self.plan.learn(&state.learning[..wanted], state.segment.number) {
            Ok(baseline) => {
                state.segment.fault = None;
                state.segment.reference_c = self
                    .plan
                    .track
                    .reference_temperature_c
                    .or_else(|| mean_temperature(state, wanted))
                    .filter(|_| self.plan.compensates());
                self.shift = Some(self.plan.shift(&baseline));
                state.segment.baseline = Some(baseline);
                for observation in std::mem::take(&mut state.learning) {
                    if let Some(Ok(relative)) = self.relative(&observation) {
                        self.await_period(Pending::new(&observation, &relative));
                    }
                }
            }
            Err(fault) => {
                state.segment.fault = Some(fault.to_string());
                // The older half makes room; the next attempt comes when there are enough again.
                state.learning.drain(..wanted.div_ceil(2));
            }
        }
    }

    fn await_period(&mut self, pending: Pending) {
        let open = &mut self.state.open;
        let at = open.partition_point(|known| known.start <= pending.start);
        open.insert(at, pending);
    }

    fn relative(&self, observation: &Observation) -> Option<Result<Relative, NoRelative>> {
        let segment = self.state.segment.number;
        let seed = self.plan.seed_of(b"relative", segment, Some(observation.start));
        Some(self.shift.as_ref()?.relative(observation, seed))
    }

    /// Closes every period no record can come into any more.
    fn close_periods(&mut self) -> (Vec<Period>, Vec<AlarmEvent>) {
        let (mut closed, mut events) = (Vec::new(), Vec::new());
        let period_s = self.plan.track.period_s;
        let Some(latest) = self.state.latest else {
            return (closed, events);
        };
        while let Some(first) = self.state.open.first() {
            let index = period::index_of(first.start, period_s);
            let end = period::start_of(index + 1, period_s);
            if latest.seconds_since(end) < self.plan.track.reorder_window_s {
                break;
            }
            let count = self
                .state
                .open
                .partition_point(|pending| pending.start < end)
                .max(1);
            let records: Vec<Pending> = self.state.open.drain(..count).collect();
            let shift = self.shift.as_ref();
            let state = &mut self.state;
            let period = period::combine(
                index,
                period_s,
                &records,
                &mut state.thermal,
                &mut state.readings,
                |delta, misfit| shift.map_or(1.0, |shift| shift.not_axial_p(delta, misfit)),
            );
            state.closed = Some(index);
            let (period, news) = monitor::close(self, period, latest);
            self.state.periods.push(period.clone());
            closed.push(period);
            events.extend(news);
        }
        (closed, events)
    }

    /// Force and relative force at the reference temperature, by what the closed periods taught.
    fn at_reference(&self, observation: &Observation, relative: &Relative) -> Option<AtReference> {
        let state = &self.state;
        let regression = state
            .regression
            .as_ref()
            .filter(|regression| regression.periods() >= FEWEST_PERIODS)?;
        let reference_c = state.segment.reference_c?;
        let end = observation.start.plus_seconds(observation.duration_s);
        let mut thermal = state.thermal.clone();
        for reading in state.readings.iter().take_while(|reading| reading.time <= end) {
            thermal.push(*reading);
        }
        let warmer_k: Vec<f64> = thermal
            .at(end)?
            .iter()
            .map(|celsius| celsius - reference_c)
            .collect();
        let ratio = &relative.ratio;
        let delta = ratio.mean - 1.0;
        let index = period::index_of(observation.start, self.plan.track.period_s);
        let statistic = period::statistic(index, delta, relative.record_sd * ratio.mean, &warmer_k);
        let prediction = regression.predict(&statistic);
        // N at the reference temperature is N_t less what temperature explains of N_t / N_0, times N_0.
        let factor = libm::exp(-prediction.thermal);
        let force = &relative.force_n;
        let further = prediction.thermal_sd;
        Some(AtReference {
            temperature_c: reference_c,
            ratio: moved(
                ratio,
                1.0,
                delta - period::at_reference(delta, &prediction),
                further * ratio.mean,
            ),
            force_n: moved(force, factor, 0.0, further * force.mean),
        })
    }

    /// A record that could not be used.
    fn trouble(&mut self, reason: &str, time: Timestamp) -> Vec<AlarmEvent> {
        let alarm = &self.plan.alarm;
        let state = &mut self.state;
        let found = state
            .watches
            .look(Kind::Sensor, Some(true), alarm.sensor_records, alarm.confirm);
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        if found == Finding::Holds {
            let message = format!(
                "{} records in a row could not be used, the last because {reason}",
                alarm.sensor_records
            );
            board.raise(Kind::Sensor, time, message, None);
        }
        board.into_events()
    }

    fn sensor_is_fine(&mut self, time: Timestamp) -> Vec<AlarmEvent> {
        let alarm = &self.plan.alarm;
        let state = &mut self.state;
        let found = state
            .watches
            .look(Kind::Sensor, Some(false), alarm.sensor_records, alarm.confirm);
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        if found == Finding::Over {
            board.clear(Kind::Sensor, time);
        }
        board.into_events()
    }

    fn outside_range(&mut self, time: Timestamp) -> Vec<AlarmEvent> {
        let confirm = self.plan.alarm.confirm;
        let state = &mut self.state;
        let found = state
            .watches
            .look(Kind::OutsideTraining, Some(true), confirm, confirm);
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        if found == Finding::Holds {
            let message = "the frequencies differ from the baseline's by more than the model was prepared for: the rod, its supports or \
                 the channel changed";
            board.raise(Kind::OutsideTraining, time, message.to_owned(), None);
        }
        board.into_events()
    }

    fn look_at_conflict(&mut self, observation: &Observation) -> Vec<AlarmEvent> {
        let alarm = &self.plan.alarm;
        let score = observation.conflict;
        let holds = if score >= alarm.conflict_sd {
            Some(true)
        } else if score < 0.5 * alarm.conflict_sd {
            Some(false)
        } else {
            None
        };
        let state = &mut self.state;
        let found = state
            .watches
            .look(Kind::Conflict, holds, alarm.confirm, alarm.confirm);
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        match found {
            Finding::Holds => {
                let message = format!(
                    "no rod the model allows has these frequencies: they lie {score:.1} standard deviations off; the absolute \
                     force may be wrong by more than its interval says"
                );
                board.raise(Kind::Conflict, observation.start, message, None);
            }
            Finding::Over => board.clear(Kind::Conflict, observation.start),
            Finding::Undecided => {}
        }
        board.into_events()
    }

    /// From when on the rod counts as silent.
    fn silent_from(&self) -> Option<Timestamp> {
        let state = &self.state;
        let usual_s = match &state.segment.baseline {
            Some(baseline) => {
                baseline.last.seconds_since(baseline.first) / (baseline.records.max(2) - 1) as f64
            }
            None => {
                let (first, last) = (state.learning.first()?, state.learning.last()?);
                last.start.seconds_since(first.start) / (state.learning.len().max(2) - 1) as f64
            }
        };
        let patience_s = self.plan.alarm.silence_s.max(SILENCE_INTERVALS * usual_s);
        Some(state.latest?.plus_seconds(patience_s))
    }

    /// A record came: if it ends a silence, tells that there was one.
    fn end_of_silence(&mut self, time: Timestamp) -> Vec<AlarmEvent> {
        let due = self.silent_from().filter(|from| time > *from);
        let state = &mut self.state;
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        if let Some(from) = due {
            raise_silence(&mut board, state.latest, from);
        }
        board.clear(Kind::NoData, time);
        board.into_events()
    }

    fn repeat(&mut self, time: Timestamp) -> Vec<AlarmEvent> {
        let repeat_s = self.plan.alarm.repeat_s;
        let is_due = |alarm: &Alarm| {
            alarm.kind == Kind::Drift
                && alarm.acknowledged.is_none()
                && time.seconds_since(alarm.told) >= repeat_s
        };
        let renewed = if self.state.alarms.iter().any(is_due) {
            monitor::change_now(self)
        } else {
            None
        };
        let state = &mut self.state;
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        board.repeat(time, repeat_s, |alarm| {
            if alarm.kind == Kind::Drift
                && let Some(change) = &renewed
            {
                alarm.message = monitor::drift_message(change);
                alarm.change = Some(change.clone());
            }
        });
        board.into_events()
    }
}

fn raise_silence(board: &mut Board<'_>, latest: Option<Timestamp>, from: Timestamp) {
    let Some(latest) = latest else { return };
    let message = format!("no usable record since {latest}");
    board.raise(Kind::NoData, from, message, None);
}

/// The mean temperature beside the first `count` observations that wait for the baseline, at the shortest lag.
fn mean_temperature(state: &State, count: usize) -> Option<f64> {
    let mut thermal = state.thermal.clone();
    let mut readings = state.readings.iter().peekable();
    let (mut sum, mut known) = (0.0, 0);
    for observation in &state.learning[..count] {
        let end = observation.start.plus_seconds(observation.duration_s);
        while let Some(reading) = readings.next_if(|reading| reading.time <= end) {
            thermal.push(*reading);
        }
        if let Some(&celsius) = thermal.at(end).as_ref().and_then(|lagged| lagged.first()) {
            sum += celsius;
            known += 1;
        }
    }
    (known > 0).then(|| sum / f64::from(known))
}

/// `interval` times `factor` less `shift`, with a further independent standard deviation.
fn moved(interval: &Interval, factor: f64, shift: f64, further_sd: f64) -> Interval {
    let mean = interval.mean * factor - shift;
    let sd = (interval.sd * factor).hypot(further_sd);
    let widening = if interval.sd > 0.0 { sd / interval.sd } else { 1.0 };
    Interval {
        mean,
        sd,
        q025: mean - widening * (interval.mean - interval.q025),
        q975: mean + widening * (interval.q975 - interval.mean),
    }
}
