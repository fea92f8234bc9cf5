//! Emulators that stand in for the beam: chaos expansions and a perceptron, with their error reports.

pub mod design;
pub mod domain;
pub mod expansion;
pub mod fallback;
pub mod fit;
pub mod germ;
pub mod pce;
pub mod reduced;
mod reduced_fit;
pub mod sobol;
pub mod training;
pub mod validate;

pub use fallback::OrExact;
pub use pce::Pce;
pub use reduced::{Reduced, ReducedModel};
pub use training::{FitError, Training};
pub use validate::ErrorReport;

use serde::Serialize;

/// Which forward model answers for the natural frequencies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case", tag = "model")]
pub enum ModelSettings {
    /// Roots of the characteristic determinant.
    Exact,
    /// Two-node beam elements.
    FiniteElements {
        /// How many; the paper: 50.
        elements: usize,
    },
    /// Chaos in the dimensionless groups, one for every rod and prior (the default).
    #[default]
    Reduced,
    /// The paper's Hermite chaos in the germs of the uncertain parameters.
    Pce {
        /// Total order; the paper: 5.
        order: usize,
    },
}
