//! From arguments to plans: the configuration, what the command line overrides, the forward models.

use super::BadArguments;
use crate::analysis::{AnalysisSettings, Plan};
use crate::bayes::{Adjustment, Accept, Distance, Method};
use crate::cache;
use crate::config::Config;
use crate::emulator::ModelSettings;
use crate::record::RodId;
use anyhow::Context;
use clap::{Args, ValueEnum};
use std::collections::HashMap;
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
