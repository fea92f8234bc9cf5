//! The temperature beside a record: its mean over the record's time span.

use super::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How old the last reading may be when none falls into a record \[s\].
const STALE_S: i64 = 900;
/// Seconds of readings kept.
const KEPT: usize = 20_000;

/// One temperature reading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// When.
    pub time: Timestamp,
    /// How warm \[degC\].
    pub celsius: f64,
}

/// Readings of one channel, as sum and count a second.
#[derive(Debug, Clone, Default)]
pub(super) struct Temperature {
    seconds: BTreeMap<i64, (f64, u32)>,
    last: Option<i64>,
}

impl Temperature {
    /// Takes a reading \[degC\]; one that is not finite counts for nothing.
    pub fn push(&mut self, time: Timestamp, celsius: f64) {
        if !celsius.is_finite() {
            return;
        }
        let second = time.as_nanos().div_euclid(1_000_000_000);
        let (sum, count) = self.seconds.entry(second).or_default();
        *sum += celsius;
        *count += 1;
        self.last = self.last.max(Some(second));
        if self.seconds.len() > KEPT {
            self.seconds.pop_first();
        }
    }

    /// Whether readings have come beyond this time.
    pub fn reaches(&self, time: Timestamp) -> bool {
        self.last
            .is_some_and(|last| last > time.as_nanos().div_euclid(1_000_000_000))
    }

    /// The mean from `start` to `end`; with no reading in between, the last one before if it is recent.
    pub fn mean(&self, start: Timestamp, end: Timestamp) -> Option<f64> {
        let second = |time: Timestamp| time.as_nanos().div_euclid(1_000_000_000);
        let (from, to) = (second(start), second(end).max(second(start)));
        let (sum, count) = self
            .seconds
            .range(from..=to)
            .fold((0.0, 0u32), |(sum, count), (_, reading)| {
                (sum + reading.0, count + reading.1)
            });
        if count > 0 {
            return Some(sum / f64::from(count));
        }
        let (_, (sum, count)) = self
            .seconds
            .range(from.saturating_sub(STALE_S)..from)
            .next_back()?;
        Some(sum / f64::from(*count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_over_the_span_or_the_last_before() {
        let at = |second: i64| Timestamp::from_nanos(second * 1_000_000_000);
        let mut temperature = Temperature::default();
        temperature.push(at(0), 10.0);
        temperature.push(at(60), 12.0);
        temperature.push(at(120), 14.0);
        temperature.push(at(121), f64::NAN);
        assert_eq!(temperature.mean(at(30), at(130)), Some(13.0));
        assert_eq!(temperature.mean(at(61), at(100)), Some(12.0));
        assert_eq!(temperature.mean(at(121 + STALE_S), at(2000)), None);
        assert!(temperature.reaches(at(100)) && !temperature.reaches(at(120)));
    }
}
