//! One configuration in force, and everything prepared from it.

use crate::analysis::Plan;
use crate::config::Config;
use crate::record::RodId;
use crate::track::TrackPlan;
use std::collections::BTreeMap;
use std::sync::Arc;

/// One configuration in force, and everything prepared from it.
pub struct Generation {
    /// The configuration.
    pub config: Config,
    /// What analyses each rod's records.
    pub plans: BTreeMap<RodId, Plan>,
    /// What follows each rod.
    pub track_plans: Vec<Arc<TrackPlan>>,
}
