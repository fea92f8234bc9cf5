//! The paper's own study, run from the same code as the product, figure by figure beside the paper's.
//!
//! * [`paper`]       the paper's printed figures
//! * [`setting`]     as printed, and as its numbers require
//! * [`table2`]      Table 2: posteriors of the real record by every sampler on every model
//! * [`cases`]       figure 6: divergences and ratios
//! * [`table3`]      Table 3, figures 7 and 8: one to five frequencies of a known rod
//! * [`sensitivity`] Sobol's indices, figure 4
//! * [`predictive`]  posterior predictive checks
//! * [`assumptions`], [`worth`], [`ladder`] beyond the paper: other assumptions, worth of measurements, samplers
//! * [`claims`]      verdicts on statements, by the rules of [`verdict`]; [`reasons`] of disagreements
//! * [`times`]       times of emulators and samplers
//! * [`estimate`]    a figure with its Monte Carlo error
//! * [`density`]     densities and the Kullback-Leibler divergence
//!
//! Everything follows from [`Effort`] and seed: the same bytes at any number of threads.

pub mod assumptions;
pub mod cases;
pub mod claims;
pub mod density;
pub mod estimate;
pub mod ladder;
pub mod paper;
pub mod predictive;
pub mod reasons;
pub mod sensitivity;
pub mod setting;
pub mod table2;
pub mod table3;
pub mod times;
pub mod verdict;
pub mod worth;

use super::ann::{self, Ann};
use super::mcmc::McmcError;
use crate::inference::{InvalidObservation, PlanError};
use crate::rod::beam::forward::ForwardModel;
use crate::rod::beam::{Exact, FiniteElements, OutsideRange, finite_elements};
use crate::rod::emulator::fit::Weighting;
use crate::rod::emulator::validate::{self, ErrorReport};
use crate::rod::emulator::{FitError, OrExact, Pce, ReducedModel, Training};
use crate::rod::prior::RodPrior;
use crate::signal::record::Rejection;
use cases::Case;
use claims::Claim;
use estimate::{Comparison, Estimate};
use serde::Serialize;
use setting::Setting;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use table2::{Column, Sampler};
use table3::Row;
use thiserror::Error;
use times::Time;

/// The paper's order of the chaos.
const ORDER: usize = 5;

/// Numbers of runs, draws and steps of the study.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Effort {
    /// Number of repetitions of every ABC.
    pub abc_runs: usize,
    /// Number of repetitions of every MCMC.
    pub mcmc_runs: usize,
    /// Number of draws of the paper's ABC.
    pub abc_draws: usize,
    /// Number of draws where many are wanted.
    pub many_draws: usize,
    /// Number of steps of one MCMC, all chains together.
    pub mcmc_steps: usize,
    /// Number of rods over which the worth of measurements is averaged.
    pub rods: usize,
    /// Number of passes of the perceptron's training over its design.
    pub epochs: usize,
}

/// The paper's sizes, repeated until the error of one run is known to a tenth (ABC) or a quarter (MCMC).
impl Default for Effort {
    fn default() -> Self {
        Self {
            abc_runs: 40,
            mcmc_runs: 10,
            abc_draws: paper::ABC_DRAWS,
            many_draws: 200_000,
            mcmc_steps: 450_000,
            rods: 20,
            epochs: ann::EPOCHS,
        }
    }
}

impl Effort {
    /// Number of repetitions of a sampler.
    pub fn runs(&self, sampler: Sampler) -> usize {
        match sampler {
            Sampler::Mcmc => self.mcmc_runs,
            Sampler::Abc => self.abc_runs,
            Sampler::AbcOfMany => self.mcmc_runs.div_ceil(2).max(2),
        }
    }

    /// Number of progress reports to expect with `models` models.
    fn reports(&self, models: usize) -> usize {
        let samplers = [Sampler::Mcmc, Sampler::Abc, Sampler::AbcOfMany];
        let columns: usize = samplers.iter().map(|&sampler| models * self.runs(sampler)).sum();
        let (assumptions, rungs) = (assumptions::COUNT, 6);
        let trainings = 2;
        Setting::ALL.len() * (columns + self.abc_runs + trainings) + self.rods + assumptions + rungs
    }
}

