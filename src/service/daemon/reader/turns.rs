//! Turns of the journal and the watched folder, and what each step of theirs becomes.
//!
//! A turn is short: a huge file never keeps live data waiting.

use super::{JOURNAL, Remembered, Sources, Surroundings};
use crate::analysis::signal::record::{Event, RodChannels};
use crate::recording::part;
use crate::recording::read::Place;
use crate::recording::read::{HELD, MOST_READY, PartEnd, Series, Step};
use crate::service::daemon::folder::{Folder, FolderEnd, FolderStep, Waits};
use crate::service::daemon::steps::Guard;
use crate::service::daemon::supervision::Standing;
use crate::service::daemon::trial::Input;
use crate::service::daemon::useless;
use crate::service::journal;
use crate::service::telemetry::Fault;
use crate::service::viewer::Signals;
use crate::site::driver::Job;
use crate::site::prepared::Generation;
use crate::site::store::{Carry, FileMark, FileState};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TrySendError};
use std::thread;
use std::time::{Duration, Instant};

/// Pause before sources without new data are checked again.
const POLL: Duration = Duration::from_millis(200);
/// Interval at which it reports that there is no more to read, and the time after the last event for which it
/// does.
const LOOK: Duration = Duration::from_millis(100);
const LOOK_FOR: Duration = Duration::from_secs(3);
/// Room for the samples of the journal, whatever the watched folder holds \[bytes\]: live data goes before.
const JOURNAL_ROOM: usize = HELD / 2;
/// Pause before a full queue is tried again.
const PUSH_BACK: Duration = Duration::from_millis(2);

/// State of the thread.
pub(super) struct Work {
    folder: Option<Folder>,
    journal: Option<JournalLane>,
    generation: Arc<Generation>,
    /// Configuration that takes effect with the next part of the journal.
    waiting: Option<Arc<Generation>>,
    /// Time of the last event sent, and of the last report that there is no more to read.
    last_event: Option<Instant>,
    last_look: Option<Instant>,
    around: Surroundings,
    stop: Arc<AtomicBool>,
}

struct JournalLane {
    series: Series,
    input: Input,
    handle: journal::Handle,
    signals: Arc<Signals>,
    guard: Guard,
    /// Number of the damaged part after which a new one was requested.
    rotated: Option<u32>,
    /// True if its end has been reached once.
    is_read: bool,
}

/// The daemon stops, or the receiver of the jobs is gone.
struct Stopped;

fn channels(generation: &Generation) -> Vec<RodChannels> {
    let rods = generation.config.rods.iter();
    rods.map(|rod| rod.channels.clone()).collect()
}

impl Work {
    pub fn new(
        sources: Sources,
        remembered: &Remembered,
        generation: Arc<Generation>,
        around: Surroundings,
        stop: Arc<AtomicBool>,
    ) -> Self {
        let health = &around.health;
        let (channels, settings) = (channels(&generation), generation.config.record);
        let folder = sources.folder.map(|path| {
            Folder::new(
                (path, sources.subfolders),
                Waits::new(
                    sources.settle_s,
                    sources.join_s,
                    generation.config.ingest.readings_s,
                ),
                &channels,
                &settings,
                remembered,
                Arc::clone(health),
            )
        });
        let journal = sources.journal.map(|source| {
            let resumed = remembered.journal(&source.folder, &channels, &settings);
            source
                .results_kept
                .fetch_max(resumed.done.unwrap_or(0), Ordering::Relaxed);
            for lost in resumed.lost {
                health.fault(Fault::Recording, lost);
            }
            let mut series = resumed.series;
            source.signals.follow(&channels);
            series.set_listener(source.signals.listener());
            JournalLane {
                series,
                input: Input::Journal {
                    folder: source.folder,
                },
                handle: source.handle,
                signals: source.signals,
                guard: Guard::default(),
                rotated: None,
                is_read: false,
            }
        });
        Self {
            folder,
            journal,
            generation,
            waiting: None,
            last_event: None,
            last_look: None,
            around,
            stop,
        }
    }

    /// Reads until it is asked to stop.
    pub fn run(mut self, reloads: &Receiver<Arc<Generation>>) {
        while !self.stop.load(Ordering::Relaxed) {
            match self.turn(reloads) {
                Ok(true) => {}
                Ok(false) => match self.look() {
                    Ok(pause) => self.around.bell.wait(pause),
                    Err(Stopped) => return,
                },
                Err(Stopped) => return,
            }
        }
    }

    /// Reports for a while after an event that there is no more to read, so that no event waits for a silent
    /// rod; returns the time to pause.
    fn look(&mut self) -> Result<Duration, Stopped> {
        if self.last_event.is_none_or(|event| event.elapsed() > LOOK_FOR) {
            return Ok(POLL);
        }
        if self.last_look.is_none_or(|look| look.elapsed() >= LOOK) {
            self.last_look = Some(Instant::now());
            let reached = self.journal.as_ref().map(|lane| lane.series.reached());
            self.send(Job::Look(reached.unwrap_or_else(|| Arc::from([]))))?;
        }
        Ok(LOOK)
    }

