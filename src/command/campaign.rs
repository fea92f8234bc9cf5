//! Recorded campaigns through the plans: every record's outcome in order, losses named, all counted.

use super::WITH_LOSSES;
use super::progress::Progress;
use crate::analysis::Plan;
use crate::config::Config;
use crate::outcome::{Outcome, Rejected};
use crate::pipeline::{Limits, map_in_order};
use crate::record::{RodChannels, RodId};
use crate::source::{self, Event, Follow, Options, Recording, SourceError, Summary};
use std::collections::{BTreeMap, HashSet};
use std::fmt::{self, Display};
use std::io;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// Pause before a growing recording is looked at again.
const FOLLOW_POLL: Duration = Duration::from_millis(200);

/// Samples of records in memory between reading and analysis (8 bytes each).
const SAMPLES_IN_FLIGHT: usize = 4 << 20;

/// How recordings are read.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct Reading {
    /// Threads that analyse records; the reader has one more. Default: one per core. The results are
    /// the same, bit for bit, for any number.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,

    /// Go on reading a recording that is still being written, until it is finished.
    #[arg(long)]
    pub follow: bool,
}

/// Says on stderr what came of a campaign, and gives the exit code.
pub fn conclude(tally: Option<Tally>) -> ExitCode {
    tally.map_or(ExitCode::SUCCESS, |tally| {
        tell!("{tally}");
        tally.exit_code()
    })
}

/// What came of a campaign.
#[derive(Debug, Default)]
pub struct Tally {
    identified: usize,
    rejected: BTreeMap<&'static str, usize>,
    repeated: usize,
    panicked: usize,
    files: usize,
    unreadable: usize,
    with_losses: usize,
}

impl Tally {
    /// 0 good, 1 nothing could be read or something broke, 3 rejected records or lost data.
    fn exit_code(&self) -> ExitCode {
        if self.panicked > 0 || (self.files > 0 && self.unreadable == self.files) {
            ExitCode::FAILURE
        } else if !self.rejected.is_empty() || self.unreadable > 0 || self.with_losses > 0 {
            ExitCode::from(WITH_LOSSES)
        } else {
            ExitCode::SUCCESS
        }
    }
}

impl Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rejected: usize = self.rejected.values().sum();
        let records = self.identified + rejected + self.repeated + self.panicked;
        write!(
            f,
            "{records} records from {} files: {} identified",
            self.files, self.identified
        )?;
        if rejected > 0 {
            let reasons: Vec<String> = self
                .rejected
                .iter()
                .map(|(code, count)| format!("{count} {code}"))
                .collect();
            write!(f, ", {rejected} rejected ({})", reasons.join(", "))?;
        }
        if self.repeated > 0 {
            write!(f, ", {} left out (the same data as one before)", self.repeated)?;
        }
        if self.panicked > 0 {
            write!(f, ", {} broke the program (please report)", self.panicked)?;
        }
        if self.unreadable > 0 {
            write!(f, ", {} files could not be read", self.unreadable)?;
        }
        if self.with_losses > 0 {
            write!(f, ", {} files with lost data", self.with_losses)?;
        }
        Ok(())
    }
}

