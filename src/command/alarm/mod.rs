//! `tirante alarm`: what the drift alarm promises, the proof, and whether messages arrive.

mod design;
mod prove;
mod test;

use std::process::ExitCode;

/// What the drift alarm promises for a rod, the proof of it by simulated years of sites, and whether its messages arrive.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante alarm design --noise 0.003
  tirante alarm design --config config/campaign.toml --rod nave-3 --frequency-sd 0.0005 --json
  tirante alarm prove --world masonry-30d,harsh --histories 400
  tirante alarm test --config site.toml --sink mail")]
pub struct Args {
    /// What to do.
    #[command(subcommand)]
    pub action: Action,
}

/// What to do with the alarm.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Action {
    /// Print the false-alarm rate, delays by simulation of this rod, and the smallest change that is told.
    Design(design::Args),
    /// Simulate years of whole sites, follow them with the real trackers, and print how often they alarmed beside what is stated.
    Prove(prove::Args),
    /// Send a test message to every sink of a configuration, and say which of them have it.
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
