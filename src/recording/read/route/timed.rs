//! An event of a rod with its completion time.

use crate::analysis::signal::record::{Event, Timestamp};
use crate::analysis::track::ordered::Reached;
use crate::recording::read::Place;
use std::sync::Arc;

/// An event of a rod with its completion time.
#[derive(Debug)]
pub(in crate::recording::read) struct Timed {
    pub(in crate::recording::read) event: Event,
    /// Completion time, by the rod's own stamps.
    pub(in crate::recording::read) at: Timestamp,
    /// Times up to which each rod had been read by then.
    pub(in crate::recording::read) reached: Reached,
    /// Name of the file that holds its last sample, where several are read as one.
    pub(super) origin: Option<Arc<str>>,
}

impl Timed {
    /// Number of records in it: one, or zero for temperatures alone.
    pub(in crate::recording::read) fn records(&self) -> u64 {
        u64::from(!matches!(self.event, Event::Readings { .. }))
    }

    /// Bytes of the samples of events.
    pub(in crate::recording::read) fn bytes<'a>(events: impl IntoIterator<Item = &'a Self>) -> usize {
        8 * events
            .into_iter()
            .map(|timed| timed.event.samples())
            .sum::<usize>()
    }

    /// Returns the event with the place at which it was complete.
    pub(in crate::recording::read) fn at_place(
        self,
        file: Arc<str>,
        bytes: u64,
        records: u64,
    ) -> (Event, Place) {
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
