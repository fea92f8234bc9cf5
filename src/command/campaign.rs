//! Runs recorded campaigns through the plans: every record's outcome in order, with losses reported and all
//! counted.

use super::foreign;
use super::progress::Progress;
use super::topics::{Differences, Topics};
use super::{BadArguments, WITH_LOSSES};
use crate::analysis::identify::{LeftOut, Sensors};
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{Rejection, RodChannels, RodId, Timestamp, is_one_motion};
use crate::config::Config;
use crate::recording::read::{self, Recordings, SourceError, Step, Summary};
use crate::site::analyse::{Analysed, LastSeen};
use crate::site::driver::{self, Done, Held, Job, Taker};
use crate::site::motion;
use crate::site::ordered_map::Limits;
use crate::site::overlap::{Change, Overlaps};
use crate::site::prepared::Plans;
use crate::site::records::{AnyFile, Others, in_order};
use crate::site::store::Position;
use crate::site::trackers::Taken;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fmt::{self, Display};
use std::io;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;
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

/// Reports the result of a campaign on stderr and returns the exit code.
pub fn conclude(tally: Option<Tally>) -> ExitCode {
    tally.map_or(ExitCode::SUCCESS, |tally| {
        tell!("{tally}");
        tally.exit_code()
    })
}

/// Result of a campaign.
#[derive(Debug, Default)]
pub struct Tally {
    identified: usize,
    rejected: BTreeMap<&'static str, usize>,
    repeated: usize,
    broken: usize,
    /// Events of which nothing is known but that the program broke on them.
    lost: usize,
    files: usize,
    unreadable: usize,
    with_losses: usize,
    /// Records that a sensor was left out of, by rod and sensor.
    without: BTreeMap<(RodId, String), usize>,
    /// Sensors that each rod's latest record left out.
    out_now: BTreeMap<RodId, BTreeSet<String>>,
    topics: Topics,
    differences: Differences,
    /// Rods whose records overlap in time.
    overlapping: BTreeSet<RodId>,
}

impl Tally {
    /// Exit code: 0 good, 1 nothing could be read or the analysis failed, 3 rejected records or lost data.
    fn exit_code(&self) -> ExitCode {
        if self.broken > 0 || (self.files > 0 && self.unreadable == self.files) {
            ExitCode::FAILURE
        } else if !self.rejected.is_empty()
            || self.unreadable > 0
            || self.with_losses > 0
            || !self.without.is_empty()
            || !self.differences.misspelt.is_empty()
            || self.differences.is_all
            || !self.overlapping.is_empty()
        {
            ExitCode::from(WITH_LOSSES)
        } else {
            ExitCode::SUCCESS
        }
    }
}

/// A number with its noun: `1 record`, `2 records`.
fn counted(number: usize, noun: &str) -> String {
    format!("{number} {noun}{}", if number == 1 { "" } else { "s" })
}

impl Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rejected: usize = self.rejected.values().sum();
        let records = self.identified + rejected + self.repeated + self.broken;
        write!(f, "{}", counted(records, "record"))?;
        if self.files > 0 {
            write!(f, " from {}", counted(self.files, "file"))?;
        }
        write!(f, ": {} identified", self.identified)?;
        if rejected > 0 {
            let reasons: Vec<String> = self
                .rejected
                .iter()
                .map(|(code, count)| format!("{count} {code}"))
                .collect();
            write!(f, ", {rejected} rejected ({})", reasons.join(", "))?;
        }
        if self.repeated > 0 {
            write!(
                f,
                ", {} left out (the same data as one before, or in the store)",
                self.repeated
            )?;
        }
        if self.broken > 0 {
            write!(f, ", {} broke the program (please report)", self.broken)?;
        }
        if self.unreadable > 0 {
            write!(f, ", {} could not be read", counted(self.unreadable, "file"))?;
        }
        if self.with_losses > 0 {
            write!(f, ", {} with lost data", counted(self.with_losses, "file"))?;
        }
        for ((rod, sensor), count) in &self.without {
            write!(f, ", {} of rod {rod} without {sensor}", counted(*count, "record"))?;
        }
        for rod in &self.overlapping {
            write!(f, ", overlapping records of rod {rod}")?;
        }
        match &self.differences.absent[..] {
            [] => {}
            [rod] => write!(f, ", nothing of rod {rod}")?,
            rods => write!(f, ", nothing of rods {}", rods.join(", "))?,
        }
        Ok(())
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
        tally.differences = tally.topics.compare(config);
        for sentence in &tally.differences.misspelt {
            bar.say(&format!("warning: {sentence}"));
        }
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
        self.tally.broken += 1;
        self.tally.lost += 1;
        self.bar
            .say(&format!("error: the program broke on one event ({panic})"));
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
            self.bar.say(&format!("warning: {sentence}"));
            self.tally.overlapping.insert(outcome.rod().clone());
        }
        ControlFlow::Continue(())
    }
}

