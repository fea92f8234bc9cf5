//! Table 2: posteriors of the real record by MCMC and ABC, on finite elements, exact solver and emulators,
//! repeated with other random numbers.

use super::density::Grid;
use super::estimate::{Comparison, Estimate};
use super::paper::{self, INFERRED, Table2Column};
use super::setting::Setting;
use super::{Effort, StudyError};
use crate::inference::{
    AbcSettings, Accept, Adjustment, Distance, Inference, Method, Noise, Observation, Tables,
};
use crate::lab::mcmc::{self, McmcSettings, Problem};
use crate::numerics::{diagnostics, random};
use crate::rod::beam::forward::ForwardModel;
use crate::rod::prior::RodPrior;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::Arc;

/// Number of draws of a run kept for posterior predictive checks.
const SAMPLE: usize = 4000;
/// Steps of a chain per draw kept.
pub const THIN: usize = 5;
/// Number of chains of one MCMC.
pub const CHAINS: usize = 16;
/// Chains, points and lags of the figures of traces and autocorrelations.
const TRACES: usize = 4;
const TRACE_POINTS: usize = 400;
const LAGS: usize = 60;

/// Sampler of a posterior.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampler {
    /// Algorithm 1.
    Mcmc,
    /// Algorithms 2 and 3 with the paper's number of draws.
    Abc,
    /// The same with far more draws at the same share accepted.
    AbcOfMany,
}

/// Sampler and model of a column of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Which {
    /// The sampler.
    pub sampler: Sampler,
    /// The forward model's name.
    pub model: &'static str,
}

impl Which {
    /// Name in tables and files.
    pub fn name(&self) -> String {
        let sampler = match self.sampler {
            Sampler::Mcmc => "MCMC",
            Sampler::Abc => "ABC",
            Sampler::AbcOfMany => "ABC, many draws",
        };
        format!("{sampler}, {}", self.model)
    }

    /// Printed column of the paper, if it has this one.
    pub fn printed(&self) -> Option<Table2Column> {
        match (self.sampler, self.model) {
            (Sampler::Mcmc, "finite-elements") => Some(paper::MCMC),
            (Sampler::Abc, "finite-elements") => Some(paper::ABC),
            (Sampler::Mcmc, "pce") => Some(paper::MCMC_PCE),
            (Sampler::Abc, "pce") => Some(paper::ABC_PCE),
            _ => None,
        }
    }
}

/// Result of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Posterior means of the inferred quantities, SI.
    pub mean: [f64; 4],
    /// Their coefficients of variation.
    pub cv: [f64; 4],
    /// Their densities on the grids of their priors.
    pub density: [Vec<f64>; 4],
    /// Convergence figures of the sampler.
    pub quality: Quality,
    /// Up to 4000 parameter vectors, row-major.
    pub sample: Vec<f64>,
    /// Traces; of the first run of MCMC alone.
    pub traces: Option<Traces>,
}

/// Convergence figures of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Quality {
    /// Largest distance accepted \[Hz\].
    Tolerance(f64),
    /// Largest split R-hat and smallest effective sample size of the inferred quantities, share accepted.
    Chains {
        /// Split R-hat.
        r_hat: f64,
        /// Effective sample size.
        ess: f64,
        /// Share of proposals accepted.
        acceptance: f64,
    },
}

impl Quality {
    /// The tolerance; or R-hat, effective sample size and share accepted.
    fn figures(&self) -> [f64; 3] {
        match *self {
            Self::Tolerance(epsilon) => [epsilon, f64::NAN, f64::NAN],
            Self::Chains {
                r_hat,
                ess,
                acceptance,
            } => [r_hat, ess, acceptance],
        }
    }
}

/// Traces and autocorrelations of chains.
#[derive(Debug, Clone, PartialEq)]
pub struct Traces {
    /// Steps between two points of a trace.
    pub every: usize,
    /// The axial force along some chains \[N\].
    pub force: Vec<Vec<f64>>,
    /// Autocorrelations of the inferred quantities, [`THIN`] steps a lag.
    pub autocorrelation: Vec<Vec<f64>>,
}

/// A column of the table: all its runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Sampler and model.
    pub which: Which,
    /// Runs of the column.
    pub runs: Vec<Run>,
}

