//! Posterior predictive checks: would a rod drawn from the posterior have given the observed frequencies?

use super::StudyError;
use super::estimate::{Comparison, Estimate};
use super::paper::OBSERVED_HZ;
use crate::bayes::{RodPrior, diagnostics};
use crate::beam::Exact;
use crate::forward::ForwardModel;
use crate::random;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Where the histogram of f3 / f1 begins and ends, and its bins.
pub const RATIO: (f64, f64) = (2.7, 3.7);
/// Bins of the histogram.
pub const BINS: usize = 100;

/// What a posterior predicts, held against what was observed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Whose posterior.
    pub column: String,
    /// Standard deviation of the measurement error \[Hz\].
    pub error_sd_hz: f64,
    /// Smallest f3 / f1 of the model itself over the posterior.
    pub smallest_ratio: f64,
    /// 2.5 %, 50 % and 97.5 % quantiles of the predicted f3 / f1, error included.
    pub ratio: [f64; 3],
    /// Share of predictions with an f3 / f1 as small as the observed one.
    pub ratio_tail: f64,
    /// Root mean square over the posterior of the residuals of modes 1 to 3 \[Hz\].
    pub residual_hz: [f64; 3],
    /// Posterior predictive p-value of sum ((y - y_M) / sd)^2 (Gelman, Meng and Stern 1996).
    pub p_value: f64,
    /// Histogram of the predicted f3 / f1, of integral one.
    #[serde(skip)]
    pub histogram: Vec<f64>,
}

impl Check {
    /// Its figures.
    pub fn comparisons(&self, part: &str) -> Vec<Comparison> {
        let figures = [
            ("smallest f3/f1 of the model", self.smallest_ratio),
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
            .map(|(name, value)| {
                Comparison::new(part, &self.column, "all", name, None, Estimate::sure(value))
            })
            .to_vec()
    }
}

/// Checks the posterior that `rows` (row-major parameter vectors) are drawn from.
///
/// # Errors
/// A row is no rod.
pub fn check(
    column: &str,
    prior: &RodPrior,
    rows: &[f64],
    error_sd_hz: f64,
    seed: u64,
) -> Result<Check, StudyError> {
    let exact = Exact::new(*prior.parameterisation());
    let mut generator = random::stream(random::seed(&[column.as_bytes(), &seed.to_le_bytes()]), 0);
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
    let observed = OBSERVED_HZ[2] / OBSERVED_HZ[0];
    let weights = vec![1.0 / count; ratios.len()];
    let quantiles = diagnostics::quantiles(&ratios, &weights, &[0.025, 0.5, 0.975]);
    let width = (RATIO.1 - RATIO.0) / BINS as f64;
    let mut histogram = vec![0.0; BINS];
    for ratio in &ratios {
        let place = (ratio - RATIO.0) / width;
        if place >= 0.0 && place < BINS as f64 {
            histogram[place as usize] += 1.0 / (count * width);
        }
    }
    Ok(Check {
        column: column.to_owned(),
        error_sd_hz,
        smallest_ratio,
        ratio: [quantiles[0], quantiles[1], quantiles[2]],
        ratio_tail: ratios.iter().filter(|ratio| **ratio <= observed).count() as f64 / count,
        residual_hz: squares.map(|square| (square / count).sqrt()),
        p_value: p_value / count,
        histogram,
    })
}
