//! The one driver of replay and daemon: jobs of a source, analysed on several threads, taken in the order of event time.
//!
//! They differ in where jobs come from (recordings; a channel from the reader's thread) and in the receiver
//! of the output.

mod bench;
mod held;
mod job;

pub use held::Held;
pub use job::{Done, Job, Load, Loads};

use super::analyse::{Known, analyse_by};
use super::ordered_map::{Limits, map_in_order};
use crate::analysis::identify::{Identification, Plan, Refusal};
use crate::analysis::signal::record::{Event, Record};
use bench::Bench;
use std::ops::ControlFlow;

/// Receiver of the driver's output, on the thread that runs it.
pub trait Taker {
    /// Takes items that became ready together, in their order; may end the run.
    fn take(&mut self, group: Vec<Done>) -> ControlFlow<()>;

    /// Reports a job whose work panicked outside the analysis.
    fn lost(&mut self, panic: &str);
}

/// Runs until there are no more jobs or the taker ends the run. The load of a record is its number of
/// samples; records are analysed at once as far as their samples fit on the bench.
pub fn run(
    jobs: impl Iterator<Item = Job> + Send,
    limits: Limits,
    work: impl Fn(Job) -> Done + Sync,
    taker: &mut impl Taker,
) {
    let weigh = |job: &Job| match job {
        Job::Event {
            event: event @ (Event::Record(_) | Event::Moment(_)),
            ..
        } => event.samples(),
        _ => 1,
    };
    let bench = Bench::default();
    let work = |job: Job| {
        let _place = bench.take(weigh(&job));
        work(job)
    };
    map_in_order(jobs, limits, weigh, work, |results| {
        let mut group = Vec::with_capacity(results.len());
        for result in results {
            match result {
                Ok(done) => group.push(done),
                Err(panic) => taker.lost(&panic),
            }
        }
        taker.take(group)
    });
}

/// Does the part of a job that need not wait for its turn: analyses an event's record, unless it is one of
/// `known`.
pub fn work(job: Job, known: &Known) -> Done {
    work_by(job, known, Plan::run)
}

/// [`work`] for a source of which some records are `known`.
pub fn knowing(known: &Known) -> impl Fn(Job) -> Done + Sync {
    |job| work(job, known)
}

/// [`work`] with a way of its own to run a record through its plan, which gives the same.
pub fn work_by(
    job: Job,
    known: &Known,
    run: impl Fn(&Plan, &Record) -> Result<Identification, Refusal>,
) -> Done {
    match job {
        Job::Event {
            event,
            place,
            plans,
            load,
        } => {
            let analysed = analyse_by(event, &plans, known, run);
            drop(load);
            Done::Event(analysed, place)
        }
        other => Done::Job(other),
    }
}
