//! How far out an observation lies among the records the prior simulates.

use super::distance::Target;
use super::table::{NoiseTable, Table};
use crate::forward::MAX_MODES;
use nalgebra::{SMatrix, SVector};

/// Draws the observation is compared with.
const DRAWS: usize = 4096;

type Row = SVector<f64, MAX_MODES>;

/// Share of the table's first [`DRAWS`] draws, error and discrepancy included, whose Mahalanobis
/// distance from their mean is at least the observation's, which counts as one of them. One if the
/// draws have no spread to measure by.
pub(super) fn prior_tail(target: &Target, table: &Table, noise: &NoiseTable) -> f64 {
    let entries = |value: &dyn Fn(usize) -> f64| {
        Row::from_fn(|i, _| if i < target.terms().len() { value(i) } else { 0.0 })
    };
    let rows: Vec<Row> = (0..table.draws().min(DRAWS))
        .filter(|&draw| table.frequency(draw, 0).is_finite())
        .map(|draw| {
            entries(&|i| {
                let term = &target.terms()[i];
                let frequency = table.frequency(draw, term.mode);
                f64::from(Target::simulated(term, frequency, noise.at(draw, term.mode, 0)))
            })
        })
        .collect();
    let observed = entries(&|i| f64::from(target.terms()[i].observed));
    let count = rows.len().max(1) as f64;
    let mean = rows.iter().fold(Row::zeros(), |sum, row| sum + row) / count;
    let mut covariance = rows
        .iter()
        .map(|row| (row - mean) * (row - mean).transpose())
        .fold(SMatrix::<f64, MAX_MODES, MAX_MODES>::zeros(), |sum, square| {
            sum + square
        })
        / count;
    for unused in target.terms().len()..MAX_MODES {
        covariance[(unused, unused)] = 1.0;
    }
    let Some(root) = covariance.cholesky().map(|cholesky| cholesky.l()) else {
        return 1.0;
    };
    let distance = |row: &Row| {
        root.solve_lower_triangular(&(row - mean))
            .map_or(f64::INFINITY, |whitened| whitened.norm_squared())
    };
    let limit = distance(&observed);
    let further = rows.iter().filter(|row| distance(row) >= limit).count();
    (further + 1) as f64 / (rows.len() + 1) as f64
}
