//! `tirante hub parked`: messages of a site that are not folded.

use crate::command::listing::{Aligned, is_coloured};
use crate::command::print;
use crate::config::HubConfig;
use crate::service::hub;
use std::process::ExitCode;

/// List the messages of a site that are not folded, with the reason.
///
/// A running hub takes them up by itself as soon as they fit: when the missing commits come, when it is updated, when the
/// site is put on the list. What was forged or broken on the way never fits: `--discard` drops it, and the mark of the site.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante hub parked todi --config hub.toml
  tirante hub parked todi --discard --config hub.toml  # the hub is stopped")]
pub struct Args {
    /// Name of the site.
    #[arg(value_name = "SITE")]
    pub site: String,

    /// Drop them; the hub must be stopped.
    #[arg(long)]
    pub discard: bool,
}

/// Runs the command.
///
/// # Errors
/// The database cannot be read, a hub runs, or stdout cannot be written.
pub fn run(args: &Args, config: &HubConfig) -> anyhow::Result<ExitCode> {
    if args.discard {
        let dropped = hub::open(&config.storage)?.discard(&args.site)?;
        return print(format!("{dropped} messages dropped\n").as_bytes());
    }
    let parked = hub::beside(&config.storage)?.parked(&args.site)?;
    if parked.is_empty() {
        tell!("no message of {} is parked", args.site);
        return Ok(ExitCode::SUCCESS);
    }
    let mut table = Aligned::new(&[">message", "fault", ">bytes", "reason"]);
    for message in parked {
        table.push(vec![
            message.sequence.to_string(),
            message.fault,
            message.payload.len().to_string(),
            message.detail,
        ]);
    }
    print(table.print(is_coloured()).as_bytes())
}
