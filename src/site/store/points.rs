//! Records as points over time, and the modes of a sample of them: what is plotted.

use super::page::limit;
use super::state::Failure;
use super::{Reader, StoreError};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::Interval;
use rusqlite::{OptionalExtension, Params};

/// Values of a record that are plotted over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Number in the store, ascending with commits.
    pub id: i64,
    /// Id of the rod.
    pub rod: RodId,
    /// Time of its first sample, if it had one.
    pub start: Option<Timestamp>,
    /// Code of the rejection, if it was rejected.
    pub rejection: Option<String>,
    /// Reason why it does not count on the charts, if it does not.
    pub set_aside: Option<String>,
    /// N_t / N_0 at the measured temperature.
    pub relative_force: Option<Interval>,
    /// N_t / N_0 at the reference temperature.
    pub relative_force_at_reference: Option<Interval>,
    /// Force given the baseline, at the reference temperature \[N\].
    pub force_at_reference_n: Option<Interval>,
    /// Force given the baseline, at the measured temperature \[N\].
    pub tracked_force_n: Option<Interval>,
    /// Force of this record alone \[N\].
    pub axial_force_n: Option<Interval>,
    /// Temperature \[degC\].
    pub temperature_c: Option<f64>,
}

/// The modes of one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    /// Time of the record's first sample.
    pub start: Timestamp,
    /// Order, frequency \[Hz\] and its standard error \[Hz\], ascending; empty for a rejected record.
    pub modes: Vec<(u32, f64, f64)>,
}

/// Selection of some of many records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sampling {
    /// Each record of this many.
    Every(usize),
    /// First record of each stretch of this length \[ns\].
    Apart(i64),
}

impl Reader {
    /// At most `most` records with numbers above `after`, ascending.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn points_after(&self, after: i64, most: usize) -> Result<Vec<Point>, StoreError> {
        self.points_where("id > ? ORDER BY id LIMIT ?", (after, limit(most)))
    }

    /// The records of a rod from a time on and before another, at most `most`, in the order of time.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn points_between(
        &self,
        rod: &RodId,
        from: Timestamp,
        to: Timestamp,
        most: usize,
    ) -> Result<Vec<Point>, StoreError> {
        self.points_where(
            "rod = ? AND start_ns >= ? AND start_ns < ? ORDER BY start_ns, id LIMIT ?",
            (&rod.0, from.as_nanos(), to.as_nanos(), limit(most)),
        )
    }

    /// The last records of a rod, at most `most`, in the order of time.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn last_points(&self, rod: &RodId, most: usize) -> Result<Vec<Point>, StoreError> {
        let condition = "rod = ? AND start_ns IS NOT NULL ORDER BY start_ns DESC, id DESC LIMIT ?";
        let mut points = self.points_where(condition, (&rod.0, limit(most)))?;
        points.reverse();
        Ok(points)
    }

    fn points_where(&self, condition: &str, parameters: impl Params) -> Result<Vec<Point>, StoreError> {
        let (mut points, mut places) = (Vec::new(), None);
        self.verified("record", condition, parameters, |row| {
            let places = match &mut places {
                Some(places) => places,
                none => none.insert(Places::of(row)?),
            };
            points.push(places.point(row)?);
            Ok(())
        })?;
        Ok(points)
    }

    /// Modes of a sample of a rod's records in a time range, end exclusive, in order of time, at most `most`.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn modes_between(
        &self,
        rod: &RodId,
        (from, to): (Timestamp, Timestamp),
        sampling: Sampling,
        most: usize,
    ) -> Result<Vec<Modes>, StoreError> {
        let mut found = Vec::new();
        let (mut after, mut skip) = ((from.as_nanos(), i64::MIN), 0);
        while found.len() < most {
            let next = || -> rusqlite::Result<Option<(i64, i64)>> {
                let mut statement = self.connection.prepare_cached(
                    "SELECT start_ns, id FROM record WHERE rod = ? AND start_ns < ? AND (start_ns, id) > (?, ?)
                     ORDER BY start_ns, id LIMIT 1 OFFSET ?",
                )?;
                let values = (&rod.0, to.as_nanos(), after.0, after.1, limit(skip));
                let row = statement.query_row(values, |row| Ok((row.get(0)?, row.get(1)?)));
                row.optional()
            };
            let Some((start_ns, id)) = next().map_err(|error| self.fault(Failure::Sql(error)))? else {
                break;
            };
            let mut modes = Vec::new();
            self.verified("mode", "record = ? ORDER BY mode_order", [id], |row| {
                modes.push((
                    row.get("mode_order")?,
                    row.get("frequency_hz")?,
                    row.get("sd_hz")?,
                ));
                Ok(())
            })?;
            let start = Timestamp::from_nanos(start_ns);
            found.push(Modes { start, modes });
            (after, skip) = match sampling {
                Sampling::Every(count) => ((start_ns, id), count.saturating_sub(1)),
                Sampling::Apart(length_ns) => {
                    let into = start_ns
                        .saturating_sub(from.as_nanos())
                        .rem_euclid(length_ns.max(1));
                    let next = start_ns.saturating_add(length_ns.max(1) - into);
                    ((next, i64::MIN), 0)
                }
            };
        }
        Ok(found)
    }
}

/// Columns of a point: those of every record, then four of each interval.
const COLUMNS: [&str; 26] = [
    "id",
    "rod",
    "start_ns",
    "rejection",
    "set_aside",
    "temperature_c",
    "relative_force",
    "relative_force_sd",
    "relative_force_q025",
    "relative_force_q975",
    "relative_force_at_reference",
    "relative_force_at_reference_sd",
    "relative_force_at_reference_q025",
    "relative_force_at_reference_q975",
    "force_at_reference_n",
    "force_at_reference_sd_n",
    "force_at_reference_q025_n",
    "force_at_reference_q975_n",
    "tracked_force_n",
    "tracked_force_sd_n",
    "tracked_force_q025_n",
    "tracked_force_q975_n",
    "axial_force_n",
    "axial_force_sd_n",
    "axial_force_q025_n",
    "axial_force_q975_n",
];

/// Indices of the columns of a point in a row.
struct Places([usize; 26]);

impl Places {
    fn of(row: &rusqlite::Row<'_>) -> rusqlite::Result<Self> {
        let mut places = [0; 26];
        for (place, name) in places.iter_mut().zip(COLUMNS) {
            *place = row.as_ref().column_index(name)?;
        }
        Ok(Self(places))
    }

    fn point(&self, row: &rusqlite::Row<'_>) -> rusqlite::Result<Point> {
        let [id, rod, start, rejection, set_aside, temperature, intervals @ ..] = self.0;
        let interval = |number: usize| -> rusqlite::Result<Option<Interval>> {
            let [mean, sd, low, high] = [0, 1, 2, 3].map(|part| intervals[4 * number + part]);
            let Some(mean) = row.get(mean)? else {
                return Ok(None);
            };
            let (sd, q025, q975) = (row.get(sd)?, row.get(low)?, row.get(high)?);
            Ok(Some(Interval { mean, sd, q025, q975 }))
        };
        Ok(Point {
            id: row.get(id)?,
            rod: RodId(row.get(rod)?),
            start: row.get::<_, Option<i64>>(start)?.map(Timestamp::from_nanos),
            rejection: row.get(rejection)?,
            set_aside: row.get(set_aside)?,
            temperature_c: row.get(temperature)?,
            relative_force: interval(0)?,
            relative_force_at_reference: interval(1)?,
            force_at_reference_n: interval(2)?,
            tracked_force_n: interval(3)?,
            axial_force_n: interval(4)?,
        })
    }
}
