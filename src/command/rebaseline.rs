//! `tirante rebaseline`: begins a new baseline of a rod.

use super::which_store::{WhichStore, ask, check_rod};
use crate::site::clock;
use crate::site::store::{Asked, Reader};
use crate::site::trackers::behind;
use std::process::ExitCode;

/// Start a new baseline for a rod, after work on it.
///
/// Such work is retensioning, a repair, another sensor. The baseline begins with the rod's next record, in a
/// segment of its own; earlier results are kept. Unacknowledged alarms stay.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Example:
  tirante rebaseline --store site.db north --reason \"retensioned by 20 kN\"")]
pub struct Args {
    /// Id of the rod.
    #[arg(value_name = "ROD")]
    pub rod: String,

    /// Reason, for readers of the history.
    #[arg(long, value_name = "TEXT")]
    pub reason: Option<String>,

    /// Store to use.
    #[command(flatten)]
    pub which: WhichStore,
}

/// Runs the command.
///
/// # Errors
/// No store is named, it cannot be read or written, or it has no such rod.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let path = args.which.path()?;
    let reader = Reader::open(&path)?;
    let rod = check_rod(&reader, Some(&args.rod))?;
    if let Some(rod) = &rod {
        let waiting = reader.waiting(rod)?;
        if waiting
            .iter()
            .any(|request| matches!(request.what, Asked::Rebaseline { .. }))
        {
            let text =
                format!("a new baseline of {rod} is asked for already: it begins with the next record\n");
            return super::print(text.as_bytes());
        }
    }
    let standing = match &rod {
        Some(rod) => reader.standing(rod)?,
        None => None,
    };
    if let Some(latest) = behind(standing.and_then(|standing| standing.latest_start), clock::now()) {
        tell!(
            "warning: the latest record of {} is of {latest}: if records from before the work are still to come, the new baseline \
             begins with one of them; ask again when they are in",
            args.rod
        );
    }
    drop(reader);
    let what = Asked::rebaseline(args.reason.as_deref());
    let requests: Vec<_> = rod.into_iter().map(|rod| (rod, what.clone())).collect();
    ask(&path, &requests, clock::now())?;
    super::print(format!("a new baseline of {} begins with its next record\n", args.rod).as_bytes())
}
