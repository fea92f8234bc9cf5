//! One configuration in force, and everything prepared from it: the same for a replay and for the daemon.

use crate::analysis::identify::{self, Plan};
use crate::analysis::inference::Tables;
use crate::analysis::signal::record::{RodChannels, RodId};
use crate::analysis::track::TrackPlan;
use crate::config::Config;
use crate::site::emulator_cache::{self, Cache};
use crate::site::hex::hex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Analysis plan of each rod.
pub type Plans = BTreeMap<RodId, Plan>;

/// One configuration in force, and everything prepared from it.
pub struct Generation {
    /// The configuration in force.
    pub config: Config,
    /// Plan of each rod's analysis.
    pub plans: Arc<Plans>,
    /// Plan of each rod's tracking.
    pub track_plans: Vec<Arc<TrackPlan>>,
    hash: String,
    effective: String,
}

/// The configuration of a site, in the form of the store.
#[derive(Debug, Clone, Copy)]
pub struct Provenance<'a> {
    /// Name of the site.
    pub site: &'a str,
    /// Hash by which records refer to it.
    pub hash: &'a str,
    /// Text with every default filled in.
    pub effective: &'a str,
}

impl Generation {
    /// Prepares everything; `solves_of` gives the progress callback (solves newly done, total) of a rod whose
    /// model is fitted. This may take minutes.
    ///
    /// # Errors
    /// Settings that contradict each other, or an emulator that cannot be fitted.
    pub fn prepare<S: Fn(usize, usize) + Sync>(
        config: Config,
        solves_of: impl Fn(&RodId) -> S,
    ) -> anyhow::Result<Self> {
        let plans = plans(&config, solves_of)?;
        Ok(Self {
            track_plans: track_plans(&config, &plans),
            hash: provenance(&config),
            effective: config.effective(),
            plans: Arc::new(plans),
            config,
        })
    }

    /// The configuration in the form of the store.
    pub fn provenance(&self) -> Provenance<'_> {
        Provenance {
            site: &self.config.site,
            hash: &self.hash,
            effective: &self.effective,
        }
    }

    /// Location of the rods' samples in recordings.
    pub fn channels(&self) -> Vec<RodChannels> {
        self.config.rods.iter().map(|rod| rod.channels.clone()).collect()
    }
}

/// Hash of everything that determines the meaning of a rod's numbers: its settings, and the version of the
/// analysis.
pub fn key(config: &Config, rod: &RodId) -> String {
    let meaning = config.meaning_of(rod);
    format!("{}-{}", identify::VERSION, hex(&meaning[..8]))
}

/// Sixteen hexadecimal digits that identify everything a result depends on besides its record.
pub fn provenance(config: &Config) -> String {
    hex(&config.hash()[..8])
}

/// Prepares the analysis of every rod: model (fitted or from the cache), table, pattern; `solves_of` as for
/// [`Generation::prepare`].
///
/// # Errors
/// Settings that contradict each other, or an emulator that cannot be fitted.
pub fn plans<S: Fn(usize, usize) + Sync>(
    config: &Config,
    solves_of: impl Fn(&RodId) -> S,
) -> anyhow::Result<Plans> {
    let tables = Tables::new(config.seed);
    let cache = Cache::of_user();
    let mut plans = BTreeMap::new();
    for rod in &config.rods {
        let settings = rod.analysis.clone();
        let solved = solves_of(&settings.rod);
        let model = emulator_cache::model(&settings.model, &settings.prior, &cache, &solved)?;
        drop(solved);
        let rod = settings.rod.clone();
        let plan = Plan::new(settings, model, &tables)?;
        for doubt in plan.doubts() {
            tracing::warn!(%rod, "the rod's tests hardly agree: {doubt}");
        }
        plans.insert(rod, plan);
    }
    Ok(plans)
}

/// Prepares the tracking of every rod that has a plan.
fn track_plans(config: &Config, plans: &Plans) -> Vec<Arc<TrackPlan>> {
    let alarm = &config.alarm;
    plans
        .iter()
        .map(|(rod, plan)| {
            Arc::new(TrackPlan::new(
                plan.settings(),
                plan.model(),
                config.track.clone(),
                alarm.clone(),
                key(config, rod),
            ))
        })
        .collect()
}
