//! Findings of records' samples in the order of the fold, for an analysis without samples: one row a record, and
//! one for temperatures that belong to none.

use super::row::{self, Row};
use super::state::Failure;
use super::{Reader, StoreError};
use crate::analysis::signal::record::RodId;
use crate::site::found::Found;
use rusqlite::Connection;

/// Findings of one input of the fold.
#[derive(Debug, Clone)]
pub struct FoundRow {
    /// Place in the order of the fold.
    pub number: i64,
    /// Id of the rod.
    pub rod: RodId,
    /// Identity of the record; for temperatures that belong to none, of the record before them, if any.
    pub identity: Option<[u8; 32]>,
    /// The findings.
    pub found: Found,
}

/// What records of one kind were made with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Made {
    /// Hash of their configuration.
    pub config: String,
    /// Version of their analysis.
    pub analysis_version: Option<u32>,
}

/// Adds the table to a store that lacks it.
pub(super) fn add_table(connection: &Connection) -> rusqlite::Result<()> {
    connection.execute_batch(
        "CREATE TABLE resonance (
            number INTEGER PRIMARY KEY,
            rod TEXT NOT NULL,
            record INTEGER NOT NULL,
            part INTEGER NOT NULL,
            body BLOB NOT NULL,
            checksum INTEGER NOT NULL
        ) STRICT;
        CREATE UNIQUE INDEX resonance_readings ON resonance (rod, part) WHERE part > 0;",
    )
}

/// Writes the findings of a record.
pub(super) fn write(connection: &Connection, rod: &RodId, record: i64, found: &Found) -> Result<(), Failure> {
    insert(connection, rod, record, 0, found)
}

/// Writes temperatures that came after a rod's record committed last, unless they are there.
pub(super) fn write_readings(
    connection: &Connection,
    rod: &RodId,
    first_ns: i64,
    found: &Found,
) -> Result<(), Failure> {
    // Zero marks the findings of a record.
    let part = first_ns.max(1);
    // By their time alone: when an archive is replayed again, another record is the last one committed.
    let is_known = connection
        .prepare_cached("SELECT 1 FROM resonance WHERE rod = ? AND part = ? AND part > 0")?
        .exists((&rod.0, part))?;
    if is_known {
        return Ok(());
    }
    let record: i64 = connection
        .prepare_cached("SELECT coalesce(max(id), 0) FROM record WHERE rod = ?")?
        .query_row([&rod.0], |row| row.get(0))?;
    insert(connection, rod, record, part, found)
}

fn insert(
    connection: &Connection,
    rod: &RodId,
    record: i64,
    part: i64,
    found: &Found,
) -> Result<(), Failure> {
    let number: i64 = connection
        .prepare_cached("SELECT coalesce(max(number), 0) + 1 FROM resonance")?
        .query_row((), |row| row.get(0))?;
    Row::of("resonance")
        .with("number", number)
        .with("rod", rod.0.clone())
        .with("record", record)
        .with("part", part)
        .with("body", found.encode())
        .insert(connection)?;
    Ok(())
}

impl Reader {
    /// Findings after a number in the order of the fold, at most `most` of them.
    ///
    /// # Errors
    /// The store cannot be read, or a row is not what was written.
    pub fn found(&self, after: i64, most: usize) -> Result<Vec<FoundRow>, StoreError> {
        self.try_found(after, most).map_err(|failure| self.fault(failure))
    }

    fn try_found(&self, after: i64, most: usize) -> Result<Vec<FoundRow>, Failure> {
        let mut rows: Vec<(i64, String, i64, Vec<u8>)> = Vec::new();
        let most = i64::try_from(most).unwrap_or(i64::MAX);
        let condition = "number > ? ORDER BY number LIMIT ?";
        let bad = row::verify_where(&self.connection, "resonance", condition, (after, most), |row| {
            rows.push((
                row.get("number")?,
                row.get("rod")?,
                row.get("record")?,
                row.get("body")?,
            ));
            Ok(())
        })?;
        if let Some(bad) = bad {
            return Err(Failure::Other(StoreError::Damaged {
                path: self.path.clone(),
                detail: format!("row {bad} after {after} of table resonance is not what was written"),
            }));
        }
        let mut statement = self
            .connection
            .prepare_cached("SELECT identity FROM record WHERE id = ?")?;
        let mut found = Vec::with_capacity(rows.len());
        for (number, rod, record, body) in rows {
            let identity = match record {
                0 => None,
                id => Some(statement.query_row([id], |row| row.get(0))?),
            };
            found.push(FoundRow {
                number,
                identity,
                found: Found::decode(&body).map_err(|error| {
                    Failure::Other(StoreError::Unreadable {
                        what: format!("the resonances of a record of rod {rod}"),
                        detail: error.to_string(),
                    })
                })?,
                rod: RodId(rod),
            });
        }
        Ok(found)
    }

    /// Number of inputs of the fold with findings, for progress.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn count_found(&self) -> Result<u64, StoreError> {
        self.connection
            .query_row("SELECT count(*) FROM resonance", (), |row| row.get(0))
            .map(i64::unsigned_abs)
            .map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Number of records whose findings are not in the store, and the first of them: rod, start, and the reason if it
    /// was refused.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn without_findings(&self) -> Result<Option<(u64, [String; 3])>, StoreError> {
        const MISSING: &str = "id NOT IN (SELECT record FROM resonance WHERE part = 0)";
        let ask = || -> rusqlite::Result<Option<(u64, [String; 3])>> {
            let count: i64 = self.connection.query_row(
                &format!("SELECT count(*) FROM record WHERE {MISSING}"),
                (),
                |row| row.get(0),
            )?;
            if count == 0 {
                return Ok(None);
            }
            let sql = format!(
                "SELECT rod, coalesce(start, 'unknown time'), coalesce(rejection, '') FROM record WHERE {MISSING} ORDER BY id LIMIT 1"
            );
            let first = self
                .connection
                .query_row(&sql, (), |row| Ok([row.get(0)?, row.get(1)?, row.get(2)?]))?;
            Ok(Some((count.unsigned_abs(), first)))
        };
        ask().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Configurations and versions that any record was made with.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn made_with(&self) -> Result<Vec<Made>, StoreError> {
        let ask = || -> rusqlite::Result<Vec<Made>> {
            let mut statement = self
                .connection
                .prepare("SELECT DISTINCT config, analysis_version FROM record ORDER BY 1, 2")?;
            let rows = statement.query_map((), |row| {
                Ok(Made {
                    config: row.get(0)?,
                    analysis_version: row.get(1)?,
                })
            })?;
            rows.collect()
        };
        ask().map_err(|error| self.fault(Failure::Sql(error)))
    }
}
