//! Fitting the reduced emulator: exact solutions on a tensor Gauss grid, projected axis by axis.

use super::expansion::Expansion;
use super::reduced::{BENDING, LAMBDA, Reduced};
use crate::numerics::orthogonal::Recurrence;
use crate::rod::beam::exact::{Support, wavenumber};
use crate::rod::beam::forward::MAX_MODES;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Terms whose largest contribution to `phi_n / (n pi)` is below this are left out.
const TOLERANCE: f64 = 1e-7;
/// Gauss points in u.
const POINTS_U: usize = 32;
/// Gauss points in s.
const POINTS_S: usize = 28;
/// Functions of u, at most.
pub(super) const INNER: usize = 26;
/// Functions of each s, at most.
pub(super) const DEGREES_S: usize = 22;

impl Reduced {
    /// Fits the expansions: exact solutions on the grid, one projection per axis. The bits are the same on every machine.
    pub fn fit() -> Self {
        Self::with_tolerance(TOLERANCE)
    }

    /// Fits with another truncation.
    fn with_tolerance(tolerance: f64) -> Self {
        let legendre = Recurrence::legendre(POINTS_U.max(POINTS_S));
        let (gauss_u, gauss_s) = (legendre.gauss(POINTS_U), legendre.gauss(POINTS_S));
        // projection[degree][node] = weight p_degree(node).
        let projection = |nodes: &[f64], weights: &[f64], degrees: usize| -> Vec<Vec<f64>> {
            let values: Vec<Vec<f64>> = nodes.iter().map(|&x| legendre.at(x, degrees - 1)).collect();
            (0..degrees)
                .map(|k| values.iter().zip(weights).map(|(v, w)| w * v[k]).collect())
                .collect()
        };
        let project_u = projection(&gauss_u.nodes, &gauss_u.weights, INNER);
        let project_s = projection(&gauss_s.nodes, &gauss_s.weights, DEGREES_S);
        let all: Vec<(usize, usize)> = (0..DEGREES_S)
            .flat_map(|j| (0..=j).map(move |k| (j, k)))
            .collect();

        // Per Gauss point in u, a plane of exact wavenumbers projected on both ends: [pair][mode].
        let planes: Vec<Vec<[f64; MAX_MODES]>> = gauss_u
            .nodes
            .par_iter()
            .map(|&x| {
                let fraction = 0.5 * (1.0 + x);
                plane(
                    LAMBDA * fraction / (1.0 - fraction),
                    &gauss_s.nodes,
                    &project_s,
                    &all,
                )
            })
            .collect();

        let mut rows = vec![vec![Vec::new(); all.len()]; MAX_MODES];
        for (p, &(j, k)) in all.iter().enumerate() {
            for (mode, rows) in rows.iter_mut().enumerate() {
                let coefficients = project_u.iter().map(|row| {
                    row.iter()
                        .zip(&planes)
                        .map(|(w, plane)| w * plane[p][mode])
                        .sum::<f64>()
                });
                let coefficients: Vec<f64> = coefficients.collect();
                // The largest value of p_i p_j p_k, twice where both orders of the ends count.
                let twice = if j == k { 1.0 } else { 2.0 };
                let order = (mode + 1) as f64;
                let matters = |i: usize| {
                    let sup = twice * (((2 * i + 1) * (2 * j + 1) * (2 * k + 1)) as f64).sqrt();
                    coefficients[i].abs() * sup > tolerance * order * PI
                };
                let run = (0..INNER).rev().find(|&i| matters(i)).map_or(0, |last| last + 1);
                rows[p] = coefficients[..run].to_vec();
            }
        }
        let used = |p: &usize| rows.iter().any(|rows| !rows[*p].is_empty());
        let kept: Vec<usize> = (0..all.len()).filter(used).collect();
        let expansions: Vec<Expansion> = rows
            .iter()
            .map(|rows| Expansion::new(kept.iter().map(|&p| rows[p].as_slice())))
            .collect();
        Self::of(kept.iter().map(|&p| all[p]).collect(), expansions)
    }
}

/// Exact wavenumbers over the fixities `nodes` x `nodes` at one lambda, projected on both ends:
/// one entry per pair of degrees.
fn plane(
    lambda: f64,
    nodes: &[f64],
    project: &[Vec<f64>],
    pairs: &[(usize, usize)],
) -> Vec<[f64; MAX_MODES]> {
    let tension = 1.0 / (lambda * lambda);
    // s = k / (k + scale EI / l) at the node.
    let scale = (tension + BENDING).sqrt();
    let support = |x: f64| Support::from_fixity(0.5 * (1.0 + x), 1.0 / scale);
    let count = nodes.len();
    let mut values = vec![[0.0; MAX_MODES]; count * count];
    for (i, &left) in nodes.iter().enumerate() {
        for (j, &right) in nodes[..=i].iter().enumerate() {
            let supports = [support(left), support(right)];
            let phi = std::array::from_fn(|mode| wavenumber(mode + 1, tension, &supports));
            values[i * count + j] = phi;
            values[j * count + i] = phi;
        }
    }
    let add = |sum: &mut [f64; MAX_MODES], w: f64, v: &[f64; MAX_MODES]| {
        sum.iter_mut().zip(v).for_each(|(sum, v)| *sum += w * v);
    };
    let degrees = project.len();
    let mut half = vec![[0.0; MAX_MODES]; count * degrees];
    for i in 0..count {
        for (k, row) in project.iter().enumerate() {
            for (w, v) in row.iter().zip(&values[i * count..]) {
                add(&mut half[i * degrees + k], *w, v);
            }
        }
    }
    let mut out = vec![[0.0; MAX_MODES]; pairs.len()];
    for (out, &(j, k)) in out.iter_mut().zip(pairs) {
        for (i, w) in project[j].iter().enumerate() {
            add(out, *w, &half[i * degrees + k]);
        }
    }
    out
}