impl Column {
    /// A statistic over the runs.
    pub fn estimate(&self, of: impl Fn(&Run) -> f64) -> Estimate {
        Estimate::of(self.runs.iter().map(of))
    }

    /// Mean density over the runs of inferred quantity `i`.
    pub fn density(&self, i: usize) -> Vec<f64> {
        let mut sum = vec![0.0; super::density::POINTS];
        for run in &self.runs {
            for (sum, density) in sum.iter_mut().zip(&run.density[i]) {
                *sum += density / self.runs.len() as f64;
            }
        }
        sum
    }

    /// Figures of the column beside the paper's.
    pub fn comparisons(&self, setting: Setting) -> Vec<Comparison> {
        let printed = self.which.printed();
        let part = format!("Table 2, {}", setting.key());
        let column = self.which.name();
        let mut all = Vec::new();
        for (i, quantity) in INFERRED.iter().enumerate() {
            let mean = self.estimate(|run| run.mean[i]);
            let cv = self.estimate(|run| run.cv[i]);
            let one = |statistic, paper, ours| {
                Comparison::new(&part, &column, quantity.key(), statistic, paper, ours)
            };
            all.push(one("mean", printed.map(|p| p.mean[i]), mean));
            all.push(one("cv", printed.map(|p| p.cv[i]), cv));
        }
        let names: &[&'static str] = match self.which.sampler {
            Sampler::Mcmc => &["split R-hat", "effective sample size", "share accepted"],
            Sampler::Abc | Sampler::AbcOfMany => &["tolerance [Hz]"],
        };
        for (i, name) in names.iter().enumerate() {
            let ours = self.estimate(|run| run.quality.figures()[i]);
            all.push(Comparison::new(&part, &column, "all", name, None, ours));
        }
        all
    }
}

/// Input of every run of a setting.
pub struct Plan<'a> {
    /// Setting of the runs.
    pub setting: Setting,
    /// Prior of the rod.
    pub prior: &'a RodPrior,
    /// The forward models.
    pub models: &'a [Arc<dyn ForwardModel>],
    /// Numbers of runs, draws and steps.
    pub effort: &'a Effort,
    /// Seed of all runs.
    pub seed: u64,
}

/// Runs all columns; `done` is called after every run.
///
/// # Errors
/// A run that cannot be made.
pub fn columns(plan: &Plan, done: &(dyn Fn(&str) + Sync)) -> Result<Vec<Column>, StudyError> {
    let mut jobs = Vec::new();
    // The longest first.
    for sampler in [Sampler::Mcmc, Sampler::AbcOfMany, Sampler::Abc] {
        for model in plan.models {
            let name = model.name();
            let which = Which { sampler, model: name };
            let runs = plan.effort.runs(sampler);
            jobs.extend((0..runs).map(|run| (which, model, run)));
        }
    }
    let results: Vec<(Which, Run)> = jobs
        .into_par_iter()
        .with_max_len(1)
        .map(|(which, model, run)| {
            let result = one(plan, which, model, run);
            done(&which.name());
            result.map(|run| (which, run))
        })
        .collect::<Result<_, StudyError>>()?;
    let mut columns: Vec<Column> = Vec::new();
    for (which, run) in results {
        match columns.iter_mut().find(|column| column.which == which) {
            Some(column) => column.runs.push(run),
            None => columns.push(Column {
                which,
                runs: vec![run],
            }),
        }
    }
    Ok(columns)
}

/// Run number `run` of a column.
///
/// # Errors
/// It cannot be made.
pub fn one(plan: &Plan, which: Which, model: &Arc<dyn ForwardModel>, run: usize) -> Result<Run, StudyError> {
    let seed = random::seed(&[
        plan.setting.key().as_bytes(),
        which.name().as_bytes(),
        &(run as u64).to_le_bytes(),
        &plan.seed.to_le_bytes(),
    ]);
    match which.sampler {
        Sampler::Mcmc => chain(plan, &**model, seed, run == 0),
        Sampler::Abc => rejection(plan, model, plan.effort.abc_draws, seed),
        Sampler::AbcOfMany => rejection(plan, model, plan.effort.many_draws, seed),
    }
}

