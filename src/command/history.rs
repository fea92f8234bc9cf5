//! `tirante history`: lists records, periods, alarms and rejections of a store.

use super::BadArguments;
use super::import::MessageEncoding;
use super::listing::{Aligned, cell, csv, decimals, is_coloured, minutes, object};
use super::render::percent;
use super::which_store::{Format, WhichStore, check_rod};
use crate::analysis::findings::Doubt;
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::Timestamp;
use crate::recording::write::Encoding;
use crate::service::api::{self, listing::AlarmAnswer};
use crate::service::viewer::{Message, ResultsWriter};
use crate::site::store::{Filter, Listing, Reader};
use rusqlite::types::Value;
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

/// List records, periods, alarms or rejected records of a store.
///
/// A running `replay` or `run` is not disturbed.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante history --store site.db
  tirante history --store site.db --rod north --from 2026-03-01 --to 2026-04-01
  tirante history --config site.toml --what alarms
  tirante history --store site.db --format csv > forces.csv
  tirante history --store site.db --format parquet > forces.parquet
  tirante history --store site.db --format mcap > results.mcap
  tirante history --store site.db --format mcap --encoding cdr > ros2.mcap

A '~' before a change or force says that it is not compensated for temperature,
'!' or '?' before a force that it may be wrong: conflict, prior_tail,
label_probability and the ends axial_force_q025_n and axial_force_q975_n of
--format csv say by what.")]
pub struct Args {
    /// Store to read.
    #[command(flatten)]
    pub which: WhichStore,

    /// Only this rod.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,

    /// Begin of the listing: a day (2026-03-01, from midnight UTC) or a time (2026-03-01T06:00:00Z).
    #[arg(long, value_name = "TIME", value_parser = Timestamp::as_written)]
    pub from: Option<Timestamp>,

    /// End of the listing, exclusive.
    #[arg(long, value_name = "TIME", value_parser = Timestamp::as_written)]
    pub to: Option<Timestamp>,

    /// Table to list.
    #[arg(long, value_enum, default_value_t)]
    pub what: What,

    /// Output format.
    #[arg(long, value_enum, default_value_t)]
    pub format: AnyFormat,

    /// Encoding of the messages of --format mcap.
    #[arg(long, value_enum, default_value_t = MessageEncoding::Json)]
    pub encoding: MessageEncoding,
}

/// Output format of a listing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum AnyFormat {
    /// Aligned columns.
    #[default]
    #[value(alias = "text")]
    Table,
    /// One JSON object per line.
    Json,
    /// Comma-separated values (RFC 4180) with the unit in each column's name.
    Csv,
    /// Parquet: the columns of the CSV, typed.
    Parquet,
    /// MCAP: records and alarms as messages, to open next to the recordings in Foxglove or Lichtblick.
    Mcap,
}

/// Table of a store to list.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum What {
    /// Every record, including rejected ones.
    #[default]
    Records,
    /// Closed decorrelation periods (a day by default), with the evidence of a change.
    Periods,
    /// Alarms, active or over.
    Alarms,
    /// Rejected records.
    Rejections,
}

