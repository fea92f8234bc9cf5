//! The exact likelihood of observed frequencies: normal errors and a normal model discrepancy, independent
//! between modes (paper, section 3, where the discrepancy is taken as zero).

use crate::inference::Observation;
use thiserror::Error;

/// Reason why an observation has no likelihood.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum NoLikelihood {
    /// A mode without discrepancy has a standard error of zero.
    #[error(
        "mode {order} has neither a standard error nor a model discrepancy: its likelihood is not a density"
    )]
    Exact {
        /// Mode order, from 1.
        order: usize,
    },
    /// The discrepancy is missing for a mode, negative, or not a number.
    #[error(
        "discrepancy {discrepancy:?}: one number from zero for each mode order up to {highest} is needed"
    )]
    Discrepancy {
        /// Discrepancies as given.
        discrepancy: Vec<f64>,
        /// Highest order observed.
        highest: usize,
    },
}

/// `p(y_0 | theta)` as a function of the model's frequencies.
#[derive(Debug, Clone, PartialEq)]
pub struct Likelihood {
    terms: Vec<Term>,
    modes: usize,
}

#[derive(Debug, Clone, PartialEq)]
struct Term {
    mode: usize,
    observed: f64,
    variance: f64,
    /// Square of the relative discrepancy.
    discrepancy: f64,
}

impl Likelihood {
    /// A likelihood; `discrepancy` holds the relative standard deviation per mode order from the first.
    pub fn new(observation: &Observation, discrepancy: &[f64]) -> Result<Self, NoLikelihood> {
        let modes = observation.orders.last().copied().unwrap_or(0);
        if discrepancy.len() < modes || discrepancy.iter().any(|d| !(d.is_finite() && *d >= 0.0)) {
            return Err(NoLikelihood::Discrepancy {
                discrepancy: discrepancy.to_vec(),
                highest: modes,
            });
        }
        let measured = observation.orders.iter().zip(&observation.frequency_hz);
        let terms = measured
            .zip(&observation.sd_hz)
            .map(|((&order, &observed), &sd)| {
                let relative = discrepancy[order - 1];
                if sd > 0.0 || relative > 0.0 {
                    Ok(Term {
                        mode: order - 1,
                        observed,
                        variance: sd * sd,
                        discrepancy: relative * relative,
                    })
                } else {
                    Err(NoLikelihood::Exact { order })
                }
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { terms, modes })
    }

    /// Number of frequencies needed, from the first.
    pub fn modes(&self) -> usize {
        self.modes
    }

    /// Natural logarithm of the density up to a constant, given the model's frequencies; minus infinity where
    /// the model has no answer (NaN).
    #[inline]
    pub fn log_density(&self, frequency_hz: &[f64]) -> f64 {
        let mut sum = 0.0;
        for term in &self.terms {
            let y = frequency_hz[term.mode];
            let residual = y - term.observed;
            if term.discrepancy > 0.0 {
                let variance = term.variance + term.discrepancy * y * y;
                sum -= 0.5 * (residual * residual / variance + libm::log(variance));
            } else {
                sum -= 0.5 * residual * residual / term.variance;
            }
        }
        if sum.is_nan() { f64::NEG_INFINITY } else { sum }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_normal_density() {
        let observation = Observation::new(vec![1, 3], vec![4.0, 13.0], vec![0.1, 0.2]).unwrap();
        let plain = Likelihood::new(&observation, &[0.0; 3]).unwrap();
        // One and two standard deviations away.
        assert!((plain.log_density(&[4.1, f64::NAN, 12.6]) - -(0.5 + 2.0)).abs() < 1e-12);
        assert_eq!(plain.log_density(&[f64::NAN, 8.0, 12.6]), f64::NEG_INFINITY);
        let wide = Likelihood::new(&observation, &[0.03, 0.0, 0.0]).unwrap();
        let variance = 0.01f64 + 0.12 * 0.12;
        let wanted = -0.5 * (0.0 + variance.ln());
        assert!((wide.log_density(&[4.0, 8.0, 13.0]) - wanted).abs() < 1e-12);
    }

    #[test]
    fn what_has_no_density_is_named() {
        let sure = Observation::new(vec![1, 2], vec![4.0, 8.0], vec![0.1, 0.0]).unwrap();
        assert_eq!(
            Likelihood::new(&sure, &[0.0; 2]),
            Err(NoLikelihood::Exact { order: 2 })
        );
        assert!(Likelihood::new(&sure, &[0.0, 0.01]).is_ok());
        let missing = Likelihood::new(&sure, &[0.01]);
        assert!(matches!(
            missing,
            Err(NoLikelihood::Discrepancy { highest: 2, .. })
        ));
        assert!(Likelihood::new(&sure, &[0.01, f64::NAN]).is_err());
    }
}
