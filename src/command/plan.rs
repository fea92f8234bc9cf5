//! `tirante plan`: ranks further measurements of a rod.

use super::progress::Progress;
use super::report_page::{Share, shares};
use super::setup::{self, Setup};
use super::which_store::Output;
use super::{BadArguments, print};
use crate::analysis::inference::joint::next::{self, Campaign, Worth};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Width of a bar for the whole standard deviation.
const BAR: f64 = 40.0;

/// Rank what to measure next at a rod.
///
/// Simulates rods of the prior (or of the posterior of `[[rod.test]]`), measures each with and without the
/// further measurement, and compares the posteriors. Changes nothing.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante plan --config site.toml --rod north-3
  tirante plan --config site.toml --minutes load=10,mass=20,caliper=5
  tirante plan --svg plan.svg
  tirante plan --format json")]
pub struct Args {
    /// Rod of the configuration; required if it has several.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,

    /// Standard error of a frequency in Hz.
    #[arg(long, value_name = "HZ", default_value_t = 0.01)]
    pub sd: f64,

    /// Minutes that measurements take, by their names in the table: they are then ranked by the gain per
    /// minute.
    #[arg(long, value_name = "NAME=MINUTES", value_delimiter = ',')]
    pub minutes: Vec<String>,

    /// Simulated rods to average over.
    #[arg(long, value_name = "COUNT", default_value_t = 16, value_parser = clap::value_parser!(u32).range(4..=10_000))]
    pub rods: u32,

    /// Draw the ranking into an SVG file, too.
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,

    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,

    /// Configuration of the run.
    #[command(flatten)]
    pub setup: Setup,
}

/// A row of the table.
#[derive(Serialize)]
struct Row<'a> {
    rod: &'a str,
    #[serde(flatten)]
    worth: Worth,
    minutes: Option<f64>,
    /// Decrease of the logarithm of the standard deviation per minute.
    per_minute: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, tests already done that give no posterior.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = args.setup.load()?;
    let analysis = &setup::choose_rod(&config, args.rod.as_deref())?.analysis;
    if !(args.sd > 0.0 && args.sd.is_finite()) {
        return Err(BadArguments(format!("--sd {}: an error above 0 Hz is wanted", args.sd)).into());
    }
    let candidates = next::usual(&analysis.prior, analysis.modes.count);
    let minutes = minutes(&args.minutes, &candidates)?;
    let done: Vec<_> = analysis.tests.iter().map(|test| test.data.clone()).collect();
    let campaign = Campaign {
        prior: &analysis.prior,
        discrepancy: &analysis.discrepancy,
        done: &done,
        modes: analysis.modes.count,
        sd_hz: args.sd,
        rods: args.rods as usize,
    };
    let bar = Progress::of_solves();
    let worth = next::worth(&campaign, &candidates, analysis.seed, &|| {
        bar.add(1, u64::from(args.rods))
    })?;
    drop(bar);
    for candidate in &candidates {
        if !worth.iter().any(|one| one.key == candidate.key) {
            tell!(
                "{}: left out, its posteriors are too thin for the sampler in most of the simulated rods",
                candidate.key
            );
        }
    }
    let mut rows: Vec<Row<'_>> = worth
        .into_iter()
        .map(|worth| {
            let taken = minutes.iter().find(|(key, _)| *key == worth.key).map(|(_, m)| *m);
            Row {
                rod: &analysis.rod.0,
                minutes: taken,
                per_minute: taken.map(|m| -worth.left.ln() / m),
                worth,
            }
        })
        .collect();
    // With minutes what a minute buys counts; a measurement without minutes comes behind those that have some.
    rows.sort_by(|a, b| {
        let gain = |row: &Row<'_>| row.per_minute.unwrap_or(f64::NEG_INFINITY);
        gain(b)
            .total_cmp(&gain(a))
            .then(a.worth.left.total_cmp(&b.worth.left))
    });
    let of = format!(
        "share of the standard deviation of N left beside {} frequencies to {} Hz{}, {} rods",
        analysis.modes.count,
        args.sd,
        if done.is_empty() {
            ""
        } else {
            " and the tests already done"
        },
        rows.first().map_or(0, |row| row.worth.rods)
    );
    if let Some(path) = &args.svg {
        draw(
            path,
            &format!("{}: what to measure next", analysis.rod),
            &of,
            &rows,
        )?;
    }
    let mut text = String::new();
    if args.output.is_json() {
        for row in &rows {
            text += &serde_json::to_string(row)?;
            text.push('\n');
        }
        return print(text.as_bytes());
    }
    text += &format!("{}\n\n  {of}\n\n", analysis.rod);
    for row in &rows {
        let bar = "#".repeat((BAR * row.worth.left.clamp(0.0, 1.0)).round() as usize);
        let minutes = row.minutes.map_or_else(String::new, |m| format!("   {m:>4} min"));
        text += &format!(
            "  {:<16} {:<58} {:.2} +- {:.2}{minutes}\n  {:<16} {bar}\n",
            row.worth.key, row.worth.measurement, row.worth.left, row.worth.error, ""
        );
    }
    print(text.as_bytes())
}

fn draw(path: &Path, title: &str, of: &str, rows: &[Row<'_>]) -> anyhow::Result<()> {
    let bars: Vec<Share> = rows
        .iter()
        .map(|row| Share {
            name: row.worth.measurement.clone(),
            share: row.worth.left,
            error: row.worth.error,
            note: row.minutes.map_or_else(String::new, |m| format!("{m} min")),
        })
        .collect();
    super::study::write(path, &shares(title, of, &bars))
}

fn minutes<'c>(
    texts: &[String],
    candidates: &'c [next::Candidate],
) -> Result<Vec<(&'c str, f64)>, BadArguments> {
    texts
        .iter()
        .map(|text| {
            let (key, value) = text
                .split_once('=')
                .ok_or_else(|| BadArguments(format!("--minutes {text}: NAME=MINUTES is wanted")))?;
            let known = candidates.iter().map(|candidate| candidate.key);
            let key = known.clone().find(|known| *known == key.trim()).ok_or_else(|| {
                let known: Vec<&str> = known.collect();
                BadArguments(format!("--minutes {text}: measurements are {}", known.join(", ")))
            })?;
            match value.trim().parse::<f64>() {
                Ok(minutes) if minutes > 0.0 && minutes.is_finite() => Ok((key, minutes)),
                _ => Err(BadArguments(format!(
                    "--minutes {text}: a number above 0 is wanted"
                ))),
            }
        })
        .collect()
}
