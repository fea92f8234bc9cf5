//! Place of an observation among the records the prior simulates.

use super::distance::Target;
use super::table::{NoiseTable, Table};
use crate::rod::beam::forward::MAX_MODES;
use nalgebra::{SMatrix, SVector};

/// Number of draws with which the observation is compared.
const DRAWS: usize = 4096;

type Row = SVector<f64, MAX_MODES>;

/// Place of an observation among the prior's records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Share of the draws whose Mahalanobis distance from their mean is at least the observation's, which counts as one of them.
    pub(super) tail: f64,
    /// Distance of its frequencies, each by itself, from their means as a multiple of the farthest draw's; of the least distant of
    /// them. A pattern no beam has does not count here: the conflict judges that.
    pub(super) distance: f64,
}

/// The observation among the table's first [`DRAWS`] draws, error and discrepancy included, all by the logarithms of the
/// frequencies: a prior of the force over decades has no other scale. In the middle if the draws have no
/// spread.
pub(super) fn prior_place(target: &Target, table: &Table, noise: &NoiseTable) -> Place {
    let entries = |value: &dyn Fn(usize) -> f64| {
        Row::from_fn(|i, _| {
            if i < target.terms().len() {
                libm::log(value(i))
            } else {
                0.0
            }
        })
    };
    let rows: Vec<Row> = (0..table.draws().min(DRAWS))
        .map(|draw| {
            entries(&|i| {
                let term = &target.terms()[i];
                let frequency = table.frequency(draw, term.mode);
                f64::from(Target::simulated(term, frequency, noise.at(draw, term.mode, 0)))
            })
        })
        // No answer, or an error larger than the frequency.
        .filter(|row| row.iter().all(|value| value.is_finite()))
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
        return Place {
            tail: 1.0,
            distance: 0.0,
        };
    };
    let whitened = |row: &Row| {
        root.solve_lower_triangular(&(row - mean))
            .unwrap_or_else(|| Row::repeat(f64::INFINITY))
    };
    let limit = whitened(&observed).norm_squared();
    let further = rows
        .iter()
        .filter(|row| whitened(row).norm_squared() >= limit)
        .count();
    let widest = rows
        .iter()
        .fold(Row::zeros(), |widest, row| widest.sup(&(row - mean).abs()));
    let distance = (0..target.terms().len())
        .map(|i| (observed[i] - mean[i]).abs() / widest[i])
        .fold(f64::INFINITY, f64::min);
    Place {
        tail: (further + 1) as f64 / (rows.len() + 1) as f64,
        distance,
    }
}
