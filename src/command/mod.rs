//! One file per subcommand, each with one `run`.

/// A line of diagnostics on stderr. A stderr that cannot be written (full, closed) must not lose
/// results, let alone panic as the standard macro does.
macro_rules! tell {
    ($($part:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($part)*);
    }};
}

pub mod ack;
mod again;
pub mod alarm;
pub mod backup;
mod campaign;
pub mod check;
pub mod cli;
pub mod completions;
mod draws;
pub mod emulator;
pub mod files;
mod findings;
pub mod fleet;
mod foreign;
pub mod frequencies;
pub mod history;
pub mod hub;
pub mod identify;
pub mod import;
pub mod init;
mod listing;
pub mod manual;
pub mod measure;
mod measure_files;
pub mod parquet;
pub mod plan;
mod progress;
mod quantities;
mod questions;
pub mod rebaseline;
mod render;
pub mod replay;
pub mod report;
pub mod report_page;
mod rod_flags;
pub mod run;
mod sections;
pub mod send;
mod sensor;
pub mod serve;
mod setup;
pub mod simulate;
pub mod sketch;
pub mod spectrum;
pub mod status;
pub mod study;
mod tally;
mod template;
mod tests_of_rod;
mod topics;
pub mod track;
pub mod trial;
pub mod which_store;
pub mod work;

use crate::analysis::inference::PlanError;
use crate::config::ConfigError;
use crate::site::baselines::BaselineError;
use clap::CommandFactory;
use cli::{Cli, Command};
use std::io::{self, Write};
use std::process::ExitCode;

/// Exit code: finished, but with rejections or lost data.
pub const WITH_LOSSES: u8 = 3;
/// Exit code: bad arguments or configuration.
pub const USAGE: u8 = 2;

/// Runs the subcommand.
pub fn run(command: &Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Replay(args) => replay::run(args),
        Command::Identify(args) => identify::run(args),
        Command::Files(args) => files::run(args),
        Command::Frequencies(args) => frequencies::run(args),
        Command::Plan(args) => plan::run(args),
        Command::Emulator(args) => emulator::run(args),
        Command::Check(args) => check::run(args),
        Command::Import(args) => import::run(args),
        Command::Spectrum(args) => spectrum::run(args),
        Command::Init(args) => init::run(args),
        Command::Measure(args) => measure::run(args),
        Command::Simulate(args) => simulate::run(args),
        Command::Alarm(args) => alarm::run(args),
        Command::Status(args) => status::run(args),
        Command::History(args) => history::run(args),
        Command::Report(args) => report::run(args),
        Command::Ack(args) => ack::run(args),
        Command::Rebaseline(args) => rebaseline::run(args),
        Command::Backup(args) => backup::run(args),
        Command::Study(args) => study::run(args),
        Command::Track(args) => track::run(args),
        Command::Fleet(args) => fleet::run(args),
        Command::Run(args) => run::run(args),
        Command::Hub(args) => hub::run(args),
        Command::Work(args) => work::run(args),
        Command::Serve(args) => serve::run(args),
        Command::Send(args) => send::run(args),
        Command::Completions(args) => completions::run(args, &mut Cli::command()),
        Command::Manual(args) => manual::run(args, &Cli::command()),
    }
}

/// Arguments that parse but contradict each other; ends with exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadArguments(pub String);

/// Reports an error on stderr and returns the exit code: 2 for arguments and configuration, 1 for
/// everything else. A reader that closes stdout (`| head`) is no failure.
pub fn report(error: &anyhow::Error) -> ExitCode {
    if let Some(faults) = error.downcast_ref::<ConfigError>() {
        return check::refuse(faults);
    }
    let seen_enough = |error: &io::Error| error.kind() == io::ErrorKind::BrokenPipe;
    if error.downcast_ref().is_some_and(seen_enough) {
        return ExitCode::SUCCESS;
    }
    // A cause that the words before it name already is not named again.
    let words = error.chain().skip(1).fold(error.to_string(), |words, cause| {
        let cause = cause.to_string();
        match words.contains(&cause) {
            true => words,
            false => format!("{words}: {cause}"),
        }
    });
    tell!("error: {words}");
    let is_refused = matches!(error.downcast_ref(), Some(BaselineError::Refused(_)));
    if is_refused || error.is::<BadArguments>() || error.is::<PlanError>() {
        ExitCode::from(USAGE)
    } else {
        ExitCode::FAILURE
    }
}

/// Writes results to stdout.
fn print(text: &[u8]) -> anyhow::Result<ExitCode> {
    let mut out = io::stdout().lock();
    out.write_all(text)?;
    out.flush()?;
    Ok(ExitCode::SUCCESS)
}
