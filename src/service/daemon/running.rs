//! A running daemon: starts, reloads and ends its threads.

use super::core::{Core, CoreError, Notice};
use super::live::{Bound, Live};
use super::pipe::{self, Ending, JOBS};
use super::quarantine::Quarantine;
use super::reader::{Reader, Remembered, Sources, Surroundings};
use super::supervision::Watched;
use super::trial::Trials;
use super::workers::Workers;
use super::{LifecycleEvent, Options, restart};
use crate::config::Config;
use crate::recording::part;
use crate::service::alert::Couriers;
use crate::service::forward::{self, Forwarder, SINK};
use crate::service::memory;
use crate::service::telemetry::{Fault, Telemetry};
use crate::site::clock;
use crate::site::driver::{Job, Loads};
use crate::site::ordered_map::message_of;
use crate::site::prepared::Generation;
use crate::site::store::ConditionEvent;
use crate::site::trackers::Site;
use anyhow::Context;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

/// Longest time for the pipeline to finish its content.
const DRAIN: Duration = Duration::from_secs(4);
/// Interval of ticks through the pipeline.
const TICK: Duration = Duration::from_secs(1);
/// Ticks between two returns of freed memory to the system.
const TRIM_EVERY: usize = 10;

/// A running daemon.
pub struct Running {
    generation: Arc<Generation>,
    reader: Reader,
    live: Live,
    couriers: Arc<Mutex<Couriers>>,
    forward: Forward,
    quarantine: Arc<Quarantine>,
    trials: Arc<Trials>,
    ending: Ending,
}

/// Copy to a centre, if there is one, shared with the core's notifications.
#[derive(Clone)]
struct Forward {
    running: Arc<Mutex<Option<Forwarder>>>,
    jobs: SyncSender<Job>,
    store: PathBuf,
    config: PathBuf,
    telemetry: Telemetry,
}

impl Forward {
    /// Changes to these settings; unchanged ones do not disturb it.
    fn reload(&self, config: &Config) {
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        let settings = config.forward.as_ref();
        if settings.is_some_and(|new| running.as_ref().is_some_and(|old| old.is_of(new))) {
            return;
        }
        *running = None;
        let Some(settings) = settings else {
            for about in forward::ABOUTS {
                self.telemetry.health.over(Fault::Forward, about);
            }
            self.telemetry.metrics.forget_sink(SINK);
            return;
        };
        let jobs = self.jobs.clone();
        // The position is noted for people, and for lines that may go once they were sent; a full queue is no reason to wait.
        let noted = Box::new(move |through| {
            let sink = SINK.to_owned();
            let _ = jobs.try_send(Job::Delivered { sink, through });
        });
        match Forwarder::start(
            settings,
            self.store.clone(),
            &self.config,
            noted,
            self.telemetry.clone(),
        ) {
            Ok(forwarder) => *running = Some(forwarder),
            Err(error) => {
                let detail = format!("forward: no thread for it: {error}");
                self.telemetry.health.hold(Fault::Forward, SINK, detail);
            }
        }
    }

    fn wake(&self) {
        let running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        running.iter().for_each(Forwarder::wake);
    }

