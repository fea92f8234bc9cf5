//! Change from a level: what a period shows beyond what its columns explain, against the mean of earlier periods.

use super::bank::{Row, Seen, quadratic};
use super::detector::Detector;
use super::prior::Fluctuation;

/// Where columns begin in the state: after change and intercept.
const COLUMNS: usize = 2;

impl Detector {
    /// Change from a level and its standard deviation. `seen` holds ratio and columns less their means over `periods` periods
    /// in `span_d` days:
    ///
    /// ```text
    /// c = (y - y_0) - (X - X_0) b,    var c = sigma^2 (R + r + r2 + x'P x + (1 + r s(tau) + r2 s(tau2)) / level)
    /// ```
    ///
    /// The fluctuation counts with its whole variance: what lasts for days only is no change. `None` for a period that cannot
    /// be used.
    pub fn change_from_level(&self, seen: &Seen, periods: f64, span_d: f64) -> Option<(f64, f64)> {
        let row = Row::new(&self.prior, seen)?;
        let x = row.columns();
        let width = x.len();
        let mut along = vec![0.0; width];
        along[COLUMNS..width - 2].copy_from_slice(&x[COLUMNS..width - 2]);
        let (mut mean, mut square, mut variance) = (0.0, 0.0, 0.0);
        for member in &self.null.members {
            let weight = libm::exp(member.ln_weight);
            let fluctuation = &self.prior.members[usize::from(member.which)];
            let explained: f64 = along.iter().zip(&member.mean).map(|(x, mean)| x * mean).sum();
            mean += weight * explained;
            square += weight * explained * explained;
            let own = row.error() + fluctuation.variance + fluctuation.slow_variance;
            let level = periods.recip() + averaged(fluctuation, span_d);
            variance += weight * member.noise() * (own + level + quadratic(&member.cov, &along, width));
        }
        let between = (square - mean * mean).max(0.0);
        Some((seen.ratio - mean, (variance + between).sqrt()))
    }

    /// Slope of the ratio with a temperature that stays: the sum of the first `filters` coefficients, and its standard deviation.
    pub fn slope(&self, filters: usize) -> (f64, f64) {
        let width = self.prior.columns.len() + 4;
        let mut along = vec![0.0; width];
        along[COLUMNS..COLUMNS + filters.min(self.prior.columns.len())].fill(1.0);
        let (mut mean, mut square, mut variance) = (0.0, 0.0, 0.0);
        for member in &self.null.members {
            let weight = libm::exp(member.ln_weight);
            let slope: f64 = along.iter().zip(&member.mean).map(|(x, mean)| x * mean).sum();
            mean += weight * slope;
            square += weight * slope * slope;
            variance += weight * member.noise() * quadratic(&member.cov, &along, width);
        }
        (mean, (variance + (square - mean * mean).max(0.0)).sqrt())
    }
}

/// Variance of a fluctuation's mean over `span_d` days, in noise variances.
fn averaged(fluctuation: &Fluctuation, span_d: f64) -> f64 {
    let of = |variance: f64, memory_d: f64| {
        let share = memory_d / span_d.max(f64::MIN_POSITIVE);
        // An Ornstein-Uhlenbeck process averaged over its span; for a span far below its memory it is constant.
        if share > 1e3 {
            variance
        } else {
            variance * 2.0 * share * (1.0 + share * libm::expm1(-1.0 / share))
        }
    };
    of(fluctuation.variance, fluctuation.memory_d) + of(fluctuation.slow_variance, fluctuation.slow_memory_d)
}
