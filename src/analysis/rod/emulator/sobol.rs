//! Sobol's sensitivity indices: from the coefficients of a chaos, and by Saltelli's Monte Carlo estimate on any
//! function to check them.
//!
//! The first-order index of a variable is the share of the variance that it explains alone, its total index
//! the share that is gone when it is known last (Saltelli et al. 2008).

use crate::numerics::random;
use rand::rngs::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

/// The indices of one output.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Indices {
    /// Variance of the output.
    pub variance: f64,
    /// First-order index per variable.
    pub first: Vec<f64>,
    /// Total index per variable.
    pub total: Vec<f64>,
}

/// Indices from the terms of an expansion in orthonormal functions: multi-index and coefficient (Sudret 2008).
pub fn of_terms<'a>(variables: usize, terms: impl Iterator<Item = (&'a [usize], f64)>) -> Indices {
    let mut indices = Indices {
        variance: 0.0,
        first: vec![0.0; variables],
        total: vec![0.0; variables],
    };
    for (degrees, coefficient) in terms {
        let share = coefficient * coefficient;
        let mut involved = (0..variables).filter(|&i| degrees[i] > 0);
        let Some(one) = involved.next() else { continue };
        indices.variance += share;
        if involved.next().is_none() {
            indices.first[one] += share;
        }
        for (total, _) in indices.total.iter_mut().zip(degrees).filter(|(_, d)| **d > 0) {
            *total += share;
        }
    }
    let variance = indices.variance;
    for index in indices.first.iter_mut().chain(&mut indices.total) {
        *index /= variance;
    }
    indices
}

/// Function of a Monte Carlo estimate, with its variables and outputs.
pub struct Problem<'a> {
    /// Number of variables.
    pub variables: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Draws all variables.
    pub sample: &'a (dyn Fn(&mut ChaCha8Rng, &mut [f64]) + Sync),
    /// Evaluates the function: variables in, outputs out.
    pub evaluate: &'a (dyn Fn(&[f64], &mut [f64]) + Sync),
}

/// Indices of every output from `points` pairs of draws, in `points (variables + 2)` evaluations: first order by
/// Saltelli et al. (2010), total by Jansen (1999).
pub fn saltelli(problem: &Problem, points: usize, seed: u64) -> Vec<Indices> {
    let (variables, outputs) = (problem.variables, problem.outputs);
    let blocks: Vec<Sums> = (0..points.div_ceil(random::BLOCK))
        .into_par_iter()
        .map(|block| {
            let mut generator = random::stream(seed, block as u64);
            let mut sums = Sums::new(variables, outputs);
            for _ in 0..random::BLOCK.min(points - block * random::BLOCK) {
                sums.add(problem, &mut generator);
            }
            sums
        })
        .collect();
    let mut all = Sums::new(variables, outputs);
    blocks.iter().for_each(|block| all.append(block));
    let n = points as f64;
    (0..outputs)
        .map(|output| {
            // Both matrices are samples of the output.
            let mean = all.sum[output] / (2.0 * n);
            let variance = all.squares[output] / (2.0 * n) - mean * mean;
            let of = |sums: &[f64], i: usize| sums[output * variables + i] / n / variance;
            Indices {
                variance,
                first: (0..variables).map(|i| of(&all.first, i)).collect(),
                total: (0..variables).map(|i| 0.5 * of(&all.total, i)).collect(),
            }
        })
        .collect()
}

struct Sums {
    sum: Vec<f64>,
    squares: Vec<f64>,
    /// One entry per output and variable, outputs x variables.
    first: Vec<f64>,
    total: Vec<f64>,
}

impl Sums {
    fn new(variables: usize, outputs: usize) -> Self {
        Self {
            sum: vec![0.0; outputs],
            squares: vec![0.0; outputs],
            first: vec![0.0; outputs * variables],
            total: vec![0.0; outputs * variables],
        }
    }

