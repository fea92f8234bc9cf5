//! `tirante emulator`: fits emulators into the cache, and prints their errors.

use super::progress::Progress;
use super::{USAGE, print, setup};
use crate::analysis::rod::beam::forward::ForwardModel;
use crate::analysis::rod::beam::{Exact, FiniteElements, finite_elements};
use crate::analysis::rod::emulator::validate::{self, ErrorReport, GridErrors, ModeErrors, Spread};
use crate::analysis::rod::emulator::{FitError, Pce, ReducedModel};
use crate::analysis::rod::prior::RodPrior;
use crate::command::which_store::Output;
use crate::config::Config;
use crate::site::emulator_cache::{Cache, Origin};
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// Fit an emulator, or print its errors.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante emulator validate
  tirante emulator train --order 5 --config config/campaign.toml --rod nave-3")]
pub struct Args {
    /// Action to take.
    #[command(subcommand)]
    pub action: Action,

    /// Configuration whose rod's prior is used; default: the paper's rod.
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Rod of the configuration; required if it has several.
    #[arg(long, global = true, value_name = "ID")]
    pub rod: Option<String>,
}

/// Action of `tirante emulator`.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Action {
    /// Fit the paper's chaos and keep it in the cache directory; the reduced emulator needs no training.
    #[command(after_help = "Examples:
  tirante emulator train --order 5")]
    Train {
        /// Total order of the chaos, 1 to 12.
        #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=12))]
        order: u8,
    },
    /// Print an emulator's errors of value and slope over the prior.
    #[command(after_help = "Examples:
  tirante emulator validate --model pce --order 5 --sample 100000 \\
      --format json")]
    Validate(ValidateArgs),
}

/// Options for measuring the errors of an emulator.
#[derive(Debug, Clone, clap::Args)]
pub struct ValidateArgs {
    /// Emulator to check.
    #[arg(long, value_enum, default_value_t = Which::All)]
    pub model: Which,
    /// Total order of the paper's chaos, 1 to 12.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=12))]
    pub order: u8,
    /// Model taken as the truth.
    #[arg(long, value_enum, default_value_t = Truth::Exact)]
    pub reference: Truth,
    /// Number of draws from the prior.
    #[arg(long, default_value_t = validate::SAMPLE as u32, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub sample: u32,
    /// Seed of the draws.
    #[arg(long, default_value_t = validate::SEED)]
    pub seed: u64,
    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,
}

/// Emulator to check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Which {
    /// The reduced emulator (default model).
    Reduced,
    /// The paper's Hermite chaos.
    Pce,
    /// Both emulators.
    All,
}

/// Model taken as the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Truth {
    /// The exact model.
    Exact,
    /// Fifty finite elements.
    FiniteElements,
}

/// Runs the command. Exit code 2: no chaos of that order can be fitted for the rod.
///
/// # Errors
/// Bad arguments or configuration, or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = Config::resolve(args.config.as_deref(), &[])?;
    let prior = &setup::choose_rod(&config, args.rod.as_deref())?.analysis.prior;
    let cache = Cache::of_user();
    let text = match &args.action {
        Action::Train { order } => train(&cache, prior, usize::from(*order)),
        Action::Validate(args) => validated(args, &cache, prior),
    };
    match text {
        Ok(text) => print(&text?),
        Err(error) => {
            tell!("tirante emulator: {error}");
            Ok(ExitCode::from(USAGE))
        }
    }
}

fn train(cache: &Cache, prior: &RodPrior, order: usize) -> Result<io::Result<Vec<u8>>, FitError> {
    let (pce, origin) = fitted_pce(cache, prior, order)?;
    let where_from = match &origin {
        Origin::Read(path) => format!("already in {}", path.display()),
        Origin::Kept(path) => format!("fitted, kept in {}", path.display()),
        Origin::Fitted => "fitted, not kept (no usable cache directory)".to_owned(),
    };
    let mut text = format!(
        "pce of order {}, {} terms per mode: {where_from}\n",
        pce.order(),
        pce.terms()
    );
    Ok(table(pce.report()).map(|table| {
        text.push_str(&table);
        text.into_bytes()
    }))
}