    fn stop(&self) {
        *self.running.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

impl Running {
    /// Starts all threads; `told` are begins of conditions that were told before the site was open.
    ///
    /// # Errors
    /// The files beside the store or the journal cannot be read or written, or the system gives no thread.
    pub fn start(
        generation: Arc<Generation>,
        (site, told): (Site, Vec<ConditionEvent>),
        options: &Options,
        bound: Bound,
        runtime: &Runtime,
        telemetry: &Telemetry,
        sender: &Sender<LifecycleEvent>,
    ) -> anyhow::Result<Self> {
        let config = &generation.config;
        let store = site.store().path().to_owned();
        let quarantine = Quarantine::open(&store)
            .with_context(|| format!("{}: what stands beside it cannot be read", store.display()))?;
        let quarantine = Arc::new(quarantine);
        let reading = telemetry.beats.of("reader");
        let trials = Arc::new(Trials::new(
            options.program.clone(),
            store.clone(),
            generation.provenance().effective.to_owned(),
            Arc::clone(&reading),
        ));
        let remembered = Remembered::of(site.store())?;
        let health = &telemetry.health;
        let halted = Arc::<AtomicBool>::default();
        let live = Live::start(
            config,
            &store,
            bound,
            runtime,
            telemetry,
            (sender, Arc::clone(&halted)),
        )?;
        telemetry.metrics.watch_disk("store", store.clone());
        telemetry.metrics.standings(&site.standings()?);

        let (jobs, receiver) = sync_channel(JOBS);
        let delivered = {
            let jobs = jobs.clone();
            Box::new(move |sink, through| jobs.send(Job::Delivered { sink, through }).is_ok())
        };
        let mut couriers = Couriers::start(&config.sinks, &config.site, &store, delivered, telemetry.clone());
        couriers.watch(&config.alert, &config.site);
        let couriers = Arc::new(Mutex::new(couriers));
        let forward = Forward {
            running: Arc::default(),
            jobs: jobs.clone(),
            store,
            config: options.config.clone(),
            telemetry: telemetry.clone(),
        };
        let known = Arc::new(site.store().all_known().clone());
        let workers = Workers::new(
            Arc::clone(&known),
            Arc::clone(&quarantine),
            Arc::clone(&telemetry.metrics),
        );
        let ending = Ending::default();
        let core = Core::new(
            site,
            Arc::clone(&generation),
            Arc::clone(health),
            (Arc::clone(&ending.drain), halted),
            told,
            Box::new(hear(
                telemetry.clone(),
                &live,
                Arc::clone(&couriers),
                forward.clone(),
            )),
        )?;
        let threads = options
            .threads
            .unwrap_or_else(|| thread::available_parallelism().map_or(1, usize::from));
        work(core, receiver, workers, threads, ending.clone(), sender.clone())?;

        let (caught_up, loads) = (Arc::<AtomicBool>::default(), Loads::default());
        let watch = Box::new(Watched {
            quarantine: Arc::clone(&quarantine),
            trials: Arc::clone(&trials),
            known,
            loads: loads.clone(),
            caught_up: Arc::clone(&caught_up),
            beat: Arc::clone(&reading),
            slot: quarantine.slot(),
        });
        let sources = Sources {
            folder: config.ingest.folder.clone(),
            subfolders: config.ingest.subfolders,
            settle_s: config.ingest.settle_s,
            join_s: config.ingest.join_s,
            journal: live.source(),
        };
        let reader = Reader::start(
            sources,
            remembered,
            Arc::clone(&generation),
            Surroundings {
                jobs: jobs.clone(),
                health: Arc::clone(health),
                bell: live.bell(),
                caught_up: Arc::clone(&caught_up),
                loads,
                beat: reading,
                watch,
            },
        )?;
        tick(jobs, caught_up)?;
        draw_tables(&generation, &ending)?;
        forward.reload(&generation.config);
        Ok(Self {
            generation,
            reader,
            live,
            couriers,
            forward,
            quarantine,
            trials,
            ending,
        })
    }

    /// Changes to another configuration.
    pub fn reload(&mut self, generation: Arc<Generation>) {
        for key in restart::needed_for(&self.generation.config, &generation.config) {
            tracing::warn!("{key} changed: it holds after a restart, the old one until then");
        }
        let config = &generation.config;
        self.live.retarget(&config.rods);
        lock(&self.couriers).reload(&config.sinks, &config.site);
        lock(&self.couriers).watch(&config.alert, &config.site);
        self.forward.reload(config);
        self.trials
            .configure(generation.provenance().effective.to_owned());
        self.reader.reload(Arc::clone(&generation));
        // Without a thread for it, a rod's first record draws its table.
        let _ = draw_tables(&generation, &self.ending);
        self.generation = generation;
    }

    /// Checks that all threads run.
    ///
    /// # Errors
    /// The reader ended by itself, so that nothing would be read.
    pub fn check(&self) -> Result<(), CoreError> {
        if self.reader.is_finished() && !self.ending.drain.load(Ordering::Relaxed) {
            return Err(CoreError::Panicked("the reader ended by itself".to_owned()));
        }
        Ok(())
    }

    /// Stops listening and reading, finishes the data already read, and closes the store; data that takes too
    /// long is read again at the next start.
    ///
    /// # Errors
    /// The core could not go on.
    pub fn drain(self, runtime: &Runtime, events: &Receiver<LifecycleEvent>) -> Result<(), CoreError> {
        let deadline = Instant::now() + DRAIN;
        self.end_reading();
        self.reader.stop();
        self.live.stop(runtime);
        let result = loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match events.recv_timeout(left) {
                Ok(LifecycleEvent::Ended(result)) => break result,
                Ok(_) => {}
                Err(_) => {
                    tracing::warn!("some records are still analysed: they are read again at the next start");
                    self.ending.give_up.store(true, Ordering::Relaxed);
                    break Ok(());
                }
            }
        };
        self.forward.stop();
        stop(self.couriers);
        result
    }

    /// Asks everything before the core to stop. The reader is asked before a trial is ended, for which it waits: it must not go
    /// on without the verdict.
    fn end_reading(&self) {
        self.live.hang_up();
        self.ending.drain.store(true, Ordering::Relaxed);
        self.reader.ask_to_stop();
        self.quarantine.stand_down();
        self.trials.stop();
    }

    /// Ends the rest after the work loop, or another necessary thread, ended by itself; every sink is told.
    pub fn abandon(self, runtime: &Runtime, why: &str) {
        self.end_reading();
        self.reader.stop();
        lock(&self.couriers).tell_end(why);
        self.live.stop(runtime);
        self.forward.stop();
        stop(self.couriers);
    }
}

/// Runs the pipeline and the core on a thread of their own.
fn work(
    mut core: Core,
    jobs: Receiver<Job>,
    workers: Workers,
    threads: usize,
    ending: Ending,
    sender: Sender<LifecycleEvent>,
) -> std::io::Result<()> {
    let work = move || {
        let work = || pipe::run(jobs, threads, &workers, &mut core, &ending);
        let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
            ending.drain.store(true, Ordering::Relaxed);
            Err(CoreError::Panicked(message_of(&*panic)))
        });
        // The store is closed before anybody hears of the end.
        drop(core);
        let _ = sender.send(LifecycleEvent::Ended(result));
    };
    thread::Builder::new().name("core".to_owned()).spawn(work)?;
    Ok(())
}

