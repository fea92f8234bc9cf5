//! Place of an observation among the records the prior simulates.

use super::distance::Target;
use super::table::{NoiseTable, PLACED, Table};
use crate::rod::beam::forward::MAX_MODES;
use nalgebra::SMatrix;

/// Logarithms of the observed modes' frequencies.
type Row = [f64; MAX_MODES];

/// Place of an observation among the prior's records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Share of the draws whose Mahalanobis distance from their mean is at least the observation's, which counts as one of them.
    pub(super) tail: f64,
    /// Distance of its frequencies, each by itself, from their means as a multiple of the farthest draw's on the same side; of the
    /// least distant of them. A pattern no beam has does not count here: the conflict judges that.
    pub(super) distance: f64,
    /// True if each frequency lies beyond the farthest draw by more than [`BEYOND`] times what this lies beyond the 99 % point.
    pub(super) is_outside: bool,
}

/// Room beyond the farthest of 4096 draws, as a multiple of its distance from their 99 % point. A normal tail so reaches to 5.8 standard deviations
/// (farthest 3.5, 99 % point 2.3); one with an end ends there, because both points lie at the end.
const BEYOND: f64 = 2.0;

/// The observation among the table's first [`PLACED`] draws, error and discrepancy included, all by the logarithms of the
/// frequencies: a prior of the force over decades has no other scale. In the middle if the draws have no
/// spread.
pub(super) fn prior_place(target: &Target, table: &Table, noise: &NoiseTable) -> Place {
    let width = target.terms().len();
    let entries = |value: &dyn Fn(usize) -> f64| {
        let mut row = [0.0; MAX_MODES];
        for (i, entry) in row[..width].iter_mut().enumerate() {
            *entry = value(i);
        }
        row
    };
    let rows: Vec<Row> = (0..table.draws().min(PLACED))
        .map(|draw| {
            entries(&|i| {
                let term = &target.terms()[i];
                let frequency = table.frequency(draw, term.mode);
                let error = Target::simulated(term, frequency, noise.at(draw, term.mode, 0)) - frequency;
                // The error is that of the observed frequency: as a share of a much lower one it would be no error of this record.
                table.logarithms(term.mode)[draw] + f64::from(error / frequency.max(term.observed))
            })
        })
        // No answer.
        .filter(|row| row.iter().all(|value| value.is_finite()))
        .collect();
    let observed = entries(&|i| libm::log(f64::from(target.terms()[i].observed)));
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
            is_outside: false,
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
    let (mut distance, mut is_outside) = (f64::INFINITY, true);
    for i in 0..width {
        let off = observed[i] - mean[i];
        let mut outward: Vec<f64> = rows
            .iter()
            .map(|row| (row[i] - mean[i]).copysign(off * (row[i] - mean[i])))
            .collect();
        // The covariance has a root: there are draws.
        let at = 99 * (outward.len() - 1) / 100;
        let (_, &mut nearly, beyond) = outward.select_nth_unstable_by(at, f64::total_cmp);
        let farthest = beyond.iter().copied().fold(nearly, f64::max);
        distance = distance.min(off.abs() / farthest);
        is_outside &= off.abs() > farthest + BEYOND * (farthest - nearly);
    }
    Place {
        tail: (further + 1) as f64 / (rows.len() + 1) as f64,
        distance,
        is_outside,
    }
}
