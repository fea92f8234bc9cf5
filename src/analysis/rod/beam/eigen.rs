//! The lowest eigenvalues of a banded pencil `K v = mu M v`, none missed: inverse iteration, counted.
//!
//! Factorising `K - sigma M = L D L'` within the band answers two questions at once: the number of
//! negative entries of D is the number of eigenvalues below sigma (Sylvester's law of inertia), and one
//! solve with it turns a vector towards the eigenvectors nearest sigma. Shifts follow the Rayleigh quotient
//! (cubic convergence) while it stays inside the bracket that the counts have established for the mode
//! sought, and halve that bracket when it does not. The last shift lies just above the eigenvalue, so that
//! its count certifies the order.

use super::assembly::{Assembly, BANDWIDTH, Band};

/// Shifts lie this share above the Rayleigh quotient, so that the converged one counts its eigenvalue.
const ABOVE: f64 = 1e-8;
/// A shift is close enough when it lies within this share of the new Rayleigh quotient. The vector was
/// then good to better than its root, and the solve has improved it once more by this factor.
const CLOSE: f64 = 1e-6;
/// Most Rayleigh steps before bisection by counts alone.
const PATIENCE: usize = 24;

/// An eigenvalue and its sensitivity to tension.
#[derive(Debug, Clone, Copy, Default)]
pub struct Eigenvalue {
    /// The eigenvalue mu.
    pub mu: f64,
    /// Tension's share of the strain energy, which is `d ln mu / d ln N`.
    pub tension_share: f64,
}

/// Fills `out` with the lowest eigenvalues, ascending.
pub fn lowest(assembly: &Assembly, out: &mut [Eigenvalue]) {
    let size = assembly.size;
    let count = out.len();
    let mut low = vec![0.0f64; count];
    let mut high = vec![f64::INFINITY; count];
    let mut factor = vec![[0.0; BANDWIDTH + 1]; size + BANDWIDTH];
    let mut vector = vec![0.0; size + BANDWIDTH];
    let mut load = vec![0.0; size + BANDWIDTH];

    for mode in 0..count {
        let guess = mode
            .checked_sub(1)
            .map_or(0.0, |before| assembly.following(out[before].mu));
        let mut shift = if guess > low[mode] && guess < high[mode] {
            guess
        } else {
            low[mode]
        };
        assembly.sine(mode + 1, &mut vector);
        for step in 0.. {
            let below = factorise(assembly, shift, &mut factor);
            for (j, (low, high)) in low.iter_mut().zip(&mut high).enumerate() {
                if j < below {
                    *high = high.min(shift);
                } else {
                    *low = low.max(shift);
                }
            }
            multiply(&assembly.mass, &vector, &mut load, size);
            solve(&factor, &mut load, size);
            std::mem::swap(&mut vector, &mut load);
            let (tension, strain) = assembly.strain_energies(&vector);
            let mass = quadratic(&assembly.mass, &vector, size);
            let mu = strain / mass;
            let scale = 1.0 / mass.sqrt();
            vector[..size].iter_mut().for_each(|x| *x *= scale);

            let converged = (mu - shift).abs() <= CLOSE * mu && mu > low[mode] && mu <= high[mode];
            let exhausted = step >= PATIENCE && high[mode] - low[mode] <= 1e-13 * high[mode];
            if converged && below == mode + 1 || exhausted {
                out[mode] = Eigenvalue {
                    mu,
                    tension_share: tension / strain,
                };
                if exhausted {
                    out[mode].mu = 0.5 * (low[mode] + high[mode]);
                }
                break;
            }
            let above = mu * (1.0 + ABOVE);
            shift = if above > low[mode] && above < high[mode] && step < PATIENCE {
                above
            } else {
                // The vector has turned to another mode: start afresh, nearer.
                assembly.sine(mode + 1, &mut vector);
                if high[mode].is_finite() {
                    0.5 * (low[mode] + high[mode])
                } else {
                    2.0 * low[mode].max(mu)
                }
            };
        }
    }
}

/// `K - shift M = L D L'`; returns the number of negative entries of D. Column j of `factor` becomes
/// `1 / d` and the entries of L below it.
fn factorise(assembly: &Assembly, shift: f64, factor: &mut Band) -> usize {
    for ((f, k), m) in factor.iter_mut().zip(&assembly.stiffness).zip(&assembly.mass) {
        for d in 0..=BANDWIDTH {
            f[d] = k[d] - shift * m[d];
        }
    }
    let mut negative = 0;
    for window in 0..assembly.size {
        let [column, next @ ..] = &mut factor[window..window + BANDWIDTH + 1] else {
            unreachable!("the factor has BANDWIDTH rows beyond the last")
        };
        // A pivot of zero means the shift is an eigenvalue of a leading block; any tiny one does.
        let pivot = if column[0] == 0.0 { f64::EPSILON } else { column[0] };
        negative += usize::from(pivot < 0.0);
        let inverse = 1.0 / pivot;
        let entries = [column[1], column[2], column[3]];
        let l = entries.map(|a| a * inverse);
        next[0][0] -= entries[0] * l[0];
        next[0][1] -= entries[1] * l[0];
        next[0][2] -= entries[2] * l[0];
        next[1][0] -= entries[1] * l[1];
        next[1][1] -= entries[2] * l[1];
        next[2][0] -= entries[2] * l[2];
        *column = [inverse, l[0], l[1], l[2]];
    }
    negative
}

/// Solves `L D L' x = b` in place; `b` is followed by as many zeros as the bandwidth.
fn solve(factor: &Band, b: &mut [f64], size: usize) {
    for j in 0..size {
        let x = b[j];
        for d in 1..=BANDWIDTH {
            b[j + d] -= factor[j][d] * x;
        }
    }
    // L has no entries below its last row, so the padding was only ever reduced by zeros.
    for j in (0..size).rev() {
        let below = factor[j][1] * b[j + 1] + factor[j][2] * b[j + 2] + factor[j][3] * b[j + 3];
        b[j] = b[j] * factor[j][0] - below;
    }
}

/// `out = A v`; `v` is followed by zeros.
fn multiply(a: &Band, v: &[f64], out: &mut [f64], size: usize) {
    out.fill(0.0);
    for j in 0..size {
        let x = v[j];
        let mut own = a[j][0] * x;
        for d in 1..=BANDWIDTH {
            own += a[j][d] * v[j + d];
            out[j + d] += a[j][d] * x;
        }
        out[j] += own;
    }
}

/// `v' A v`.
fn quadratic(a: &Band, v: &[f64], size: usize) -> f64 {
    (0..size)
        .map(|j| {
            let below = a[j][1] * v[j + 1] + a[j][2] * v[j + 2] + a[j][3] * v[j + 3];
            v[j] * (a[j][0] * v[j] + 2.0 * below)
        })
        .sum()
}
