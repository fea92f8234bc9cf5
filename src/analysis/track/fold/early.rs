//! Watch over the records of the future baseline: a change during learning is reported on the next record,
//! not a month later.
//!
//! The first five records give a provisional baseline; a drift watch runs on the periods measured against it until the baseline
//! is there. Both are dropped then: the baseline's own watch begins with its first record.

use super::monitor::change_told;
use super::packed::Packed;
use super::plan::TrackPlan;
use super::tracker::Tracker;
use crate::signal::record::{Reading, Timestamp};
use crate::track::alarm::change::Change;
use crate::track::alarm::{Kind, Known};
use crate::track::baseline::Baseline;
use crate::track::drift::Filters;
use crate::track::drift::others::Others;
use crate::track::drift::period::{self, Pending};
use crate::track::drift::watch::{DriftWatch, Finding};
use crate::track::observation::Observation;
use crate::track::relative::Shift;
use serde::{Deserialize, Serialize};

/// Number of records of the provisional baseline.
pub(crate) const RECORDS: usize = 5;

/// A provisional baseline and the periods measured against it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EarlyWatch {
    pub(crate) baseline: Baseline,
    filters: Filters,
    reference_c: Option<f64>,
    /// Records of the period that is still open.
    open: Vec<Pending>,
    watch: Packed<DriftWatch>,
    /// Start of the last record taken.
    taken: Option<Timestamp>,
}

impl EarlyWatch {
    /// A watch before its first record.
    fn new(baseline: Baseline) -> Self {
        Self {
            baseline,
            filters: Filters::default(),
            reference_c: None,
            open: Vec::new(),
            watch: Packed::default(),
            taken: None,
        }
    }

    /// Takes a record; returns the change, if the periods closed so far show one.
    fn take(
        &mut self,
        plan: &TrackPlan,
        shift: &Shift,
        observation: &Observation,
        readings: &[Reading],
    ) -> Option<Change> {
        self.taken = Some(observation.start);
        let seed = plan.seed_of(b"early", 0, Some(observation.start));
        let relative = shift.relative(observation, seed).ok()?;
        let period_s = plan.track.period_s;
        let index = period::index_of(observation.start, period_s);
        let is_later = self
            .open
            .first()
            .is_some_and(|first| period::index_of(first.start, period_s) < index);
        let found = if is_later {
            self.close(plan, shift, readings)
        } else {
            None
        };
        self.open.push(Pending::new(observation, &relative));
        found
    }

    /// True if periods were closed, and their watch was of another layout.
    fn has_lost_its_watch(&self, period_s: f64) -> bool {
        let index = |time| period::index_of(time, period_s);
        let open = self.open.first().map(|first| index(first.start));
        self.watch.get().is_none() && open.is_some_and(|open| open > index(self.baseline.first))
    }

    /// Closes the open period.
    fn close(&mut self, plan: &TrackPlan, shift: &Shift, readings: &[Reading]) -> Option<Change> {
        let records = std::mem::take(&mut self.open);
        let period_s = plan.track.period_s;
        let index = period::index_of(records.first()?.start, period_s);
        let mut readings = readings.to_vec();
        let not_axial_p = |delta: f64, misfit: &[_]| shift.not_axial_p(delta, misfit);
        let period = period::combine(
            index,
            period_s,
            &records,
            &mut self.filters,
            &mut readings,
            None,
            not_axial_p,
        );
        self.reference_c = self.reference_c.or(period.filtered_c.map(|filtered| filtered[0]));
        let terms = plan.terms(&self.baseline, shift, self.reference_c);
        let watch = self.watch.get_or_insert_with(|| {
            DriftWatch::new(period.start.days(), period.delta_sd.max(f64::MIN_POSITIVE))
        });
        let others = Others::default();
        watch.step(&terms, &period, self.filters.is_sparse(), &others, period_s);
        match watch.finding(&others, index, false) {
            Finding::Quiet | Finding::Waiting => None,
            Finding::Drift(_) | Finding::Common => change_told(watch, Some(shift)),
        }
    }
}

impl Tracker {
    /// Passes the latest observation that waits for the baseline to the early watch.
    pub(crate) fn watch_early(&mut self, time: Timestamp) {
        let segment = self.state.segment.number;
        let waiting = self.state.learning.len();
        // Records that were withdrawn take the provisional baseline with them; a watch that cannot be read any more is made anew
        // from all records.
        let first = self.state.learning.first().map(|first| first.start);
        let period_s = self.plan.track.period_s;
        if self
            .state
            .early
            .as_ref()
            .is_some_and(|early| Some(early.baseline.first) != first || early.has_lost_its_watch(period_s))
        {
            (self.state.early, self.early_shift) = (None, None);
        }
        if waiting < RECORDS {
            return;
        }
        if self.state.early.is_none() {
            let Ok(baseline) = self.plan.learn(&self.state.learning[..RECORDS], segment) else {
                return;
            };
            self.state.early = Some(EarlyWatch::new(baseline));
        }
        let Some(mut early) = self.state.early.take() else {
            return;
        };
        if self.early_shift.is_none() {
            self.early_shift = Some(self.plan.shift(&early.baseline));
        }
        let mut found = None;
        if let Some(shift) = &self.early_shift {
            let taken = early.taken;
            for observation in self.state.learning.iter().filter(|one| Some(one.start) > taken) {
                found = early
                    .take(&self.plan, shift, observation, &self.state.readings)
                    .or(found);
            }
        }
        self.state.early = Some(early);
        if let Some(change) = found {
            let message = message(&change);
            let known = Known {
                change: Some(change),
                ..Known::default()
            };
            self.on_board(|board| board.raise(Kind::Drift, time, message, known));
        }
    }
}

fn message(change: &Change) -> String {
    let size = &change.size;
    format!(
        "the axial force changed by {:+.2} % (95 %: {:+.2} to {:+.2} %) while the baseline is being learned: if that is known and \
         accepted, begin the baseline anew with `tirante rebaseline`",
        100.0 * size.mean,
        100.0 * size.q025,
        100.0 * size.q975,
    )
}
