//! A record: an evenly sampled stretch of one rod's displacement, with what is known about it.

pub mod assembler;
pub mod channel;
mod clock;
mod envelope;
mod error_code;
mod event;
mod hold;
mod holes;
pub mod moments;
mod onset;
pub mod quality;
pub mod rejection;
mod saved;
pub mod settings;
pub(crate) mod slope;
mod steps;
mod temperature;
pub mod time;
mod timing;
mod unit;

pub use assembler::Assembler;
pub use channel::{Beside, Channel, RodChannels, TimeSource};
pub use envelope::Envelope;
pub use event::Event;
pub use moments::{Moment, Moments, is_one_motion};
pub use rejection::{Flag, Rejection};
pub use saved::{EventToSave, SavedEvent};
pub use settings::{Cut, RecordSettings};
pub use temperature::{POSSIBLE_C, Reading, STALE_S};
pub use time::Timestamp;
pub use unit::Unit;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fmt;

/// The name of a rod, unique within a site.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RodId(pub String);

impl From<&str> for RodId {
    fn from(name: &str) -> Self {
        Self(name.to_owned())
    }
}

impl fmt::Display for RodId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Excitation of a rod.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Excitation {
    /// Wind, traffic, bells: a stationary random response.
    Ambient,
    /// A pull and release, or a blow: the record begins at the onset and decays.
    FreeDecay,
}

/// An evenly sampled stretch of one rod's displacement that passed the quality checks.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// The rod it belongs to.
    pub rod: RodId,
    /// Time of the first sample.
    pub start: Timestamp,
    /// Sample rate \[Hz\], measured from the stamps where there are stamps.
    pub fs_hz: f64,
    /// Displacement in SI of its unit (m, m/s or m/s^2), in time order.
    pub samples: Vec<f64>,
    /// Mean temperature during the record \[degC\], if there is a channel for it.
    pub temperature_c: Option<f64>,
    /// Temperature readings since the rod's previous record, its own included, ascending in time.
    pub readings: Vec<Reading>,
    /// Excitation, as declared by the cut; `None`: to be recognised.
    pub excitation: Option<Excitation>,
    /// Relative standard error of the sample rate \[-\]; 0 where it is exact or not known.
    pub clock_sd: f64,
    /// Faults that the quality checks noticed without rejecting the record.
    pub flags: Vec<Flag>,
}

impl Record {
    /// A record from evenly spaced samples, SI of their unit, after the quality checks; missing samples are NaN.
    ///
    /// # Errors
    /// Samples that are too short a record, missing, held, clipped, or otherwise no measurement.
    pub fn from_samples(
        rod: RodId,
        start: Timestamp,
        fs_hz: f64,
        samples: Vec<f64>,
        settings: &RecordSettings,
    ) -> Result<Self, Rejection> {
        let duration_s = samples.len() as f64 / fs_hz;
        // A hair less than asked for is a matter of rounding; a rate that is no number is refused, too.
        if !(duration_s >= settings.min_duration_s * (1.0 - 1e-9) && fs_hz > 0.0 && fs_hz.is_finite()) {
            return Err(Rejection::TooShort {
                duration_s,
                needed_s: settings.min_duration_s,
            });
        }
        let checked = quality::check(samples, fs_hz, settings)?;
        Ok(Self {
            rod,
            start,
            fs_hz,
            samples: checked.samples,
            temperature_c: None,
            readings: Vec::new(),
            excitation: None,
            clock_sd: 0.0,
            flags: checked.flags,
        })
    }

    /// Length of the record \[s\]: samples over sample rate.
    pub fn duration_s(&self) -> f64 {
        self.samples.len() as f64 / self.fs_hz
    }

    /// Root mean square of the samples about their mean, SI of their unit.
    pub fn rms(&self) -> f64 {
        let count = self.samples.len().max(1) as f64;
        let mean = self.samples.iter().sum::<f64>() / count;
        (self.samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt()
    }

    /// Content hash: SHA-256 of rod, start, sample rate and samples, so that a copied or renamed file is
    /// still the same record.
    pub fn identity(&self) -> [u8; 32] {
        let mut hash = Sha256::new();
        hash.update((self.rod.0.len() as u64).to_le_bytes());
        hash.update(self.rod.0.as_bytes());
        hash.update(self.start.as_nanos().to_le_bytes());
        hash.update(self.fs_hz.to_bits().to_le_bytes());
        let mut bytes = [0u8; 4096];
        for block in self.samples.chunks(bytes.len() / 8) {
            for (sample, slot) in block.iter().zip(bytes.chunks_exact_mut(8)) {
                slot.copy_from_slice(&sample.to_bits().to_le_bytes());
            }
            hash.update(&bytes[..block.len() * 8]);
        }
        hash.finalize().into()
    }
}
