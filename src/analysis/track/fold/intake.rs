//! Intake of one identified record: doubted, set aside, kept for the baseline, or added to its period.

use super::loss::{Fall, Loss, Shown};
use super::state::Opening;
use super::tracker::Tracker;
use super::verdict::{SetAside, Verdict};
use super::{monitor, reference};
use crate::signal::record::{Reading, Timestamp};
use crate::track::alarm::Cause;
use crate::track::drift::others::Others;
use crate::track::drift::period::{self, Pending, Period};
use crate::track::drift::watch::DriftWatch;
use crate::track::observation::Observation;
use crate::track::plausibility::{self, JUMP_S, Peer};
use crate::track::relative::{NoRelative, Relative};

/// Largest age of a temperature at the end of a record \[s\].
const STALE_S: f64 = 3.0 * 3600.0;

impl Tracker {
    /// Takes an identified record.
    pub(crate) fn take(
        &mut self,
        observation: &Observation,
        peers: &[Peer],
        others: &Others,
        verdict: &mut Verdict,
    ) {
        let patience = self.plan.alarm.sensor_records;
        self.shows_another = plausibility::shows_another(observation, peers);
        let state = &mut self.state;
        let (rod, latest) = (&state.rod, state.latest);
        let is_repeated = state.plausibility.is_doubted_at(observation.start);
        let doubt = state
            .plausibility
            .doubt(observation, rod, latest, peers, patience);
        if let Some(since) = state.plausibility.take_wrong_since() {
            // They were believed before the other channel showed the exchange, too.
            state.open.retain(|pending| pending.start < since);
            state.learning.retain(|known| known.start < since);
        }
        if let Some(doubt) = doubt {
            let aside = SetAside::from(&doubt);
            if aside == SetAside::Clock {
                // A loss shows whatever the clock says, and may have come with the silence.
                if !is_repeated && !self.state.plausibility.is_exchanged() {
                    self.look_at_doubted(observation, others);
                }
            } else {
                self.keep_readings(&observation.readings);
            }
            self.set_aside(aside, &doubt.message(), observation, verdict);
            return;
        }
        if self.is_late(observation.start) {
            if self.state.plausibility.is_back(observation.start, patience) {
                self.open_segment(Opening::Clock, true, Some(observation.start));
            } else {
                self.keep_readings(&observation.readings);
                verdict.relative = self.relative(observation).and_then(Result::ok);
                let reason = "it is older than periods already closed: the clock was set back, or recordings come out of order";
                self.set_aside(SetAside::Late, reason, observation, verdict);
                return;
            }
        }
        if self.state.has_record_of(observation.start) {
            let reason =
                "there is another of the same time: the clock stands still, or the recording came twice";
            self.set_aside(SetAside::SameTime, reason, observation, verdict);
            return;
        }
        if self.believe(observation) {
            verdict.closed = self.close_periods(others);
        }
        self.keep_readings(&observation.readings);
        self.look_at_conflict(observation);
        let shown = if self.shift.is_none() {
            self.usable(observation);
            self.wait_for_baseline(observation)
        } else {
            self.take_relative(observation, others, verdict)
        };
        verdict.closed.extend(self.close_periods(others));
        let time = self.known_at(observation.start);
        monitor::tell_ahead(self, others, time);
        self.look_at_suspicion(shown, time);
    }

    fn set_aside(&mut self, aside: SetAside, reason: &str, observation: &Observation, verdict: &mut Verdict) {
        verdict.set_aside = Some(aside);
        let time = self.known_at(observation.start);
        self.unusable(reason, time);
    }

    fn is_late(&self, start: Timestamp) -> bool {
        let index = period::index_of(start, self.plan.track.period_s);
        self.state.closed.is_some_and(|closed| index <= closed)
    }