fn validated(args: &ValidateArgs, cache: &Cache, prior: &RodPrior) -> Result<io::Result<Vec<u8>>, FitError> {
    let parameterisation = *prior.parameterisation();
    let sample = (args.sample as usize, args.seed);
    let reference: Box<dyn ForwardModel> = match args.reference {
        Truth::Exact => Box::new(Exact::new(parameterisation)),
        Truth::FiniteElements => Box::new(FiniteElements::new(parameterisation, finite_elements::ELEMENTS)),
    };
    let mut reports = Vec::new();
    if args.model != Which::Pce {
        let model = ReducedModel::new(parameterisation);
        reports.push(judging(args, |judged| {
            validate::on_prior(&model, None, &*reference, prior, sample, judged)
        }));
    }
    if args.model != Which::Reduced {
        let (pce, _) = fitted_pce(cache, prior, usize::from(args.order))?;
        let mut report = judging(args, |judged| pce.validate(&*reference, sample, judged));
        report.grid.clone_from(&pce.report().grid);
        reports.push(report);
    }
    let line = |report: &ErrorReport| Ok(serde_json::to_string(report)? + "\n");
    let texts = reports.iter().map(|report| {
        if args.output.is_json() {
            line(report)
        } else {
            table(report)
        }
    });
    Ok(texts.collect::<io::Result<String>>().map(String::into_bytes))
}

/// The paper's chaos from the cache, or fitted behind a progress bar on standard error.
pub(super) fn fitted_pce(cache: &Cache, prior: &RodPrior, order: usize) -> Result<(Pce, Origin), FitError> {
    let solves = Progress::of_solves();
    cache.pce(prior, order, finite_elements::ELEMENTS, &|more, all| {
        solves.add(more as u64, all as u64);
    })
}

/// Runs a validation behind a progress bar.
fn judging(args: &ValidateArgs, work: impl FnOnce(&(dyn Fn(usize) + Sync)) -> ErrorReport) -> ErrorReport {
    let sample = u64::from(args.sample);
    let judged = Progress::new(
        sample,
        "{wide_bar} {human_pos}/{human_len} draws judged, {eta} left",
    );
    work(&|more| judged.add(more as u64, sample))
}

/// Error report as tables.
fn table(report: &ErrorReport) -> io::Result<String> {
    let mut out = Vec::new();
    let ErrorReport {
        emulator,
        reference,
        sample,
        outside,
        ..
    } = report;
    writeln!(out)?;
    writeln!(
        out,
        "{emulator} against {reference}: {sample} draws from the prior, {outside} outside the trained range"
    )?;
    if *outside > 0 {
        writeln!(out, "inside the trained range (the exact model answers outside)")?;
    }
    modes(&mut out, &report.modes)?;
    if let Some(all) = &report.extrapolated {
        writeln!(out, "all draws, had those outside been extrapolated")?;
        modes(&mut out, all)?;
    }
    if let Some(grid) = &report.grid {
        writeln!(out, "on the fitting points")?;
        writeln!(out, "mode    mean [Hz]   variance [Hz^2]")?;
        for GridErrors {
            order,
            mean_hz,
            variance_hz2,
        } in grid
        {
            writeln!(out, "{order:>4}    {mean_hz:<9.1e}   {variance_hz2:.2e}")?;
        }
    }
    Ok(String::from_utf8_lossy(&out).into_owned())
}

fn modes(out: &mut impl Write, modes: &[ModeErrors]) -> io::Result<()> {
    writeln!(
        out,
        "        frequency [Hz]                 relative [-]                   slope d ln f / d ln N [-]"
    )?;
    writeln!(
        out,
        "mode    rms      99.9 %   max          rms      99.9 %   max          rms      99.9 %   max"
    )?;
    let cells = |s: &Spread| format!("{:<8.1e} {:<8.1e} {:<8.1e}", s.rms, s.q999, s.max);
    for ModeErrors {
        order,
        value_hz,
        relative,
        slope,
    } in modes
    {
        let slope = slope
            .as_ref()
            .map_or_else(|| "the force is fixed".to_owned(), cells);
        let line = format!(
            "{order:>4}    {}     {}     {slope}",
            cells(value_hz),
            cells(relative)
        );
        writeln!(out, "{}", line.trim_end())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_is_readable_and_complete() {
        let prior = RodPrior::todi();
        let args = ValidateArgs {
            model: Which::Reduced,
            order: 5,
            reference: Truth::Exact,
            sample: 200,
            seed: 1,
            output: Output::default(),
        };
        let nowhere = Cache::at(std::path::Path::new("/nonexistent"));
        let text = |args: &ValidateArgs| {
            String::from_utf8(validated(args, &nowhere, &prior).unwrap().unwrap()).unwrap()
        };
        let table = text(&args);
        assert!(
            table.contains("reduced against exact: 200 draws from the prior, 0 outside the trained range")
        );
        assert_eq!(table.lines().count(), 9);
        let json: ErrorReport = serde_json::from_str(&text(&ValidateArgs {
            output: Output::JSON,
            ..args
        }))
        .unwrap();
        assert_eq!((json.sample, json.modes.len()), (200, 5));
    }
}