impl What {
    /// Listing of the store.
    pub fn listing(self) -> Listing {
        match self {
            Self::Records => Listing::Records,
            Self::Periods => Listing::Periods,
            Self::Alarms => Listing::Alarms,
            Self::Rejections => Listing::Rejections,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// No store is named, it cannot be read, it does not have the rod, or stdout cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if let (Some(from), Some(to)) = (args.from, args.to)
        && from >= to
    {
        return Err(BadArguments("--from must be before --to".to_owned()).into());
    }
    let reader = Reader::open(&args.which.path()?)?;
    let filter = Filter {
        rod: check_rod(&reader, args.rod.as_deref())?,
        from: args.from,
        to: args.to,
    };
    if args.encoding != MessageEncoding::Json && args.format != AnyFormat::Mcap {
        return Err(BadArguments("--encoding is that of --format mcap".to_owned()).into());
    }
    let has_lines = match args.format {
        AnyFormat::Json => matches!(args.what, What::Records | What::Rejections),
        AnyFormat::Mcap => true,
        _ => false,
    };
    if has_lines {
        let older = reader.without_line(&filter)?;
        let count = match args.what {
            What::Rejections => older.refused,
            _ => older.records,
        };
        if count > 0 {
            tell!("{count} older records have no JSON line any more (keep_lines_d): --format csv has them");
        }
    }
    let mut out = io::BufWriter::new(io::stdout());
    let format = match args.format {
        AnyFormat::Table => Format::Table,
        AnyFormat::Json => Format::Json,
        AnyFormat::Csv => Format::Csv,
        AnyFormat::Mcap => {
            if args.what != What::Records {
                let why = "--format mcap has records and alarms in one file; leave --what out";
                return Err(BadArguments(why.to_owned()).into());
            }
            write_mcap(&reader, &filter, args.encoding.encoding(), &mut out)?;
            out.flush()?;
            return Ok(ExitCode::SUCCESS);
        }
        AnyFormat::Parquet => {
            write_parquet(&reader, &filter, args.what, &mut out)?;
            out.flush()?;
            return Ok(ExitCode::SUCCESS);
        }
    };
    write(&reader, &filter, args.what, format, &mut out)?;
    out.flush()?;
    Ok(ExitCode::SUCCESS)
}

/// Writes records and alarms as messages.
fn write_mcap(
    reader: &Reader,
    filter: &Filter,
    encoding: Encoding,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    if io::stdout().is_terminal() {
        let why = "MCAP is not for a terminal: send it to a file, > results.mcap";
        return Err(BadArguments(why.to_owned()).into());
    }
    let mut results = ResultsWriter::new(out, encoding)?;
    reader.rows(filter, |row| {
        let messages = Message::of_record(&row);
        messages.iter().try_for_each(|message| results.write(message))?;
        anyhow::Ok(())
    })?;
    for rod in reader.rods()? {
        if filter.rod.as_ref().is_some_and(|only| *only != rod) {
            continue;
        }
        let kept = reader.snapshots(&rod)?;
        let is_within = |picture: &Snapshot| {
            filter.from.is_none_or(|from| picture.start >= from)
                && filter.to.is_none_or(|to| picture.start < to)
        };
        let latest = kept.latest.filter(|latest| kept.first.as_ref() != Some(latest));
        let pictures = kept.first.into_iter().chain(latest).chain(kept.refused);
        for picture in pictures.filter(is_within) {
            let unit = api::rod::unit(reader, &rod, picture.start)?;
            for message in Message::of_picture(&rod, &picture, unit) {
                results.write(&message)?;
            }
        }
    }
    for alarm in reader.alarms(filter)? {
        let AlarmAnswer {
            alarm,
            acknowledged_words,
            ..
        } = AlarmAnswer::of(reader, alarm)?;
        results.write(&Message::of_alarm(&alarm, acknowledged_words.as_deref()))?;
    }
    results.finish()?;
    Ok(())
}

fn write_parquet(
    reader: &Reader,
    filter: &Filter,
    what: What,
    out: &mut (impl Write + Send),
) -> anyhow::Result<()> {
    if io::stdout().is_terminal() {
        return Err(BadArguments(
            "Parquet is not for a terminal: send it to a file, > forces.parquet".to_owned(),
        )
        .into());
    }
    super::parquet::write(reader, filter, what, out)
}

/// Writes a listing of a store.
///
/// # Errors
/// The store cannot be read, or `out` cannot be written.
pub fn write(
    reader: &Reader,
    filter: &Filter,
    what: What,
    format: Format,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    let listing = what.listing();
    match (format, what) {
        (Format::Json, What::Records | What::Rejections) => {
            reader.lines(listing, filter, |line| Ok(writeln!(out, "{line}")?))
        }
        (Format::Json, What::Alarms) => {
            for alarm in reader.alarms(filter)? {
                let answer = serde_json::to_value(AlarmAnswer::of(reader, alarm)?)?;
                writeln!(out, "{answer}")?;
            }
            Ok(())
        }
        (Format::Json, What::Periods) => reader.list(listing, filter, |names, values| {
            Ok(writeln!(out, "{}", object(names, values))?)
        }),
        (Format::Csv, _) => {
            let names = reader.columns(listing)?;
            out.write_all(csv(names.iter().map(String::as_str)).as_bytes())?;
            reader.list(listing, filter, |_, values| {
                let cells: Vec<String> = values.iter().map(cell).collect();
                Ok(out.write_all(csv(cells.iter().map(String::as_str)).as_bytes())?)
            })
        }
        (Format::Table, _) => {
            let mut table = Aligned::new(heads(what));
            let mut found = false;
            reader.list(listing, filter, |names, values| -> anyhow::Result<()> {
                found = true;
                let row = Row { names, values };
                table.push(cells(what, &row));
                if what == What::Alarms && row.number("stands") == Some(1.0) {
                    table.stress();
                }
                Ok(())
            })?;
            if found {
                out.write_all(table.print(is_coloured()).as_bytes())?;
            } else {
                tell!("nothing of that is in {}", reader.path().display());
            }
            Ok(())
        }
    }
}

fn heads(what: What) -> &'static [&'static str] {
    match what {
        What::Records => &[
            "rod",
            "start (UTC)",
            ">change [%]",
            ">force [kN]",
            ">alone [kN]",
            ">degC",
            "state",
        ],
        What::Periods => &[
            "rod",
            "day (UTC)",
            ">change [%]",
            ">at reference",
            ">evidence",
            ">by peers",
            ">alone",
        ],
        What::Alarms => &["id", "rod", "kind", "raised (UTC)", "stands", "message"],
        What::Rejections => &["rod", "start (UTC)", ">length [s]", "reason", "message"],
    }
}

fn cells(what: What, row: &Row<'_>) -> Vec<String> {
    match what {
        What::Records => {
            let ratio = |mean, sd| Some((row.number(mean)?, row.number(sd).unwrap_or(f64::NAN)));
            let at_reference = ratio("relative_force_at_reference", "relative_force_at_reference_sd");
            let change = match (at_reference, ratio("relative_force", "relative_force_sd")) {
                (Some((mean, sd)), _) => percent(mean, sd),
                (None, Some((mean, sd))) => format!("~{}", percent(mean, sd)),
                (None, None) => "-".to_owned(),
            };
            let mark = Doubt::mark(&row.doubts());
            let force = match (row.number("force_at_reference_n"), row.number("tracked_force_n")) {
                (Some(mean), _) => format!("{mark}{}", row.force_with_sd(mean, "force_at_reference_sd_n")),
                (None, Some(mean)) => format!("{mark}~{}", row.force_with_sd(mean, "tracked_force_sd_n")),
                (None, None) => "-".to_owned(),
            };
            let absolute = row.number("axial_force_n").map_or_else(
                || "-".to_owned(),
                |mean| format!("{mark}{}", row.force_with_sd(mean, "axial_force_sd_n")),
            );
            let state = match (row.text("rejection"), row.text("set_aside")) {
                (Some(code), _) => {
                    format!(
                        "rejected ({code}): {}",
                        row.text("rejection_message").unwrap_or_default()
                    )
                }
                (None, Some(aside)) => format!("set aside ({aside})"),
                (None, None) => row.shown("state"),
            };
            vec![
                row.shown("rod"),
                row.time("start"),
                change,
                force,
                absolute,
                row.fixed("temperature_c", 1.0, 1),
                state,
            ]
        }
        What::Periods => {
            let evidence = |column: &str| match row.number(column) {
                Some(value) => format!("{value:.1e}"),
                None => "-".to_owned(),
            };
            let percent = |mean: &str, sd: &str| {
                row.number(mean)
                    .map_or_else(|| "-".to_owned(), |mean| row.percent_with_sd(mean, sd))
            };
            vec![
                row.shown("rod"),
                row.time("start").chars().take(10).collect(),
                percent("delta", "delta_sd"),
                percent("at_reference", "at_reference_sd"),
                evidence("evidence"),
                evidence("evidence_peers"),
                evidence("evidence_blind"),
            ]
        }
        What::Alarms => vec![
            row.shown("id"),
            row.shown("rod"),
            row.shown("kind"),
            row.time("raised"),
            if row.number("stands") == Some(1.0) {
                "yes"
            } else {
                "no"
            }
            .to_owned(),
            [("acknowledged", "acknowledged"), ("cleared", "condition ended")]
                .iter()
                .filter(|(column, _)| row.text(column).is_some())
                .map(
                    |(column, words)| match (*column, row.text("acknowledged_words")) {
                        ("acknowledged", Some(said)) => format!("{words} {} ({said}); ", row.time(column)),
                        _ => format!("{words} {}; ", row.time(column)),
                    },
                )
                .chain([row.shown("message")])
                .collect(),
        ],
        What::Rejections => vec![
            row.shown("rod"),
            row.time("start"),
            row.fixed("duration_s", 1.0, 1),
            row.shown("rejection"),
            row.shown("rejection_message"),
        ],
    }
}

/// A row with columns by name.
struct Row<'a> {
    names: &'a [String],
    values: &'a [Value],
}

