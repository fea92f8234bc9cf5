//! A figure with its Monte Carlo error, and how far a printed one lies from it.

use super::paper::Printed;
use serde::Serialize;

/// From this many standard errors on, two figures are said to disagree.
pub const DISAGREE: f64 = 3.0;
/// Up to this relative difference one figure is said to be about another.
pub const CLOSE: f64 = 0.05;

impl Printed {
    /// Whether a figure is about the printed one: it rounds to it, or differs by [`CLOSE`] at most.
    pub fn is_about(self, value: f64) -> bool {
        (value - self.value).abs() <= (0.5 * self.digit).max(CLOSE * self.value.abs())
    }
}

/// A stochastic figure over repeated runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Mean over the runs.
    pub value: f64,
    /// Standard deviation between runs: the Monte Carlo error of one run.
    pub error: f64,
    /// How many runs.
    pub runs: usize,
}

impl Estimate {
    /// From one figure per run; the error of a single run is not known (NaN).
    pub fn of(figures: impl Iterator<Item = f64>) -> Self {
        let figures: Vec<f64> = figures.collect();
        let runs = figures.len();
        let value = figures.iter().sum::<f64>() / runs as f64;
        let square: f64 = figures.iter().map(|x| (x - value) * (x - value)).sum();
        Self {
            value,
            error: (square / (runs as f64 - 1.0)).sqrt(),
            runs,
        }
    }

    /// A figure without Monte Carlo error.
    pub fn sure(value: f64) -> Self {
        Self {
            value,
            error: 0.0,
            runs: 1,
        }
    }

    /// Standard error of the mean over the runs.
    pub fn error_of_mean(&self) -> f64 {
        self.error / (self.runs as f64).sqrt()
    }

    /// How many standard errors another study's figure lies above: that study is one run with the error of one
    /// of ours, and its figure is rounded.
    pub fn deviation(&self, printed: Printed) -> f64 {
        let rounding = printed.digit * printed.digit / 12.0;
        let variance = self.error * self.error * (1.0 + 1.0 / self.runs as f64) + rounding;
        (printed.value - self.value) / variance.sqrt()
    }
}

/// One figure: the paper's, ours, and what lies between them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Which table or figure.
    pub part: String,
    /// Which column or row of it.
    pub column: String,
    /// Of which quantity.
    pub quantity: String,
    /// Which statistic.
    pub statistic: &'static str,
    /// What the paper prints, if it does.
    pub paper: Option<Printed>,
    /// What we get.
    pub ours: Estimate,
    /// Paper less ours in standard errors.
    pub deviation: Option<f64>,
}

impl Comparison {
    /// Compares.
    pub fn new(
        part: &str,
        column: &str,
        quantity: &str,
        statistic: &'static str,
        paper: Option<Printed>,
        ours: Estimate,
    ) -> Self {
        Self {
            part: part.to_owned(),
            column: column.to_owned(),
            quantity: quantity.to_owned(),
            statistic,
            paper,
            ours,
            deviation: paper.map(|printed| ours.deviation(printed)),
        }
    }

    /// Whether the two disagree; `None` if the paper prints nothing.
    pub fn disagrees(&self) -> Option<bool> {
        self.deviation
            .map(|deviation| deviation.is_nan() || deviation.abs() > DISAGREE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deviation_counts_both_errors_and_the_rounding() {
        let ours = Estimate::of([1.0, 3.0, 2.0, 2.0].into_iter());
        assert_eq!((ours.value, ours.runs), (2.0, 4));
        assert!((ours.error - (2.0f64 / 3.0).sqrt()).abs() < 1e-15);
        let at = |value, digit| ours.deviation(Printed { value, digit });
        assert!((at(4.0, 0.0) - 2.0 / (2.0f64 / 3.0 * 1.25).sqrt()).abs() < 1e-12);
        assert!((at(4.0, 10.0) - 2.0 / (2.0f64 / 3.0 * 1.25 + 100.0 / 12.0).sqrt()).abs() < 1e-12);
        let rounded = Printed {
            value: 0.1,
            digit: 0.1,
        };
        assert!(rounded.is_about(0.149) && !rounded.is_about(0.151) && !rounded.is_about(f64::NAN));
        let exact = Printed {
            value: 200.0,
            digit: 1.0,
        };
        assert!(exact.is_about(209.9) && !exact.is_about(189.9));
        let printed = Printed {
            value: 7.0,
            digit: 0.1,
        };
        let one = Comparison::new("a", "b", "c", "mean", Some(printed), ours);
        assert_eq!(one.disagrees(), Some(true));
        assert_eq!(
            Comparison::new("a", "b", "c", "mean", None, ours).disagrees(),
            None
        );
    }
}
