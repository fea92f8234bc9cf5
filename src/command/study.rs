//! `tirante study`: repeats the source paper and compares its printed figures.

use super::print;
use super::progress::Progress;
use crate::analysis::lab::study::claims::Claim;
use crate::analysis::lab::study::density::Grid;
use crate::analysis::lab::study::estimate::{Comparison, DISAGREE};
use crate::analysis::lab::study::paper::{self, INFERRED};
use crate::analysis::lab::study::times::Time;
use crate::analysis::lab::study::{self, Effort, Score, Study};
use crate::analysis::rod::beam::Quantity;
use crate::command::report_page;
use crate::command::which_store::Output;
use crate::recording::atomic::AtomicFile;
use anyhow::Context;
use serde::Serialize;
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Run the source paper's study and compare it with the paper.
///
/// Every table and figure is compared with the printed one, with Monte Carlo errors.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante study --out study
  tirante study --quick

Writes study.html (every table and figure), study.json and numbers.csv (every
number), curves.csv (every curve). The same seed gives the same bytes. A few
minutes on two cores; --quick half a minute.")]
pub struct Args {
    /// Folder of the report; without it only the table on stdout.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Number of repetitions of every ABC; of every MCMC a quarter as many.
    #[arg(long, value_name = "COUNT", default_value_t = 40, value_parser = clap::value_parser!(u16).range(8..=10_000), conflicts_with = "quick")]
    pub repeats: u16,

    /// Do a small part of the work, as a trial; its errors are large.
    #[arg(long)]
    pub quick: bool,

    /// Also measure the times of training, evaluation and sampling on one thread, half a minute more; these
    /// are not reproducible, everything else is.
    #[arg(long)]
    pub times: bool,

    /// Seed of all random numbers.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,

    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,
}

impl Args {
    fn effort(&self) -> Effort {
        let runs = usize::from(self.repeats);
        if self.quick {
            Effort {
                abc_runs: 8,
                mcmc_runs: 4,
                many_draws: 50_000,
                mcmc_steps: 48_000,
                rods: 4,
                epochs: 10,
                ..Effort::default()
            }
        } else {
            Effort {
                abc_runs: runs,
                mcmc_runs: runs / 4,
                ..Effort::default()
            }
        }
    }
}

/// Runs the command.
///
/// # Errors
/// The report cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if let Some(out) = &args.out {
        // Minutes of work must not end at a folder that cannot be made.
        fs::create_dir_all(out).with_context(|| format!("the folder {}", out.display()))?;
    }
    let progress = Progress::new(0, "{wide_bar} {human_pos}/{human_len} runs, {eta} left, {msg}");
    let mut study = study::run(args.effort(), args.seed, &|what, done, all| {
        progress.say_at(what, done as u64, all as u64);
    })?;
    drop(progress);
    if args.times {
        let begun = Instant::now();
        let clock = || begun.elapsed().as_secs_f64();
        study.times = study::times::measure(&args.effort(), args.seed, &clock)?;
    }
    let json = serde_json::to_string(&Document::of(&study))? + "\n";
    if let Some(out) = &args.out {
        write(&out.join("study.html"), &report_page::study(&study))?;
        write(&out.join("study.json"), &json)?;
        write(&out.join("numbers.csv"), &numbers(&study.comparisons()))?;
        write(&out.join("curves.csv"), &curves(&study))?;
    }
    let text = if args.output.is_json() {
        json
    } else {
        table(&study, args.out.as_deref())
    };
    print(text.as_bytes())
}

/// Replaces a file as a whole.
pub(super) fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    let at = || format!("the file {}", path.display());
    let mut file = AtomicFile::create(path).with_context(at)?;
    file.write_all(text.as_bytes()).with_context(at)?;
    file.commit().with_context(at)
}

/// All numbers of the study.
#[derive(Serialize)]
struct Document<'a> {
    program: &'static str,
    version: &'static str,
    seed: u64,
    effort: Effort,
    claims: &'a [Claim],
    score: Vec<Score>,
    #[serde(skip_serializing_if = "<[Time]>::is_empty")]
    times: &'a [Time],
    numbers: Vec<Comparison>,
}

impl<'a> Document<'a> {
    fn of(study: &'a Study) -> Self {
        Self {
            program: "tirante study",
            version: env!("CARGO_PKG_VERSION"),
            seed: study.seed,
            effort: study.effort,
            claims: &study.claims,
            score: study.score(),
            times: &study.times,
            numbers: study.comparisons(),
        }
    }
}

