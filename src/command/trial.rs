//! `tirante trial`: the process of its own in which the daemon tries a step that it may have died of.

use crate::service::daemon::trial::apart;
use std::process::ExitCode;

/// Take one step that the daemon hands over on standard input. Not for people.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// The step cannot be begun.
pub fn run(_args: &Args) -> anyhow::Result<ExitCode> {
    apart::run().map(|()| ExitCode::SUCCESS)
}
