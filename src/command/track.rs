//! `tirante track`: tracks rods from tables of natural frequencies identified elsewhere.

use super::progress::Progress;
use super::render::Table;
use super::setup::{self, GivenUp, Prepared, Setup};
use super::status;
use super::which_store::{Format, Output};
use super::{BadArguments, WITH_LOSSES};
use crate::analysis::outcome::{Outcome, TableRow};
use crate::analysis::signal::record::{Reading, RodId};
use crate::analysis::track::{Alarm, AlarmEvent};
use crate::config::Config;
use crate::recording::import::DateOrder;
use crate::recording::import::frequencies::{self, FrequencyRow};
use crate::site::store::StoreError;
use crate::site::trackers::{Site, Taken};
use anyhow::{Context, anyhow};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Follow rods from tables of natural frequencies.
///
/// The frequencies were identified elsewhere: a researcher's series, or years without stored samples. Prints
/// per row what `replay` prints per record, and at the end every alarm and the state of every rod.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante track frequencies.csv --config site.toml
  tirante track 2024.csv 2025.csv weather.csv --config site.toml \\
      --format json > change.jsonl
  tirante track frequencies.csv --config site.toml --store site.db

A table (CSV, or with semicolons or tabs) names its columns in the first line, in any order:

  time,rod,f1_hz,sd1_hz,f2_hz,sd2_hz,temperature_c
  2026-03-01T06:00:00Z,nave-3,4.4921,0.0021,9.2884,0.0046,8.5
  2026-03-01T07:00:00Z,,,,,,8.9
  2026-03-01T12:00:00Z,nave-3,4.4870,0.0024,,,

`time` is ISO 8601 (UTC where no zone is said) or seconds since 1970; `sd1_hz`
is the standard error of `f1_hz`. An empty cell (or nan, null, NA, -) is a value
that is missing: above, mode 2 of the last record. A row without frequencies is
a temperature, of every rod if it names none. `rms` (of the samples, one unit throughout) and
`duration_s` may be there. Rows of all tables are taken in the order of their
times. The configuration is that of `replay`, from `tirante init`; where its
samples come from does not matter here.

Each record has no force of its own, which `tirante identify --frequencies`
gives: the force shown is that of the baseline times the change. Alarms are
results, not failures: exit code 0, or 3 if rows were refused because no rod of
the prior has such frequencies.")]
pub struct Args {
    /// Tables of frequencies and temperatures.
    #[arg(value_name = "TABLE", required = true)]
    pub paths: Vec<PathBuf>,

    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,

    /// Keep results in this database (SQLite) and resume from it; overrides `[store] path` of the
    /// configuration. Without either, nothing is kept afterwards.
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,

    /// The decimal sign is a comma.
    #[arg(long)]
    pub decimal_comma: bool,

    /// Order of day and month in dates such as 03/04/2026.
    #[arg(long, value_enum)]
    pub dates: Option<DateOrder>,

    /// Configuration of the run.
    #[command(flatten)]
    pub setup: Setup,

    /// Baselines that may be dropped.
    #[command(flatten)]
    pub given_up: GivenUp,
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, a table that cannot be read or names a rod that is not configured, a store
/// or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = args.setup.load()?;
    let mut rows = Vec::new();
    for path in &args.paths {
        rows.extend(read(path, args, &config)?);
    }
    // Ties in a fixed order: the same rows are followed alike however they are split into tables.
    rows.sort_by(|a, b| {
        (a.time, &a.rod)
            .cmp(&(b.time, &b.rod))
            .then_with(|| first_hz(a).total_cmp(&first_hz(b)))
    });
    let Prepared { generation, mut site } =
        setup::site(config, args.store.as_deref(), &args.given_up, false)?;
    let config = &generation.config;
    let modes = config
        .rods
        .iter()
        .map(|rod| rod.analysis.modes.count)
        .max()
        .unwrap_or(0);
    let store = args.store.as_deref().or(config.store.path.as_deref());
    let is_coloured = super::listing::is_coloured();
    let table = Table::new(
        config.rods.iter().map(|rod| &rod.analysis.rod),
        modes,
        store.map(|path| path.display().to_string()),
        is_coloured,
    );
    let mut output = io::stdout().lock();
    if !args.output.is_json() {
        writeln!(output, "{}\n{}", config.site, table.header())?;
    }
    let bar = Progress::new(
        0,
        "{bar:40} {percent:>3} %  {human_pos} of {human_len} rows, {eta} left",
    );
    let all = rows.len() as u64;
    let mut tally = Tally::default();
    let mut waiting = Waiting::of(config);
    for (done, row) in rows.into_iter().enumerate() {
        bar.set(done as u64, all);
        waiting.keep(&row);
        let Some(rod) = row.rod.clone().filter(|_| !row.modes.is_empty()) else {
            continue;
        };
        let Some(plan) = generation.plans.get(&rod) else {
            continue;
        };
        let row = TableRow {
            start: row.time,
            duration_s: row.duration_s,
            modes: row.modes,
            temperature_c: row.temperature_c,
            readings: waiting.take(&rod),
            rms: row.rms,
        };
        let outcome = Outcome::of_row(plan, row);
        waiting.passed(&rod, outcome.identity());
        let Some(Taken { row, verdict, .. }) = fold(&mut site, &outcome)? else {
            tally.known += 1;
            continue;
        };
        tally.count(&outcome, verdict.set_aside.is_some(), &verdict.events);
        let text = if args.output.is_json() {
            row.to_json()?
        } else {
            table.row(&outcome, &verdict)
        };
        bar.suspend(|| writeln!(output, "{text}"))?;
    }
    for (rod, readings, after) in waiting.rest() {
        site.take_readings(&rod, &readings, after)?;
    }
    output.flush()?;
    drop(bar);
    tally.tell();
    tell!(
        "{}",
        status::text(site.store(), None, Format::Table, None)?.trim_end()
    );
    Ok(if tally.rejected > 0 {
        ExitCode::from(WITH_LOSSES)
    } else {
        ExitCode::SUCCESS
    })
}

