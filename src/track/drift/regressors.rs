//! Regressors: exponential filters of temperature readings at any times, curvature, transients, a yearly cycle, other rods.
//!
//! A filter of time constant tau follows the readings T by dF/dt = (T - F) / tau. Between readings the temperature is taken as a
//! straight line, for which the solution is closed, with x = (t_1 - t_0) / tau:
//!
//! ```text
//! F_1 = T_1 + (F_0 - T_0) e^-x - (T_1 - T_0) (1 - e^-x) / x
//! ```
//!
//! A rod follows the air by hours, masonry by weeks; a weighted sum of filters between stands for lags in between and for
//! distributed ones.

use super::detector::YEAR_D;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Time constants of the filters \[d\].
pub const FILTERS_D: [f64; 6] = [0.0, 0.25, 1.0, 3.0, 10.0, 30.0];
/// The filter whose square is the curvature's regressor.
const CURVED: usize = 1;
/// Time constants of what slow filters forget of their start \[d\].
const TRANSIENTS_D: [f64; 2] = [10.0, 30.0];
/// Readings further apart than this \[d\], and than [`HOLE_MEMORIES`] time constants, say nothing about what was between.
const HOLE_D: f64 = 1.5;
/// After as many time constants a filter has forgotten what was before (e^-3 = 5 %).
const HOLE_MEMORIES: f64 = 3.0;
/// Least and greatest time the last reading holds on \[d\]; between, one and a half usual gaps.
const HOLD_D: [f64; 2] = [0.125, 1.5];
const HOLD_GAPS: f64 = 1.5;
/// Weight of the newest gap in the usual one.
const FRESH: f64 = 0.1;
/// Readings are sparse if the usual gap exceeds this \[d\].
const SPARSE_D: f64 = 1.0 / 6.0;

/// Exponential filters of one thermometer's readings.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Filters {
    /// Time of the first reading \[d\].
    first: Option<f64>,
    /// Time of the last reading \[d\].
    last: Option<f64>,
    /// The last reading \[degC\].
    celsius: f64,
    /// Filters at that time \[degC\].
    filtered: [f64; FILTERS_D.len()],
    /// Usual time between readings \[d\].
    gap: f64,
}

impl Filters {
    /// Takes a reading; one that is not finite, or not later than the last, is left out.
    ///
    /// The first reading starts every filter at its own value. After a hole longer than a day and a half and three time
    /// constants a filter starts anew; across shorter ones the temperature is taken as a straight line.
    pub fn push(&mut self, day: f64, celsius: f64) {
        if !celsius.is_finite() || !day.is_finite() || self.last.is_some_and(|last| day <= last) {
            return;
        }
        let passed = self.last.map(|last| day - last);
        for (filtered, memory_d) in self.filtered.iter_mut().zip(FILTERS_D) {
            *filtered = match passed {
                Some(passed) if passed <= HOLE_D.max(HOLE_MEMORIES * memory_d) => {
                    follow(*filtered, self.celsius, celsius, passed, memory_d)
                }
                _ => celsius,
            };
        }
        if let Some(passed) = passed {
            let share = if self.gap > 0.0 { FRESH } else { 1.0 };
            self.gap += share * (passed - self.gap);
        }
        self.first = self.first.or(Some(day));
        self.last = Some(day);
        self.celsius = celsius;
    }

    /// The filters \[degC\] at a time, the last reading holding on for one and a half usual gaps, between three hours and a day
    /// and a half; `None` later, or as long before the last reading. An earlier time has the filters of the last reading.
    pub fn at(&self, day: f64) -> Option<[f64; FILTERS_D.len()]> {
        let passed = day - self.last?;
        let hold = (HOLD_GAPS * self.gap).clamp(HOLD_D[0], HOLD_D[1]);
        if !(passed.abs() <= hold) {
            return None;
        }
        let mut now = self.filtered;
        for (filtered, memory_d) in now.iter_mut().zip(FILTERS_D) {
            *filtered = follow(*filtered, self.celsius, self.celsius, passed.max(0.0), memory_d);
        }
        Some(now)
    }

    /// Whether readings are usually too far apart to resolve the day.
    pub fn is_sparse(&self) -> bool {
        self.gap > SPARSE_D
    }

    /// Time of the first reading \[d\].
    pub fn first_day(&self) -> Option<f64> {
        self.first
    }
}

/// A filter after `passed` days in which the temperature went straight from `from` to `to`.
fn follow(filtered: f64, from: f64, to: f64, passed: f64, memory_d: f64) -> f64 {
    if memory_d <= 0.0 {
        return to;
    }
    let x = passed / memory_d;
    if x <= 0.0 {
        return filtered;
    }
    let gone = -libm::expm1(-x);
    to + (filtered - from) * (1.0 - gone) - (to - from) * gone / x
}

/// Columns of the banks, from filters and from the median of the other rods' ratios.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Regressors {
    /// Reference temperature \[degC\].
    pub reference_c: f64,
    /// Time the yearly cycle and the transients are counted from \[d\]: the first period.
    pub origin: f64,
}

impl Regressors {
    /// Columns of [`super::BankPrior::thermal`].
    pub fn thermal(&self, day: f64, filtered: &[f64; FILTERS_D.len()]) -> Vec<f64> {
        let mut columns: Vec<f64> = filtered.iter().map(|celsius| celsius - self.reference_c).collect();
        columns.push(columns[CURVED] * columns[CURVED]);
        let age = (day - self.origin).max(0.0);
        columns.extend(TRANSIENTS_D.map(|memory_d| libm::exp(-age / memory_d)));
        columns.extend(self.yearly(day));
        columns
    }

    /// Columns of [`super::BankPrior::thermal_and_peers`]; `median` is that of the other rods' N_t / N_0 - 1.
    pub fn thermal_and_peers(&self, day: f64, filtered: &[f64; FILTERS_D.len()], median: f64) -> Vec<f64> {
        let mut columns = self.thermal(day, filtered);
        columns.extend([median, median * median]);
        columns
    }

    /// Columns of [`super::BankPrior::peers`].
    pub fn peers(&self, day: f64, median: f64) -> Vec<f64> {
        let [cosine, sine] = self.yearly(day);
        vec![median, median * median, cosine, sine]
    }

    /// Columns of [`super::BankPrior::blind`].
    pub fn blind(&self, day: f64) -> Vec<f64> {
        self.yearly(day).to_vec()
    }

    /// A yearly cycle that is zero at the origin.
    fn yearly(&self, day: f64) -> [f64; 2] {
        let phase = TAU * (day - self.origin) / YEAR_D;
        [libm::cos(phase) - 1.0, libm::sin(phase)]
    }
}

/// Median of the ratios that are finite; `None` of none. An even number has the mean of the two in the middle.
pub fn median(ratios: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = ratios.filter(|ratio| ratio.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        odd if odd % 2 == 1 => Some(sorted[middle]),
        _ => Some(0.5 * (sorted[middle - 1] + sorted[middle])),
    }
}
