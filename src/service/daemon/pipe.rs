//! The pipeline: jobs from a bounded channel, analysed on several threads, taken by the core in their order.

use super::core::{Core, CoreError};
use super::workers::Workers;
use crate::site::driver::{self, Done, Job, Taker};
use crate::site::ordered_map::Limits;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

/// Capacity of the channel between reader and pipeline \[jobs\]; small, since each may be a record of
/// millions of samples.
pub const JOBS: usize = 4;
/// Samples of records in the pipeline (8 bytes each); a larger record is processed alone.
const SAMPLES_IN_FLIGHT: usize = 2 << 20;
/// Interval at which an idle pipeline checks if it is to end.
const LOOK: Duration = Duration::from_millis(50);

/// Flags that end a pipeline from outside.
#[derive(Debug, Clone, Default)]
pub struct Ending {
    /// Ends after the jobs in the channel.
    pub drain: Arc<AtomicBool>,
    /// Ends after the current item.
    pub give_up: Arc<AtomicBool>,
}

/// Runs until it is ended.
///
/// # Errors
/// The core cannot go on.
pub fn run(
    jobs: Receiver<Job>,
    threads: usize,
    workers: &Workers,
    core: &mut Core,
    ending: &Ending,
) -> Result<(), CoreError> {
    let drain = Arc::clone(&ending.drain);
    let input = std::iter::from_fn(move || {
        loop {
            match jobs.recv_timeout(LOOK) {
                Ok(job) => return Some(job),
                Err(RecvTimeoutError::Timeout) if !drain.load(Ordering::Relaxed) => {}
                Err(_) => return None,
            }
        }
    });
    let limits = Limits {
        workers: threads,
        weight: SAMPLES_IN_FLIGHT,
    };
    let mut taker = Taking {
        core,
        ending,
        broken: None,
    };
    driver::run(input, limits, |job| workers.work(job), &mut taker);
    if taker.broken.is_none()
        && let Err(error) = taker.core.end()
    {
        tracing::warn!("the end of the daemon's work is not in the store: {error}");
    }
    match taker.broken {
        // The core stopped on request: data not stored are read again.
        None | Some(CoreError::Stopping) => Ok(()),
        Some(error) => Err(error),
    }
}

/// Passes the driver's output to the core, until the core fails or is told to end.
struct Taking<'a> {
    core: &'a mut Core,
    ending: &'a Ending,
    broken: Option<CoreError>,
}

impl Taker for Taking<'_> {
    fn take(&mut self, group: Vec<Done>) -> ControlFlow<()> {
        if self.ending.give_up.load(Ordering::Relaxed) {
            return ControlFlow::Break(());
        }
        if let Err(error) = self.core.take(group) {
            self.broken = Some(error);
            // Otherwise the input would wait for jobs that are never taken.
            self.ending.drain.store(true, Ordering::Relaxed);
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }

    fn lost(&mut self, panic: &str) {
        self.core.lost(panic);
    }
}
