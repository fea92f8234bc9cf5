//! Local-linear regression adjustment of accepted draws (Beaumont, Zhang and Balding 2002).
//!
//! Near the observation y_0 the parameters are taken as linear in the simulated frequencies,
//! g(theta_i) = alpha + (y_i - y_0)' beta + residual, fitted by least squares with Epanechnikov weights
//! w_i (1 - d_i^2 / epsilon^2); each draw moves to g^-1(g(theta_i) - (y_i - y_0)' beta). g keeps every
//! quantity inside the support of its prior: the logarithm, or the logit between the ends of a uniform.

//!
//! Where model and data disagree, as for the paper's own rod, all draws lie to one side of the observation
//! and the line extrapolates. A little of that is still far better than no adjustment, much of it is
//! not (docs/abc.md): see [`REACH`].

use crate::rod::prior::Prior;
use nalgebra::{DMatrix, SymmetricEigen};
use thiserror::Error;

/// Share of the largest eigenvalue below which a direction of the scaled design counts as absent.
const RANK_TOLERANCE: f64 = 1e-10;

/// Farthest the observation may lie from the mean of the accepted y_i, in standard deviations of the
/// accepted (Mahalanobis). Records drawn from prior and model lie up to 4.7 away, a third mode 1 % too
/// low for the model 4.4, the paper's rod 8.6, where the adjusted force still depends on the tolerance.
pub const REACH: f64 = 5.0;

/// Reason why accepted draws stay unadjusted although an adjustment was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Withheld {
    /// Too few points have weight.
    #[error("{points} draws for {modes} modes are too few to fit a line")]
    TooFew {
        /// Points with weight.
        points: usize,
        /// Modes observed.
        modes: usize,
    },
    /// The observation lies too far from the accepted draws.
    #[error(
        "the frequencies lie {reach:.1} standard deviations from the nearest draws of the prior, more than {REACH} \
         (the force then depends on the tolerance; narrow the prior, or [abc] method = \"sequential\")"
    )]
    OutOfReach {
        /// Mahalanobis distance from the mean of the accepted draws.
        reach: f64,
    },
}

/// Moves `particles` (row-major, points x quantities) and multiplies `weights`, which sum to one before
/// and after, by the kernel. `differences` are y_i - y_0, row-major (points x modes).
///
/// # Errors
/// Changes nothing if fewer points have weight than twice the coefficients sought, or if the observation is
/// out of their [`REACH`].
pub fn linear(
    priors: &[Prior],
    particles: &mut [f64],
    differences: &[f64],
    distances: &[f64],
    epsilon: f64,
    weights: &mut [f64],
) -> Result<(), Withheld> {
    let points = weights.len();
    let modes = differences.len().checked_div(points).unwrap_or(0);
    let kernel: Vec<f64> = weights
        .iter()
        .zip(distances)
        .map(|(&weight, &distance)| weight * epanechnikov(distance, epsilon))
        .collect();
    let weighty = kernel.iter().filter(|&&w| w > 0.0).count();
    if modes == 0 || weighty < 2 * (modes + 1) {
        return Err(Withheld::TooFew {
            points: weighty,
            modes,
        });
    }
    let total: f64 = kernel.iter().sum();
    let kernel: Vec<f64> = kernel.iter().map(|w| w / total).collect();
    let uncertain: Vec<usize> = (0..priors.len()).filter(|&i| !priors[i].is_fixed()).collect();
    let width = priors.len();
    let design = DMatrix::from_row_slice(points, modes, differences);
    let response = DMatrix::from_fn(points, uncertain.len(), |point, slot| {
        let quantity = uncertain[slot];
        priors[quantity].to_line(particles[point * width + quantity])
    });
    let fit = weighted_least_squares(&design, &response, &kernel);
    if fit.reach > REACH {
        return Err(Withheld::OutOfReach { reach: fit.reach });
    }
    weights.copy_from_slice(&kernel);
    let moved = response - design * fit.slopes;
    for (point, theta) in particles.chunks_exact_mut(width).enumerate() {
        for (slot, &quantity) in uncertain.iter().enumerate() {
            theta[quantity] = priors[quantity].from_line(moved[(point, slot)]);
        }
    }
    Ok(())
}

