//! Everything remembered of one rod from record to record.

use super::baseline::Baseline;
use super::chart::Charts;
use super::regression::Regression;
use super::relative::Relative;
use super::thermal::Thermal;
use super::{Alarm, Observation, Period};
use crate::record::{Reading, RodId, Timestamp};
use serde::{Deserialize, Serialize};

/// A stretch of history with one baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// From 1.
    pub number: u32,
    /// Why it was opened.
    pub reason: Opening,
    /// What the analysis and tracking of the rod depend on, as a hash: configuration and version.
    pub key: String,
    /// The baseline, once learned.
    pub baseline: Option<Baseline>,
    /// Temperature to which force is referred \[degC\], once known.
    pub reference_c: Option<f64>,
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
}

/// Everything remembered of one rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The rod.
    pub rod: RodId,
    /// The present segment.
    pub segment: Segment,
    /// Observations that wait for the baseline.
    pub learning: Vec<Observation>,
    /// Records of periods that are still open.
    pub open: Vec<Pending>,
    /// Readings not yet run through the thermal lag, ascending.
    pub readings: Vec<Reading>,
    /// The rod's low-passed temperature up to the last closed period.
    pub thermal: Thermal,
    /// What temperature explains.
    pub regression: Option<Regression>,
    /// The charts, once learned.
    pub charts: Option<Charts>,
    /// Closed periods of this segment, ascending. Kept in rows of their own by the store.
    #[serde(skip)]
    pub periods: Vec<Period>,
    /// Alarms that stand.
    pub alarms: Vec<Alarm>,
    /// Start of the latest record that was believed.
    pub latest: Option<Timestamp>,
}

/// A record of an open period.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pending {
    /// Time of its first sample.
    pub start: Timestamp,
    /// Its relative force.
    pub relative: Relative,
}
