//! Rods that moved beside what their temperature explains: the thermometer's error, the structure, or a rod by itself.
//!
//! Rods are thermometers, too. If readings are too high by tau, what they explain is wrong by beta_j tau, so that rod j seems to
//! have changed by J_j = -beta_j tau: a pattern over the rods that is known from their slopes. With D = diag(sd_j^2),
//!
//! ```text
//! thermometer   J ~ N(0, D + s^2 (beta beta' + diag(sd_beta_j^2)))    s = 0.3, 1, 3 K
//! together      J ~ N(0, D + s^2 1 1')                                s = 0.3 to 30 %: every rod by the same share
//! one rod       J ~ N(0, D + s^2 e_k e_k')                            any k alike
//! several       J ~ N(0, D + s^2 I)                                   each by itself
//! ```
//!
//! all four, and the sizes s within each, alike beforehand. Weather that the filters do not resolve has the pattern of the thermometer.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Errors of a thermometer \[K\], and shares of the force.
const KELVINS: [f64; 3] = [0.3, 1.0, 3.0];
const SHARES: [f64; 5] = [0.003, 0.01, 0.03, 0.1, 0.3];

/// One rod of the site.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// Change of N_t / N_0 beside what the temperature explains, since a common onset.
    pub change: f64,
    /// Its standard error.
    pub sd: f64,
    /// Learned slope beta of N_t / N_0 \[1/K\].
    pub slope_per_k: f64,
    /// Its standard error.
    pub slope_sd_per_k: f64,
}

/// Causes of what the rods of a site show together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Common {
    /// Probability that the thermometer, or weather its readings do not show, explains it.
    pub thermometer: f64,
    /// Probability that all rods changed by the same share.
    pub together: f64,
    /// Probability that several rods changed, each by itself.
    pub several: f64,
    /// Probability that one rod changed, rod by rod.
    pub one: Vec<f64>,
    /// Excess of the readings, if it is the thermometer: mean and standard deviation \[K\].
    pub error_k: (f64, f64),
}

impl Common {
    /// Weighs the causes; `None` for fewer than two rods, which tell nothing apart, or for numbers that are none.
    pub fn of(rods: &[Moved]) -> Option<Self> {
        let is_sane = rods.iter().all(|rod| {
            rod.change.is_finite() && rod.slope_per_k.is_finite() && rod.sd > 0.0 && rod.slope_sd_per_k >= 0.0
        });
        if rods.len() < 2 || !is_sane {
            return None;
        }
        let count = rods.len();
        let changes = DVector::from_iterator(count, rods.iter().map(|rod| rod.change));
        let own = |extra: &dyn Fn(usize) -> f64| {
            DMatrix::from_fn(count, count, |a, b| {
                if a == b {
                    rods[a].sd * rods[a].sd + extra(a)
                } else {
                    0.0
                }
            })
        };
        let slopes = DVector::from_iterator(count, rods.iter().map(|rod| rod.slope_per_k));
        let ones = DVector::from_element(count, 1.0);
        let mut thermometer = Vec::new();
        let mut errors = Vec::new();
        for s in KELVINS {
            let covariance = own(&|a| (s * rods[a].slope_sd_per_k).powi(2));
            let seen = &covariance + s * s * &slopes * slopes.transpose();
            thermometer.push(ln_normal(&changes, seen)?);
            let weighted = covariance.cholesky()?.solve(&slopes);
            let variance = (1.0 / (s * s) + weighted.dot(&slopes)).recip();
            errors.push((-variance * weighted.dot(&changes), variance));
        }
        let shares = |covariance: &dyn Fn(f64) -> DMatrix<f64>| {
            SHARES
                .iter()
                .map(|s| ln_normal(&changes, covariance(*s)))
                .collect::<Option<Vec<f64>>>()
                .map(|logs| ln_mean(&logs))
        };
        let together = shares(&|s| own(&|_| 0.0) + s * s * &ones * ones.transpose())?;
        let several = shares(&|s| own(&|_| s * s))?;
        let one = (0..count)
            .map(|k| shares(&|s| own(&|a| if a == k { s * s } else { 0.0 })))
            .collect::<Option<Vec<f64>>>()?;
        let logs = [ln_mean(&thermometer), together, several, ln_mean(&one)];
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = logs.iter().map(|log| libm::exp(log - most)).sum();
        let probability = |log: f64| libm::exp(log - most) / sum;
        let parts: Vec<f64> = thermometer
            .iter()
            .map(|log| libm::exp(log - ln_mean(&thermometer)) / KELVINS.len() as f64)
            .collect();
        let mean: f64 = parts.iter().zip(&errors).map(|(w, (mean, _))| w * mean).sum();
        let variance: f64 = parts
            .iter()
            .zip(&errors)
            .map(|(w, (at, variance))| w * (variance + (at - mean).powi(2)))
            .sum();
        Some(Self {
            thermometer: probability(logs[0]),
            together: probability(together),
            several: probability(several),
            one: one.iter().map(|log| probability(*log) / count as f64).collect(),
            error_k: (mean, variance.sqrt()),
        })
    }
}