fn chain(plan: &Plan, model: &dyn ForwardModel, seed: u64, first: bool) -> Result<Run, StudyError> {
    let observation = Observation::first(&paper::OBSERVED_HZ, plan.setting.likelihood_sd_hz())?;
    let steps = plan.effort.mcmc_steps / CHAINS;
    let settings = McmcSettings {
        chains: CHAINS,
        steps,
        burn_in: steps / 4,
        thin: THIN,
    };
    let problem = Problem {
        prior: plan.prior,
        model,
        observation: &observation,
        discrepancy: &[0.0; 3],
    };
    let chains = mcmc::run(&problem, &settings, seed)?;
    let ess = INFERRED.map(|q| chains.ess(q).unwrap_or(f64::NAN));
    let (mean, cv, density) = summary(plan.prior, &chains.draws, &ess);
    let traces = first.then(|| {
        let every = (chains.kept / TRACE_POINTS).max(1);
        let force = chains.values(INFERRED[0]).unwrap_or_default();
        Traces {
            every: every * THIN,
            force: force
                .chunks_exact(chains.kept)
                .take(TRACES)
                .map(|chain| chain.iter().step_by(every).copied().collect())
                .collect(),
            autocorrelation: INFERRED
                .iter()
                .filter_map(|&q| chains.autocorrelation(q, LAGS))
                .collect(),
        }
    });
    let r_hat = INFERRED.map(|q| chains.r_hat(q).unwrap_or(f64::NAN));
    Ok(Run {
        mean,
        cv,
        density,
        quality: Quality::Chains {
            r_hat: r_hat.into_iter().fold(0.0, f64::max),
            ess: ess.into_iter().fold(f64::INFINITY, f64::min),
            acceptance: chains.acceptance.iter().sum::<f64>() / chains.acceptance.len() as f64,
        },
        sample: thinned(&chains.draws, plan.prior),
        traces,
    })
}

/// Settings of the paper's rejection ABC.
pub fn settings(draws: usize, share: f64) -> AbcSettings {
    AbcSettings {
        draws,
        accept: Accept::Quantile(share),
        distance: Distance::Euclidean,
        noise: Noise::Fixed(paper::error_sd_hz()),
        method: Method::Rejection,
        adjustment: Adjustment::None,
    }
}

fn rejection(plan: &Plan, model: &Arc<dyn ForwardModel>, draws: usize, seed: u64) -> Result<Run, StudyError> {
    let observation = Observation::first(&paper::OBSERVED_HZ, paper::error_sd_hz())?;
    let inference = Inference::plan(
        plan.prior.clone(),
        model.clone(),
        vec![0.0; 3],
        settings(draws, plan.setting.share()),
        3,
        &Tables::new(seed),
    )?;
    let posterior = inference.run(&observation, seed)?;
    let worth = [posterior.ess; 4];
    let (mean, cv, density) = summary(plan.prior, &posterior.particles, &worth);
    Ok(Run {
        mean,
        cv,
        density,
        quality: Quality::Tolerance(posterior.epsilon),
        sample: thinned(&posterior.particles, plan.prior),
        traces: None,
    })
}

/// Means, coefficients of variation and densities of the inferred quantities.
fn summary(prior: &RodPrior, rows: &[f64], worth: &[f64; 4]) -> ([f64; 4], [f64; 4], [Vec<f64>; 4]) {
    let width = prior.priors().len();
    let column = |i: usize| -> Vec<f64> { rows.iter().skip(i).step_by(width).copied().collect() };
    let (mut mean, mut cv) = ([0.0; 4], [0.0; 4]);
    let density = std::array::from_fn(|i| {
        let values = column(i);
        let weights = vec![1.0 / values.len() as f64; values.len()];
        mean[i] = diagnostics::mean(&values, &weights);
        cv[i] = diagnostics::sd(&values, &weights) / mean[i];
        Grid::of(&prior.priors()[i]).density(&values, worth[i])
    });
    (mean, cv, density)
}

/// At most [`SAMPLE`] rows, evenly spaced.
fn thinned(rows: &[f64], prior: &RodPrior) -> Vec<f64> {
    let width = prior.priors().len();
    let every = (rows.len() / width).div_ceil(SAMPLE).max(1);
    rows.chunks_exact(width)
        .step_by(every)
        .flatten()
        .copied()
        .collect()
}
