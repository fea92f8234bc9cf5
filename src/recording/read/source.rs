//! The one way records are read: a recording, a journal, a folder and many of them side by side all bring events step by step.

use super::Place;
use crate::analysis::signal::record::Event;
use std::sync::Arc;

/// One step of reading. `F` is what is told of a file that was read to its end.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "one at a time, moved on at once")]
pub enum Step<F> {
    /// An event, and where its file then stands.
    Event(Event, Place),
    /// The end of one of its files; every event of it came before.
    File(F),
    /// Nothing yet; there is more to read.
    More,
    /// Nothing yet, and nothing to read now; it may grow.
    Wait,
    /// The end.
    End,
}

/// Something records are read from, a step at a time: at most one record is read, or some way into one chunk.
pub trait Source {
    /// What is told of a file that was read to its end.
    type File;

    /// The next step.
    fn poll(&mut self) -> Step<Self::File>;

    /// The file that is read, and where in it the next step goes on \[bytes\]; `None` between two files.
    fn position(&self) -> Option<(Arc<str>, u64)>;

    /// Ends the file that is read here; its last events are still to be taken.
    fn abandon(&mut self, why: &str);

    /// Ends the file that is read as if nothing of it had been read; events of it that were not taken are lost.
    fn discard(&mut self, why: &str);
}
