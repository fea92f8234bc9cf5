//! The observed natural frequencies, and the checks that a set of them is usable.

use crate::rod::beam::forward::MAX_MODES;
use thiserror::Error;

/// Highest natural frequency accepted \[Hz\]; far above any rod, far below the range of `f32`.
pub const MAX_FREQUENCY_HZ: f64 = 1e6;

/// Observed natural frequencies: one entry per measured mode; any order may be missing.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Mode orders, from 1, ascending.
    pub orders: Vec<usize>,
    /// Natural frequencies \[Hz\].
    pub frequency_hz: Vec<f64>,
    /// Their standard errors \[Hz\].
    pub sd_hz: Vec<f64>,
}

/// Reason why a set of frequencies is no observation.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum InvalidObservation {
    /// There is no frequency.
    #[error("no natural frequency given")]
    Empty,
    /// Orders, frequencies and standard errors differ in number.
    #[error(
        "{orders} mode orders, {frequencies} frequencies and {sds} standard errors: one of each per mode is needed"
    )]
    Lengths {
        /// Number of orders.
        orders: usize,
        /// Number of frequencies.
        frequencies: usize,
        /// Number of standard errors.
        sds: usize,
    },
    /// An order is zero, repeated, out of sequence or beyond the highest.
    #[error("mode orders {orders:?}: they must ascend between 1 and {MAX_MODES}")]
    Orders {
        /// Orders as given.
        orders: Vec<usize>,
    },
    /// A frequency is not a positive number, or they do not ascend with the order.
    #[error(
        "frequency {frequency_hz} Hz of mode {order}: frequencies must be positive and ascend with the order"
    )]
    Frequency {
        /// Mode order, from 1.
        order: usize,
        /// Its frequency \[Hz\].
        frequency_hz: f64,
    },
    /// A standard error is negative or not finite.
    #[error("standard error {sd_hz} Hz of mode {order}: it must be zero or positive")]
    StandardError {
        /// Mode order, from 1.
        order: usize,
        /// Its standard error \[Hz\].
        sd_hz: f64,
    },
}

impl Observation {
    /// A checked observation.
    pub fn new(
        orders: Vec<usize>,
        frequency_hz: Vec<f64>,
        sd_hz: Vec<f64>,
    ) -> Result<Self, InvalidObservation> {
        let observation = Self {
            orders,
            frequency_hz,
            sd_hz,
        };
        observation.check()?;
        Ok(observation)
    }

    /// An observation of the first orders without a gap, all with one standard error \[Hz\].
    pub fn first(frequency_hz: &[f64], sd_hz: f64) -> Result<Self, InvalidObservation> {
        Self::new(
            (1..=frequency_hz.len()).collect(),
            frequency_hz.to_vec(),
            vec![sd_hz; frequency_hz.len()],
        )
    }

    /// Number of modes observed.
    pub fn modes(&self) -> usize {
        self.orders.len()
    }

    /// Checks the fields: equal lengths, ascending orders from 1 to [`MAX_MODES`], positive
    /// ascending frequencies, standard errors not negative.
    pub fn check(&self) -> Result<(), InvalidObservation> {
        let count = self.orders.len();
        if self.frequency_hz.len() != count || self.sd_hz.len() != count {
            return Err(InvalidObservation::Lengths {
                orders: count,
                frequencies: self.frequency_hz.len(),
                sds: self.sd_hz.len(),
            });
        }
        let (Some(&lowest), Some(&highest)) = (self.orders.first(), self.orders.last()) else {
            return Err(InvalidObservation::Empty);
        };
        if lowest == 0 || highest > MAX_MODES || self.orders.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(InvalidObservation::Orders {
                orders: self.orders.clone(),
            });
        }
        let mut previous = 0.0;
        for ((&order, &frequency_hz), &sd_hz) in self.orders.iter().zip(&self.frequency_hz).zip(&self.sd_hz) {
            if !(frequency_hz > previous && frequency_hz <= MAX_FREQUENCY_HZ) {
                return Err(InvalidObservation::Frequency { order, frequency_hz });
            }
            if !(0.0..=MAX_FREQUENCY_HZ).contains(&sd_hz) {
                return Err(InvalidObservation::StandardError { order, sd_hz });
            }
            previous = frequency_hz;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_subset_of_orders_is_an_observation() {
        assert!(Observation::new(vec![1, 3], vec![4.5, 13.3], vec![0.01, 0.0]).is_ok());
        assert!(Observation::first(&[4.5], 0.01).is_ok());
    }

    #[test]
    fn nonsense_is_named() {
        use InvalidObservation::*;
        let check = |orders: &[usize], f: &[f64], sd: &[f64]| {
            Observation::new(orders.to_vec(), f.to_vec(), sd.to_vec()).unwrap_err()
        };
        assert_eq!(check(&[], &[], &[]), Empty);
        assert!(matches!(check(&[1], &[4.0], &[]), Lengths { sds: 0, .. }));
        assert!(matches!(check(&[2, 1], &[4.0, 8.0], &[0.0, 0.0]), Orders { .. }));
        assert!(matches!(check(&[0], &[4.0], &[0.0]), Orders { .. }));
        assert!(matches!(check(&[6], &[4.0], &[0.0]), Orders { .. }));
        assert!(matches!(
            check(&[1, 2], &[4.0, 3.0], &[0.0, 0.0]),
            Frequency { order: 2, .. }
        ));
        assert!(matches!(check(&[1], &[f64::NAN], &[0.0]), Frequency { .. }));
        assert!(matches!(check(&[1], &[f64::INFINITY], &[0.0]), Frequency { .. }));
        assert!(matches!(check(&[1], &[4.0], &[-1e-3]), StandardError { .. }));
        assert!(matches!(check(&[1], &[4.0], &[f64::NAN]), StandardError { .. }));
    }
}
