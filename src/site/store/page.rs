//! Bounded queries, for pages: each uses an index, and every row it reads is compared with its checksum.

use super::read::parse;
use super::state::{self, Failure};
use super::{Reader, StoreError, row};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::fold::packed::Packed;
use crate::analysis::track::{Alarm, DriftWatch, Period};
use crate::site::record_row::RecordRow;
use rusqlite::Params;
use rusqlite::types::Value;
use serde::de::DeserializeOwned;

/// End of a page of records: time and number of the last one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mark {
    /// Time of its first sample \[ns\].
    pub start_ns: i64,
    /// Number in the store.
    pub id: i64,
}

/// A record's JSON line.
#[derive(Debug)]
pub struct Line {
    /// Mark of the record.
    pub mark: Mark,
    /// The line as printed.
    pub json: String,
    /// File the record came from; `None` for records of stores before format 5.
    pub file: Option<String>,
}

/// JSON lines of records, the latest first.
#[derive(Debug, Default)]
pub struct Lines {
    /// Lines of the records.
    pub found: Vec<Line>,
    /// True if they end because retention removed the lines of older records.
    pub are_older_removed: bool,
}

impl Reader {
    /// A number that changes with every commit to the store.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn data_version(&self) -> Result<i64, StoreError> {
        self.connection
            .pragma_query_value(None, "data_version", |row| row.get(0))
            .map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Runs several queries on one snapshot of the store, whatever is committed meanwhile.
    ///
    /// # Errors
    /// The store cannot be read, or a query fails.
    pub fn together<T>(&self, ask: impl FnOnce(&Self) -> Result<T, StoreError>) -> Result<T, StoreError> {
        let view = self
            .connection
            .unchecked_transaction()
            .map_err(|error| self.fault(Failure::Sql(error)))?;
        let answer = ask(self);
        drop(view);
        answer
    }

