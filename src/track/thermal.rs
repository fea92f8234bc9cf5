//! The rod's temperature from the thermometer's: first-order lags.
//!
//! A rod follows the air by dL/dt = (T - L) / lag. For an air temperature that is a straight line from (t_0, T_0) to
//! (t_1, T_1) the solution is closed, with x = (t_1 - t_0) / lag:
//!
//! ```text
//! L_1 = T_1 + (L_0 - T_0) e^-x - (T_1 - T_0) (1 - e^-x) / x
//! ```

use crate::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};

/// The thermal lags tried \[s\]: a bar of 7 cm follows the air by about two hours.
pub const LAGS_S: [f64; 6] = [0.0, 3600.0, 7200.0, 14_400.0, 28_800.0, 57_600.0];

/// Readings further apart than this, and than [`HOLE_LAGS`] lags, say nothing about what was between \[s\].
const HOLE_S: f64 = 6.0 * 3600.0;
/// After as many lags the rod has forgotten what was before (e^-3 = 5 %).
const HOLE_LAGS: f64 = 3.0;
/// How long the last reading holds on \[s\].
const HOLD_S: f64 = 3.0 * 3600.0;

/// First-order low passes dT_lag/dt = (T - T_lag) / lag, one per lag, run along the readings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Thermal {
    /// The lags \[s\].
    pub lags_s: Vec<f64>,
    /// Time of the first reading, or of the first after a hole that made dense readings start anew.
    pub first: Option<Timestamp>,
    /// Time from which there is no hole even for the slowest low pass.
    #[serde(default)]
    pub unbroken: Option<Timestamp>,
    /// Time of the last reading.
    pub time: Option<Timestamp>,
    /// The last reading \[degC\].
    pub last_c: f64,
    /// The low-passed temperatures at that time \[degC\].
    pub lagged_c: Vec<f64>,
}

impl Thermal {
    /// Low passes that have seen nothing.
    pub fn new(lags_s: Vec<f64>) -> Self {
        Self {
            lagged_c: vec![0.0; lags_s.len()],
            lags_s,
            first: None,
            unbroken: None,
            time: None,
            last_c: 0.0,
        }
    }

    /// Takes a reading; one that is not later than the last, or not finite, is left out.
    ///
    /// The first reading starts every low pass at its own value. After a hole longer than six hours and three lags a
    /// low pass starts anew; it keeps what it remembers across shorter ones, the temperature between taken as a
    /// straight line.
    pub fn push(&mut self, reading: Reading) {
        if !reading.celsius.is_finite() || self.time.is_some_and(|last| reading.time <= last) {
            return;
        }
        let passed_s = self.time.map(|last| reading.time.seconds_since(last));
        for (lagged, &lag_s) in self.lagged_c.iter_mut().zip(&self.lags_s) {
            *lagged = match passed_s {
                Some(passed_s) if passed_s <= HOLE_S.max(HOLE_LAGS * lag_s) => {
                    follow(*lagged, self.last_c, reading.celsius, passed_s, lag_s)
                }
                _ => reading.celsius,
            };
        }
        if passed_s.is_none_or(|passed_s| passed_s > HOLE_S.max(self.settling_s())) {
            // Readings that were sparse before (one a week) never settle, and must not wait for it each time.
            let was_settled = self.time.is_none_or(|end| self.is_unbroken_until(end));
            if was_settled {
                self.first = Some(reading.time);
            }
            self.unbroken = Some(reading.time);
        }
        self.time = Some(reading.time);
        self.last_c = reading.celsius;
    }

    /// How long the slowest low pass remembers \[s\].
    fn settling_s(&self) -> f64 {
        HOLE_LAGS * self.lags_s.iter().copied().fold(0.0, f64::max)
    }

    /// Whether readings without a hole up to `end` are as long as the slowest low pass remembers.
    fn is_unbroken_until(&self, end: Timestamp) -> bool {
        self.unbroken
            .is_some_and(|begin| end.seconds_since(begin) >= self.settling_s())
    }

    /// Whether the slowest low pass has forgotten at `time` that it was started at a reading's value.
    pub fn has_settled(&self, time: Timestamp) -> bool {
        self.first
            .is_some_and(|first| time.seconds_since(first) >= self.settling_s())
    }

    /// The low-passed temperatures \[degC\], one per lag, at a time up to three hours after the last reading, which
    /// holds on; at an earlier time, up to three hours before, those at the last reading. `None` beyond.
    pub fn at(&self, time: Timestamp) -> Option<Vec<f64>> {
        let passed_s = time.seconds_since(self.time?);
        if passed_s.abs() > HOLD_S {
            return None;
        }
        let now = |(&lagged, &lag_s)| follow(lagged, self.last_c, self.last_c, passed_s.max(0.0), lag_s);
        Some(self.lagged_c.iter().zip(&self.lags_s).map(now).collect())
    }
}

