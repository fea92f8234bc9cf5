//! `tirante identify`: one recording, or frequencies measured elsewhere, to the posterior.

mod description;
mod frequencies;

use super::campaign::{self, Became, Reading};
use super::draws::DrawsFile;
use super::findings;
use super::foreign::Foreign;
use super::listing::folded;
use super::progress::Progress;
use super::setup::{self, Setup};
use super::sketch::{self, When};
use super::tally;
use super::tests_of_rod::{TestFlags, Tests};
use super::{BadArguments, WITH_LOSSES};
use crate::analysis::identify::Plan;
use crate::analysis::outcome::{Outcome, Rejected};
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::modes::Mode;
use crate::command::which_store::Output;
use crate::config::Config;
use crate::site::analyse::{Analysed, Known};
use crate::site::driver;
use crate::site::prepared::{Plans, provenance};
use crate::site::record_row::RecordRow;
use crate::site::store::Position;
use anyhow::anyhow;
use description::describe;
use frequencies::modes_of;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

/// Compute the posterior of the axial force from one recording.
///
/// Frequencies measured elsewhere can be given instead. Prints prior and posterior of every uncertain
/// parameter. For a record that gives no force it prints the reason, every peak, and possible assignments of
/// the peaks, each with its probability and its force.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante identify recordings/todi-pull.mcap
  tirante identify laser.csv \\
      --config site.toml          # UFF, WAV, MATLAB, .lvm, .tdms alike
  tirante identify hammer.tdms --config site.toml --channel 'Acc 3'
  tirante identify camera.npy --config site.toml --rate 250 --channel '[7,:,1]'
  tirante identify --frequencies 4.492,9.288,13.252
  tirante identify --frequencies 4.492,-,13.252 \\
      --sd 0.005,-,0.01    # mode 2 not measured
  tirante identify --frequencies 4.492,9.288 --draws-out draws.csv
  tirante identify pull.mcap --load 300N@0.5L=1.1mm+-3%    # same day
  tirante identify bare.mcap --config site.toml \\
      --mass 5kg@0.3L --with-mass heavy.mcap
  tirante identify --frequencies 4.492,9.288 \\
      --measured side=70.1,70.4,69.9mm+-0.2mm")]
pub struct Args {
    /// Recordings (MCAP), folders of them, or files of other programs; all their records are identified. Files of one sensor each make
    /// one motion of a rod with several.
    #[arg(
        value_name = "PATH",
        required_unless_present = "frequencies",
        conflicts_with = "frequencies"
    )]
    pub paths: Vec<PathBuf>,

    /// Natural frequencies in Hz of modes 1, 2, ... up to 5, separated by commas; '-' where a mode was
    /// not measured.
    #[arg(long, value_name = "HZ,HZ,...", allow_hyphen_values = true)]
    pub frequencies: Option<String>,

    /// Standard errors of the frequencies in Hz: one for all, or one per frequency. Default: the paper's
    /// 0.0316 Hz.
    #[arg(
        long,
        value_name = "HZ[,HZ,...]",
        requires = "frequencies",
        allow_hyphen_values = true
    )]
    pub sd: Option<String>,

    /// Rod of the configuration; required if it has several.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,

    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,

    /// Write the posterior's draws to a file: .csv, .npy, or .parquet. Those of
    /// a second record go to NAME-2.csv, and so on.
    #[arg(long, value_name = "FILE", value_parser = DrawsFile::parse)]
    pub draws_out: Option<DrawsFile>,

    /// Draw a small plot at the end.
    #[arg(long, value_name = "WHEN", value_enum, default_value_t)]
    pub plot: When,

    /// Configuration of the run.
    #[command(flatten)]
    pub setup: Setup,

    /// Facts missing in another program's file.
    #[command(flatten)]
    pub foreign: Foreign,

    /// Tests of the rod.
    #[command(flatten)]
    pub tests: TestFlags,
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, or a recording that cannot be read at all.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    match &args.frequencies {
        Some(list) => from_frequencies(args, list),
        None => from_recordings(args),
    }
}

