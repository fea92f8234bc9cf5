//! Arguments as typed.

use crate::command::{
    ack, alarm, backup, check, completions, emulator, files, fleet, frequencies, history, hub, identify,
    import, init, manual, measure, plan, rebaseline, replay, report, run, send, serve, simulate, spectrum,
    status, study, track, work,
};
use crate::service::telemetry::log;
use clap::{ArgAction, Parser, Subcommand};
use tracing_subscriber::EnvFilter;

/// Axial force of historic tie-rods from contactless vibration records.
///
/// Results go to stdout, diagnostics to stderr. Exit codes: 0 good, 1 failed, 2 bad arguments or
/// configuration, 3 finished with rejected records or lost data.
#[derive(Debug, Parser)]
#[command(name = "tirante", version, propagate_version = true, max_term_width = 80)]
pub struct Cli {
    /// The command to run.
    #[command(subcommand)]
    pub command: Command,

    /// Log more on stderr; twice for everything.
    #[arg(short, long, global = true, action = ArgAction::Count)]
    pub verbose: u8,

    /// Format of the log; by default the journal's if stderr leads there, else plain lines.
    #[arg(long, global = true, value_name = "FORMAT")]
    pub log: Option<log::Format>,
}

/// The subcommands. Their help is that of their arguments: a comment on a variant would take its place.
#[derive(Debug, Subcommand)]
#[allow(missing_docs, reason = "clap would show it instead of the long help")]
pub enum Command {
    Measure(measure::Args),
    Replay(replay::Args),
    Track(track::Args),
    Run(run::Args),
    Status(status::Args),
    Serve(serve::Args),
    History(history::Args),
    Files(files::Args),
    Report(report::Args),
    Ack(ack::Args),
    Rebaseline(rebaseline::Args),
    Backup(backup::Args),
    Alarm(alarm::Args),
    Identify(identify::Args),
    Spectrum(spectrum::Args),
    Init(init::Args),
    Import(import::Args),
    Simulate(simulate::Args),
    Frequencies(frequencies::Args),
    Plan(plan::Args),
    Emulator(emulator::Args),
    Study(study::Args),
    Send(send::Args),
    Fleet(fleet::Args),
    Hub(hub::Args),
    Work(work::Args),
    Completions(completions::Args),
    #[command(hide = true)]
    Manual(manual::Args),
    Check(check::Args),
}

impl Cli {
    /// Starts the log on stderr: warnings by default (of the daemon also what it does), more with `-v`, or as
    /// `TIRANTE_LOG` says.
    pub fn start_logging(&self) {
        let is_daemon = matches!(self.command, Command::Run(_) | Command::Work(_))
            || matches!(&self.command, Command::Hub(args) if args.action.is_none());
        let default = match self.verbose + u8::from(is_daemon) {
            0 => "warn",
            // Every connection to the post has lines of its own; what fails is a condition.
            1 => "info,async_nats=warn",
            _ => "debug",
        };
        let filter = EnvFilter::try_from_env("TIRANTE_LOG").unwrap_or_else(|_| EnvFilter::new(default));
        log::start(self.log, filter, is_daemon);
    }
}
