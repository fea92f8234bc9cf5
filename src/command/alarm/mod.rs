//! `tirante alarm`: limits and false-alarm rate of the drift alarm, their check by simulation, and a test of
//! its messages.

mod design;
mod prove;
mod test;

use std::process::ExitCode;

/// Show the drift alarm's limits and false-alarm rate, check them by simulation, and test its messages.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante alarm design --noise 0.003
  tirante alarm design --config config/campaign.toml --rod nave-3 --frequency-sd 0.0005 --json
  tirante alarm prove --world masonry-30d,harsh --histories 400
  tirante alarm test --config site.toml --sink mail")]
pub struct Args {
    /// Action to take.
    #[command(subcommand)]
    pub action: Action,
}

/// Action of `tirante alarm`.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Action {
    /// Print the false-alarm rate, delays by simulation of this rod, and the smallest change detected.
    Design(design::Args),
    /// Simulate years of whole sites, track them with the real trackers, and compare their alarm rates with
    /// the stated ones.
    Prove(prove::Args),
    /// Send a test message to every sink of a configuration, and list the sinks that received it.
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