/// Runs every record of `paths` (files, or folders of them) through its rod's plan and hands the
/// outcomes to `on_outcome` in the order of the recordings. What was lost is said on stderr. `None` if
/// the reader of stdout has seen enough (`| head`). A record with the same data as one before (a copied or
/// renamed file) is counted and left out.
///
/// # Errors
/// `on_outcome` failed.
pub fn run(
    paths: &[PathBuf],
    config: &Config,
    plans: &BTreeMap<RodId, Plan>,
    reading: &Reading,
    mut on_outcome: impl FnMut(&Outcome, &Progress) -> io::Result<()>,
) -> anyhow::Result<Option<Tally>> {
    let files = source::recordings(paths);
    let total: u64 = files
        .iter()
        .flatten()
        .filter_map(|file| file.metadata().ok())
        .map(|data| data.len())
        .sum();
    let bar = Progress::new(
        total,
        "{bar:40} {percent:>3} %  {bytes} of {total_bytes}, {eta} left",
    );
    let done = Arc::new(AtomicU64::new(0));
    let channels: Vec<RodChannels> = config.rods.iter().map(|rod| rod.channels.clone()).collect();
    let input = Recordings::new(files, channels, config, reading.follow, Arc::clone(&done));
    let workers = reading.threads.map_or_else(
        || thread::available_parallelism().map_or(1, usize::from),
        usize::from,
    );

    let mut tally = Tally::default();
    let mut failure = None;
    let mut seen = HashSet::new();
    map_in_order(
        input,
        Limits {
            workers,
            weight: SAMPLES_IN_FLIGHT,
        },
        |step| match step {
            Step::Event(Event::Record(record)) => record.samples.len(),
            _ => 1,
        },
        |step| analyse(step, plans),
        |result| {
            bar.set(done.load(Ordering::Relaxed), total);
            match result {
                Ok(Done::Record(outcome)) => {
                    if outcome.identity().is_some_and(|identity| !seen.insert(identity)) {
                        tally.repeated += 1;
                        return ControlFlow::Continue(());
                    }
                    match outcome.as_ref() {
                        Outcome::Identified(_) => tally.identified += 1,
                        Outcome::Rejected(rejected) => {
                            *tally.rejected.entry(rejected.rejection.code()).or_default() += 1;
                        }
                    }
                    if let Err(error) = on_outcome(&outcome, &bar) {
                        failure = Some(error);
                        return ControlFlow::Break(());
                    }
                }
                Ok(Done::File(result)) => tally.file(&result, &bar),
                Err(panic) => {
                    tally.panicked += 1;
                    bar.say(&format!("error: the analysis of one record broke ({panic})"));
                }
            }
            ControlFlow::Continue(())
        },
    );
    drop(bar);
    match failure {
        Some(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(None),
        Some(error) => Err(error.into()),
        None => Ok(Some(tally)),
    }
}

impl Tally {
    fn file(&mut self, result: &Result<Summary, SourceError>, bar: &Progress) {
        self.files += 1;
        let summary = match result {
            Ok(summary) => summary,
            Err(error) => {
                self.unreadable += 1;
                return bar.say(&format!("error: {error}"));
            }
        };
        for fault in summary.faults() {
            bar.say(&format!("warning: {fault}"));
        }
        if summary.has_nothing() {
            self.unreadable += 1;
            for absence in summary.absences() {
                bar.say(&format!("error: {absence}"));
            }
        } else {
            self.with_losses += usize::from(summary.lost_data());
            for absence in summary.absences() {
                tracing::info!("{absence}");
            }
        }
    }
}

/// One step of reading: an event of a recording, or its end.
enum Step {
    Event(Event),
    File(Result<Summary, SourceError>),
}

enum Done {
    Record(Box<Outcome>),
    File(Result<Summary, SourceError>),
}

fn analyse(step: Step, plans: &BTreeMap<RodId, Plan>) -> Done {
    let record = match step {
        Step::File(result) => return Done::File(result),
        Step::Event(Event::Rejected {
            rod,
            start,
            duration_s,
            rejection,
        }) => {
            return Done::Record(Box::new(Outcome::Rejected(Box::new(Rejected {
                rod,
                start,
                duration_s: Some(duration_s),
                fs_hz: None,
                identity: None,
                readings: Vec::new(),
                rejection,
            }))));
        }
        Step::Event(Event::Record(record)) => record,
    };
    Done::Record(Box::new(
        match plans.get(&record.rod).map(|plan| plan.run(&record)) {
            Some(Ok(identification)) => Outcome::Identified(Box::new(identification)),
            Some(Err(rejection)) => Outcome::Rejected(Box::new(Rejected {
                start: Some(record.start),
                duration_s: Some(record.duration_s()),
                fs_hz: Some(record.fs_hz),
                identity: Some(record.identity()),
                readings: record.readings,
                rod: record.rod,
                rejection,
            })),
            // The reader only cuts records of rods of the same configuration the plans were made from.
            None => unreachable!("the rod {} has channels but no plan", record.rod),
        },
    ))
}

/// The events of many files, one after another, each followed by its end.
struct Recordings {
    files: std::vec::IntoIter<Result<PathBuf, SourceError>>,
    channels: Vec<RodChannels>,
    settings: crate::record::RecordSettings,
    options: Options,
    done: Arc<AtomicU64>,
    bytes_of_closed: u64,
    open: Option<Recording>,
}

impl Recordings {
    fn new(
        files: Vec<Result<PathBuf, SourceError>>,
        channels: Vec<RodChannels>,
        config: &Config,
        follow: bool,
        done: Arc<AtomicU64>,
    ) -> Self {
        let settings = config.record;
        let follow = follow.then(|| Follow {
            stop: Arc::default(),
            poll: FOLLOW_POLL,
        });
        Self {
            files: files.into_iter(),
            channels,
            settings,
            options: Options { follow },
            done,
            bytes_of_closed: 0,
            open: None,
        }
    }
}

impl Iterator for Recordings {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        loop {
            if let Some(mut recording) = self.open.take() {
                let event = recording.next();
                self.done.store(
                    self.bytes_of_closed + recording.position().read,
                    Ordering::Relaxed,
                );
                return Some(match event {
                    Some(event) => {
                        self.open = Some(recording);
                        Step::Event(event)
                    }
                    None => {
                        self.bytes_of_closed += recording.position().read;
                        Step::File(Ok(recording.summary().clone()))
                    }
                });
            }
            let opened = self.files.next()?.and_then(|path| {
                Recording::open(&path, &self.channels, &self.settings, self.options.clone())
            });
            match opened {
                Ok(recording) => self.open = Some(recording),
                Err(error) => {
                    return Some(Step::File(Err(error)));
                }
            }
        }
    }
}
