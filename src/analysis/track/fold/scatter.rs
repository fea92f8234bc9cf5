//! Scatter of a rod's records within a period about what the temperature explains: a period of many records is known better than any
//! one of them, whose own noise the watch over periods never sees.

use serde::{Deserialize, Serialize};

/// Degrees of freedom from which the scatter is known.
const FEWEST: f64 = 10.0;
/// Most degrees of freedom remembered: older scatter is forgotten.
const MOST: f64 = 500.0;
/// Largest variance of a period, in those before: one with a sudden loss is no scatter.
const WILD: f64 = 9.0;

/// Pooled variance within periods, s^2 = sum (n_k - 1) s_k^2 / sum (n_k - 1).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Scatter {
    /// Number of the period in hand, its records, their mean and their sum of squares about it.
    index: i64,
    records: f64,
    mean: f64,
    squares: f64,
    /// Degrees of freedom of the periods before, and s^2.
    freedom: f64,
    variance: f64,
}

impl Scatter {
    /// Takes the change that a record of a period shows at the reference temperature; one of an earlier period comes too late.
    pub(super) fn take(&mut self, index: i64, change: f64) {
        if self.records > 0.0 && index < self.index {
            return;
        }
        if index != self.index {
            self.close();
            self.index = index;
        }
        self.records += 1.0;
        let off = change - self.mean;
        self.mean += off / self.records;
        self.squares += off * (change - self.mean);
    }

    /// Pools the period in hand.
    fn close(&mut self) {
        let freedom = self.records - 1.0;
        if freedom > 0.0 {
            let most = if self.sd().is_some() {
                WILD * self.variance
            } else {
                f64::INFINITY
            };
            let variance = (self.squares / freedom).min(most);
            self.freedom = (self.freedom + freedom).min(MOST);
            self.variance += (freedom / self.freedom).min(1.0) * (variance - self.variance);
        }
        (self.records, self.mean, self.squares) = (0.0, 0.0, 0.0);
    }

    /// Standard deviation of a record about its period; `None` where periods have one record each, or too few of them passed.
    pub(super) fn sd(&self) -> Option<f64> {
        (self.freedom >= FEWEST).then(|| self.variance.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    fn taken(periods: i64, records: usize, level: impl Fn(i64, usize) -> f64) -> Scatter {
        let (mut scatter, mut generator) = (Scatter::default(), random::stream(5, 1));
        for index in 0..periods {
            for record in 0..records {
                let noise: f64 = StandardNormal.sample(&mut generator);
                scatter.take(index, level(index, record) + 0.002 * noise);
            }
        }
        scatter
    }

    #[test]
    fn scatter_is_that_within_periods() {
        assert_eq!(taken(100, 1, |_, _| 0.0).sd(), None);
        assert_eq!(taken(2, 6, |_, _| 0.0).sd(), None);
        // Periods differ by tenths. 500 degrees of freedom: the standard deviation is known to 3.2 %.
        let sd = taken(100, 24, |index, _| 0.1 * (index as f64).sin())
            .sd()
            .unwrap();
        assert!((sd / 0.002 - 1.0).abs() < 0.1, "{sd}");
    }

    #[test]
    fn a_period_with_a_loss_is_no_scatter() {
        let lost = |index, record| if (index, record) >= (50, 12) { -0.4 } else { 0.0 };
        // One period of 24 at nine times the variance among 500 degrees of freedom: 1.17 times the standard deviation at most.
        let sd = taken(52, 24, lost).sd().unwrap();
        assert!((1.0..1.3).contains(&(sd / 0.002)), "{sd}");
    }

    #[test]
    fn a_record_of_an_earlier_period_changes_nothing() {
        let mut scatter = taken(20, 4, |_, _| 0.0);
        let before = scatter.clone();
        scatter.take(3, 5.0);
        assert_eq!(scatter, before);
    }
}
