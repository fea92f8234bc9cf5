//! `tirante measure`: one file to a force, a configuration and a report.

use super::campaign::{self, Became, Reading};
use super::foreign::{self, Foreign};
use super::measure_files::Files;
use super::progress::Progress;
use super::quantities;
use super::questions::Questions;
use super::rod_flags::{Rod, RodFlags};
use super::sensor::{Sensor, Wanted};
use super::setup::{self, GivenUp, Prepared};
use super::sketch::{self, When};
use super::tally;
use super::template::{self, Template};
use super::{findings, report};
use crate::analysis::findings::{Candidate, Doubt};
use crate::analysis::outcome::Outcome;
use crate::analysis::record_view::Snapshot;
use crate::analysis::rod::beam::Quantity;
use crate::analysis::signal::record::{Rejection, Unit};
use crate::command::which_store::Output;
use crate::config::Config;
use crate::recording::import::{self, Format, How, TimeUnit};
use crate::recording::read::contents::Content;
use crate::site::analyse::Analysed;
use crate::site::driver;
use crate::site::records::Others;
use crate::site::store::Position;
use std::io::{self, BufRead, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Measure the axial force once, from one file of any format.
///
/// Asks for length, section and material, recognises the motion, and shows the spectrum's peaks, the force with its
/// 95 % interval and its sensitivities. Values given by flags are not asked for.
///
/// Writes a configuration, to be corrected and used again by `identify`, `replay` and `run`, and a report to print
/// and sign. A mark precedes every force that may be wrong: '!' where model or prior and data disagree, '?'
/// where the orders of the modes are not certain.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante measure laser.csv
  tirante measure laser.csv --length 14 --section s70 --material iron
  tirante measure hammer.wav --length '9.5 m' --section d45 --material steel \\
      --force '20..200 kN'
  tirante measure camera.npy --rate 250 --length 950cm --section 40x60mm \\
      --material iron --format json

Files: laser.toml and laser.html in --out. A configuration that exists is never
overwritten.

Exit codes: 0 a force was told, marked or not (read the marks, or conflict,
prior_tail and label_probability of --format json); 1 the file cannot be read; 2
something is not said or makes no sense; 3 a record was refused, or data were
lost.")]
pub struct Args {
    /// Recording (MCAP), or file of another program (CSV, UFF, WAV, MATLAB, LabVIEW, NumPy).
    #[arg(value_name = "FILE")]
    pub file: PathBuf,

    /// Facts of the rod.
    #[command(flatten)]
    pub rod: RodFlags,

    /// Name of the rod; default: that of the file.
    #[arg(long, value_parser = crate::config::rod_id)]
    pub id: Option<String>,

    /// Name of the site, which heads the report; default: that of the file.
    #[arg(long)]
    pub site: Option<String>,

    /// Channel of its motion, if the file has several.
    #[arg(long)]
    pub topic: Option<String>,

    /// Field of a message that holds the samples, if it is not one of the usual ones; only for recordings.
    #[arg(long, value_name = "PATH")]
    pub field: Option<String>,

    /// Folder for configuration and report.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,

    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,

    /// Draw a small plot of the spectrum.
    #[arg(long, value_name = "WHEN", value_enum, default_value_t)]
    pub plot: When,

    /// Facts missing in another program's file.
    #[command(flatten)]
    pub foreign: Foreign,
}

/// Runs the command.
///
/// # Errors
/// A fact is missing and cannot be asked for, the file cannot be read, or an output cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let stem = args.file.file_stem().unwrap_or_default().to_string_lossy();
    let named = |ending: &str| {
        let name = PathBuf::from(format!("{stem}.{ending}"));
        match args.out == Path::new(".") {
            true => name,
            false => args.out.join(name),
        }
    };
    let files = Files::new(named("toml"), named("html"), &args.file)?;
    let mut questions = Questions::here();
    let mut how = args.foreign.how();
    let found = look(&args.file, &mut how, &mut questions)?;
    let rod = Rod::of(&args.rod, false, &mut questions)?;
    let wanted = Wanted {
        topic: args.topic.as_deref(),
        field: args.field.as_deref(),
        unit: how.unit,
        fs_hz: how.rate_hz,
        needs_unit: false,
    };
    let sensor = Sensor::of(&wanted, Some(&found), &mut questions)?;
    if !sensor.says_unit {
        tell!(
            "the file does not say its unit: its samples pass for metres, which changes no frequency and no force (--unit)"
        );
    }
    let text = Template {
        command: "measure",
        site: args.site.as_deref().unwrap_or(&stem),
        id: args.id.as_deref().unwrap_or(&id_of(&stem)),
        rod: &rod,
        sensor: &sensor,
        thermometer: template::thermometer(Some(&found)),
    }
    .text();
    let config = Config::parse(&text, &files.toml.display().to_string())?;
    let how = as_read(&args.file, how, &sensor)?;
    let Prepared { generation, mut site } = setup::site(config, None, &GivenUp::default(), true)?;
    let others = Others {
        how,
        is_meant: true,
        any_start: true,
        needs_all: false,
    };
    let understood = format!("{}: {}", args.file.display(), rod.said());
    if args.output.is_json() {
        tell!("{understood}");
    } else {
        super::print((understood + "\n").as_bytes())?;
    }
    let (mut records, mut forces) = (0, 0);
    let tally = campaign::run(
        std::slice::from_ref(&args.file),
        &generation.config,
        &generation.plans,
        &Reading::default(),
        others,
        driver::knowing(&site.store().all_known().clone()),
        |analysed: &Analysed, place: Option<Position<'_>>, _: Option<[u8; 32]>, bar: &Progress| {
            if let Analysed::Record(outcome) = analysed {
                records += 1;
                forces += usize::from(matches!(outcome.as_ref(), Outcome::Identified(_)));
                let Some(taken) = site.take(outcome, place)? else {
                    return Ok(Became::Known);
                };
                let text = match args.output.is_json() {
                    true => taken.row.to_json()? + "\n",
                    false => {
                        let is_force_expected = rod.expected.is_some();
                        told(&generation.config, outcome, is_force_expected, args.plot.width())
                    }
                };
                bar.suspend(|| io::stdout().lock().write_all(text.as_bytes()))?;
            }
            Ok(Became::New)
        },
    )?;
    let code = tally::conclude(tally);
    if records > 0 {
        files.keep(&text, forces > 0, |page| {
            report::write(site.store(), None, page)?;
            Ok(())
        })?;
    }
    Ok(code)
}

