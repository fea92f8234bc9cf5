//! What came of one record: a force, or a reason why there is none.

use crate::analysis::{Identification, Measurement};
use crate::modes::Labels;
use crate::record::{Envelope, Reading, Rejection, RodId, Timestamp};
use crate::track::{Input, Observation};
use sha2::{Digest, Sha256};

/// What came of one record.
#[derive(Debug, Clone)]
pub enum Outcome {
    /// It gave a force.
    Identified(Box<Identification>),
    /// It gave none, for a stated reason.
    Rejected(Box<Rejected>),
}

/// A record that gave no force.
#[derive(Debug, Clone, PartialEq)]
pub struct Rejected {
    /// The rod.
    pub rod: RodId,
    /// Time of the first sample, if it is known.
    pub start: Option<Timestamp>,
    /// Length \[s\], if it is known.
    pub duration_s: Option<f64>,
    /// Sample rate \[Hz\], if it is known.
    pub fs_hz: Option<f64>,
    /// The record's identity by content, if it has samples.
    pub identity: Option<[u8; 32]>,
    /// Temperature readings that came with it.
    pub readings: Vec<Reading>,
    /// The reason.
    pub rejection: Rejection,
    /// Waveform, spectrum and resonances, if the analysis came that far.
    pub measurement: Option<Box<Measurement>>,
    /// Assignments of its peaks to orders, if there are peaks.
    pub labels: Option<Labels>,
    /// Its samples as the columns of a drawing, if it was refused before there was a spectrum.
    pub waveform: Option<Envelope>,
}

impl Outcome {
    /// The rod.
    pub fn rod(&self) -> &RodId {
        match self {
            Self::Identified(identification) => &identification.rod,
            Self::Rejected(rejected) => &rejected.rod,
        }
    }

    /// Identity of the record by content; what has no samples is known by rod, time, length and reason. `None` for
    /// frequencies measured elsewhere.
    pub fn identity(&self) -> Option<[u8; 32]> {
        match self {
            Self::Identified(identification) => identification.measurement.as_ref().map(|m| m.identity),
            Self::Rejected(rejected) => {
                Some(rejected.identity.unwrap_or_else(|| rejected.derived_identity()))
            }
        }
    }

    /// What tracking takes from it; `None` for frequencies measured elsewhere, which have no time.
    pub fn input(&self) -> Option<Input> {
        match self {
            Self::Identified(identification) => Observation::of(identification).map(Input::Identified),
            Self::Rejected(rejected) => Some(Input::Rejected {
                start: rejected.start,
                reason: rejected.rejection.to_string(),
                readings: rejected.readings.clone(),
            }),
        }
    }
}

impl Rejected {
    fn derived_identity(&self) -> [u8; 32] {
        let mut hash = Sha256::new();
        hash.update(b"rejected\0");
        hash.update(self.rod.0.as_bytes());
        hash.update([0]);
        hash.update(self.start.map_or(i64::MIN, Timestamp::as_nanos).to_le_bytes());
        hash.update(self.duration_s.unwrap_or(-1.0).to_bits().to_le_bytes());
        hash.update(self.rejection.code().as_bytes());
        hash.finalize().into()
    }
}
