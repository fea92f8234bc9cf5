//! A figure with its Monte Carlo error, and the distance of a printed one from it.

use super::paper::Printed;
use serde::Serialize;

/// Number of standard errors from which two figures disagree.
pub const DISAGREE: f64 = 3.0;
/// Largest relative difference at which one figure counts as about another.
pub const CLOSE: f64 = 0.05;

impl Printed {
    /// True if a figure is about the printed one: it rounds to it, or differs by [`CLOSE`] at most.
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
    /// Number of runs.
    pub runs: usize,
}

impl Estimate {
    /// Estimate from one figure per run; the error of a single run is NaN.
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

    /// Number of standard errors by which another study's figure lies above ours: that study is one run with
    /// the error of one of ours, and its figure is rounded.
    pub fn deviation(&self, printed: Printed) -> f64 {
        let rounding = printed.digit * printed.digit / 12.0;
        let variance = self.error * self.error * (1.0 + 1.0 / self.runs as f64) + rounding;
        (printed.value - self.value) / variance.sqrt()
    }
}

/// One figure: the paper's, ours, and the difference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Table or figure.
    pub part: String,
    /// Column or row of it.
    pub column: String,
    /// Quantity compared.
    pub quantity: String,
    /// Statistic compared.
    pub statistic: &'static str,
    /// The paper's figure, if it prints one.
    pub paper: Option<Printed>,
    /// Our figure.
    pub ours: Estimate,
    /// Paper less ours in standard errors.
    pub deviation: Option<f64>,
}

impl Comparison {
    /// Compares a figure with the paper's.
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

    /// True if the two disagree; `None` if the paper prints nothing.
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
