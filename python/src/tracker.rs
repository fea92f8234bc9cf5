//! Relative force of a site's rods over time.

use crate::event::Event;
use crate::outcome::Outcome;
use crate::refused;
use crate::site::modes;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;
use tirante::analysis::track::Tracker as Inner;
use tirante::site::prepared::Generation;
use tirante::{Plan, Reading, RodId, TableRow, Timestamp};

/// Begin of the times that can be meant, 1970-04-26: what nobody dated counts from 1970, and so does a number of
/// seconds, milliseconds or microseconds that was taken for nanoseconds.
const DATED: Timestamp = Timestamp::from_nanos(10_000_000_000_000_000);

/// The fold over the records of a site's rods, in memory.
#[pyclass(module = "tirante._core")]
pub struct Tracker {
    trackers: BTreeMap<RodId, Inner>,
    plans: Arc<BTreeMap<RodId, Plan>>,
    config_hash: String,
    /// Identities of the records taken.
    known: HashSet<[u8; 32]>,
}

impl Tracker {
    pub(crate) fn new(generation: &Generation) -> Self {
        let plans = generation.track_plans.iter();
        Self {
            trackers: plans
                .map(|plan| (plan.rod().clone(), Inner::new(Arc::clone(plan))))
                .collect(),
            plans: Arc::clone(&generation.plans),
            config_hash: generation.provenance().hash.to_owned(),
            known: HashSet::new(),
        }
    }
}

#[pymethods]
impl Tracker {
    /// Takes one result, in the order of event time, and returns it with its relative force; `None` for data taken
    /// before.
    fn take(&mut self, py: Python<'_>, outcome: &Outcome) -> PyResult<Option<Outcome>> {
        let inner = &outcome.inner;
        let (Some(input), Some(identity)) = (inner.input(), inner.identity()) else {
            return Err(refused(
                "frequencies without a time cannot be tracked: take_frequencies wants one",
            ));
        };
        if let Some(start) = inner.start().filter(|start| *start < DATED) {
            return Err(refused(format!(
                "rod {}: a record of {start} has no time that can be tracked: nothing said when it began (`start` of `read` \
                 and `record` does), or its time is not in nanoseconds",
                inner.rod()
            )));
        }
        if !self.known.insert(identity) {
            return Ok(None);
        }
        let trackers = &mut self.trackers;
        let verdict = py
            .detach(|| Inner::step_among(trackers, inner.rod(), &input))
            .ok_or_else(|| PyKeyError::new_err(inner.rod().0.clone()))?;
        Ok(Some(outcome.tracked(py, &verdict)))
    }

    /// Takes temperatures that belong to no record.
    fn take_readings(&mut self, event: &Event) -> PyResult<bool> {
        let tirante::Event::Readings { rod, readings } = &event.0 else {
            return Err(refused(
                "a record is no temperature; identify it, then take the result",
            ));
        };
        let tracker = self.trackers.get_mut(rod);
        let tracker = tracker.ok_or_else(|| PyKeyError::new_err(rod.0.clone()))?;
        Ok(tracker.take_readings(readings))
    }

    /// Takes frequencies identified elsewhere: order, frequency and standard error in hertz of each.
    #[pyo3(signature = (rod, start_ns, given, *, temperature_c = None, duration_s = 0.0, rms = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn take_frequencies(
        &mut self,
        py: Python<'_>,
        rod: &str,
        start_ns: i64,
        given: Vec<(usize, f64, f64)>,
        temperature_c: Option<f64>,
        duration_s: f64,
        rms: Option<f64>,
    ) -> PyResult<Option<Outcome>> {
        let start = Timestamp::from_nanos(start_ns);
        let counts = |value: f64| value.is_finite() && value >= 0.0;
        if !counts(duration_s) || !rms.is_none_or(counts) {
            return Err(refused("duration_s and rms: numbers from 0 on are wanted"));
        }
        let row = TableRow {
            start,
            duration_s,
            modes: modes(&given)?,
            temperature_c,
            readings: temperature_c
                .map(|celsius| Reading { time: start, celsius })
                .into_iter()
                .collect(),
            rms,
        };
        let plan = self.plans.get(&RodId::from(rod));
        let plan = plan.ok_or_else(|| PyKeyError::new_err(rod.to_owned()))?;
        let (highest, count) = (
            row.modes.last().map_or(0, |mode| mode.order),
            plan.settings().modes.count,
        );
        if highest > count {
            return Err(refused(format!(
                "mode {highest}: {rod} is followed by {count} modes, set modes.count"
            )));
        }
        let outcome = py.detach(|| tirante::Outcome::of_row(plan, row));
        let outcome = Outcome::new(py, outcome, &self.config_hash)?;
        self.take(py, &outcome)
    }

    /// State of a rod: `learning`, `monitoring`, `alarm` or `not-monitoring`.
    fn state(&self, rod: &str) -> PyResult<&'static str> {
        let tracker = self.trackers.get(&RodId::from(rod));
        let tracker = tracker.ok_or_else(|| PyKeyError::new_err(rod.to_owned()))?;
        Ok(tracker.rod_state().code())
    }
}
