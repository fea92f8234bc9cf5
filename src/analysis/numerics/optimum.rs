//! The maximum of a smooth function of four parameters, and its curvature there.

use nalgebra::{Matrix4, Vector4};

/// A maximum with the covariance that its curvature implies (Laplace's approximation).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optimum {
    /// Parameters at the maximum.
    pub at: [f64; 4],
    /// Value at the maximum.
    pub value: f64,
    /// Inverse of the negative matrix of second derivatives.
    pub covariance: Matrix4<f64>,
}

const MAX_ITERATIONS: usize = 30;
/// Convergence: predicted gain of a full step (a fifth of a standard deviation); the step is still taken.
const LEAST_GAIN: f64 = 0.02;

/// The maximum near `start`; `reach` bounds the step of each parameter, and the differences begin with a
/// fiftieth of it.
pub fn maximise(
    objective: impl Fn(&[f64; 4]) -> Option<f64>,
    start: [f64; 4],
    reach: [f64; 4],
) -> Option<Optimum> {
    maximise_from(objective, start, reach, reach.map(|r| 0.02 * r), f64::INFINITY)
}

/// Newton's method with second differences, modified to ascend where the function is not concave.
///
/// The steps of the differences begin with `step` and follow the function's own scale: half the width at which it
/// falls by one half. A maximum counts once they are within a factor of `settled` of that.
pub fn maximise_from(
    objective: impl Fn(&[f64; 4]) -> Option<f64>,
    start: [f64; 4],
    reach: [f64; 4],
    mut step: [f64; 4],
    settled: f64,
) -> Option<Optimum> {
    let mut at = start;
    let mut value = objective(&at)?;
    for iteration in 0..MAX_ITERATIONS {
        let (gradient, hessian) = differences(&objective, &at, value, &step);
        let eigen = (-hessian).symmetric_eigen();
        let largest = eigen.eigenvalues.amax();
        let bowl = eigen.eigenvalues.iter().all(|&l| l > 1e-9 * largest);
        let along = eigen.eigenvectors.transpose() * gradient;
        let newton = Vector4::from_fn(|i, _| {
            along[i]
                / eigen.eigenvalues[i]
                    .abs()
                    .max(1e-6 * largest)
                    .max(f64::MIN_POSITIVE)
        });
        let mut direction = eigen.eigenvectors * newton;
        let gain = 0.5 * along.dot(&newton);
        let scaled = (0..4).all(|i| -hessian[(i, i)] * 4.0 < settled * settled);
        if bowl && (gain < LEAST_GAIN && scaled || iteration + 1 == MAX_ITERATIONS) {
            let inverse = eigen.eigenvectors
                * Matrix4::from_diagonal(&eigen.eigenvalues.map(f64::recip))
                * eigen.eigenvectors.transpose();
            let covariance = Matrix4::from_fn(|i, j| inverse[(i, j)] * step[i] * step[j]);
            let last: [f64; 4] = std::array::from_fn(|i| at[i] + direction[i] * step[i]);
            if let Some(better) = objective(&last).filter(|&v| v > value) {
                (at, value) = (last, better);
            }
            return Some(Optimum {
                at,
                value,
                covariance,
            });
        }
        let excess = (0..4)
            .map(|i| (direction[i] * step[i] / reach[i]).abs())
            .fold(1.0, f64::max);
        direction /= excess;
        let mut moved = false;
        for _ in 0..8 {
            let trial: [f64; 4] = std::array::from_fn(|i| at[i] + direction[i] * step[i]);
            if let Some(better) = objective(&trial).filter(|&v| v > value) {
                at = trial;
                value = better;
                moved = true;
                break;
            }
            direction *= 0.3;
        }
        for i in 0..4 {
            let bend = -hessian[(i, i)];
            let wanted = if bend > 0.0 {
                0.5 * step[i] / bend.sqrt()
            } else {
                2.0 * step[i]
            };
            step[i] = wanted
                .clamp(0.1 * step[i], 4.0 * step[i])
                .clamp(1e-5 * reach[i], 0.2 * reach[i]);
        }
        if !moved && !bowl {
            step = step.map(|s| 0.5 * s);
        }
    }
    None
}

