//! `tirante hub rebuild`: folds the whole stream into an emptied database.

use crate::command::WITH_LOSSES;
use crate::config::HubConfig;
use crate::service::hub::{self, Hub};
use crate::service::telemetry::Health;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Empty the database and fold the whole stream anew.
///
/// The hub must be stopped. Refused if the stream no longer begins with the first commit of a site that the database has:
/// its earlier results would be lost. A rebuild that was interrupted is run again.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  tirante hub rebuild --config hub.toml")]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// The stream lacks results, or server, stream or database fail.
pub fn run(config: &HubConfig) -> anyhow::Result<ExitCode> {
    let begun = Instant::now();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let stopping = Arc::<AtomicBool>::default();
    let last = Hub::new(config, &runtime, Arc::<Health>::default(), stopping).rebuild()?;
    runtime.shutdown_background();
    let sites = hub::beside(&config.storage)?.sites()?;
    let marked = sites.values().filter(|state| state.fault.is_some()).count();
    tell!(
        "folded up to message {last} of the stream in {:.1} s: {} sites, {marked} with parked messages",
        begun.elapsed().as_secs_f64(),
        sites.len()
    );
    Ok(if marked == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(WITH_LOSSES)
    })
}
