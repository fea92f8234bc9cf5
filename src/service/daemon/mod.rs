//! The daemon: sources, pipeline, site and sinks, all live at once.
//!
//! docs/daemon.md shows the way of a record through it. [`run`] is its life cycle: prepare, open, run,
//! reload, drain.

pub mod core;
mod folder;
mod guard;
mod late_readings;
mod left_out;
mod live;
mod misnamed;
mod new_store;
pub mod notify;
mod opening;
mod pending;
mod pipe;
pub mod places;
pub mod quarantine;
pub mod reader;
mod remembered;
mod restart;
mod retention;
mod running;
mod signals;
mod silence;
pub mod steps;
pub mod supervision;
pub mod trial;
mod unopened;
mod unread;
mod useless;
mod vigil;
mod wall_clock;

mod workers;

use crate::site::prepared::Generation;
pub use live::vouch;

use crate::config::{Config, ConfigError, Setting};
use crate::service::http;
use crate::service::ingest::Listener;
use crate::service::memory;
use crate::service::telemetry::{Fault, Health, Phase, Telemetry};
use crate::service::viewer::Signals;
use crate::site::ordered_map::message_of;
use crate::site::trackers::Site;
use crate::site::{baselines, clock, store};
use live::Bound;
use notify::Watchdog;
use running::Running;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;
use tokio::runtime::Runtime;
use tokio::sync::watch;
use unopened::Unopened;

/// Conditions of a kind that may hold of one rod: of a few sensors, of its thermometer.
const CONDITIONS_OF_ROD: usize = 4;
/// Interval between checks of the threads.
const LOOK: Duration = Duration::from_secs(1);

/// Start options of a daemon.
#[derive(Debug, Clone)]
pub struct Options {
    /// Path of the configuration; it is read again on SIGHUP.
    pub config: PathBuf,
    /// Settings that override it.
    pub settings: Vec<Setting>,
    /// Number of threads that analyse; by default one per core.
    pub threads: Option<usize>,
    /// Rods whose baselines may be dropped by settings that changed.
    pub given_up: Vec<String>,
    /// The program, to try what ended it in a process of its own; without it nothing is tried.
    pub program: Option<PathBuf>,
    /// Folder that holds everything of the daemon, in place of what the configuration says.
    pub within: Option<PathBuf>,
}

/// Lifecycle event of a daemon.
enum LifecycleEvent {
    /// SIGTERM or SIGINT.
    Stop,
    /// SIGHUP.
    Reload,
    /// The first configuration is prepared and the store is open, or cannot be.
    Opened(anyhow::Result<(Arc<Generation>, Box<Site>)>),
    /// Another configuration is prepared, or cannot be.
    Prepared(anyhow::Result<Arc<Generation>>),
    /// A failure without which the daemon cannot go on.
    Failed(anyhow::Error),
    /// The work loop ended.
    Ended(Result<(), core::CoreError>),
}

/// Runs until stopped (exit code 0), or until it cannot go on.
///
/// # Errors
/// The configuration is bad, the store is another process's or cannot be opened, or something that must be durable
/// cannot be written.
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let config = load(options)?;
    // Before any thread starts.
    memory::return_freed();
    let inherited = Listener::inherited()?;
    let telemetry = Telemetry::default();
    telemetry.health.make_room(CONDITIONS_OF_ROD * config.rods.len());
    let (sender, events) = channel();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("io")
        .enable_all()
        .build()?;
    signals::listen(&runtime, sender.clone())?;
    // Addresses in use by another process are detected before anything begins.
    let (_stop_http, http_stopped) = watch::channel(false);
    let bind = || -> anyhow::Result<Bound> {
        let signals = Arc::<Signals>::default();
        show(&config, &runtime, &telemetry, &signals, http_stopped)?;
        Bound::bind(&config, inherited, signals)
    };
    // If it is another daemon on the same store, that is the reason to give.
    let holder = |error| match config.store.path.as_deref().and_then(store::held) {
        Some(held) => held.into(),
        None => error,
    };
    let mut unopened = Unopened::new(&config, &telemetry);
    let mut bound = match bind().map_err(holder) {
        Ok(bound) => Some(bound),
        Err(error) => {
            unopened.tell_end(&error);
            return Err(error);
        }
    };
    let _watchdog = Watchdog::start(telemetry.clone())?;
    open(
        config,
        Arc::clone(&telemetry.health),
        options.given_up.clone(),
        unopened.pending(),
        sender.clone(),
    )?;
    let daemon = Daemon {
        options,
        runtime: &runtime,
        telemetry: &telemetry,
        sender: &sender,
    };
    let result = daemon.live(&events, &mut bound, unopened);
    // Whatever still waits for the network is not waited for.
    runtime.shutdown_background();
    result
}

