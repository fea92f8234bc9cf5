//! Status of one rod, as JSON: for `status --format json` and the page.

use super::listing::AlarmAnswer;
use crate::analysis::findings::Doubt;
use crate::analysis::identify::Sensors;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Alarm, Interval, Kind, RodState, SILENCE_INTERVALS};
use crate::config::Config;
use crate::site::record_row::RecordRow;
use crate::site::store::{Asked, Counts, Reader, Standing, StoreError};
use serde::Serialize;

/// Status of one rod; every field but `sensors` is always present.
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
    /// Temperature of the record in `latest_used` \[degC\].
    pub temperature_c: Option<f64>,
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
    /// Start of the latest record whose time can be believed.
    pub latest_record: Option<Timestamp>,
    /// Number of records that a wrong clock dated after that one.
    pub records_ahead: u64,
    /// Age from which its data are stale \[s\]: the silence that raises an alarm, 0 while that alarm holds; `null` if unknown.
    pub stale_after_s: Option<f64>,
    /// Number of records.
    pub records: u64,
    /// Number of rejected records.
    pub rejected: u64,
    /// Number of records that were set aside: identified, and not followed.
    pub set_aside: u64,
    /// Active alarms.
    pub alarms: Vec<AlarmAnswer>,
    /// Requests that wait.
    pub waiting: Vec<String>,
    /// Time since which a daemon has expected the rod's first record; `null` once one has come.
    pub never_seen_since: Option<Timestamp>,
    /// Sensors of the record in `latest_used`; only of a rod with several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensors: Option<Sensors>,
}

/// Numbers of records and periods that learning takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Goals {
    /// Number of records of the baseline.
    pub records: usize,
    /// Number of periods to learn the effect of temperature, those of the baseline included.
    pub periods: usize,
}

/// Terms of a store's latest configuration that its rods are judged by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Terms {
    /// Numbers that learning takes.
    pub goals: Goals,
    /// Silence that raises an alarm \[s\].
    pub silence_s: f64,
    /// Relative loss of force that raises an alarm \[-\].
    pub limit_loss: f64,
}

impl Terms {
    /// Terms by the latest configuration of a store; `None` if it has none that this program can parse.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn of(reader: &Reader) -> Result<Option<Self>, StoreError> {
        let config = reader.latest_config()?;
        let config = config.and_then(|[_, _, text]| Config::parse(&text, "the store").ok());
        Ok(config.map(|config| Self {
            goals: Goals {
                records: config.track.baseline_records,
                periods: config.track.learning_periods,
            },
            silence_s: config.alarm.silence_s,
            limit_loss: config.alarm.limit_loss,
        }))
    }
}

/// Age from which a rod's data are stale \[s\], by the rule of the alarm `no-data`.
fn stale_after_s(standing: &Standing, terms: Option<Terms>) -> Option<f64> {
    let is_silent = |alarm: &Alarm| alarm.kind == Kind::NoData && alarm.cleared.is_none();
    if standing.alarms.iter().any(is_silent) {
        return Some(0.0);
    }
    let usual_s = standing.usual_s.unwrap_or(0.0);
    terms.map(|terms| terms.silence_s.max(SILENCE_INTERVALS * usual_s))
}

impl RodStatus {
    /// True if its data are stale at `now`: it is not followed, whatever state its last record left.
    pub fn is_stale(&self, now: Timestamp) -> bool {
        let age_s = self.latest_record.map(|latest| now.seconds_since(latest));
        age_s
            .zip(self.stale_after_s)
            .is_some_and(|(age_s, after_s)| age_s > after_s)
    }

    /// Status from the store.
    ///
    /// # Errors
    /// The latest record's line cannot be understood.
    pub fn of(mut standing: Standing, counts: Counts, terms: Option<Terms>) -> Result<Self, StoreError> {
        let latest = standing.latest_row()?;
        let latest_used = latest.as_ref().and_then(|row| row.start);
        let sensors = latest.as_ref().and_then(|row| row.sensors.clone());
        // A record of an older segment is relative to another baseline.
        let row = latest
            .filter(|row| row.segment == Some(standing.segment))
            .unwrap_or_else(|| RecordRow::new(&standing.rod, ""));
        let compensated = row.relative_force_at_reference.is_some();
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
            learning_takes: terms
                .map(|terms| terms.goals)
                .filter(|_| baseline_records.is_some()),
            compensated,
            temperature_c: row.temperature_c,
            reference_temperature_c: row.reference_temperature_c,
            force_n: row.force_n(),
            relative_force: row.ratio(),
            axial_force_n: row.axial_force_n.as_ref().map(Interval::from),
            doubts: row.doubts(),
            latest_used,
            latest_record: standing.latest_start,
            records_ahead: standing.ahead,
            stale_after_s: stale_after_s(&standing, terms),
            records: counts.records,
            rejected: counts.rejected,
            set_aside: counts.set_aside,
            alarms: standing
                .alarms
                .into_iter()
                .map(|alarm| {
                    let words = standing.words.remove(&alarm.id);
                    AlarmAnswer::with(alarm, words)
                })
                .collect(),
            waiting: standing
                .waiting
                .iter()
                .map(|request| match &request.what {
                    Asked::Acknowledge { alarm, .. } => format!("acknowledge {alarm}"),
                    Asked::Rebaseline { .. } => "rebaseline".to_owned(),
                })
                .collect(),
            never_seen_since: standing.awaited,
            sensors,
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

    /// Explanation of the state, if its name is not enough.
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
