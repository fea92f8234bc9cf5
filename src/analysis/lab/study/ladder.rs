//! Samplers compared on a record that the model can produce: each against the exact posterior, which comes
//! from importance sampling of the prior.

use super::estimate::Estimate;
use super::{Effort, StudyError, paper, table2};
use crate::inference::{AbcSettings, Accept, Inference, Method, Observation, Tables};
use crate::lab::likelihood::Likelihood;
use crate::lab::mcmc::{self, McmcSettings, Problem};
use crate::numerics::diagnostics;
use crate::numerics::random::{self, BLOCK};
use crate::rod::beam::forward::ForwardModel;
use crate::rod::beam::{Exact, Quantity};
use crate::rod::emulator::ReducedModel;
use crate::rod::prior::RodPrior;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;
use std::sync::Arc;

/// Draws of the importance sample, as a multiple of the many draws of ABC.
const IMPORTANCE: usize = 20;

/// One sampler of the comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rung {
    /// Name of the sampler.
    pub sampler: &'static str,
    /// Posterior mean of N \[N\].
    pub mean_n: Estimate,
    /// Posterior standard deviation of N \[N\].
    pub sd_n: Estimate,
    /// Distance of the mean from the exact posterior's, in its standard deviations.
    pub off: f64,
    /// Standard deviation over the exact posterior's.
    pub sd_ratio: f64,
}

/// Frequencies with errors of the printed size from the rod at the prior means \[Hz\].
fn record(prior: &RodPrior, seed: u64) -> Result<Observation, StudyError> {
    let mut y = [0.0; 3];
    Exact::new(*prior.parameterisation()).frequencies(&prior.centre(), &mut y)?;
    let mut generator = random::stream(random::seed(&[b"ladder", &seed.to_le_bytes()]), 0);
    for y in &mut y {
        let z: f64 = StandardNormal.sample(&mut generator);
        *y += paper::error_sd_hz() * z;
    }
    Ok(Observation::first(&y, paper::error_sd_hz())?)
}

/// Mean and standard deviation of N.
type Moments = (f64, f64);

/// Runs all samplers, the exact posterior last.
///
/// # Errors
/// A run that cannot be made.
pub fn ladder(
    prior: &RodPrior,
    effort: &Effort,
    seed: u64,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Rung>, StudyError> {
    let observation = record(prior, seed)?;
    let model: Arc<dyn ForwardModel> = Arc::new(ReducedModel::new(*prior.parameterisation()));
    let few = table2::settings(effort.abc_draws, 0.01);
    let many = AbcSettings {
        draws: effort.many_draws,
        ..few
    };
    let adjusted = AbcSettings {
        draws: effort.many_draws,
        ..AbcSettings::default()
    };
    let sequential = AbcSettings {
        method: Method::Sequential,
        accept: Accept::Epsilon(0.5 * paper::error_sd_hz()),
        ..adjusted
    };
    let abc = |settings: AbcSettings| {
        let (observation, model) = (&observation, &model);
        move |seed: u64| -> Result<Moments, StudyError> {
            let tables = Tables::new(seed);
            let plan = Inference::plan(prior.clone(), model.clone(), vec![0.0; 3], settings, 3, &tables)?;
            let posterior = plan.run(observation, seed)?;
            let force = posterior.marginal(Quantity::AxialForce);
            Ok(force.map_or((f64::NAN, f64::NAN), |m| (m.mean, m.sd)))
        }
    };
    let chains = |seed: u64| -> Result<Moments, StudyError> {
        let steps = effort.mcmc_steps / table2::CHAINS;
        let problem = Problem {
            prior,
            model: &*model,
            observation: &observation,
            discrepancy: &[0.0; 3],
        };
        let settings = McmcSettings {
            chains: table2::CHAINS,
            steps,
            burn_in: steps / 4,
            thin: table2::THIN,
        };
        let force = mcmc::run(&problem, &settings, seed)?.marginal(Quantity::AxialForce);
        Ok(force.map_or((f64::NAN, f64::NAN), |m| (m.mean, m.sd)))
    };
    let importance = |seed: u64| -> Result<Moments, StudyError> {
        Ok(weighted(
            prior,
            &*model,
            &observation,
            IMPORTANCE * effort.many_draws,
            seed,
        ))
    };
    type Sampler<'a> = Box<dyn Fn(u64) -> Result<Moments, StudyError> + Sync + 'a>;
    let samplers: [(&'static str, Sampler); 6] = [
        ("rejection, the paper's draws", Box::new(abc(few))),
        ("rejection, many draws", Box::new(abc(many))),
        (
            "regression-adjusted (this program's default)",
            Box::new(abc(adjusted)),
        ),
        ("sequential ABC, adjusted", Box::new(abc(sequential))),
        ("MCMC", Box::new(chains)),
        ("exact (importance sampling)", Box::new(importance)),
    ];
    let mut moments: Vec<(&'static str, Estimate, Estimate)> = Vec::new();
    for (name, sampler) in &samplers {
        let runs: Vec<Moments> = (0..effort.mcmc_runs as u64)
            .into_par_iter()
            .map(|run| {
                sampler(random::seed(&[
                    name.as_bytes(),
                    &run.to_le_bytes(),
                    &seed.to_le_bytes(),
                ]))
            })
            .collect::<Result<_, _>>()?;
        done("ladder of samplers");
        let of = |pick: fn(&Moments) -> f64| Estimate::of(runs.iter().map(pick));
        moments.push((name, of(|m| m.0), of(|m| m.1)));
    }
    let exact = moments.last().map(|(_, mean, sd)| (mean.value, sd.value));
    let (mean, sd) = exact.unwrap_or((f64::NAN, f64::NAN));
    Ok(moments
        .into_iter()
        .map(|(sampler, mean_n, sd_n)| Rung {
            sampler,
            mean_n,
            sd_n,
            off: (mean_n.value - mean) / sd,
            sd_ratio: sd_n.value / sd,
        })
        .collect())
}

/// Moments of N under the prior weighted by the likelihood.
fn weighted(
    prior: &RodPrior,
    model: &dyn ForwardModel,
    observation: &Observation,
    draws: usize,
    seed: u64,
) -> Moments {
    let width = prior.priors().len();
    let Ok(likelihood) = Likelihood::new(observation, &[0.0; 3]) else {
        return (f64::NAN, f64::NAN);
    };
    let blocks: Vec<Vec<(f64, f64)>> = (0..draws.div_ceil(BLOCK))
        .into_par_iter()
        .map(|block| {
            let mut generator = random::stream(seed, block as u64);
            let mut thetas = vec![0.0; BLOCK * width];
            for theta in thetas.chunks_exact_mut(width) {
                prior.sample(&mut generator, theta);
            }
            let mut y = vec![0.0; BLOCK * 3];
            model.frequencies_of_many(&thetas, 3, &mut y);
            let weigh = |(theta, y): (&[f64], &[f64])| (theta[0], libm::exp(likelihood.log_density(y)));
            let all = thetas.chunks_exact(width).zip(y.chunks_exact(3)).map(weigh);
            all.filter(|(_, weight)| *weight > 0.0).collect()
        })
        .collect();
    let total: f64 = blocks.iter().flatten().map(|(_, weight)| weight).sum();
    let (forces, weights): (Vec<f64>, Vec<f64>) = blocks
        .into_iter()
        .flatten()
        .map(|(n, weight)| (n, weight / total))
        .unzip();
    (
        diagnostics::mean(&forces, &weights),
        diagnostics::sd(&forces, &weights),
    )
}
