//! `tirante replay`: recordings through the whole pipeline.

use super::campaign::{self, Reading};
use super::render::{self, Table};
use super::setup::{self, Setup};
use crate::record::RodId;
use crate::site::Site;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// Runs recordings through the whole pipeline and prints, per record, the natural frequencies with
/// their standard errors and the posterior of the axial force.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante replay recordings/todi-pull.mcap
  tirante replay recordings/campaign --config config/campaign.toml
  tirante replay /data/2026 --config site.toml --json > forces.jsonl

A ' !' behind the conflict says that no parameters of the model reproduce the measured frequencies
within their errors: the force may be wrong by more than its interval says. A ' ?' says that hardly
any rod the prior allows has such frequencies: check length, section, material and expected force.")]
pub struct Args {
    /// MCAP recordings, or folders of them.
    #[arg(value_name = "PATH", required = true)]
    pub paths: Vec<PathBuf>,

    /// One JSON object per record on stdout instead of the table.
    #[arg(long)]
    pub json: bool,

    /// How recordings are read.
    #[command(flatten)]
    pub reading: Reading,

    /// The configuration.
    #[command(flatten)]
    pub setup: Setup,
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, no recording at all, or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = args.setup.load()?;
    let plans = setup::plans(&config)?;
    let provenance = setup::provenance(&config);
    let modes = config
        .rods
        .iter()
        .map(|rod| rod.analysis.modes.count)
        .max()
        .unwrap_or(0);
    let rods: Vec<&RodId> = config.rods.iter().map(|rod| &rod.analysis.rod).collect();
    let table = Table::new(rods.into_iter(), modes);

    let mut site = Site::new(setup::track_plans(&config, &plans).into_iter());
    let mut output = io::stdout().lock();
    let mut header_due = !args.json;
    let tally = campaign::run(&args.paths, &config, &plans, &args.reading, |outcome, bar| {
        let verdict = site.take(outcome);
        bar.suspend(|| {
            if header_due {
                header_due = false;
                writeln!(output, "{}\n{}", config.site, table.header())?;
            }
            let line = match &verdict {
                Some(verdict) if !args.json => table.row(outcome, verdict),
                _ => render::json(outcome, verdict.as_ref(), &provenance),
            };
            writeln!(output, "{line}")
        })
    })?;
    Ok(campaign::conclude(tally))
}
