//! The axial force that an assignment implies: rough, to compare candidates by.

use super::evidence::{Fit, Scene};
use super::rod::FORCE;

/// Number of slices of fixed force, and their reach in standard deviations of Laplace's approximation.
const SLICES: i32 = 6;
const REACH: f64 = 3.5;
/// Quantiles returned.
const SHARES: [f64; 3] = [0.025, 0.5, 0.975];

/// The 2.5 %, 50 % and 97.5 % points of the force \[N\] given the assignment: slices of fixed force, Laplace's
/// integral over all else in each (force against fixity is a curved ridge, a normal at its top is too narrow).
pub(super) fn axial_force_n(scene: &Scene<'_>, fit: &Fit) -> Option<[f64; 3]> {
    let sd = fit.covariance[(FORCE, FORCE)].max(0.0).sqrt();
    let centre = fit.q[FORCE];
    let step = REACH * sd / f64::from(SLICES);
    let mut slices = vec![(0.0, f64::NEG_INFINITY); 2 * SLICES as usize + 1];
    let mut guesses = fit.guesses;
    let (log, ridge) = scene.log_slice(fit, FORCE, &fit.q, centre, &mut guesses)?;
    slices[SLICES as usize] = (centre, log);
    for direction in [1, -1] {
        let (mut from, mut guesses) = (ridge, guesses);
        for i in 1..=SLICES {
            // Along the ridge: all other coordinates move with the force according to the covariance.
            let moved = f64::from(direction) * step;
            for (other, coordinate) in from.iter_mut().enumerate() {
                if other != FORCE && sd > 0.0 {
                    *coordinate += moved * fit.covariance[(other, FORCE)] / (sd * sd);
                }
            }
            let value = centre + f64::from(i) * moved;
            let (log, at) = scene.log_slice(fit, FORCE, &from, value, &mut guesses)?;
            slices[(SLICES + direction * i) as usize] = (value, log);
            from = at;
        }
    }
    let top = slices
        .iter()
        .map(|slice| slice.1)
        .fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = slices.iter().map(|slice| libm::exp(slice.1 - top)).collect();
    let mut below = vec![0.0];
    for pair in weights.windows(2) {
        below.push(below[below.len() - 1] + 0.5 * (pair[0] + pair[1]));
    }
    let total = below[below.len() - 1];
    Some(SHARES.map(|share| {
        let i = below
            .partition_point(|&sum| sum < share * total)
            .clamp(1, below.len() - 1);
        let x = (share * total - below[i - 1]) / (below[i] - below[i - 1]).max(f64::MIN_POSITIVE);
        let q = slices[i - 1].0 + x * (slices[i].0 - slices[i - 1].0);
        libm::exp(scene.rod.force.at(q).0)
    }))
}
