//! Exponential filters of temperature readings at any times.
//!
//! A filter of time constant tau follows the readings T by dF/dt = (T - F) / tau. Between readings the temperature is taken as a
//! straight line, for which the solution is closed, with x = (t_1 - t_0) / tau:
//!
//! ```text
//! F_1 = T_1 + (F_0 - T_0) e^-x - (T_1 - T_0) (1 - e^-x) / x
//! ```
//!
//! Where readings resolve the day, the temperature after the last of them, until the next is there, goes on by its trend, which dies
//! away:
//!
//! ```text
//! T(t) = T_1 + s D (1 - e^-(t - t_1)/D),    s = (T_1 - L_1) / tau_L,    D = 4 h
//! ```
//!
//! with L the low pass of tau_L = 2 h: that of a steady slope lags by tau_L. Sparse readings hold.
//!
//! Of a time without readings, longer than usual by far, nothing is known. After it a filter is off by the share of its memory that the time
//! has, of as much as it is off the readings at other times, in mean square V; and it forgets that like everything else:
//!
//! ```text
//! W_1 = W_0 e^-2x + V (1 - e^-x)^2 after such a hole,    W_1 = W_0 e^-2x else
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
/// Time constant of the low pass that tells the trend of the temperature \[d\].
const TREND_D: f64 = 1.0 / 12.0;
/// Time in which a trend dies away \[d\]: a sixth of the daily cycle.
const TREND_LASTS_D: f64 = 1.0 / 6.0;
/// Weight of the newest gap in the usual one.
const FRESH: f64 = 0.1;
/// Readings are sparse if the usual gap exceeds this \[d\].
const SPARSE_D: f64 = 1.0 / 6.0;
/// Longest gap that says how the air wanders \[d\]: later its changes grow no more.
const WANDER_D: f64 = 10.0;
/// Least weight of the newest change in their mean square.
const FRESH_CHANGE: f64 = 1.0 / 30.0;
/// Usual gaps beyond which a time without readings is a hole, if it is one of [`HOLE_D`]; and most of them that a gap counts for.
const HOLE_GAPS: f64 = 3.0;
const LONGEST_GAPS: f64 = 10.0;
/// Longest time over which the filters' distance from the readings is averaged \[d\].
const SPREAD_D: f64 = 60.0;
/// Correlation of the errors of two filters after a hole: they share the distance of the present reading from its mean.
const SHARED: f64 = 0.5;
/// Variance of an error that counts as none \[K^2\]: (0.02 K)^2.
const NOTHING_K2: f64 = 4e-4;

