//! `tirante run`: runs the daemon.

use super::setup::GivenUp;
use crate::config::Setting;
use crate::service::daemon::{self, Options};
use std::path::PathBuf;
use std::process::ExitCode;

/// Run the daemon: read live sources, keep results, send alarms.
///
/// Reads a folder and sockets until SIGTERM or SIGINT (exit code 0 within 5 seconds, nothing lost). SIGHUP reads
/// the configuration again; an invalid one is refused with all its faults, and the old one stays in use.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante check site.toml && tirante run --config site.toml
  tirante run --config site.toml --set 'store.path=\"/var/lib/tirante/site.db\"' \\
      --threads 1
  systemctl start tirante            # as the package installs it

Exit codes: 0 it was told to stop; 1 something cannot be opened or written
(another process has the store, the disk refuses); 2 bad arguments or
configuration, found before anything is opened. A full disk is waited for.
`tirante status --config site.toml`, `history`, `report`, `ack` and `rebaseline`
work beside it.")]
pub struct Args {
    /// Configuration. It must name a store: `[store] path`.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,

    /// Override one configuration key, also after every reload; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,

    /// Rods whose baselines may be dropped.
    #[command(flatten)]
    pub given_up: GivenUp,

    /// Number of threads that analyse records; others read, write and send. Default: one per core. Results
    /// are bit-identical for any number.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,

    /// Work for the worker that started it, with everything in this folder, and end with it.
    #[arg(long, hide = true)]
    pub within: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// The configuration is bad, the store cannot be opened, or something that must be durable cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if args.within.is_some() {
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL))?;
    }
    daemon::run(&Options {
        config: args.config.clone(),
        settings: args.settings.clone(),
        threads: args.threads.map(usize::from),
        given_up: args.given_up.rods(),
        // The very program that runs, also after an upgrade put another in its place.
        program: Some(PathBuf::from("/proc/self/exe")),
        within: args.within.clone(),
    })
}
