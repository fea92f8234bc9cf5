//! The real record under other assumptions: the error of an ordinary record, and room for a model that is wrong.

use super::estimate::{Comparison, Estimate};
use super::paper::{self, INFERRED};
use super::{Effort, StudyError, table2};
use crate::bayes::mcmc::{self, McmcSettings, Problem};
use crate::bayes::{
    AbcSettings, Distance, Inference, Method, Noise, Observation, RodPrior, Tables, conflict,
};
use crate::emulator::ReducedModel;
use crate::random;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::Arc;

/// Standard error of every frequency \[Hz\] and relative discrepancy of every mode.
const ASSUMPTIONS: [(f64, f64); 6] = [
    (0.031_622_776_601_683_79, 0.0),
    (1.0, 0.0),
    (0.01, 0.0),
    (0.01, 0.01),
    (0.01, 0.02),
    (0.01, 0.03),
];

/// The posterior under one assumption.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Assumed {
    /// Standard error of every frequency \[Hz\].
    pub error_sd_hz: f64,
    /// Relative discrepancy of every mode.
    pub discrepancy: f64,
    /// How far the record lies from every beam, in standard deviations.
    pub conflict: f64,
    /// Posterior means by MCMC, N, E, density, side, SI.
    pub mean: Vec<Estimate>,
    /// Posterior coefficients of variation by MCMC.
    pub cv: Vec<Estimate>,
    /// Posterior mean of N by this program's ABC (regression-adjusted within reach) \[N\].
    pub abc_force_n: Estimate,
    /// Its coefficient of variation.
    pub abc_force_cv: Estimate,
}

impl Assumed {
    /// The assumption in words.
    pub fn name(&self) -> String {
        let error = 1e3 * self.error_sd_hz;
        format!(
            "error {error:.1} mHz, discrepancy {:.0} %",
            100.0 * self.discrepancy
        )
    }

    /// Its figures.
    pub fn comparisons(&self) -> Vec<Comparison> {
        let name = self.name();
        let one = |quantity: &str, statistic, ours| {
            Comparison::new("other assumptions", &name, quantity, statistic, None, ours)
        };
        let mut all = vec![one("all", "conflict", Estimate::sure(self.conflict))];
        for (i, quantity) in INFERRED.iter().enumerate() {
            all.push(one(quantity.key(), "mean, MCMC", self.mean[i]));
            all.push(one(quantity.key(), "cv, MCMC", self.cv[i]));
        }
        all.push(one(INFERRED[0].key(), "mean, ABC", self.abc_force_n));
        all.push(one(INFERRED[0].key(), "cv, ABC", self.abc_force_cv));
        all
    }
}

/// Runs all.
///
/// # Errors
/// A run that cannot be made.
pub fn assumptions(
    prior: &RodPrior,
    effort: &Effort,
    seed: u64,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Assumed>, StudyError> {
    conflict::Conflict::prepare();
    ASSUMPTIONS
        .par_iter()
        .map(|&(error_sd_hz, discrepancy)| {
            let assumed = one(prior, effort, (error_sd_hz, discrepancy), seed);
            done("other assumptions");
            assumed
        })
        .collect()
}

fn one(
    prior: &RodPrior,
    effort: &Effort,
    (error_sd_hz, discrepancy): (f64, f64),
    seed: u64,
) -> Result<Assumed, StudyError> {
    let model = Arc::new(ReducedModel::new(*prior.parameterisation()));
    let observation = Observation::first(&paper::OBSERVED_HZ, error_sd_hz)?;
    let steps = effort.mcmc_steps / table2::CHAINS;
    let settings = McmcSettings {
        chains: table2::CHAINS,
        steps,
        burn_in: steps / 4,
        thin: table2::THIN,
    };
    let problem = Problem {
        prior,
        model: &*model,
        observation: &observation,
        discrepancy: &[discrepancy; 3],
    };
    let abc = AbcSettings {
        draws: effort.many_draws,
        distance: Distance::Euclidean,
        noise: Noise::Record,
        method: Method::Rejection,
        ..AbcSettings::default()
    };
    let (mut chains, mut posteriors, mut score) = (Vec::new(), Vec::new(), f64::NAN);
    for run in 0..effort.mcmc_runs as u64 {
        let seed = random::seed(&[
            b"assumptions",
            &error_sd_hz.to_le_bytes(),
            &discrepancy.to_le_bytes(),
            &run.to_le_bytes(),
            &seed.to_le_bytes(),
        ]);
        let walked = mcmc::run(&problem, &settings, seed)?;
        chains.push(INFERRED.map(|q| {
            walked
                .marginal(q)
                .map_or((f64::NAN, f64::NAN), |m| (m.mean, m.cv))
        }));
        let tables = Tables::new(seed);
        let inference = Inference::plan(
            prior.clone(),
            model.clone(),
            vec![discrepancy; 3],
            abc,
            3,
            &tables,
        )?;
        let posterior = inference.run(&observation, seed)?;
        let force = posterior.marginal(INFERRED[0]);
        posteriors.push(force.map_or((f64::NAN, f64::NAN), |m| (m.mean, m.cv)));
        score = inference.conflict(&observation)?.score;
    }
    let means = |i: usize| Estimate::of(chains.iter().map(|run: &[(f64, f64); 4]| run[i].0));
    let cvs = |i: usize| Estimate::of(chains.iter().map(|run| run[i].1));
    Ok(Assumed {
        error_sd_hz,
        discrepancy,
        conflict: score,
        mean: (0..INFERRED.len()).map(means).collect(),
        cv: (0..INFERRED.len()).map(cvs).collect(),
        abc_force_n: Estimate::of(posteriors.iter().map(|run| run.0)),
        abc_force_cv: Estimate::of(posteriors.iter().map(|run| run.1)),
    })
}
