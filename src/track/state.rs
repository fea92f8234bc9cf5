//! Everything remembered of one rod from record to record.

use super::Observation;
use super::alarm::{Alarm, Watches};
use super::baseline::Baseline;
use super::chart::Charts;
use super::period::{Pending, Period};
use super::plausibility::Plausibility;
use super::regression::Regression;
use super::thermal::Thermal;
use super::thermometer::Thermometer;
use super::whiteness::Whiteness;
use crate::record::{Reading, RodId, Timestamp};
use serde::{Deserialize, Serialize};

/// A stretch of history with one baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// From 1.
    pub number: u32,
    /// Why it was opened.
    pub reason: Opening,
    /// Everything that gives numbers their meaning (configuration of the rod, version of the analysis), as a
    /// hash: when it changes, a new segment begins, so that an upgrade can never look like drift.
    pub key: String,
    /// The baseline, once learned.
    pub baseline: Option<Baseline>,
    /// Temperature to which force is referred \[degC\], once known.
    pub reference_c: Option<f64>,
    /// Why the last attempt at a baseline failed, if it did.
    pub fault: Option<String>,
}

/// Why a segment was opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Opening {
    /// The rod's first record.
    First,
    /// Somebody asked for it.
    Requested,
    /// Configuration or analysis changed what numbers mean.
    Changed,
    /// The clock had jumped ahead for a while: time begins anew.
    Clock,
}

impl Opening {
    /// The name in JSON.
    pub fn code(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Requested => "requested",
            Self::Changed => "changed",
            Self::Clock => "clock",
        }
    }
}

/// Everything remembered of one rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The rod.
    pub rod: RodId,
    /// The present segment.
    pub segment: Segment,
    /// Observations that wait for the baseline, ascending in time.
    pub learning: Vec<Observation>,
    /// Records of periods that are still open, ascending in time.
    pub open: Vec<Pending>,
    /// Readings not yet run through the thermal lag, ascending in time.
    pub readings: Vec<Reading>,
    /// The rod's low-passed temperature up to the last closed period.
    pub thermal: Thermal,
    /// What temperature explains.
    pub regression: Option<Regression>,
    /// The charts, once the regression has learned.
    pub charts: Option<Charts>,
    /// Spans of periods the regression must not learn: from the onset of what an alarm warned of to its end, if
    /// it ended.
    pub frozen: Vec<(i64, Option<i64>)>,
    /// The last period that was closed.
    pub closed: Option<i64>,
    /// Closed periods of this segment, ascending. The store keeps them in rows of their own.
    #[serde(skip)]
    pub periods: Vec<Period>,
    /// Alarms that stand, in the order they were raised.
    pub alarms: Vec<Alarm>,
    /// Whether the latest charted residuals are white, as the stated false-alarm rate supposes.
    pub whiteness: Option<Whiteness>,
    /// How long each condition has held or been absent.
    pub watches: Watches,
    /// What tells records of this sensor from others.
    pub plausibility: Plausibility,
    /// What tells its thermometer's readings from a broken one's.
    pub thermometer: Thermometer,
    /// Start of the latest record that was believed.
    pub latest: Option<Timestamp>,
}

impl State {
    /// A rod of which nothing is known yet.
    pub fn new(rod: RodId, key: String, lags_s: Vec<f64>) -> Self {
        Self {
            rod,
            segment: Segment {
                number: 1,
                reason: Opening::First,
                key,
                baseline: None,
                reference_c: None,
                fault: None,
            },
            learning: Vec::new(),
            open: Vec::new(),
            readings: Vec::new(),
            thermal: Thermal::new(lags_s),
            regression: None,
            charts: None,
            frozen: Vec::new(),
            closed: None,
            periods: Vec::new(),
            alarms: Vec::new(),
            watches: Watches::default(),
            plausibility: Plausibility::default(),
            thermometer: Thermometer::default(),
            whiteness: None,
            latest: None,
        }
    }

    /// Whether a standing alarm keeps the regression from learning what it warns of.
    pub(super) fn is_frozen(&self) -> bool {
        matches!(self.frozen.last(), Some((_, None)))
    }

    /// Whether a period belongs to what an alarm warned of.
    pub(super) fn was_frozen(&self, index: i64) -> bool {
        self.frozen
            .iter()
            .any(|(from, to)| *from <= index && to.is_none_or(|to| index <= to))
    }

    /// The next segment: everything is learned anew; time and temperature go on, unless the clock was wrong.
    pub fn next_segment(&self, reason: Opening, key: String, lags_s: Vec<f64>, anew_in_time: bool) -> Self {
        let thermal = if lags_s == self.thermal.lags_s {
            self.thermal.clone()
        } else {
            Thermal::new(lags_s.clone())
        };
        let mut next = Self::new(self.rod.clone(), key, lags_s);
        next.segment.number = self.segment.number + 1;
        next.segment.reason = reason;
        if reason == Opening::Changed {
            next.thermometer = self.thermometer.clone();
        }
        next.alarms = self.alarms.clone();
        if !anew_in_time {
            next.readings = self.readings.clone();
            next.thermal = thermal;
            next.closed = self.closed;
            next.latest = self.latest;
        }
        next
    }

    /// Whether the regression has learned from this many periods: charts and limits count from then on.
    pub(super) fn has_learned(&self, periods: usize) -> bool {
        self.regression
            .as_ref()
            .is_some_and(|regression| regression.periods() >= periods)
    }

    /// The period's temperatures less the reference \[K\], one per lag, empty without compensation; `None` if they
    /// are not known.
    pub(super) fn warmer_k(&self, period: &Period) -> Option<Vec<f64>> {
        if self.thermal.lags_s.is_empty() {
            return Some(Vec::new());
        }
        let reference_c = self.segment.reference_c?;
        let lagged_c = period.lagged_c.as_ref()?;
        Some(lagged_c.iter().map(|celsius| celsius - reference_c).collect())
    }

    /// Whether a record of this very time waits already.
    pub(super) fn has_record_of(&self, start: Timestamp) -> bool {
        self.learning
            .binary_search_by_key(&start, |known| known.start)
            .is_ok()
            || self
                .open
                .binary_search_by_key(&start, |known| known.start)
                .is_ok()
    }

    /// The usual distance between records \[s\]; `None` before two records.
    pub(super) fn usual_s(&self) -> Option<f64> {
        let (first, last, records) = match (&self.segment.baseline, &self.learning[..]) {
            (Some(baseline), _) => (baseline.first, baseline.last, baseline.records),
            (None, [first, .., last]) => (first.start, last.start, self.learning.len()),
            (None, _) => return None,
        };
        Some(last.seconds_since(first) / (records.max(2) - 1) as f64)
    }
}
