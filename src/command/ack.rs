//! `tirante ack`: acknowledges alarms.

use super::BadArguments;
use super::listing::hanging;
use super::which_store::{WhichStore, ask, check_rod};
use crate::analysis::signal::record::RodId;
use crate::analysis::track::Alarm;
use crate::site::clock;
use crate::site::store::{Asked, Filter, Reader};
use std::process::ExitCode;

/// Acknowledge alarms.
///
/// Acknowledged alarms are not repeated, and end when their condition ends. This takes effect at once if
/// nothing writes to the store, within seconds beside a running `run`, and before the rod's next record
/// beside a running `replay`.
#[derive(Debug, Clone, clap::Args)]
#[command(
    group = clap::ArgGroup::new("which alarms").required(true).args(["alarms", "rod", "all"]),
    after_help = "Examples:
  tirante ack --store site.db 5f1d0c7a9e3b2468
  tirante ack --config site.toml --rod north --by 'M. Rossi' \\
      --note 'wedge inspected, sound'
  tirante ack --store site.db --all"
)]
pub struct Args {
    /// Ids of the alarms, as shown by `status` and `history --what alarms`.
    #[arg(value_name = "ALARM")]
    pub alarms: Vec<String>,

    /// Acknowledge every active alarm of this rod.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,

    /// Acknowledge every active alarm.
    #[arg(long)]
    pub all: bool,

    /// Name of the person, kept with the alarm and told with it by every list, export and sink.
    #[arg(long, value_name = "NAME")]
    pub by: Option<String>,

    /// Note, kept and told likewise.
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,

    /// Store to use.
    #[command(flatten)]
    pub which: WhichStore,
}

/// Runs the command.
///
/// # Errors
/// No store is named, it cannot be read or written, or it has no such alarm or rod.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let path = args.which.path()?;
    let alarms = {
        let reader = Reader::open(&path)?;
        wanted(args, &reader)?
    };
    if alarms.is_empty() {
        return super::print(b"no alarm waits to be acknowledged\n");
    }
    let requests: Vec<(RodId, Asked)> = alarms
        .iter()
        .map(|alarm| {
            (
                alarm.rod.clone(),
                Asked::acknowledge(&alarm.id, args.by.as_deref(), args.note.as_deref()),
            )
        })
        .collect();
    let when = ask(&path, &requests, clock::now())?;
    let mut out = String::new();
    for alarm in &alarms {
        let words = format!(
            "{when}: {} {} of rod {}: {}",
            alarm.id, alarm.kind, alarm.rod, alarm.message
        );
        out += &(hanging(&words, 0, 4).join("\n") + "\n");
    }
    super::print(out.as_bytes())
}

/// Alarms selected that are not acknowledged.
fn wanted(args: &Args, reader: &Reader) -> anyhow::Result<Vec<Alarm>> {
    let mut wanted = Vec::new();
    for id in &args.alarms {
        let Some(alarm) = reader.alarm(id)? else {
            return Err(BadArguments(format!(
                "{} has no alarm {id}; `tirante status` lists those that stand",
                reader.path().display()
            ))
            .into());
        };
        if let Some(time) = alarm.acknowledged {
            tell!("{id} was acknowledged at {time}");
        } else if alarm.is_over() {
            tell!("{id} is over");
        } else {
            wanted.push(alarm);
        }
    }
    if args.alarms.is_empty() {
        let filter = Filter {
            rod: check_rod(reader, args.rod.as_deref())?,
            ..Filter::default()
        };
        wanted = reader.alarms(&filter)?;
        wanted.retain(|alarm| alarm.acknowledged.is_none() && !alarm.is_over());
    }
    wanted.dedup_by(|a, b| a.id == b.id);
    Ok(wanted)
}
