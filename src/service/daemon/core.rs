//! The one thread that owns trackers and store: takes the results of the pipeline, in order, and makes them
//! durable.

mod unwritable;

use super::guard::Guard;
use super::late_readings::LateReadings;
use super::left_out::Runs;
use super::opening::warn_of_renewed;
use super::retention::Retention;
use super::silence::Silence;
use super::vigil::Vigil;
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{Rejection, RodId, Timestamp};
use crate::config::RodConfig;
use crate::recording::note;
use crate::recording::read::Place;
use crate::recording::read::{SourceError, Summary};
use crate::service::alert;
use crate::service::forward::SINK;
use crate::service::telemetry::{Fault, Health};
use crate::site::analyse::{Analysed, LastSeen};
use crate::site::clock;
use crate::site::driver::{Done, Held, Job};
use crate::site::overlap::{self, Change, Overlaps};
use crate::site::prepared::Generation;
use crate::site::store::{ConditionEvent, FileMark, Standing, StoreError};
use crate::site::trackers::{Note, Site, Taken};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// True if an item only adds data to the store, so that it may share a commit with others.
fn is_kept(done: &Done) -> bool {
    !matches!(done, Done::Job(Job::Reload(_) | Job::Tick { .. }))
}

/// Notifications of the core, sent on its own thread: listeners must be quick.
pub enum Notice<'a> {
    /// A tick passed through the whole pipeline, or a full disk is waited for: the work loop is alive.
    Alive,
    /// There are events in the outbox.
    News,
    /// A condition that the store cannot keep now, to be sent past it.
    Untold(&'a ConditionEvent),
    /// A record is in the store already.
    Known(&'a RodId),
    /// A record was taken; its commit is durable.
    Taken {
        /// Outcome of the record.
        outcome: &'a Outcome,
        /// Result of tracking.
        taken: &'a Taken,
        /// Duration of the commit, with the others of its group.
        took: Duration,
    },
    /// A file, or a part of the journal, is in the store up to its end.
    File(&'a FileMark),
    /// The status of all rods, which something other than a record changed.
    Standings(&'a [Standing]),
    /// Another configuration is in force from here on.
    Reloaded(&'a Arc<Generation>),
}

/// Reason why the core cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum CoreError {
    /// The store returned a permanent error.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The daemon stops while the disk is full: data not yet stored is read again at the next start.
    #[error("the daemon stops while the disk is full")]
    Stopping,
    /// The store was found damaged after the disk was full.
    #[error("the store was damaged while the disk was full; a restart reads everything again")]
    Damaged,
    /// The program panicked.
    #[error("the program broke, please report it: {0}")]
    Panicked(String),
}

/// Trackers, store, and the state between records.
pub struct Core {
    /// `None` only while waiting for a full disk.
    site: Option<Site>,
    guard: Guard,
    /// True while the store is not the file that is written: nothing is acknowledged then.
    halted: Arc<AtomicBool>,
    store: PathBuf,
    generation: Arc<Generation>,
    held: Held,
    passed: LastSeen,
    silence: Silence,
    left_out: Runs,
    late_readings: LateReadings,
    overlaps: Overlaps,
    retention: Retention,
    vigil: Vigil,
    health: Arc<Health>,
    stopping: Arc<AtomicBool>,
    /// True once the store has a position for each sink of the configuration.
    has_placed_sinks: bool,
    /// True while the lock says why nothing is stored.
    has_told: bool,
    notify: Box<dyn Fn(Notice<'_>) + Send>,
}

impl Core {
    /// A core for an open site. `stopping` ends the wait for a full disk; `halted` is true while the store is
    /// lost; `told` are begins of conditions that were told before the store was open.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn new(
        site: Site,
        generation: Arc<Generation>,
        health: Arc<Health>,
        (stopping, halted): (Arc<AtomicBool>, Arc<AtomicBool>),
        told: Vec<ConditionEvent>,
        notify: Box<dyn Fn(Notice<'_>) + Send>,
    ) -> Result<Self, StoreError> {
        let (vigil, silent_from) = Vigil::begin(site.store(), told, &generation.config, Arc::clone(&health))?;
        let mut passed = LastSeen::default();
        for (rod, _) in site.latest() {
            // Every record before this start came before the next one. A rod whose record cannot be read has none.
            if let Ok(Some(identity)) = site.store().last_identity(rod) {
                passed.note(rod, identity);
            }
        }
        let mut core = Self {
            guard: Guard::of(site.store().path()),
            halted,
            store: site.store().path().to_owned(),
            site: Some(site),
            held: Held::new(generation.config.track.reorder_window_s),
            generation,
            passed,
            silence: Silence::default(),
            left_out: Runs::default(),
            late_readings: LateReadings::default(),
            overlaps: Overlaps::default(),
            retention: Retention::default(),
            vigil,
            health,
            stopping,
            has_placed_sinks: false,
            // What an earlier process left beside the store goes once the store has it.
            has_told: true,
            notify,
        };
        core.left_out.retain(&core.generation.config, &core.health);
        for condition in core.health.conditions() {
            if condition.fault != Fault::Topic || !overlap::is_about(&condition.about) {
                continue;
            }
            let mut rods = core.generation.config.rods.iter();
            match rods.find(|rod| overlap::about(&rod.analysis.rod) == condition.about) {
                Some(rod) if may_overlap(rod) => core.overlaps.resume(&rod.analysis.rod),
                _ => core.health.over(Fault::Topic, &condition.about),
            }
        }
        core.listen(silent_from);
        Ok(core)
    }

    /// Takes a group of results of the pipeline. Events are put in the order of their times; consecutive
    /// records, files and marks that are due become durable at once, with one flush of the disk, and are
    /// announced only then. Events still waiting when the daemon stops are read again at the next start:
    /// their file is not marked yet.
    ///
    /// # Errors
    /// The daemon cannot go on; results not announced were not kept.
    pub fn take(&mut self, group: Vec<Done>) -> Result<(), CoreError> {
        let group = self.held.take(group, Instant::now());
        for run in group.chunk_by(|one, next| is_kept(one) && is_kept(next)) {
            self.place_sinks()?;
            match run {
                [Done::Job(Job::Reload(generation))] => self.reload(Arc::clone(generation))?,
                [Done::Job(Job::Tick { is_caught_up })] => self.tick(*is_caught_up)?,
                run => self.keep(run)?,
            }
        }
        Ok(())
    }

    /// Records at a clean end up to when a daemon was at work: an outage begins there.
    ///
    /// # Errors
    /// The store refuses.
    pub fn end(&mut self) -> Result<(), StoreError> {
        let stretch = self.vigil.last_stretch();
        match &mut self.site {
            Some(site) => site.watch(&[], stretch),
            None => Ok(()),
        }
    }

    /// Reports a panic outside the analysis.
    pub fn lost(&mut self, panic: &str) {
        self.health.fault(
            Fault::Broken,
            format_args!("the program broke on one event: {panic}"),
        );
    }

    /// Gives each new sink its position before anything further happens.
    fn place_sinks(&mut self) -> Result<(), CoreError> {
        if self.has_placed_sinks {
            return Ok(());
        }
        let generation = Arc::clone(&self.generation);
        self.durable(|site| {
            site.together(|site| {
                for (sink, through) in alert::marks_of_new(&generation.config.sinks, site.store())? {
                    site.note(Note::Delivered { sink: &sink, through })?;
                }
                Ok(())
            })
        })?;
        self.has_placed_sinks = true;
        Ok(())
    }

    /// Makes a run of items durable, then announces them.
    fn keep(&mut self, run: &[Done]) -> Result<(), CoreError> {
        let begun = Instant::now();
        // Asked once, in order: the run may be taken again.
        let before: Vec<_> = run
            .iter()
            .map(|done| match done {
                Done::Event(analysed, _) => self.passed.pass(analysed),
                Done::Job(_) => None,
            })
            .collect();
        let taken = self.durable(|site| {
            site.together(|site| {
                let items = run.iter().zip(&before);
                items.map(|(done, before)| put(site, done, *before)).collect()
            })
        });
        let taken: Vec<Option<Taken>> = taken?;
        let took = begun.elapsed();
        let mut has_news = false;
        for (done, taken) in run.iter().zip(&taken) {
            match done {
                Done::Event(Analysed::Known(rod, _), _) => (self.notify)(Notice::Known(rod)),
                Done::Event(Analysed::Record(outcome), place) => match taken {
                    None => (self.notify)(Notice::Known(outcome.rod())),
                    Some(taken) => {
                        self.record(taken.outcome(outcome), place, taken, took);
                        has_news |= !taken.verdict.events.is_empty();
                    }
                },
                Done::Job(Job::Files { marks, results, .. }) => {
                    results.iter().for_each(|result| self.report(result));
                    for mark in marks {
                        (self.notify)(Notice::File(mark));
                    }
                }
                Done::Event(Analysed::Readings(rod, readings), _) => {
                    let config = &self.generation.config;
                    self.late_readings.readings(rod, readings, config, &self.health);
                }
                Done::Job(_) => {}
            }
        }
        if has_news {
            (self.notify)(Notice::News);
        }
        Ok(())
    }

    /// Announces a record that was taken.
    fn record(&mut self, outcome: &Outcome, place: &Place, taken: &Taken, took: Duration) {
        let rod = outcome.rod();
        self.silence.end(rod, Instant::now());
        if let Some(start) = outcome.start() {
            self.vigil.heard(start);
        }
        if let Some(sensors) = outcome.sensors() {
            let patience = self.generation.config.alarm.sensor_records;
            self.left_out.take(rod, sensors, patience, &self.health);
        }
        self.late_readings
            .record(outcome, &self.generation.config, &self.health);
        match self.overlaps.take(outcome, &place.origin) {
            Some(Change::Begins(detail)) => self.health.hold(Fault::Topic, &overlap::about(rod), detail),
            Some(Change::Ends) => self.health.over(Fault::Topic, &overlap::about(rod)),
            None => {}
        }
        if let Outcome::Rejected(rejected) = outcome {
            let fault = match rejected.rejection {
                Rejection::Broken { .. } => Fault::Broken,
                Rejection::Quarantined { .. } => Fault::Quarantined,
                _ => Fault::Rejected,
            };
            let (reason, file) = (&rejected.rejection, &place.origin);
            self.health
                .fault(fault, format_args!("rod {rod}, {file}: {reason}"));
        }
        (self.notify)(Notice::Taken { outcome, taken, took });
    }

    fn report(&self, result: &Result<Summary, SourceError>) {
        match result {
            Err(error) => self.health.fault(Fault::Recording, error),
            Ok(summary) => {
                for note in &summary.notes {
                    tracing::info!("{note}");
                }
                for (topic, held) in &summary.topics {
                    if held.messages > 0 && topic != note::TOPIC && !self.generation.config.reads(topic) {
                        self.health.strays().came(topic);
                    }
                }
                for fault in summary.faults() {
                    self.health.fault(Fault::Recording, fault);
                }
                if let Some(absence) = summary.absence() {
                    if summary.has_nothing() {
                        self.health.fault(Fault::Recording, absence);
                    } else {
                        tracing::info!("{absence}");
                    }
                }
            }
        }
    }

    fn reload(&mut self, generation: Arc<Generation>) -> Result<(), CoreError> {
        // If the disk is full on the way, the site is opened with the new configuration when there is room again.
        let before = std::mem::replace(&mut self.generation, Arc::clone(&generation));
        self.has_placed_sinks = false;
        let mut standings = None;
        if let Some(site) = self.site.take() {
            match site.reload(generation.track_plans.iter().cloned(), generation.provenance()) {
                Ok(mut site) => {
                    site.expect_rods(clock::now())?;
                    warn_of_renewed(&site);
                    standings = Some(site.standings()?);
                    self.site = Some(site);
                }
                Err(error) if error.is_disk_full() => {
                    self.wait_for_room(&error, 0)?;
                    self.health.over(Fault::DiskFull, &self.about());
                    standings = self.site.as_ref().map(Site::standings).transpose()?;
                }
                Err(error) => return Err(error.into()),
            }
        }
        self.left_out.retain(&generation.config, &self.health);
        let is_configured = |rod: &RodId| {
            let mut rods = generation.config.rods.iter();
            rods.any(|own| own.analysis.rod == *rod && may_overlap(own))
        };
        for rod in self.overlaps.retain(is_configured) {
            self.health.over(Fault::Topic, &overlap::about(&rod));
        }
        // Nothing of a topic that no rod reads any more would end its condition.
        for condition in self.health.conditions() {
            let about = &condition.about;
            if condition.fault == Fault::Topic
                && before.config.reads(about)
                && !generation.config.reads(about)
            {
                self.health.over(Fault::Topic, about);
            }
        }
        self.listen(clock::now());
        let settle = Duration::from_secs_f64(generation.config.alert.settle_s);
        self.vigil.set_settle(settle);
        if let Some(standings) = standings {
            (self.notify)(Notice::Standings(&standings));
        }
        (self.notify)(Notice::Reloaded(&generation));
        Ok(())
    }

    /// Begins to count the silence of new rods.
    fn listen(&mut self, wall: Timestamp) {
        let now = Instant::now();
        for (rod, since) in self.site.iter().flat_map(Site::silent_since) {
            self.silence.begin(rod, since, wall, now);
        }
    }

    fn tick(&mut self, is_caught_up: bool) -> Result<(), CoreError> {
        self.look_at_files()?;
        let mut has_moved = self.durable(Site::apply_requests)? > 0;
        if is_caught_up {
            let lasting: Vec<(RodId, f64)> = self
                .silence
                .lasts(Instant::now())
                .map(|(rod, s)| (rod.clone(), s))
                .collect();
            for (rod, elapsed_s) in lasting {
                let events = self.durable(|site| site.look_at_clock(&rod, elapsed_s))?;
                has_moved |= !events.is_empty();
            }
        }
        let mut has_news = has_moved;
        if has_moved {
            let standings = self.durable(|site| site.standings())?;
            (self.notify)(Notice::Standings(&standings));
        }
        let config = &self.generation.config;
        self.vigil.tick(self.site.as_ref(), config, is_caught_up);
        self.vigil.look();
        if let Some((notices, stretch)) = self.vigil.due() {
            self.durable(|site| site.watch(&notices, stretch))?;
            self.vigil.kept(notices.len());
            has_news |= !notices.is_empty();
        }
        self.tell(None);
        if let Some(keep_s) = self.generation.config.store.keep_lines_s
            && let Some((rod, from)) = self.retention.next(&self.generation.plans)
        {
            let copied_to = self.generation.config.forward.as_ref().map(|_| SINK);
            let next = self.durable(|site| site.forget_lines(&rod, keep_s, from, copied_to))?;
            self.retention.came_to(rod, next);
        }
        if has_news {
            (self.notify)(Notice::News);
        }
        (self.notify)(Notice::Alive);
        Ok(())
    }

    /// Subject of a condition of the store.
    fn about(&self) -> String {
        self.store.display().to_string()
    }
}

/// True for a rod with one sensor: records of several are meant to be of the same time.
fn may_overlap(rod: &RodConfig) -> bool {
    rod.channels.sensors().count() == 1
}

/// Puts an item into the site; returns the result if it is a new record.
fn put(site: &mut Site, done: &Done, before: Option<[u8; 32]>) -> Result<Option<Taken>, StoreError> {
    match done {
        Done::Event(analysed, place) => return site.take_event(analysed, Some(place.into()), before),
        Done::Job(Job::Files { marks, carry, .. }) if !marks.is_empty() || !carry.is_empty() => {
            site.note(Note::Files { marks, carry })?;
        }
        Done::Job(Job::Delivered { sink, through }) => {
            let through = *through;
            site.note(Note::Delivered { sink, through })?;
        }
        // The driver has turned every event into its result.
        Done::Job(_) => {}
    }
    Ok(None)
}
