//! Place of an observation among the records the prior simulates.

use super::distance::Target;
use super::table::{NoiseTable, PLACED, Table};
use crate::numerics::extremes::extremes;
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
    let mut columns = simulated(target, table, noise);
    let draws = columns.first().map_or(0, Vec::len);
    let (mean, covariance) = match columns.len() {
        1 => centred::<1>(&mut columns),
        2 => centred::<2>(&mut columns),
        3 => centred::<3>(&mut columns),
        4 => centred::<4>(&mut columns),
        _ => centred::<MAX_MODES>(&mut columns),
    };
    let observed = target
        .terms()
        .iter()
        .map(|term| libm::log(f64::from(term.observed)));
    let off: Vec<f64> = observed
        .zip(mean)
        .map(|(observed, mean)| observed - mean)
        .collect();
    // Its lower triangle is all that is read.
    let Some(root) = covariance.cholesky().map(|cholesky| cholesky.l()) else {
        return Place {
            tail: 1.0,
            distance: 0.0,
            is_outside: false,
        };
    };
    let own: Vec<Vec<f64>> = off.iter().map(|off| vec![*off]).collect();
    let limit = distances_squared(&own, &root)[0];
    let further = distances_squared(&columns, &root)
        .iter()
        .filter(|&&squared| squared >= limit)
        .count();
    let (mut distance, mut is_outside) = (f64::INFINITY, true);
    for (column, off) in columns.iter().zip(off) {
        let side = 1f64.copysign(off);
        let (low, high) = extremes(column);
        let farthest = if side > 0.0 { high } else { -low };
        distance = distance.min(off.abs() / farthest);
        is_outside = is_outside && off.abs() > farthest && {
            let mut outward: Vec<f64> = column.iter().map(|value| side * value).collect();
            // The covariance has a root: there are draws.
            let at = 99 * (outward.len() - 1) / 100;
            let nearly = *outward.select_nth_unstable_by(at, f64::total_cmp).1;
            off.abs() > farthest + BEYOND * (farthest - nearly)
        };
    }
    Place {
        tail: (further + 1) as f64 / (draws + 1) as f64,
        distance,
        is_outside,
    }
}

/// Centres `N` columns about their means; returns these, and the covariances in the lower triangle of a unit matrix. The sums run side by
/// side, each in the order of the draws.
fn centred<const N: usize>(
    columns: &mut [Vec<f64>],
) -> ([f64; MAX_MODES], SMatrix<f64, MAX_MODES, MAX_MODES>) {
    let draws = columns.first().map_or(0, Vec::len);
    let count = draws.max(1) as f64;
    let mut mean = [0.0; MAX_MODES];
    for row in rows::<N>(columns) {
        mean.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
    mean = mean.map(|sum| sum / count);
    for (column, mean) in columns.iter_mut().zip(mean) {
        column.iter_mut().for_each(|value| *value -= mean);
    }
    // The same bits, without a division for each.
    let products = match draws.is_power_of_two() {
        true => products::<N>(columns, |product| product * (1.0 / count)),
        false => products::<N>(columns, |product| product / count),
    };
    let mut covariance = SMatrix::identity();
    for (i, row) in products.iter().enumerate() {
        for (j, product) in row[..=i].iter().enumerate() {
            covariance[(i, j)] = *product;
        }
    }
    (mean, covariance)
}

/// Sums over the draws of a share of the product of every two columns, in the lower triangle.
fn products<const N: usize>(columns: &[Vec<f64>], share: impl Fn(f64) -> f64) -> [[f64; N]; N] {
    let mut sums = [[0.0; N]; N];
    for row in rows::<N>(columns) {
        for (i, sums) in sums.iter_mut().enumerate() {
            for (sum, other) in sums[..=i].iter_mut().zip(row) {
                *sum += share(row[i] * other);
            }
        }
    }
    sums
}

/// Values of one draw after another.
fn rows<const N: usize>(columns: &[Vec<f64>]) -> impl Iterator<Item = [f64; N]> {
    let draws = columns.first().map_or(0, Vec::len);
    let columns: [&[f64]; N] = std::array::from_fn(|i| &columns[i][..draws]);
    (0..draws).map(move |draw| columns.map(|column| column[draw]))
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
