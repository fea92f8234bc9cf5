//! Daily means of every rod, kept up to date from the new records in a store.
//!
//! A history of years is drawn from these instead of from its records; a day of a rod takes a few hundred bytes.

use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::Interval;
use crate::site::store::{Counts, Point, Reader, StoreError};
use std::collections::BTreeMap;

/// Length of a day \[ns\].
pub const DAY_NS: i64 = 86_400_000_000_000;

/// 1980-01-01: earlier records were dated by a clock that was not set.
const DAY_1980: i64 = 3652;

/// Number of records read at once: some ten milliseconds.
const BATCH: usize = 2_000;

/// Daily sums of every rod.
#[derive(Debug, Default)]
pub struct Days {
    /// Number of the last record added.
    through: i64,
    rods: BTreeMap<RodId, BTreeMap<i64, Bucket>>,
    /// Records without a time.
    timeless: BTreeMap<RodId, Bucket>,
}

/// Sums over the records of a stretch of time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bucket {
    /// Number of records.
    pub records: u64,
    /// Number of rejected records.
    pub rejected: u64,
    /// Number of records that were set aside.
    pub set_aside: u64,
    /// Number of records whose time tracking believed.
    pub believed: u64,
    /// N_t / N_0 at the reference temperature.
    pub relative_force_at_reference: Mean,
    /// N_t / N_0 at the measured temperature.
    pub relative_force: Mean,
    /// Force given the baseline, at the reference temperature \[N\].
    pub force_at_reference_n: Mean,
    /// Force given the baseline, at the measured temperature \[N\].
    pub tracked_force_n: Mean,
    /// Force of each record alone \[N\].
    pub axial_force_n: Mean,
    /// Temperature \[degC\].
    pub temperature_c: Mean,
}

/// Sums of one quantity and of the ends of its interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mean {
    count: u32,
    mean: f64,
    q025: f64,
    q975: f64,
}

impl Mean {
    fn add(&mut self, mean: f64, q025: f64, q975: f64) {
        self.count += 1;
        self.mean += mean;
        self.q025 += q025;
        self.q975 += q975;
    }

    fn add_interval(&mut self, interval: Option<&Interval>) {
        if let Some(interval) = interval {
            self.add(interval.mean, interval.q025, interval.q975);
        }
    }

    fn join(&mut self, other: &Self) {
        self.count += other.count;
        self.mean += other.mean;
        self.q025 += other.q025;
        self.q975 += other.q975;
    }

    /// Means of value, 2.5 % and 97.5 % quantile over the records; `None` without records.
    pub fn get(&self) -> Option<[f64; 3]> {
        (self.count > 0).then(|| [self.mean, self.q025, self.q975].map(|sum| sum / f64::from(self.count)))
    }
}

impl Bucket {
    /// Adds a record. One that was set aside counts, but its force is left out of the means.
    pub fn add(&mut self, point: &Point) {
        self.records += 1;
        if point.rejection.is_some() {
            self.rejected += 1;
        }
        if !matches!(point.set_aside.as_deref(), Some("clock" | "late")) {
            self.believed += 1;
        }
        if let Some(temperature_c) = point.temperature_c {
            self.temperature_c
                .add(temperature_c, temperature_c, temperature_c);
        }
        if point.set_aside.is_some() {
            self.set_aside += 1;
            return;
        }
        self.relative_force_at_reference
            .add_interval(point.relative_force_at_reference.as_ref());
        self.relative_force.add_interval(point.relative_force.as_ref());
        self.force_at_reference_n
            .add_interval(point.force_at_reference_n.as_ref());
        self.tracked_force_n.add_interval(point.tracked_force_n.as_ref());
        self.axial_force_n.add_interval(point.axial_force_n.as_ref());
    }

    /// Adds the records of another.
    pub fn join(&mut self, other: &Self) {
        self.records += other.records;
        self.rejected += other.rejected;
        self.set_aside += other.set_aside;
        self.believed += other.believed;
        self.relative_force_at_reference
            .join(&other.relative_force_at_reference);
        self.relative_force.join(&other.relative_force);
        self.force_at_reference_n.join(&other.force_at_reference_n);
        self.tracked_force_n.join(&other.tracked_force_n);
        self.axial_force_n.join(&other.axial_force_n);
        self.temperature_c.join(&other.temperature_c);
    }
}

impl Days {
    /// Adds at most a batch of the new records in the store; returns true if there may be more.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn take_up(&mut self, reader: &Reader) -> Result<bool, StoreError> {
        let points = reader.points_after(self.through, BATCH)?;
        for point in &points {
            self.through = point.id;
            let Some(start) = point.start else {
                self.timeless.entry(point.rod.clone()).or_default().add(point);
                continue;
            };
            let day = start.as_nanos().div_euclid(DAY_NS);
            let days = match self.rods.get_mut(&point.rod) {
                Some(days) => days,
                None => self.rods.entry(point.rod.clone()).or_default(),
            };
            days.entry(day).or_default().add(point);
        }
        Ok(points.len() == BATCH)
    }

    /// Share of a store's records added so far, 0 to 1.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn share(&self, reader: &Reader) -> Result<f64, StoreError> {
        let last = reader.last_record()?;
        Ok(self.through.max(0) as f64 / last.max(1) as f64)
    }

    /// Days of a rod from one time to before another, ascending: begin of each, and its records.
    pub fn between(
        &self,
        rod: &RodId,
        from: Timestamp,
        to: Timestamp,
    ) -> impl DoubleEndedIterator<Item = (Timestamp, &Bucket)> {
        let first = from.as_nanos().div_euclid(DAY_NS);
        let last = to.as_nanos().saturating_sub(1).div_euclid(DAY_NS);
        let days = self.rods.get(rod).filter(|_| first <= last);
        days.into_iter()
            .flat_map(move |days| days.range(first..=last))
            .map(|(day, bucket)| (Timestamp::from_nanos(day.saturating_mul(DAY_NS)), bucket))
    }

    /// Numbers of a rod's records, those without a time among them.
    pub fn counts(&self, rod: &RodId) -> Counts {
        let days = self.rods.get(rod).into_iter().flat_map(BTreeMap::values);
        days.chain(self.timeless.get(rod))
            .fold(Counts::default(), |all, day| Counts {
                records: all.records + day.records,
                rejected: all.rejected + day.rejected,
                set_aside: all.set_aside + day.set_aside,
            })
    }

    /// Begin of a rod's first day with a record whose time is believed, and end of the day of its `latest` record.
    pub fn believed_span(&self, rod: &RodId, latest: Option<Timestamp>) -> Option<(Timestamp, Timestamp)> {
        let last = latest?.as_nanos().div_euclid(DAY_NS);
        let mut days = self.rods.get(rod)?.range(..=last);
        let first = *days.clone().next()?.0;
        // A clock that was never set begins in 1970.
        let first = days
            .find(|(day, bucket)| **day >= DAY_1980 && bucket.believed > 0)
            .map_or(first, |(day, _)| *day);
        let at = |day: i64| Timestamp::from_nanos(day.saturating_mul(DAY_NS));
        Some((at(first), at(last.saturating_add(1))))
    }

    /// Begin of a rod's first day and end of its last, whatever clock dated their records.
    pub fn span(&self, rod: &RodId) -> Option<(Timestamp, Timestamp)> {
        let days = self.rods.get(rod)?;
        let (first, last) = (days.keys().next()?, days.keys().next_back()?);
        let at = |day: i64| Timestamp::from_nanos(day.saturating_mul(DAY_NS));
        Some((at(*first), at(last.saturating_add(1))))
    }
}
