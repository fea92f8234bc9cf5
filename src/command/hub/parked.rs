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
  tirante hub parked todi --discard --config hub.toml  # the hub is stopped
  tirante hub parked todi --current 6f0e2a91c4d7b358 \\
      --config hub.toml                # this store is the present one")]
pub struct Args {
    /// Name of the site.
    #[arg(value_name = "SITE")]
    pub site: String,

    /// Drop them; the hub must be stopped.
    #[arg(long)]
    pub discard: bool,

    /// Make the store of this id the site's present one, whatever began after it; the hub must be stopped.
    ///
    /// For a name that two machines had: the right one's messages are taken up at the next start of the hub. What the other has
    /// sent stays as a history of its own.
    #[arg(long, value_name = "STORE", conflicts_with = "discard")]
    pub current: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// The database cannot be read, a hub runs, or stdout cannot be written.
pub fn run(args: &Args, config: &HubConfig) -> anyhow::Result<ExitCode> {
    if args.discard {
        // A running hub remembers nothing that a worker parked.
        let mut centre = if config.is_thin(&args.site) {
            hub::beside(&config.storage)?
        } else {
            hub::open(&config.storage)?
        };
        let dropped = centre.discard(&args.site)?;
        return print(format!("{dropped} messages dropped\n").as_bytes());
    }
    if let Some(epoch) = &args.current {
        hub::open(&config.storage)?.make_present(&args.site, epoch)?;
        return print(format!("store {epoch} is the present one of {}\n", args.site).as_bytes());
    }
    let mut centre = hub::beside(&config.storage)?;
    let mut table = Aligned::new(&[">message", "fault", ">bytes", "reason"]);
    let mut after = (i64::MIN, i64::MIN);
    loop {
        let page = centre.parked(&args.site, None, after)?;
        let Some(last) = page.last() else { break };
        after = (last.sequence, last.time_ns);
        for message in page {
            table.push(vec![
                message.sequence.to_string(),
                message.fault,
                message.payload.len().to_string(),
                message.detail,
            ]);
        }
    }
    if after == (i64::MIN, i64::MIN) {
        tell!("no message of {} is parked", args.site);
        return Ok(ExitCode::SUCCESS);
    }
    print(table.print(is_coloured()).as_bytes())
}
