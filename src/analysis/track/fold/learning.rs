//! Records that wait for the baseline, and the baseline learned from them.

use super::early;
use super::loss::Shown;
use super::state::State;
use super::tracker::Tracker;
use crate::signal::record::Timestamp;
use crate::track::baseline::are_sound;
use crate::track::drift::period::{self, Pending};
use crate::track::observation::Observation;
use crate::track::plausibility::{JUMP_S, LONGEST_SILENCE_S};

impl Tracker {
    /// Adds an observation to those that wait for the baseline, and learns it when there are enough and none
    /// can come late any more. Returns the loss that the record shows by itself.
    pub(super) fn wait_for_baseline(&mut self, observation: &Observation) -> Option<Shown> {
        let state = &mut self.state;
        let at = state
            .learning
            .partition_point(|known| known.start <= observation.start);
        // Its readings are kept apart.
        let readings = Vec::new();
        state.learning.insert(
            at,
            Observation {
                modes: observation.modes.clone(),
                readings,
                ..*observation
            },
        );
        let shown = self.watch_early(self.known_at(observation.start));
        let state = &mut self.state;
        let wanted = self.plan.track.baseline_records;
        let Some(last) = wanted.checked_sub(1).and_then(|last| state.learning.get(last)) else {
            return shown;
        };
        let window_s = self.plan.track.reorder_window_s;
        if state
            .latest
            .is_none_or(|latest| latest.seconds_since(last.start) < window_s)
        {
            return shown;
        }
        if self.learn_baseline(wanted) { shown } else { None }
    }

    /// Learns the baseline from the first `wanted` records that wait for it, or from those before a change told of them; returns false if
    /// they make none.
    fn learn_baseline(&mut self, wanted: usize) -> bool {
        let intact = self.intact_records(wanted);
        let state = &mut self.state;
        match self.plan.learn(&state.learning[..intact], state.segment.number) {
            Ok((baseline, left_out)) => {
                state.segment.fault = left_out.map(|fault| fault.to_string());
                state.segment.reference_c = self
                    .plan
                    .track
                    .reference_temperature_c
                    .or_else(|| mean_temperature(state, wanted))
                    .filter(|_| self.plan.compensates());
                self.shift = Some(self.plan.shift(&baseline));
                state.segment.baseline = Some(baseline);
                let learned = std::mem::take(&mut state.learning);
                let mut is_kept = are_sound(&learned[..intact]);
                is_kept.resize(learned.len(), true);
                let provisional = state.early.as_ref().map_or(0, |early| early.baseline.records);
                self.end_early();
                // Records after the change in the last period before it would make that a mixture.
                let until = self.state.segment.baseline.as_ref().map(|baseline| baseline.last);
                let period_s = self.plan.track.period_s;
                let index = |time| period::index_of(time, period_s);
                let is_mixed = |start: Timestamp| {
                    intact < wanted && until.is_some_and(|last| start > last && index(start) == index(last))
                };
                let kept = learned.into_iter().zip(is_kept).filter(|(_, kept)| *kept);
                for (observation, _) in kept.filter(|(one, _)| !is_mixed(one.start)) {
                    if let Some(Ok(relative)) = self.relative(&observation) {
                        self.await_period(Pending::new(&observation, &relative));
                    }
                }
                self.take_over_loss(provisional);
                true
            }
            Err(fault) => {
                state.segment.fault = Some(fault.to_string());
                // The older half makes room; the next attempt comes when there are enough again.
                let time = state.learning.last().map(|last| last.start);
                state.learning.drain(..wanted.div_ceil(2));
                state.before = None;
                self.end_early();
                if let Some(time) = time {
                    self.drop_suspicion(self.known_at(time));
                }
                false
            }
        }
    }

    /// Ends the wait for the baseline if a long silence lies between `latest` and `time`: the rod may have changed in it. Returns true if
    /// the records before it make a baseline; else they are dropped.
    pub(super) fn end_with_silence(&mut self, latest: Timestamp, time: Timestamp) -> bool {
        let (silence_s, waiting) = (time.seconds_since(latest), self.state.learning.len());
        if silence_s <= JUMP_S || waiting == 0 {
            return false;
        }
        if silence_s < LONGEST_SILENCE_S && waiting >= early::RECORDS && self.learn_baseline(waiting) {
            return true;
        }
        self.state.segment.fault = None;
        self.state.learning.clear();
        self.end_early();
        self.drop_suspicion(time);
        false
    }
}

/// Mean temperature of the first `count` observations that wait for the baseline.
pub(super) fn mean_temperature(state: &State, count: usize) -> Option<f64> {
    let mut filters = state.filters.clone();
    let mut readings = state.readings.iter().peekable();
    let (mut sum, mut known) = (0.0, 0);
    for observation in &state.learning[..count] {
        let end = observation.start.plus_seconds(observation.duration_s);
        while let Some(reading) = readings.next_if(|reading| reading.time <= end) {
            filters.push(reading.time.days(), reading.celsius);
        }
        if let Some(filtered) = filters.at(end.days()) {
            sum += filtered[0];
            known += 1;
        }
    }
    (known > 0).then(|| sum / f64::from(known))
}
