//! A daemon at work: its threads, and how they are begun, given another configuration, and ended.

use super::core::{Broken, Core, Word};
use super::pipe::{self, Ending, JOBS};
use super::stand_in::Reader;
use super::suspects::Suspects;
use super::workers::Workers;
use super::{Generation, Happening, Job, Options, restart};
use crate::pipeline::message_of;
use crate::site::Site;
use crate::telemetry::Health;
use anyhow::Context;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// How long what is in the pipeline may take to come to its end.
const DRAIN: Duration = Duration::from_secs(4);
/// How often the pipeline is ticked.
const TICK: Duration = Duration::from_secs(1);
/// A daemon at work.
pub struct Running {
    generation: Arc<Generation>,
    reader: Reader,
    suspects: Arc<Suspects>,
    ending: Ending,
}

impl Running {
    /// Begins everything.
    ///
    /// # Errors
    /// What stands beside the store cannot be read, or the system gives no thread.
    pub fn start(
        generation: Arc<Generation>,
        site: Site,
        options: &Options,
        health: Arc<Health>,
        tell: Sender<Happening>,
    ) -> anyhow::Result<Self> {
        let store = site.store().path().to_owned();
        let suspects = Suspects::open(&store)
            .with_context(|| format!("{}: what stands beside it cannot be read", store.display()))?;
        let suspects = Arc::new(suspects);
        let marks = site.store().files()?;
        let workers = Workers::new(site.store().all_known().clone(), Arc::clone(&suspects));
        let ending = Ending::default();
        let (jobs, receiver) = sync_channel(JOBS);
        let mut core = Core::new(
            site,
            Arc::clone(&generation),
            health,
            Arc::clone(&ending.drain),
            Box::new(hear),
        );
        let threads = options
            .threads
            .unwrap_or_else(|| thread::available_parallelism().map_or(1, usize::from));
        let ended = ending.clone();
        let work = move || {
            let work = || pipe::run(receiver, threads, &workers, &mut core, &ended);
            let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
                ended.drain.store(true, Ordering::Relaxed);
                Err(Broken::Panicked(message_of(&*panic)))
            });
            // The store is closed before anybody hears of the end.
            drop(core);
            let _ = tell.send(Happening::Ended(result));
        };
        thread::Builder::new().name("core".to_owned()).spawn(work)?;
        let caught_up: Arc<AtomicBool> = Arc::default();
        tick(jobs.clone(), Arc::clone(&caught_up))?;
        let reader = Reader::start(marks, Arc::clone(&generation), jobs, caught_up)?;
        Ok(Self {
            generation,
            reader,
            suspects,
            ending,
        })
    }

    /// Goes on with another configuration from the next event on.
    pub fn reload(&mut self, generation: Arc<Generation>) {
        for key in restart::needed_for(&self.generation.config, &generation.config) {
            tracing::warn!("{key} changed: it holds after a restart, the old one until then");
        }
        self.reader.reload(Arc::clone(&generation));
        self.generation = generation;
    }

    /// Whether everything that is to run does.
    ///
    /// # Errors
    /// The reader ended by itself: nothing would be read any more.
    pub fn check(&self) -> Result<(), Broken> {
        if self.reader.is_finished() && !self.ending.drain.load(Ordering::Relaxed) {
            return Err(Broken::Panicked("the reader ended by itself".to_owned()));
        }
        Ok(())
    }

    /// Stops reading, lets what was read come to its end, and closes the store; what takes too long is read again at the
    /// next start.
    ///
    /// # Errors
    /// The core could not go on.
    pub fn drain(self, happenings: &Receiver<Happening>) -> Result<(), Broken> {
        let deadline = Instant::now() + DRAIN;
        self.ending.drain.store(true, Ordering::Relaxed);
        self.suspects.stand_down();
        self.reader.stop();
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match happenings.recv_timeout(left) {
                Ok(Happening::Ended(result)) => return result,
                Ok(_) => {}
                Err(_) => {
                    tracing::warn!("some records are still analysed: they are read again at the next start");
                    self.ending.give_up.store(true, Ordering::Relaxed);
                    return Ok(());
                }
            }
        }
    }

    /// The work loop came to its end by itself.
    pub fn abandon(self) {
        self.suspects.stand_down();
        self.reader.stop();
    }
}

/// Sends a tick through the whole pipeline every second; a full channel makes it late, which is what it is to show.
fn tick(jobs: SyncSender<Job>, caught_up: Arc<AtomicBool>) -> std::io::Result<()> {
    let work = move || {
        loop {
            let is_caught_up = caught_up.load(Ordering::Relaxed);
            if jobs.send(Job::Tick { is_caught_up }).is_err() {
                return;
            }
            thread::sleep(TICK);
        }
    };
    thread::Builder::new().name("tick".to_owned()).spawn(work)?;
    Ok(())
}

/// What the core says.
fn hear(word: Word<'_>) {
    match word {
        Word::Reloaded(generation) => {
            tracing::info!("configuration {} holds", generation.provenance().hash);
        }
        Word::File(mark) => tracing::info!("{} is read", mark.name),
        Word::Alive | Word::News | Word::Known(_) | Word::Taken { .. } => {}
    }
}
