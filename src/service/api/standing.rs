//! How one rod stands, as JSON: what `status --format json` prints and the page shows.

use crate::analysis::findings::Doubt;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Alarm, Interval, RodState};
use crate::config::Config;
use crate::site::store::{Asked, Reader, Standing, StoreError};
use serde::{Deserialize, Serialize};

/// How one rod stands; every field is always present.
#[derive(Debug, Clone, Serialize)]
pub struct RodStatus {
    /// The rod.
    pub rod: RodId,
    /// `learning`, `monitoring`, `alarm` or `not-monitoring`.
    pub state: &'static str,
    /// Why it is not followed, if it is not.
    pub state_reason: Option<String>,
    /// Since when, in event time.
    pub since: Option<Timestamp>,
    /// The present segment.
    pub segment: u32,
    /// Records of the baseline so far, while it learns.
    pub baseline_records: Option<usize>,
    /// Periods learned so far, while it learns.
    pub learned_periods: Option<usize>,
    /// Records and periods that learning takes, while it learns.
    pub learning_takes: Option<Goals>,
    /// Whether force and change are at the reference temperature.
    pub compensated: bool,
    /// Reference temperature \[degC\].
    pub reference_temperature_c: Option<f64>,
    /// Force given the baseline \[N\].
    pub force_n: Option<Interval>,
    /// N_t / N_0.
    pub relative_force: Option<Interval>,
    /// Force of the latest record alone \[N\].
    pub axial_force_n: Option<Interval>,
    /// Reasons to doubt that record's force.
    pub doubts: Vec<Doubt>,
    /// The latest record that was neither rejected nor set aside.
    pub latest_used: Option<Timestamp>,
    /// The latest record.
    pub latest_record: Option<Timestamp>,
    /// Records there were.
    pub records: u64,
    /// Those of them that were rejected.
    pub rejected: u64,
    /// Alarms that stand.
    pub alarms: Vec<Alarm>,
    /// What was asked for and waits.
    pub waiting: Vec<String>,
    /// Since when a daemon has waited for the rod's first record; `null` once one has come.
    pub never_seen_since: Option<Timestamp>,
}

/// Records of a baseline, and periods that teach what temperature does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Goals {
    /// Records of the baseline.
    pub records: usize,
    /// Periods, those of the baseline among them.
    pub periods: usize,
}

impl Goals {
    /// By the latest configuration of a store; `None` if it has none that this program understands.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn of(reader: &Reader) -> Result<Option<Self>, StoreError> {
        let config = reader.latest_config()?;
        let config = config.and_then(|[_, _, text]| Config::parse(&text, "the store").ok());
        Ok(config.map(|config| Self {
            records: config.track.baseline_records,
            periods: config.track.learning_periods,
        }))
    }
}

/// What a record's line says that is asked for here.
#[derive(Default, Deserialize)]
struct Line {
    start: Option<Timestamp>,
    axial_force_n: Option<Interval>,
    conflict: Option<f64>,
    prior_tail: Option<f64>,
    label_probability: Option<f64>,
    tracked_force_n: Option<Interval>,
    relative_force: Option<Interval>,
    reference_temperature_c: Option<f64>,
    force_at_reference_n: Option<Interval>,
    relative_force_at_reference: Option<Interval>,
    segment: Option<u32>,
}

impl RodStatus {
    /// From what the store knows; `counts` are the rod's records and those rejected, `goals` what learning takes.
    ///
    /// # Errors
    /// The latest record's line cannot be understood.
    pub fn of(standing: Standing, counts: (u64, u64), goals: Option<Goals>) -> Result<Self, StoreError> {
        let line: Line = match &standing.latest {
            Some(line) => serde_json::from_str(line).map_err(|error| StoreError::Unreadable {
                what: format!("the latest record of rod {}", standing.rod),
                detail: error.to_string(),
            })?,
            None => Line::default(),
        };
        // What an older segment's record says is relative to another baseline.
        let is_present = line.segment == Some(standing.segment);
        let line = if is_present {
            line
        } else {
            Line {
                start: line.start,
                ..Line::default()
            }
        };
        let compensated = line.relative_force_at_reference.is_some();
        let (state_reason, baseline_records, learned_periods) = match &standing.state {
            RodState::NotMonitoring { reason } => (Some(reason.clone()), None, None),
            RodState::Learning { records, periods } => (None, Some(*records), Some(*periods)),
            RodState::Monitoring | RodState::Alarm => (None, None, None),
        };
        Ok(Self {
            state: standing.state.code(),
            state_reason,
            since: standing.since,
            segment: standing.segment,
            baseline_records,
            learned_periods,
            learning_takes: goals.filter(|_| baseline_records.is_some()),
            compensated,
            reference_temperature_c: line.reference_temperature_c,
            force_n: line.force_at_reference_n.or(line.tracked_force_n),
            relative_force: line.relative_force_at_reference.or(line.relative_force),
            axial_force_n: line.axial_force_n,
            doubts: Doubt::all(line.conflict, line.prior_tail, line.label_probability),
            latest_used: line.start,
            latest_record: standing.latest_start,
            records: counts.0,
            rejected: counts.1,
            alarms: standing.alarms,
            waiting: standing
                .waiting
                .iter()
                .map(|request| match &request.what {
                    Asked::Acknowledge { alarm } => format!("acknowledge {alarm}"),
                    Asked::Rebaseline { .. } => "rebaseline".to_owned(),
                })
                .collect(),
            never_seen_since: standing.awaited,
            rod: standing.rod,
        })
    }

    /// The share of records that were rejected.
    pub fn rejected_share(&self) -> f64 {
        if self.records > 0 {
            self.rejected as f64 / self.records as f64
        } else {
            0.0
        }
    }

    /// Why the rod stands as it does, if there is more to say than the state's name.
    pub fn why(&self) -> Option<String> {
        if let Some(since) = self.never_seen_since.filter(|_| self.state_reason.is_none()) {
            return Some(format!(
                "never seen: no record since the rod was configured, {since}"
            ));
        }
        if let (Some(records), Some(periods)) = (self.baseline_records, self.learned_periods) {
            let of = |goal: fn(&Goals) -> usize| {
                let goal = self.learning_takes.as_ref().map(goal);
                goal.map_or_else(String::new, |goal| format!(" of {goal}"))
            };
            return Some(format!(
                "learning: baseline {records}{} records, charts {periods}{} periods",
                of(|goals| goals.records),
                of(|goals| goals.periods)
            ));
        }
        self.state_reason.clone()
    }
}
