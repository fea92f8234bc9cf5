//! Whether residuals are still autocorrelated: a guard of the stated false-alarm rate.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Lags in the portmanteau statistic.
const LAGS: usize = 7;
/// Fewer residuals say nothing.
const FEW: usize = 30;
/// Residuals are taken as no larger, as on the charts.
const CLAMP: f64 = 5.0;

/// What is left of autocorrelation in residuals that ought to be independent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Whiteness {
    /// Residuals looked at.
    pub count: usize,
    /// Autocorrelation of neighbours.
    pub lag1: f64,
    /// P(one as large or larger | independent): positive autocorrelation shortens the run length.
    pub lag1_p: f64,
    /// P(Ljung and Box's Q over seven lags as large or larger | independent).
    pub ljung_box_p: f64,
    /// The two taken together (Bonferroni).
    pub p: f64,
}

/// Below this probability residuals are not white.
const COLOURED_P: f64 = 1e-3;

impl Whiteness {
    /// Whether the stated false-alarm rate may be believed.
    pub fn is_white(&self) -> bool {
        self.p >= COLOURED_P
    }

    /// One sentence for people, if they are not white.
    pub fn message(&self) -> String {
        format!(
            "the stated false-alarm rate does not hold: the last {} residuals depend on one another (lag 1: {:+.2}, p = {:.1e}); \
             a longer track.period_h may help",
            self.count, self.lag1, self.p
        )
    }
}

/// Tests residuals in time order, neighbours next to each other; `None` for fewer than thirty.
///
/// Autocorrelations are taken about zero, the mean the residuals ought to have; lag 1 against N(0, 1/n), the sum
/// Q = n (n + 2) sum r_k^2 / (n - k) against chi-square (Ljung and Box 1978).
pub fn whiteness(residuals: &[f64]) -> Option<Whiteness> {
    let count = residuals.len();
    if count < FEW {
        return None;
    }
    let values: Vec<f64> = residuals
        .iter()
        .map(|r| {
            if r.is_finite() {
                r.clamp(-CLAMP, CLAMP)
            } else {
                0.0
            }
        })
        .collect();
    let power: f64 = values.iter().map(|r| r * r).sum();
    if power <= 0.0 {
        return None;
    }
    let correlation = |lag: usize| values.iter().zip(&values[lag..]).map(|(a, b)| a * b).sum::<f64>() / power;
    let n = count as f64;
    let q: f64 = (1..=LAGS)
        .map(|lag| correlation(lag).powi(2) / (n - lag as f64))
        .sum();
    let lag1 = correlation(1);
    let lag1_p = 0.5 * libm::erfc(lag1 * n.sqrt() / std::f64::consts::SQRT_2);
    let ljung_box_p = ChiSquared::new(LAGS as f64).map_or(1.0, |law| law.sf(n * (n + 2.0) * q));
    Some(Whiteness {
        count,
        lag1,
        lag1_p,
        ljung_box_p,
        p: (2.0 * lag1_p.min(ljung_box_p)).min(1.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random;
    use rand_distr::{Distribution, StandardNormal};

    fn share(count: usize, phi: f64, level: f64) -> f64 {
        let rejected = (0..2000u64).filter(|&run| {
            let mut generator = random::stream(5, run);
            let mut value = 0.0;
            let residuals: Vec<f64> = (0..count)
                .map(|_| {
                    let z: f64 = StandardNormal.sample(&mut generator);
                    value = phi * value + (1.0 - phi * phi).sqrt() * z;
                    value
                })
                .collect();
            whiteness(&residuals).is_some_and(|found| found.p < level)
        });
        rejected.count() as f64 / 2000.0
    }

    #[test]
    fn silent_on_white_noise_and_sure_of_an_autocorrelation_of_a_third() {
        assert_eq!(whiteness(&[0.0; 29]), None);
        assert_eq!(whiteness(&[0.0; 40]), None);
        // Two tests share 5 %; 2000 runs have a binomial sd of 0.5 %; the chi-square law is asymptotic.
        for count in [60, 365] {
            let found = share(count, 0.0, 0.05);
            assert!((0.025..0.075).contains(&found), "{found}");
        }
        assert!(share(180, 0.3, 0.01) > 0.85);
    }
}
