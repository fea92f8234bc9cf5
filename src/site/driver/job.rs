//! What passes through the driver, in order: everything that changes the store is one of these.

use crate::analysis::signal::record::Event;
use crate::analysis::track::ordered::Reached;
use crate::recording::read::Place;
use crate::recording::read::recordings::FileResult;
use crate::site::analyse::Analysed;
use crate::site::prepared::{Generation, Plans};
use crate::site::store::{Carry, FileMark};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most samples of records between the reader and the end of their analysis (8 bytes each); a record with more goes alone.
const SAMPLES: usize = 2 << 20;

/// Samples of all records between the reader and the end of their analysis.
#[derive(Debug, Clone, Default)]
pub struct Loads(Arc<AtomicUsize>);

/// A record's samples among all of them, until it is dropped.
#[derive(Debug)]
pub struct Load {
    all: Loads,
    samples: usize,
}

impl Loads {
    /// Takes so many samples more; nothing while there is no room for them.
    pub fn take(&self, samples: usize) -> Option<Load> {
        // Only the reader adds to it.
        let held = self.0.load(Ordering::Acquire);
        if held > 0 && held + samples > SAMPLES {
            return None;
        }
        self.0.fetch_add(samples, Ordering::AcqRel);
        Some(Load {
            all: self.clone(),
            samples,
        })
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.all.0.fetch_sub(self.samples, Ordering::AcqRel);
    }
}

/// One item of work.
pub enum Job {
    /// An event of a source, to be analysed by the plans of the configuration it was cut with.
    Event {
        /// The event.
        event: Event,
        /// Where its source then stands.
        place: Place,
        /// The plans.
        plans: Arc<Plans>,
        /// What it weighs, until it is analysed, where that is bounded.
        load: Option<Load>,
    },
    /// A file was read to its end: every event of it came before.
    File {
        /// What to remember of it; `None` for one that may still grow.
        mark: Option<FileMark>,
        /// What it held, or why it could not be read.
        result: FileResult,
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

/// What comes out of the driver.
pub enum Done {
    /// What came of an event.
    Event(Analysed, Place),
    /// A job that needs no analysis.
    Job(Job),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heavy_record_goes_alone() {
        let loads = Loads::default();
        let heavy = loads.take(SAMPLES + 1).unwrap();
        assert!(loads.take(1).is_none());
        drop(heavy);
        let all = loads.take(SAMPLES).unwrap();
        assert!(loads.take(0).is_some() && loads.take(1).is_none());
        drop(all);
        assert!(loads.take(1).is_some());
    }
}