fn from_frequencies(args: &Args, list: &str) -> anyhow::Result<ExitCode> {
    let mut config = args.setup.load()?;
    let modes = modes_of(("--frequencies", list), ("--sd", args.sd.as_deref()))?;
    let rod = setup::choose_rod(&config, args.rod.as_deref())?
        .analysis
        .rod
        .clone();
    config.rods.retain(|candidate| candidate.analysis.rod == rod);
    let highest = modes.iter().map(|mode| mode.order).max().unwrap_or(0);
    for candidate in &mut config.rods {
        candidate.analysis = candidate.analysis.clone().for_orders(highest);
    }
    let plans = Arc::new(setup::plans(&config)?);
    let plan = plans
        .get(&rod)
        .ok_or_else(|| anyhow!("the rod {rod} has no plan"))?;
    let tests = tests_of(args, &config, plan)?;
    let found = match tests {
        None => plan.run_frequencies(modes),
        Some(tests) => plan.run_with(modes, &tests.data),
    };
    let code = found
        .as_ref()
        .map_or(ExitCode::from(WITH_LOSSES), |_| ExitCode::SUCCESS);
    let outcome = Outcome::of_frequencies(&rod, found);
    keep_draws(args, &outcome, 1)?;
    show(args, &config, &plans, &outcome)?;
    Ok(code)
}

fn from_recordings(args: &Args) -> anyhow::Result<ExitCode> {
    let mut config = args.setup.load()?;
    if let Some(id) = &args.rod {
        let rod = setup::choose_rod(&config, Some(id))?.analysis.rod.clone();
        config.rods.retain(|candidate| candidate.analysis.rod == rod);
    }
    let plans = Arc::new(setup::plans(&config)?);
    let known = Known::new();
    let reading = Reading::default();
    // Alone, a file may begin at any time.
    let others = args.foreign.among(&args.setup, args.paths.len() < 2);
    let tests = if args.tests.is_empty() {
        None
    } else {
        let rod = setup::choose_rod(&config, args.rod.as_deref())?
            .analysis
            .rod
            .clone();
        let plan = plans
            .get(&rod)
            .ok_or_else(|| anyhow!("the rod {rod} has no plan"))?;
        tests_of(args, &config, plan)?
    };
    let (mut forces, mut refused_with_tests) = (0, false);
    let on_event = |analysed: &Analysed, _: Option<Position<'_>>, _: Option<[u8; 32]>, bar: &Progress| {
        if let Analysed::Record(outcome) = analysed {
            let tested = tests
                .as_ref()
                .and_then(|tests| with_tests(outcome, &plans, tests));
            let outcome = tested.as_ref().unwrap_or(outcome);
            forces += usize::from(matches!(outcome, Outcome::Identified(_)));
            keep_draws(args, outcome, forces)?;
            // The record alone gave a force: the tally does not know that with the tests it gives none.
            refused_with_tests |= matches!(tested, Some(Outcome::Rejected(_)));
            bar.suspend(|| show(args, &config, &plans, outcome))?;
        }
        Ok(Became::New)
    };
    let tally = campaign::run(
        &args.paths,
        &config,
        &plans,
        &reading,
        others,
        driver::knowing(&known),
        on_event,
    )?;
    let code = tally::conclude(tally);
    Ok(match refused_with_tests && code == ExitCode::SUCCESS {
        true => ExitCode::from(WITH_LOSSES),
        false => code,
    })
}

/// Writes the draws of the run's `number`-th force, if asked for.
fn keep_draws(args: &Args, outcome: &Outcome, number: usize) -> anyhow::Result<()> {
    match (&args.draws_out, outcome) {
        (Some(file), Outcome::Identified(found)) => file.write(&found.posterior, number),
        _ => Ok(()),
    }
}

