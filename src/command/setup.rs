//! From arguments to plans: configuration, overriding settings, forward models.

use super::BadArguments;
use super::progress::Progress;
use crate::analysis::signal::record::RodId;
use crate::config::{Config, ConfigError, RodConfig, Setting};
use crate::site::baselines;
use crate::site::prepared::{self, Generation, Plans};
use crate::site::store::{Durability, Store};
use crate::site::trackers::{self, Site};
use clap::Args;
use std::path::{Path, PathBuf};

/// Configuration, with the settings that override it for one run.
#[derive(Debug, Clone, Args)]
pub struct Setup {
    /// Configuration; default: the built-in one, the paper's tie-rod at Todi (config/todi.toml).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Override one configuration key; may be repeated: `--set abc.distance=relative`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,

    /// Forward model: reduced, pce, exact or finite-elements (emulator.model).
    #[arg(long)]
    pub model: Option<String>,

    /// Number of draws from the prior (abc.draws).
    #[arg(long, value_name = "COUNT")]
    pub draws: Option<u64>,

    /// Accept this share of the draws, the nearest ones (abc.accept).
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
    /// Loads the configuration of this run.
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

/// Prepares the plans of every rod, with a progress bar where a model is fitted.
///
/// # Errors
/// As [`generation::plans`].
pub fn plans(config: &Config) -> anyhow::Result<Plans> {
    sampling(has_tests(config), || prepared::plans(config, solves_of))
}

fn has_tests(config: &Config) -> bool {
    config.rods.iter().any(|rod| !rod.analysis.tests.is_empty())
}

/// Prepares plans, with a line of progress where tests of rods are sampled for them.
fn sampling<T>(has_tests: bool, prepare: impl FnOnce() -> T) -> T {
    match has_tests {
        true => Progress::during("tests of the rods together", prepare),
        false => prepare(),
    }
}

fn solves_of(_rod: &RodId) -> impl Fn(usize, usize) + Sync + use<> {
    let bar = Progress::of_solves();
    move |more, all| bar.add(more as u64, all as u64)
}

/// Baselines that may be dropped.
#[derive(Debug, Clone, Default, Args)]
pub struct GivenUp {
    /// Rod whose baseline may be dropped if its settings changed the meaning of its numbers; may be repeated.
    /// Without it, such settings are refused.
    #[arg(long = "accept-new-baseline", value_name = "ROD")]
    rods: Vec<String>,
}

impl GivenUp {
    /// The rods.
    pub fn rods(&self) -> Vec<String> {
        self.rods.clone()
    }
}

/// A site ready for records: plans, trackers and store.
pub struct Prepared {
    /// Configuration and plans.
    pub generation: Generation,
    /// Trackers and store.
    pub site: Site,
}

/// Prepares a whole site. `store` overrides the configuration's; without either, a store in memory, which keeps the states of the rods if a
/// report is made of it.
///
/// # Errors
/// Plans that cannot be made, a store that cannot be opened, settings that would drop a baseline not given
/// up.
pub fn site(
    config: Config,
    store: Option<&Path>,
    given_up: &GivenUp,
    is_reported: bool,
) -> anyhow::Result<Prepared> {
    let store = match store.or(config.store.path.as_deref()) {
        Some(path) => Store::open(path, Durability::Replay)?,
        // A report reads the states, too.
        None if is_reported => Store::in_memory()?,
        None => Store::transient()?,
    };
    if let Some(aside) = store.moved_aside() {
        tell!(
            "warning: the store was damaged and is now {}; a new one is begun: replay the recordings to rebuild it",
            aside.display()
        );
    }
    baselines::guard(&store, &config, &given_up.rods)?;
    let generation = sampling(has_tests(&config), || Generation::prepare(config, solves_of))?;
    let name = &generation.config.site;
    let others = trackers::others_in(&store, name)?;
    if !others.is_empty() {
        tell!(
            "warning: {} holds records of {}; those of {name} are added to it",
            store.path().display(),
            others.join(", "),
        );
    }
    let plans = generation.track_plans.iter().cloned();
    let site = Site::open(plans, store, generation.provenance())?;
    for rod in site.unfollowed() {
        tell!("warning: {rod} is in the store, but not in the configuration: no record of it is taken");
    }
    for renewed in site.renewed() {
        match renewed.is_found {
            true => tell!("{renewed}"),
            false => tell!("warning: {renewed}: replay them into another store for that"),
        }
    }
    Ok(Prepared { generation, site })
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
