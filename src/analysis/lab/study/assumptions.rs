//! The real record under other assumptions: the error of an ordinary record, room for model error, and the
//! errors that the paper's chains might have been run with.

use super::estimate::{Comparison, DISAGREE, Estimate};
use super::paper::{self, INFERRED, Table2Column};
use super::{Effort, StudyError, table2};
use crate::inference::{AbcSettings, Distance, Inference, Method, Noise, Observation, Tables, conflict};
use crate::lab::mcmc::{self, McmcSettings, Problem};
use crate::numerics::random;
use crate::rod::beam::forward::MAX_MODES;
use crate::rod::emulator::ReducedModel;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::Arc;

/// Assumed prior mean of the density \[kg/m^3\], standard error of every frequency \[Hz\] and relative
/// discrepancy of every mode.
type Assumption = (f64, f64, f64);

/// Other errors and discrepancies under Table 1's prior; then every error that the paper's columns of MCMC
/// might have used, under both of its priors.
const ASSUMPTIONS: [Assumption; 15] = [
    (7500.0, 0.01, 0.0),
    (7500.0, 0.01, 0.01),
    (7500.0, 0.01, 0.02),
    (7500.0, 0.01, 0.03),
    (7500.0, 0.031_622_776_601_683_79, 0.0),
    (7500.0, 0.1, 0.0),
    (7500.0, 0.316_227_766_016_837_94, 0.0),
    (7500.0, 0.5, 0.0),
    (7500.0, 1.0, 0.0),
    (7500.0, 1.5, 0.0),
    (7000.0, 0.1, 0.0),
    (7000.0, 0.316_227_766_016_837_94, 0.0),
    (7000.0, 0.5, 0.0),
    (7000.0, 1.0, 0.0),
    (7000.0, 1.5, 0.0),
];
/// Number of assumptions.
pub const COUNT: usize = ASSUMPTIONS.len();

/// The posterior under one assumption.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Assumed {
    /// Prior mean of the density \[kg/m^3\].
    pub density_kg_m3: f64,
    /// Standard error of every frequency \[Hz\].
    pub error_sd_hz: f64,
    /// Relative discrepancy of every mode.
    pub discrepancy: f64,
    /// Distance of the record from every beam, in standard deviations.
    pub conflict: f64,
    /// Posterior means by MCMC, N, E, density, side, SI.
    pub mean: Vec<Estimate>,
    /// Posterior coefficients of variation by MCMC.
    pub cv: Vec<Estimate>,
    /// Posterior mean of N by this program's ABC (regression-adjusted within reach) \[N\].
    pub abc_force_n: Estimate,
    /// Coefficient of variation of that posterior.
    pub abc_force_cv: Estimate,
}

impl Assumed {
    /// The assumption in words.
    pub fn name(&self) -> String {
        format!(
            "density prior {:.0}, error {:.0} mHz, discrepancy {:.0} %",
            self.density_kg_m3,
            1e3 * self.error_sd_hz,
            100.0 * self.discrepancy
        )
    }

    /// Largest relative difference between its posterior by MCMC and a column of Table 2, and the number of
    /// figures of that column within three standard errors.
    pub fn against(&self, column: &Table2Column) -> (f64, usize) {
        let printed = column.mean.iter().chain(&column.cv);
        let pairs = || self.mean.iter().chain(&self.cv).zip(printed.clone());
        let off = pairs().map(|(ours, printed)| (ours.value / printed.value - 1.0).abs());
        let agree = pairs().filter(|(ours, printed)| ours.deviation(**printed).abs() <= DISAGREE);
        (off.fold(0.0, f64::max), agree.count())
    }

    /// Figures beside the paper's.
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

/// Runs all assumptions.
///
/// # Errors
/// A run that cannot be made.
pub fn assumptions(
    effort: &Effort,
    seed: u64,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Assumed>, StudyError> {
    conflict::Conflict::prepare(MAX_MODES);
    ASSUMPTIONS
        .par_iter()
        .map(|&assumption| {
            let assumed = one(effort, assumption, seed);
            done("other assumptions");
            assumed
        })
        .collect()
}

fn one(
    effort: &Effort,
    (density_kg_m3, error_sd_hz, discrepancy): Assumption,
    seed: u64,
) -> Result<Assumed, StudyError> {
    let prior = &paper::prior(density_kg_m3);
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
            &density_kg_m3.to_le_bytes(),
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
        density_kg_m3,
        error_sd_hz,
        discrepancy,
        conflict: score,
        mean: (0..INFERRED.len()).map(means).collect(),
        cv: (0..INFERRED.len()).map(cvs).collect(),
        abc_force_n: Estimate::of(posteriors.iter().map(|run| run.0)),
        abc_force_cv: Estimate::of(posteriors.iter().map(|run| run.1)),
    })
}
