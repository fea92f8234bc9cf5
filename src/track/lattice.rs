//! The joint state of two one-sided CUSUM charts that are fed the same residual.
//!
//! Let k_1 > k_2 and D = C_2 - C_1. While C_1 stays above zero so does C_2, and D grows by exactly k_1 - k_2 every
//! period; when C_1 falls to o below zero it is set to zero and D becomes max(0, D + k_1 - k_2 - o). The state is thus
//! a line of Gauss-Legendre nodes for C_1 and a lattice of multiples of (k_1 - k_2) / m for D, and the value V of
//! any functional of the run obeys, with D' = D + k_1 - k_2 and b(D') = min(h_1, h_2 - D'),
//!
//! ```text
//! V(c, D) = g + int_0^b(D') V(x, D') p(x - c + k_1) dx
//!             + int_0^min(D', h_2) V(0, y) p(k_1 - c - D' + y) dy + V(0, 0) P(r < k_1 - c - D')
//! ```
//!
//! p the density of the residual r. The first integral takes the nodes of 0 to h_1 with weights that integrate their
//! polynomial up to b (V continues analytically beyond), the second the lattice with the weights of piecewise cubics.

use super::arl::{density, distribution, legendre};
use super::chart::Chart;

/// Width of a level for mean run lengths: the error goes with the fourth power, and is below 1e-4 of the result.
pub(super) const FINE: f64 = 0.1;
/// Width of a level for run-length distributions: errors below 2e-3 of the result.
pub(super) const COARSE: f64 = 0.2;
/// No more levels than about this.
const LEVELS: f64 = 300.0;
/// Reference values nearer than this count as equal.
pub(super) const NEAR: f64 = 0.05;

/// The states of one side of both charts.
pub(super) struct Lattice {
    /// k_1, the larger one.
    k: f64,
    /// Where the kernel of C_1 is wanted: zero, then the nodes.
    at: Vec<f64>,
    /// Levels by which D grows in a period.
    growth: usize,
    /// h_2.
    reach: f64,
    /// Width of a level of D.
    width: f64,
    /// Levels of D from zero to h_2.
    levels: usize,
    /// Weights of the nodes for the integral up to b, level by level.
    up: Vec<Vec<f64>>,
    /// Weights of the levels for the integral up to D' or h_2, by the level of D'.
    down: Vec<Vec<f64>>,
}

/// The probabilities of one period.
pub(super) struct Kernel {
    /// Density of C_1 moving from state `c` to a node.
    up: Vec<Vec<f64>>,
    /// Density of C_1 falling from state `c` to this many levels below zero.
    down: Vec<Vec<f64>>,
    /// Probability of its falling further than that.
    beyond: Vec<Vec<f64>>,
    /// By the level of D', what makes the quadrature of `down` give its exact total: no probability may leak where
    /// an alarm in 1e7 periods counts.
    whole: Vec<Vec<f64>>,
}

impl Lattice {
    /// The states for two charts, with levels about this wide.
    pub(super) fn new(mut charts: [Chart; 2], step: f64) -> Self {
        if charts[0].k < charts[1].k {
            charts.swap(0, 1);
        }
        let [first, second] = charts;
        let gap = first.k - second.k;
        // As one chart, the more impatient in everything: alarms are overstated, never understated.
        let (k, h, reach, width, growth) = if gap < NEAR {
            let h = first.h.min(second.h);
            (second.k, h, h, 1.0, 0)
        } else {
            let growth = (gap / step.max(second.h / LEVELS)).ceil().max(2.0);
            (first.k, first.h, second.h, gap / growth, growth as usize)
        };
        let levels = if growth == 0 {
            1
        } else {
            (reach / width) as usize + 1
        };
        let points = 16 + (2.0 * h).ceil() as usize;
        let rule = legendre(points);
        let at: Vec<f64> = std::iter::once(0.0)
            .chain(rule.nodes.iter().map(|node| 0.5 * h * (node + 1.0)))
            .collect();
        let polynomials: Vec<Vec<f64>> = rule.nodes.iter().map(|&t| polynomials(t, points)).collect();
        let up = (0..levels).map(|level| {
            let bound = h.min(reach - level as f64 * width);
            let end = polynomials_to(2.0 * bound / h - 1.0, points);
            let weight = |(own, weight): (&Vec<f64>, &f64)| {
                let sum: f64 = own.iter().zip(&end).map(|(p, integral)| p * integral).sum();
                0.5 * h * weight * sum
            };
            polynomials.iter().zip(&rule.weights).map(weight).collect()
        });
        let down = (0..levels + growth).map(|level| {
            let mut weights = cubic_weights(level.min(levels - 1));
            if level >= levels {
                add_partial_cell(&mut weights, reach / width - (levels - 1) as f64);
            }
            weights.iter().map(|weight| weight * width).collect()
        });
        Self {
            k,
            growth,
            reach,
            width,
            levels,
            up: up.collect(),
            down: down.collect(),
            at,
        }
    }

