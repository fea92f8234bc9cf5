//! `tirante check`: reports every fault of a configuration at once, or prints the effective one.

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
    /// Configuration; default: the built-in rod of the paper.
    #[arg(value_name = "FILE", conflicts_with = "config")]
    pub path: Option<PathBuf>,
    /// Configuration, as for the other commands.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one configuration key (KEY=VALUE); may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,
    /// Print only faults and set the exit code; no effective configuration.
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

/// Reports the faults of a configuration on stderr; returns the exit code of bad arguments.
pub fn refuse(error: &ConfigError) -> ExitCode {
    tell!("{error}");
    if let ConfigError::Faults { origin, faults } = error {
        let plural = if faults.len() == 1 { "" } else { "s" };
        tell!("{origin}: {} fault{plural}", faults.len());
    }
    ExitCode::from(super::USAGE)
}