/// Channels of a file; asks for the unit of its times if they can hardly be seconds, and for its rate if it has none.
fn look<R: BufRead>(
    file: &Path,
    how: &mut How,
    questions: &mut Questions<R>,
) -> anyhow::Result<Vec<Content>> {
    if let Some(choices) = import::lacks_time_unit(file, how)? {
        let question = format!("unit of the time column ({choices})");
        let unit = questions.ask(&question, "--time-unit", |answer| {
            TimeUnit::of(&answer.to_lowercase())
                .ok_or_else(|| format!("{answer:?} is none of s, ms, us, ns, min, h"))
        })?;
        how.table.time_unit = Some(unit);
    }
    if import::lacks_rate(file, how)? {
        let question = "sample rate in Hz, which the file does not say";
        let flag = "--rate, or --time with the column of the stamps,";
        let rate_hz = questions.ask(question, flag, quantities::rate)?;
        questions.confirm(&format!("{rate_hz} Hz"));
        how.rate_hz = Some(rate_hz);
    }
    Ok(import::topics(file, how, &foreign::watch)?)
}

/// Options for reading the file with the configuration. That of a recording has rate and unit; the scale of
/// the samples does not affect frequencies, so an unknown one is 1.
fn as_read(file: &Path, how: How, sensor: &Sensor) -> anyhow::Result<How> {
    let Some(format) = import::format(file, &how)? else {
        return Ok(How {
            rate_hz: None,
            unit: None,
            ..how
        });
    };
    Ok(How {
        full_scale: how.full_scale.or((format == Format::Wav).then_some(1.0)),
        unit: how.unit.or((!sensor.says_unit).then_some(Unit::Metre)),
        ..how
    })
}

