//! Queries of a store, possible while another process writes it.

use super::listing::Filter;
use super::request::{self, Request};
use super::state::{self, Failure};
use super::{FileId, StoreError, open, row, schema};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Alarm, AlarmEvent, Period, RodState, Segment, State};
use crate::site::record_row::RecordRow;
use rusqlite::types::Value;
use rusqlite::{Connection, OptionalExtension};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A store open for reading.
pub struct Reader {
    pub(super) connection: Connection,
    pub(super) path: PathBuf,
    file: FileId,
}

/// Parses a JSON line of the store.
pub(super) fn parse(line: &str) -> Result<RecordRow, StoreError> {
    RecordRow::parse(line).map_err(|error| {
        let known: serde_json::Value = serde_json::from_str(line).unwrap_or_default();
        let text = |name: &str| known[name].as_str().unwrap_or("unknown").to_owned();
        StoreError::Unreadable {
            what: format!("the record of rod {} of {}", text("rod"), text("start")),
            detail: error.to_string(),
        }
    })
}

impl Reader {
    /// Opens a store for reading. Rods, periods and alarms are compared with their checksums now, records
    /// when queried.
    ///
    /// # Errors
    /// There is none, it is another program's, a newer format, or damaged.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        // Looked at before it is opened: a file that takes its place in between is found to be another one.
        let file = FileId::of(path);
        let (connection, path) = open::for_reading(path)?;
        let reader = Self::over(connection, path, file);
        reader.check(&schema::SMALL)?;
        Ok(reader)
    }

    /// Opens a store for reading after a check of its tables and of every page, index and row.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub fn open_whole(path: &Path) -> Result<Self, StoreError> {
        let file = FileId::of(path);
        let (connection, path) = open::for_reading_whole(path)?;
        Ok(Self::over(connection, path, file))
    }

    /// Compares the rows of these tables with their checksums.
    pub(super) fn check(&self, tables: &[&str]) -> Result<(), StoreError> {
        for table in tables {
            let bad = row::verify(&self.connection, table, |_| Ok(()));
            if let Some(number) = bad.map_err(|error| self.fault(Failure::Sql(error)))? {
                return Err(StoreError::Damaged {
                    path: self.path.clone(),
                    detail: format!("row {number} of table {table} is not what was written"),
                });
            }
        }
        Ok(())
    }

    /// Compares every row of every table with its checksum.
    ///
    /// # Errors
    /// A row is not what was written, or the store cannot be read.
    pub fn check_all(&self) -> Result<(), StoreError> {
        self.check(&schema::TABLES)
    }

    /// Number of records, and of those that were rejected.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn count_records(&self) -> Result<(u64, u64), StoreError> {
        self.connection
            .query_row("SELECT count(*), count(rejection) FROM record", (), |row| {
                let (all, rejected): (i64, i64) = (row.get(0)?, row.get(1)?);
                Ok((all.unsigned_abs(), rejected.unsigned_abs()))
            })
            .map_err(|error| self.fault(Failure::Sql(error)))
    }

    pub(super) fn over(connection: Connection, path: PathBuf, file: FileId) -> Self {
        Self {
            connection,
            path,
            file,
        }
    }

    /// Identity of the file opened; another one may have its name by now.
    pub fn file(&self) -> FileId {
        self.file
    }

    /// Path of the store, links followed.
    pub fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn fault(&self, failure: Failure) -> StoreError {
        match failure {
            Failure::Other(error) => error,
            Failure::Sql(error) => open::is_damage(&self.path, error),
        }
    }

    /// State of every rod's fold.
    ///
    /// # Errors
    /// It cannot be read, or not be understood.
    pub fn states(&self) -> Result<BTreeMap<RodId, State>, StoreError> {
        state::load(&self.connection).map_err(|failure| self.fault(failure))
    }

    /// Segments of a rod, ascending.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn segments(&self, rod: &RodId) -> Result<Vec<Segment>, StoreError> {
        state::segments(&self.connection, rod).map_err(|failure| self.fault(failure))
    }

    /// The closed periods of one segment, ascending.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn periods(&self, rod: &RodId, segment: u32) -> Result<Vec<Period>, StoreError> {
        state::periods(&self.connection, rod, segment).map_err(|failure| self.fault(failure))
    }

    /// Identity of a rod's record committed last.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn last_identity(&self, rod: &RodId) -> Result<Option<[u8; 32]>, StoreError> {
        let ask = || {
            self.connection
                .prepare_cached("SELECT identity FROM record WHERE rod = ? ORDER BY id DESC LIMIT 1")?
                .query_row([&rod.0], |row| row.get(0))
                .optional()
        };
        ask().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Start and length \[s\] of the latest of a rod's identified records that begin before `end`.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn spans_before(&self, rod: &RodId, end: Timestamp) -> Result<Vec<(Timestamp, f64)>, StoreError> {
        let ask = || -> rusqlite::Result<Vec<(Timestamp, f64)>> {
            self.connection
                .prepare_cached(
                    "SELECT start_ns, duration_s FROM record WHERE rod = ? AND start_ns < ? AND rejection IS NULL \
                     AND duration_s IS NOT NULL ORDER BY start_ns DESC LIMIT 64",
                )?
                .query_map((&rod.0, end.as_nanos()), |row| {
                    Ok((Timestamp::from_nanos(row.get(0)?), row.get(1)?))
                })?
                .collect()
        };
        ask().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Waiting requests about a rod, in the order they were made.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn waiting(&self, rod: &RodId) -> Result<Vec<Request>, StoreError> {
        request::waiting(&self.connection, rod).map_err(|failure| self.fault(failure))
    }

    /// Rods with waiting requests.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn rods_asked(&self) -> Result<Vec<RodId>, StoreError> {
        let rods = || -> rusqlite::Result<Vec<RodId>> {
            let mut statement = self
                .connection
                .prepare_cached("SELECT DISTINCT rod FROM request WHERE applied = 0 ORDER BY rod")?;
            let rods = statement.query_map((), |row| Ok(RodId(row.get(0)?)))?;
            rods.collect()
        };
        rods().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// The alarm with this id, in its present state.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn alarm(&self, id: &str) -> Result<Option<Alarm>, StoreError> {
        let sql = "SELECT rod, json FROM alarm WHERE id = ?";
        let mut found = self.parsed(sql, vec![Value::Text(id.to_owned())])?;
        Ok(found.pop())
    }

    /// Words of the person who acknowledged an alarm: `NAME: TEXT`; `None` for an alarm that is not acknowledged.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn acknowledged_words(&self, alarm: &Alarm) -> Result<Option<String>, StoreError> {
        if alarm.acknowledged.is_none() {
            return Ok(None);
        }
        request::said_of(&self.connection, &alarm.id).map_err(|trouble| self.fault(trouble))
    }

    /// The same of several alarms, by their ids.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn words_of(&self, alarms: &[Alarm]) -> Result<BTreeMap<String, String>, StoreError> {
        let words = alarms.iter().map(|alarm| {
            let words = self.acknowledged_words(alarm)?;
            Ok(words.map(|words| (alarm.id.clone(), words)))
        });
        words.filter_map(Result::transpose).collect()
    }

    /// Reasons given with the applied requests for a baseline of a rod, in order.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn rebaselines(&self, rod: &RodId) -> Result<Vec<Option<String>>, StoreError> {
        request::rebaselines(&self.connection, rod).map_err(|trouble| self.fault(trouble))
    }

    /// Alarms in their present state, in the order they were raised.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn alarms(&self, filter: &Filter) -> Result<Vec<Alarm>, StoreError> {
        let (wanted, values) = filter.sql("raised_ns");
        let sql = format!("SELECT rod, json FROM alarm WHERE {wanted} ORDER BY raised_ns, rod, id");
        self.parsed(&sql, values)
    }

    /// Events of a rod's alarms, in order.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn events(&self, rod: &RodId) -> Result<Vec<AlarmEvent>, StoreError> {
        let sql = "SELECT rod, json FROM outbox WHERE rod = ? ORDER BY number";
        self.parsed(sql, vec![Value::Text(rod.0.clone())])
    }

    fn parsed<T: serde::de::DeserializeOwned>(
        &self,
        sql: &str,
        values: Vec<Value>,
    ) -> Result<Vec<T>, StoreError> {
        let rows = || -> rusqlite::Result<Vec<(String, String)>> {
            let mut statement = self.connection.prepare(sql)?;
            let rows = statement.query_map(rusqlite::params_from_iter(values), |row| {
                Ok((row.get(0)?, row.get(1)?))
            })?;
            rows.collect()
        };
        let rows = rows().map_err(|error| self.fault(Failure::Sql(error)))?;
        rows.iter().map(|(rod, json)| state::read(rod, json)).collect()
    }

    /// Rods in the store, in alphabetical order.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn rods(&self) -> Result<Vec<RodId>, StoreError> {
        let rods = || -> rusqlite::Result<Vec<RodId>> {
            let mut statement = self.connection.prepare("SELECT rod FROM rod ORDER BY rod")?;
            let rods = statement.query_map((), |row| Ok(RodId(row.get(0)?)))?;
            rods.collect()
        };
        rods().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Rods that are known to be no longer configured.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn unfollowed(&self) -> Result<BTreeSet<RodId>, StoreError> {
        let read = || -> Result<BTreeSet<RodId>, Failure> {
            let mut statement = self.connection.prepare_cached("SELECT rod, detail FROM rod")?;
            let mut rows = statement.query(())?;
            let mut unfollowed = BTreeSet::new();
            while let Some(row) = rows.next()? {
                let (rod, detail): (String, String) = (row.get(0)?, row.get(1)?);
                if state::read::<RodState>(&rod, &detail)? == state::not_followed() {
                    unfollowed.insert(RodId(rod));
                }
            }
            Ok(unfollowed)
        };
        read().map_err(|failure| self.fault(failure))
    }

    /// Numbers of a rod's records in the store. Reads every one of them.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn counts(&self, rod: &RodId) -> Result<Counts, StoreError> {
        let count = || -> rusqlite::Result<Counts> {
            let mut statement = self.connection.prepare_cached(
                "SELECT count(*), count(rejection), count(set_aside) FROM record WHERE rod = ?",
            )?;
            statement.query_row([&rod.0], |row| {
                let number = |place| row.get(place).map(i64::unsigned_abs);
                Ok(Counts {
                    records: number(0)?,
                    rejected: number(1)?,
                    set_aside: number(2)?,
                })
            })
        };
        count().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Refused records of a rod by reason, in the order of the reasons' codes.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn refusals(&self, rod: &RodId) -> Result<Vec<Refusals>, StoreError> {
        let read = || -> rusqlite::Result<Vec<Refusals>> {
            let mut statement = self.connection.prepare_cached(
                "SELECT rejection, count(*), max(start_ns),
                    (SELECT rejection_message FROM record AS last WHERE last.rod = ?1 AND last.rejection = record.rejection
                     ORDER BY start_ns DESC, id DESC LIMIT 1)
                 FROM record WHERE rod = ?1 AND rejection IS NOT NULL GROUP BY rejection ORDER BY rejection",
            )?;
            let rows = statement.query_map([&rod.0], |row| {
                let (count, last_ns, message): (i64, Option<i64>, Option<String>) =
                    (row.get(1)?, row.get(2)?, row.get(3)?);
                Ok(Refusals {
                    code: row.get(0)?,
                    count: count.unsigned_abs(),
                    last: last_ns.map(Timestamp::from_nanos),
                    message: message.unwrap_or_default(),
                })
            })?;
            rows.collect()
        };
        read().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Configurations and versions of the analysis of a rod's records.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn meanings(&self, rod: &RodId) -> Result<Vec<(String, Option<u32>)>, StoreError> {
        let read = || -> rusqlite::Result<Vec<(String, Option<u32>)>> {
            let sql = "SELECT DISTINCT config, analysis_version FROM record WHERE rod = ? ORDER BY 1, 2";
            let mut statement = self.connection.prepare_cached(sql)?;
            let rows = statement.query_map([&rod.0], |row| Ok((row.get(0)?, row.get(1)?)))?;
            rows.collect()
        };
        read().map_err(|error| self.fault(Failure::Sql(error)))
    }
}

/// Numbers of a rod's records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// All of them.
    pub records: u64,
    /// Those that were rejected.
    pub rejected: u64,
    /// Those that were set aside: identified, and not followed.
    pub set_aside: u64,
}

/// Refused records of one reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusals {
    /// Code of the reason.
    pub code: String,
    /// Number of records.
    pub count: u64,
    /// Start of the latest, if known.
    pub last: Option<Timestamp>,
    /// Message of the latest.
    pub message: String,
}