/// Epanechnikov's kernel: 1 - (d / epsilon)^2 inside the tolerance; one for all when every distance is zero.
fn epanechnikov(distance: f64, epsilon: f64) -> f64 {
    if epsilon > 0.0 {
        (1.0 - (distance / epsilon).powi(2)).max(0.0)
    } else {
        1.0
    }
}

struct Fit {
    /// Slopes, modes x quantities.
    slopes: DMatrix<f64>,
    /// Mahalanobis distance of a zero row from the weighted mean of the design.
    reach: f64,
}

/// Weighted least squares of response on design with an intercept. Centring takes the intercept out,
/// scaling to unit variance makes one rank tolerance serve all columns; directions without variance
/// get slope zero (minimum-norm solution).
fn weighted_least_squares(design: &DMatrix<f64>, response: &DMatrix<f64>, weights: &[f64]) -> Fit {
    let (mut x, means) = centred(design, weights);
    let mut offsets = DMatrix::from_fn(x.ncols(), 1, |i, _| means[i]);
    let scales: Vec<f64> = x
        .column_iter()
        .map(|column| Some(column.norm()).filter(|&norm| norm > 0.0).unwrap_or(1.0))
        .collect();
    for (i, scale) in scales.iter().enumerate() {
        x.column_mut(i).unscale_mut(*scale);
        offsets[(i, 0)] /= scale;
    }
    let right = x.tr_mul(&centred(response, weights).0);
    let eigen = SymmetricEigen::new(x.tr_mul(&x));
    let largest = eigen.eigenvalues.max();
    let mut rotated = eigen.eigenvectors.tr_mul(&right);
    let rotated_offsets = eigen.eigenvectors.tr_mul(&offsets);
    let mut squared = 0.0;
    for (i, &eigenvalue) in eigen.eigenvalues.iter().enumerate() {
        let inverse = if eigenvalue > RANK_TOLERANCE * largest {
            1.0 / eigenvalue
        } else {
            0.0
        };
        rotated.row_mut(i).scale_mut(inverse);
        squared += inverse * rotated_offsets[(i, 0)].powi(2);
    }
    let mut slopes = eigen.eigenvectors * rotated;
    for (mut row, scale) in slopes.row_iter_mut().zip(scales) {
        row.unscale_mut(scale);
    }
    Fit {
        slopes,
        reach: squared.sqrt(),
    }
}

