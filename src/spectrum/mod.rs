//! Windows, Welch's power spectral density and peak picking.

use serde::Serialize;

/// A taper applied to each segment before its transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Window {
    /// Raised cosine.
    Hann,
    /// Raised cosine on a pedestal.
    Hamming,
    /// Three-term Blackman.
    Blackman,
    /// No taper.
    Rectangular,
}

/// How a spectrum is estimated (Welch 1967).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WelchSettings {
    /// The taper.
    pub window: Window,
    /// Length of a segment \[s\]; `None` chooses it from the record's length.
    pub segment_s: Option<f64>,
    /// Overlap of neighbouring segments as a share of their length, 0 to 0.95.
    pub overlap: f64,
}

impl Default for WelchSettings {
    fn default() -> Self {
        Self {
            window: Window::Hann,
            segment_s: None,
            overlap: 0.5,
        }
    }
}

/// Which maxima of a spectrum count as peaks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PeakSettings {
    /// Least height above the local noise floor \[dB\].
    pub prominence_db: f64,
    /// The most peaks kept, the most prominent first.
    pub max_peaks: usize,
}

impl Default for PeakSettings {
    fn default() -> Self {
        Self {
            prominence_db: 10.0,
            max_peaks: 20,
        }
    }
}
