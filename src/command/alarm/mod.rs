//! `tirante alarm`: limits and false-alarm rate of the drift alarm, their check by simulation, and a test of
//! its messages.

mod design;
mod prove;
mod stiffer;
mod test;

use std::process::ExitCode;

/// Check the drift alarm: limits, false alarms, sinks.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante alarm design --noise 0.003
  tirante alarm design --config config/campaign.toml --rod nave-3 \\
      --frequency-sd 0.0005 --format json
  tirante alarm prove --world masonry-30d,harsh --histories 400
  tirante alarm test --config site.toml --sink mail")]
pub struct Args {
    /// Action to take.
    #[command(subcommand)]
    pub action: Action,
}

/// The subcommands of `alarm`; their help is that of their arguments.
#[derive(Debug, Clone, clap::Subcommand)]
#[allow(missing_docs, reason = "clap would show it instead of the long help")]
pub enum Action {
    Design(design::Args),
    Prove(prove::Args),
    Test(test::Args),
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    match &args.action {
        Action::Design(args) => design::run(args),
        Action::Prove(args) => prove::run(args),
        Action::Test(args) => test::run(args),
    }
}