    /// Takes one step of every source; returns true if there was any data.
    fn turn(&mut self, reloads: &Receiver<Arc<Generation>>) -> Result<bool, Stopped> {
        self.around.beat.pass();
        while let Ok(generation) = reloads.try_recv() {
            self.reload(generation)?;
        }
        // Of what came while nothing read, the older comes first, wherever it lies: what is younger closes its periods.
        let has_turn = |folder: &Folder| !folder.catches_up() || self.journal_at() < folder.at();
        let folder_goes_on = self
            .folder
            .as_ref()
            .is_some_and(|folder| folder.ready_bytes() > MOST_READY);
        let journal_has_turn =
            !folder_goes_on && (self.journal_goes_on() || self.folder.as_ref().is_none_or(has_turn));
        let journal_had_some = journal_has_turn && self.journal_turn()?;
        let is_live = self.folder.as_ref().is_none_or(|folder| !folder.catches_up());
        let folder_has_turn = folder_goes_on || (!self.journal_goes_on() && (is_live || !journal_had_some));
        let folder_had_some = folder_has_turn && self.folder_turn()?;
        let folder_is_read = self.folder.as_ref().is_none_or(|folder| !folder.has_backlog());
        let journal_is_read = self.journal.as_ref().is_none_or(|lane| lane.is_read);
        self.around
            .caught_up
            .store(folder_is_read && journal_is_read, Ordering::Relaxed);
        Ok(folder_had_some || journal_had_some)
    }

    /// Sends a job; waits while the queue is full.
    fn send(&self, job: Job) -> Result<(), Stopped> {
        let mut waiting = Some(job);
        self.until(|| match self.around.jobs.try_send(waiting.take()?) {
            Ok(()) => Some(Ok(())),
            Err(TrySendError::Disconnected(_)) => Some(Err(Stopped)),
            Err(TrySendError::Full(back)) => {
                waiting = Some(back);
                None
            }
        })?
    }

    fn send_event(&mut self, event: Event, place: Place) -> Result<(), Stopped> {
        let standing = self.around.watch.event(&event);
        if standing == Standing::Stopped {
            return Err(Stopped);
        }
        self.last_event = Some(Instant::now());
        let samples = event.samples();
        let load = self.until(|| self.around.loads.take(samples))?;
        self.send(Job::Event {
            event,
            place,
            plans: Arc::clone(&self.generation.plans),
            load: Some(load),
        })?;
        match standing {
            Standing::Suspect => self.until(|| self.around.loads.are_none().then_some(())),
            _ => Ok(()),
        }
    }

    /// Waits for the pipeline, whose own beat is watched, until there is something.
    fn until<T>(&self, mut found: impl FnMut() -> Option<T>) -> Result<T, Stopped> {
        loop {
            if let Some(found) = found() {
                return Ok(found);
            }
            if self.stop.load(Ordering::Relaxed) {
                return Err(Stopped);
            }
            self.around.beat.pass();
            thread::sleep(PUSH_BACK);
        }
    }

    /// True if so many events of the journal wait to be taken that nothing else is read meanwhile.
    fn journal_goes_on(&self) -> bool {
        let lane = self.journal.as_ref();
        lane.is_some_and(|lane| lane.series.ready_bytes() > MOST_READY)
    }

    /// Log time up to which the journal is read \[ns since 1970\].
    fn journal_at(&self) -> u64 {
        let lane = self.journal.as_ref();
        lane.and_then(|lane| lane.series.at()).unwrap_or(0)
    }

    /// Takes one step of the folder; returns true if there was any data.
    fn folder_turn(&mut self) -> Result<bool, Stopped> {
        let Some(folder) = &mut self.folder else {
            return Ok(false);
        };
        let elsewhere = self.journal.as_ref().map_or(0, |lane| lane.series.held());
        let step = folder.step(
            &mut *self.around.watch,
            (&self.stop, &self.around.beat),
            elsewhere,
        );
        self.send_step(step)
    }

    /// Sends a step of the folder; returns true if it brought any data.
    fn send_step(&mut self, step: FolderStep) -> Result<bool, Stopped> {
        match step {
            Step::Wait | Step::End => return Ok(false),
            Step::More => {}
            Step::Event(event, place) => self.send_event(event, place)?,
            Step::File(FolderEnd { files, kept }) => {
                for (_, result) in &files {
                    if let Ok(summary) = result {
                        let topics = summary.topics.iter();
                        let topics = topics.map(|(name, topic)| (name.as_str(), topic));
                        useless::look(&self.around.health, &self.generation.config, topics);
                    }
                }
                let (marks, results) = files.into_iter().unzip();
                self.send(Job::Files {
                    marks,
                    results,
                    carry: kept,
                })?;
            }
        }
        Ok(true)
    }

