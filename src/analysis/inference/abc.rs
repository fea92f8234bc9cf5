//! Rejection ABC (paper, Algorithms 2 and 3) on the simulated table.

use super::Accept;
use super::distance::{self, Candidate, Target};
use super::table::{NoiseTable, Table};

/// The accepted draws: parameters, simulated frequencies and distances, in the order of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Accepted {
    /// Parameter vectors, row-major (accepted x quantities), SI.
    pub particles: Vec<f64>,
    /// Simulated frequencies, row-major (accepted x observed modes) \[Hz\].
    pub simulated: Vec<f64>,
    /// Distances, one per accepted draw.
    pub distances: Vec<f64>,
    /// The tolerance: given, or the largest accepted distance.
    pub epsilon: f64,
}

/// Number of draws in a share `alpha` of `draws`: the nearest whole number, at least one.
pub fn count_of(alpha: f64, draws: usize) -> usize {
    ((alpha * draws as f64).round() as usize).clamp(1, draws.max(1))
}

/// Algorithm 2: every draw theta_i of the prior has its y_i = y_M(theta_i) + b_i + e_i (Algorithm 3),
/// and theta_i is retained if d(y_i, y_0) <= epsilon, or if it is among the nearest share alpha.
/// `shift` selects the record's noise.
pub fn reject(target: &Target, table: &Table, noise: &NoiseTable, shift: usize, accept: Accept) -> Accepted {
    let found = match accept {
        Accept::Quantile(alpha) => {
            distance::nearest(target, table, noise, shift, count_of(alpha, table.draws()))
        }
        Accept::Epsilon(epsilon) => distance::within(target, table, noise, shift, (epsilon * epsilon) as f32),
    };
    let distances: Vec<f64> = found
        .iter()
        .map(|candidate| f64::from(candidate.distance_squared()).sqrt())
        .collect();
    let epsilon = match accept {
        Accept::Quantile(_) => distances.iter().copied().fold(0.0, f64::max),
        Accept::Epsilon(epsilon) => epsilon,
    };
    Accepted {
        particles: particles(&found, table),
        simulated: simulated(&found, target, table, noise, shift),
        distances,
        epsilon,
    }
}

fn particles(found: &[Candidate], table: &Table) -> Vec<f64> {
    let mut particles = vec![0.0; found.len() * table.width()];
    for (candidate, theta) in found.iter().zip(particles.chunks_exact_mut(table.width())) {
        table.theta(candidate.draw(), theta);
    }
    particles
}

fn simulated(
    found: &[Candidate],
    target: &Target,
    table: &Table,
    noise: &NoiseTable,
    shift: usize,
) -> Vec<f64> {
    let mut simulated = Vec::with_capacity(found.len() * target.terms().len());
    for candidate in found {
        for term in target.terms() {
            let frequency = table.frequency(candidate.draw(), term.mode);
            let z = noise.at(candidate.draw(), term.mode, shift);
            simulated.push(f64::from(Target::simulated(term, frequency, z)));
        }
    }
    simulated
}
