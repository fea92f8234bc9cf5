//! Ordered log of what each commit wrote, for copies of the store elsewhere.
//!
//! A change names rows by table and key; their content is read when it is asked for. Rows that may change
//! later are read as they are then, so a change may already show what a later one names again: who applies
//! all changes in order ends with the same rows.

use super::row::Row;
use super::state::Failure;
use super::{Reader, Store, StoreError, schema};
use rusqlite::types::Value;
use rusqlite::{Connection, OptionalExtension};
use serde_json::Value as Json;

/// Tables that are copied, in an order in which rows can be inserted.
pub const COPIED: [&str; 11] = [
    "config", "rod", "segment", "record", "line", "mode", "period", "alarm", "outbox", "notice", "request",
];

/// Name of the removal of a rod, in place of a table.
pub const FORGOTTEN: &str = "forgotten";

/// Rows written by one commit, in order.
#[derive(Default)]
pub(super) struct Changed(Vec<Json>);

impl Changed {
    /// Notes a row by its table and key. A record stands for its line and modes, too.
    pub(super) fn note(&mut self, table: &str, key: impl IntoIterator<Item = Json>) {
        let mut named = vec![Json::from(table)];
        named.extend(key);
        self.0.push(Json::Array(named));
    }

    /// Appends the change to the log, unless it is empty.
    pub(super) fn write(self, connection: &Connection) -> rusqlite::Result<()> {
        if self.0.is_empty() {
            return Ok(());
        }
        let number: i64 = connection
            .prepare_cached("SELECT coalesce(max(number), 0) + 1 FROM change")?
            .query_row((), |row| row.get(0))?;
        Row::of("change")
            .with("number", number)
            .with("rows", Json::Array(self.0).to_string())
            .insert(connection)
    }
}

/// A commit, as it is copied.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Number in the order of commits, from 1, without gaps.
    pub number: i64,
    /// Rows it wrote, in order.
    pub rows: Vec<ChangedRow>,
}

/// A row of a change.
#[derive(Debug, Clone, PartialEq)]
pub struct ChangedRow {
    /// Name of its table, or [`FORGOTTEN`] with the rod as only value.
    pub table: String,
    /// Values in the order of the table's columns, the checksum last.
    pub values: Vec<Value>,
}

/// Columns of a copied table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shape {
    /// Name of the table.
    pub table: &'static str,
    /// Its columns in order, the checksum last.
    pub columns: Vec<Column>,
}

/// A column of a copied table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// Name of the column.
    pub name: String,
    /// Type of its values.
    pub kind: ValueKind,
    /// True if every row has a value.
    pub is_required: bool,
    /// Place in the primary key, from 1; 0 outside it.
    pub key: usize,
}

/// Type of a column's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueKind {
    /// 64-bit integer.
    Integer,
    /// Double precision.
    Real,
    /// Text.
    Text,
    /// Bytes.
    Blob,
}

impl ValueKind {
    /// True for a value of this type.
    pub fn holds(self, value: &Value) -> bool {
        matches!(
            (self, value),
            (Self::Integer, Value::Integer(_))
                | (Self::Real, Value::Real(_))
                | (Self::Text, Value::Text(_))
                | (Self::Blob, Value::Blob(_))
        )
    }
}

/// Columns of all copied tables, in the order of [`COPIED`].
///
/// # Errors
/// There is no memory for an empty store.
pub fn shapes() -> Result<Vec<Shape>, StoreError> {
    let store = Store::in_memory()?;
    let read = || -> rusqlite::Result<Vec<Shape>> {
        COPIED
            .iter()
            .map(|table| shape(&store.connection, table))
            .collect()
    };
    read().map_err(|error| store.fault(Failure::Sql(error)))
}

fn shape(connection: &Connection, table: &'static str) -> rusqlite::Result<Shape> {
    let mut statement =
        connection.prepare("SELECT name, type, \"notnull\", pk FROM pragma_table_info(?) ORDER BY cid")?;
    let columns = statement.query_map([table], |row| {
        let (kind, key): (String, u32) = (row.get(1)?, row.get(3)?);
        Ok(Column {
            name: row.get(0)?,
            kind: match kind.as_str() {
                "INTEGER" => ValueKind::Integer,
                "REAL" => ValueKind::Real,
                "BLOB" => ValueKind::Blob,
                _ => ValueKind::Text,
            },
            is_required: row.get::<_, bool>(2)? || key > 0,
            key: key as usize,
        })
    })?;
    Ok(Shape {
        table,
        columns: columns.collect::<rusqlite::Result<_>>()?,
    })
}