/// Reason why the study could not be run.
#[derive(Debug, Error)]
pub enum StudyError {
    /// The chaos cannot be fitted.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The ABC cannot be planned.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The ABC gives no posterior.
    #[error("ABC found no posterior: {0}")]
    Rejection(#[from] Rejection),
    /// There are no chains.
    #[error(transparent)]
    Mcmc(#[from] McmcError),
    /// No thread pool for the timings can be made.
    #[error("times cannot be taken: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// The frequencies are no valid observation.
    #[error(transparent)]
    Observation(#[from] InvalidObservation),
    /// The model has no frequencies for a rod.
    #[error(transparent)]
    Model(#[from] OutsideRange),
    /// A prior does not describe a rod.
    #[error("a prior does not describe a rod")]
    NoRod,
}

/// Results of one setting.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Setting of the part.
    pub setting: Setting,
    /// Columns of Table 2.
    pub columns: Vec<Column>,
    /// Cases of figure 6.
    pub cases: Vec<Case>,
    /// Rows of Table 3.
    pub rows: Vec<Row>,
    /// Posterior predictive checks.
    pub checks: Vec<predictive::Check>,
}

/// Results of the whole study.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Numbers of runs, draws and steps.
    pub effort: Effort,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Results per setting.
    pub parts: Vec<Part>,
    /// Error reports of the emulators under Table 1's prior, the paper's chaos first.
    pub emulators: Vec<ErrorReport>,
    /// Sobol's indices under Table 1's prior.
    pub sensitivity: Vec<sensitivity::Sensitivity>,
    /// Curves of figure 4.
    pub springs: sensitivity::Springs,
    /// The real record under other assumptions.
    pub assumptions: Vec<assumptions::Assumed>,
    /// Worth of further measurements.
    pub worth: Vec<worth::Worth>,
    /// Comparison of samplers.
    pub ladder: Vec<ladder::Rung>,
    /// Verdicts on the paper's statements.
    pub claims: Vec<Claim>,
    /// Times of emulators and samplers; empty unless [`times::measure`] was called.
    pub times: Vec<Time>,
}

/// Number of printed figures of a column or row that agree with ours.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Score {
    /// Table or figure, with its column or row.
    pub name: String,
    /// Per setting: number of figures that agree, and number of all.
    pub agree: Vec<(usize, usize)>,
}

impl Study {
    /// Every number of the study, with the paper's where it prints one.
    pub fn comparisons(&self) -> Vec<Comparison> {
        let mut all = Vec::new();
        for part in &self.parts {
            let setting = part.setting;
            all.extend(part.columns.iter().flat_map(|column| column.comparisons(setting)));
            all.extend(part.cases.iter().flat_map(|case| case.comparisons(setting)));
            all.extend(part.rows.iter().flat_map(|row| table3::comparisons(row, setting)));
            let predictive = format!("predictive, {}", setting.key());
            all.extend(
                part.checks
                    .iter()
                    .flat_map(|check| check.comparisons(&predictive)),
            );
        }
        all.extend(self.emulators.iter().flat_map(errors));
        all.extend(self.sensitivity.iter().flat_map(|s| s.comparisons()));
        all.extend(self.assumptions.iter().flat_map(|a| a.comparisons()));
        for worth in &self.worth {
            let one = |statistic, ours| {
                Comparison::new(
                    "worth of measurements",
                    &worth.measured,
                    "axial_force_n",
                    statistic,
                    None,
                    ours,
                )
            };
            all.push(one("cv", worth.cv));
            all.push(one("cv over that of the first", worth.of_first));
        }
        for rung in &self.ladder {
            let one = |statistic, ours| {
                Comparison::new(
                    "ladder of samplers",
                    rung.sampler,
                    "axial_force_n",
                    statistic,
                    None,
                    ours,
                )
            };
            all.push(one("mean", rung.mean_n));
            all.push(one("sd", rung.sd_n));
        }
        all
    }

