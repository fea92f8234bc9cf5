//! State of one rod from record to record.

use super::early::EarlyWatch;
use super::loss::Before;
use super::packed::Packed;
use super::scatter::Scatter;
use super::silence::Doubted;
use super::verdict::RodState;
use crate::signal::record::{Reading, RodId, Timestamp};
use crate::track::alarm::{Alarm, Cause, Kind, Watches};
use crate::track::baseline::Baseline;
use crate::track::baseline::spacing::usual_s;
use crate::track::drift::Filters;
use crate::track::drift::Law;
use crate::track::drift::period::{Pending, Period};
use crate::track::drift::watch::DriftWatch;
use crate::track::observation::Observation;
use crate::track::plausibility::{JUMP_S, Plausibility};
use crate::track::thermometer::Thermometer;
use serde::{Deserialize, Serialize};

/// Periods whose steps tell the weather's.
const STEPS: usize = 60;

/// Periods of its own after which a `limit` without a drift puts a rod in doubt no more.
const LOST_PERIODS: usize = 30;

/// A stretch of history with one baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// Number of the segment, from 1.
    pub number: u32,
    /// Reason for opening it.
    pub reason: Opening,
    /// Hash of everything that determines the meaning of numbers (configuration of the rod, version of the
    /// analysis): when it changes, a new segment begins, so that an upgrade can never look like drift.
    pub key: String,
    /// The baseline, once learned.
    pub baseline: Option<Baseline>,
    /// Temperature to which force is referred \[degC\], once known.
    pub reference_c: Option<f64>,
    /// Error of the last attempt at a baseline, if it failed.
    pub fault: Option<String>,
}

/// Reason for opening a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Opening {
    /// The rod's first record.
    First,
    /// A person asked for it.
    Requested,
    /// Configuration or analysis changed the meaning of numbers.
    Changed,
    /// The clock had jumped ahead for a while: time starts again.
    Clock,
}

impl Opening {
    /// Name in JSON.
    pub fn code(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Requested => "requested",
            Self::Changed => "changed",
            Self::Clock => "clock",
        }
    }
}

/// State of one rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The rod.
    pub rod: RodId,
    /// The current segment.
    pub segment: Segment,
    /// Observations that wait for the baseline, ascending in time.
    pub learning: Vec<Observation>,
    /// Records of periods that are still open, ascending in time.
    pub open: Vec<Pending>,
    /// Readings not yet run through the low passes, ascending in time.
    pub readings: Vec<Reading>,
    /// The low-passed temperature up to the last closed period.
    #[serde(default)]
    pub filters: Filters,
    /// The drift watch, from the first period of the baseline.
    #[serde(default)]
    pub watch: Packed<DriftWatch>,
    /// Watch over the records of the future baseline.
    #[serde(default)]
    pub early: Option<EarlyWatch>,
    /// Scatter of records within a period.
    #[serde(default)]
    pub scatter: Scatter,
    /// Law of the ratio before a large loss that is suspected or stands.
    #[serde(default)]
    pub before: Option<Before>,
    /// Last record, if its clock is doubted.
    #[serde(default)]
    pub doubted: Option<Doubted>,
    /// Number of the last closed period.
    pub closed: Option<i64>,
    /// Closed periods of this segment, ascending. The store keeps them in rows of their own.
    #[serde(skip)]
    pub periods: Vec<Period>,
    /// Active alarms, in the order they were raised.
    pub alarms: Vec<Alarm>,
    /// Runs of each condition, held or absent.
    pub watches: Watches,
    /// Memory for judging records of this sensor.
    pub plausibility: Plausibility,
    /// Memory for judging readings of its thermometer.
    pub thermometer: Thermometer,
    /// Start of the latest accepted record.
    pub latest: Option<Timestamp>,
    /// Number of the segment that was opened last: a shelved one may continue after it.
    #[serde(default)]
    pub opened: u32,
}