/// Gradient and second derivatives in units of `step`.
fn differences(
    objective: &impl Fn(&[f64; 4]) -> Option<f64>,
    at: &[f64; 4],
    value: f64,
    step: &[f64; 4],
) -> (Vector4<f64>, Matrix4<f64>) {
    let at_offset = |i: usize, a: f64, j: usize, b: f64| {
        let mut x = *at;
        x[i] += a * step[i];
        x[j] += b * step[j];
        objective(&x).unwrap_or(value - 20.0)
    };
    let mut gradient = Vector4::zeros();
    let mut hessian = Matrix4::zeros();
    let mut sides = [(0.0, 0.0); 4];
    for i in 0..4 {
        sides[i] = (at_offset(i, 1.0, i, 0.0), at_offset(i, -1.0, i, 0.0));
        gradient[i] = 0.5 * (sides[i].0 - sides[i].1);
        hessian[(i, i)] = sides[i].0 + sides[i].1 - 2.0 * value;
    }
    for i in 0..4 {
        for j in 0..i {
            let both = at_offset(i, 1.0, j, 1.0) + at_offset(i, -1.0, j, -1.0);
            let alone = sides[i].0 + sides[i].1 + sides[j].0 + sides[j].1;
            let mixed = 0.5 * (both - alone + 2.0 * value);
            hessian[(i, j)] = mixed;
            hessian[(j, i)] = mixed;
        }
    }
    (gradient, hessian)
}

/// The maximum of `objective` between `low` and `high` by golden section, `evaluations` times.
pub fn golden(objective: impl Fn(f64) -> Option<f64>, low: f64, high: f64, evaluations: usize) -> f64 {
    const SHARE: f64 = 0.618_033_988_749_894_9;
    let at = |x: f64| objective(x).unwrap_or(f64::NEG_INFINITY);
    let (mut low, mut high) = (low, high);
    let (mut a, mut b) = (high - SHARE * (high - low), low + SHARE * (high - low));
    let (mut va, mut vb) = (at(a), at(b));
    for _ in 2..evaluations {
        if va >= vb {
            (high, b, vb) = (b, a, va);
            a = high - SHARE * (high - low);
            va = at(a);
        } else {
            (low, a, va) = (a, b, vb);
            b = low + SHARE * (high - low);
            vb = at(b);
        }
    }
    if va >= vb { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadratic_gives_its_own_covariance() {
        let bend = Matrix4::new(
            4.0, 1.0, 0.0, 0.5, 1.0, 3.0, 0.2, 0.0, 0.0, 0.2, 2.0, 0.1, 0.5, 0.0, 0.1, 1.0,
        );
        let centre = Vector4::new(1.0, -2.0, 0.5, 0.1);
        let objective = |x: &[f64; 4]| {
            let d = Vector4::from_row_slice(x) - centre;
            Some(-0.5 * (d.transpose() * bend * d)[0])
        };
        let found = maximise(objective, [0.0; 4], [1.0; 4]).unwrap();
        let inverse = bend.try_inverse().unwrap();
        // Converged to a gain of 1e-3: a few hundredths of a standard deviation.
        for i in 0..4 {
            assert!((found.at[i] - centre[i]).abs() < 0.05);
        }
        // Second differences of a quadratic are exact to rounding.
        assert!((found.covariance - inverse).amax() < 1e-8);
    }

    #[test]
    fn golden_section_finds_a_maximum() {
        let x = golden(|x| Some(-(x - 0.3).powi(2)), -1.0, 1.0, 30);
        assert!((x - 0.3).abs() < 1e-5);
    }
}
