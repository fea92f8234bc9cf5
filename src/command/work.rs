//! `tirante work`: monitors sites without a computer from the centre.

use super::BadArguments;
use crate::config::HubConfig;
use crate::service::hub::thin::{BeginError, Choice, Worker};
use crate::service::telemetry::process;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};

/// Monitor sites without a computer, whose samples come through the post.
///
/// A sensor or logger publishes its samples on `tirante.v1.raw.SITE`: whole MCAP recordings, or JSON lines. A worker takes sites
/// that have a `config` in the hub's list, each under a lease, and runs the daemon of each. Results, state and position are
/// written to PostgreSQL in one transaction; a worker that ends, or stands still for longer than its lease, loses its sites to
/// another, and nothing of them.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante work --config hub.toml                 # all sites that are free
  tirante work --config hub.toml --sites 'umbria-*' --most 20
  tirante hub sites --config hub.toml            # who has which site

Exit codes: 0 it was told to stop, and its sites are free; 1 post or database
cannot be reached or are not fit; 2 bad arguments or configuration.
Several workers share the sites; SIGHUP reads the sites' configurations again.
docs/hub.md has a section on sites without a computer.")]
pub struct Args {
    /// Configuration of the hub, with the list of sites.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,

    /// Sites to take, by name or by its beginning with a `*` behind; may be repeated. Default: all.
    #[arg(long, value_name = "NAME")]
    pub sites: Vec<String>,

    /// Most sites at once; the others are left to other workers. Each costs a process and a connection to PostgreSQL.
    #[arg(long, value_name = "COUNT", default_value_t = 50, value_parser = clap::value_parser!(u16).range(1..))]
    pub most: u16,

    /// Time after which a site is free again if its worker does not say that it lives, in seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(2..=3600))]
    pub lease: u64,
}

/// Runs the command.
///
/// # Errors
/// The configuration is bad, or database or post are not fit or cannot be reached.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = HubConfig::load(&args.config)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("io")
        .enable_all()
        .build()?;
    let (stopping, reloads) = (Arc::<AtomicBool>::default(), Arc::<AtomicU64>::default());
    let (mut interrupt, mut terminate, mut hangup) = {
        let _entered = runtime.enter();
        (
            signal(SignalKind::interrupt())?,
            signal(SignalKind::terminate())?,
            signal(SignalKind::hangup())?,
        )
    };
    let (stop, reload) = (Arc::clone(&stopping), Arc::clone(&reloads));
    runtime.spawn(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        stop.store(true, Ordering::Relaxed);
    });
    runtime.spawn(async move {
        while hangup.recv().await.is_some() {
            reload.fetch_add(1, Ordering::Relaxed);
        }
    });
    let choice = Choice {
        sites: args.sites.clone(),
        most: usize::from(args.most),
        lease: Duration::from_secs(args.lease),
        holder: format!("{}/{}", process::host(), std::process::id()),
    };
    let worker = match Worker::new(&config, &runtime, choice, (stopping, reloads)) {
        Err(error @ (BeginError::NoSites(_) | BeginError::Unfit(_))) => {
            return Err(BadArguments(error.to_string()).into());
        }
        begun => begun?,
    };
    tell!(
        "ready: {} sites without a computer on the list",
        worker.candidates()
    );
    worker.run();
    drop(worker);
    runtime.shutdown_background();
    Ok(ExitCode::SUCCESS)
}