    /// The probabilities of a period whose residual is N(`mean`, `sd`^2).
    pub(super) fn kernel(&self, mean: f64, sd: f64) -> Kernel {
        let falls = self.levels + self.growth;
        let score = |residual: f64| (residual - mean) / sd;
        let table = |entries: &dyn Fn(f64) -> Vec<f64>| self.at.iter().map(|&c| entries(c)).collect();
        let fall = |c: f64, levels: f64| score(self.k - c - levels * self.width);
        let down: Vec<Vec<f64>> = table(&|c| (0..falls).map(|o| density(fall(c, o as f64)) / sd).collect());
        let beyond: Vec<Vec<f64>> = table(&|c| (0..falls).map(|o| distribution(fall(c, o as f64))).collect());
        let whole = (0..self.at.len()).map(|c| {
            let total = |grown: usize| {
                let least = (grown as f64 - self.reach / self.width).max(0.0);
                let exact = distribution(fall(self.at[c], least)) - beyond[c][grown];
                let weights = self.down[grown].iter().enumerate();
                let sum: f64 = weights.map(|(y, weight)| weight * down[c][grown - y]).sum();
                if sum > 0.0 { exact / sum } else { 1.0 }
            };
            (0..falls).map(total).collect()
        });
        Kernel {
            up: table(&|c| {
                self.at[1..]
                    .iter()
                    .map(|x| density(score(x - c + self.k)) / sd)
                    .collect()
            }),
            whole: whole.collect(),
            down,
            beyond,
        }
    }

    /// The distribution at the start: both charts at zero.
    pub(super) fn start(&self) -> Vec<f64> {
        let mut state = vec![0.0; self.levels * self.at.len()];
        state[0] = 1.0;
        state
    }

    /// One period on: the part of the distribution (level-major) that raised no alarm.
    pub(super) fn advance(&self, state: &[f64], kernel: &Kernel) -> Vec<f64> {
        let width = self.at.len();
        let mut next = vec![0.0; state.len()];
        let mut landed = vec![0.0; self.at.len()];
        for (level, from) in state.chunks_exact(width).enumerate() {
            let grown = level + self.growth;
            if from.iter().all(|mass| mass.abs() < 1e-18) {
                continue;
            }
            if grown < self.levels {
                landed.fill(0.0);
                for (mass, row) in from.iter().zip(&kernel.up) {
                    add(&mut landed[1..], *mass, row);
                }
                let row = &mut next[grown * width + 1..(grown + 1) * width];
                for ((to, mass), weight) in row.iter_mut().zip(&landed[1..]).zip(&self.up[grown]) {
                    *to += mass * weight;
                }
            }
            for (c, mass) in from.iter().enumerate() {
                next[0] += mass * kernel.beyond[c][grown];
                let whole = mass * kernel.whole[c][grown];
                for (y, weight) in self.down[grown].iter().enumerate() {
                    next[y * width] += whole * weight * kernel.down[c][grown - y];
                }
            }
        }
        next
    }

