//! Exponential filters of temperature readings at any times.
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

use super::unread::{self, Covariance};
use crate::signal::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};

/// Time constants of the filters \[d\].
pub const FILTERS_D: [f64; 6] = [0.0, 0.25, 1.0, 3.0, 10.0, 30.0];
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
/// Power of the time by which the mean square change of the air grows within days: at the same hour of days, a correlation near 0.7 from
/// one to the next and 0.3 after three and a half.
const WANDERS: f64 = 0.75;
/// Longest gap that says how the air wanders \[d\]: later its changes grow no more.
const WANDER_D: f64 = 10.0;
/// Least weight of the newest change in their mean square.
const FRESH_CHANGE: f64 = 1.0 / 30.0;

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
    /// Mean square change between readings over (gap / 1 d)^0.75 \[K^2\].
    #[serde(default)]
    wander_k2: f64,
    /// Weight of the newest change in it; zero before the first.
    #[serde(default)]
    newest: f64,
}

impl Filters {
    /// A copy moved on along readings, ascending in time, up to a time.
    pub fn advanced(&self, readings: &[Reading], until: Timestamp) -> Self {
        let mut filters = self.clone();
        for reading in readings.iter().take_while(|reading| reading.time <= until) {
            filters.push(reading.time.days(), reading.celsius);
        }
        filters
    }

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
            self.learn_wander(passed, celsius - self.celsius);
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

    /// Learns from a change within some days; the mean is even until it has as many as its memory.
    fn learn_wander(&mut self, passed_d: f64, change_k: f64) {
        if passed_d > WANDER_D {
            return;
        }
        self.newest = if self.newest > 0.0 {
            (self.newest / (1.0 + self.newest)).max(FRESH_CHANGE)
        } else {
            1.0
        };
        let change_k2 = change_k * change_k / libm::pow(passed_d, WANDERS);
        self.wander_k2 += self.newest * (change_k2 - self.wander_k2);
    }

    /// Covariance of the filters' errors at a time by what the temperature did since its last reading \[K^2\], beyond what it does in
    /// the four hours for which a reading stands where they are dense; `None` there. A day of the air's wander is the intensity.
    pub fn unread_k2(&self, day: f64) -> Option<Covariance> {
        let passed = (day - self.last?).max(0.0);
        let (all, of_dense) = (unread::gained(passed), unread::gained(passed.min(SPARSE_D)));
        let beyond = |i: usize, j: usize| self.wander_k2 * (all[i][j] - of_dense[i][j]);
        self.is_sparse()
            .then(|| std::array::from_fn(|i| std::array::from_fn(|j| beyond(i, j))))
    }

    /// True if readings are usually too far apart to resolve the day.
    pub fn is_sparse(&self) -> bool {
        self.gap > SPARSE_D
    }

    /// The last reading \[degC\].
    #[cfg(test)]
    pub(super) fn celsius(&self) -> f64 {
        self.celsius
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

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

    /// Air of three days' memory, read every three or four days: what the filters miss a day after a reading, by a simulation of the air in
    /// steps of an hour.
    #[test]
    fn readings_leave_open_what_the_air_does_after_them() {
        let mut generator = random::stream(8, 0);
        let keep = libm::exp(-1.0 / 72.0_f64);
        let (mut air, mut filters) = (0.0, Filters::default());
        let mut followed = [0.0; FILTERS_D.len()];
        let (mut read, mut taken) = (0, 0);
        let (mut missed, mut stated) = ([0.0; FILTERS_D.len()], [0.0; FILTERS_D.len()]);
        for hour in 0..24 * 3000 {
            let kick: f64 = StandardNormal.sample(&mut generator);
            let before = air;
            air = keep * air + 2.5 * libm::sqrt(1.0 - keep * keep) * kick;
            for (followed, memory_d) in followed.iter_mut().zip(FILTERS_D) {
                *followed = follow(*followed, before, air, 1.0 / 24.0, memory_d);
            }
            let day = f64::from(hour) / 24.0;
            if hour == read {
                filters.push(day, air);
                read += if read % 168 == 0 { 72 } else { 96 };
            }
            let is_a_day_later = filters
                .last_day()
                .is_some_and(|last| (day - last - 1.0).abs() < 1e-9);
            if day > 300.0 && is_a_day_later {
                let held = filters.at(day).unwrap();
                let unread_k2 = filters.unread_k2(day).unwrap();
                taken += 1;
                for at in 0..FILTERS_D.len() {
                    missed[at] += (followed[at] - held[at]).powi(2);
                    stated[at] += unread_k2[at][at];
                }
            }
        }
        // The slower filters miss more by the straight line between readings, which is noise of every period.
        for at in 0..2 {
            let ratio = (stated[at] / missed[at]).sqrt();
            assert!((0.8..1.25).contains(&ratio), "{at}: {ratio} of {taken}");
        }
    }
}
