//! Queries of a store, possible while another process writes it.

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

/// Selection of rows.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filter {
    /// Only this rod; `None`: all.
    pub rod: Option<RodId>,
    /// From this time on.
    pub from: Option<Timestamp>,
    /// End of the listing, exclusive.
    pub to: Option<Timestamp>,
}

/// Tables that can be listed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listing {
    /// Every record, including rejected ones.
    Records,
    /// Rejected records.
    Rejections,
    /// Closed periods.
    Periods,
    /// Alarms, active or over.
    Alarms,
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

    /// Compares the rows of these tables with their checksums.
    fn check(&self, tables: &[&str]) -> Result<(), StoreError> {
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

    /// Words of the person who acknowledged an alarm: `NAME: TEXT`.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn acknowledged_words(&self, alarm: &str) -> Result<Option<String>, StoreError> {
        request::said_of(&self.connection, alarm).map_err(|trouble| self.fault(trouble))
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

    /// Calls `on_line` with the JSON line of every record selected, in the order of time, as `replay --json`
    /// printed it.
    ///
    /// # Errors
    /// The store cannot be read, or `on_line` failed.
    pub fn lines<E: From<StoreError>>(
        &self,
        listing: Listing,
        filter: &Filter,
        mut on_line: impl FnMut(&str) -> Result<(), E>,
    ) -> Result<(), E> {
        self.check(&["record", "line"])?;
        let (wanted, values) = filter.sql("start_ns");
        let rejected = match listing {
            Listing::Rejections => "AND rejection IS NOT NULL",
            _ => "",
        };
        let sql = format!(
            "SELECT line.json FROM record JOIN line ON line.record = record.id
             WHERE {wanted} {rejected} ORDER BY rod, start_ns, id"
        );
        let fault = |error| E::from(self.fault(Failure::Sql(error)));
        let mut statement = self.connection.prepare(&sql).map_err(fault)?;
        let mut rows = statement
            .query(rusqlite::params_from_iter(values))
            .map_err(fault)?;
        while let Some(row) = rows.next().map_err(fault)? {
            let line = row.get_ref(0).map_err(fault)?;
            on_line(line.as_str().map_err(|error| fault(error.into()))?)?;
        }
        Ok(())
    }

    /// Calls `on_row` with the row of every record selected, in the order of time.
    ///
    /// # Errors
    /// The store cannot be read, a line not be understood, or `on_row` failed.
    pub fn rows<E: From<StoreError>>(
        &self,
        filter: &Filter,
        mut on_row: impl FnMut(RecordRow) -> Result<(), E>,
    ) -> Result<(), E> {
        self.lines(Listing::Records, filter, |line| on_row(parse(line)?))
    }

    /// Names of a listing's columns.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn columns(&self, listing: Listing) -> Result<Vec<String>, StoreError> {
        let names = || -> rusqlite::Result<Vec<String>> {
            let (sql, _) = listing.sql(&Filter::default(), self.orders()?);
            let sql = self.of_now(listing, sql)?;
            let statement = self.connection.prepare(&sql)?;
            Ok(statement.column_names().map(str::to_owned).collect())
        };
        names().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Calls `on_row` with every row of a listing and the names of its columns, in the order of time.
    ///
    /// # Errors
    /// The store cannot be read, or `on_row` failed.
    pub fn list<E: From<StoreError>>(
        &self,
        listing: Listing,
        filter: &Filter,
        mut on_row: impl FnMut(&[String], &[Value]) -> Result<(), E>,
    ) -> Result<(), E> {
        let fault = |error| E::from(self.fault(Failure::Sql(error)));
        if matches!(listing, Listing::Records | Listing::Rejections) {
            self.check(&["record", "mode", "origin"])?;
        }
        if listing == Listing::Records {
            self.check(&["line"])?;
        }
        let names = self.columns(listing)?;
        let (sql, values) = listing.sql(filter, self.orders().map_err(fault)?);
        let sql = self.of_now(listing, sql).map_err(fault)?;
        let mut statement = self.connection.prepare(&sql).map_err(fault)?;
        let mut rows = statement
            .query(rusqlite::params_from_iter(values))
            .map_err(fault)?;
        while let Some(row) = rows.next().map_err(fault)? {
            let values = (0..names.len())
                .map(|place| row.get(place).map(|value| number_of_line(&names[place], value)))
                .collect::<rusqlite::Result<Vec<Value>>>()
                .map_err(fault)?;
            on_row(&names, &values)?;
        }
        Ok(())
    }

    /// Listing of a store of an older format, whose periods lack columns.
    fn of_now(&self, listing: Listing, sql: String) -> rusqlite::Result<String> {
        let stands_in = matches!(listing, Listing::Periods)
            && self
                .connection
                .prepare_cached("SELECT 1 FROM temp.sqlite_master WHERE name = ?")?
                .exists([super::open::LISTED_PERIODS])?;
        Ok(if stands_in {
            sql.replacen("FROM period", &format!("FROM {}", super::open::LISTED_PERIODS), 1)
        } else {
            sql
        })
    }

    /// Highest mode order of any record.
    fn orders(&self) -> rusqlite::Result<i64> {
        self.connection
            .query_row("SELECT coalesce(max(mode_order), 0) FROM mode", (), |row| {
                row.get(0)
            })
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

    /// Number of a rod's records in the store, and of those rejected. Reads every one of them.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn counts(&self, rod: &RodId) -> Result<(u64, u64), StoreError> {
        let counted: (i64, i64) = self
            .connection
            .prepare_cached("SELECT count(*), count(rejection) FROM record WHERE rod = ?")
            .and_then(|mut statement| statement.query_row([&rod.0], |row| Ok((row.get(0)?, row.get(1)?))))
            .map_err(|error| self.fault(Failure::Sql(error)))?;
        Ok((counted.0.unsigned_abs(), counted.1.unsigned_abs()))
    }

    /// Numbers of the records selected whose lines were removed.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn without_line(&self, filter: &Filter) -> Result<WithoutLine, StoreError> {
        let (wanted, values) = filter.sql("start_ns");
        let sql = format!(
            "SELECT count(*), count(rejection),
                count(CASE WHEN rejection IS NULL AND set_aside IS NULL THEN 1 END)
             FROM record WHERE {wanted} AND NOT EXISTS (SELECT 1 FROM line WHERE line.record = record.id)"
        );
        let counted = || -> rusqlite::Result<[i64; 3]> {
            let mut statement = self.connection.prepare_cached(&sql)?;
            statement.query_row(rusqlite::params_from_iter(values), |row| {
                Ok([row.get(0)?, row.get(1)?, row.get(2)?])
            })
        };
        let counted = counted().map_err(|error| self.fault(Failure::Sql(error)))?;
        let [records, refused, used] = counted.map(i64::unsigned_abs);
        Ok(WithoutLine {
            records,
            refused,
            used,
        })
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

/// A number that only the JSON line has, to the bit: SQLite's own reading of decimal digits may be off by the last.
fn number_of_line(name: &str, value: Value) -> Value {
    match value {
        Value::Text(digits) if name == "label_probability" => digits.parse().map_or(Value::Null, Value::Real),
        value => value,
    }
}

/// Numbers of records whose lines were removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WithoutLine {
    /// All of them.
    pub records: u64,
    /// Those refused.
    pub refused: u64,
    /// Those that count.
    pub used: u64,
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

impl Filter {
    /// The selection as an SQL condition with its values; `time` is the column of times in nanoseconds.
    fn sql(&self, time: &str) -> (String, Vec<Value>) {
        let mut wanted = vec!["1".to_owned()];
        let mut values = Vec::new();
        if let Some(rod) = &self.rod {
            wanted.push("rod = ?".to_owned());
            values.push(Value::Text(rod.0.clone()));
        }
        if let Some(from) = self.from {
            wanted.push(format!("{time} >= ?"));
            values.push(Value::Integer(from.as_nanos()));
        }
        if let Some(to) = self.to {
            wanted.push(format!("{time} < ?"));
            values.push(Value::Integer(to.as_nanos()));
        }
        (wanted.join(" AND "), values)
    }
}

impl Listing {
    fn sql(self, filter: &Filter, orders: i64) -> (String, Vec<Value>) {
        match self {
            Self::Records => {
                let (wanted, values) = filter.sql("start_ns");
                let modes: String = (1..=orders)
                    .map(|n| {
                        format!(
                            "(SELECT frequency_hz FROM mode WHERE record = id AND mode_order = {n}) AS mode_{n}_hz,
                             (SELECT sd_hz FROM mode WHERE record = id AND mode_order = {n}) AS mode_{n}_sd_hz,
                             (SELECT damping FROM mode WHERE record = id AND mode_order = {n}) AS mode_{n}_damping,\n"
                        )
                    })
                    .collect();
                let sql = format!(
                    "SELECT rod, start, duration_s, state, state_reason, set_aside, rejection,
                        relative_force_at_reference, relative_force_at_reference_sd,
                        relative_force_at_reference_q025, relative_force_at_reference_q975,
                        force_at_reference_n, force_at_reference_sd_n, force_at_reference_q025_n,
                        force_at_reference_q975_n, reference_temperature_c,
                        relative_force, relative_force_sd, relative_force_q025, relative_force_q975,
                        tracked_force_n, tracked_force_sd_n, temperature_c, not_axial_p,
                        axial_force_n, axial_force_sd_n, axial_force_q025_n, axial_force_q50_n, axial_force_q975_n,
                        {modes}
                        conflict, prior_tail,
                        (SELECT json -> '$.label_probability' FROM line WHERE record = id) AS label_probability,
                        epsilon, draws, accepted, ess, fs_hz, rms, segment,
                        emulator, seed, config, analysis_version, rejection_message,
                        (SELECT file FROM origin WHERE record = id) AS file
                     FROM record WHERE {wanted} ORDER BY rod, start_ns, id"
                );
                (sql, values)
            }
            Self::Rejections => {
                let (wanted, values) = filter.sql("start_ns");
                let sql = format!(
                    "SELECT rod, start, duration_s, fs_hz, rejection, rejection_message, config, analysis_version,
                        (SELECT file FROM origin WHERE record = id) AS file
                     FROM record WHERE {wanted} AND rejection IS NOT NULL ORDER BY rod, start_ns, id"
                );
                (sql, values)
            }
            Self::Periods => {
                let (wanted, values) = filter.sql("start_ns");
                let sql = format!(
                    "SELECT rod, segment, period, start, records, delta, delta_sd, temperature_c, expected, expected_sd,
                        residual, leverage, at_reference, at_reference_sd, not_axial_p,
                        evidence, evidence_peers, evidence_blind
                     FROM period WHERE {wanted} ORDER BY rod, segment, period"
                );
                (sql, values)
            }
            Self::Alarms => {
                let (wanted, values) = filter.sql("raised_ns");
                let sql = format!(
                    "SELECT id, rod, kind, raised, acknowledged, cleared, stands, message,
                        CASE WHEN acknowledged IS NOT NULL THEN {} END AS acknowledged_words
                     FROM alarm WHERE {wanted} ORDER BY raised_ns, rod, id",
                    request::SAID
                );
                (sql, values)
            }
        }
    }
}
