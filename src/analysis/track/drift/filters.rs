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
        let end = 1.4;
        let found = filters.at(end).unwrap();
        assert_eq!(found[0], 3.0);
        for (memory_d, found) in FILTERS_D.into_iter().zip(found).skip(1) {
            // Midpoint rule in steps of 5e-6 d: errors of (h / memory)^2 / 24 of the swings.
            let (mut value, h) = (10.0, 5e-6);
            for step in 0..280_000 {
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
    fn a_trend_goes_on_and_dies_away() {
        let mut filters = Filters::default();
        // 1 K an hour for two days: the low pass of two hours lags by them to e^-24.
        for hour in 0..=48 {
            filters.push(f64::from(hour) / 24.0, f64::from(hour));
        }
        let [air, six_hours, ..] = filters.at(2.0 + 0.5 / 24.0).unwrap();
        let ahead_k = 4.0 * (1.0 - (-0.125_f64).exp());
        assert!((air - 48.0 - ahead_k).abs() < 1e-9, "{air}");
        let (x, behind) = (0.5 / 6.0_f64, 6.0 * (1.0 - (-8.0_f64).exp()));
        let expected = air - behind * (-x).exp() - ahead_k * (1.0 - (-x).exp()) / x;
        assert!((six_hours - expected).abs() < 1e-9, "{six_hours} {expected}");
        // A state of an earlier version has no trend until it has seen some hours.
        let mut earlier = Filters {
            trailing: None,
            ..filters
        };
        assert_eq!(earlier.at(2.02).unwrap()[0], 48.0);
        earlier.push(2.0 + 1.0 / 24.0, 49.0);
        assert_eq!(earlier.at(2.05).unwrap()[0], 49.0);
    }

    /// Days of 6 K and readings every hour in digits of 0.1 K: the air within an hour of the last reading, at any time of day.
    #[test]
    fn a_trend_misses_less_of_the_air_than_holding() {
        let air = |day: f64| 3.0 * (std::f64::consts::TAU * day).sin();
        let mut filters = Filters::default();
        let (mut missed, mut held, mut stated) = (0.0, 0.0, 0.0);
        for hour in 0..24 * 10 {
            let read = f64::from(hour) / 24.0;
            let celsius = (air(read) * 10.0).round() / 10.0;
            filters.push(read, celsius);
            for minute in [15.0, 30.0, 45.0, 60.0] {
                let day = read + minute / 1440.0;
                if day > 2.0 {
                    missed += (filters.at(day).unwrap()[0] - air(day)).powi(2);
                    held += (celsius - air(day)).powi(2);
                    stated += filters.unread_k2(day).unwrap()[0][0];
                }
            }
        }
        // 0.32 by another program; the low pass is late by two hours at the turns of the day.
        assert!(missed < 0.4 * held, "{}", missed / held);
        // Beside the slope, its change is missed too, which counts less within the hour than at its end.
        let ratio = stated / missed;
        assert!((0.9..1.4).contains(&ratio), "{ratio}");
    }

    #[test]
    fn between_dense_readings_the_air_is_on_the_line() {
        let mut filters = Filters::default();
        for hour in 0..48 {
            filters.push(f64::from(hour) / 24.0, f64::from(hour % 5));
        }
        let (last, next) = (47.0 / 24.0, (2.0, 6.0));
        let at = last + 0.25 / 24.0;
        let mut read = filters.clone();
        read.push(at, 3.0);
        let found = filters.before(next, at).unwrap();
        for (found, read) in found.iter().zip(read.at(at).unwrap()) {
            assert!((found - read).abs() < 1e-12, "{found} {read}");
        }
        assert_eq!(filters.before(next, 2.01), None);
        assert_eq!(filters.before((2.5, 6.0), at), None);
        let mut sparse = Filters::default();
        (0..9).for_each(|day| sparse.push(f64::from(day), 10.0));
        assert_eq!(sparse.before((9.0, 12.0), 8.5), None);
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

    /// Hourly readings of air with a daily cycle, weather and a season, and holes of two to forty days: what the filters miss after one.
    #[test]
    fn holes_leave_open_where_the_filters_are() {
        let mut generator = random::stream(31, 0);
        let keep = libm::exp(-1.0 / 72.0_f64);
        let (mut weather, mut filters, mut whole) = (0.0, Filters::default(), Filters::default());
        let (mut missed, mut stated) = ([0.0; FILTERS_D.len()], [0.0; FILTERS_D.len()]);
        let mut looks = 0;
        for hour in 0..24 * 20_000 {
            let kick: f64 = StandardNormal.sample(&mut generator);
            weather = keep * weather + 2.5 * libm::sqrt(1.0 - keep * keep) * kick;
            let day = f64::from(hour) / 24.0;
            let phase = |period: f64| libm::sin(std::f64::consts::TAU * day / period);
            let celsius = weather + 3.0 * phase(1.0) + 7.0 * phase(365.25);
            whole.push(day, celsius);
            // A hole each hundred days, none in the first 300; its length goes round.
            let [number, within] = [hour / 2400, hour % 2400];
            let hole = [48, 5 * 24 + 7, 12 * 24 + 13, 40 * 24 + 5][number as usize % 4];
            if number < 3 || within >= hole {
                filters.push(day, celsius);
            }
            if number >= 3 && [0, 6, 24].contains(&(within - hole)) {
                looks += 1;
                let (truth, known) = (whole.at(day).unwrap(), filters.at(day).unwrap());
                let cov = filters.unread_k2(day).unwrap();
                for at in 0..FILTERS_D.len() {
                    missed[at] += (truth[at] - known[at]).powi(2);
                    stated[at] += cov[at][at];
                }
            }
            if number >= 3 && within == hole + 24 {
                assert!(!filters.is_sparse(), "a hole is not the usual gap");
            }
        }
        for at in 1..FILTERS_D.len() {
            let ratio = (stated[at] / missed[at]).sqrt();
            // A straight line through a hole knows the season, which is much of V for the slow ones.
            assert!((0.7..2.5).contains(&ratio), "{at}: {ratio} of {looks}");
        }
        assert!(filters.lost_k2[1] == 0.0 && filters.known(20_000.0, None).is_some());
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
