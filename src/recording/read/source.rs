//! The one interface for reading records: a recording, a journal, a folder and several of them side by side
//! all return events step by step.

use super::Place;
use std::sync::Arc;
use tirante_analysis::signal::record::Event;

/// Result of one step of reading. `F`: data about a file that was read to its end.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "one at a time, moved on at once")]
pub enum Step<F> {
    /// An event, with the position of its file after it.
    Event(Event, Place),
    /// The end of one of the source's files, after all its events.
    File(F),
    /// Nothing yet; there is more to read.
    More,
    /// No event, and nothing to read at present; the file may grow.
    Wait,
    /// The end.
    End,
}

/// A source of records, read in steps: a step reads at most one record, or part of one chunk.
pub trait Source {
    /// Data about a file that was read to its end.
    type File;

    /// Takes the next step.
    fn poll(&mut self) -> Step<Self::File>;

    /// File being read and offset of the next step in it \[bytes\]; `None` between two files.
    fn position(&self) -> Option<(Arc<str>, u64)>;

    /// Ends the current file here; its last events can still be taken.
    fn abandon(&mut self, why: &str);

    /// Ends the current file as if none of it had been read; events not yet taken are lost.
    fn discard(&mut self, why: &str);
}