/// Names the rows of a store that had no log yet, in an order in which they could have come.
pub(super) fn begin_log(connection: &Connection, id: String) -> rusqlite::Result<()> {
    Row::of("epoch").with("id", id).insert(connection)?;
    let of = |sql: &str, table: &str, single: bool| -> rusqlite::Result<()> {
        let mut statement = connection.prepare(sql)?;
        let width = statement.column_count();
        let mut rows = statement.query(())?;
        let mut together = Changed::default();
        while let Some(row) = rows.next()? {
            let key = (0..width).map(|place| match row.get::<_, Value>(place) {
                Ok(Value::Integer(number)) => Json::from(number),
                Ok(Value::Text(text)) => Json::from(text),
                _ => Json::Null,
            });
            together.note(table, key);
            if single || together.0.len() == 100 {
                std::mem::take(&mut together).write(connection)?;
            }
        }
        together.write(connection)
    };
    of("SELECT hash FROM config ORDER BY hash", "config", false)?;
    of(
        "SELECT rod, number FROM segment ORDER BY rod, number",
        "segment",
        // Each holds the particles of a baseline, tens of kilobytes: a hundred together are no message.
        true,
    )?;
    of("SELECT id FROM record ORDER BY id", "record", true)?;
    of(
        "SELECT rod, segment, period FROM period ORDER BY start_ns, rod, segment",
        "period",
        false,
    )?;
    of("SELECT id FROM alarm ORDER BY raised_ns, id", "alarm", false)?;
    of("SELECT number FROM outbox ORDER BY number", "outbox", false)?;
    of("SELECT number FROM notice ORDER BY number", "notice", false)?;
    of(
        "SELECT number FROM request WHERE applied = 1 ORDER BY number",
        "request",
        false,
    )?;
    of("SELECT rod FROM rod ORDER BY rod", "rod", false)
}

fn fresh_id(connection: &Connection) -> rusqlite::Result<String> {
    connection.query_row("SELECT lower(hex(randomblob(8)))", (), |row| row.get(0))
}

/// Key columns of a table as named in a change, and the tables whose rows a name stands for, with their key.
const NAMED: [(&str, &[(&str, &str)]); 9] = [
    ("config", &[("config", "hash = ?1")]),
    ("rod", &[("rod", "rod = ?1")]),
    ("segment", &[("segment", "rod = ?1 AND number = ?2")]),
    (
        "record",
        &[
            ("record", "id = ?1"),
            ("line", "record = ?1"),
            ("mode", "record = ?1 ORDER BY mode_order"),
        ],
    ),
    (
        "period",
        &[("period", "rod = ?1 AND segment = ?2 AND period = ?3")],
    ),
    ("alarm", &[("alarm", "id = ?1")]),
    ("outbox", &[("outbox", "number = ?1")]),
    ("notice", &[("notice", "number = ?1")]),
    ("request", &[("request", "number = ?1")]),
];

impl Store {
    /// Begins the log anew under an id of its own, as if the store had been brought up to this format: what stores of equal
    /// results differ in is gone then.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn restart_log(&mut self, id: &str) -> Result<(), StoreError> {
        let write = |connection: &Connection| -> rusqlite::Result<()> {
            connection.execute_batch("BEGIN; DELETE FROM change; DELETE FROM epoch;")?;
            begin_log(connection, id.to_owned())?;
            connection.execute_batch("COMMIT")
        };
        write(&self.connection).map_err(|error| self.fault(Failure::Sql(error)))
    }
}

