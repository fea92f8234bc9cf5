//! Waveforms and spectra of a store's pictures, for views of records that are analysed again without samples.

use crate::analysis::record_view::{Curve, Snapshot};
use crate::analysis::signal::record::{Envelope, RodId, Timestamp};
use crate::site::store::{Reader, StoreError};
use std::collections::HashMap;

/// Waveforms and spectra by rod and start of the record.
#[derive(Debug, Clone, Default)]
pub struct Pictures(HashMap<(RodId, Timestamp), (Option<Envelope>, Curve)>);

impl Pictures {
    /// All pictures of a store.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn of(reader: &Reader) -> Result<Self, StoreError> {
        let mut pictures = HashMap::new();
        for rod in reader.rods()? {
            for Snapshot {
                start,
                waveform,
                curve,
                ..
            } in reader.all_snapshots(&rod)?
            {
                pictures.insert((rod.clone(), start), (waveform, curve));
            }
        }
        Ok(Self(pictures))
    }

    /// A view with the waveform and spectrum of the same record; `None` if there is no picture of it. The spectrum
    /// reaches as far as in the picture.
    pub fn complete(&self, rod: &RodId, view: Snapshot) -> Option<Snapshot> {
        let (waveform, curve) = self.0.get(&(rod.clone(), view.start))?.clone();
        Some(Snapshot {
            waveform,
            curve,
            ..view
        })
    }
}
