//! Mean and covariance of a four-parameter posterior, beyond the curvature at its maximum.

use crate::numerics::optimum::Optimum;
use nalgebra::{Matrix4, Vector4};
use statrs::distribution::{ContinuousCDF, Normal};
use std::sync::LazyLock;

/// Widths of the proposal's three normal components, in standard deviations of the Gaussian it is
/// built on: the wide ones reach the tails of a skewed posterior.
const WIDTHS: [f64; 3] = [0.8, 1.3, 2.2];
/// Groups of four points in each of two rounds; the second starts from what the first found.
const GROUPS: [usize; 2] = [36, 60];
/// Fewest effective points of a usable result.
const LEAST_EFFECTIVE: f64 = 20.0;

/// The moments of a posterior known up to a constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// Mean.
    pub mean: [f64; 4],
    /// Covariance.
    pub covariance: Matrix4<f64>,
    /// Effective number of points, (sum w)^2 / sum w^2.
    pub effective: f64,
}

/// Moments of `exp(log_posterior)` starting from Laplace's approximation; `None` if the points miss
/// the posterior.
///
/// The points are an additive recurrence (golden ratio of dimension four) in groups of four: each with its
/// mirror image, and both with the first parameter (the frequency) mirrored alone. So the result has no
/// randomness and is exact for a Gaussian's mean; and what skews the other parameters cannot lean on the
/// frequency through a chance correlation of the fixed points (in mirrored pairs alone it did, by 0.18
/// standard deviations in every record).
///
/// `enough` effective points in the first round spare the second.
pub fn moments(
    log_posterior: impl Fn(&[f64; 4]) -> Option<f64>,
    start: &Optimum,
    enough: f64,
) -> Option<Moments> {
    let mut mean = Vector4::from(start.at);
    let mut covariance = start.covariance;
    let mut found = None;
    for groups in GROUPS {
        let round = sample(&log_posterior, &mean, &covariance, start.value, groups)?;
        if round.effective < 0.25 * LEAST_EFFECTIVE {
            return None;
        }
        if round.effective >= enough {
            return Some(round);
        }
        mean = Vector4::from(round.mean);
        // Few points make a poor covariance: never let a round collapse below the curvature.
        covariance = round.covariance + start.covariance * (2.0 / round.effective);
        found = Some(round);
    }
    found.filter(|m| m.effective >= LEAST_EFFECTIVE)
}

/// The points before scaling, with the proposal's log density there: one of each group.
static POINTS: LazyLock<Vec<(Vector4<f64>, f64)>> = LazyLock::new(|| {
    // Root of x^5 = x + 1.
    const GOLDEN: f64 = 1.167_303_978_261_418_7;
    let normal = Normal::standard();
    let point = |i: usize| {
        let z = Vector4::from_fn(|j, _| {
            let u = (0.5 + (i + 1) as f64 * GOLDEN.powi(-(j as i32 + 1))).fract();
            WIDTHS[i % WIDTHS.len()] * normal.inverse_cdf(u.clamp(1e-9, 1.0 - 1e-9))
        });
        let square = z.norm_squared();
        let proposal: f64 = WIDTHS
            .iter()
            .map(|w| (-0.5 * square / (w * w)).exp() / w.powi(4))
            .sum();
        (z, proposal.ln())
    };
    (0..GROUPS[0].max(GROUPS[1])).map(point).collect()
});

fn sample(
    log_posterior: &impl Fn(&[f64; 4]) -> Option<f64>,
    mean: &Vector4<f64>,
    covariance: &Matrix4<f64>,
    reference: f64,
    groups: usize,
) -> Option<Moments> {
    let factor = covariance.cholesky()?.l();
    let mut points = Vec::with_capacity(4 * groups);
    for (z, log_proposal) in &POINTS[..groups] {
        let step = factor * z;
        let other = factor * Vector4::new(-z[0], z[1], z[2], z[3]);
        for x in [mean + step, mean - step, mean + other, mean - other] {
            if let Some(log_target) = log_posterior(&x.into()) {
                points.push((x, log_target - reference - log_proposal));
            }
        }
    }
    let highest = points.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
    if !highest.is_finite() {
        return None;
    }
    let (mut sum, mut squares) = (0.0, 0.0);
    let mut mean = Vector4::zeros();
    for (x, log_weight) in &mut points {
        *log_weight = (*log_weight - highest).exp();
        sum += *log_weight;
        squares += *log_weight * *log_weight;
        mean += *x * *log_weight;
    }
    mean /= sum;
    let mut covariance = Matrix4::zeros();
    for (x, weight) in &points {
        let d = x - mean;
        covariance += d * d.transpose() * (*weight / sum);
    }
    let effective = sum * sum / squares;
    covariance *= 1.0 + 1.0 / effective;
    Some(Moments {
        mean: mean.into(),
        covariance,
        effective,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Normal-gamma: x | s ~ N(0, e^s) with s ~ N(0, 1): variance of x is e^(1/2) = 1.649, where
    /// Laplace's approximation sees far less.
    #[test]
    fn a_scale_mixture_is_wider_than_its_curvature() {
        let log = |p: &[f64; 4]| {
            let s = p[1];
            Some(-0.5 * p[0] * p[0] * (-s).exp() - 0.5 * s - 0.5 * (s * s + p[2] * p[2] + p[3] * p[3]))
        };
        let start = crate::numerics::optimum::maximise(log, [0.1, 0.0, 0.1, 0.0], [1.0; 4]).unwrap();
        let found = moments(log, &start, f64::INFINITY).unwrap();
        assert!(start.covariance[(0, 0)] < 0.7);
        // 240 points: about 10 % in a standard deviation.
        assert!((found.covariance[(0, 0)].sqrt() / 1.284 - 1.0).abs() < 0.12);
        assert!((found.covariance[(2, 2)].sqrt() - 1.0).abs() < 0.1);
        assert!(found.mean[0].abs() < 0.1);
    }

    /// The second parameter is skewed, the first is normal and independent of it: its mean is zero. Mirrored
    /// pairs alone do not give that.
    #[test]
    fn a_skewed_neighbour_does_not_move_the_frequency() {
        let log =
            |p: &[f64; 4]| Some(3.0 * (p[1] - p[1].exp()) - 0.5 * (p[0] * p[0] + p[2] * p[2] + p[3] * p[3]));
        let start = crate::numerics::optimum::maximise(log, [0.1, 0.0, 0.1, 0.0], [1.0; 4]).unwrap();
        let found = moments(log, &start, f64::INFINITY).unwrap();
        // The maximum is exact to rounding for a quadratic, and so is the symmetry of the points about it.
        assert!(found.mean[0].abs() < 1e-3, "{}", found.mean[0]);
    }
}