/// Sends a tick through the whole pipeline every second, and returns freed memory; a full channel delays both, as it should.
fn tick(jobs: SyncSender<Job>, caught_up: Arc<AtomicBool>) -> std::io::Result<()> {
    let work = move || {
        for number in 1usize.. {
            let is_caught_up = caught_up.load(Ordering::Relaxed);
            if jobs.send(Job::Tick { is_caught_up }).is_err() {
                return;
            }
            if number.is_multiple_of(TRIM_EVERY) {
                memory::trim();
            }
            thread::sleep(TICK);
        }
    };
    thread::Builder::new().name("tick".to_owned()).spawn(work)?;
    Ok(())
}

/// Draws the tables of all rods on a separate thread: a site of many rods is ready before, and a record that
/// comes meanwhile draws its rod's table itself.
fn draw_tables(generation: &Arc<Generation>, ending: &Ending) -> std::io::Result<()> {
    let (generation, drain) = (Arc::clone(generation), Arc::clone(&ending.drain));
    let work = move || {
        // By address: rods share what is equal.
        let mut bytes = BTreeMap::new();
        for plan in generation.plans.values() {
            if drain.load(Ordering::Relaxed) {
                return;
            }
            bytes.extend(plan.table().pieces());
        }
        let mb = bytes.values().sum::<usize>() as f64 / 1e6;
        tracing::info!("the tables of all rods are drawn: {mb:.0} MB");
    };
    thread::Builder::new().name("tables".to_owned()).spawn(work)?;
    Ok(())
}

/// Handles notifications of the core.
fn hear(
    telemetry: Telemetry,
    live: &Live,
    couriers: Arc<Mutex<Couriers>>,
    forward: Forward,
) -> impl Fn(Notice<'_>) + Send + use<> {
    let results_kept = live.results_kept();
    let gauges = live.gauges();
    move |word| {
        let metrics = &telemetry.metrics;
        match word {
            Notice::Alive => {
                telemetry.beat();
                gauges.show(metrics);
                lock(&couriers).look_at_clock(clock::now());
            }
            Notice::News => {
                lock(&couriers).wake();
                forward.wake();
            }
            Notice::Untold(notice) => lock(&couriers).tell(notice),
            Notice::Known(rod) => metrics.known(rod),
            Notice::Taken { outcome, taken, took } => {
                metrics.taken(outcome, &taken.verdict, took);
                forward.wake();
            }
            Notice::File(mark) => {
                if let Some(part) = part::number_of_mark(&mark.name) {
                    results_kept.fetch_max(part, Ordering::Relaxed);
                }
                tracing::info!("{} is read", mark.name);
            }
            Notice::Standings(standings) => metrics.standings(standings),
            Notice::Reloaded(generation) => {
                tracing::info!("configuration {} holds", generation.provenance().hash);
            }
        }
    }
}

fn stop(couriers: Arc<Mutex<Couriers>>) {
    // The core, which has the other half, has ended or is left behind.
    if let Some(couriers) = Arc::into_inner(couriers) {
        couriers
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner)
            .stop();
    }
}

fn lock(couriers: &Mutex<Couriers>) -> std::sync::MutexGuard<'_, Couriers> {
    couriers.lock().unwrap_or_else(PoisonError::into_inner)
}
