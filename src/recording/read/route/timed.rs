//! An event of a rod with its completion time.

use crate::read::Place;
use std::sync::Arc;
use tirante_analysis::signal::record::{Event, Timestamp};
use tirante_analysis::track::ordered::Reached;

/// An event of a rod with its completion time.
#[derive(Debug)]
pub(in crate::read) struct Timed {
    pub(in crate::read) event: Event,
    /// Completion time, by the rod's own stamps.
    pub(in crate::read) at: Timestamp,
    /// Times up to which each rod had been read by then.
    pub(in crate::read) reached: Reached,
    /// Name of the file that holds its last sample, where several are read as one.
    pub(super) origin: Option<Arc<str>>,
}

impl Timed {
    /// Number of records in it: one, or zero for temperatures alone.
    pub(in crate::read) fn records(&self) -> u64 {
        u64::from(!matches!(self.event, Event::Readings { .. }))
    }

    /// Bytes of its samples.
    pub(super) fn bytes(&self) -> usize {
        8 * self.event.samples()
    }

    /// Returns the event with the place at which it was complete.
    pub(in crate::read) fn at_place(self, file: Arc<str>, bytes: u64, records: u64) -> (Event, Place) {
        let Self {
            event,
            at,
            reached,
            origin,
        } = self;
        let place = Place {
            origin: origin.unwrap_or_else(|| Arc::clone(&file)),
            file,
            bytes,
            records,
            at,
            reached,
        };
        (event, place)
    }
}
