//! Status of one rod, as JSON: for `status --format json` and the page.

use crate::analysis::findings::Doubt;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Alarm, Interval, RodState};
use crate::config::Config;
use crate::site::store::{Asked, Reader, Standing, StoreError};
use serde::{Deserialize, Serialize};

/// Status of one rod; every field is always present.
#[derive(Debug, Clone, Serialize)]
pub struct RodStatus {
    /// Id of the rod.
    pub rod: RodId,
    /// `learning`, `monitoring`, `alarm` or `not-monitoring`.
    pub state: &'static str,
    /// Reason why it is not tracked, if so.
    pub state_reason: Option<String>,
    /// Time of the last change of state, in event time.
    pub since: Option<Timestamp>,
    /// Number of the current segment.
    pub segment: u32,
    /// Number of records of the baseline so far, while it learns.
    pub baseline_records: Option<usize>,
    /// Number of periods learned so far, while it learns.
    pub learned_periods: Option<usize>,
    /// Number of records and periods needed, while it learns.
    pub learning_takes: Option<Goals>,
    /// True if force and change are at the reference temperature.
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
    /// Start of the latest record that was neither rejected nor set aside.
    pub latest_used: Option<Timestamp>,
    /// Start of the latest record.
    pub latest_record: Option<Timestamp>,
    /// Number of records.
    pub records: u64,
    /// Number of rejected records.
    pub rejected: u64,
    /// Active alarms.
    pub alarms: Vec<Alarm>,
    /// Requests that wait.
    pub waiting: Vec<String>,
}

/// Numbers of records and periods that learning takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Goals {
    /// Number of records of the baseline.
    pub records: usize,
    /// Number of periods to learn the effect of temperature, those of the baseline included.
    pub periods: usize,
}

impl Goals {
    /// Goals by the latest configuration of a store; `None` if it has none that this program can parse.
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

/// Fields of a record's line that are used here.
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
    /// Status from the store; `counts` are the numbers of the rod's records and of those rejected, `goals`
    /// those that learning takes.
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
            rod: standing.rod,
        })
    }

    /// Share of records that were rejected, 0 to 1.
    pub fn rejected_share(&self) -> f64 {
        if self.records > 0 {
            self.rejected as f64 / self.records as f64
        } else {
            0.0
        }
    }

    /// Explanation of the state, if there is more to say than its name.
    pub fn why(&self) -> Option<String> {
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
