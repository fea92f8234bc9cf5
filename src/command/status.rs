//! `tirante status`: shows the state of every rod, since when, and why.

use super::listing::{Aligned, csv, decimals, is_coloured, minutes};
use super::render::signed_percent;
use super::which_store::{Format, WhichStore, check_rod};
use crate::analysis::findings::Doubt;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::service::api::listing::AlarmAnswer;
use crate::service::api::{Monitoring, RodStatus, Terms};
use crate::site::clock;
use crate::site::store::{self, Reader};
use crate::site::text::escaped;
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;

/// Show the state of every rod: force, change, alarms.
///
/// The state comes with its time, the force with its 95 % interval. A running `replay` or `run` is not
/// disturbed. Stderr reports a stop of monitoring, with time and reason, and the daemon's present conditions.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante status --store site.db
  tirante status --config site.toml --rod north --format json

Force and change (since the rod's baseline) are given at the reference
temperature. A '~' says that they are not: they are those of the latest record
at its own temperature, uncompensated. Before there is a baseline the force is
that of the latest record alone. '!' and '?' say that the force may be wrong, by
the latest record that counts; a baseline does not mend that. The exit code says
whether the store could be read, not whether an alarm stands or the site is
measured: read `alarms`, `is_stale` and `monitoring` of --format json for that.")]
pub struct Args {
    /// Store to read.
    #[command(flatten)]
    pub which: WhichStore,

    /// Only this rod.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,

    /// Output format.
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Runs the command.
///
/// # Errors
/// No store is named, it cannot be read, it does not have the rod, or stdout cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let path = args.which.path()?;
    let told = store::told(&path);
    // A store that was taken away or damaged is why the daemon stopped.
    show(args, &path, told.as_deref()).inspect_err(|_| {
        let monitoring = told.as_deref().map(Monitoring::of_told);
        say(monitoring.as_ref());
    })
}

fn show(args: &Args, path: &Path, told: Option<&str>) -> anyhow::Result<ExitCode> {
    let reader = Reader::open(path)?;
    let rod = check_rod(&reader, args.rod.as_deref())?;
    let now = clock::now();
    let monitoring = Monitoring::of(&reader, store::is_held(reader.path()), told, now)?;
    let text = text(&reader, rod.as_ref(), args.format, monitoring.as_ref())?;
    say(monitoring.as_ref());
    if text.is_empty() {
        tell!("{} has no records yet", reader.path().display());
    }
    super::print(text.as_bytes())
}

fn say(monitoring: Option<&Monitoring>) {
    for sentence in monitoring.iter().flat_map(|monitoring| monitoring.sentences()) {
        tell!("{}", escaped(&sentence));
    }
}

/// Status of a store's rods, or of one; empty if it has none yet.
///
/// # Errors
/// The store cannot be read.
pub fn text(
    reader: &Reader,
    rod: Option<&RodId>,
    format: Format,
    monitoring: Option<&Monitoring>,
) -> anyhow::Result<String> {
    let (rows, now) = (rows(reader, rod)?, clock::now());
    Ok(match format {
        _ if rows.is_empty() => String::new(),
        Format::Json => json(&rows, monitoring, now)?,
        Format::Csv => spreadsheet(&rows, monitoring, now),
        Format::Table => table(&rows, now),
    })
}

fn rows(reader: &Reader, rod: Option<&RodId>) -> anyhow::Result<Vec<RodStatus>> {
    let mut rows = Vec::new();
    let terms = Terms::of(reader)?;
    for standing in reader.standings()? {
        if rod.is_none_or(|rod| *rod == standing.rod) {
            let counts = reader.counts(&standing.rod)?;
            rows.push(RodStatus::of(standing, counts, terms)?);
        }
    }
    Ok(rows)
}

/// A line of JSON: the rod's status, and what says that it may be none.
#[derive(Serialize)]
struct Line<'a> {
    #[serde(flatten)]
    rod: &'a RodStatus,
    /// True if the latest record is older than `stale_after_s`.
    is_stale: bool,
    /// State of the site's monitoring; `null` if no daemon ever worked on the store.
    monitoring: Option<&'a Monitoring>,
}

fn json(rows: &[RodStatus], monitoring: Option<&Monitoring>, now: Timestamp) -> anyhow::Result<String> {
    let mut out = String::new();
    for rod in rows {
        out += &serde_json::to_string(&Line {
            rod,
            is_stale: rod.is_stale(now),
            monitoring,
        })?;
        out.push('\n');
    }
    Ok(out)
}

