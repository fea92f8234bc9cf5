//! `tirante emulator`: fits emulators into the cache, and says how wrong they are.

use crate::bayes::RodPrior;
use crate::beam::{Exact, FiniteElements, finite_elements};
use crate::cache::{Cache, Origin};
use crate::emulator::validate::{self, ErrorReport, ModeErrors, Spread};
use crate::emulator::{FitError, Pce, ReducedModel};
use crate::forward::ForwardModel;
use indicatif::{ProgressBar, ProgressStyle};
use std::process::ExitCode;

/// Fit an emulator, or judge one.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// What to do.
    #[command(subcommand)]
    pub action: Action,
}

/// What to do with an emulator.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Action {
    /// Fit the paper's chaos and keep it in the cache directory; the reduced emulator needs no training.
    #[command(after_help = "Example: tirante emulator train --order 5")]
    Train {
        /// Total order of the chaos, 1 to 12.
        #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=12))]
        order: u8,
    },
    /// Print an emulator's errors of value and slope over the prior.
    #[command(after_help = "Example: tirante emulator validate --model pce --order 5 --sample 100000 --json")]
    Validate(ValidateArgs),
}

/// How an emulator is judged.
#[derive(Debug, Clone, clap::Args)]
pub struct ValidateArgs {
    /// Which emulator.
    #[arg(long, value_enum, default_value_t = Which::All)]
    pub model: Which,
    /// Total order of the paper's chaos, 1 to 12.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=12))]
    pub order: u8,
    /// What is taken as the truth.
    #[arg(long, value_enum, default_value_t = Truth::Exact)]
    pub reference: Truth,
    /// Draws from the prior.
    #[arg(long, default_value_t = validate::SAMPLE as u32, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    pub sample: u32,
    /// Seed of the draws.
    #[arg(long, default_value_t = validate::SEED)]
    pub seed: u64,
    /// One JSON object per emulator and line instead of the tables.
    #[arg(long)]
    pub json: bool,
}

/// Which emulator is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Which {
    /// The reduced one (default model).
    Reduced,
    /// The paper's Hermite chaos.
    Pce,
    /// Both.
    All,
}

/// What an emulator is judged by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Truth {
    /// The exact model.
    Exact,
    /// Fifty finite elements.
    FiniteElements,
}

/// Runs on the paper's rod.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    run_for(args, &RodPrior::todi())
}

/// Runs on a rod with this prior. Exit code 2: no chaos of that order can be fitted for it.
pub fn run_for(args: &Args, prior: &RodPrior) -> anyhow::Result<ExitCode> {
    let cache = Cache::of_user();
    let done = match &args.action {
        Action::Train { order } => train(&cache, prior, usize::from(*order)),
        Action::Validate(args) => judge(args, &cache, prior)?,
    };
    Ok(match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("tirante emulator: {error}");
            ExitCode::from(2)
        }
    })
}

fn train(cache: &Cache, prior: &RodPrior, order: usize) -> Result<(), FitError> {
    let (pce, origin) = fitted_pce(cache, prior, order)?;
    let where_from = match &origin {
        Origin::Read(path) => format!("already in {}", path.display()),
        Origin::Kept(path) => format!("fitted, kept in {}", path.display()),
        Origin::Fitted => "fitted, not kept (no usable cache directory)".to_owned(),
    };
    println!(
        "pce of order {}, {} terms per mode: {where_from}",
        pce.order(),
        pce.terms()
    );
    print_report(pce.report());
    Ok(())
}

fn judge(args: &ValidateArgs, cache: &Cache, prior: &RodPrior) -> anyhow::Result<Result<(), FitError>> {
    let parameterisation = *prior.parameterisation();
    let sample = args.sample as usize;
    let reference: Box<dyn ForwardModel> = match args.reference {
        Truth::Exact => Box::new(Exact::new(parameterisation)),
        Truth::FiniteElements => Box::new(FiniteElements::new(parameterisation, finite_elements::ELEMENTS)),
    };
    let mut reports = Vec::new();
    if args.model != Which::Pce {
        let model = ReducedModel::new(parameterisation);
        reports.push(validate::on_prior(
            &model,
            None,
            &*reference,
            prior,
            sample,
            args.seed,
        ));
    }
    if args.model != Which::Reduced {
        let pce = match fitted_pce(cache, prior, usize::from(args.order)) {
            Ok((pce, _)) => pce,
            Err(error) => return Ok(Err(error)),
        };
        let mut report = pce.validate(&*reference, sample, args.seed);
        report.grid.clone_from(&pce.report().grid);
        reports.push(report);
    }
    for report in &reports {
        if args.json {
            println!("{}", serde_json::to_string(report)?);
        } else {
            print_report(report);
        }
    }
    Ok(Ok(()))
}

/// The paper's chaos from the cache, or fitted behind a progress bar on standard error.
pub(super) fn fitted_pce(cache: &Cache, prior: &RodPrior, order: usize) -> Result<(Pce, Origin), FitError> {
    let bar = ProgressBar::new(0).with_message("finite-element solves");
    if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {human_pos}/{human_len} {eta}") {
        bar.set_style(style);
    }
    let fitted = cache.pce(prior, order, finite_elements::ELEMENTS, &|done, all| {
        bar.set_length(all as u64);
        bar.inc(done as u64);
    });
    bar.finish_and_clear();
    fitted
}

fn print_report(report: &ErrorReport) {
    println!();
    println!(
        "{} against {}: {} draws from the prior, {} outside the trained range (answered by the exact model)",
        report.emulator, report.reference, report.sample, report.outside
    );
    print_modes(&report.modes);
    if let Some(all) = &report.extrapolated {
        println!("all draws, had those outside been extrapolated");
        print_modes(all);
    }
    if let Some(grid) = &report.grid {
        println!("on the fitting points   mean [Hz]   variance [Hz^2]");
        for errors in grid {
            println!(
                "  mode {:>15}  {:>10.1e}  {:>16.2e}",
                errors.order, errors.mean_hz, errors.variance_hz2
            );
        }
    }
}

fn print_modes(modes: &[ModeErrors]) {
    println!(
        "        frequency [Hz]                 relative [-]                   slope d ln f / d ln N [-]"
    );
    println!("mode    rms      99.9 %   max          rms      99.9 %   max          rms      99.9 %   max");
    let cells = |s: &Spread| format!("{:<8.1e} {:<8.1e} {:<8.1e}", s.rms, s.q999, s.max);
    for mode in modes {
        let slope = mode
            .slope
            .as_ref()
            .map_or_else(|| "the force is fixed".to_owned(), cells);
        println!(
            "{:>4}    {}     {}     {slope}",
            mode.order,
            cells(&mode.value_hz),
            cells(&mode.relative)
        );
    }
}
