//! Items that pass through the driver, in order. Every change of the store is one of these.

use crate::analysis::signal::record::Event;
use crate::analysis::track::ordered::Reached;
use crate::recording::read::Place;
use crate::recording::read::recordings::FileResult;
use crate::site::analyse::Analysed;
use crate::site::prepared::{Generation, Plans};
use crate::site::store::{Carry, FileMark};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most samples of records between the reader and the end of their analysis (8 bytes each); a larger record
/// is processed alone.
const SAMPLES: usize = 2 << 20;

/// Number of samples of all records between the reader and the end of their analysis.
#[derive(Debug, Clone, Default)]
pub struct Loads(Arc<AtomicUsize>);

/// Share of a record in that number, until dropped.
#[derive(Debug)]
pub struct Load {
    all: Loads,
    samples: usize,
}

impl Loads {
    /// True if nothing is between the reader and the end of its analysis.
    pub fn are_none(&self) -> bool {
        self.0.load(Ordering::Acquire) == 0
    }

    /// Reserves room for `samples` samples; `None` while there is no room.
    pub fn take(&self, samples: usize) -> Option<Load> {
        // An event without samples is work as well.
        let samples = samples.max(1);
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
    /// An event of a source, to be analysed with the plans of the configuration that cut it.
    Event {
        /// The event.
        event: Event,
        /// Position of its source after it.
        place: Place,
        /// Plans of the rods.
        plans: Arc<Plans>,
        /// Share of the bounded memory that the event takes until it is analysed; `None` where memory is not
        /// bounded.
        load: Option<Load>,
    },
    /// Files were read to their ends: all their events came before.
    Files {
        /// Marks to store; none for a file that may still grow.
        marks: Vec<FileMark>,
        /// Summaries of the files, or the errors that prevented reading.
        results: Vec<FileResult>,
        /// Open samples that they leave for the next part or file, or that are left no more.
        carry: Vec<Carry>,
    },
    /// A new configuration is in force from here on.
    Reload(Arc<Generation>),
    /// A sink has all events up to this number.
    Delivered {
        /// Id of the sink.
        sink: String,
        /// Number of the latest event delivered.
        through: i64,
    },
    /// The sources have no more data now; with the times up to which the rods have been read. Earlier events
    /// need not wait for a silent rod.
    Look(Reached),
    /// Time to check the clock, requests, and retention.
    Tick {
        /// True if the reader had read all data when this was sent: only then does silence mean missing data.
        is_caught_up: bool,
    },
}

/// Output of the driver.
pub enum Done {
    /// Result of an event.
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
        assert!(loads.take(0).is_none() && loads.take(1).is_none());
        assert!(!loads.are_none());
        drop(all);
        assert!(loads.are_none() && loads.take(1).is_some());
    }
}
