//! The mean shift of the modes since an onset, and its covariance.

use super::response::Alternatives;
use crate::rod::beam::forward::MAX_MODES;
use crate::track::baseline::Baseline;
use crate::track::observation::LogMode;
use nalgebra::{DMatrix, DVector};

/// Degrees of freedom with which the baseline's overdispersion counts beside the scatter since the onset.
const PRIOR_FREEDOM: f64 = 10.0;

/// One record since the onset.
#[derive(Debug, Clone, Copy)]
pub struct Shifted<'a> {
    /// Its modes.
    pub modes: &'a [LogMode],
    /// ln(N / N_0) that its temperature explains; zero where none is known.
    pub expected: f64,
}

/// The mean shift z of ln f since an onset, less the part explained by temperature.
#[derive(Debug, Clone, PartialEq)]
pub struct MeanShift {
    /// Mode orders, from 1, ascending.
    pub orders: Vec<usize>,
    /// z.
    pub shift: DVector<f64>,
    /// The part of its covariance that falls as 1 / records.
    pub falling: DMatrix<f64>,
    /// The constant part: errors of the baseline and of the part explained by temperature.
    pub fixed: DMatrix<f64>,
    /// Number of records averaged.
    pub records: usize,
}

impl Alternatives {
    /// The mean over records since an onset, each mode weighted by its stated errors. `expected_sd`: standard error of the mean
    /// of `expected`, the force's own autocorrelated fluctuation included; it moves all modes as a change of force does. The part
    /// explained by temperature is a share of the force that the same responses made of the modes: their errors (the spread of the
    /// particles and the model's own) make a pattern of it, and no force. The stated errors grow by the scatter of the records about
    /// their means and about a common change of force, shared by all modes. A mode that the baseline or more than half of the records
    /// do not have is left out. `None` if that leaves none.
    pub fn mean_shift(
        &self,
        baseline: &Baseline,
        records: &[Shifted],
        expected_sd: f64,
    ) -> Option<MeanShift> {
        let z = |record: &Shifted, order: usize, level: f64| {
            let mode = record.modes.iter().find(|mode| mode.order == order)?;
            let z = mode.log_frequency - level - self.of_force(record.expected)[order - 1];
            (z.is_finite() && mode.log_sd > 0.0).then_some((z, mode.log_sd.powi(-2)))
        };
        let mut orders = Vec::new();
        let (mut means, mut weights, mut levels, mut errors) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for mode in baseline.modes.iter().filter(|mode| mode.order <= self.modes) {
            let known = || {
                records
                    .iter()
                    .filter_map(|record| z(record, mode.order, mode.log_frequency))
            };
            if 2 * known().count() < records.len().max(1) {
                continue;
            }
            let weight: f64 = known().map(|(_, w)| w).sum();
            orders.push(mode.order);
            means.push(known().map(|(z, w)| w * z).sum::<f64>() / weight);
            weights.push(weight);
            levels.push(mode.log_frequency);
            errors.push(mode.log_sd);
        }
        if orders.is_empty() {
            return None;
        }
        const STEP: f64 = 0.01;
        let (up, down) = (self.of_force(STEP), self.of_force(-STEP));
        let slopes: [f64; MAX_MODES] = std::array::from_fn(|n| (up[n] - down[n]) / (2.0 * STEP));
        let (mut square, mut freedom) = (0.0, 0.0);
        for record in records {
            // Residuals of the record, less its own change of force.
            let rows: Vec<(f64, f64, f64)> = (0..orders.len())
                .filter_map(|slot| {
                    let (z, weight) = z(record, orders[slot], levels[slot])?;
                    Some((z - means[slot], weight, slopes[orders[slot] - 1]))
                })
                .collect();
            let information: f64 = rows.iter().map(|(_, w, s)| w * s * s).sum();
            let own = if information > 0.0 {
                rows.iter().map(|(e, w, s)| e * w * s).sum::<f64>() / information
            } else {
                0.0
            };
            square += rows
                .iter()
                .map(|(e, w, s)| w * (e - s * own).powi(2))
                .sum::<f64>();
            freedom += rows.len().saturating_sub(1) as f64;
        }
        freedom *= 1.0 - (records.len() as f64).recip();
        let stated = PRIOR_FREEDOM * baseline.overdispersion.powi(2);
        let dispersion = ((stated + square) / (PRIOR_FREEDOM + freedom)).max(1.0);
        let count = orders.len();
        let diagonal = |entries: &dyn Fn(usize) -> f64| {
            DMatrix::from_fn(count, count, |a, b| if a == b { entries(a) } else { 0.0 })
        };
        let common = DMatrix::from_fn(count, count, |a, b| {
            slopes[orders[a] - 1] * slopes[orders[b] - 1] * expected_sd * expected_sd
        });
        let expected = records.iter().map(|record| record.expected).sum::<f64>() / records.len() as f64;
        let answer = self.error_of_force(expected);
        let answer = DMatrix::from_fn(count, count, |a, b| answer[(orders[a] - 1, orders[b] - 1)]);
        // A pattern is what the least squares for the force leave.
        let slope = DVector::from_fn(count, |n, _| slopes[orders[n] - 1]);
        let weighted = DVector::from_fn(count, |n, _| weights[n] * slope[n]);
        let information = weighted.dot(&slope).max(f64::MIN_POSITIVE);
        let pattern = DMatrix::identity(count, count) - slope * weighted.transpose() / information;
        let answer = &pattern * answer * pattern.transpose();
        Some(MeanShift {
            falling: diagonal(&|n| dispersion / weights[n]),
            fixed: diagonal(&|n| errors[n] * errors[n]) + common + answer,
            shift: DVector::from_vec(means),
            orders,
            records: records.len(),
        })
    }
}
