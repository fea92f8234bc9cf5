//! Arguments as typed.

use crate::command::{
    ack, alarm, backup, check, completions, emulator, frequencies, history, identify, import, init, manual,
    measure, plan, rebaseline, replay, report, run, send, serve, simulate, spectrum, status, study, track,
};
use crate::service::telemetry::log;
use clap::{ArgAction, Parser, Subcommand};
use tracing_subscriber::EnvFilter;

/// The axial force of historic tie-rods from contactless vibration records.
///
/// Results go to stdout, diagnostics to stderr. Exit codes: 0 good, 1 failed, 2 bad arguments or
/// configuration, 3 finished with rejected records or lost data.
#[derive(Debug, Parser)]
#[command(name = "tirante", version, propagate_version = true, max_term_width = 100)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,

    /// Say more on stderr; twice for everything.
    #[arg(short, long, global = true, action = ArgAction::Count)]
    pub verbose: u8,

    /// The form of the log; without it, the journal's if stderr leads there, else plain lines.
    #[arg(long, global = true, value_name = "FORMAT")]
    pub log: Option<log::Format>,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Measure the axial force once: one file to force, configuration and report.
    Measure(measure::Args),
    /// Recordings through the whole pipeline: frequencies, axial force, and what changed since the baseline.
    Replay(replay::Args),
    /// Tables of frequencies identified elsewhere: what changed since the baseline, and alarms.
    Track(track::Args),
    /// The daemon: live sources, results kept, alarms sent.
    Run(run::Args),
    /// How every rod of a store stands: state, force, change since the baseline, alarms.
    Status(status::Args),
    /// A store as a web page.
    Serve(serve::Args),
    /// What a store holds: records, periods, alarms, rejections.
    History(history::Args),
    /// What a store knows as one page with figures, to read and print.
    Report(report::Args),
    /// Somebody knows of an alarm.
    Ack(ack::Args),
    /// Begins a new baseline of a rod.
    Rebaseline(rebaseline::Args),
    /// A copy of a store, while the daemon writes to it.
    Backup(backup::Args),
    /// What the drift alarm promises for a rod, and the proof of it.
    Alarm(alarm::Args),
    /// One recording, or frequencies measured elsewhere, to the posterior of the axial force.
    Identify(identify::Args),
    /// Every peak of a measurement, without a rod: look at it first.
    Spectrum(spectrum::Args),
    /// A commented configuration for one rod, from flags, questions and a recording.
    Init(init::Args),
    /// Measurements of other programs (CSV, UFF58, WAV, MATLAB, LabVIEW, NumPy) to a recording.
    Import(import::Args),
    /// Recordings from the beam model, faults included, as MCAP files.
    Simulate(simulate::Args),
    /// Natural frequencies of a given rod, by every forward model side by side.
    Frequencies(frequencies::Args),
    /// What to measure next at a rod: the share of the force's uncertainty each measurement leaves.
    Plan(plan::Args),
    /// Fits and judges the emulators.
    Emulator(emulator::Args),
    /// The source paper's study, held against what it prints.
    Study(study::Args),
    /// A recording into the daemon's socket, at a chosen speed.
    Send(send::Args),
    /// What a shell completes after `tirante`, on stdout.
    Completions(completions::Args),
    /// Man pages and shell completions, for packages.
    #[command(hide = true)]
    Manual(manual::Args),
    /// A configuration: every fault at once with its key and line, or what holds.
    Check(check::Args),
}

impl Cli {
    /// Starts the log on stderr: warnings by default (of the daemon also what it does), more with `-v`, or as
    /// `TIRANTE_LOG` says.
    pub fn start_logging(&self) {
        let is_daemon = matches!(self.command, Command::Run(_));
        let default = match self.verbose + u8::from(is_daemon) {
            0 => "warn",
            1 => "info",
            _ => "debug",
        };
        let filter = EnvFilter::try_from_env("TIRANTE_LOG").unwrap_or_else(|_| EnvFilter::new(default));
        log::start(self.log, filter, is_daemon);
    }
}
