//! `tirante hub`: the centre of many sites.

mod command;
mod compare;
mod key;
mod parked;
mod rebuild;
mod report;
mod serve;
mod sites;
mod store;

use super::BadArguments;
use super::listing::{Aligned, csv, is_coloured};
use super::which_store::Format;
use crate::config::HubConfig;
use clap::Subcommand;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;

/// Run the centre of many sites: fold what their daemons forward into one database.
///
/// Each site's daemon forwards its results to NATS JetStream (section `forward` of its configuration). The hub folds them,
/// exactly once and in order, into PostgreSQL, or into SQLite for up to some 200 rods, and shows all sites, worst first. A
/// message that cannot be folded is parked with its reason; its site is marked, the others go on.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante hub --config hub.toml                  # fold and serve until stopped
  tirante hub sites --config hub.toml            # list of sites, worst first
  tirante hub compare todi --store replayed.db \\
      --config hub.toml                          # equal row by row?
  tirante hub report todi --out reports/ \\
      --config hub.toml                          # its page, from the centre's rows
  tirante hub store todi --out todi.db \\
      --config hub.toml                          # its rows as a store
  tirante hub rebuild --config hub.toml          # fold the whole stream anew

Exit codes: 0 good; 1 something cannot be opened, or is not fit (the server is
older than 2.12, the stream has no limits); 2 bad arguments or configuration;
3 `compare` found a difference, or `rebuild` left messages parked.
`sites` and `compare` work beside a running hub. docs/hub.md tells how to set
up server, database and sites; config/fleet/try.sh starts them all.")]
pub struct Args {
    /// Configuration of the hub.
    #[arg(long, value_name = "FILE", global = true)]
    pub config: Option<PathBuf>,

    /// Task instead of folding and serving.
    #[command(subcommand)]
    pub action: Option<Action>,
}

/// Actions besides folding.
#[derive(Debug, Subcommand)]
#[allow(missing_docs, reason = "clap would show it instead of the long help")]
pub enum Action {
    Sites(sites::Args),
    Command(command::Args),
    Compare(compare::Args),
    Parked(parked::Args),
    Rebuild(rebuild::Args),
    Report(report::Args),
    Store(store::Args),
    Key(key::Args),
}

/// Runs the command.
///
/// # Errors
/// The configuration is bad, or server, stream or database are not fit or cannot be reached.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = || -> anyhow::Result<HubConfig> {
        let path = args
            .config
            .as_deref()
            .ok_or_else(|| BadArguments("name the configuration of the hub: --config hub.toml".to_owned()))?;
        Ok(HubConfig::load(path)?)
    };
    match &args.action {
        None => serve::run(config()?),
        Some(Action::Sites(sites)) => sites::run(sites, &config()?),
        Some(Action::Command(command)) => command::run(command, &config()?),
        Some(Action::Compare(compare)) => compare::run(compare, &config()?),
        Some(Action::Parked(parked)) => parked::run(parked, &config()?),
        Some(Action::Rebuild(_)) => rebuild::run(&config()?),
        Some(Action::Report(report)) => report::run(report, &config()?),
        Some(Action::Store(store)) => store::run(store, &config()?),
        Some(Action::Key(key)) => key::run(key),
    }
}

/// Rows in a format of `listing`; each head stands over its cell.
fn listed<T: Serialize, const N: usize>(
    rows: &[T],
    format: Format,
    heads: &[&str; N],
    cells: impl Fn(&T) -> [String; N],
) -> anyhow::Result<String> {
    Ok(match format {
        Format::Json => {
            let lines: Result<Vec<String>, _> = rows
                .iter()
                .map(|row| serde_json::to_string(row).map(|line| line + "\n"))
                .collect();
            lines?.concat()
        }
        Format::Csv => {
            let mut out = csv(heads.map(|head| head.trim_start_matches('>')));
            for row in rows {
                out += &csv(cells(row).iter().map(String::as_str));
            }
            out
        }
        Format::Table => {
            let mut table = Aligned::new(heads);
            rows.iter().for_each(|row| table.push(cells(row).to_vec()));
            table.print(is_coloured())
        }
    })
}
