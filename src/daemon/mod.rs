//! The daemon: sources, pipeline, site and sinks, all live at once.
//!
//! docs/daemon.md tells the way of a record through it. [`run`] is its life: prepare, open, run, reload, drain.

pub mod core;
pub mod generation;
pub mod job;
mod opening;
mod pipe;
mod restart;
mod retention;
mod running;
mod signals;
mod silence;
mod stand_in;
pub mod suspects;
mod workers;

pub use generation::Generation;
pub use job::Job;

use crate::config::{Config, ConfigError, Setting};
use crate::pipeline::message_of;
use crate::site::Site;
use crate::telemetry::{Fault, Health};
use running::Running;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use std::thread;
use std::time::Duration;

/// How often the threads are looked after.
const LOOK: Duration = Duration::from_secs(1);

/// What a daemon is started with.
#[derive(Debug, Clone)]
pub struct Options {
    /// The configuration; it is read again on SIGHUP.
    pub config: PathBuf,
    /// What is put over it.
    pub settings: Vec<Setting>,
    /// Threads that analyse; by default one per core.
    pub threads: Option<usize>,
}

/// What happens to a daemon.
enum Happening {
    /// SIGTERM or SIGINT.
    Stop,
    /// SIGHUP.
    Reload,
    /// The first configuration is prepared and the store is open, or cannot be.
    Opened(anyhow::Result<(Arc<Generation>, Box<Site>)>),
    /// Another configuration is prepared, or cannot be.
    Prepared(anyhow::Result<Arc<Generation>>),
    /// The work loop came to its end.
    Ended(Result<(), core::Broken>),
}

/// Runs until it is told to stop (exit code 0), or cannot go on.
///
/// # Errors
/// The configuration is bad, the store is another process's or cannot be opened, or something that must be durable
/// cannot be written.
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let config = load(options)?;
    let health = Arc::new(Health::default());
    let (tell, happenings) = channel();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("io")
        .enable_all()
        .build()?;
    signals::listen(&runtime, tell.clone())?;
    open(config, Arc::clone(&health), tell.clone())?;

    let mut running: Option<Running> = None;
    // One configuration is prepared at a time; a SIGHUP meanwhile is answered after it.
    let (mut is_preparing, mut is_asked_again) = (true, false);
    loop {
        let happening = match happenings.recv_timeout(LOOK) {
            Ok(happening) => happening,
            Err(_) => {
                running.as_ref().map_or(Ok(()), Running::check)?;
                continue;
            }
        };
        match happening {
            Happening::Stop => {
                tracing::info!("stopping");
                let result = running.map_or(Ok(()), |running| running.drain(&happenings));
                return result.map(|()| ExitCode::SUCCESS).map_err(Into::into);
            }
            Happening::Reload if is_preparing => is_asked_again = true,
            Happening::Reload => is_preparing = begin_reload(options, &health, &tell),
            Happening::Opened(opened) => {
                let (generation, site) = opened?;
                let begun = Running::start(generation, *site, options, Arc::clone(&health), tell.clone())?;
                running = Some(begun);
                tracing::info!("ready");
                is_preparing = std::mem::take(&mut is_asked_again) && begin_reload(options, &health, &tell);
            }
            Happening::Prepared(prepared) => {
                match (prepared, &mut running) {
                    (Ok(generation), Some(running)) => running.reload(generation),
                    (Ok(_), None) => {}
                    (Err(error), _) => keep_old(&health, &error),
                }
                is_preparing = std::mem::take(&mut is_asked_again) && begin_reload(options, &health, &tell);
            }
            Happening::Ended(result) => {
                if let Some(running) = running {
                    running.abandon();
                }
                result?;
                anyhow::bail!("the work loop ended by itself");
            }
        }
    }
}

/// The configuration of a daemon: one that names a store.
fn load(options: &Options) -> Result<Config, ConfigError> {
    let config = Config::resolve(Some(&options.config), &options.settings)?;
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
fn open(config: Config, health: Arc<Health>, tell: Sender<Happening>) -> io::Result<()> {
    let work = move || {
        let generation = prepared(config)?;
        let site = opening::open_patiently(&generation, &health)?;
        Ok((generation, Box::new(site)))
    };
    beside("open", tell, work, Happening::Opened)
}

/// Prepares another configuration on a thread of its own.
fn prepare(config: Config, tell: Sender<Happening>) -> io::Result<()> {
    beside("prepare", tell, || prepared(config), Happening::Prepared)
}

/// Does some work on a thread called `name` and tells what came of it, whatever that is.
fn beside<T: 'static>(
    name: &str,
    tell: Sender<Happening>,
    work: impl FnOnce() -> anyhow::Result<T> + Send + 'static,
    happening: fn(anyhow::Result<T>) -> Happening,
) -> io::Result<()> {
    let whole = move || {
        let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
            let detail = message_of(&*panic);
            Err(anyhow::anyhow!("the program broke, please report it: {detail}"))
        });
        // Nobody listens any more if the daemon stops.
        let _ = tell.send(happening(result));
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

/// Begins a reload; whether one is under way.
fn begin_reload(options: &Options, health: &Health, tell: &Sender<Happening>) -> bool {
    let begun = load(options)
        .map_err(anyhow::Error::from)
        .and_then(|config| Ok(prepare(config, tell.clone())?));
    match begun {
        Ok(()) => true,
        Err(error) => {
            keep_old(health, &error);
            false
        }
    }
}

/// All faults go to the log, one fault to health.
fn keep_old(health: &Health, error: &anyhow::Error) {
    for line in error.to_string().lines() {
        tracing::error!("{line}");
    }
    health.fault(
        Fault::Reload,
        "the new configuration is bad, the old one holds; `tirante check` lists its faults",
    );
}
