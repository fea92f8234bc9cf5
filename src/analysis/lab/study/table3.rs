//! Table 3, figures 7 and 8: posteriors of a rod whose truth is known, with its first one to five frequencies.

use super::density::Grid;
use super::estimate::{Comparison, Estimate};
use super::paper::{self, INFERRED, Printed};
use super::setting::Setting;
use super::{Effort, StudyError, table2};
use crate::inference::{Inference, Observation, Tables};
use crate::numerics::{diagnostics, random};
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::prior::RodPrior;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::Arc;

/// Result for one number of frequencies.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Number of frequencies.
    pub frequencies: usize,
    /// Results per inferred quantity.
    pub quantities: Vec<Cell>,
    /// Mean BMAPE of the quantities.
    pub bmape: Estimate,
}

/// Result for one quantity.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cell {
    /// Posterior mean, SI.
    pub mean: Estimate,
    /// Posterior coefficient of variation.
    pub cv: Estimate,
    /// Bayesian mean absolute percentage error, as a share of the truth.
    pub bmape: Estimate,
    /// Posterior density on the grid of its prior, mean over the runs.
    #[serde(skip)]
    pub density: Vec<f64>,
}

/// One run with one number of frequencies.
struct Run {
    mean: [f64; 4],
    cv: [f64; 4],
    bmape: [f64; 4],
    density: [Vec<f64>; 4],
}

/// The five frequencies of the rod of Table 3 \[Hz\]; with springs, which it does not print, at the prior
/// means.
///
/// # Errors
/// The rod is outside the model's range.
pub fn frequencies(prior: &RodPrior, model: &dyn ForwardModel) -> Result<[f64; MAX_MODES], StudyError> {
    let mut theta = prior.centre();
    theta[..4].copy_from_slice(&paper::TRUTH);
    let mut y = [0.0; MAX_MODES];
    model.frequencies(&theta, &mut y)?;
    Ok(y)
}

/// Runs the table on one model.
///
/// # Errors
/// A run that cannot be made.
pub fn rows(
    setting: Setting,
    model: &Arc<dyn ForwardModel>,
    effort: &Effort,
    seed: u64,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Row>, StudyError> {
    let prior = &paper::prior(paper::TABLE_3_DENSITY);
    let truth = frequencies(prior, &**model)?;
    let runs: Vec<Vec<Run>> = (0..effort.abc_runs)
        .into_par_iter()
        .map(|run| {
            let seed = random::seed(&[
                b"table 3",
                setting.key().as_bytes(),
                &(run as u64).to_le_bytes(),
                &seed.to_le_bytes(),
            ]);
            let inference = Inference::plan(
                prior.clone(),
                model.clone(),
                vec![0.0; MAX_MODES],
                table2::settings(effort.abc_draws, setting.share()),
                MAX_MODES,
                &Tables::new(seed),
            )?;
            let rows = (1..=MAX_MODES).map(|count| one(&inference, &truth[..count], seed));
            let rows = rows.collect::<Result<Vec<_>, StudyError>>();
            done("Table 3");
            rows
        })
        .collect::<Result<_, StudyError>>()?;
    let row = |at: usize| {
        let over = |of: &dyn Fn(&Run) -> f64| Estimate::of(runs.iter().map(|rows| of(&rows[at])));
        let cell = |i: usize| {
            let mut density = vec![0.0; super::density::POINTS];
            for rows in &runs {
                for (sum, one) in density.iter_mut().zip(&rows[at].density[i]) {
                    *sum += one / runs.len() as f64;
                }
            }
            Cell {
                mean: over(&|run| run.mean[i]),
                cv: over(&|run| run.cv[i]),
                bmape: over(&|run| run.bmape[i]),
                density,
            }
        };
        Row {
            frequencies: at + 1,
            quantities: (0..INFERRED.len()).map(cell).collect(),
            bmape: over(&|run| run.bmape.iter().sum::<f64>() / 4.0),
        }
    };
    Ok((0..MAX_MODES).map(row).collect())
}

fn one(inference: &Inference, observed: &[f64], seed: u64) -> Result<Run, StudyError> {
    let observation = Observation::first(observed, paper::error_sd_hz())?;
    let posterior = inference.run(&observation, seed)?;
    let mut run = Run {
        mean: [0.0; 4],
        cv: [0.0; 4],
        bmape: [0.0; 4],
        density: Default::default(),
    };
    for (i, &quantity) in INFERRED.iter().enumerate() {
        let values = posterior.values(quantity).unwrap_or_default();
        let truth = paper::TRUTH[i];
        let errors: Vec<f64> = values.iter().map(|x| (x / truth - 1.0).abs()).collect();
        run.mean[i] = diagnostics::mean(&values, &posterior.weights);
        run.cv[i] = diagnostics::sd(&values, &posterior.weights) / run.mean[i];
        run.bmape[i] = diagnostics::mean(&errors, &posterior.weights);
        let grid = Grid::of(&inference.prior().priors()[i]);
        run.density[i] = grid.density(&values, posterior.ess);
    }
    Ok(run)
}

/// Figures of a row beside the paper's.
pub fn comparisons(row: &Row, setting: Setting) -> Vec<Comparison> {
    let part = format!("Table 3, {}", setting.key());
    let column = format!("nf = {}", row.frequencies);
    let mut all = Vec::new();
    for (i, (cell, quantity)) in row.quantities.iter().zip(&INFERRED).enumerate() {
        let printed = Printed {
            value: paper::TABLE_3[row.frequencies - 1][i],
            digit: paper::TABLE_3_DIGITS[i],
        };
        let one =
            |statistic, paper, ours| Comparison::new(&part, &column, quantity.key(), statistic, paper, ours);
        all.push(one("mean", Some(printed), cell.mean));
        all.push(one("cv", None, cell.cv));
        all.push(one("BMAPE", None, cell.bmape));
    }
    all.push(Comparison::new(&part, &column, "all", "BMAPE", None, row.bmape));
    all
}
