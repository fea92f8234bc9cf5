//! The reader's thread: turns the journal and the watched folder into jobs.
//!
//! When it stops, data not committed yet is left to be read again at the next start.

mod turns;

use self::turns::Work;
pub use super::remembered::{JOURNAL, Remembered};
use super::supervision::Watch;
use crate::service::journal::{self, Bell};
use crate::service::telemetry::{Beat, Health};
use crate::service::viewer::Signals;
use crate::site::driver::{Job, Loads};
use crate::site::prepared::Generation;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Sender, SyncSender, channel};
use std::thread::{self, JoinHandle};

/// Sources to read.
pub struct Sources {
    /// Watched folder, if any.
    pub folder: Option<PathBuf>,
    /// True if the folders below it are watched too.
    pub subfolders: bool,
    /// Time without growth after which a recording counts as cut short \[s\].
    pub settle_s: f64,
    /// Time for which open samples at the end of a recording wait for the one that goes on there \[s\].
    pub join_s: f64,
    /// Journal to read, if any.
    pub journal: Option<JournalSource>,
}

/// The journal to read.
pub struct JournalSource {
    /// Folder of the journal.
    pub folder: PathBuf,
    /// Handle of its writer: a change of the configuration begins a new part.
    pub handle: journal::Handle,
    /// Shared number of [`journal::Journal::results_kept`]: set at the start to the last part in the store.
    pub results_kept: Arc<AtomicU32>,
    /// Receiver of its samples, for viewers.
    pub signals: Arc<Signals>,
}

/// Everything that the reader works with.
pub struct Surroundings {
    /// Queue of its jobs.
    pub jobs: SyncSender<Job>,
    /// Receiver of faults.
    pub health: Arc<Health>,
    /// Bell that wakes it: the journal's, or any.
    pub bell: Arc<Bell>,
    /// True if no present data waits to be read; false again while finished recordings do.
    pub caught_up: Arc<AtomicBool>,
    /// Share of its events in the pipeline.
    pub loads: Loads,
    /// Its own beat: a step that never ends, or a disk that does not answer, is seen by it.
    pub beat: Arc<Beat>,
    /// Notes the step it works on.
    pub watch: Box<dyn Watch>,
}

/// The reader's thread.
#[derive(Debug)]
pub struct Reader {
    reloads: Sender<Arc<Generation>>,
    stop: Arc<AtomicBool>,
    bell: Arc<Bell>,
    thread: Option<JoinHandle<()>>,
}

impl Reader {
    /// Starts the reader.
    ///
    /// # Errors
    /// There is no thread for it.
    pub fn start(
        sources: Sources,
        remembered: Remembered,
        generation: Arc<Generation>,
        around: Surroundings,
    ) -> io::Result<Self> {
        let (reloads, receiver) = channel();
        let stop = Arc::<AtomicBool>::default();
        let bell = Arc::clone(&around.bell);
        let work = Work::new(sources, &remembered, generation, around, Arc::clone(&stop));
        let thread = thread::Builder::new()
            .name("reader".to_owned())
            .spawn(move || work.run(&receiver))?;
        Ok(Self {
            reloads,
            stop,
            bell,
            thread: Some(thread),
        })
    }

    /// Takes a new configuration. Records are cut by it from the next part of the journal on; files not read
    /// to their end are begun again, if it changes how records are cut. A [`Job::Reload`] marks where it
    /// takes effect.
    pub fn reload(&self, generation: Arc<Generation>) {
        // A reader that stopped needs no configuration.
        let _ = self.reloads.send(generation);
        self.bell.ring();
    }

    /// Asks it to stop; what it waits for is waited for by [`Reader::stop`].
    pub fn ask_to_stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
        self.bell.ring();
    }

    /// Stops, without finishing anything.
    pub fn stop(mut self) {
        self.halt();
    }

    /// True if its thread ended; by itself if [`Reader::stop`] was not called.
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    fn halt(&mut self) {
        self.ask_to_stop();
        if let Some(thread) = self.thread.take() {
            // A panic there has already been reported by the panic hook.
            let _ = thread.join();
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.halt();
    }
}
