//! A rod's history in columns, by record, or by stretch of time if there are too many records.

use super::days::{Bucket, DAY_NS, Days, Mean};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::Interval;
use crate::site::store::{Point, Reader, Sampling, StoreError};
use serde::Serialize;
use std::collections::BTreeSet;

const SECOND_NS: i64 = 1_000_000_000;

/// Most records read for one answer.
const MOST_READ: u64 = 20_000;

/// A rod's history; all columns are equally long, ascending in time.
#[derive(Debug, Serialize)]
pub struct History {
    /// Id of the rod.
    pub rod: RodId,
    /// Begin of the history.
    pub from: Timestamp,
    /// End of the history, exclusive.
    pub to: Timestamp,
    /// Length of the stretch of time behind each point \[s\]; `null` if each is one record.
    pub step_s: Option<f64>,
    /// Time of the record's first sample, or the beginning of the stretch.
    pub time: Vec<Timestamp>,
    /// Number of records of each point.
    pub records: Vec<u64>,
    /// Number of rejected records of each point.
    pub rejected: Vec<u64>,
    /// Reason why a record does not count on the charts; `null` for one that does, and for stretches.
    pub set_aside: Vec<Option<String>>,
    /// N_t / N_0 at the reference temperature.
    pub relative_force_at_reference: Band,
    /// N_t / N_0 at the measured temperature.
    pub relative_force: Band,
    /// Force given the baseline, at the reference temperature \[N\].
    pub force_at_reference_n: Band,
    /// Force given the baseline, at the measured temperature \[N\].
    pub tracked_force_n: Band,
    /// Force of each record alone \[N\].
    pub axial_force_n: Band,
    /// Temperature \[degC\].
    pub temperature_c: Vec<Option<f64>>,
}

/// A quantity with its 95 % interval, in columns; of a stretch, the means of its records.
#[derive(Debug, Default, Serialize)]
pub struct Band {
    /// Mean.
    pub mean: Vec<Option<f64>>,
    /// 2.5 % quantile.
    pub q025: Vec<Option<f64>>,
    /// 97.5 % quantile.
    pub q975: Vec<Option<f64>>,
}

impl Band {
    fn push(&mut self, values: Option<[f64; 3]>) {
        let [mean, q025, q975] = values.map_or([None; 3], |values| values.map(Some));
        self.mean.push(mean);
        self.q025.push(q025);
        self.q975.push(q975);
    }

    fn push_interval(&mut self, interval: Option<&Interval>) {
        self.push(interval.map(|i| [i.mean, i.q025, i.q975]));
    }

    /// Adds the means of a stretch, rounded, since they are never compared digit by digit.
    fn push_mean(&mut self, mean: &Mean) {
        self.push(mean.get().map(|values| values.map(shortened)));
    }
}

impl History {
    /// History of a rod from one time to before another, in about `points` points at most.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(
        reader: &Reader,
        days: &Days,
        rod: &RodId,
        (from, to): (Timestamp, Timestamp),
        points: usize,
    ) -> Result<Self, StoreError> {
        let points = points.max(1);
        let mut history = Self::empty(rod, from, to);
        if records_between(days, rod, from, to) > MOST_READ {
            history.fill_from_days(days, points);
            return Ok(history);
        }
        let most = usize::try_from(MOST_READ).unwrap_or(usize::MAX);
        let found = reader.points_between(rod, from, to, most)?;
        if found.len() <= points {
            found.iter().for_each(|point| history.push_record(point));
        } else {
            history.fill_from_records(&found, points);
        }
        Ok(history)
    }

    fn empty(rod: &RodId, from: Timestamp, to: Timestamp) -> Self {
        Self {
            rod: rod.clone(),
            from,
            to,
            step_s: None,
            time: Vec::new(),
            records: Vec::new(),
            rejected: Vec::new(),
            set_aside: Vec::new(),
            relative_force_at_reference: Band::default(),
            relative_force: Band::default(),
            force_at_reference_n: Band::default(),
            tracked_force_n: Band::default(),
            axial_force_n: Band::default(),
            temperature_c: Vec::new(),
        }
    }

    /// Fills in whole days, several per point if there are too many.
    fn fill_from_days(&mut self, days: &Days, points: usize) {
        let rod = self.rod.clone();
        let number = |time: Timestamp| time.as_nanos().div_euclid(DAY_NS);
        let count = days.between(&rod, self.from, self.to).count();
        let together = i64::try_from(count.div_ceil(points)).unwrap_or(1).max(1);
        self.step_s = Some((together * DAY_NS) as f64 * 1e-9);
        let first = number(self.from);
        let stretches = days
            .between(&rod, self.from, self.to)
            .map(|(start, day)| ((number(start) - first).div_euclid(together), day));
        self.join(
            stretches,
            first.saturating_mul(DAY_NS),
            together.saturating_mul(DAY_NS),
        );
    }

    /// Fills in even stretches of time.
    fn fill_from_records(&mut self, found: &[Point], points: usize) {
        let start = |point: &Point| point.start.map_or(0, Timestamp::as_nanos);
        let (first, last) = (found.first().map_or(0, start), found.last().map_or(0, start));
        let span_s = last.saturating_sub(first) / SECOND_NS;
        // Whole seconds, the last record in the last stretch.
        let step_s = (span_s / i64::try_from(points).unwrap_or(i64::MAX).max(1)).saturating_add(1);
        let step_ns = step_s.saturating_mul(SECOND_NS);
        self.step_s = Some(step_ns as f64 * 1e-9);
        let buckets: Vec<(i64, Bucket)> = found
            .iter()
            .map(|point| {
                let mut bucket = Bucket::default();
                bucket.add(point);
                (start(point).saturating_sub(first).div_euclid(step_ns), bucket)
            })
            .collect();
        let buckets = buckets.iter().map(|(number, bucket)| (*number, bucket));
        self.join(buckets, first, step_ns);
    }

    /// Joins neighbours of the same number, ascending; stretch 0 begins at `first_ns`.
    fn join<'b>(&mut self, buckets: impl Iterator<Item = (i64, &'b Bucket)>, first_ns: i64, step_ns: i64) {
        let begin = |number: i64| first_ns.saturating_add(number.saturating_mul(step_ns));
        let mut open: Option<(i64, Bucket)> = None;
        for (number, bucket) in buckets {
            match &mut open {
                Some((last, joined)) if *last == number => joined.join(bucket),
                _ => {
                    if let Some((number, joined)) = open.replace((number, *bucket)) {
                        self.push_bucket(begin(number), &joined);
                    }
                }
            }
        }
        if let Some((number, joined)) = open {
            self.push_bucket(begin(number), &joined);
        }
    }

    fn push_bucket(&mut self, start_ns: i64, bucket: &Bucket) {
        self.time.push(Timestamp::from_nanos(start_ns));
        self.records.push(bucket.records);
        self.rejected.push(bucket.rejected);
        self.set_aside.push(None);
        self.relative_force_at_reference
            .push_mean(&bucket.relative_force_at_reference);
        self.relative_force.push_mean(&bucket.relative_force);
        self.force_at_reference_n.push_mean(&bucket.force_at_reference_n);
        self.tracked_force_n.push_mean(&bucket.tracked_force_n);
        self.axial_force_n.push_mean(&bucket.axial_force_n);
        let temperature = bucket.temperature_c.get();
        self.temperature_c
            .push(temperature.map(|[mean, ..]| shortened(mean)));
    }

    fn push_record(&mut self, point: &Point) {
        let Some(start) = point.start else { return };
        self.time.push(start);
        self.records.push(1);
        self.rejected.push(u64::from(point.rejection.is_some()));
        self.set_aside.push(point.set_aside.clone());
        self.relative_force_at_reference
            .push_interval(point.relative_force_at_reference.as_ref());
        self.relative_force.push_interval(point.relative_force.as_ref());
        self.force_at_reference_n
            .push_interval(point.force_at_reference_n.as_ref());
        self.tracked_force_n.push_interval(point.tracked_force_n.as_ref());
        self.axial_force_n.push_interval(point.axial_force_n.as_ref());
        self.temperature_c.push(point.temperature_c);
    }
}