/// Starts the HTTP server from the first moment: it reports that the daemon is not ready yet, and why.
fn show(
    config: &Config,
    runtime: &Runtime,
    telemetry: &Telemetry,
    signals: &Arc<Signals>,
    stopped: watch::Receiver<bool>,
) -> anyhow::Result<()> {
    let Some(listener) = http::listen(&config.http)? else {
        return Ok(());
    };
    tracing::info!("page, health and metrics at http://{}", listener.local_addr()?);
    let api = match &config.store.path {
        Some(path) => {
            let shown = http::Shown::new(path);
            runtime.spawn(Arc::clone(&shown).watch(stopped.clone()));
            let ask = {
                let path = path.clone();
                move |rod, what| match store::request_of_writer(&path, &[(rod, what)], clock::now()) {
                    Ok(_) => Ok("within seconds".to_owned()),
                    Err(error) => Err(error.to_string()),
                }
            };
            let access = http::Access::of(&config.http)?;
            let api = http::Api::new(shown, access, ask, stopped.clone());
            Some(api.of_daemon(Arc::clone(&telemetry.health), Arc::clone(signals)))
        }
        None => None,
    };
    let routes = http::routes(Some(telemetry.clone()), api);
    let health = Arc::clone(&telemetry.health);
    runtime.spawn(async move {
        if let Err(error) = http::serve(listener, routes, Arc::clone(&health), stopped).await {
            health.fault(Fault::Write, format!("http: {error}"));
        }
    });
    Ok(())
}

/// State of a daemon's life.
struct Daemon<'a> {
    options: &'a Options,
    runtime: &'a Runtime,
    telemetry: &'a Telemetry,
    sender: &'a Sender<LifecycleEvent>,
}

impl Daemon<'_> {
    /// Handles lifecycle events until the end.
    fn live(
        &self,
        events: &Receiver<LifecycleEvent>,
        bound: &mut Option<Bound>,
        unopened: Unopened,
    ) -> anyhow::Result<ExitCode> {
        let Self {
            options,
            runtime,
            telemetry,
            sender,
        } = *self;
        let health = &telemetry.health;
        let mut running: Option<Running> = None;
        let mut unopened = Some(unopened);
        // One configuration is prepared at a time; a SIGHUP meanwhile is answered after it.
        let (mut is_preparing, mut is_asked_again) = (true, false);
        loop {
            let event = match events.recv_timeout(LOOK) {
                Ok(event) => event,
                Err(_) => {
                    if let Some(unopened) = &mut unopened {
                        unopened.look();
                    }
                    let error = match running.as_ref().map_or(Ok(()), Running::check) {
                        Ok(()) => continue,
                        Err(error) => anyhow::Error::from(error),
                    };
                    if let Some(running) = running {
                        running.abandon(runtime, &format!("{error:#}"));
                    }
                    return Err(error);
                }
            };
            match event {
                LifecycleEvent::Stop => {
                    tracing::info!("stopping");
                    notify::stopping();
                    telemetry.enter(Phase::Stopping);
                    let result = running.map_or(Ok(()), |running| running.drain(runtime, events));
                    return result.map(|()| ExitCode::SUCCESS).map_err(Into::into);
                }
                LifecycleEvent::Reload if is_preparing => is_asked_again = true,
                LifecycleEvent::Reload => is_preparing = begin_reload(options, health, sender),
                LifecycleEvent::Opened(opened) => {
                    let bound = bound.take().unwrap_or_default();
                    let begun = opened.and_then(|(generation, site)| {
                        let status = format!("{}: {} rods", generation.config.site, generation.plans.len());
                        let told = unopened.as_ref().map(Unopened::told).unwrap_or_default();
                        let site = (*site, told);
                        let begun =
                            Running::start(generation, site, options, bound, runtime, telemetry, sender)?;
                        Ok((begun, status))
                    });
                    let (begun, status) = match (begun, unopened.take()) {
                        (Ok(begun), _) => begun,
                        (Err(error), unopened) => {
                            unopened
                                .into_iter()
                                .for_each(|mut unopened| unopened.tell_end(&error));
                            return Err(error);
                        }
                    };
                    running = Some(begun);
                    telemetry.enter(Phase::Serving);
                    notify::ready(&status);
                    tracing::info!("ready");
                    is_preparing =
                        std::mem::take(&mut is_asked_again) && begin_reload(options, health, sender);
                }
                LifecycleEvent::Prepared(prepared) => {
                    match (prepared, &mut running) {
                        (Ok(generation), Some(running)) => {
                            health.make_room(CONDITIONS_OF_ROD * generation.config.rods.len());
                            running.reload(generation);
                            health.over(Fault::Reload, &about(options));
                            notify::ready("the configuration was read again");
                        }
                        (Ok(_), None) => {}
                        (Err(error), _) => keep_old(options, health, &error),
                    }
                    is_preparing =
                        std::mem::take(&mut is_asked_again) && begin_reload(options, health, sender);
                }
                LifecycleEvent::Failed(error) => {
                    if let Some(running) = running {
                        running.abandon(runtime, &format!("{error:#}"));
                    }
                    return Err(error);
                }
                LifecycleEvent::Ended(result) => {
                    let error = match result {
                        Ok(()) => anyhow::anyhow!("the work loop ended by itself"),
                        Err(error) => error.into(),
                    };
                    if let Some(running) = running {
                        running.abandon(runtime, &format!("{error:#}"));
                    }
                    return Err(error);
                }
            }
        }
    }
}