/// Takes one record into the site's fold and its store; `None` if the store has it already.
fn fold(site: &mut Site, outcome: &Outcome) -> Result<Option<Taken>, StoreError> {
    site.take(outcome, None)
}

/// Reads the rows of a table; every rod must be configured, and every record's rod known.
fn read(path: &Path, args: &Args, config: &Config) -> anyhow::Result<Vec<FrequencyRow>> {
    let named = || path.display();
    let file = File::open(path).with_context(|| named().to_string())?;
    let table = frequencies::read(BufReader::new(file), args.decimal_comma, args.dates)
        .map_err(|error| anyhow!("{}: {error}", named()))?;
    if !table.unused.is_empty() {
        tell!("{}: left out: column {}", named(), table.unused.join(", "));
    }
    let known = || {
        let names: Vec<&str> = config
            .rods
            .iter()
            .map(|rod| rod.analysis.rod.0.as_str())
            .collect();
        names.join(", ")
    };
    let mut rows = table.rows;
    for row in &mut rows {
        let line = row.line;
        if row.rod.is_none() && !row.modes.is_empty() {
            let [only] = &config.rods[..] else {
                let why = format!(
                    "{}: line {line}: column rod is needed: the configuration has {}",
                    named(),
                    known()
                );
                return Err(BadArguments(why).into());
            };
            row.rod = Some(only.analysis.rod.clone());
        }
        let Some(rod) = &row.rod else { continue };
        let Some(configured) = config.rod(&rod.0) else {
            let why = format!(
                "{}: line {line}: no rod {rod} is configured: there is {}",
                named(),
                known()
            );
            return Err(BadArguments(why).into());
        };
        let (highest, count) = (
            row.modes.last().map_or(0, |mode| mode.order),
            configured.analysis.modes.count,
        );
        if highest > count {
            let why = format!(
                "{}: line {line}: f{highest}_hz, but {rod} is followed by {count} modes: set [modes] count = {highest}, or leave \
                 the column out",
                named()
            );
            return Err(BadArguments(why).into());
        }
    }
    Ok(rows)
}

fn first_hz(row: &FrequencyRow) -> f64 {
    row.modes.first().map_or(0.0, |mode| mode.frequency_hz)
}

/// Temperatures that wait for the next record of each rod, and each rod's last record.
struct Waiting(BTreeMap<RodId, (Vec<Reading>, Option<[u8; 32]>)>);

impl Waiting {
    fn of(config: &Config) -> Self {
        let rods = config.rods.iter().map(|rod| rod.analysis.rod.clone());
        Self(rods.map(|rod| (rod, (Vec::new(), None))).collect())
    }

    /// Keeps a row's temperature for its rod, or for every rod.
    fn keep(&mut self, row: &FrequencyRow) {
        let Some(celsius) = row.temperature_c else { return };
        for (rod, (readings, _)) in &mut self.0 {
            if row.rod.as_ref().is_none_or(|only| only == rod) {
                readings.push(Reading {
                    time: row.time,
                    celsius,
                });
            }
        }
    }

    fn take(&mut self, rod: &RodId) -> Vec<Reading> {
        self.0
            .get_mut(rod)
            .map(|(readings, _)| std::mem::take(readings))
            .unwrap_or_default()
    }

    fn passed(&mut self, rod: &RodId, identity: Option<[u8; 32]>) {
        if let Some((_, last)) = self.0.get_mut(rod) {
            *last = identity;
        }
    }

    /// Readings that belong to no record: rod, readings, the record before them.
    fn rest(self) -> impl Iterator<Item = (RodId, Vec<Reading>, Option<[u8; 32]>)> {
        let rods = self.0.into_iter();
        rods.map(|(rod, (readings, after))| (rod, readings, after))
            .filter(|(_, readings, _)| !readings.is_empty())
    }
}

/// Counts of a run, and every alarm raised.
#[derive(Default)]
struct Tally {
    followed: usize,
    set_aside: usize,
    rejected: usize,
    known: usize,
    alarms: Vec<Alarm>,
}

impl Tally {
    fn count(&mut self, outcome: &Outcome, is_set_aside: bool, events: &[AlarmEvent]) {
        match outcome {
            Outcome::Rejected(_) => self.rejected += 1,
            _ if is_set_aside => self.set_aside += 1,
            _ => self.followed += 1,
        }
        for event in events {
            match self.alarms.iter_mut().find(|alarm| alarm.id == event.alarm.id) {
                Some(alarm) => alarm.clone_from(&event.alarm),
                None => self.alarms.push(event.alarm.clone()),
            }
        }
    }

    /// Reports counts and alarms on stderr.
    fn tell(&self) {
        let Self {
            followed,
            set_aside,
            rejected,
            known,
            ..
        } = self;
        let records = followed + set_aside + rejected + known;
        let mut line = format!("{records} records: {followed} followed");
        for (count, what) in [
            (set_aside, "set aside"),
            (rejected, "refused (no rod of the prior has such frequencies)"),
            (known, "left out (twice, or in the store)"),
        ] {
            if *count > 0 {
                line += &format!(", {count} {what}");
            }
        }
        tell!("{line}; {} alarms", self.alarms.len());
        for alarm in &self.alarms {
            let until = alarm
                .cleared
                .map_or_else(|| "now".to_owned(), |time| time.to_string());
            tell!(
                "  {} of {} from {} to {until}: {}",
                alarm.kind,
                alarm.rod,
                alarm.raised,
                alarm.message
            );
        }
    }
}
