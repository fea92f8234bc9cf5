//! `tirante check`: a configuration, every fault at once, or what holds.

use crate::config::{Config, ConfigError, Setting};
use std::path::PathBuf;
use std::process::ExitCode;

/// Check a configuration: report every fault, or print what holds.
///
/// Every fault comes with its key and line (exit code 2). Without a fault the configuration is printed with all
/// defaults filled in.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante check config/todi.toml
  tirante check config/todi.toml --set abc.draws=1000000")]
pub struct Args {
    /// The configuration; without one, the built-in rod of the paper.
    #[arg(value_name = "FILE", conflicts_with = "config")]
    pub path: Option<PathBuf>,
    /// The configuration, as for the other commands.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// A setting over the configuration's, as KEY=VALUE; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,
    /// Only the exit code and the faults, no effective configuration.
    #[arg(long, short)]
    pub quiet: bool,
}

/// Runs the command.
///
/// # Errors
/// Standard output cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let path = args.path.as_deref().or(args.config.as_deref());
    let config = Config::resolve(path, &args.settings);
    match config {
        Ok(config) => {
            if !args.quiet {
                return super::print(config.effective().as_bytes());
            }
            Ok(ExitCode::SUCCESS)
        }
        Err(error) => Ok(refuse(&error)),
    }
}

/// Says on standard error what is wrong with a configuration; the exit code of bad arguments.
pub fn refuse(error: &ConfigError) -> ExitCode {
    tell!("{error}");
    if let ConfigError::Faults { origin, faults } = error {
        let plural = if faults.len() == 1 { "" } else { "s" };
        tell!("{origin}: {} fault{plural}", faults.len());
    }
    ExitCode::from(super::USAGE)
}
