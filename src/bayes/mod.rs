//! Priors, approximate Bayesian computation, posteriors and their diagnostics.

pub mod prior;
pub mod settings;

pub use prior::{Prior, RodPrior};
pub use settings::{AbcSettings, Accept, Adjustment, Distance, Method, Noise};

/// Natural frequencies to be explained: one entry per measured mode, any order may be missing.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Mode orders, from 1, ascending.
    pub orders: Vec<usize>,
    /// Natural frequencies \[Hz\].
    pub frequency_hz: Vec<f64>,
    /// Their standard errors \[Hz\].
    pub sd_hz: Vec<f64>,
}
