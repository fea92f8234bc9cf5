//! A plan once per rod, then one pure `run` per record: displacement to axial force.

use crate::bayes::{AbcSettings, RodPrior};
use crate::emulator::ModelSettings;
use crate::modes::ModeSettings;
use crate::record::RodId;
use crate::spectrum::{PeakSettings, WelchSettings};

/// Everything the analysis of one rod depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalysisSettings {
    /// The rod.
    pub rod: RodId,
    /// What is known about it beforehand.
    pub prior: RodPrior,
    /// Relative model discrepancy per mode order (standard deviation of b_n / y_n), one entry per
    /// mode looked for; zeros are the paper's setting.
    pub discrepancy: Vec<f64>,
    /// How the spectrum is estimated.
    pub welch: WelchSettings,
    /// Which maxima count as peaks.
    pub peaks: PeakSettings,
    /// Which modes are looked for.
    pub modes: ModeSettings,
    /// How the force is inferred.
    pub abc: AbcSettings,
    /// Which forward model answers.
    pub model: ModelSettings,
    /// Seed of the whole site; each record's seed follows from it, the rod and the record.
    pub seed: u64,
}
