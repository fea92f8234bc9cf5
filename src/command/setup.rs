//! From arguments to plans: the configuration, what the command line puts over it, the forward models.

use super::BadArguments;
use super::progress::Progress;
use crate::analysis::{self, Plan};
use crate::bayes::Tables;
use crate::cache::{self, Cache};
use crate::config::{Config, ConfigError, RodConfig, Setting};
use crate::record::RodId;
use crate::site::{Provenance, Site};
use crate::store::{Durability, Reader, Store, StoreError};
use crate::track::TrackPlan;
use crate::track::chart::Design;
use clap::Args;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The configuration, and what is put over it for one run.
#[derive(Debug, Clone, Args)]
pub struct Setup {
    /// The configuration; without it the built-in one: the paper's tie-rod at Todi (config/todi.toml).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Puts one key over the configuration, any number of times: `--set abc.distance=relative`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,

    /// Forward model: reduced, pce, exact or finite-elements (emulator.model).
    #[arg(long)]
    pub model: Option<String>,

    /// Draws from the prior (abc.draws).
    #[arg(long, value_name = "COUNT")]
    pub draws: Option<u64>,

    /// Accept this share of the draws, the nearest (abc.accept).
    #[arg(long, value_name = "SHARE", conflicts_with = "epsilon")]
    pub alpha: Option<f64>,

    /// Accept every draw nearer than this, in the unit of the distance (abc.accept).
    #[arg(long, value_name = "DISTANCE")]
    pub epsilon: Option<f64>,

    /// Seed of all random numbers (site.seed).
    #[arg(long)]
    pub seed: Option<u64>,
}

impl Setup {
    /// The configuration of this run.
    ///
    /// # Errors
    /// Every fault of the file and of the settings over it.
    pub fn load(&self) -> Result<Config, ConfigError> {
        if self.config.is_none() {
            tracing::info!("no --config: using the built-in config/todi.toml, the paper's tie-rod");
        }
        let mut settings = self.settings.clone();
        let mut put = |key: &str, value: Option<String>| {
            settings.extend(value.map(|value| Setting::new(key, value)));
        };
        put("emulator.model", self.model.clone());
        put("abc.draws", self.draws.map(|draws| draws.to_string()));
        put(
            "abc.accept",
            self.alpha.map(|alpha| format!("{{ quantile = {alpha} }}")),
        );
        put(
            "abc.accept",
            self.epsilon.map(|epsilon| format!("{{ epsilon = {epsilon} }}")),
        );
        put("site.seed", self.seed.map(|seed| seed.to_string()));
        Config::resolve(self.config.as_deref(), &settings)
    }
}

/// Sixteen hexadecimal digits that name everything a result depends on besides its record.
pub fn provenance(config: &Config) -> String {
    hex(&config.hash()[..8])
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Prepares every rod of the configuration: model (fitted or from the cache), table, pattern.
///
/// # Errors
/// Settings that contradict each other, or an emulator that cannot be fitted.
pub fn plans(config: &Config) -> anyhow::Result<BTreeMap<RodId, Plan>> {
    let tables = Tables::new(config.seed);
    let cache = Cache::of_user();
    let mut plans = BTreeMap::new();
    for rod in &config.rods {
        let settings = rod.analysis.clone();
        let solves = Progress::of_solves();
        let model = cache::model(&settings.model, &settings.prior, &cache, &|more, all| {
            solves.add(more as u64, all as u64);
        })?;
        drop(solves);
        plans.insert(settings.rod.clone(), Plan::new(settings, model, &tables)?);
    }
    Ok(plans)
}

/// Prepares the tracking of every rod that has a plan.
pub fn track_plans(config: &Config, plans: &BTreeMap<RodId, Plan>) -> Vec<Arc<TrackPlan>> {
    let alarm = &config.alarm;
    let design = Design::of(alarm, config.track.period_s);
    plans
        .iter()
        .map(|(rod, plan)| {
            let meaning = config.meaning_of(rod);
            let key = format!("{}-{}", analysis::VERSION, hex(&meaning[..8]));
            Arc::new(TrackPlan::new(
                plan.settings(),
                plan.model(),
                config.track.clone(),
                alarm.clone(),
                design,
                key,
            ))
        })
        .collect()
}

/// A site ready for records: what analyses them, and what follows them.
pub struct Prepared {
    /// One plan per rod.
    pub plans: BTreeMap<RodId, Plan>,
    /// Trackers and store.
    pub site: Site,
}

/// Prepares a whole site. `store`: over the configuration's; without either, a store that is gone with the process.
///
/// # Errors
/// Plans that cannot be made, a store that cannot be opened.
pub fn site(config: &Config, store: Option<&Path>) -> anyhow::Result<Prepared> {
    let store = match store.or(config.store.as_deref()) {
        Some(path) => Store::open(path, Durability::Replay)?,
        None => Store::in_memory()?,
    };
    if let Some(aside) = store.moved_aside() {
        tell!(
            "warning: the store was damaged and is now {}; a new one is begun: replay the recordings to rebuild it",
            aside.display()
        );
    }
    let plans = plans(config)?;
    let hash = provenance(config);
    let effective = config.effective();
    let provenance = Provenance {
        site: &config.site,
        hash: &hash,
        effective: &effective,
    };
    let sites: BTreeSet<String> = store.configs()?.into_iter().map(|[_, site, _]| site).collect();
    if !sites.is_empty() && !sites.contains(&config.site) {
        let sites: Vec<String> = sites.into_iter().collect();
        tell!(
            "warning: {} holds records of {}; those of {} are added to it",
            store.path().display(),
            sites.join(", "),
            config.site
        );
    }
    let segments = present_segments(&store)?;
    let site = Site::open(track_plans(config, &plans), store, provenance)?;
    for (rod, segment) in present_segments(site.store())? {
        if segments.get(&rod).is_some_and(|before| *before != segment) {
            tell!(
                "warning: the settings of {rod} changed: its new records begin a new baseline (segment {segment}); records \
                 kept before are not analysed again: replay them into another store for that"
            );
        }
    }
    Ok(Prepared { plans, site })
}

/// The segment each rod of a store is in.
fn present_segments(store: &Reader) -> Result<BTreeMap<RodId, u32>, StoreError> {
    let states = store.states()?;
    Ok(states
        .into_iter()
        .map(|(rod, state)| (rod, state.segment.number))
        .collect())
}

/// The rod called `id`, or the only one.
///
/// # Errors
/// No rod of that name, or several and no name.
pub fn choose_rod<'c>(config: &'c Config, id: Option<&str>) -> Result<&'c RodConfig, BadArguments> {
    let known = || {
        let ids: Vec<&str> = config
            .rods
            .iter()
            .map(|rod| rod.analysis.rod.0.as_str())
            .collect();
        ids.join(", ")
    };
    match (id, config.rods.as_slice()) {
        (Some(id), _) => config
            .rod(id)
            .ok_or_else(|| BadArguments(format!("--rod {id}: the configuration has {}", known()))),
        (None, [only]) => Ok(only),
        (None, _) => Err(BadArguments(format!(
            "--rod is needed: the configuration has {}",
            known()
        ))),
    }
}