/// Exponential filters of one thermometer's readings.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Filters {
    /// Time of the last reading \[d\].
    last: Option<f64>,
    /// The last reading \[degC\].
    celsius: f64,
    /// Filters at that time \[degC\].
    filtered: [f64; FILTERS_D.len()],
    /// Low pass of two hours at that time, which tells the trend \[degC\]; `None` before a reading of this version.
    #[serde(default)]
    trailing: Option<f64>,
    /// Usual time between readings \[d\].
    gap: f64,
    /// Mean square change between readings over (gap / 1 d)^0.75 \[K^2\].
    #[serde(default)]
    wander_k2: f64,
    /// Mean square of what the trend misses of the next reading, over the time passed \[K^2/d\].
    #[serde(default)]
    missed_k2_per_d: f64,
    /// Weight of the newest change in both; zero before the first.
    #[serde(default)]
    newest: f64,
    /// V: mean square distance of each filter from the readings \[K^2\], and the time over which it is averaged \[d\].
    #[serde(default)]
    spread_k2: [f64; FILTERS_D.len()],
    #[serde(default)]
    spread_over_d: f64,
    /// W: variance of each filter's error by holes before the last reading \[K^2\].
    #[serde(default)]
    lost_k2: [f64; FILTERS_D.len()],
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
    /// constants a filter starts again; across shorter ones the temperature is taken as a straight line. How far off that may be is
    /// remembered.
    pub fn push(&mut self, day: f64, celsius: f64) {
        if !celsius.is_finite() || !day.is_finite() || self.last.is_some_and(|last| day <= last) {
            return;
        }
        let passed = self.last.map(|last| day - last);
        if let Some(passed) = passed.filter(|passed| *passed <= WANDER_D) {
            self.learn(passed, celsius);
        }
        let is_hole = passed.is_some_and(|passed| passed > HOLE_D.max(HOLE_GAPS * self.gap));
        self.lost_k2 = self.lost_after(passed.unwrap_or(0.0), is_hole);
        for (filtered, memory_d) in self.filtered.iter_mut().zip(FILTERS_D) {
            *filtered = match passed {
                Some(passed) if passed <= HOLE_D.max(HOLE_MEMORIES * memory_d) => {
                    follow(*filtered, self.celsius, celsius, passed, memory_d)
                }
                _ => celsius,
            };
        }
        self.trailing = Some(match (passed, self.trailing) {
            (Some(passed), Some(trailing)) if passed <= HOLE_D => {
                follow(trailing, self.celsius, celsius, passed, TREND_D)
            }
            _ => celsius,
        });
        if let Some(passed) = passed {
            if !is_hole {
                self.learn_spread(passed, celsius);
            }
            let share = if self.gap > 0.0 { FRESH } else { 1.0 };
            // One long hole is not the usual gap of the readings after it.
            let most = if self.gap > 0.0 {
                HOLE_D + LONGEST_GAPS * self.gap
            } else {
                passed
            };
            self.gap += share * (passed.min(most) - self.gap);
        }
        self.last = Some(day);
        self.celsius = celsius;
    }

    /// The filters \[degC\] at a time, the last reading and its trend holding on for one and a half usual gaps, between three hours and a
    /// day and a half; `None` later, or as long before the last reading. An earlier time has the filters of the last reading.
    pub fn at(&self, day: f64) -> Option<[f64; FILTERS_D.len()]> {
        let passed = day - self.last?;
        if passed.is_nan() || passed.abs() > self.hold_d() {
            return None;
        }
        let passed = passed.max(0.0);
        Some(self.moved_on(passed, self.air_c(passed)))
    }

    /// The filters \[degC\] at a time between the last reading and the next, (day, degC), on the line between them; `None` where readings
    /// do not resolve the day, or these two are too far apart.
    fn before(&self, next: (f64, f64), day: f64) -> Option<[f64; FILTERS_D.len()]> {
        let passed = day - self.last?;
        let gap = next.0 - self.last?;
        let is_between = (0.0..gap).contains(&passed) && gap <= self.hold_d();
        let celsius = self.celsius + (next.1 - self.celsius) * passed / gap;
        (is_between && !self.is_sparse()).then(|| self.moved_on(passed, celsius))
    }

    /// The filters \[degC\] at a time and the covariance of their errors \[K^2\]: on the line to the next reading, (day, degC), where that
    /// holds, else as [`at`](Self::at) and [`unread_k2`](Self::unread_k2) have them.
    pub fn known(
        &self,
        day: f64,
        next: Option<(f64, f64)>,
    ) -> Option<([f64; FILTERS_D.len()], Option<Covariance>)> {
        match next.and_then(|next| self.before(next, day)) {
            Some(filtered) => Some((filtered, self.lost_cov(day - self.last?))),
            None => Some((self.at(day)?, self.unread_k2(day))),
        }
    }

    /// Longest time from a reading for which it tells the temperature \[d\].
    fn hold_d(&self) -> f64 {
        (HOLD_GAPS * self.gap).clamp(HOLD_D[0], HOLD_D[1])
    }

    /// The filters after `passed_d` days in which the temperature came to `celsius`.
    fn moved_on(&self, passed_d: f64, celsius: f64) -> [f64; FILTERS_D.len()] {
        let mut now = self.filtered;
        for (filtered, memory_d) in now.iter_mut().zip(FILTERS_D) {
            *filtered = follow(*filtered, self.celsius, celsius, passed_d, memory_d);
        }
        now
    }

    /// The temperature by the last reading and its trend \[degC\]; by the reading alone where readings do not resolve the day.
    fn air_c(&self, passed_d: f64) -> f64 {
        let trailing = self.trailing.filter(|_| !self.is_sparse());
        trailing.map_or(self.celsius, |trailing| {
            let trend_k_per_d = (self.celsius - trailing) / TREND_D;
            self.celsius - trend_k_per_d * TREND_LASTS_D * libm::expm1(-passed_d / TREND_LASTS_D)
        })
    }

    /// Learns from the next reading within some days; means are even until they have as many as their memory.
    fn learn(&mut self, passed_d: f64, celsius: f64) {
        self.newest = if self.newest > 0.0 {
            (self.newest / (1.0 + self.newest)).max(FRESH_CHANGE)
        } else {
            1.0
        };
        let change_k2 = (celsius - self.celsius).powi(2) / wandered(passed_d);
        self.wander_k2 += self.newest * (change_k2 - self.wander_k2);
        let missed_k2_per_d = (celsius - self.air_c(passed_d)).powi(2) / passed_d;
        self.missed_k2_per_d += self.newest * (missed_k2_per_d - self.missed_k2_per_d);
    }

    /// Learns how far the filters are off a reading.
    fn learn_spread(&mut self, passed_d: f64, celsius: f64) {
        let share = passed_d / (self.spread_over_d + passed_d);
        for (spread, filtered) in self.spread_k2.iter_mut().zip(self.filtered) {
            *spread += share * ((filtered - celsius).powi(2) - *spread);
        }
        self.spread_over_d = (self.spread_over_d + passed_d).min(SPREAD_D);
    }

    /// Variances of the errors by holes after some days more, which may be a hole themselves \[K^2\].
    fn lost_after(&self, passed_d: f64, is_hole: bool) -> [f64; FILTERS_D.len()] {
        std::array::from_fn(|at| {
            if FILTERS_D[at] <= 0.0 {
                return 0.0;
            }
            let kept = libm::exp(-passed_d / FILTERS_D[at]);
            let gained = if is_hole { self.spread_k2[at] } else { 0.0 };
            let lost = self.lost_k2[at] * kept.powi(2) + gained * (1.0 - kept).powi(2);
            if lost > NOTHING_K2 { lost } else { 0.0 }
        })
    }

    /// Covariance of the errors by holes some days after the last reading \[K^2\]; `None` if there is none.
    fn lost_cov(&self, passed_d: f64) -> Option<Covariance> {
        let sds = self.lost_after(passed_d, false).map(f64::sqrt);
        let shared = |i: usize, j: usize| if i == j { 1.0 } else { SHARED };
        let cov = std::array::from_fn(|i| std::array::from_fn(|j| shared(i, j) * sds[i] * sds[j]));
        sds.iter().any(|sd| *sd > 0.0).then_some(cov)
    }

    /// Covariance of the filters' errors at a time by what the temperature did since its last reading, and in holes before it \[K^2\];
    /// `None` before one.
    ///
    /// Where readings are dense it is what the trend misses; air is smooth within a usual gap, where its error grows with the time and not
    /// with the root of it. Where they are sparse, a day of the air's wander is the intensity, and the first four hours are left to the noise
    /// that a bank learns.
    pub fn unread_k2(&self, day: f64) -> Option<Covariance> {
        let passed = (day - self.last?).max(0.0);
        let all = unread::gained(passed);
        let since: Covariance = if self.is_sparse() {
            let of_dense = unread::gained(passed.min(SPARSE_D));
            let beyond = |i: usize, j: usize| self.wander_k2 * (all[i][j] - of_dense[i][j]);
            std::array::from_fn(|i| std::array::from_fn(|j| beyond(i, j)))
        } else {
            let k2_per_d = self.missed_k2_per_d * (passed / self.gap).min(1.0);
            all.map(|row| row.map(|one| k2_per_d * one))
        };
        Some(match self.lost_cov(passed) {
            None => since,
            Some(lost) => std::array::from_fn(|i| std::array::from_fn(|j| since[i][j] + lost[i][j])),
        })
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

/// t^0.75, with which the mean square change of the air grows within days: at the same hour of days, a correlation near 0.7 from one to
/// the next and 0.3 after three and a half.
fn wandered(passed_d: f64) -> f64 {
    (passed_d * passed_d.sqrt()).sqrt()
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
mod tests;
