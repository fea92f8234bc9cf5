//! The temperature beside a record: its mean over the record's time span, and the readings since the
//! record before, thinned to one mean per five minutes. A single wild reading moves neither.

use super::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Greatest age of the last reading when none falls into a record \[s\].
pub const STALE_S: i64 = 900;
/// Time for which readings are remembered for samples that come later \[s\].
const REMEMBERED_S: i64 = 86_400;
/// Most of them that are remembered one by one.
const REMEMBERED: usize = 2000;
/// Most seconds of readings kept.
const KEPT: usize = 20_000;
/// Length of the means that are handed out, aligned to 1970 \[s\].
const BIN_S: i64 = 300;
/// Most sums that wait to be handed out; beyond, the oldest are merged.
const FRESH: usize = 4096;

/// Possible temperatures of a rod in a building \[degC\]: iron in the sun stays below, and a common digital thermometer gives
/// 85 when it was just switched on.
pub const POSSIBLE_C: RangeInclusive<f64> = -60.0..=80.0;
/// Distance from their median beyond which one of three or more readings of five minutes, or of a record, is wild \[K\].
const WILD_K: f64 = 10.0;

/// One temperature reading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Time of the reading.
    pub time: Timestamp,
    /// Temperature \[degC\].
    pub celsius: f64,
}

/// Sum of some readings.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Sum {
    celsius: f64,
    /// Sum of seconds since the key under which it is kept.
    after_s: f64,
    count: f64,
}

/// Readings of one channel, as sum and count per second.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Temperature {
    seconds: BTreeMap<i64, (f64, u32)>,
    last: Option<i64>,
    /// Sums not handed out yet, by their first second.
    fresh: BTreeMap<i64, Sum>,
}

