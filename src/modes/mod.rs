//! From a spectrum to natural frequencies: refinement per peak, standard errors, mode orders.

pub mod band;
pub mod identify;
pub mod label;
pub mod likelihood;
mod logarithm;
pub mod optimum;
pub mod posterior;
pub mod refine;

pub use identify::{ModalEstimate, ModalPlan};
pub use label::{Labelling, Pattern, label};
pub use refine::{Refinement, refine};

use serde::Serialize;

/// One resonance found in a record, not yet given a mode order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resonance {
    /// Natural frequency \[Hz\].
    pub frequency_hz: f64,
    /// Standard error of the frequency \[Hz\].
    pub frequency_sd_hz: f64,
    /// Damping ratio \[-\].
    pub damping: f64,
    /// Standard error of the damping ratio's natural logarithm \[-\].
    pub damping_log_sd: f64,
    /// Height of the fitted peak over the fitted noise floor, as a power ratio \[-\].
    pub peak_to_noise: f64,
    /// Twice the gain in log likelihood over noise alone.
    pub evidence: f64,
    /// Whether a pure sine explains it as well: interference, or a record too short or too noisy to
    /// tell a resonance from a line. Never believed to be a mode.
    pub line: bool,
}

/// One natural frequency of a rod, measured in one record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Mode {
    /// Mode order, from 1.
    pub order: usize,
    /// Natural frequency \[Hz\].
    pub frequency_hz: f64,
    /// Standard error of the frequency \[Hz\].
    pub sd_hz: f64,
    /// Damping ratio \[-\], if it was measured.
    pub damping: Option<f64>,
}

/// A band of frequencies in which no peak is believed: mains hum, a bell motor, a pump.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Mask {
    /// Lower end \[Hz\].
    pub low_hz: f64,
    /// Upper end \[Hz\].
    pub high_hz: f64,
}

/// Which natural frequencies are looked for, and where.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeSettings {
    /// Mode orders used, 1 to this number; at most [`crate::forward::MAX_MODES`].
    pub count: usize,
    /// Bands in which no peak is believed.
    pub masks: Vec<Mask>,
}

impl Default for ModeSettings {
    fn default() -> Self {
        Self {
            count: 3,
            masks: Vec::new(),
        }
    }
}
