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

use crate::signal::record::time::YEAR_D;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Time constants of the filters \[d\].
pub const FILTERS_D: [f64; 6] = [0.0, 0.25, 1.0, 3.0, 10.0, 30.0];
/// Index of the filter whose square is the regressor of curvature.
const CURVED: usize = 1;
/// Time constants of the transients of slow filters after their start \[d\].
const TRANSIENTS_D: [f64; 2] = [10.0, 30.0];
/// Gap of readings \[d\], and in [`HOLE_MEMORIES`] time constants, beyond which the temperature between them
/// is unknown.
const HOLE_D: f64 = 1.5;
/// Time constants after which a filter has forgotten its state (e^-3 = 5 %).
const HOLE_MEMORIES: f64 = 3.0;
/// Shortest and longest time for which the last reading is held \[d\]; between, one and a half usual gaps.
const HOLD_D: [f64; 2] = [0.125, 1.5];
const HOLD_GAPS: f64 = 1.5;
/// Weight of the newest gap in the usual one.
const FRESH: f64 = 0.1;
/// Readings are sparse if the usual gap exceeds this \[d\].
const SPARSE_D: f64 = 1.0 / 6.0;

/// Exponential filters of one thermometer's readings.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Filters {
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
    /// constants a filter starts again; across shorter ones the temperature is taken as a straight line.
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
        self.last = Some(day);
        self.celsius = celsius;
    }

    /// The filters \[degC\] at a time, the last reading holding on for one and a half usual gaps, between three hours and a day
    /// and a half; `None` later, or as long before the last reading. An earlier time has the filters of the last reading.
    pub fn at(&self, day: f64) -> Option<[f64; FILTERS_D.len()]> {
        let passed = day - self.last?;
        let hold = (HOLD_GAPS * self.gap).clamp(HOLD_D[0], HOLD_D[1]);
        if passed.is_nan() || passed.abs() > hold {
            return None;
        }
        let mut now = self.filtered;
        for (filtered, memory_d) in now.iter_mut().zip(FILTERS_D) {
            *filtered = follow(*filtered, self.celsius, self.celsius, passed.max(0.0), memory_d);
        }
        Some(now)
    }

    /// True if readings are usually too far apart to resolve the day.
    pub fn is_sparse(&self) -> bool {
        self.gap > SPARSE_D
    }

    /// Time of the last reading \[d\].
    pub fn last_day(&self) -> Option<f64> {
        self.last
    }
}

/// A filter after `passed` days in which the temperature changed linearly from `from` to `to`.
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
    /// Origin of time of the yearly cycle and of the transients \[d\]: the first period.
    pub origin: f64,
}

impl Regressors {
    /// Columns of [`super::BankPrior::thermal`].
    pub fn thermal(&self, day: f64, filtered: &[f64; FILTERS_D.len()]) -> Vec<f64> {
        let mut columns: Vec<f64> = filtered
            .iter()
            .map(|celsius| celsius - self.reference_c)
            .collect();
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

/// Median of the ratios that are finite; `None` without any. For an even number, the mean of the two in the
/// middle.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_agree_with_a_fine_integration() {
        let points = [
            (0.0, 10.0),
            (0.05, 14.0),
            (0.07, 9.0),
            (0.5, 9.5),
            (0.5001, 20.0),
            (1.4, 3.0),
        ];
        let mut filters = Filters::default();
        points
            .iter()
            .for_each(|&(day, celsius)| filters.push(day, celsius));
        let end = 1.45;
        let found = filters.at(end).unwrap();
        assert_eq!(found[0], 3.0);
        for (memory_d, found) in FILTERS_D.into_iter().zip(found).skip(1) {
            // Midpoint rule in steps of 5e-6 d: errors of (h / memory)^2 / 24 of the swings.
            let (mut value, h) = (10.0, 5e-6);
            for step in 0..290_000 {
                let t = (f64::from(step) + 0.5) * h;
                let air = points.windows(2).find(|pair| t < pair[1].0).map_or(3.0, |pair| {
                    pair[0].1 + (t - pair[0].0) / (pair[1].0 - pair[0].0) * (pair[1].1 - pair[0].1)
                });
                let slope = (air - value) / memory_d;
                value += h * (air - (value + 0.5 * h * slope)) / memory_d;
            }
            assert!((value - found).abs() < 1e-6, "{memory_d}: {value} {found}");
        }
    }

    #[test]
    fn readings_out_of_turn_are_left_out_and_holes_start_anew() {
        let mut filters = Filters::default();
        assert_eq!(filters.at(0.0), None);
        for hour in 0..48 {
            filters.push(f64::from(hour) / 24.0, 10.0);
        }
        let before = filters.clone();
        for (day, celsius) in [(1.0, 50.0), (47.0 / 24.0, 50.0), (3.0, f64::NAN), (f64::NAN, 1.0)] {
            filters.push(day, celsius);
        }
        assert_eq!(filters, before);
        assert!(!filters.is_sparse() && filters.at(2.05).is_some() && filters.at(2.2).is_none());
        // Ten days: one day and three days are forgotten, ten and thirty are not.
        filters.push(12.0, 20.0);
        let found = filters.at(12.0).unwrap();
        assert!(found[..4].iter().all(|&celsius| celsius == 20.0), "{found:?}");
        assert!(found[4..].iter().all(|&celsius| celsius < 15.0), "{found:?}");
    }

    #[test]
    fn one_reading_a_day_holds_on_for_a_day() {
        let mut filters = Filters::default();
        for day in 0..20 {
            filters.push(f64::from(day), 10.0 + f64::from(day % 3));
        }
        assert!(filters.is_sparse());
        assert!(filters.at(20.4).is_some() && filters.at(20.6).is_none());
    }

    #[test]
    fn columns_are_as_many_as_the_priors_expect() {
        use super::super::{BankPrior, ThermalPrior};
        let regressors = Regressors {
            reference_c: 12.0,
            origin: 100.0,
        };
        let thermal = ThermalPrior {
            slope_mean_per_k: -0.005,
            slope_sd_per_k: 0.01,
            curvature_sd_per_k2: 1e-5,
            is_sparse: false,
        };
        let filtered = [12.0, 14.0, 12.0, 12.0, 12.0, 12.0];
        let columns = regressors.thermal(100.0, &filtered);
        assert_eq!(columns.len(), BankPrior::thermal(0.002, thermal).columns.len());
        assert_eq!(columns, [0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 4.0, 1.0, 1.0, 0.0, 0.0]);
        let both = BankPrior::thermal_and_peers(0.002, thermal).columns.len();
        assert_eq!(regressors.thermal_and_peers(100.0, &filtered, 0.1).len(), both);
        assert_eq!(
            regressors.peers(100.0, 0.1).len(),
            BankPrior::peers(0.002).columns.len()
        );
        assert_eq!(
            regressors.blind(100.0).len(),
            BankPrior::blind(0.002).columns.len()
        );
        for prior in [
            BankPrior::thermal(0.002, thermal),
            BankPrior::peers(0.002),
            BankPrior::blind(0.002),
        ] {
            let total: f64 = prior.members.iter().map(|member| member.probability).sum();
            assert!((total - 1.0).abs() < 1e-12, "{total}");
        }
    }

    #[test]
    fn the_median_of_what_is_there() {
        assert_eq!(median([].into_iter()), None);
        assert_eq!(median([3.0, f64::NAN, 1.0, 2.0].into_iter()), Some(2.0));
        assert_eq!(median([3.0, 1.0].into_iter()), Some(2.0));
    }
}
