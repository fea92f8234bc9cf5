//! `tirante files`: lists the files that a daemon read, with the outcome of each.

use super::listing::{Aligned, csv, is_coloured, minutes};
use super::which_store::{Format, WhichStore};
use crate::analysis::signal::record::Timestamp;
use crate::site::store::{FileMark, FileState, Reader};
use serde_json::json;
use std::process::ExitCode;

/// Show what became of every file that the daemon read, or a task of a fleet.
///
/// Files of the watched folder and parts of the journal that were read to their end, or set aside. A file that is not
/// listed waits to be read, or cannot be opened. In the result of `fleet task`: every file of the task, without a time.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante files --store site.db --losses
  tirante files --config site.toml day.mcap --format json

Outcomes: done; incomplete (what could be read is in the store, the reason says
what is lost); quarantined (it crashed the program again and again). What each
record gave: tirante history --what rejections.")]
pub struct Args {
    /// Only files whose name holds this.
    #[arg(value_name = "NAME")]
    pub name: Option<String>,

    /// Only files of which something is lost.
    #[arg(long)]
    pub losses: bool,

    /// Store to read.
    #[command(flatten)]
    pub which: WhichStore,

    /// Output format.
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Runs the command.
///
/// # Errors
/// No store is named, it cannot be read, or stdout cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let reader = Reader::open(&args.which.path()?)?;
    let files = reader.files()?;
    let wanted = files.values().filter(|file| {
        let is_named = args.name.as_ref().is_none_or(|name| file.name.contains(name));
        is_named && !(args.losses && file.state == FileState::Done)
    });
    let rows: Vec<(&FileMark, Outcome<'_>)> = wanted.map(|file| (file, outcome(file))).collect();
    let mut text = String::new();
    match args.format {
        Format::Json => {
            for (file, (outcome, reason)) in &rows {
                let line = json!({
                    "file": file.name,
                    "bytes": file.size,
                    "modified": changed(file),
                    "outcome": outcome,
                    "reason": reason,
                });
                text += &format!("{line}\n");
            }
        }
        Format::Csv => {
            text += &csv(["file", "bytes", "modified", "outcome", "reason"]);
            for (file, (outcome, reason)) in &rows {
                let bytes = file.size.to_string();
                text += &csv([
                    &*file.name,
                    &bytes,
                    &changed(file).unwrap_or_default(),
                    outcome,
                    reason.unwrap_or_default(),
                ]);
            }
        }
        Format::Table if rows.is_empty() => {}
        Format::Table => {
            let mut table = Aligned::new(&["file", ">bytes", "changed (UTC)", "outcome"]);
            for (file, (outcome, reason)) in &rows {
                table.push(vec![
                    file.name.clone(),
                    file.size.to_string(),
                    changed(file).map_or_else(String::new, |time| minutes(&time)),
                    (*outcome).to_owned(),
                ]);
                if let Some(reason) = reason {
                    table.note(format!("  {reason}"));
                }
            }
            text = table.print(is_coloured());
        }
    }
    if rows.is_empty() {
        tell!("{}: no such file was read", reader.path().display());
    }
    super::print(text.as_bytes())
}

/// Word for the outcome of a file, and the reason for what is lost.
type Outcome<'a> = (&'static str, Option<&'a str>);

fn outcome(file: &FileMark) -> Outcome<'_> {
    match &file.state {
        FileState::Done => ("done", None),
        FileState::Incomplete(reason) => ("incomplete", Some(reason)),
        FileState::Quarantined(reason) => ("quarantined", Some(reason)),
    }
}

/// Time of a file's last change; `None` where it was not kept.
fn changed(file: &FileMark) -> Option<String> {
    (file.modified_ns != 0).then(|| Timestamp::from_nanos(file.modified_ns).to_string())
}
