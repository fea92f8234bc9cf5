//! `tirante hub sites`: all sites, worst first.

use super::listed;
use crate::command::listing::minutes;
use crate::command::which_store::Format;
use crate::config::HubConfig;
use crate::service::hub;
use crate::service::hub::sites::{SiteRow, list};
use crate::site::clock;
use std::process::ExitCode;

/// List all sites, worst first.
///
/// An alarm is worst, then parked messages, silence, rods that are not monitored. A site with more than one store has a
/// history in segments; the present one began when it was replaced.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante hub sites --config hub.toml
  tirante hub sites --config hub.toml --format json | jq 'select(.alarms > 0)'")]
pub struct Args {
    /// Output format.
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Runs the command.
///
/// # Errors
/// The database cannot be read, or stdout cannot be written.
pub fn run(args: &Args, config: &HubConfig) -> anyhow::Result<ExitCode> {
    let mut centre = hub::beside(&config.storage)?;
    let rows = list(&mut centre, &config.sites, clock::now().as_nanos())?;
    let text = listed(&rows, args.format, &HEAD, cells)?;
    for row in &rows {
        if let Some(detail) = &row.detail {
            tell!("{}: {} messages parked: {detail}", row.site, row.parked);
        }
        for said in row.sentences() {
            tell!("{}: {said}", row.site);
        }
    }
    crate::command::print(text.as_bytes())
}

const HEAD: [&str; 8] = [
    "site",
    "worst",
    "rods",
    ">alarms",
    "latest record (UTC)",
    "heard (UTC)",
    ">commits",
    ">stores",
];

fn cells(row: &SiteRow) -> [String; 8] {
    let rods: Vec<String> = row
        .rods
        .iter()
        .map(|(state, count)| format!("{count} {state}"))
        .collect();
    let time = |time: &Option<String>| time.as_deref().map_or_else(|| "-".to_owned(), minutes);
    [
        row.site.clone(),
        row.worst.code().to_owned(),
        rods.join(", "),
        row.alarms.to_string(),
        time(&row.latest_record),
        time(&row.heard),
        row.through.to_string(),
        row.stores.to_string(),
    ]
}
