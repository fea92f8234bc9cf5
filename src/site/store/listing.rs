//! Listings of a store: records, rejections, periods and alarms, selected by rod and time.

use super::read::{Reader, parse};
use super::request;
use super::state::Failure;
use super::{StoreError, open};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::site::record_row::RecordRow;
use rusqlite::types::Value;

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

impl Reader {
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
                .exists([open::LISTED_PERIODS])?;
        Ok(if stands_in {
            sql.replacen("FROM period", &format!("FROM {}", open::LISTED_PERIODS), 1)
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
}

impl Filter {
    /// The selection as an SQL condition with its values; `time` is the column of times in nanoseconds.
    pub(super) fn sql(&self, time: &str) -> (String, Vec<Value>) {
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

/// A number that only the JSON line has, to the bit: SQLite's own reading of decimal digits may be off by the last.
fn number_of_line(name: &str, value: Value) -> Value {
    match value {
        Value::Text(digits) if name == "label_probability" => digits.parse().map_or(Value::Null, Value::Real),
        value => value,
    }
}
