//! The remainder of a store: rows from which a daemon goes on, beside those that copies of the store have.
//!
//! With the copied rows of the same moment it makes a store again, under its id and with the number of its last commit.

use super::row::Row;
use super::state::Failure;
use super::{Reader, Store, StoreError, schema};
use rusqlite::types::Value;
use rusqlite::{Connection, OptionalExtension, params_from_iter};
use serde::{Deserialize, Serialize};

/// Tables of the remainder. Left out are those of a machine (`file`, `origin`, `source`, `delivery`) and what only an analysis without
/// samples reads (`resonance`).
const TABLES: [&str; 7] = [
    "state", "snapshot", "carry", "expected", "alive", "shelf", "request",
];

/// Rows from which a daemon goes on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Remainder {
    /// Format of the store, which fixes the columns.
    format: i64,
    /// Id of the store.
    pub epoch: String,
    /// Number of its last commit.
    pub through: i64,
    tables: Vec<(String, Vec<Vec<Cell>>)>,
}

/// A value of a row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Cell {
    Null,
    Integer(i64),
    Real(f64),
    Text(String),
    Blob(Vec<u8>),
}

impl From<Value> for Cell {
    fn from(value: Value) -> Self {
        match value {
            Value::Null => Self::Null,
            Value::Integer(number) => Self::Integer(number),
            Value::Real(number) => Self::Real(number),
            Value::Text(text) => Self::Text(text),
            Value::Blob(bytes) => Self::Blob(bytes),
        }
    }
}

impl From<Cell> for Value {
    fn from(cell: Cell) -> Self {
        match cell {
            Cell::Null => Self::Null,
            Cell::Integer(number) => Self::Integer(number),
            Cell::Real(number) => Self::Real(number),
            Cell::Text(text) => Self::Text(text),
            Cell::Blob(bytes) => Self::Blob(bytes),
        }
    }
}

impl Remainder {
    /// As bytes.
    ///
    /// # Errors
    /// They cannot be compressed.
    pub fn encode(&self) -> Result<Vec<u8>, StoreError> {
        let bytes = postcard::to_stdvec(self).map_err(unreadable)?;
        zstd::encode_all(bytes.as_slice(), 3).map_err(unreadable)
    }

    /// From such bytes.
    ///
    /// # Errors
    /// They are not those of a remainder, or of a store of another format.
    pub fn decode(bytes: &[u8]) -> Result<Self, StoreError> {
        let bytes = zstd::decode_all(bytes).map_err(unreadable)?;
        // The format comes first: another one need not be readable beyond it.
        let (format, _) = postcard::take_from_bytes::<i64>(&bytes).map_err(unreadable)?;
        if format != schema::FORMAT {
            return Err(unreadable(format_args!(
                "it is of store format {format}, and this program knows {}: all workers are to be of one version",
                schema::FORMAT
            )));
        }
        postcard::from_bytes(&bytes).map_err(unreadable)
    }
}

fn unreadable(detail: impl std::fmt::Display) -> StoreError {
    StoreError::Unreadable {
        what: "the kept state of a site".to_owned(),
        detail: detail.to_string(),
    }
}

