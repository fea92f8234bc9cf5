//! Scatter of the particles' shifts about their mean, at any change of force.

use super::shift::{LANES, Polynomials, TERMS, v_of};

/// Covariance over the particles of the modes' shifts. Shifts are polynomials, so that the covariance of their coefficients holds it for
/// every change.
#[derive(Debug, Clone)]
pub(crate) struct Spread {
    modes: usize,
    /// Covariance of the coefficients, mode by mode and power by power.
    covariance: Vec<f64>,
}

/// A shift of one mode: its index and u = ln(N / N_0).
pub(crate) type At = (usize, f64);

impl Spread {
    /// Covariance over the first `count` particles.
    pub fn new(polynomials: &Polynomials, count: usize, means: &[[f64; TERMS]]) -> Self {
        let width = means.len() * TERMS;
        let means = means.as_flattened();
        let mut sums = vec![[0.0; LANES]; width * width];
        for block in 0..count.div_ceil(LANES) {
            let full = LANES.min(count - block * LANES);
            let off: Vec<[f64; LANES]> = polynomials
                .block(block)
                .iter()
                .zip(means)
                .map(|(row, mean)| std::array::from_fn(|l| if l < full { row[l] - mean } else { 0.0 }))
                .collect();
            for (sums, one) in sums.chunks_exact_mut(width).zip(&off) {
                for (sum, other) in sums.iter_mut().zip(&off) {
                    for l in 0..LANES {
                        sum[l] += one[l] * other[l];
                    }
                }
            }
        }
        let count = count.max(1) as f64;
        Self {
            modes: means.len() / TERMS,
            covariance: sums.iter().map(|sum| sum.iter().sum::<f64>() / count).collect(),
        }
    }

    /// Covariance of two shifts.
    pub fn between(&self, (one, u): At, (other, v): At) -> f64 {
        let (rows, columns) = (powers(u), powers(v));
        let width = self.modes * TERMS;
        let row = |power: usize| &self.covariance[(one * TERMS + power) * width + other * TERMS..][..TERMS];
        let along = |power| row(power).iter().zip(&columns).map(|(c, v)| c * v).sum::<f64>();
        rows.iter().enumerate().map(|(power, u)| u * along(power)).sum()
    }

    /// Standard deviation of a weighted sum of shifts.
    pub fn sd_of(&self, terms: &[(f64, At)]) -> f64 {
        let products = terms.iter().flat_map(|(weight, one)| {
            terms
                .iter()
                .map(move |(other_weight, other)| (weight * other_weight, *one, *other))
        });
        let variance: f64 = products
            .map(|(weight, one, other)| weight * self.between(one, other))
            .sum();
        variance.max(0.0).sqrt()
    }
}

/// Powers of v in -1 to 1 for u.
fn powers(u: f64) -> [f64; TERMS] {
    let v = v_of(u);
    let mut power = 1.0;
    std::array::from_fn(|_| {
        let this = power;
        power *= v;
        this
    })
}