impl Row<'_> {
    fn value(&self, name: &str) -> &Value {
        let place = self.names.iter().position(|known| known == name);
        place
            .and_then(|place| self.values.get(place))
            .unwrap_or(&Value::Null)
    }

    fn text(&self, name: &str) -> Option<&str> {
        match self.value(name) {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    fn number(&self, name: &str) -> Option<f64> {
        match self.value(name) {
            Value::Real(number) => Some(*number),
            Value::Integer(number) => Some(*number as f64),
            _ => None,
        }
    }

    /// Reasons to doubt the record's force.
    fn doubts(&self) -> Vec<Doubt> {
        let [conflict, prior_tail, label_probability] =
            ["conflict", "prior_tail", "label_probability"].map(|name| self.number(name));
        let ends = ["axial_force_q025_n", "axial_force_q975_n"].map(|name| self.number(name));
        let interval = ends[0].zip(ends[1]).map(|(low, high)| [low, high]);
        Doubt::all(conflict, prior_tail, label_probability, interval)
    }

    fn shown(&self, name: &str) -> String {
        match self.value(name) {
            Value::Null => "-".to_owned(),
            value => cell(value),
        }
    }

    fn time(&self, name: &str) -> String {
        self.text(name).map_or_else(|| "-".to_owned(), minutes)
    }

    fn fixed(&self, name: &str, factor: f64, digits: usize) -> String {
        self.number(name).map_or_else(
            || "-".to_owned(),
            |number| format!("{:.digits$}", number * factor),
        )
    }

    fn percent_with_sd(&self, mean: f64, sd: &str) -> String {
        let sd = 100.0 * self.number(sd).unwrap_or(f64::NAN);
        format!("{:.2} ± {sd:.2}", 100.0 * mean)
    }

    /// Force in kN with its standard deviation.
    fn force_with_sd(&self, mean_n: f64, sd_n: &str) -> String {
        let sd = 1e-3 * self.number(sd_n).unwrap_or(f64::NAN);
        let mean = 1e-3 * mean_n;
        let digits = decimals(mean);
        format!("{mean:.digits$} ± {sd:.digits$}")
    }
}
