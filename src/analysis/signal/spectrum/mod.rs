//! Windows, Welch's power spectral density and peak picking.

pub mod peaks;
pub mod welch;
pub mod window;

pub use peaks::{Peak, find_peaks, noise_floor, pick_peaks};
pub use welch::{Spectrum, Transforms, Welch, WelchError, fast_length};

use serde::Serialize;

/// A taper applied to each segment before its transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
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

/// Settings of the spectral estimate (Welch 1967).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WelchSettings {
    /// The taper.
    pub window: Window,
    /// Length of a segment \[s\]; `None` chooses it from the record's length
    /// ([`WelchSettings::nperseg`]).
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

impl WelchSettings {
    /// Samples per segment for a record of `samples` samples.
    ///
    /// A stated length is taken as it is (at most the record). Otherwise a sixth of the record, at
    /// least 10 s (main lobe of the Hann window 0.4 Hz: modes 1 Hz apart are resolved) and at most 40 s
    /// (lightly damped modes rise higher the longer the segment; beyond that the variance and the refinement,
    /// which uses the whole record, gain nothing), rounded to a length the transform is fast at.
    pub fn nperseg(&self, fs_hz: f64, samples: usize) -> usize {
        let wanted = match self.segment_s {
            Some(segment_s) => return ((segment_s * fs_hz).round() as usize).clamp(2, samples.max(2)),
            None => (samples as f64 / 6.0).clamp(10.0 * fs_hz, 40.0 * fs_hz),
        };
        fast_length((wanted as usize).clamp(2, samples.max(2)))
    }

    /// Samples shared by neighbouring segments of `nperseg` samples.
    pub fn noverlap(&self, nperseg: usize) -> usize {
        ((self.overlap * nperseg as f64) as usize).min(nperseg.saturating_sub(1))
    }
}

/// Criteria for a maximum of a spectrum to be a peak.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PeakSettings {
    /// Least height above the local noise floor \[dB\]; the maximum's prominence must reach half of it.
    pub prominence_db: f64,
    /// Most peaks kept: the highest above the local noise floor.
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
