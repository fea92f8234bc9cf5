//! `tirante init`: writes a commented configuration for one rod, from flags, questions and a recording.

use super::listing::pasted;
use super::questions::Questions;
use super::rod_flags::{Rod, RodFlags};
use super::sensor::{Sensor, Wanted};
use super::template::{self, Template};
use super::{BadArguments, foreign, print};
use crate::analysis::signal::record::Unit;
use crate::config::{self, Config};
use crate::recording::import::{self, How};
use anyhow::Context;
use std::path::PathBuf;
use std::process::ExitCode;

/// Name of the site, if none is given.
const SITE: &str = "A site";
/// Default id of the rod.
const ID: &str = "rod-1";

/// Write a commented configuration for one rod.
///
/// It holds the minimum, with wide priors. Values without a flag are asked for on a terminal; topic, field,
/// unit and rate come from a recording, if one is given.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante init laser.mcap --out site.toml
  tirante init laser.mcap --id nave-3 --length 14 --section s70 \\
      --material iron --out site.toml
  tirante init --length 9500mm --section d45 --material steel \\
      --force '20..200 kN' --topic /rod --unit um --out site.toml

Then: tirante check site.toml; tirante identify laser.mcap --config site.toml")]
pub struct Args {
    /// Recording of the rod (MCAP), or another program's file that gives its rate (CSV, UFF, WAV, MATLAB,
    /// LabVIEW).
    #[arg(value_name = "RECORDING")]
    pub recording: Option<PathBuf>,
    /// Configuration to write; an existing one is never overwritten.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Name of the site.
    #[arg(long)]
    pub site: Option<String>,
    /// Name of the rod: letters, digits, '-', '_' and '.'; default: rod-1.
    #[arg(long)]
    pub id: Option<String>,
    /// Facts of the rod.
    #[command(flatten)]
    pub rod: RodFlags,
    /// Topic of its displacement, velocity or acceleration.
    #[arg(long)]
    pub topic: Option<String>,
    /// Field of a message that holds the samples, if it is not one of the usual ones.
    #[arg(long, value_name = "PATH")]
    pub field: Option<String>,
    /// Unit of the samples, if the recording does not give it.
    #[arg(long, value_parser = foreign::unit)]
    pub unit: Option<Unit>,
    /// Sample rate in Hz, only for arrays, if the recording does not give it.
    #[arg(long, value_name = "HZ", value_parser = super::quantities::rate)]
    pub fs_hz: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// A fact is missing and cannot be asked for, the recording cannot be read, or the file exists or cannot be
/// written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if args.out.exists() {
        return Err(BadArguments(format!(
            "{}: exists, and init overwrites nothing: give another --out",
            args.out.display()
        ))
        .into());
    }
    let found = match &args.recording {
        Some(path) => {
            let how = How {
                rate_hz: args.fs_hz,
                ..How::default()
            };
            Some(import::topics(path, &how, &foreign::watch)?)
        }
        None => None,
    };
    let mut questions = Questions::here();
    let rod = Rod::of(&args.rod, true, &mut questions)?;
    let wanted = Wanted {
        topic: args.topic.as_deref(),
        field: args.field.as_deref(),
        unit: args.unit,
        fs_hz: args.fs_hz,
        needs_unit: true,
    };
    let sensor = Sensor::of(&wanted, found.as_deref(), &mut questions)?;
    let id = match &args.id {
        Some(id) => id.clone(),
        None => {
            let question = format!("name of the rod (Enter: {ID})");
            let answer = questions.ask_open(&question, config::rod_id)?;
            answer.unwrap_or_else(|| {
                if !questions.is_terminal {
                    tell!("the rod is called {ID}: --id gives it another name");
                }
                ID.to_owned()
            })
        }
    };
    if args.site.is_none() {
        tell!("the site is called {SITE}: --site gives it another name");
    }
    let text = Template {
        command: "init",
        site: args.site.as_deref().unwrap_or(SITE),
        id: &id,
        rod: &rod,
        sensor: &sensor,
        thermometer: template::thermometer(found.as_deref()),
    }
    .text();
    // Faults caused by a flag or an answer are reported in the form of `check`.
    Config::parse(&text, &args.out.display().to_string())?;
    template::save(&args.out, &text).with_context(|| format!("cannot write {}", args.out.display()))?;
    let recording = args
        .recording
        .as_ref()
        .map_or("RECORDING.mcap".to_owned(), |path| pasted(path));
    print(
        format!(
            "{}: written: {}\nRead it, correct its priors, then\n  tirante identify {recording} --config {}\n",
            args.out.display(),
            rod.said(),
            pasted(&args.out)
        )
        .as_bytes(),
    )
}
