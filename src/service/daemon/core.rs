//! The one thread that owns trackers and store: takes what comes out of the pipeline, in order, and makes it durable.

use super::Job;
use super::guard::Guard;
use super::held::Held;
use super::opening::{open_site, warn_of_renewed};
use super::retention::Retention;
use super::silence::Silence;
use super::vigil::Vigil;
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{Rejection, RodId, Timestamp};
use crate::recording::note;
use crate::recording::read::Place;
use crate::recording::read::{SourceError, Summary};
use crate::service::telemetry::{Fault, Health};
use crate::site::analyse::{Analysed, Passed};
use crate::site::clock;
use crate::site::prepared::Generation;
use crate::site::store::{FileMark, Notice, Standing, StoreError};
use crate::site::trackers::{Note, Site, Taken};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Free space with which work is taken up again after the disk was full \[bytes\].
const ROOM: u64 = 8 << 20;
/// How often a full disk is looked at.
const LOOK: Duration = Duration::from_millis(250);

/// What comes out of the pipeline.
pub enum Done {
    /// What came of an event.
    Event(Analysed, Place),
    /// A job that needs no analysis.
    Job(Job),
}

impl Done {
    /// Whether all it does is to keep something; the rest stands alone.
    fn is_kept(&self) -> bool {
        !matches!(self, Self::Job(Job::Reload(_) | Job::Tick { .. }))
    }
}

