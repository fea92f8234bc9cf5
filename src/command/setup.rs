//! From arguments to plans: the configuration, what the command line overrides, the forward models.

use crate::analysis::{AnalysisSettings, Plan};
use crate::bayes::{Accept, Adjustment, Distance, Method, Tables};
use crate::cache;
use crate::config::Config;
use crate::emulator::ModelSettings;
use crate::record::RodId;
use clap::{Args, ValueEnum};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Choices of the configuration that may be overridden for one run.
#[derive(Debug, Clone, Args)]
pub struct Overrides {
    /// The configuration; without it the built-in one: the paper's tie-rod at Todi (config/todi.toml).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Forward model behind the inference.
    #[arg(long, value_enum)]
    pub model: Option<ModelName>,

    /// Draws from the prior per record.
    #[arg(long, value_name = "COUNT")]
    pub draws: Option<usize>,

    /// Accept this share of the draws, the nearest ones (0 to 1).
    #[arg(long, value_name = "SHARE", conflicts_with = "epsilon")]
    pub alpha: Option<f64>,

    /// Accept every draw nearer than this, in the unit of the distance.
    #[arg(long, value_name = "DISTANCE")]
    pub epsilon: Option<f64>,

    /// Distance between observed and simulated frequencies.
    #[arg(long, value_enum)]
    pub distance: Option<DistanceName>,

    /// Correct the accepted draws by local-linear regression (Beaumont 2002).
    #[arg(long)]
    pub adjust: bool,

    /// Propose draws from a shrinking sequence of populations instead of the prior.
    #[arg(long)]
    pub sequential: bool,

    /// Seed of all random numbers.
    #[arg(long)]
    pub seed: Option<u64>,
}

/// Forward models as typed.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum ModelName {
    /// Chaos in the dimensionless groups (default).
    Reduced,
    /// The paper's Hermite chaos, order 5.
    Pce,
    /// Roots of the characteristic determinant.
    Exact,
    /// 50 two-node beam elements.
    FiniteElements,
}

/// Distances as typed.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum DistanceName {
    /// In hertz (default).
    Euclidean,
    /// Relative to the observed frequencies.
    Relative,
    /// In standard deviations.
    Mahalanobis,
}

impl Overrides {
    /// The configuration named on the command line, or the built-in one.
    ///
    /// # Errors
    /// Every fault of the file.
    pub fn load(&self) -> anyhow::Result<Config> {
        let mut config = match &self.config {
            Some(path) => Config::load(path)?,
            None => {
                tracing::info!("no --config: using the built-in config/todi.toml, the paper's tie-rod");
                Config::built_in()
            }
        };
        for rod in &mut config.rods {
            self.apply(&mut rod.analysis);
        }
        Ok(config)
    }

    fn apply(&self, settings: &mut AnalysisSettings) {
        let abc = &mut settings.abc;
        if let Some(draws) = self.draws {
            abc.draws = draws;
        }
        if let Some(alpha) = self.alpha {
            abc.accept = Accept::Quantile(alpha);
        }
        if let Some(epsilon) = self.epsilon {
            abc.accept = Accept::Epsilon(epsilon);
        }
        match self.distance {
            Some(DistanceName::Euclidean) => abc.distance = Distance::Euclidean,
            Some(DistanceName::Relative) => abc.distance = Distance::Relative,
            Some(DistanceName::Mahalanobis) => abc.distance = Distance::Mahalanobis,
            None => {}
        }
        if self.adjust {
            abc.adjustment = Adjustment::Linear;
        }
        if self.sequential {
            abc.method = Method::Sequential;
        }
        match self.model {
            Some(ModelName::Reduced) => settings.model = ModelSettings::Reduced,
            Some(ModelName::Pce) => settings.model = ModelSettings::Pce { order: 5 },
            Some(ModelName::Exact) => settings.model = ModelSettings::Exact,
            Some(ModelName::FiniteElements) => {
                settings.model = ModelSettings::FiniteElements { elements: 50 };
            }
            None => {}
        }
        if let Some(seed) = self.seed {
            settings.seed = seed;
        }
    }

    /// Sixteen hexadecimal digits that name everything a result depends on besides its record: the
    /// effective configuration and what the command line overrides.
    pub fn provenance(&self, config: &Config) -> String {
        let Self {
            config: _,
            model,
            draws,
            alpha,
            epsilon,
            distance,
            adjust,
            sequential,
            seed,
        } = self;
        let mut hash = Sha256::new();
        hash.update(config.hash());
        let overrides = (model, draws, alpha, epsilon, distance, adjust, sequential, seed);
        hash.update(format!("{overrides:?}").as_bytes());
        hash.finalize()[..8]
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect()
    }
}

/// Prepares every rod of the configuration: model (fitted or from the cache), table, pattern.
///
/// # Errors
/// Settings that contradict each other, or an emulator that cannot be fitted.
pub fn plans(config: &Config) -> anyhow::Result<BTreeMap<RodId, Plan>> {
    let mut tables: Option<Tables> = None;
    let mut plans = BTreeMap::new();
    for rod in &config.rods {
        let settings = rod.analysis.clone();
        let model = cache::model(&settings.model, &settings.prior)?;
        let tables = tables.get_or_insert_with(|| Tables::new(settings.seed));
        plans.insert(settings.rod.clone(), Plan::new(settings, model, tables)?);
    }
    Ok(plans)
}
