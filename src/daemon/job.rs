//! What passes through the daemon's pipeline, in order: everything that changes the store is one of these.

use super::Generation;
use crate::ordered::Reached;
use crate::record::Event;
use crate::source::{SourceError, Summary};
use crate::step::Place;
use crate::store::{Carry, FileMark};
use std::sync::Arc;

/// One item of work.
pub enum Job {
    /// An event of a source, to be analysed by the configuration it was cut with.
    Event {
        /// The event.
        event: Event,
        /// Where its source then stands.
        place: Place,
        /// The configuration.
        generation: Arc<Generation>,
    },
    /// A file was read to its end: every event of it came before.
    File {
        /// What to remember of it; `None` for one that may still grow.
        mark: Option<FileMark>,
        /// What it held, or why it could not be read.
        result: Result<Summary, SourceError>,
        /// What its journal leaves for the next part.
        carry: Option<Carry>,
    },
    /// A new configuration holds from here on.
    Reload(Arc<Generation>),
    /// A sink has all news up to this number.
    Delivered {
        /// The sink's id.
        sink: String,
        /// The number.
        through: i64,
    },
    /// The sources have nothing more at this moment, and this is how far the rods have been followed: no event that was
    /// read before need wait for a rod that is silent.
    Look(Reached),
    /// Time to look at the clock, at requests, and at what is too old to keep.
    Tick {
        /// Whether the reader had read everything there was when this was sent: only then is silence a silence.
        is_caught_up: bool,
    },
}