/// A rod's id from the name of a file.
fn id_of(stem: &str) -> String {
    let id: String = stem
        .trim_start_matches('.')
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || "-_.".contains(c) {
                c
            } else {
                '-'
            }
        })
        .take(64)
        .collect();
    match id.is_empty() {
        true => "rod-1".to_owned(),
        false => id,
    }
}

/// A record in words: peaks, spectrum, force with its marks and the sources of its variance; for a refused
/// one the reason.
fn told(config: &Config, outcome: &Outcome, is_force_expected: bool, width: Option<usize>) -> String {
    let prior = config.rod(&outcome.rod().0).map(|rod| &rod.analysis.prior);
    let picture = prior.and_then(|prior| Snapshot::of_outcome(prior, outcome));
    let plot = match (width, &picture) {
        (Some(width), Some(picture)) => sketch::spectrum(picture, width),
        _ => String::new(),
    };
    let mut text = "\n".to_owned();
    let identification = match outcome {
        Outcome::Identified(identification) => identification,
        Outcome::Rejected(rejected) => {
            text += &findings::refused(rejected);
            if matches!(rejected.rejection, Rejection::NoLabel { .. }) && !is_force_expected {
                let has_orders = picture
                    .as_ref()
                    .is_some_and(|picture| !picture.candidates.is_empty());
                text += match has_orders {
                    true => "\n  A force expected may decide: --force '20..200 kN'\n",
                    false => {
                        "\n  Check length, section and material; a force expected may decide, too:\n  --force '20..200 kN'\n"
                    }
                };
            }
            if !plot.is_empty() {
                text += &format!("\n{plot}");
            }
            return text;
        }
        // Rows of tables do not come here.
        Outcome::Tabulated(_) => return text,
    };
    for line in identification.measurement.iter().flat_map(findings::opening) {
        text += &(line + "\n");
    }
    if let Some(picture) = &picture {
        text += &format!("\n{}", findings::peaks(&picture.peaks));
    }
    if !plot.is_empty() {
        text += &format!("\n{plot}");
    }
    let labels = identification.labels.as_ref();
    let conflict = &identification.conflict;
    let doubts = outcome.doubts();
    let force = identification.posterior.marginal(Quantity::AxialForce);
    if let Some(force) = &force {
        text += &format!(
            "\n  {}axial force {}, 95 % interval in brackets\n",
            Doubt::mark(&doubts),
            findings::force(force)
        );
    }
    for line in findings::doubts(conflict, force.as_ref()) {
        text += &(line + "\n");
    }
    if let Some(labels) = labels.filter(|_| doubts.contains(&Doubt::Orders)) {
        text += &format!(
            "  ? {}\n    (they are right with {:.1} %); the peaks may be\n{}",
            Doubt::Orders.said(),
            100.0 * labels.probability,
            findings::candidates(&Candidate::all(labels))
        );
    }
    if let Some(shares) = &identification.hangs_on {
        text += &format!("\n{}", findings::hangs_on(shares));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_any_name_names_its_rod() {
        assert_eq!(id_of("nave-3"), "nave-3");
        assert_eq!(id_of("Navata nord (1)"), "Navata-nord--1-");
        assert_eq!(id_of(".."), "rod-1");
        for name in ["\u{e0}\u{e8}", "x", &"y".repeat(300), "a b"] {
            assert!(crate::config::rod_id(&id_of(name)).is_ok(), "{name}");
        }
    }
}