    fn add(&mut self, problem: &Problem, generator: &mut ChaCha8Rng) {
        let (variables, outputs) = (problem.variables, problem.outputs);
        let draw = |generator: &mut ChaCha8Rng| {
            let mut point = vec![0.0; variables];
            (problem.sample)(generator, &mut point);
            point
        };
        let at = |point: &[f64]| {
            let mut out = vec![0.0; outputs];
            (problem.evaluate)(point, &mut out);
            out
        };
        let (mut a, b) = (draw(generator), draw(generator));
        let (fa, fb) = (at(&a), at(&b));
        for output in 0..outputs {
            self.sum[output] += fa[output] + fb[output];
            self.squares[output] += fa[output] * fa[output] + fb[output] * fb[output];
        }
        for i in 0..variables {
            // A with one variable of B.
            let own = std::mem::replace(&mut a[i], b[i]);
            let mixed = at(&a);
            a[i] = own;
            for output in 0..outputs {
                let moved = mixed[output] - fa[output];
                self.first[output * variables + i] += fb[output] * moved;
                self.total[output * variables + i] += moved * moved;
            }
        }
    }

    fn append(&mut self, other: &Self) {
        let join = |to: &mut [f64], from: &[f64]| to.iter_mut().zip(from).for_each(|(to, x)| *to += x);
        join(&mut self.sum, &other.sum);
        join(&mut self.squares, &other.squares);
        join(&mut self.first, &other.first);
        join(&mut self.total, &other.total);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::orthogonal::{Recurrence, total_degree};
    use rand::RngExt;
    use std::f64::consts::PI;

    /// Ishigami and Homma (1990) with a = 7, b = 0.1 on -pi to pi.
    fn ishigami(x: &[f64]) -> f64 {
        x[0].sin() + 7.0 * x[1].sin().powi(2) + 0.1 * x[2].powi(4) * x[0].sin()
    }

    /// Variance, first-order and total indices in closed form.
    fn closed_form() -> (f64, [f64; 3], [f64; 3]) {
        let (a, b) = (7.0f64, 0.1f64);
        let one = 0.5 * (1.0 + b * PI.powi(4) / 5.0).powi(2);
        let two = a * a / 8.0;
        let both = b * b * PI.powi(8) * (1.0 / 18.0 - 1.0 / 50.0);
        let v = one + two + both;
        (v, [one / v, two / v, 0.0], [(one + both) / v, two / v, both / v])
    }

    #[test]
    fn a_chaos_has_ishigamis_indices() {
        // Legendre chaos of order 14 by projection on 20 Gauss points an axis.
        let order = 14;
        let legendre = Recurrence::legendre(20);
        let rule = legendre.gauss(20);
        let values: Vec<Vec<f64>> = rule.nodes.iter().map(|&x| legendre.at(x, order)).collect();
        let indices = total_degree(3, order);
        let mut coefficients = vec![0.0; indices.len()];
        for i in 0..8000 {
            let at = [i / 400, i / 20 % 20, i % 20];
            let f = ishigami(&at.map(|k| PI * rule.nodes[k]));
            let weight: f64 = at.iter().map(|&k| rule.weights[k]).product();
            for (c, index) in coefficients.iter_mut().zip(&indices) {
                let basis: f64 = (0..3).map(|j| values[at[j]][index[j]]).product();
                *c += weight * f * basis;
            }
        }
        let terms = indices.iter().map(Vec::as_slice).zip(coefficients);
        let found = of_terms(3, terms);
        let (variance, first, total) = closed_form();
        assert!((found.variance / variance - 1.0).abs() < 1e-4, "{found:?}");
        for i in 0..3 {
            assert!((found.first[i] - first[i]).abs() < 1e-4, "{found:?} {first:?}");
            assert!((found.total[i] - total[i]).abs() < 1e-4, "{found:?} {total:?}");
        }
    }

    #[test]
    fn monte_carlo_has_ishigamis_indices() {
        let problem = Problem {
            variables: 3,
            outputs: 2,
            sample: &|generator, x| x.fill_with(|| PI * (2.0 * generator.random::<f64>() - 1.0)),
            evaluate: &|x, out| {
                out[0] = ishigami(x);
                out[1] = x[2] - 100.0;
            },
        };
        let found = saltelli(&problem, 200_000, 3);
        let (variance, first, total) = closed_form();
        assert!((found[0].variance / variance - 1.0).abs() < 0.01);
        for i in 0..3 {
            assert!(
                (found[0].first[i] - first[i]).abs() < 0.015,
                "{found:?} {first:?}"
            );
            assert!(
                (found[0].total[i] - total[i]).abs() < 0.015,
                "{found:?} {total:?}"
            );
        }
        // The second output depends on one variable alone.
        assert!((found[1].total[2] - 1.0).abs() < 0.01 && found[1].total[0] == 0.0);
    }
}