    /// Number of printed figures that agree, per column and per row.
    pub fn score(&self) -> Vec<Score> {
        let mut all: Vec<Score> = Vec::new();
        for part in &self.parts {
            let setting = part.setting;
            let columns = part.columns.iter();
            let table_2 = columns.map(|c| (format!("Table 2, {}", c.which.name()), c.comparisons(setting)));
            let cases = part.cases.iter();
            let figure_6 = cases.map(|c| (format!("Figure 6, case {}", c.name), c.comparisons(setting)));
            let rows = part.rows.iter();
            let table_3 = rows.map(|row| {
                let name = format!("Table 3, nf = {}", row.frequencies);
                (name, table3::comparisons(row, setting))
            });
            for (name, comparisons) in table_2.chain(figure_6).chain(table_3) {
                let judged: Vec<bool> = comparisons.iter().filter_map(Comparison::disagrees).collect();
                if judged.is_empty() {
                    continue;
                }
                let agree = judged.iter().filter(|disagrees| !**disagrees).count();
                let counts = (agree, judged.len());
                match all.iter_mut().find(|score| score.name == name) {
                    Some(score) => score.agree.push(counts),
                    None => all.push(Score {
                        name,
                        agree: vec![counts],
                    }),
                }
            }
        }
        all
    }
}

/// Figures of an emulator's error report.
fn errors(report: &ErrorReport) -> Vec<Comparison> {
    let one = |order: usize, statistic, value| {
        let column = format!("{}, mode {order}", report.emulator);
        Comparison::new(
            "emulators",
            &column,
            "frequency_hz",
            statistic,
            None,
            Estimate::sure(value),
        )
    };
    let mut all = Vec::new();
    for mode in &report.modes {
        all.push(one(mode.order, "rms error [Hz]", mode.value_hz.rms));
        all.push(one(mode.order, "99.9 % error [Hz]", mode.value_hz.q999));
        all.push(one(mode.order, "largest error [Hz]", mode.value_hz.max));
        let slope = mode.slope.map_or(f64::NAN, |slope| slope.rms);
        all.push(one(mode.order, "rms error of the slope", slope));
    }
    for grid in report.grid.iter().flatten() {
        all.push(one(grid.order, "variance on the design [Hz2]", grid.variance_hz2));
    }
    all
}

/// Runs the study. `progress` is called with the step, its count so far, and the total.
///
/// # Errors
/// A part that cannot be run: with the paper's rod, none.
pub fn run(
    effort: Effort,
    seed: u64,
    progress: &(dyn Fn(&str, usize, usize) + Sync),
) -> Result<Study, StudyError> {
    let count = AtomicUsize::new(0);
    let all = effort.reports(MODELS);
    let done = |what: &str| progress(what, count.fetch_add(1, Ordering::Relaxed) + 1, all);
    let mut parts = Vec::new();
    let mut all_emulators = Vec::new();
    for setting in Setting::ALL {
        let emulators = Emulators::train(&setting.prior(), &effort, seed, &done)?;
        parts.push(part(setting, &emulators, &effort, seed, &done)?);
        all_emulators.push(emulators);
    }
    // Table 1's prior is that of the first setting.
    let prior = Setting::AsPrinted.prior();
    let emulators = all_emulators.swap_remove(0);
    let mut study = Study {
        effort,
        seed,
        parts,
        emulators: emulators.reports(&prior),
        sensitivity: sensitivity::indices(&prior, &emulators.pce, seed),
        springs: sensitivity::springs(&prior)?,
        assumptions: assumptions::assumptions(&effort, seed, &done)?,
        worth: worth::worth(&prior, &effort, seed, &done)?,
        ladder: ladder::ladder(&prior, &effort, seed, &done)?,
        claims: Vec::new(),
        times: Vec::new(),
    };
    study.claims = claims::judge(&study);
    Ok(study)
}

/// Number of forward models.
const MODELS: usize = 5;

/// The forward models in the order of the columns.
fn models(prior: &RodPrior, emulators: &Emulators) -> [Arc<dyn ForwardModel>; MODELS] {
    let rod = *prior.parameterisation();
    [
        Arc::new(FiniteElements::new(rod, finite_elements::ELEMENTS)),
        Arc::new(OrExact::new(emulators.pce.clone())),
        Arc::new(OrExact::new(emulators.ann.clone())),
        Arc::new(Exact::new(rod)),
        Arc::new(ReducedModel::new(rod)),
    ]
}

/// The paper's two emulators, trained on the same solves.
struct Emulators {
    pce: Pce,
    ann: Ann,
}

impl Emulators {
    fn train(
        prior: &RodPrior,
        effort: &Effort,
        seed: u64,
        done: &(dyn Fn(&str) + Sync),
    ) -> Result<Self, StudyError> {
        let training = Training::solve(prior, ORDER, finite_elements::ELEMENTS, &|_, _| ())?;
        let pce = Pce::from_training(prior, &training, Weighting::Equal);
        done("chaos");
        let ann = Ann::train(prior, &training, effort.epochs, seed);
        done("perceptron");
        Ok(Self { pce, ann })
    }

    /// Error reports over the prior: the two, and the reduced emulator.
    fn reports(&self, prior: &RodPrior) -> Vec<ErrorReport> {
        let rod = *prior.parameterisation();
        let (reduced, exact) = (ReducedModel::new(rod), Exact::new(rod));
        let sample = (validate::SAMPLE, validate::SEED);
        vec![
            self.pce.report().clone(),
            self.ann.report().clone(),
            validate::on_prior(&reduced, None, &exact, prior, sample, &|_| ()),
        ]
    }
}

fn part(
    setting: Setting,
    emulators: &Emulators,
    effort: &Effort,
    seed: u64,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Part, StudyError> {
    let prior = setting.prior();
    let models = models(&prior, emulators);
    let plan = table2::Plan {
        setting,
        prior: &prior,
        models: &models,
        effort,
        seed,
    };
    let columns = table2::columns(&plan, done)?;
    let checks = columns
        .iter()
        .filter(|column| column.which.model == "finite-elements" && column.which.printed().is_some())
        .map(|column| {
            let sd = match column.which.sampler {
                Sampler::Mcmc => setting.likelihood_sd_hz(),
                Sampler::Abc | Sampler::AbcOfMany => paper::error_sd_hz(),
            };
            predictive::check(column, &prior, sd, seed)
        })
        .collect::<Result<_, _>>()?;
    Ok(Part {
        setting,
        cases: cases::cases(&prior, &columns),
        rows: table3::rows(setting, &models[0], effort, seed, done)?,
        columns,
        checks,
    })
}
