//! Place of an observation among the records the prior simulates.

use super::distance::Target;
use super::table::{NoiseTable, Table};
use crate::rod::beam::forward::MAX_MODES;
use nalgebra::SMatrix;

/// Number of draws with which the observation is compared.
const DRAWS: usize = 4096;

/// Logarithms of the observed modes' frequencies.
type Row = [f64; MAX_MODES];

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
    let width = target.terms().len();
    let entries = |value: &dyn Fn(usize) -> f32| {
        let mut row = [0.0; MAX_MODES];
        for (i, entry) in row[..width].iter_mut().enumerate() {
            *entry = libm::log(f64::from(value(i)));
        }
        row
    };
    let rows: Vec<Row> = (0..table.draws().min(DRAWS))
        .map(|draw| {
            entries(&|i| {
                let term = &target.terms()[i];
                let frequency = table.frequency(draw, term.mode);
                Target::simulated(term, frequency, noise.at(draw, term.mode, 0))
            })
        })
        // No answer, or an error larger than the frequency.
        .filter(|row| row.iter().all(|value| value.is_finite()))
        .collect();
    let observed = entries(&|i| target.terms()[i].observed);
    let count = rows.len().max(1) as f64;
    let mut mean = [0.0; MAX_MODES];
    for row in &rows {
        for i in 0..width {
            mean[i] += row[i];
        }
    }
    mean.iter_mut().for_each(|sum| *sum /= count);
    let mut covariance = SMatrix::<f64, MAX_MODES, MAX_MODES>::identity();
    covariance.view_mut((0, 0), (width, width)).fill(0.0);
    for row in &rows {
        for i in 0..width {
            for j in 0..=i {
                covariance[(i, j)] += (row[i] - mean[i]) * (row[j] - mean[j]) / count;
            }
        }
    }
    // Its lower triangle is all that is read.
    let Some(root) = covariance.cholesky().map(|cholesky| cholesky.l()) else {
        return Place {
            tail: 1.0,
            distance: 0.0,
        };
    };
    let distance_squared = |row: &Row| -> f64 {
        let mut left = [0.0; MAX_MODES];
        let mut sum = 0.0;
        for i in 0..width {
            left[i] = row[i] - mean[i];
            for j in 0..i {
                left[i] -= root[(i, j)] * left[j];
            }
            left[i] /= root[(i, i)];
            sum += left[i] * left[i];
        }
        sum
    };
    let limit = distance_squared(&observed);
    let further = rows.iter().filter(|row| distance_squared(row) >= limit).count();
    let mut widest = [0.0_f64; MAX_MODES];
    for row in &rows {
        for i in 0..width {
            widest[i] = widest[i].max((row[i] - mean[i]).abs());
        }
    }
    let distance = (0..width)
        .map(|i| (observed[i] - mean[i]).abs() / widest[i])
        .fold(f64::INFINITY, f64::min);
    Place {
        tail: (further + 1) as f64 / (rows.len() + 1) as f64,
        distance,
    }
}