/// What the core lets others know, on its own thread: whoever listens must be quick.
pub enum Word<'a> {
    /// A tick passed through the whole pipeline, or a full disk is waited for: the work loop is alive.
    Alive,
    /// There are news in the outbox.
    News,
    /// A condition that the store cannot keep now: it is told past it.
    Untold(&'a Notice),
    /// A record that the store has already.
    Known(&'a RodId),
    /// A record was taken; its commit is durable.
    Taken {
        /// What came of it.
        outcome: &'a Outcome,
        /// What tracking made of it.
        taken: &'a Taken,
        /// How long the commit took, with the others of its group.
        took: Duration,
    },
    /// A file, or a part of the journal, is in the store up to its end.
    File(&'a FileMark),
    /// Another configuration holds from here on, and so its rods stand, if they can be asked.
    Reloaded(&'a Arc<Generation>, Option<&'a [Standing]>),
}

/// Why the core cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum Broken {
    /// The store refused for a reason that does not pass.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The daemon stops while the disk is full: what was not kept is read again at the next start.
    #[error("the daemon stops while the disk is full")]
    Stopping,
    /// The store was found damaged after the disk was full.
    #[error("the store was damaged while the disk was full; a restart reads everything again")]
    Damaged,
    /// A fault of the program.
    #[error("the program broke, please report it: {0}")]
    Panicked(String),
}

/// Trackers, store, and what is remembered between records.
pub struct Core {
    /// `None` only while a full disk is waited for.
    site: Option<Site>,
    guard: Guard,
    /// Whether the store is not the file that is written: nothing is acknowledged while it is not.
    halted: Arc<AtomicBool>,
    store: PathBuf,
    generation: Arc<Generation>,
    held: Held,
    passed: Passed,
    silence: Silence,
    retention: Retention,
    vigil: Vigil,
    health: Arc<Health>,
    stopping: Arc<AtomicBool>,
    tell: Box<dyn Fn(Word<'_>) + Send>,
}

impl Core {
    /// A core for an open site. `stopping` ends the wait for a full disk; `halted` tells others that the store is lost.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn new(
        site: Site,
        generation: Arc<Generation>,
        health: Arc<Health>,
        (stopping, halted): (Arc<AtomicBool>, Arc<AtomicBool>),
        tell: Box<dyn Fn(Word<'_>) + Send>,
    ) -> Result<Self, StoreError> {
        let settle = Duration::from_secs_f64(generation.config.alert.settle_s);
        let (vigil, silent_from) = Vigil::begin(site.store(), settle, Arc::clone(&health))?;
        let mut passed = Passed::default();
        for (rod, _) in site.latest() {
            // Every record before this start came before what comes now. A rod that cannot be asked for has none.
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
            retention: Retention::default(),
            vigil,
            health,
            stopping,
            tell,
        };
        core.listen(silent_from);
        Ok(core)
    }

    /// Takes what came out of the pipeline together. Events are put into the order of their times; of what goes now, records,
    /// files and marks that follow each other become durable at once, for the price of one flush of the disk; nobody hears of
    /// any before. What still waits for its turn when the daemon stops is read again at the next start: its file is not
    /// marked yet.
    ///
    /// # Errors
    /// The daemon cannot go on; what was not told was not kept.
    pub fn take(&mut self, group: Vec<Done>) -> Result<(), Broken> {
        let group = self.held.take(group, Instant::now());
        for run in group.chunk_by(|one, next| one.is_kept() && next.is_kept()) {
            match run {
                [Done::Job(Job::Reload(generation))] => self.reload(Arc::clone(generation))?,
                [Done::Job(Job::Tick { is_caught_up })] => self.tick(*is_caught_up)?,
                run => self.keep(run)?,
            }
        }
        Ok(())
    }

    /// An event whose work panicked outside the analysis: nothing is known of it but that.
    pub fn lost(&mut self, panic: &str) {
        self.health.fault(
            Fault::Broken,
            format_args!("the program broke on one event: {panic}"),
        );
    }

    /// Makes a run of items durable, then tells of them.
    fn keep(&mut self, run: &[Done]) -> Result<(), Broken> {
        let begun = Instant::now();
        // Asked once, in order: the run may be taken again.
        let before: Vec<_> = run.iter().map(|done| self.pass(done)).collect();
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
                Done::Event(Analysed::Known(rod, _), _) => (self.tell)(Word::Known(rod)),
                Done::Event(Analysed::Record(outcome), place) => match taken {
                    None => (self.tell)(Word::Known(outcome.rod())),
                    Some(taken) => {
                        self.record(outcome, place, taken, took);
                        has_news |= !taken.verdict.events.is_empty();
                    }
                },
                Done::Job(Job::File { mark, result, .. }) => {
                    self.report(result);
                    if let Some(mark) = mark {
                        (self.tell)(Word::File(mark));
                    }
                }
                Done::Event(Analysed::Readings(..), _) | Done::Job(_) => {}
            }
        }
        if has_news {
            (self.tell)(Word::News);
        }
        Ok(())
    }

    /// Notes that an item passes; the record of its rod that passed before.
    fn pass(&mut self, done: &Done) -> Option<[u8; 32]> {
        let Done::Event(analysed, _) = done else {
            return None;
        };
        let (rod, identity) = match analysed {
            Analysed::Known(rod, identity) => (rod, Some(*identity)),
            Analysed::Record(outcome) => (outcome.rod(), outcome.identity()),
            Analysed::Readings(rod, _) => (rod, None),
        };
        let before = self.passed.last(rod);
        if let Some(identity) = identity {
            self.passed.note(rod, identity);
        }
        before
    }

    /// Tells of a record that was taken.
    fn record(&mut self, outcome: &Outcome, place: &Place, taken: &Taken, took: Duration) {
        let rod = outcome.rod();
        self.silence.end(rod, Instant::now());
        if let Some(start) = outcome.start() {
            self.vigil.heard(start);
        }
        if let Outcome::Rejected(rejected) = outcome {
            let fault = match rejected.rejection {
                Rejection::Broken { .. } => Fault::Broken,
                Rejection::Quarantined { .. } => Fault::Quarantined,
                _ => Fault::Rejected,
            };
            let (reason, file) = (&rejected.rejection, &place.file);
            self.health
                .fault(fault, format_args!("rod {rod}, {file}: {reason}"));
        }
        (self.tell)(Word::Taken { outcome, taken, took });
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
                for absence in summary.absences() {
                    if summary.has_nothing() {
                        self.health.fault(Fault::Recording, absence);
                    } else {
                        tracing::info!("{absence}");
                    }
                }
            }
        }
    }

    fn reload(&mut self, generation: Arc<Generation>) -> Result<(), Broken> {
        // If the disk is full on the way, the site is opened with the new configuration when there is room again.
        self.generation = Arc::clone(&generation);
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
        self.listen(clock::now());
        let settle = Duration::from_secs_f64(generation.config.alert.settle_s);
        self.vigil.set_settle(settle);
        (self.tell)(Word::Reloaded(&generation, standings.as_deref()));
        Ok(())
    }

    /// Begins to count the silence of rods that are new.
    fn listen(&mut self, wall: Timestamp) {
        let now = Instant::now();
        for (rod, since) in self.site.iter().flat_map(Site::silent_since) {
            self.silence.begin(rod, since, wall, now);
        }
    }

    fn tick(&mut self, is_caught_up: bool) -> Result<(), Broken> {
        self.look_at_files()?;
        let mut has_news = self.durable(Site::apply_requests)? > 0;
        if is_caught_up {
            let lasting: Vec<(RodId, f64)> = self
                .silence
                .lasts(Instant::now())
                .map(|(rod, s)| (rod.clone(), s))
                .collect();
            for (rod, elapsed_s) in lasting {
                let events = self.durable(|site| site.look_at_clock(&rod, elapsed_s))?;
                has_news |= !events.is_empty();
            }
        }
        let config = &self.generation.config;
        self.vigil.tick(self.site.as_ref(), config, is_caught_up);
        self.vigil.look();
        if let Some((notices, stretch)) = self.vigil.due() {
            self.durable(|site| site.watch(&notices, stretch))?;
            self.vigil.kept(notices.len());
            has_news |= !notices.is_empty();
        }
        if let Some(keep_s) = self.generation.config.store.keep_lines_s
            && let Some((rod, from)) = self.retention.next(&self.generation.plans)
        {
            let next = self.durable(|site| site.forget_lines(&rod, keep_s, from))?;
            self.retention.came_to(rod, next);
        }
        if has_news {
            (self.tell)(Word::News);
        }
        (self.tell)(Word::Alive);
        Ok(())
    }

    /// Does something to site and store, again from the beginning if the disk was full: the trackers in memory are ahead of
    /// the store then, so both are read from the disk anew. Records the store has are known by content, so nothing is
    /// taken twice.
    fn durable<T>(&mut self, mut act: impl FnMut(&mut Site) -> Result<T, StoreError>) -> Result<T, Broken> {
        let mut tries = 0;
        loop {
            let Some(site) = &mut self.site else {
                return Err(Broken::Stopping);
            };
            match act(site) {
                Ok(value) => {
                    if tries > 0 {
                        self.health.over(Fault::DiskFull, &self.about());
                    }
                    return Ok(value);
                }
                Err(error) if error.is_disk_full() => self.wait_for_room(&error, tries)?,
                Err(error) => return Err(error.into()),
            }
            tries += 1;
        }
    }

    /// Gives up trackers and store, and opens them again when there is room; longer after each try that was in vain.
    fn wait_for_room(&mut self, error: &StoreError, tries: u32) -> Result<(), Broken> {
        let about = self.about();
        let waits = format_args!(
            "{about}: no room on the disk ({error}); nothing is lost, work goes on when there is"
        );
        self.health.hold(Fault::DiskFull, &about, waits);
        self.site = None;
        let begun = Instant::now();
        let mut looks = 1 << tries.min(6);
        loop {
            if self.stopping.load(Ordering::Relaxed) {
                return Err(Broken::Stopping);
            }
            (self.tell)(Word::Alive);
            for notice in self.vigil.look() {
                (self.tell)(Word::Untold(&notice));
            }
            thread::sleep(LOOK);
            looks -= 1;
            if looks > 0 {
                continue;
            }
            looks = 1;
            if room(&self.store) < ROOM {
                continue;
            }
            match open_site(&self.store, &self.generation, &self.health) {
                // The reader knows nothing of marks that are gone: only a restart reads everything again.
                Ok(site) if site.store().moved_aside().is_some() => return Err(Broken::Damaged),
                Ok(site) => {
                    self.guard = Guard::of(&self.store);
                    self.site = Some(site);
                    self.silence.forgive(begun.elapsed());
                    return Ok(());
                }
                // Somebody acknowledges an alarm meanwhile.
                Err(error @ StoreError::Held { .. }) => self.health.hold(Fault::DiskFull, &about, error),
                Err(error) if error.is_disk_full() => looks = 1 << 6,
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Looks whether the store is still the file that is written. If not, nothing is kept or acknowledged, and the sinks are told
    /// past it, until the very file is back or somebody starts the daemon anew.
    fn look_at_files(&mut self) -> Result<(), Broken> {
        let begun = Instant::now();
        let mut is_lost = false;
        while let Err((path, what)) = self.guard.look() {
            self.halted.store(true, Ordering::Relaxed);
            let detail = format!(
                "{} {what} while it was written: nothing is kept or acknowledged. Bring the very file back and it goes on; or \
                 start the daemon anew: it begins a new store if there is none, and reads again what folder and journal hold",
                path.display()
            );
            self.health.hold(Fault::Files, &self.about(), detail);
            is_lost = true;
            if self.stopping.load(Ordering::Relaxed) {
                // Closing it would remove, by its name, a write-ahead log that may be another store's.
                std::mem::forget(self.site.take());
                return Err(Broken::Stopping);
            }
            (self.tell)(Word::Alive);
            for notice in self.vigil.look() {
                (self.tell)(Word::Untold(&notice));
            }
            thread::sleep(LOOK);
        }
        if is_lost {
            self.halted.store(false, Ordering::Relaxed);
            self.health.over(Fault::Files, &self.about());
            self.silence.forgive(begun.elapsed());
        }
        Ok(())
    }

    /// What a condition of the store is about.
    fn about(&self) -> String {
        self.store.display().to_string()
    }
}

/// Puts an item into the site; what was taken, if it is a record that is new.
fn put(site: &mut Site, done: &Done, before: Option<[u8; 32]>) -> Result<Option<Taken>, StoreError> {
    match done {
        Done::Event(Analysed::Record(outcome), place) => return site.take(outcome, Some(place.position())),
        Done::Event(Analysed::Readings(rod, readings), _) => {
            site.take_readings(rod, readings, before)?;
        }
        Done::Job(Job::File { mark, carry, .. }) if mark.is_some() || carry.is_some() => {
            let (mark, carry) = (mark.as_ref(), carry.as_ref());
            site.note(Note::File { mark, carry })?;
        }
        Done::Job(Job::Delivered { sink, through }) => {
            let through = *through;
            site.note(Note::Delivered { sink, through })?;
        }
        // What is known needs nothing, and the pipeline turned every event into what came of it.
        Done::Event(Analysed::Known(..), _) | Done::Job(_) => {}
    }
    Ok(None)
}

/// Free space where a file is \[bytes\]; all there is if the system does not say.
fn room(path: &Path) -> u64 {
    let folder = path.parent().unwrap_or(Path::new("."));
    rustix::fs::statvfs(folder).map_or(u64::MAX, |stat| stat.f_bavail.saturating_mul(stat.f_frsize))
}
