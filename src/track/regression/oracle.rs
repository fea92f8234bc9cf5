//! The bank against dense linear algebra: all periods at once as one Gaussian vector, the noise level integrated by
//! the trapezoidal rule. It shares no formula with the recursion.

use super::*;
use nalgebra::{DMatrix, DVector};

/// Periods with a hole of three, and unequal standard errors.
const DAYS: [(i64, f64, f64, f64); 9] = [
    (100, 1.2e-4, 1.0e-4, -0.3),
    (101, -0.4e-4, 1.2e-4, 0.4),
    (102, 2.1e-4, 0.8e-4, -1.1),
    (103, 1.7e-4, 1.0e-4, -0.9),
    (106, -2.2e-4, 2.5e-4, 1.3),
    (107, -1.4e-4, 1.1e-4, 0.9),
    (108, 0.2e-4, 0.7e-4, 0.1),
    (109, 3.0e-4, 1.0e-4, -1.6),
    (110, -4.0e-4, 1.4e-4, 1.2),
];

/// Phi^-1(F) of the last response given those before.
fn residual(count: usize, prior: &RegressionPrior) -> f64 {
    let days = &DAYS[..count];
    let first_sd = days[0].2;
    let response = DVector::from_iterator(count, days.iter().map(|day| day.1.exp_m1()));
    let (mut below, mut total) = (0.0, 0.0);
    for (phi, phi_weight) in PHIS {
        for share in NOISE_SHARES {
            let scale =
                |day: &(i64, f64, f64, f64)| (1.0 - share + share * (day.2 / first_sd).powi(2)).sqrt();
            // Covariance of errors and coefficients, both over the noise variance.
            let covariance = DMatrix::from_fn(count, count, |i, j| {
                let (a, b) = (&days[i], &days[j]);
                let wide = |sd: f64| (sd / (CONJUGATE * first_sd)).powi(2);
                phi.powi((a.0 - b.0).unsigned_abs() as i32) * scale(a) * scale(b)
                    + wide(prior.intercept_sd)
                    + wide(prior.slope_sd) * a.3 * b.3
                    + wide(prior.curvature_sd) * (a.3 * b.3).powi(2)
            });
            let mean = DVector::from_iterator(count, days.iter().map(|day| prior.slope_mean * day.3));
            let off = response.clone() - mean;
            let known = count - 1;
            let past = covariance.view((0, 0), (known, known)).into_owned();
            let cross = covariance.view((0, known), (known, 1)).into_owned();
            let lu = past.clone().lu();
            let weights = lu.solve(&cross).unwrap();
            let past_off = off.rows(0, known).into_owned();
            let expected = (weights.transpose() * &past_off)[0];
            let variance = covariance[(known, known)] - (weights.transpose() * &cross)[0];
            let squares = past_off.dot(&lu.solve(&past_off).unwrap());
            let ln_determinant = lu.determinant().ln();
            // Over ln s: inverse gamma density of s^2 times the Gaussian likelihood.
            for step in 0..4000 {
                let ln_s = first_sd.ln() - 12.0 + 24.0 * step as f64 / 4000.0;
                let s2 = (2.0 * ln_s).exp();
                let ln_prior = -2.0 * SHAPE * ln_s - SHAPE * first_sd * first_sd / s2;
                let ln_likelihood = -0.5 * ln_determinant - known as f64 * ln_s - 0.5 * squares / s2;
                let weight = phi_weight * (ln_prior + ln_likelihood - known as f64 * 9.0).exp();
                let z = (off[known] - expected) / (s2 * variance).sqrt();
                total += weight;
                below += weight * 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
            }
        }
    }
    -tail::upper_deviate((below / total).ln())
}

#[test]
fn residuals_agree_with_the_joint_gaussian() {
    let prior = RegressionPrior {
        slope_mean: -1e-4,
        slope_sd: 0.8e-4,
        intercept_sd: 1e-4,
        curvature_sd: 0.3e-4,
        lags: 1,
    };
    let mut regression = Regression::new(&prior);
    for (index, (period, delta, sd, warmer)) in DAYS.into_iter().enumerate() {
        let warmer_k = [warmer];
        let statistic = Statistic {
            period,
            delta,
            sd,
            warmer_k: &warmer_k,
        };
        if index > 0 {
            let (found, expected) = (regression.residual(&statistic), residual(index + 1, &prior));
            // The oracle leaves out that errors go with the expected ratio, here within 4e-4 of one, and its grid
            // ends where half a degree of freedom still has a tail of 1e-5.
            assert!((found - expected).abs() < 2e-3, "{index}: {found} {expected}");
        }
        regression.update(&statistic);
    }
}