fn table(rows: &[RodStatus], now: Timestamp) -> String {
    let mut table = Aligned::new(&[
        "rod",
        "state",
        ">force (95 %) [kN]",
        ">change (95 %) [%]",
        "latest (UTC)",
    ]);
    let time =
        |time: Option<Timestamp>| time.map_or_else(|| "-".to_owned(), |time| minutes(&time.to_string()));
    let counted = |count: u64, noun: &str| format!("{count} {noun}{}", if count == 1 { "" } else { "s" });
    for row in rows {
        let change_mark = if row.compensated { "" } else { "~" };
        let dash = || "-".to_owned();
        // Before there is a baseline, the record's own force.
        let own = row.axial_force_n.as_ref().filter(|_| row.force_n.is_none());
        let force = row.force_n.as_ref().or(own);
        let doubts = if force.is_some() { &row.doubts[..] } else { &[] };
        let tilde = if own.is_some() { "" } else { change_mark };
        table.push(vec![
            row.rod.0.clone(),
            row.state.to_owned(),
            force.map_or_else(dash, |n| {
                let [mean, low, high] = [n.mean, n.q025, n.q975].map(|n| n * 1e-3);
                let digits = decimals(mean);
                format!(
                    "{}{tilde}{mean:.digits$} ({low:.digits$} to {high:.digits$})",
                    Doubt::mark(doubts)
                )
            }),
            row.relative_force.as_ref().map_or_else(dash, |r| {
                let [mean, low, high] = [r.mean, r.q025, r.q975].map(signed_percent);
                format!("{change_mark}{mean} ({low} to {high})")
            }),
            row.latest_record.map_or_else(dash, day),
        ]);
        if row.state == "alarm" {
            table.stress();
        }
        if own.is_some() {
            table.note("the force is that of the latest record alone".to_owned());
        }
        for doubt in doubts {
            table.note(doubt.said().to_owned());
        }
        if let Some(why) = row.why() {
            table.note(why);
        }
        let since = row.since.map_or_else(String::new, |since| {
            format!("{} since {}; ", row.state, minutes(&since.to_string()))
        });
        let set_aside = match row.set_aside {
            0 => String::new(),
            some => format!(", {some} set aside"),
        };
        table.note(format!(
            "{since}latest record {}; {}, {:.1} % rejected{set_aside}",
            time(row.latest_record),
            counted(row.records, "record"),
            row.rejected_share() * 100.0
        ));
        for out in row.sensors.iter().flat_map(|sensors| &sensors.left_out) {
            table.note(format!("sensor {} left out of it: {}", out.sensor, out.why));
        }
        if row.records_ahead > 0 {
            table.note(format!(
                "{} dated after that by a wrong clock",
                counted(row.records_ahead, "record")
            ));
        }
        // The alarm says it itself.
        if row.is_stale(now) && row.stale_after_s > Some(0.0) {
            table.note(
                "no new data: the latest record is older than the silence that raises an alarm".to_owned(),
            );
        }
        if row.relative_force.is_some() && !row.compensated {
            table.note(
                "uncompensated: force and change are those at the temperature of the latest record"
                    .to_owned(),
            );
        }
        for AlarmAnswer {
            alarm,
            acknowledged_words,
            ..
        } in &row.alarms
        {
            let known = match (alarm.acknowledged, acknowledged_words) {
                (None, _) => String::new(),
                (Some(_), None) => ", acknowledged".to_owned(),
                (Some(_), Some(words)) => format!(", acknowledged ({words})"),
            };
            let over = if alarm.cleared.is_some() {
                ", its condition ended"
            } else {
                ""
            };
            table.note(format!(
                "{} since {}{known}{over} (alarm {}, as of {}): {}",
                alarm.kind,
                minutes(&alarm.raised.to_string()),
                alarm.id,
                day(alarm.told),
                alarm.message
            ));
            if alarm.acknowledged.is_none() {
                table.stress();
            }
        }
        for request in &row.waiting {
            table.note(format!("asked for, waits for the next record: {request}"));
        }
    }
    table.print(is_coloured())
}

/// A time to the day.
fn day(time: Timestamp) -> String {
    time.to_string().chars().take(10).collect()
}

fn spreadsheet(rows: &[RodStatus], monitoring: Option<&Monitoring>, now: Timestamp) -> String {
    let mut out = csv([
        "rod",
        "state",
        "why",
        "since",
        "segment",
        "compensated",
        "reference_temperature_c",
        "force_n",
        "force_q025_n",
        "force_q975_n",
        "relative_force",
        "relative_force_sd",
        "relative_force_q025",
        "relative_force_q975",
        "latest_used",
        "latest_record",
        "records",
        "rejected",
        "alarms",
        "axial_force_n",
        "axial_force_q025_n",
        "axial_force_q975_n",
        "never_seen_since",
        "records_ahead",
        "is_stale",
        "monitoring_stopped_since",
        "set_aside",
        "acknowledged_words",
    ]);
    let number = |number: Option<f64>| number.map_or_else(String::new, |number| format!("{number:?}"));
    let time = |time: Option<Timestamp>| time.map_or_else(String::new, |time| time.to_string());
    for row in rows {
        let (force, relative) = (row.force_n.as_ref(), row.relative_force.as_ref());
        let own = row.axial_force_n.as_ref();
        let alarms: Vec<String> = row
            .alarms
            .iter()
            .map(|answer| format!("{} {}", answer.alarm.kind, answer.alarm.id))
            .collect();
        let said: Vec<String> = row
            .alarms
            .iter()
            .filter_map(|answer| {
                let words = answer.acknowledged_words.as_ref()?;
                Some(format!("{} {words}", answer.alarm.id))
            })
            .collect();
        let cells = [
            row.rod.0.clone(),
            row.state.to_owned(),
            row.why().unwrap_or_default(),
            time(row.since),
            row.segment.to_string(),
            row.compensated.to_string(),
            number(row.reference_temperature_c),
            number(force.map(|n| n.mean)),
            number(force.map(|n| n.q025)),
            number(force.map(|n| n.q975)),
            number(relative.map(|r| r.mean)),
            number(relative.map(|r| r.sd)),
            number(relative.map(|r| r.q025)),
            number(relative.map(|r| r.q975)),
            time(row.latest_used),
            time(row.latest_record),
            row.records.to_string(),
            row.rejected.to_string(),
            alarms.join("; "),
            number(own.map(|n| n.mean)),
            number(own.map(|n| n.q025)),
            number(own.map(|n| n.q975)),
            time(row.never_seen_since),
            row.records_ahead.to_string(),
            row.is_stale(now).to_string(),
            time(monitoring.and_then(|monitoring| monitoring.stopped_since)),
            row.set_aside.to_string(),
            said.join("; "),
        ];
        out += &csv(cells.iter().map(String::as_str));
    }
    out
}