/// Number of a rod's records on the days of a time range.
fn records_between(days: &Days, rod: &RodId, from: Timestamp, to: Timestamp) -> u64 {
    days.between(rod, from, to).map(|(_, day)| day.records).sum()
}

/// Natural frequencies of a rod's records, as columns of equal length, ascending in time.
#[derive(Debug, Serialize)]
pub struct Frequencies {
    /// Id of the rod.
    pub rod: RodId,
    /// Interval of the records listed: one in this many, on average if they are thinned by time.
    pub every: usize,
    /// Time of the record's first sample.
    pub time: Vec<Timestamp>,
    /// Modes, ascending in order.
    pub modes: Vec<ModeColumn>,
}

/// One mode over time, one entry per record.
#[derive(Debug, Serialize)]
pub struct ModeColumn {
    /// Mode order, from 1.
    pub order: u32,
    /// Frequency \[Hz\]; `null` where a record does not show the mode.
    pub frequency_hz: Vec<Option<f64>>,
    /// Standard error \[Hz\].
    pub sd_hz: Vec<Option<f64>>,
}

impl Frequencies {
    /// Frequencies of a rod in a time range, end exclusive, of at most `points` records: each n-th, or the first of
    /// each even stretch of time if there are more than [`MOST_READ`].
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(
        reader: &Reader,
        days: &Days,
        rod: &RodId,
        (from, to): (Timestamp, Timestamp),
        points: usize,
    ) -> Result<Self, StoreError> {
        let there = records_between(days, rod, from, to);
        let together = usize::try_from(there)
            .unwrap_or(usize::MAX)
            .div_ceil(points.max(1))
            .max(1);
        let sampling = if there > MOST_READ {
            let span_ns = to.as_nanos().saturating_sub(from.as_nanos());
            Sampling::Apart(span_ns / i64::try_from(points.max(1)).unwrap_or(i64::MAX) + 1)
        } else {
            Sampling::Every(together)
        };
        let records = reader.modes_between(rod, (from, to), sampling, points)?;
        let every = match sampling {
            Sampling::Every(every) => every,
            Sampling::Apart(_) => usize::try_from(there).unwrap_or(usize::MAX) / records.len().max(1),
        };
        let orders: BTreeSet<u32> = records
            .iter()
            .flat_map(|record| record.modes.iter().map(|(order, ..)| *order))
            .collect();
        let column = |order: u32| {
            let of_order = records.iter().map(|record| {
                let mode = record.modes.iter().find(|(one, ..)| *one == order)?;
                Some((mode.1, mode.2))
            });
            let (frequency_hz, sd_hz) = of_order
                .map(|mode| (mode.map(|m| m.0), mode.map(|m| m.1)))
                .unzip();
            ModeColumn {
                order,
                frequency_hz,
                sd_hz,
            }
        };
        Ok(Self {
            rod: rod.clone(),
            every,
            time: records.iter().map(|record| record.start).collect(),
            modes: orders.into_iter().map(column).collect(),
        })
    }
}

/// Seven significant digits.
fn shortened(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let scale = 10_f64.powi(6 - value.abs().log10().floor() as i32);
    (value * scale).round() / scale
}