/// Columns less their weighted means, rows times the root of their weight; and those means.
fn centred(matrix: &DMatrix<f64>, weights: &[f64]) -> (DMatrix<f64>, Vec<f64>) {
    let mut result = matrix.clone();
    let means = result
        .column_iter_mut()
        .map(|mut column| {
            let mean: f64 = column.iter().zip(weights).map(|(x, w)| w * x).sum();
            for (x, w) in column.iter_mut().zip(weights) {
                *x = (*x - mean) * w.sqrt();
            }
            mean
        })
        .collect();
    (result, means)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::{Parameterisation, Section};
    use crate::rod::prior::RodPrior;

    /// Direct section with an uncertain force and rigidity, everything else fixed.
    fn prior(force: Prior, rigidity: Prior) -> RodPrior {
        let fixed = |value| Prior::Fixed { value };
        let rest = [fixed(1.0), fixed(0.0), fixed(0.0), fixed(1.0)];
        RodPrior::new(
            Parameterisation::new(Section::Direct),
            [force, rigidity].into_iter().chain(rest).collect(),
        )
        .unwrap()
    }

    const LOG_NORMAL: Prior = Prior::LogNormal {
        median: 1.0,
        log_sd: 1.0,
    };

    #[test]
    fn an_exactly_linear_relation_collapses_to_the_observation() {
        // ln theta_0 = 1 + 2 x_0 - x_1: adjusted to x = 0 every particle is e.
        let prior = prior(LOG_NORMAL, LOG_NORMAL);
        let points = 50;
        let (mut particles, mut differences, mut distances) = (vec![], vec![], vec![]);
        for i in 0..points {
            let x = [(i as f64 * 0.7).sin(), (i as f64 * 1.3).cos()];
            differences.extend(x);
            distances.push((x[0] * x[0] + x[1] * x[1]).sqrt());
            particles.extend([(1.0 + 2.0 * x[0] - x[1]).exp(), 3.0, 1.0, 0.0, 0.0, 1.0]);
        }
        let mut weights = vec![1.0 / points as f64; points];
        assert_eq!(
            linear(
                prior.priors(),
                &mut particles,
                &differences,
                &distances,
                2.0,
                &mut weights
            ),
            Ok(())
        );
        for theta in particles.chunks_exact(6) {
            assert!((theta[0] - 1f64.exp()).abs() < 1e-12);
            assert!((theta[1] - 3.0).abs() < 1e-12);
            assert_eq!(theta[2..], [1.0, 0.0, 0.0, 1.0]);
        }
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_repeated_column_is_no_trouble() {
        let prior = prior(LOG_NORMAL, LOG_NORMAL);
        let points = 40;
        let (mut particles, mut differences, mut distances) = (vec![], vec![], vec![]);
        for i in 0..points {
            let x = (i as f64 * 0.7).sin();
            differences.extend([x, 2.0 * x, 0.0]);
            distances.push(x.abs());
            particles.extend([(0.5 * x).exp(), 1.0, 1.0, 0.0, 0.0, 1.0]);
        }
        let mut weights = vec![1.0 / points as f64; points];
        assert_eq!(
            linear(
                prior.priors(),
                &mut particles,
                &differences,
                &distances,
                1.1,
                &mut weights
            ),
            Ok(())
        );
        for theta in particles.chunks_exact(6) {
            assert!((theta[0] - 1.0).abs() < 1e-9, "{}", theta[0]);
        }
    }

    #[test]
    fn a_uniform_quantity_stays_between_its_ends() {
        let uniform = Prior::Uniform { low: 2.0, high: 5.0 };
        let prior = prior(uniform, LOG_NORMAL);
        let points = 40;
        let (mut particles, mut differences, mut distances) = (vec![], vec![], vec![]);
        for i in 0..points {
            // The ends themselves too, as f32 rounding produces them.
            let share = i as f64 / (points - 1) as f64;
            differences.push(share - 0.3);
            distances.push(share);
            particles.extend([2.0 + 3.0 * share, 1.0, 1.0, 0.0, 0.0, 1.0]);
        }
        let mut weights = vec![1.0 / points as f64; points];
        assert_eq!(
            linear(
                prior.priors(),
                &mut particles,
                &differences,
                &distances,
                1.5,
                &mut weights
            ),
            Ok(())
        );
        for theta in particles.chunks_exact(6) {
            assert!((2.0..=5.0).contains(&theta[0]));
        }
    }

    #[test]
    fn an_observation_out_of_reach_is_left_alone() {
        let prior = prior(LOG_NORMAL, LOG_NORMAL);
        let points = 40;
        let near: Vec<f64> = (0..points).map(|i| (i as f64 * 0.7).sin()).collect();
        // Around 0 with sd 0.7, then moved away from the observation by fifteen of those.
        for (away, expected) in [(0.0, true), (10.5, false)] {
            let differences: Vec<f64> = near.iter().map(|x| x + away).collect();
            let distances: Vec<f64> = differences.iter().map(|x| x.abs()).collect();
            let mut particles: Vec<f64> = near
                .iter()
                .flat_map(|x| [(2.0 + x).exp(), 1.0, 1.0, 0.0, 0.0, 1.0])
                .collect();
            let before = particles.clone();
            let mut weights = vec![1.0 / points as f64; points];
            let done = linear(
                prior.priors(),
                &mut particles,
                &differences,
                &distances,
                5.3,
                &mut weights,
            );
            assert_eq!(done.is_ok(), expected, "{done:?}");
            assert_eq!(particles == before, !expected);
            assert_eq!(weights == vec![1.0 / points as f64; points], !expected);
        }
    }

    #[test]
    fn too_few_points_are_left_alone() {
        let prior = prior(LOG_NORMAL, LOG_NORMAL);
        let mut particles = vec![1.0; 3 * 6];
        let mut weights = vec![1.0 / 3.0; 3];
        assert!(
            linear(
                prior.priors(),
                &mut particles,
                &[0.1, 0.2, 0.3],
                &[0.1, 0.2, 0.3],
                0.3,
                &mut weights
            )
            .is_err()
        );
        assert_eq!(weights, [1.0 / 3.0; 3]);
    }
}