/// A field of a CSV file; ours hold commas but no quotes.
fn field(text: &str) -> String {
    if text.contains(',') {
        format!("\"{text}\"")
    } else {
        text.to_owned()
    }
}

fn numbers(comparisons: &[Comparison]) -> String {
    let mut csv = String::from("part,column,quantity,statistic,paper,ours,error_of_one_run,runs,deviation\n");
    let optional = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:?}"));
    for c in comparisons {
        let names = [&c.part, &c.column, &c.quantity, c.statistic]
            .map(field)
            .join(",");
        let error = Some(c.ours.error).filter(|e| e.is_finite());
        let _ = writeln!(
            csv,
            "{names},{},{:?},{},{},{}",
            optional(c.paper.map(|printed| printed.value)),
            c.ours.value,
            optional(error),
            c.ours.runs,
            optional(c.deviation)
        );
    }
    csv
}

fn curves(study: &Study) -> String {
    let mut csv = String::from("figure,setting,curve,quantity,x,y\n");
    let mut line = |figure: &str, setting: &str, curve: &str, quantity: &str, x: f64, y: f64| {
        let _ = writeln!(csv, "{figure},{setting},{},{quantity},{x},{y}", field(curve));
    };
    for part in &study.parts {
        let (key, prior) = (part.setting.key(), part.setting.prior());
        let table_3 = paper::prior(paper::TABLE_3_DENSITY);
        for (i, quantity) in INFERRED.map(Quantity::key).iter().enumerate() {
            let grid = Grid::of(&prior.priors()[i]);
            for column in &part.columns {
                for (k, density) in column.density(i).into_iter().enumerate().step_by(4) {
                    line("5", key, &column.which.name(), quantity, grid.at(k), density);
                }
            }
            let grid = Grid::of(&table_3.priors()[i]);
            for row in &part.rows {
                let curve = format!("nf = {}", row.frequencies);
                for (k, density) in row.quantities[i].density.iter().enumerate().step_by(4) {
                    line("7", key, &curve, quantity, grid.at(k), *density);
                }
            }
        }
    }
    let springs = &study.springs;
    for (stiffness, frequencies) in springs.stiffness_n_m.iter().zip(&springs.frequency_hz) {
        for (mode, f) in frequencies.iter().enumerate() {
            line(
                "4",
                "",
                &format!("mode {}", mode + 1),
                "frequency_hz",
                *stiffness,
                *f,
            );
        }
    }
    csv
}

/// Summary of the study: figures that agree or disagree, and verdicts on the statements.
fn table(study: &Study, out: Option<&Path>) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "printed figures within {DISAGREE} standard errors of ours {:>14} {:>12}",
        "as printed", "as inferred"
    );
    for score in study.score() {
        let _ = write!(text, "  {:<46}", score.name);
        for (agree, all) in score.agree {
            let _ = write!(text, " {agree:>6} of {all:>2}");
        }
        text.push('\n');
    }
    let _ = writeln!(
        text,
        "\nTable 2 and Table 3: paper, ours with the error of one run, difference in standard errors"
    );
    let tables = study.comparisons();
    let shown = tables
        .iter()
        .filter(|c| c.part.starts_with("Table") && c.paper.is_some());
    for c in shown {
        let (Some(printed), Some(deviation)) = (c.paper, c.deviation) else {
            continue;
        };
        let _ = writeln!(
            text,
            "  {:<20} {:<24} {:<18} {:<5} {:>10.4e} {:>10.4e} +- {:.1e} {deviation:>7.1}",
            c.part, c.column, c.quantity, c.statistic, printed.value, c.ours.value, c.ours.error
        );
    }
    let _ = writeln!(text, "\nstatements");
    for claim in &study.claims {
        let verdict = claim.verdict.words();
        let _ = writeln!(
            text,
            "  [{verdict}] {} ({})\n      {}",
            claim.statement, claim.source, claim.evidence
        );
    }
    if !study.times.is_empty() {
        let _ = writeln!(text, "\ntimes on one thread of this machine [s]");
    }
    for time in &study.times {
        let _ = writeln!(
            text,
            "  {:<30} {:<16} {:.3e}",
            time.what, time.model, time.seconds
        );
    }
    if let Some(out) = out {
        let _ = writeln!(text, "\n{}", out.join("study.html").display());
    }
    text
}