    /// Takes one step of the journal; returns true if there was any data.
    fn journal_turn(&mut self) -> Result<bool, Stopped> {
        let Some(lane) = &mut self.journal else {
            return Ok(false);
        };
        let around = &mut self.around;
        let beside = self.folder.as_ref().map_or(0, Folder::held);
        lane.series.bound(HELD.saturating_sub(beside).max(JOURNAL_ROOM));
        let step = lane
            .guard
            .poll(&mut lane.series, &lane.input, &mut *around.watch, &around.health);
        // What was acknowledged is gone: told until the next start.
        if let Some((part, detail)) = lane.series.take_lost() {
            around.health.hold(Fault::Recording, &part, detail);
        }
        match step {
            Step::Event(event, place) => self.send_event(event, place)?,
            Step::More => {}
            Step::File(end) => self.end_part(*end)?,
            Step::Wait => {
                lane.is_read = true;
                useless::look(&around.health, &self.generation.config, lane.series.topics());
                let stuck = lane.series.stuck_in();
                if stuck > lane.rotated {
                    lane.handle.rotate();
                    lane.rotated = stuck;
                }
                return Ok(false);
            }
            Step::End => return Ok(false),
        }
        Ok(true)
    }

    fn end_part(&mut self, end: PartEnd) -> Result<(), Stopped> {
        let waiting = self.waiting.take();
        let Some(lane) = &mut self.journal else {
            return Ok(());
        };
        let name = part::mark_name(end.part);
        let quarantined = lane.guard.end(&name);
        let last = waiting.as_ref().map(|generation| {
            lane.signals.follow(&channels(generation));
            lane.series
                .change(&channels(generation), &generation.config.record, &end)
        });
        let body = lane.series.carry();
        for (event, place) in last.into_iter().flatten() {
            self.send_event(event, place)?;
        }
        let carry = end.next.zip(body.ok()).map(|(part, body)| Carry {
            journal: JOURNAL.to_owned(),
            part,
            body,
        });
        self.around.watch.is_read(&name);
        let losses = match &end.result {
            Ok(summary) => summary.faults(),
            Err(error) => vec![error.to_string()],
        };
        let read = match losses.is_empty() {
            true => FileState::Done,
            false => FileState::Incomplete(losses.join("; ")),
        };
        let mark = FileMark {
            name,
            size: end.size,
            modified_ns: end.modified_ns,
            state: quarantined.map_or(read, FileState::Quarantined),
        };
        self.send(Job::Files {
            marks: vec![mark],
            results: vec![end.result],
            carry: carry.into_iter().collect(),
        })?;
        match waiting {
            Some(generation) => self.change(generation),
            None => Ok(()),
        }
    }

    fn reload(&mut self, generation: Arc<Generation>) -> Result<(), Stopped> {
        let before = self.waiting.as_ref().unwrap_or(&self.generation);
        let cuts_alike =
            channels(before) == channels(&generation) && before.config.record == generation.config.record;
        if self.waiting.is_some() {
            // It holds where the one it replaces would have.
            self.waiting = Some(generation);
            return Ok(());
        }
        if cuts_alike {
            self.generation = Arc::clone(&generation);
            return self.send(Job::Reload(generation));
        }
        match &self.journal {
            // So that every part is cut by one configuration, whenever it is read again.
            Some(lane) => {
                lane.handle.rotate();
                self.waiting = Some(generation);
                Ok(())
            }
            None => self.change(generation),
        }
    }

    /// Says that recordings of the folder that were read before are not read again for topics that are read from now on.
    fn tell_new_topics(&self, generation: &Generation) {
        let Some(folder) = generation
            .config
            .ingest
            .folder
            .as_ref()
            .filter(|_| self.folder.is_some())
        else {
            return;
        };
        let rods = generation.config.rods.iter();
        let topics = rods
            .flat_map(|rod| rod.channels.all())
            .map(|channel| channel.topic.as_str());
        let new: BTreeSet<&str> = topics
            .filter(|topic| !self.generation.config.reads(topic))
            .collect();
        if !new.is_empty() {
            let new = new.into_iter().collect::<Vec<_>>().join(", ");
            tracing::warn!(
                "{new}: read from now on; the recordings in {} that were read before are not read again: `touch` those with such a topic, and \
                 the records in them that are not in the store are added",
                folder.display()
            );
        }
    }

    /// Cuts records by another configuration from here on.
    fn change(&mut self, generation: Arc<Generation>) -> Result<(), Stopped> {
        self.tell_new_topics(&generation);
        let folder = self.folder.as_mut();
        let config = &generation.config;
        let readings_s = config.ingest.readings_s;
        let steps = folder.map(|folder| folder.change(&channels(&generation), &config.record, readings_s));
        for step in steps.into_iter().flatten() {
            self.send_step(step)?;
        }
        self.generation = Arc::clone(&generation);
        self.send(Job::Reload(generation))
    }
}