    /// The JSON lines of a rod's records before a mark, the latest first, at most `most`, each with its own mark; of one day
    /// (from, to) or of all times, rejected ones alone or all. They end where retention removed lines.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn lines_before(
        &self,
        rod: &RodId,
        within: (Timestamp, Timestamp),
        before: Option<Mark>,
        only_rejected: bool,
        most: usize,
    ) -> Result<Lines, StoreError> {
        let mark = before.unwrap_or(Mark {
            start_ns: i64::MAX,
            id: i64::MAX,
        });
        let rejected = if only_rejected {
            "AND rejection IS NOT NULL"
        } else {
            ""
        };
        let sql = format!(
            "SELECT start_ns, id FROM record
             WHERE rod = ? AND start_ns >= ? AND start_ns < ? AND (start_ns, id) < (?, ?) {rejected}
             ORDER BY start_ns DESC, id DESC LIMIT ?"
        );
        let values = [
            Value::Text(rod.0.clone()),
            Value::Integer(within.0.as_nanos()),
            Value::Integer(within.1.as_nanos()),
            Value::Integer(mark.start_ns),
            Value::Integer(mark.id),
            Value::Integer(limit(most)),
        ];
        let marks = || -> rusqlite::Result<Vec<Mark>> {
            let mut statement = self.connection.prepare_cached(&sql)?;
            let rows = statement.query_map(rusqlite::params_from_iter(values), |row| {
                Ok(Mark {
                    start_ns: row.get(0)?,
                    id: row.get(1)?,
                })
            })?;
            rows.collect()
        };
        let marks = marks().map_err(|error| self.fault(Failure::Sql(error)))?;
        let mut lines = Lines::default();
        for mark in marks {
            let Some(json) = self.text_of("line", "json", mark.id)? else {
                // Retention removes the oldest.
                lines.are_older_removed = true;
                break;
            };
            let file = self.text_of("origin", "file", mark.id)?;
            lines.found.push(Line { mark, json, file });
        }
        Ok(lines)
    }

    /// Text that a table holds about a record.
    fn text_of(&self, table: &str, column: &str, record: i64) -> Result<Option<String>, StoreError> {
        let mut found = None;
        self.verified(table, "record = ?", [record], |row| {
            found = row.get(column)?;
            Ok(())
        })?;
        Ok(found)
    }

    /// Number of the record committed last; 0 before the first.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn last_record(&self) -> Result<i64, StoreError> {
        self.connection
            .prepare_cached("SELECT coalesce(max(id), 0) FROM record")
            .and_then(|mut statement| statement.query_row((), |row| row.get(0)))
            .map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Rows of records with numbers above `after`, ascending, at most `most`.
    ///
    /// # Errors
    /// As [`Reader::points_after`], or a line cannot be understood.
    pub fn rows_after(&self, after: i64, most: usize) -> Result<Vec<RecordRow>, StoreError> {
        let mut lines: Vec<String> = Vec::new();
        self.verified(
            "line",
            "record > ? ORDER BY record LIMIT ?",
            (after, limit(most)),
            |row| {
                lines.push(row.get("json")?);
                Ok(())
            },
        )?;
        lines.iter().map(|line| parse(line)).collect()
    }

    /// Alarms, the latest first, at most `most`: those raised before an alarm, of one rod or all, only active
    /// ones or all.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn alarms_before(
        &self,
        rod: Option<&RodId>,
        only_standing: bool,
        before: Option<&Alarm>,
        most: usize,
    ) -> Result<Vec<Alarm>, StoreError> {
        let mut found: Vec<(String, String)> = Vec::new();
        let (raised_ns, id) = before.map_or((i64::MAX, ""), |alarm| (alarm.raised.as_nanos(), &alarm.id));
        self.verified(
            "alarm",
            "(?1 IS NULL OR rod = ?1) AND (NOT ?2 OR stands = 1) AND (raised_ns, id) < (?3, ?4)
             ORDER BY raised_ns DESC, id DESC LIMIT ?5",
            (
                rod.map(|rod| rod.0.as_str()),
                only_standing,
                raised_ns,
                id,
                limit(most),
            ),
            |row| {
                found.push((row.get("rod")?, row.get("json")?));
                Ok(())
            },
        )?;
        found.iter().map(|(rod, json)| state::read(rod, json)).collect()
    }

    /// Reads a rod's drift watch, which is empty before the baseline.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn watch(&self, rod: &RodId) -> Result<Packed<DriftWatch>, StoreError> {
        Ok(self.part(rod, state::WATCH)?.unwrap_or_default())
    }

    /// One part of the state of a rod's fold.
    fn part<T: DeserializeOwned>(&self, rod: &RodId, part: &str) -> Result<Option<T>, StoreError> {
        let mut json = None;
        self.verified("state", "rod = ? AND part = ?", (&rod.0, part), |row| {
            json = Some(row.get::<_, String>("json")?);
            Ok(())
        })?;
        match json {
            Some(json) => state::read(&rod.0, &json),
            None => Ok(None),
        }
    }

    /// The last closed periods of a segment, at most `most`, ascending.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn last_periods(&self, rod: &RodId, segment: u32, most: usize) -> Result<Vec<Period>, StoreError> {
        let mut found: Vec<String> = Vec::new();
        self.verified(
            "period",
            "rod = ? AND segment = ? ORDER BY period DESC LIMIT ?",
            (&rod.0, segment, limit(most)),
            |row| {
                found.push(row.get("json")?);
                Ok(())
            },
        )?;
        found.iter().rev().map(|json| state::read(&rod.0, json)).collect()
    }

    /// Configuration taken into force last: hash, site, and the text with every default filled in.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn latest_config(&self) -> Result<Option<[String; 3]>, StoreError> {
        self.config_where("rowid = (SELECT max(rowid) FROM config)", ())
    }

    /// Configuration of a rod's record that began at `start`.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn config_at(&self, rod: &RodId, start: Timestamp) -> Result<Option<[String; 3]>, StoreError> {
        self.config_where(
            "hash = (SELECT config FROM record WHERE rod = ? AND start_ns = ? ORDER BY id DESC LIMIT 1)",
            (&rod.0, start.as_nanos()),
        )
    }

    /// Configuration of the latest record of a segment.
    ///
    /// # Errors
    /// As [`Reader::points_after`].
    pub fn config_in(&self, rod: &RodId, segment: u32) -> Result<Option<[String; 3]>, StoreError> {
        self.config_where(
            "hash = (SELECT config FROM record WHERE rod = ? AND segment = ? ORDER BY start_ns DESC, id DESC LIMIT 1)",
            (&rod.0, segment),
        )
    }

    fn config_where(
        &self,
        condition: &str,
        parameters: impl Params,
    ) -> Result<Option<[String; 3]>, StoreError> {
        let mut found = None;
        self.verified("config", condition, parameters, |row| {
            found = Some([row.get("hash")?, row.get("site")?, row.get("effective")?]);
            Ok(())
        })?;
        Ok(found)
    }

    /// Calls `on_row` with each row of a table that meets a condition, after comparing it with its checksum.
    pub(super) fn verified(
        &self,
        table: &str,
        condition: &str,
        parameters: impl Params,
        on_row: impl FnMut(&rusqlite::Row<'_>) -> rusqlite::Result<()>,
    ) -> Result<(), StoreError> {
        match row::verify_where(&self.connection, table, condition, parameters, on_row) {
            Ok(None) => Ok(()),
            Ok(Some(_)) => Err(StoreError::Damaged {
                path: self.path.clone(),
                detail: format!("a row of table {table} is not what was written"),
            }),
            Err(error) => Err(self.fault(Failure::Sql(error))),
        }
    }
}

/// A bound as SQL takes it.
pub(super) fn limit(most: usize) -> i64 {
    i64::try_from(most).unwrap_or(i64::MAX)
}
