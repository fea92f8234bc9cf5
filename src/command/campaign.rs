//! Runs recorded campaigns through the plans: every record's outcome in order, with losses reported.

use super::BadArguments;
use super::foreign;
use super::progress::Progress;
use super::tally::Tally;
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{RodChannels, RodId, is_one_motion};
use crate::config::Config;
use crate::recording::read::{self, Recordings, SourceError, Step};
use crate::site::analyse::{Analysed, LastSeen};
use crate::site::driver::{self, Done, Held, Job, Taker};
use crate::site::motion;
use crate::site::ordered_map::Limits;
use crate::site::overlap::{Change, Overlaps};
use crate::site::prepared::Plans;
use crate::site::records::{AnyFile, Others, in_order};
use crate::site::store::Position;
use crate::site::trackers::Taken;
use std::collections::{BTreeMap, HashSet};
use std::io;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Instant;

/// Most samples of records in memory between reading and analysis (8 bytes each).
const SAMPLES_IN_FLIGHT: usize = 2 << 20;

/// Latest motions of a rod that another file's record is compared with.
const REMEMBERED: usize = 4096;

/// Options for reading recordings.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct Reading {
    /// Number of threads that analyse records, besides the reader's; default: one per core. Results are
    /// bit-identical for any number.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,

    /// Keep reading a recording that is still being written, until it is finished.
    #[arg(long)]
    pub follow: bool,
}

impl Reading {
    /// Number of threads that analyse records.
    pub fn workers(&self) -> usize {
        let of_machine = || thread::available_parallelism().map_or(1, usize::from);
        self.threads.map_or_else(of_machine, usize::from)
    }
}

/// Fate of an event.
pub enum Became {
    /// It was there before.
    Known,
    /// It is new.
    New,
    /// It is new, and its motion has a row already.
    Late(Box<Outcome>),
}

impl Became {
    /// Of a record that a site took, if it did.
    pub fn of(taken: Option<Taken>) -> Self {
        match taken {
            None => Self::Known,
            Some(Taken { late: None, .. }) => Self::New,
            Some(Taken { late: Some(late), .. }) => Self::Late(Box::new(late)),
        }
    }
}

/// Takes the result of an event, its position in the recording if it has one, and the record of its rod that passed before.
pub trait OnEvent:
    FnMut(&Analysed, Option<Position<'_>>, Option<[u8; 32]>, &Progress) -> anyhow::Result<Became>
{
}

impl<F> OnEvent for F where
    F: FnMut(&Analysed, Option<Position<'_>>, Option<[u8; 32]>, &Progress) -> anyhow::Result<Became>
{
}

/// Runs every record of `paths` (files, or folders of them) through its rod's plan and hands the results to
/// `on_event` in the order of event time; `work` does what needs no order. Reports losses on stderr. `None` if the reader of stdout has seen
/// enough (`| head`). A record with the same data as one before (a copied or renamed file), or one of
/// `known`, is counted and left out.
///
/// # Errors
/// `on_event` failed.
pub fn run(
    paths: &[PathBuf],
    config: &Config,
    plans: &Arc<Plans>,
    reading: &Reading,
    others: Others,
    work: impl Fn(Job) -> Done + Sync,
    on_event: impl OnEvent,
) -> anyhow::Result<Option<Tally>> {
    let files = in_order(read::recordings(paths), &others.how);
    if others.how.start.is_some() && files.len() > 1 {
        let why = "--start says when one file began, and several are given: replay them one by one, or `tirante import` each with its own \
                   --start and replay the recordings together";
        return Err(BadArguments(why.to_owned()).into());
    }
    let (bar, total) = Progress::of_files(&files);
    let done = Arc::new(AtomicU64::new(0));
    let channels: Vec<RodChannels> = config.rods.iter().map(|rod| rod.channels.clone()).collect();
    let (is_meant, needs_all) = (others.is_meant, others.needs_all);
    let opener = AnyFile::new(others, channels.clone(), config.record, foreign::watch);
    let input =
        Recordings::new(files, channels, config.record, reading.follow, Arc::clone(&done)).opened_by(opener);
    let workers = reading.workers();

    let held = Held::new(config.track.reorder_window_s);
    let mut delivery = Delivery {
        on_event,
        // With a growing recording, no rod waits for another.
        held: if reading.follow { held.impatient() } else { held },
        read: done,
        total,
        is_meant,
        needs_all,
        bar: &bar,
        tally: Tally::default(),
        seen: HashSet::new(),
        passed: LastSeen::default(),
        overlaps: Overlaps::default(),
        motions: BTreeMap::new(),
        failure: None,
    };
    let jobs = input.filter_map(|step| match step {
        Step::Event(event, place) => Some(Job::Event {
            event,
            place,
            plans: Arc::clone(plans),
            load: None,
        }),
        Step::File(result) => Some(Job::Files {
            marks: Vec::new(),
            results: vec![result],
            carry: Vec::new(),
        }),
        Step::More | Step::Wait | Step::End => None,
    });
    let limits = Limits {
        workers,
        weight: SAMPLES_IN_FLIGHT,
    };
    driver::run(jobs, limits, work, &mut delivery);
    if delivery.failure.is_none() {
        let rest = delivery.held.rest();
        // The error, if any, is in `failure`.
        let _ = rest.into_iter().try_for_each(|done| delivery.done(done));
    }
    let Delivery {
        mut tally, failure, ..
    } = delivery;
    if is_meant {
        tally.compare(config, &bar);
    }
    drop(bar);
    match failure {
        Some(error) if is_broken_pipe(&error) => Ok(None),
        Some(error) => Err(error),
        None => Ok(Some(tally)),
    }
}

/// Passes on the results of events and counts them.
struct Delivery<'a, F> {
    on_event: F,
    held: Held,
    /// Number of bytes read so far, and in total.
    read: Arc<AtomicU64>,
    total: u64,
    is_meant: bool,
    needs_all: bool,
    bar: &'a Progress,
    tally: Tally,
    /// Identities of the records of this run.
    seen: HashSet<[u8; 32]>,
    passed: LastSeen,
    overlaps: Overlaps,
    /// Motions of rods with several sensors that have a row in this run.
    motions: BTreeMap<RodId, Vec<motion::Span>>,
    failure: Option<anyhow::Error>,
}

impl<F: OnEvent> Taker for Delivery<'_, F> {
    fn take(&mut self, group: Vec<Done>) -> ControlFlow<()> {
        self.bar.set(self.read.load(Ordering::Relaxed), self.total);
        let mut going = self.held.take(group, Instant::now()).into_iter();
        going.try_for_each(|done| self.done(done))
    }

    fn lost(&mut self, panic: &str) {
        self.tally.lose(panic, self.bar);
    }
}

