//! `tirante manual`: man pages and shell completions.

use std::process::ExitCode;

/// Writes man pages and completions.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// Not there yet.
pub fn run(_args: &Args) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
