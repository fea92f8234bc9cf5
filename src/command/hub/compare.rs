//! `tirante hub compare`: a site's rows at the centre against a store, row by row.

use super::super::{BadArguments, WITH_LOSSES, print};
use crate::config::HubConfig;
use crate::service::hub;
use crate::site::store::Reader;
use rusqlite::types::Value;
use std::collections::HashSet;
use std::path::PathBuf;
use std::process::ExitCode;

/// Compare a site's rows at the centre with a store, row by row.
///
/// The store is a copy of the site's own, or that of a `replay` of its recordings. Compared are records, lines, modes,
/// periods, segments, alarms with their events, configurations and the rods' status, with every column.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante replay --config todi.toml --store replayed.db recordings/
  tirante hub compare todi --store replayed.db --config hub.toml

Exit codes: 0 all rows are equal; 3 they are not, the first difference of each
table is on stdout.")]
pub struct Args {
    /// Name of the site.
    #[arg(value_name = "SITE")]
    pub site: String,

    /// Store to compare with.
    #[arg(long, value_name = "FILE")]
    pub store: PathBuf,

    /// Number of the site's store at the centre, from 1. Default: the present one.
    #[arg(long, value_name = "NUMBER")]
    pub segment: Option<i64>,
}

/// Tables that are the same for a daemon's store and that of a replay.
const COMPARED: [&str; 9] = [
    "config", "rod", "segment", "record", "line", "mode", "period", "alarm", "outbox",
];

/// Runs the command.
///
/// # Errors
/// The centre has no such site, one of the two cannot be read, or stdout cannot be written.
pub fn run(args: &Args, config: &HubConfig) -> anyhow::Result<ExitCode> {
    let reader = Reader::open(&args.store)?;
    let mut centre = hub::beside(&config.storage)?;
    let sites = centre.sites()?;
    let state = sites.get(&args.site).cloned().unwrap_or_default();
    let number = args.segment.or(state.history().map(|present| present.store));
    let history = state
        .histories
        .iter()
        .find(|history| Some(history.store) == number);
    let Some(history) = history else {
        let what = format!("the centre has no such store of site \"{}\"", args.site);
        return Err(BadArguments(what).into());
    };
    let (mut out, mut is_equal) = (String::new(), true);
    for copied in centre.copied().to_vec() {
        let table = copied.shape.table;
        if !COMPARED.contains(&table) {
            continue;
        }
        let mut theirs = centre.rows_of(&copied, &args.site, history.store)?;
        let own = reader.copied_rows(&copied.shape)?;
        let removed = if table == "line" {
            without_removed(&mut theirs, &own)
        } else {
            0
        };
        let first = theirs.iter().zip(&own).position(|(one, other)| one != other);
        let first = first.or((theirs.len() != own.len()).then_some(theirs.len().min(own.len())));
        out += &match first {
            None if removed > 0 => format!(
                "{table}: {} rows, all equal; {removed} more at the centre, of records whose line the store no longer has\n",
                own.len()
            ),
            None => format!("{table}: {} rows, all equal\n", own.len()),
            Some(place) => {
                is_equal = false;
                format!(
                    "{table}: {} rows at the centre, {} in the store, row {} differs:\n  centre {:?}\n  store  {:?}\n",
                    theirs.len(),
                    own.len(),
                    place + 1,
                    theirs.get(place),
                    own.get(place)
                )
            }
        };
    }
    print(out.as_bytes())?;
    Ok(if is_equal {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(WITH_LOSSES)
    })
}

/// Leaves out lines of records that the store has without one (`[store] keep_lines_d` removes old ones); returns their number. A
/// line of a record that it does not have is a difference of the table `record`.
fn without_removed(theirs: &mut Vec<Vec<Value>>, own: &[Vec<Value>]) -> usize {
    // The key is the first column, an integer.
    let key = |row: &[Value]| match row.first() {
        Some(Value::Integer(record)) => Some(*record),
        _ => None,
    };
    let there: HashSet<Option<i64>> = own.iter().map(|row| key(row)).collect();
    let before = theirs.len();
    theirs.retain(|row| there.contains(&key(row)));
    before - theirs.len()
}