impl<F: OnEvent> Delivery<'_, F> {
    /// Refuses what a rod's sensors in files of their own have of a motion that has its row.
    fn once(&mut self, analysed: Analysed) -> Analysed {
        let Analysed::Record(outcome) = &analysed else {
            return analysed;
        };
        let (Some(span), Some(identity)) = (motion::span(outcome), outcome.identity()) else {
            return analysed;
        };
        if self.seen.contains(&identity) {
            return analysed;
        }
        let motions = self.motions.entry(outcome.rod().clone()).or_default();
        if motions
            .iter()
            .rev()
            .take(REMEMBERED)
            .any(|known| is_one_motion(*known, span))
        {
            return Analysed::Record(Box::new(motion::late(outcome)));
        }
        motions.push(span);
        analysed
    }

    fn done(&mut self, done: Done) -> ControlFlow<()> {
        let (analysed, place) = match done {
            Done::Event(analysed, place) => (analysed, place),
            Done::Job(Job::Files { results, .. }) => {
                for result in results {
                    match result {
                        Err(error @ SourceError::Io { .. }) if self.needs_all => {
                            self.failure = Some(error.into());
                            return ControlFlow::Break(());
                        }
                        result => self.tally.file(&result, self.is_meant, self.bar),
                    }
                }
                return ControlFlow::Continue(());
            }
            Done::Job(_) => return ControlFlow::Continue(()),
        };
        let before = self.passed.pass(&analysed);
        let analysed = self.once(analysed);
        let is_repeated = match &analysed {
            Analysed::Known(..) => true,
            Analysed::Record(outcome) => outcome
                .identity()
                .is_some_and(|identity| !self.seen.insert(identity)),
            Analysed::Readings(..) => false,
        };
        let became = match is_repeated {
            true => Became::Known,
            false => match (self.on_event)(&analysed, Some((&place).into()), before, self.bar) {
                Ok(became) => became,
                Err(error) => {
                    self.failure = Some(error);
                    return ControlFlow::Break(());
                }
            },
        };
        self.tally.event(&analysed, &became, self.bar);
        if let (Analysed::Record(outcome), Became::New) = (&analysed, &became)
            && let Some(Change::Begins(sentence)) = self.overlaps.take(outcome, &place.origin)
        {
            self.tally.overlap(outcome.rod(), &sentence, self.bar);
        }
        ControlFlow::Continue(())
    }
}

/// True if the reader of stdout has seen enough.
pub fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<io::Error>()
        .is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}