impl Temperature {
    /// Takes a reading \[degC\]; one that is not finite is ignored.
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
        let sum = self.fresh.entry(second).or_default();
        sum.celsius += celsius;
        sum.count += 1.0;
        if self.fresh.len() > FRESH {
            self.thin();
        }
    }

    /// Adds the later readings of another one.
    pub fn append(&mut self, later: Self) {
        for (second, (celsius, count)) in later.seconds {
            let (sum, number) = self.seconds.entry(second).or_default();
            *sum += celsius;
            *number += count;
        }
        while self.seconds.len() > KEPT {
            self.seconds.pop_first();
        }
        self.last = self.last.max(later.last);
        for (second, more) in later.fresh {
            let sum = self.fresh.entry(second).or_default();
            sum.celsius += more.celsius;
            sum.after_s += more.after_s;
            sum.count += more.count;
        }
        if self.fresh.len() > FRESH {
            self.thin();
        }
    }

    /// Hands out the readings up to and including the second of `end`, ascending, one mean per five minutes at
    /// the mean of their times (to the second). None is handed out twice; a late one leaves with the next record.
    pub fn take(&mut self, end: Timestamp) -> Vec<Reading> {
        let second = end.as_nanos().div_euclid(1_000_000_000);
        let later = self.fresh.split_off(&second.saturating_add(1));
        merged(std::mem::replace(&mut self.fresh, later), BIN_S)
            .into_iter()
            .map(|(first, sum)| Reading {
                time: Timestamp::from_nanos(
                    first
                        .saturating_add((sum.after_s / sum.count).round() as i64)
                        .saturating_mul(1_000_000_000),
                ),
                celsius: sum.celsius / sum.count,
            })
            .collect()
    }

    /// Bounds memory: means over ever longer stretches, the oldest first, until half the room is free.
    fn thin(&mut self) {
        let mut width_s = BIN_S;
        while self.fresh.len() > FRESH / 2 {
            let newest = self.fresh.keys().nth_back(FRESH / 8).copied().unwrap_or(i64::MAX);
            // Whole bins only, so that a mean never depends on when room was made.
            let boundary = newest.div_euclid(width_s) * width_s;
            let mut recent = self.fresh.split_off(&boundary);
            let mut old = merged(std::mem::take(&mut self.fresh), width_s);
            old.append(&mut recent);
            self.fresh = old;
            width_s = width_s.saturating_mul(2);
            if width_s > (1 << 40) {
                // Stamps strewn over centuries: the oldest go.
                while self.fresh.len() > FRESH / 2 {
                    self.fresh.pop_first();
                }
            }
        }
    }

    /// True if a reading ever came.
    pub fn has_any(&self) -> bool {
        self.last.is_some()
    }

    /// Forgets what was not handed out, and of the rest all but the latest day; of many readings one mean a minute stays.
    pub fn remember(&mut self) {
        self.fresh.clear();
        let from = self
            .last
            .map_or(i64::MIN, |last| last.saturating_sub(REMEMBERED_S));
        self.seconds = self.seconds.split_off(&from);
        if self.seconds.len() > REMEMBERED {
            let mut minutes: BTreeMap<i64, (i64, f64, u32)> = BTreeMap::new();
            for (second, (celsius, count)) in &self.seconds {
                let (latest, sum, number) = minutes.entry(second.div_euclid(60)).or_default();
                *latest = *second;
                *sum += celsius;
                *number += count;
            }
            let minutes = minutes.into_values();
            self.seconds = minutes
                .map(|(latest, sum, number)| (latest, (sum, number)))
                .collect();
        }
    }

    /// True if readings have come beyond this time.
    pub fn reaches(&self, time: Timestamp) -> bool {
        self.last
            .is_some_and(|last| last > time.as_nanos().div_euclid(1_000_000_000))
    }

    /// The mean from `start` to `end`; with no reading in between, the last one before if it is recent.
    pub fn mean(&self, start: Timestamp, end: Timestamp) -> Option<f64> {
        let second = |time: Timestamp| time.as_nanos().div_euclid(1_000_000_000);
        let (from, to) = (second(start), second(end).max(second(start)));
        let within = || self.seconds.range(from..=to).map(|(_, reading)| *reading);
        let is_kept = plausible(within().map(|(sum, count)| sum / f64::from(count)));
        let (sum, count) = within()
            .filter(|(sum, count)| is_kept(sum / f64::from(*count)))
            .fold((0.0, 0u32), |all, reading| (all.0 + reading.0, all.1 + reading.1));
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

/// Sums over bins of `width_s`, each under its first second, without what is not [`plausible`] beside the others of its bin.
fn merged(sums: BTreeMap<i64, Sum>, width_s: i64) -> BTreeMap<i64, Sum> {
    let sums: Vec<(i64, Sum)> = sums.into_iter().collect();
    let bins = sums.chunk_by(|one, next| one.0.div_euclid(width_s) == next.0.div_euclid(width_s));
    bins.map(|bin| {
        let start = bin[0].0;
        let is_kept = plausible(bin.iter().map(|(_, sum)| sum.celsius / sum.count));
        let mut whole = Sum::default();
        for (first, sum) in bin.iter().filter(|(_, sum)| is_kept(sum.celsius / sum.count)) {
            whole.celsius += sum.celsius;
            whole.after_s += sum.after_s + sum.count * (first - start) as f64;
            whole.count += sum.count;
        }
        (start, whole)
    })
    .collect()
}

/// Tells which of some readings of about the same time count: of those that are possible, if any are, those within [`WILD_K`] of their
/// median, if there are three. Readings of which none is possible all count: what judges them afterwards says so.
fn plausible(celsius: impl Iterator<Item = f64>) -> impl Fn(f64) -> bool {
    let mut possible: Vec<f64> = celsius.filter(|celsius| POSSIBLE_C.contains(celsius)).collect();
    let middle = possible.len() / 2;
    let median = (possible.len() >= 3).then(|| *possible.select_nth_unstable_by(middle, f64::total_cmp).1);
    move |celsius| {
        possible.is_empty()
            || (POSSIBLE_C.contains(&celsius)
                && median.is_none_or(|median| (celsius - median).abs() <= WILD_K))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(second: i64) -> Timestamp {
        Timestamp::from_nanos(second * 1_000_000_000)
    }

    #[test]
    fn readings_leave_once_and_thinned() {
        let mut temperature = Temperature::default();
        for second in (0..1200).step_by(10) {
            temperature.push(at(second), second as f64 / 64.0);
        }
        let first = temperature.take(at(700));
        let reading = |second: i64| Reading {
            time: at(second),
            celsius: second as f64 / 64.0,
        };
        // Means over 0..300, 300..600 and 600..=700; every mean time is the mean value here.
        assert_eq!(first, [reading(145), reading(445), reading(650)]);
        // A late one comes with the next record, before the rest of the five minutes that were cut.
        temperature.push(at(20), 1.0);
        let second = temperature.take(at(2000));
        assert_eq!(second.len(), 3);
        assert_eq!((second[0].time, second[0].celsius), (at(20), 1.0));
        assert_eq!(second[1], reading(800));
        assert!(temperature.take(at(5000)).is_empty());
    }

    #[test]
    fn a_month_without_a_record_stays_small_and_keeps_its_mean() {
        let mut temperature = Temperature::default();
        let count = 40 * 1440i64;
        for minute in 0..count {
            temperature.push(at(60 * minute), (minute % 1440) as f64);
            assert!(temperature.fresh.len() <= FRESH);
        }
        // A stamp from the far future stays behind.
        temperature.push(at(4_000_000_000), 99.0);
        let readings = temperature.take(at(60 * count));
        assert!(
            readings.len() > 500 && readings.len() <= FRESH,
            "{}",
            readings.len()
        );
        assert!(readings.windows(2).all(|pair| pair[0].time < pair[1].time));
        assert!(readings.iter().all(|reading| reading.celsius < 1440.0));
        // The last days are at five minutes still.
        let last = &readings[readings.len() - 10..];
        assert!(
            last.windows(2)
                .all(|pair| pair[1].time.seconds_since(pair[0].time) == 300.0)
        );
    }

    /// Readings of a digital thermometer that was just switched on, of one with a broken wire, and a wild one that could be.
    #[test]
    fn a_wild_reading_moves_neither_five_minutes_nor_the_record() {
        for wild in [85.0, -127.0, 40.0] {
            let mut temperature = Temperature::default();
            for second in [0, 60, 120, 180] {
                temperature.push(at(second), if second == 0 { wild } else { 7.0 });
            }
            assert_eq!(temperature.mean(at(0), at(300)), Some(7.0), "{wild}");
            let readings = temperature.take(at(300));
            assert_eq!(readings.len(), 1);
            assert_eq!((readings[0].time, readings[0].celsius), (at(120), 7.0), "{wild}");
        }
        // Alone it stays what it is, for the judgement of the thermometer.
        let mut temperature = Temperature::default();
        temperature.push(at(0), -127.0);
        assert_eq!(temperature.mean(at(0), at(300)), Some(-127.0));
        assert_eq!(temperature.take(at(300))[0].celsius, -127.0);
    }

    #[test]
    fn the_latest_day_is_remembered_by_the_minute() {
        let mut temperature = Temperature::default();
        for second in 0..20_000 {
            temperature.push(at(second), second as f64 / 64.0);
        }
        temperature.remember();
        assert!(temperature.take(Timestamp::MAX).is_empty());
        assert_eq!(temperature.seconds.len(), 334);
        // Minute 100 ends with second 6059.
        assert_eq!(temperature.mean(at(6059), at(6060)), Some(6029.5 / 64.0));
        // Few stay one by one, of the latest day.
        let mut temperature = Temperature::default();
        for hour in 0..40 {
            temperature.push(at(3600 * hour), hour as f64);
        }
        temperature.remember();
        assert_eq!(temperature.seconds.len(), 25);
        assert_eq!(temperature.mean(at(3600 * 39), at(3600 * 39)), Some(39.0));
    }

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
