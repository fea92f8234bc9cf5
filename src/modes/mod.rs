//! From a spectrum to natural frequencies: refinement per peak, standard errors, mode orders.

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
    /// Height of the fitted peak over the fitted noise floor, as a power ratio \[-\].
    pub peak_to_noise: f64,
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