impl Tally {
    /// Counts an event.
    pub fn event(&mut self, analysed: &Analysed, became: &Became, bar: &Progress) {
        match (analysed, became) {
            (Analysed::Readings(..), _) => {}
            (Analysed::Record(outcome), Became::New) => self.count(outcome, bar),
            (Analysed::Record(_), Became::Late(late)) => self.count(late, bar),
            _ => self.repeated += 1,
        }
    }

    /// Counts a new record.
    fn count(&mut self, outcome: &Outcome, bar: &Progress) {
        if let Some(sensors) = outcome.sensors() {
            self.leave_out(outcome.rod(), outcome.start(), sensors, bar);
        }
        match outcome {
            Outcome::Identified(_) | Outcome::Tabulated(_) => self.identified += 1,
            Outcome::Rejected(rejected) if matches!(rejected.rejection, Rejection::Broken { .. }) => {
                self.broken += 1;
                bar.say(&format!("error: rod {}: {}", rejected.rod, rejected.rejection));
            }
            Outcome::Rejected(rejected) => {
                *self.rejected.entry(rejected.rejection.code()).or_default() += 1;
            }
        }
    }

    /// Counts the sensors that a record leaves out; one that the rod's record before had is told.
    fn leave_out(&mut self, rod: &RodId, start: Option<Timestamp>, sensors: &Sensors, bar: &Progress) {
        // What is refused of one sensor is no moment of the rod: that has a row of its own.
        if sensors.is_of_one() {
            return;
        }
        let before = self.out_now.remove(rod).unwrap_or_default();
        for LeftOut { sensor, why } in &sensors.left_out {
            *self.without.entry((rod.clone(), sensor.clone())).or_default() += 1;
            if !before.contains(sensor) {
                let from = start.map_or_else(String::new, |start| format!(", from {start} on"));
                bar.say(&format!(
                    "warning: rod {rod}{from}: sensor {sensor} left out: {why}"
                ));
            }
        }
        let out = sensors.left_out.iter().map(|out| out.sensor.clone());
        self.out_now.insert(rod.clone(), out.collect());
    }

    /// True if an event was lost: nothing is known of it.
    pub fn has_lost(&self) -> bool {
        self.lost > 0
    }

    /// Losses in words that begin with a comma; empty without any.
    pub fn losses(&self) -> String {
        let mut text = String::new();
        for (count, what) in [
            (self.unreadable, "files that could not be read"),
            (self.with_losses, "files with lost data"),
            (
                self.differences.misspelt.len(),
                "topics that are most likely misspelt",
            ),
            (self.overlapping.len(), "rods whose records overlap in time"),
            (self.broken, "records that broke the analysis"),
        ] {
            if count > 0 {
                text += &format!(", {count} {what}");
            }
        }
        text
    }

    /// Counts a file and reports its faults; without `is_meant` the rod searched for was the built-in one.
    fn file(&mut self, result: &Result<Summary, SourceError>, is_meant: bool, bar: &Progress) {
        self.files += 1;
        let summary = match result {
            Ok(summary) => summary,
            Err(error) => {
                self.unreadable += 1;
                return bar.say(&format!("error: {error}"));
            }
        };
        self.topics.take(summary);
        for note in &summary.notes {
            bar.say(note);
        }
        for fault in summary.faults() {
            bar.say(&format!("warning: {fault}"));
        }
        if summary.has_nothing() {
            self.unreadable += 1;
            if let Some(absence) = summary.absence() {
                bar.say(&format!("error: {absence}"));
            }
            if !is_meant {
                bar.say(
                    "no --config was given, so the built-in rod of the paper was looked for: `tirante measure FILE` asks for yours, \
                     `tirante init FILE` writes its configuration",
                );
            }
        } else {
            self.with_losses += usize::from(summary.lost_data());
            if let Some(absence) = summary.absence() {
                tracing::info!("{absence}");
            }
        }
    }
}

/// True if the reader of stdout has seen enough.
pub fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<io::Error>()
        .is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}