/// The low-passed temperature after `passed_s` in which the air went straight from `from_c` to `to_c`.
fn follow(lagged_c: f64, from_c: f64, to_c: f64, passed_s: f64, lag_s: f64) -> f64 {
    if lag_s <= 0.0 {
        return to_c;
    }
    let x = passed_s / lag_s;
    if x <= 0.0 {
        return lagged_c;
    }
    let gone = -libm::expm1(-x);
    to_c + (lagged_c - from_c) * (1.0 - gone) - (to_c - from_c) * gone / x
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// After weeks of silence the low passes start anew, and teach only once they have forgotten where.
    #[test]
    fn a_hole_in_dense_readings_makes_the_low_passes_settle_again() {
        let hour = 3600.0;
        let mut thermal = Thermal::new(LAGS_S.to_vec());
        (0..100).for_each(|h| thermal.push(reading(f64::from(h) * hour, 10.0)));
        assert!(!thermal.has_settled(at(47.0 * hour)) && thermal.has_settled(at(99.0 * hour)));
        let back = 500.0;
        (0..100).for_each(|h| thermal.push(reading((back + f64::from(h)) * hour, 20.0)));
        assert!(!thermal.has_settled(at((back + 47.0) * hour)));
        assert!(thermal.has_settled(at((back + 48.0) * hour)));
        // One reading a week never settles: it waits once, not every time.
        let mut weekly = Thermal::new(LAGS_S.to_vec());
        for week in 0..5 {
            let time = f64::from(week) * 168.0 * hour;
            weekly.push(reading(time, 10.0));
            assert_eq!(weekly.has_settled(at(time)), week > 0, "week {week}");
        }
    }

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_nanos(1_700_000_000_000_000_000).plus_seconds(seconds)
    }

    fn reading(seconds: f64, celsius: f64) -> Reading {
        Reading {
            time: at(seconds),
            celsius,
        }
    }

    #[test]
    fn agrees_with_a_fine_integration() {
        let points = [
            (0.0, 10.0),
            (1800.0, 14.0),
            (2400.0, 9.0),
            (9000.0, 9.5),
            (9001.0, 20.0),
        ];
        let mut thermal = Thermal::new(LAGS_S.to_vec());
        points.iter().for_each(|&(t, c)| thermal.push(reading(t, c)));
        let found = thermal.at(at(12_000.0)).unwrap();
        for (lag_s, found) in LAGS_S.iter().zip(found).skip(1) {
            // Midpoint rule in steps of a tenth of a second: error (h / lag)^2 / 24 of the swings, below 1e-9.
            let (mut value, h) = (10.0, 0.1);
            for step in 0..120_000 {
                let t = (step as f64 + 0.5) * h;
                let air = points.windows(2).find(|pair| t < pair[1].0).map_or(20.0, |pair| {
                    let share = (t - pair[0].0) / (pair[1].0 - pair[0].0);
                    pair[0].1 + share * (pair[1].1 - pair[0].1)
                });
                let slope = (air - value) / lag_s;
                value += h * (air - (value + 0.5 * h * slope)) / lag_s;
            }
            assert!((value - found).abs() < 1e-6, "{lag_s}: {value} {found}");
        }
    }

    #[test]
    fn a_day_loses_amplitude_and_comes_late() {
        // Readings every five minutes of a daily cosine: the gain and delay of a first-order lag.
        let mut thermal = Thermal::new(LAGS_S.to_vec());
        let omega = TAU / 86_400.0;
        for i in 0..=12 * 24 * 10 {
            let t = 300.0 * f64::from(i);
            thermal.push(reading(t, 10.0 * (omega * t).cos()));
        }
        let end = 10.0 * 86_400.0;
        for (found, lag_s) in thermal.at(at(end)).unwrap().iter().zip(LAGS_S) {
            let x = omega * lag_s;
            let steady = 10.0 / (1.0 + x * x).sqrt() * (omega * end - x.atan()).cos();
            // A chord over five minutes is off by (omega h)^2 / 8, the start by e^-15 at sixteen hours.
            assert!((found - steady).abs() < 1e-3, "{lag_s}: {found} {steady}");
        }
    }

    #[test]
    fn holes_late_readings_and_stale_ones() {
        let mut thermal = Thermal::new(LAGS_S.to_vec());
        assert_eq!(thermal.at(at(0.0)), None);
        thermal.push(reading(0.0, 10.0));
        thermal.push(reading(600.0, 20.0));
        let before = thermal.clone();
        thermal.push(reading(600.0, 50.0));
        thermal.push(reading(-600.0, 50.0));
        thermal.push(reading(700.0, f64::NAN));
        assert_eq!(thermal, before);
        assert!(thermal.at(at(600.0 + HOLD_S)).is_some());
        assert_eq!(thermal.at(at(601.0 + HOLD_S)), None);
        // Seven hours: what was two hours slow is forgotten, what was four hours slow is not.
        thermal.push(reading(600.0 + 7.0 * 3600.0, 0.0));
        assert!(
            thermal.lagged_c[..3].iter().all(|&c| c == 0.0),
            "{:?}",
            thermal.lagged_c
        );
        assert!(
            thermal.lagged_c[3..].iter().all(|&c| c > 1.0),
            "{:?}",
            thermal.lagged_c
        );
    }

    #[test]
    fn one_reading_a_day_is_exact_without_lag() {
        let mut thermal = Thermal::new(LAGS_S.to_vec());
        for day in 0..20 {
            let celsius = f64::from(day * 7 % 11);
            thermal.push(reading(86_400.0 * f64::from(day), celsius));
            let found = thermal.at(at(86_400.0 * f64::from(day) + 600.0)).unwrap();
            assert_eq!(found[0], celsius);
        }
    }
}