/// Loads the configuration of a daemon, which must name a store.
fn load(options: &Options) -> Result<Config, ConfigError> {
    let config = Config::resolve(Some(&options.config), &options.settings)?;
    let config = match &options.within {
        Some(folder) => config.within(folder),
        None => config,
    };
    if config.store.path.is_none() {
        return Err(ConfigError::Unreadable {
            path: options.config.clone(),
            reason: "names no store, and a daemon needs one: put `path = \"…\"` into its section [store]"
                .to_owned(),
        });
    }
    Ok(config)
}

/// Prepares the first configuration and opens the store, on a thread of its own: both may take long, and signals are
/// answered meanwhile.
fn open(
    config: Config,
    health: Arc<Health>,
    given_up: Vec<String>,
    pending: Arc<Mutex<String>>,
    sender: Sender<LifecycleEvent>,
) -> io::Result<()> {
    let work = move || {
        let generation = prepared(config)?;
        let site = opening::open_patiently(&generation, &health, &given_up, &pending)?;
        Ok((generation, Box::new(site)))
    };
    beside("open", sender, work, LifecycleEvent::Opened)
}

/// Prepares another configuration on its own thread; one that would drop a baseline is refused.
fn prepare(config: Config, given_up: Vec<String>, sender: Sender<LifecycleEvent>) -> io::Result<()> {
    let work = move || {
        if let Some(store) = &config.store.path {
            baselines::guard(&store::Reader::open(store)?, &config, &given_up)?;
        }
        prepared(config)
    };
    beside("prepare", sender, work, LifecycleEvent::Prepared)
}

/// Runs work on a thread called `name` and sends its result, even a panic.
fn beside<T: 'static>(
    name: &str,
    sender: Sender<LifecycleEvent>,
    work: impl FnOnce() -> anyhow::Result<T> + Send + 'static,
    event: fn(anyhow::Result<T>) -> LifecycleEvent,
) -> io::Result<()> {
    let whole = move || {
        let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
            let detail = message_of(&*panic);
            Err(anyhow::anyhow!("the program broke, please report it: {detail}"))
        });
        // The receiver is gone if the daemon stops.
        let _ = sender.send(event(result));
    };
    thread::Builder::new().name(name.to_owned()).spawn(whole)?;
    Ok(())
}

fn prepared(config: Config) -> anyhow::Result<Arc<Generation>> {
    Generation::prepare(config, |rod| {
        tracing::info!("preparing rod {rod}");
        |_, _| ()
    })
    .map(Arc::new)
}

/// Begins a reload; returns true if one is under way.
fn begin_reload(options: &Options, health: &Health, sender: &Sender<LifecycleEvent>) -> bool {
    notify::reloading();
    let begun = load(options)
        .map_err(anyhow::Error::from)
        .and_then(|config| Ok(prepare(config, options.given_up.clone(), sender.clone())?));
    match begun {
        Ok(()) => true,
        Err(error) => {
            keep_old(options, health, &error);
            false
        }
    }
}

/// Subject of a condition of the configuration.
fn about(options: &Options) -> String {
    options.config.display().to_string()
}

/// Ends a failed reload. All faults go to the log; the condition lasts until a configuration is taken.
fn keep_old(options: &Options, health: &Health, error: &anyhow::Error) {
    for line in error.to_string().lines() {
        tracing::error!("{line}");
    }
    let what = match error.downcast_ref::<baselines::BaselineError>() {
        Some(baselines::BaselineError::Refused(refused)) => format!(
            "the new configuration would drop a baseline, the old one holds: {}; `tirante check --against STORE` lists every change",
            refused.brief()
        ),
        _ if error.is::<ConfigError>() => {
            "the new configuration is bad, the old one holds; `tirante check` lists its faults".to_owned()
        }
        _ => format!("the new configuration cannot be taken, the old one holds: {error:#}"),
    };
    if health.lasts(Fault::Reload, &about(options)) {
        health.fault(Fault::Reload, &what);
    } else {
        health.hold(Fault::Reload, &about(options), &what);
    }
    notify::ready("the new configuration is bad, the old one holds");
}