    /// Accepts the record's time: silence ends, and the record becomes the latest if it is. Returns true if a baseline ended with the
    /// silence.
    fn believe(&mut self, observation: &Observation) -> bool {
        let time = observation.start;
        self.state.plausibility.believe(observation);
        self.state.doubted = None;
        let latest = self.state.latest;
        if latest.is_some_and(|latest| time < latest) {
            return false;
        }
        // It is not yet known if a second record after a week is late.
        if self.state.usual_s().is_some() {
            self.look_for_silence(time);
        }
        self.on_board(|board| board.clear(crate::track::alarm::Kind::NoData, time));
        let is_learned = latest.is_some_and(|latest| self.end_with_silence(latest, time));
        self.state.latest = Some(time);
        is_learned
    }

    /// Accepts the record's frequencies as those of the rod.
    fn usable(&mut self, observation: &Observation) {
        let time = self.known_at(observation.start);
        self.look(Cause::Unusable, Some(false), time, String::new);
        self.look(Cause::OutsideRange, Some(false), time, String::new);
        let is_compensated = self.state.watch.get().is_some_and(DriftWatch::is_compensated);
        if is_compensated && self.plan.compensates() {
            let end = observation.start.plus_seconds(observation.duration_s);
            let is_known = reference::filters_until(&self.state, end)
                .at(end.days())
                .is_some();
            let reason = self.state.thermometer.message();
            let patience = self.plan.alarm.sensor_records;
            self.look(Cause::NoTemperature, Some(!is_known), time, || {
                format!(
                    "{patience} records in a row came without a temperature, so only sudden changes are told: {reason}"
                )
            });
        }
    }

    /// Compares a record with the baseline; returns the loss that it shows by itself.
    fn take_relative(
        &mut self,
        observation: &Observation,
        others: &Others,
        verdict: &mut Verdict,
    ) -> Option<Shown> {
        match self.relative(observation) {
            Some(Ok(relative)) => {
                verdict.at_reference = reference::of_record(self, observation, &relative);
                if let Some(at_reference) = &verdict.at_reference {
                    let index = period::index_of(observation.start, self.plan.track.period_s);
                    self.state.scatter.take(index, at_reference.ratio.mean - 1.0);
                }
                let common_size = self.state.common_size();
                if let Some(at_reference) = &mut verdict.at_reference {
                    reference::widen(at_reference, common_size);
                }
                let ratio = relative.ratio.mean - 1.0;
                let law =
                    self.state.watch.get().and_then(|watch| {
                        watch.blind_law(observation.start.days(), ratio, relative.ratio.sd)
                    });
                let time = self.known_at(observation.start);
                let at_reference = verdict.at_reference.as_ref();
                let pending = Pending::new(observation, &relative);
                let fall = Fall::from(&relative);
                let shown = law.as_ref().map(|law| {
                    let known = || at_reference.map(Loss::at_reference);
                    let predicted = || {
                        self.state
                            .thermal_law(&pending)
                            .as_ref()
                            .map(|law| Loss::from_law(ratio, law))
                    };
                    let loss = known()
                        .or_else(predicted)
                        .unwrap_or_else(|| Loss::from_law(ratio, law));
                    Shown::within(loss, fall, law, self.plan.alarm.limit_loss)
                });
                let known = at_reference.map(Loss::at_reference);
                if !self.look_at_loss_after_silence(&pending, fall, known, others, time) {
                    self.look_at_loss(fall, law, known, time);
                }
                self.await_period(pending);
                verdict.relative = Some(relative);
                self.usable(observation);
                shown
            }
            Some(Err(NoRelative::OutsideRange)) => {
                verdict.set_aside = Some(SetAside::OutsideRange);
                let time = self.known_at(observation.start);
                let shown = self.look_at_range(observation, time);
                self.look(Cause::OutsideRange, Some(true), time, || {
                    "the frequencies differ from the baseline's by more than the model was prepared for: the rod, its \
                     supports or the channel changed"
                        .to_owned()
                });
                shown
            }
            Some(Err(NoRelative::NoCommonMode)) => {
                let reason = "none of its modes is in the baseline";
                self.set_aside(SetAside::NoCommonMode, reason, observation, verdict);
                None
            }
            None => None,
        }
    }