/// ln of the normal density with mean zero.
fn ln_normal(x: &DVector<f64>, covariance: DMatrix<f64>) -> Option<f64> {
    let lower = covariance.cholesky()?.unpack();
    let white = lower.solve_lower_triangular(x)?;
    let log_determinant: f64 = (0..x.len()).map(|n| libm::log(lower[(n, n)])).sum();
    Some(-0.5 * white.norm_squared() - log_determinant - 0.5 * x.len() as f64 * libm::log(2.0 * PI))
}

/// ln of the mean of exp.
fn ln_mean(logs: &[f64]) -> f64 {
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most + libm::log(logs.iter().map(|log| libm::exp(log - most)).sum::<f64>() / logs.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    const SLOPES: [f64; 5] = [-0.002, -0.0035, -0.005, -0.008, -0.010];

    /// Five rods known to 0.1 %, with slopes known to a twentieth.
    fn site(seed: u64, change: impl Fn(usize) -> f64) -> Common {
        let mut generator = random::stream(seed, 0);
        let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
        let rods: Vec<Moved> = (0..5)
            .map(|j| Moved {
                change: change(j) + 1e-3 * normal(),
                sd: 1e-3,
                slope_per_k: SLOPES[j] * (1.0 + 0.05 * normal()),
                slope_sd_per_k: 0.05 * SLOPES[j].abs(),
            })
            .collect();
        Common::of(&rods).unwrap()
    }

    #[test]
    fn a_thermometer_is_told_from_rods_and_its_error_is_sized() {
        let (mut told, mut inside) = (0, 0);
        for seed in 0..200 {
            let tau = if seed % 2 == 0 { 1.5 } else { -1.0 };
            let common = site(seed, |j| -SLOPES[j] * tau);
            told += usize::from(common.thermometer > 0.9);
            inside += usize::from((common.error_k.0 - tau).abs() < 1.96 * common.error_k.1);
            let sum = common.thermometer + common.together + common.several + common.one.iter().sum::<f64>();
            assert!((sum - 1.0).abs() < 1e-12);
        }
        // A step of a kelvin stands out by five standard errors of the weakest rod's slope and more.
        assert!(told > 190, "{told}");
        // 95 % within three binomial standard deviations.
        assert!((181..=199).contains(&inside), "{inside}");
    }

    #[test]
    fn one_rod_and_several_are_not_blamed_on_the_thermometer() {
        for seed in 0..200 {
            let k = seed as usize % 5;
            let common = site(seed, |j| if j == k { -0.03 } else { 0.0 });
            assert!(common.one[k] > 0.95 && common.thermometer < 0.01, "{common:?}");
            let common = site(seed, |j| [-0.02, 0.015, -0.03, 0.01, -0.01][j]);
            assert!(common.several > 0.95, "{common:?}");
            let common = site(seed, |_| -0.02);
            assert!(common.together > 0.95, "{common:?}");
        }
    }

    #[test]
    fn rods_of_one_slope_do_not_tell_the_thermometer_from_the_structure() {
        let rods = [Moved {
            change: 0.01,
            sd: 1e-3,
            slope_per_k: -0.005,
            slope_sd_per_k: 1e-4,
        }; 4];
        let common = Common::of(&rods).unwrap();
        assert!(
            (0.2..0.8).contains(&common.thermometer) && (0.2..0.8).contains(&common.together),
            "{common:?}"
        );
        assert!(Common::of(&rods[..1]).is_none());
        assert!(Common::of(&[Moved { sd: 0.0, ..rods[0] }; 2]).is_none());
    }
}
