//! Posterior predictive checks: would a rod drawn from the posterior have given the observed frequencies?

use super::StudyError;
use super::estimate::{Comparison, Estimate};
use super::paper::OBSERVED_HZ;
use super::table2::Column;
use crate::numerics::{diagnostics, random};
use crate::rod::beam::Exact;
use crate::rod::beam::forward::ForwardModel;
use crate::rod::prior::RodPrior;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Range of the histogram of f3 / f1.
pub const RATIO: (f64, f64) = (2.7, 3.7);
/// Number of bins of the histogram.
pub const BINS: usize = 100;

/// Predictions of a posterior against the observation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Name of the column.
    pub column: String,
    /// Standard deviation of the measurement error \[Hz\].
    pub error_sd_hz: f64,
    /// Smallest f3 / f1 of the model itself over all runs.
    pub smallest_ratio: f64,
    /// 2.5 %, 50 % and 97.5 % quantiles of the predicted f3 / f1, error included.
    pub ratio: [Estimate; 3],
    /// Share of predictions with an f3 / f1 as small as the observed one.
    pub ratio_tail: Estimate,
    /// Root mean square over the posterior of the residuals of modes 1 to 3 \[Hz\].
    pub residual_hz: [Estimate; 3],
    /// Posterior predictive p-value of sum ((y - y_M) / sd)^2 (Gelman, Meng and Stern 1996).
    pub p_value: Estimate,
    /// Histogram of the predicted f3 / f1, of integral one.
    #[serde(skip)]
    pub histogram: Vec<f64>,
}

impl Check {
    /// Figures of the check.
    pub fn comparisons(&self, part: &str) -> Vec<Comparison> {
        let figures = [
            ("smallest f3/f1 of the model", Estimate::sure(self.smallest_ratio)),
            ("f3/f1, 2.5 % quantile", self.ratio[0]),
            ("f3/f1, median", self.ratio[1]),
            ("f3/f1, 97.5 % quantile", self.ratio[2]),
            ("share with f3/f1 as small as observed", self.ratio_tail),
            ("predictive p-value", self.p_value),
            ("residual of mode 1 [Hz]", self.residual_hz[0]),
            ("residual of mode 2 [Hz]", self.residual_hz[1]),
            ("residual of mode 3 [Hz]", self.residual_hz[2]),
        ];
        figures
            .map(|(name, ours)| Comparison::new(part, &self.column, "all", name, None, ours))
            .to_vec()
    }
}

/// Predictions of one run.
struct Predicted {
    smallest_ratio: f64,
    ratios: Vec<f64>,
    residual_hz: [f64; 3],
    p_value: f64,
}

/// Checks the posterior of a column, run by run.
///
/// # Errors
/// A draw is no rod.
pub fn check(column: &Column, prior: &RodPrior, error_sd_hz: f64, seed: u64) -> Result<Check, StudyError> {
    let name = column.which.name();
    let runs = column.runs.iter().enumerate().map(|(run, posterior)| {
        let seed = random::seed(&[name.as_bytes(), &seed.to_le_bytes()]);
        predict(&posterior.sample, prior, error_sd_hz, seed, run as u64)
    });
    let runs: Vec<Predicted> = runs.collect::<Result<_, _>>()?;
    let over = |of: &dyn Fn(&Predicted) -> f64| Estimate::of(runs.iter().map(of));
    let quantile = |at: f64| {
        over(&|run| {
            let weights = vec![1.0 / run.ratios.len() as f64; run.ratios.len()];
            diagnostics::quantiles(&run.ratios, &weights, &[at])[0]
        })
    };
    let observed = OBSERVED_HZ[2] / OBSERVED_HZ[0];
    let below = |run: &Predicted| run.ratios.iter().filter(|ratio| **ratio <= observed).count();
    let width = (RATIO.1 - RATIO.0) / BINS as f64;
    let count: usize = runs.iter().map(|run| run.ratios.len()).sum();
    let mut histogram = vec![0.0; BINS];
    for ratio in runs.iter().flat_map(|run| &run.ratios) {
        let place = (ratio - RATIO.0) / width;
        if place >= 0.0 && place < BINS as f64 {
            histogram[place as usize] += 1.0 / (count as f64 * width);
        }
    }
    Ok(Check {
        column: name,
        error_sd_hz,
        smallest_ratio: runs
            .iter()
            .fold(f64::INFINITY, |least, run| least.min(run.smallest_ratio)),
        ratio: [0.025, 0.5, 0.975].map(quantile),
        ratio_tail: over(&|run| below(run) as f64 / run.ratios.len() as f64),
        residual_hz: [0, 1, 2].map(|mode| over(&|run| run.residual_hz[mode])),
        p_value: over(&|run| run.p_value),
        histogram,
    })
}

/// Predictions from the parameter vectors `rows`.
fn predict(
    rows: &[f64],
    prior: &RodPrior,
    error_sd_hz: f64,
    seed: u64,
    run: u64,
) -> Result<Predicted, StudyError> {
    let exact = Exact::new(*prior.parameterisation());
    let mut generator = random::stream(seed, run);
    let chi_square = ChiSquared::new(3.0).ok();
    let mut ratios = Vec::new();
    let mut smallest_ratio = f64::INFINITY;
    let (mut squares, mut p_value) = ([0.0; 3], 0.0);
    for theta in rows.chunks_exact(prior.priors().len()) {
        let mut y = [0.0; 3];
        exact.frequencies(theta, &mut y)?;
        smallest_ratio = smallest_ratio.min(y[2] / y[0]);
        let mut distance = 0.0;
        for (i, square) in squares.iter_mut().enumerate() {
            let residual = OBSERVED_HZ[i] - y[i];
            *square += residual * residual;
            distance += (residual / error_sd_hz).powi(2);
        }
        // A replication's own statistic is chi-square with three degrees of freedom whatever the rod.
        p_value += chi_square.map_or(f64::NAN, |chi| chi.sf(distance));
        let [first, third] = [y[0], y[2]].map(|y| {
            let z: f64 = StandardNormal.sample(&mut generator);
            y + error_sd_hz * z
        });
        ratios.push(third / first);
    }
    let count = ratios.len() as f64;
    Ok(Predicted {
        smallest_ratio,
        ratios,
        residual_hz: squares.map(|square| (square / count).sqrt()),
        p_value: p_value / count,
    })
}
