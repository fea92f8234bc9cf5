//! Place of an observation among the records the prior simulates.

use super::distance::Target;
use super::table::{NoiseTable, PLACED, Table};
use crate::numerics::random::BLOCK;
use crate::rod::beam::forward::MAX_MODES;
use nalgebra::SMatrix;

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
    let columns = simulated(target, table, noise);
    let draws = columns.first().map_or(0, Vec::len);
    let count = draws.max(1) as f64;
    let observed = target
        .terms()
        .iter()
        .map(|term| libm::log(f64::from(term.observed)));
    let (mut mean, mut off) = ([0.0; MAX_MODES], [0.0; MAX_MODES]);
    for (i, (column, observed)) in columns.iter().zip(observed).enumerate() {
        mean[i] = column.iter().sum::<f64>() / count;
        off[i] = observed - mean[i];
    }
    let centred: Vec<Vec<f64>> = columns
        .iter()
        .zip(mean)
        .map(|(column, mean)| column.iter().map(|value| value - mean).collect())
        .collect();
    let mut covariance = SMatrix::<f64, MAX_MODES, MAX_MODES>::identity();
    for i in 0..width {
        for j in 0..=i {
            let products = centred[i].iter().zip(&centred[j]).map(|(a, b)| a * b);
            // The same bits, without a division for each.
            covariance[(i, j)] = match draws.is_power_of_two() {
                true => products.map(|product| product * (1.0 / count)).sum(),
                false => products.map(|product| product / count).sum(),
            };
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
    let limit = distances_squared(&off.map(|off| vec![off])[..width], &root)[0];
    let further = distances_squared(&centred, &root)
        .iter()
        .filter(|&&squared| squared >= limit)
        .count();
    let (mut distance, mut is_outside) = (f64::INFINITY, true);
    for (column, off) in centred.iter().zip(off) {
        let mut outward: Vec<f64> = column.iter().map(|value| value.copysign(off * value)).collect();
        // The covariance has a root: there are draws.
        let at = 99 * (outward.len() - 1) / 100;
        let (_, &mut nearly, beyond) = outward.select_nth_unstable_by(at, f64::total_cmp);
        let farthest = beyond.iter().copied().fold(nearly, f64::max);
        distance = distance.min(off.abs() / farthest);
        is_outside &= off.abs() > farthest + BEYOND * (farthest - nearly);
    }
    Place {
        tail: (further + 1) as f64 / (draws + 1) as f64,
        distance,
        is_outside,
    }
}

/// Logarithms of the simulated frequencies, one column per observed mode, of the draws that have an answer in all of them.
fn simulated(target: &Target, table: &Table, noise: &NoiseTable) -> Vec<Vec<f64>> {
    let draws = table.draws().min(PLACED);
    let mut columns: Vec<Vec<f64>> = target
        .terms()
        .iter()
        .map(|term| {
            let blocks = (0..draws.div_ceil(BLOCK)).flat_map(|block| {
                let frequencies = table.block(block, term.mode);
                frequencies.iter().zip(noise.block(block, term.mode, 0))
            });
            let logarithms = table.logarithms(term.mode);
            // The error is that of the observed frequency: as a share of a much lower one it would be no error of this record.
            let one = |((&frequency, &z), logarithm): ((&f32, &f32), &f64)| {
                let error = Target::simulated(term, frequency, z) - frequency;
                logarithm + f64::from(error / frequency.max(term.observed))
            };
            blocks.zip(logarithms).map(one).collect()
        })
        .collect();
    let is_answered = |draw: usize| columns.iter().all(|column| column[draw].is_finite());
    let answered: Vec<bool> = (0..draws).map(is_answered).collect();
    if answered.contains(&false) {
        for column in &mut columns {
            let mut answered = answered.iter();
            column.retain(|_| answered.next().is_some_and(|&answered| answered));
        }
    }
    columns
}

/// Squared Mahalanobis distances of draws from their mean, given column by column, by the Cholesky factor of their covariance.
fn distances_squared(centred: &[Vec<f64>], root: &SMatrix<f64, MAX_MODES, MAX_MODES>) -> Vec<f64> {
    let mut sums = vec![0.0; centred.first().map_or(0, Vec::len)];
    let mut whitened: Vec<Vec<f64>> = Vec::with_capacity(centred.len());
    for (i, column) in centred.iter().enumerate() {
        let mut left = column.clone();
        for (j, other) in whitened.iter().enumerate() {
            let factor = root[(i, j)];
            left.iter_mut()
                .zip(other)
                .for_each(|(left, other)| *left -= factor * other);
        }
        let divisor = root[(i, i)];
        for (left, sum) in left.iter_mut().zip(&mut sums) {
            *left /= divisor;
            *sum += *left * *left;
        }
        whitened.push(left);
    }
    sums
}