    /// Mean run length from zero when every residual is N(0, 1).
    pub(super) fn mean_run_length(&self) -> f64 {
        let kernel = self.kernel(0.0, 1.0);
        let (states, levels) = (self.at.len(), self.levels);
        // V(c, level) = constant + linear . V(0, .), from the top level down; the constant is the last entry.
        let mut values: Vec<Vec<Vec<f64>>> = vec![Vec::new(); levels];
        for level in (0..levels).rev() {
            let grown = level + self.growth;
            values[level] = (0..states)
                .map(|c| {
                    let mut value = vec![0.0; levels + 1];
                    value[levels] = 1.0;
                    value[0] += kernel.beyond[c][grown];
                    for (y, weight) in self.down[grown].iter().enumerate() {
                        value[y] += kernel.whole[c][grown] * weight * kernel.down[c][grown - y];
                    }
                    if let Some(above) = values.get(grown) {
                        for ((p, weight), from) in kernel.up[c].iter().zip(&self.up[grown]).zip(&above[1..]) {
                            add(&mut value, p * weight, from);
                        }
                    }
                    value
                })
                .collect();
        }
        let mut system: Vec<Vec<f64>> = values.iter().map(|level| level[0].clone()).collect();
        for (i, row) in system.iter_mut().enumerate() {
            row[..levels].iter_mut().for_each(|entry| *entry = -*entry);
            row[i] += 1.0;
        }
        first_unknown(system)
    }
}

fn add(to: &mut [f64], factor: f64, from: &[f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += factor * from;
    }
}

/// The first unknown of a linear system given as rows of coefficients and right-hand side, eliminated from the last
/// unknown with the largest pivot left.
fn first_unknown(mut rows: Vec<Vec<f64>>) -> f64 {
    let constant = rows.len();
    for last in (1..constant).rev() {
        let largest = (0..=last).max_by(|&a, &b| rows[a][last].abs().total_cmp(&rows[b][last].abs()));
        rows.swap(largest.unwrap_or(last), last);
        let Some(pivot) = rows.pop() else { return f64::NAN };
        for row in &mut rows {
            let factor = -row[last] / pivot[last];
            row[constant] += factor * pivot[constant];
            add(&mut row[..last], factor, &pivot[..last]);
        }
    }
    rows.first().map_or(f64::NAN, |row| row[constant] / row[0])
}

/// (2 n + 1) P_n(t), n = 0..`count`, P_n Legendre's polynomials.
fn polynomials(t: f64, count: usize) -> Vec<f64> {
    let values = legendre_values(t, count);
    values
        .iter()
        .take(count)
        .enumerate()
        .map(|(n, p)| (2 * n + 1) as f64 * p)
        .collect()
}

/// int_-1^t P_n, n = 0..`count`: (P_n+1 - P_n-1) / (2 n + 1).
fn polynomials_to(t: f64, count: usize) -> Vec<f64> {
    let p = legendre_values(t, count);
    let integral = |n: usize| (p[n + 1] - p[n - 1]) / (2 * n + 1) as f64;
    std::iter::once(t + 1.0).chain((1..count).map(integral)).collect()
}

/// P_0 .. P_`degree`.
fn legendre_values(t: f64, degree: usize) -> Vec<f64> {
    let mut p = vec![1.0, t];
    for n in 1..degree {
        let n_f = n as f64;
        p.push(((2.0 * n_f + 1.0) * t * p[n] - n_f * p[n - 1]) / (n_f + 1.0));
    }
    p
}

/// Weights of the points 0 .. `cells` for the integral over them, each cell by the cubic through its four nearest points.
fn cubic_weights(cells: usize) -> Vec<f64> {
    match cells {
        0 => return vec![0.0],
        1 => return vec![0.5, 0.5],
        2 => return vec![1.0 / 3.0, 4.0 / 3.0, 1.0 / 3.0],
        _ => {}
    }
    let mut weights = vec![0.0; cells + 1];
    for cell in 0..cells {
        let first = cell.saturating_sub(1).min(cells - 3);
        let share = match cell - first {
            0 => [9.0, 19.0, -5.0, 1.0],
            1 => [-1.0, 13.0, 13.0, -1.0],
            _ => [1.0, -5.0, 19.0, 9.0],
        };
        add(&mut weights[first..], 1.0 / 24.0, &share);
    }
    weights
}

/// Adds the integral from the last point over `share` of the next cell, by the cubic through the last four points.
fn add_partial_cell(weights: &mut [f64], share: f64) {
    let last = weights.len() - 1;
    let points = weights.len().min(4);
    // Two Gauss points are exact for a cubic.
    for node in [0.5 - 0.5 / 3f64.sqrt(), 0.5 + 0.5 / 3f64.sqrt()] {
        let s = share * node;
        for i in 0..points {
            let others = (0..points).filter(|&j| j != i);
            let basis: f64 = others.map(|j| (s + j as f64) / (j as f64 - i as f64)).product();
            weights[last - i] += 0.5 * share * basis;
        }
    }
}