impl Reader {
    /// The remainder of this store.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn remainder(&self) -> Result<Remainder, StoreError> {
        let read = |table: &&str| -> rusqlite::Result<(String, Vec<Vec<Cell>>)> {
            let mut statement = self
                .connection
                .prepare_cached(&format!("SELECT * FROM {table}"))?;
            let width = statement.column_count();
            let rows = statement.query_map((), |row| {
                (0..width)
                    .map(|place| row.get::<_, Value>(place).map(Cell::from))
                    .collect()
            })?;
            Ok(((*table).to_owned(), rows.collect::<rusqlite::Result<_>>()?))
        };
        let tables: rusqlite::Result<Vec<_>> = TABLES.iter().map(read).collect();
        Ok(Remainder {
            format: schema::FORMAT,
            epoch: self.epoch()?.unwrap_or_default(),
            through: self.latest_change()?,
            tables: tables.map_err(|error| self.fault(Failure::Sql(error)))?,
        })
    }

    /// Losses of files that a daemon has read to their end, each in a sentence, if any; `None` if one of them is not read.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn losses_of(
        &self,
        files: impl Iterator<Item = impl AsRef<str>>,
    ) -> Result<Option<Vec<Option<String>>>, StoreError> {
        let losses = || -> rusqlite::Result<Option<Vec<Option<String>>>> {
            let mut statement = self
                .connection
                .prepare_cached("SELECT detail FROM file WHERE name = ?")?;
            let details = files.map(|name| {
                let detail = statement.query_row([name.as_ref()], |row| row.get(0));
                detail.optional()
            });
            details.collect()
        };
        losses().map_err(|error| self.fault(Failure::Sql(error)))
    }
}

impl Store {
    /// Goes on as the store that the remainder was read from: the copied rows of its last commit are here, or it had none.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn take_up(&mut self, remainder: Remainder) -> Result<(), StoreError> {
        let write = |connection: &Connection| -> rusqlite::Result<()> {
            connection
                .execute_batch("BEGIN; DELETE FROM gathered; DELETE FROM epoch; DELETE FROM change;")?;
            Row::of("epoch").with("id", remainder.epoch).insert(connection)?;
            if remainder.through > 0 {
                // Numbers go on behind it; its rows are at the copy.
                Row::of("change")
                    .with("number", remainder.through)
                    .with("rows", "[]".to_owned())
                    .insert(connection)?;
            }
            for (table, rows) in remainder.tables {
                let Some(table) = TABLES.iter().find(|known| **known == table) else {
                    continue;
                };
                for row in rows {
                    let places = vec!["?"; row.len()].join(", ");
                    connection
                        .prepare_cached(&format!("INSERT OR REPLACE INTO {table} VALUES ({places})"))?
                        .execute(params_from_iter(row.into_iter().map(Value::from)))?;
                }
            }
            connection.execute_batch("COMMIT")
        };
        write(&self.reader.connection).map_err(|error| self.reader.fault(Failure::Sql(error)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::{RodId, Timestamp};
    use crate::site::store::{Asked, ConditionEvent, Durability, Shape, shapes};

    #[test]
    fn copied_rows_and_remainder_make_the_store_again() {
        let mut from = Store::in_memory().unwrap();
        from.keep_config("a", "tower", "text").unwrap();
        let asked = Asked::Rebaseline { reason: None };
        from.request(&RodId("r".to_owned()), &asked, Timestamp::from_nanos(1))
            .unwrap();
        let mut to = Store::in_memory().unwrap();
        to.mark_gathered("todi").unwrap();
        let copied = |from: &Reader, shape: &Shape| from.copied_rows(shape).unwrap();
        for shape in shapes().unwrap() {
            to.gather(&shape, &copied(&from, &shape)).unwrap();
        }
        let remainder = from.remainder().unwrap();
        let kept = Remainder::decode(&remainder.encode().unwrap()).unwrap();
        assert_eq!(kept, remainder);
        to.take_up(kept).unwrap();
        assert_eq!(to.remainder().unwrap(), remainder);
        assert_eq!(to.epoch().unwrap(), from.epoch().unwrap());
        // Both go on with the same numbers.
        for store in [&mut from, &mut to] {
            let begun = ConditionEvent::raised("sink", "mail", Timestamp::from_nanos(1), "refused");
            store.watch(&[begun], None).unwrap();
        }
        let after = remainder.through;
        assert!(after > 0);
        assert_eq!(
            to.changes_after(after, 9).unwrap(),
            from.changes_after(after, 9).unwrap()
        );
        to.check_all().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("again.db");
        to.copy_to(&path).unwrap();
        // Nothing marks it as a copy any more.
        Store::open(&path, Durability::Full).unwrap();
        assert!(Remainder::decode(b"nothing").is_err());
    }
}