impl State {
    /// State of a rod without records.
    pub fn new(rod: RodId, key: String) -> Self {
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
            filters: Filters::default(),
            watch: Packed::default(),
            early: None,
            scatter: Scatter::default(),
            before: None,
            doubted: None,
            closed: None,
            periods: Vec::new(),
            alarms: Vec::new(),
            watches: Watches::default(),
            plausibility: Plausibility::default(),
            thermometer: Thermometer::default(),
            latest: None,
            opened: 1,
        }
    }

    /// True while nothing is known of the rod: no record or reading has been taken; at most its absence was
    /// reported.
    pub fn is_untouched(&self) -> bool {
        let mut blank = Self::new(self.rod.clone(), self.segment.key.clone());
        blank.alarms.clone_from(&self.alarms);
        blank == *self
    }

    /// Number of records of the baseline, or of those that wait for it; zero while nothing is learned.
    pub fn learned(&self) -> usize {
        let baseline = self.segment.baseline.as_ref();
        baseline.map_or(self.learning.len(), |baseline| baseline.records)
    }

    /// True while the rods of the site are reported to move together, this one among them.
    pub(super) fn moves_with_others(&self) -> bool {
        let has_joined = self.watch.get().is_some_and(DriftWatch::has_joined);
        has_joined || self.holds(Kind::Common)
    }

    /// Size of the change that rods show together, as a share of the force; zero while none is reported. Its
    /// cause is the thermometer or the structure: until that is known, a change at the reference temperature
    /// is uncertain by as much. It is known of a sudden loss that the frequencies themselves show: no thermometer makes it.
    pub(super) fn common_size(&self) -> f64 {
        if !self.moves_with_others() || self.watches.stands(Cause::Loss) {
            return 0.0;
        }
        let change = self.watch.get().and_then(DriftWatch::change);
        change.map_or(0.0, |change| change.size.abs())
    }

    /// Time at which a change of the rod was told that stands \[d\].
    pub(super) fn changed_since(&self) -> Option<f64> {
        let tells_change = |alarm: &&Alarm| match alarm.kind {
            Kind::Drift | Kind::Limit => alarm.cleared.is_none(),
            // The misfit alone tells no change since the baseline.
            Kind::NotAxial => alarm.cleared.is_none() && alarm.change.is_some(),
            _ => false,
        };
        let told = self.alarms.iter().filter(tells_change);
        told.map(|alarm| alarm.raised.days()).reduce(f64::min)
    }

    /// True if an alarm of this kind is active and its condition holds.
    pub(crate) fn holds(&self, kind: Kind) -> bool {
        self.alarms
            .iter()
            .any(|alarm| alarm.kind == kind && alarm.cleared.is_none())
    }

    /// Next segment: everything is learned again; time and temperature continue, unless the clock was wrong.
    pub fn next_segment(&self, reason: Opening, key: String, anew_in_time: bool) -> Self {
        let mut next = Self::new(self.rod.clone(), key);
        next.segment.number = self.opened.max(self.segment.number) + 1;
        next.opened = next.segment.number;
        next.segment.reason = reason;
        if reason == Opening::Changed {
            next.thermometer = self.thermometer.clone();
        }
        next.alarms = self.alarms.clone();
        if !anew_in_time {
            next.readings = self.readings.clone();
            next.filters = self.filters.clone();
            next.closed = self.closed;
            next.latest = self.latest;
        }
        next
    }

    /// Continues this shelved state after its settings replaced those of `now` again: it keeps its own
    /// learned data, and takes time, temperature, sensor and unacknowledged alarms of `now`. Records that wait for a baseline
    /// keep their temperatures, and are dropped behind a hole that no baseline may have.
    pub fn back_after(mut self, now: &Self) -> Self {
        let latest = self.latest.max(now.latest);
        let last = self.learning.last().map(|last| last.start);
        let is_behind = |last: Timestamp| latest.is_some_and(|latest| latest.seconds_since(last) > JUMP_S);
        if last.is_some_and(is_behind) {
            self.learning = Vec::new();
            self.early = None;
        }
        if self.learning.is_empty() {
            self.readings = now.readings.clone();
            self.filters = now.filters.clone();
        } else {
            self.readings.extend_from_slice(&now.readings);
            self.readings.sort_by_key(|reading| reading.time);
            self.readings.dedup_by_key(|reading| reading.time);
        }
        self.alarms = now.alarms.clone();
        self.watches = Watches::default();
        self.before = None;
        self.doubted = None;
        self.open = Vec::new();
        self.plausibility = now.plausibility.clone();
        self.thermometer = now.thermometer.clone();
        self.closed = self.closed.max(now.closed);
        self.latest = latest;
        self.opened = now.opened.max(now.segment.number);
        self
    }

    /// State of the rod, with the numbers of records of a baseline and of periods to learn.
    pub fn standing(&self, baseline_records: usize, learning_periods: usize) -> RodState {
        let measurement = |kind: Kind| matches!(kind, Kind::Sensor | Kind::NoData);
        if self.alarms.iter().any(|alarm| !measurement(alarm.kind)) {
            return RodState::Alarm;
        }
        let not_monitoring = |reason: &str| RodState::NotMonitoring {
            reason: reason.to_owned(),
        };
        if let Some(alarm) = self.alarms.first() {
            return not_monitoring(&alarm.message);
        }
        let learning = |records, periods| RodState::Learning { records, periods };
        if self.segment.baseline.is_none() {
            return match &self.segment.fault {
                Some(fault) => not_monitoring(&format!("no baseline: {fault}")),
                None => learning(self.learning.len(), 0),
            };
        }
        match self.watch.get() {
            None => learning(baseline_records, 0),
            Some(watch) if watch.periods() < learning_periods => learning(baseline_records, watch.periods()),
            Some(watch) if watch.is_compensated() => RodState::Monitoring,
            Some(watch) => {
                let time = self.latest.map_or(0.0, Timestamp::days);
                let least = watch.least_told_blind(time).unwrap_or(1.0);
                not_monitoring(&format!(
                    "uncompensated: no temperature, so only sudden changes of force above about {} % are told",
                    three_digits(100.0 * least)
                ))
            }
        }
    }

    /// True if the drift watch has seen this many periods: limits apply from then on.
    pub(crate) fn has_learned(&self, periods: usize) -> bool {
        self.watch.get().is_some_and(|watch| watch.periods() >= periods)
    }

    /// True if a record of the same time waits already.
    pub(crate) fn has_record_of(&self, start: Timestamp) -> bool {
        self.learning
            .binary_search_by_key(&start, |known| known.start)
            .is_ok()
            || self
                .open
                .binary_search_by_key(&start, |known| known.start)
                .is_ok()
    }

    /// Predictive law of a record by its temperature, without the other rods; `None` without one.
    pub(super) fn thermal_law(&self, pending: &Pending) -> Option<Law> {
        let filters = self.filters.advanced(&self.readings, pending.end);
        self.watch.get()?.law_by_temperature(pending, &filters)
    }

    /// Root mean square of the steps between the last periods' ratios: what the weather does from one to the next.
    pub(super) fn step_sd(&self) -> f64 {
        let last = &self.periods[self.periods.len().saturating_sub(STEPS + 1)..];
        let near = last.windows(2).filter(|pair| pair[1].index - pair[0].index == 1);
        let steps: Vec<f64> = near.map(|pair| (pair[1].delta - pair[0].delta).powi(2)).collect();
        let mean = steps.iter().sum::<f64>() / steps.len().max(1) as f64;
        mean.sqrt()
    }

    /// True while few periods ended since a time.
    pub(super) fn is_followed_briefly_since(&self, time: Timestamp) -> bool {
        let later = self
            .periods
            .iter()
            .rev()
            .take_while(|period| period.time() > time);
        later.take(LOST_PERIODS + 1).count() <= LOST_PERIODS
    }

    /// The usual distance between records \[s\]; `None` before two records.
    pub(crate) fn usual_s(&self) -> Option<f64> {
        let Some(baseline) = &self.segment.baseline else {
            return usual_s(self.learning.iter().map(|one| one.start));
        };
        let mean = baseline.last.seconds_since(baseline.first) / (baseline.records.max(2) - 1) as f64;
        Some(baseline.usual_s.unwrap_or(mean))
    }
}

/// A percentage with three significant digits, at least one of them a decimal: never 0 for what is not.
fn three_digits(percent: f64) -> String {
    let magnitude = percent.abs().log10().floor();
    // Zero has no magnitude.
    let decimals = if magnitude.is_finite() {
        (2.0 - magnitude).clamp(1.0, 9.0)
    } else {
        1.0
    };
    format!("{percent:.*}", decimals as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_percentage_is_not_zero() {
        for (percent, said) in [
            (0.0123, "0.0123"),
            (0.4, "0.400"),
            (1.5, "1.50"),
            (12.34, "12.3"),
            (100.0, "100.0"),
            (0.0, "0.0"),
        ] {
            assert_eq!(three_digits(percent), said);
        }
    }
}