    /// Keeps credible readings, ascending in time, one per time.
    pub(crate) fn keep_readings(&mut self, readings: &[Reading]) {
        let state = &mut self.state;
        let horizon = state.latest.map(|latest| latest.plus_seconds(JUMP_S));
        for reading in readings {
            let is_past = state
                .filters
                .last_day()
                .is_some_and(|passed| reading.time.days() <= passed);
            let is_ahead = horizon.is_some_and(|horizon| reading.time > horizon);
            if is_past || is_ahead {
                continue;
            }
            let is_believed = state.thermometer.believes(reading);
            if let Some(until) = state.thermometer.trusted_until().filter(|_| !is_believed) {
                // Readings since the thermometer froze are withdrawn.
                state.readings.retain(|kept| kept.time <= until);
            }
            if !is_believed {
                continue;
            }
            let kept = &mut state.readings;
            let at = kept.partition_point(|known| known.time < reading.time);
            if kept.get(at).is_none_or(|known| known.time != reading.time) {
                kept.insert(at, *reading);
            }
        }
        // While no record waits for its temperature, none is kept for it but for one that comes late.
        if state.open.is_empty()
            && state.learning.is_empty()
            && let Some(newest) = state.readings.last()
        {
            let from = newest
                .time
                .plus_seconds(-(STALE_S + self.plan.track.reorder_window_s));
            let passed = state.readings.partition_point(|reading| reading.time < from);
            for reading in state.readings.drain(..passed) {
                state.filters.push(reading.time.days(), reading.celsius);
            }
        }
    }

    fn look_at_conflict(&mut self, observation: &Observation) {
        let (score, least) = (observation.conflict, self.plan.alarm.conflict_sd);
        let holds = if score >= least {
            Some(true)
        } else if score < 0.5 * least {
            Some(false)
        } else {
            None
        };
        let time = self.known_at(observation.start);
        self.look(Cause::Conflict, holds, time, || {
            format!(
                "no rod the model allows has these frequencies: they lie {score:.1} standard deviations off; the absolute \
                 force may be wrong by more than its interval says"
            )
        });
    }

    pub(super) fn await_period(&mut self, pending: Pending) {
        let open = &mut self.state.open;
        let at = open.partition_point(|known| known.start <= pending.start);
        open.insert(at, pending);
    }

    pub(super) fn relative(&self, observation: &Observation) -> Option<Result<Relative, NoRelative>> {
        let segment = self.state.segment.number;
        let seed = self.plan.seed_of(b"relative", segment, Some(observation.start));
        Some(self.shift.as_ref()?.relative(observation, seed))
    }

    /// Closes every period that can get no more records.
    fn close_periods(&mut self, others: &Others) -> Vec<Period> {
        let mut closed = Vec::new();
        let Some(latest) = self.state.latest else {
            return closed;
        };
        while let Some(end) = self.end_of_open() {
            if latest.seconds_since(end) < self.plan.track.reorder_window_s {
                break;
            }
            let Some(period) = self.take_period() else { break };
            self.state.closed = Some(period.index);
            let period = monitor::close(self, period, others, latest);
            self.state.periods.push(period.clone());
            closed.push(period);
        }
        closed
    }

    /// End of the first open period.
    fn end_of_open(&self) -> Option<Timestamp> {
        let period_s = self.plan.track.period_s;
        let index = period::index_of(self.state.open.first()?.start, period_s);
        Some(period::start_of(index.saturating_add(1), period_s))
    }

    /// Takes the first open period out.
    pub(super) fn take_period(&mut self) -> Option<Period> {
        let end = self.end_of_open()?;
        let state = &mut self.state;
        let count = state.open.partition_point(|pending| pending.start < end).max(1);
        let records: Vec<Pending> = state.open.drain(..count).collect();
        let shift = self.shift.as_ref();
        let period_s = self.plan.track.period_s;
        Some(period::combine(
            period::index_of(records.first()?.start, period_s),
            period_s,
            &records,
            &mut state.filters,
            &mut state.readings,
            state.thermometer.trusted_until(),
            |delta, misfit| shift.map_or(1.0, |shift| shift.not_axial_p(delta, misfit)),
        ))
    }
}