impl Reader {
    /// Id of this store, drawn when it was created; `None` for one of an older format.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn epoch(&self) -> Result<Option<String>, StoreError> {
        self.connection
            .query_row("SELECT id FROM epoch", (), |row| row.get(0))
            .optional()
            .map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Number of the latest change, 0 without any.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn latest_change(&self) -> Result<i64, StoreError> {
        let latest = || {
            self.connection
                .prepare_cached("SELECT coalesce(max(number), 0) FROM change")?
                .query_row((), |row| row.get(0))
        };
        latest().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Changes after `number`, in order, at most `limit` of them. A row that was removed since is left out.
    ///
    /// # Errors
    /// They cannot be read, or a number is missing.
    pub fn changes_after(&self, number: i64, limit: usize) -> Result<Vec<Change>, StoreError> {
        let named = || -> rusqlite::Result<Vec<(i64, String)>> {
            let mut statement = self
                .connection
                .prepare_cached("SELECT number, rows FROM change WHERE number > ? ORDER BY number LIMIT ?")?;
            let limit = i64::try_from(limit).unwrap_or(i64::MAX);
            let rows = statement.query_map([number, limit], |row| Ok((row.get(0)?, row.get(1)?)))?;
            rows.collect()
        };
        let named = named().map_err(|error| self.fault(Failure::Sql(error)))?;
        let mut changes = Vec::new();
        for (expected, (found, text)) in (number + 1..).zip(named) {
            let unreadable = |detail: String| StoreError::Unreadable {
                what: format!("change {expected}"),
                detail,
            };
            if found != expected {
                return Err(unreadable("it is missing".to_owned()));
            }
            let names: Vec<Vec<Json>> =
                serde_json::from_str(&text).map_err(|error| unreadable(error.to_string()))?;
            let mut rows = Vec::new();
            for name in &names {
                self.read_named(name, &mut rows)
                    .map_err(|error| self.fault(Failure::Sql(error)))?;
            }
            changes.push(Change { number: found, rows });
        }
        Ok(changes)
    }

    fn read_named(&self, name: &[Json], rows: &mut Vec<ChangedRow>) -> rusqlite::Result<()> {
        let Some((table, key)) = name.split_first() else {
            return Ok(());
        };
        let key: Vec<Value> = key
            .iter()
            .map(|part| match part {
                Json::Number(number) => number.as_i64().map_or(Value::Null, Value::Integer),
                Json::String(text) => Value::Text(text.clone()),
                _ => Value::Null,
            })
            .collect();
        if table == FORGOTTEN {
            rows.push(ChangedRow {
                table: FORGOTTEN.to_owned(),
                values: key,
            });
            return Ok(());
        }
        let known = NAMED.iter().find(|(known, _)| table == known);
        for (table, condition) in known.map_or(&[][..], |(_, tables)| tables) {
            let mut statement = self
                .connection
                .prepare_cached(&format!("SELECT * FROM {table} WHERE {condition}"))?;
            let width = statement.column_count();
            let mut found = statement.query(rusqlite::params_from_iter(&key))?;
            while let Some(row) = found.next()? {
                rows.push(ChangedRow {
                    table: (*table).to_owned(),
                    values: (0..width)
                        .map(|place| row.get(place))
                        .collect::<rusqlite::Result<_>>()?,
                });
            }
        }
        Ok(())
    }

    /// Every row of a copied table in the order of its key, to compare with a copy.
    ///
    /// # Errors
    /// There is no such table, or it cannot be read.
    pub fn copied_rows(&self, shape: &Shape) -> Result<Vec<Vec<Value>>, StoreError> {
        let read = || -> rusqlite::Result<Vec<Vec<Value>>> {
            let mut keys: Vec<&Column> = shape.columns.iter().filter(|column| column.key > 0).collect();
            keys.sort_by_key(|column| column.key);
            let keys: Vec<&str> = keys.iter().map(|column| column.name.as_str()).collect();
            let sql = format!("SELECT * FROM {} ORDER BY {}", shape.table, keys.join(", "));
            let mut statement = self.connection.prepare(&sql)?;
            let width = statement.column_count();
            let rows = statement.query_map((), |row| (0..width).map(|place| row.get(place)).collect())?;
            rows.collect()
        };
        read().map_err(|error| self.fault(Failure::Sql(error)))
    }
}

/// Sixth format: the log of changes and the store's own id.
pub(super) fn add_tables(connection: &Connection) -> rusqlite::Result<()> {
    connection.execute_batch(
        "CREATE TABLE epoch (
            id TEXT PRIMARY KEY,
            checksum INTEGER NOT NULL
        ) STRICT;

        CREATE TABLE change (
            number INTEGER PRIMARY KEY,
            rows TEXT NOT NULL,
            checksum INTEGER NOT NULL
        ) STRICT;",
    )?;
    begin_log(connection, fresh_id(connection)?)
}

/// True if a row's checksum, its last value, is that of the others.
pub fn is_intact(values: &[Value]) -> bool {
    let Some((checksum, others)) = values.split_last() else {
        return false;
    };
    super::row::checksum(others) == *checksum
}

/// Number of the store's format, which fixes the columns of a change.
pub const FORMAT: i64 = schema::FORMAT;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::{RodId, Timestamp};
    use crate::site::store::{Asked, ConditionEvent};

    #[test]
    fn the_log_names_rows_in_order_and_a_row_carries_its_checksum() {
        let mut store = Store::in_memory().unwrap();
        assert_eq!(store.epoch().unwrap().unwrap().len(), 16);
        store.keep_config("a", "tower", "text").unwrap();
        store.keep_config("a", "tower", "text").unwrap();
        let begun = ConditionEvent::raised("sink", "mail", Timestamp::from_nanos(1), "refused");
        store.watch(&[begun], None).unwrap();
        let asked = Asked::Rebaseline { reason: None };
        // A request is copied with its outcome, not before.
        store
            .request(&RodId("r".to_owned()), &asked, Timestamp::from_nanos(1))
            .unwrap();
        store.forget_rod(&RodId("r".to_owned())).unwrap();
        let changes = store.changes_after(0, 10).unwrap();
        let tables: Vec<(i64, &str)> = changes
            .iter()
            .map(|change| (change.number, change.rows[0].table.as_str()))
            .collect();
        assert_eq!(tables, [(1, "config"), (2, "notice"), (3, FORGOTTEN)]);
        let row = &changes[0].rows[0].values;
        assert!(is_intact(row));
        let mut other = row.clone();
        other[1] = Value::Text("towers".to_owned());
        assert!(!is_intact(&other) && !is_intact(&[]));
        assert_eq!(store.changes_after(2, 10).unwrap(), changes[2..]);
    }

    #[test]
    fn every_copied_table_has_a_key_and_ends_with_its_checksum() {
        for shape in shapes().unwrap() {
            assert!(shape.columns.iter().any(|column| column.key == 1), "{shape:?}");
            assert_eq!(shape.columns.last().unwrap().name, "checksum");
        }
    }
}