/// The tests given, those of a record with a mass included; `None` without any.
fn tests_of(args: &Args, config: &Config, plan: &Plan) -> anyhow::Result<Option<Tests>> {
    if args.tests.is_empty() {
        return Ok(None);
    }
    let prior = &plan.settings().prior;
    let mut tests = args.tests.read(prior)?;
    if let Some(list) = &args.tests.mass_frequencies {
        let modes = modes_of(
            ("--mass-frequencies", list),
            ("--mass-sd", args.tests.mass_sd.as_deref()),
        )?;
        tests.add_loaded(&modes, prior)?;
    }
    if let Some(path) = &args.tests.with_mass {
        let (mut loaded, mut refusals) = (Vec::new(), Vec::new());
        let config = tests.with_room(config, plan);
        let plans = Arc::new(setup::plans(&config)?);
        let others = args.foreign.among(&args.setup, true);
        let paths = std::slice::from_ref(path);
        let on_event = |analysed: &Analysed, _: Option<Position<'_>>, _: Option<[u8; 32]>, _: &Progress| {
            if let Analysed::Record(outcome) = analysed {
                match outcome.as_ref() {
                    Outcome::Identified(found) => loaded.push(found.modes.clone()),
                    Outcome::Rejected(refused) => refusals.push(refused.rejection.to_string()),
                    Outcome::Tabulated(_) => {}
                }
            }
            Ok(Became::New)
        };
        let tally = campaign::run(
            paths,
            &config,
            &plans,
            &Reading::default(),
            others,
            driver::knowing(&Known::new()),
            on_event,
        )?;
        if let Some(tally) = tally {
            tell!("--with-mass {}: {tally}", path.display());
        }
        if loaded.is_empty() {
            let message = format!(
                "--with-mass {}: no record of it gives frequencies: {}",
                path.display(),
                refusals.first().map_or("it has none of the rod", String::as_str)
            );
            return Err(BadArguments(message).into());
        }
        tests.add_loaded(&mean_modes(&loaded), prior)?;
    }
    Ok(Some(tests))
}

/// Modes of several records of one moment: weighted means, with the scatter between the records where it is larger than their errors.
fn mean_modes(records: &[Vec<Mode>]) -> Vec<Mode> {
    let mut orders: Vec<usize> = records.iter().flatten().map(|mode| mode.order).collect();
    orders.sort_unstable();
    orders.dedup();
    let mean = |order: usize| {
        let seen: Vec<&Mode> = records
            .iter()
            .flatten()
            .filter(|mode| mode.order == order)
            .collect();
        let weight = |mode: &&Mode| mode.sd_hz.powi(-2);
        let weights: f64 = seen.iter().map(weight).sum();
        let frequency_hz = seen
            .iter()
            .map(|mode| weight(mode) * mode.frequency_hz)
            .sum::<f64>()
            / weights;
        let chi_square: f64 = seen
            .iter()
            .map(|mode| weight(mode) * (mode.frequency_hz - frequency_hz).powi(2))
            .sum();
        let scatter = chi_square / (seen.len() - 1).max(1) as f64;
        let sd_hz = (scatter.max(1.0) / weights).sqrt();
        let first = seen.first().copied()?;
        Some(Mode {
            frequency_hz,
            sd_hz,
            ..*first
        })
    };
    orders.into_iter().filter_map(mean).collect()
}

/// A record's outcome with the tests; `None` if the record alone gave no force.
fn with_tests(outcome: &Outcome, plans: &Plans, tests: &Tests) -> Option<Outcome> {
    let Outcome::Identified(found) = outcome else {
        return None;
    };
    let plan = plans.get(&found.rod)?;
    Some(match plan.tested(found, &tests.data) {
        Ok(tested) => Outcome::Identified(Box::new(tested)),
        Err(rejection) => Outcome::Rejected(Box::new(Rejected {
            measurement: found.measurement.clone().map(Box::new),
            labels: found.labels.clone(),
            sensors: found.joint.as_ref().map(|joint| joint.sensors.clone()),
            ..Rejected::of_identified(found, rejection)
        })),
    })
}

fn show(args: &Args, config: &Config, plans: &Plans, outcome: &Outcome) -> io::Result<()> {
    let text = match outcome {
        _ if args.output.is_json() => RecordRow::of(outcome, None, &provenance(config)).to_json()? + "\n",
        Outcome::Identified(identification) => match plans.get(&identification.rod) {
            Some(plan) => {
                describe(plan, identification)
                    + &plot(args, || Snapshot::of(&plan.settings().prior, identification))
            }
            None => String::new(),
        },
        // Rows of tables do not come here.
        Outcome::Tabulated(_) => String::new(),
        Outcome::Rejected(rejected) => {
            findings::refused(rejected) + &plot(args, || Snapshot::of_rejected(rejected))
        }
    };
    let text = if args.output.is_json() {
        text
    } else {
        folded(&text)
    };
    io::stdout().lock().write_all(text.as_bytes())
}

/// Small plot of a record's spectrum, if wanted and there is a spectrum.
fn plot(args: &Args, picture: impl FnOnce() -> Option<Snapshot>) -> String {
    let width = args.plot.width();
    let drawn = width.and_then(|width| Some(sketch::spectrum(&picture()?, width)));
    match drawn {
        Some(plot) if !plot.is_empty() => format!("\n{plot}"),
        _ => String::new(),
    }
}
