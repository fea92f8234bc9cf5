//! Rows with a checksum each, so that a changed row is detected on reading.

use rusqlite::types::{Value, ValueRef};
use rusqlite::{Connection, Params, Statement};

/// Column of the checksum, the last of every table.
const CHECKSUM: &str = "checksum";

/// A row to be written: its columns in the table's order.
pub(super) struct Row {
    table: &'static str,
    columns: Vec<(&'static str, Value)>,
}

impl Row {
    /// An empty row of a table.
    pub(super) fn of(table: &'static str) -> Self {
        Self {
            table,
            columns: Vec::new(),
        }
    }

    /// Adds the next column.
    pub(super) fn with(mut self, column: &'static str, value: impl Into<Value>) -> Self {
        self.put(column, value);
        self
    }

    /// Adds the next column.
    pub(super) fn put(&mut self, column: &'static str, value: impl Into<Value>) {
        let value = match value.into() {
            // Neither survives in a table: not-a-number reads back as NULL, negative zero as zero.
            Value::Real(number) if number.is_nan() => Value::Null,
            Value::Real(number) => Value::Real(number + 0.0),
            other => other,
        };
        self.columns.push((column, value));
    }

    /// Inserts the row; an existing row is an error.
    pub(super) fn insert(self, connection: &Connection) -> rusqlite::Result<()> {
        self.write(connection, &[])
    }

    /// Inserts the row, or replaces the one with the same key.
    pub(super) fn upsert(self, connection: &Connection, key: &[&str]) -> rusqlite::Result<()> {
        self.write(connection, key)
    }

    fn write(self, connection: &Connection, key: &[&str]) -> rusqlite::Result<()> {
        let sum = checksum(self.columns.iter().map(|(_, value)| value));
        let names: Vec<&str> = self.columns.iter().map(|(name, _)| *name).collect();
        let mut sql = format!(
            "INSERT INTO {} ({}, {CHECKSUM}) VALUES ({}?)",
            self.table,
            names.join(", "),
            "?, ".repeat(names.len())
        );
        if !key.is_empty() {
            let updates: Vec<String> = names
                .iter()
                .chain(&[CHECKSUM])
                .filter(|name| !key.contains(name))
                .map(|name| format!("{name} = excluded.{name}"))
                .collect();
            sql += &format!(
                " ON CONFLICT ({}) DO UPDATE SET {}",
                key.join(", "),
                updates.join(", ")
            );
        }
        let values = self.columns.into_iter().map(|(_, value)| value);
        connection
            .prepare_cached(&sql)?
            .execute(rusqlite::params_from_iter(values.chain([sum])))?;
        Ok(())
    }
}

/// Checksum of a row's other values.
pub(super) fn checksum<'v>(values: impl IntoIterator<Item = &'v Value>) -> Value {
    let mut sum = Sum::default();
    for value in values {
        sum.add(value.into());
    }
    sum.value()
}

/// Compares every row of a table with its checksum and calls `on_row` with the good ones; returns the number
/// of the first bad one, if any.
pub(super) fn verify(
    connection: &Connection,
    table: &str,
    on_row: impl FnMut(&rusqlite::Row<'_>) -> rusqlite::Result<()>,
) -> rusqlite::Result<Option<usize>> {
    verify_where(connection, table, "1", (), on_row)
}

/// As [`verify`], for the rows that meet a condition, which may end in an order and a limit.
pub(super) fn verify_where(
    connection: &Connection,
    table: &str,
    condition: &str,
    parameters: impl Params,
    mut on_row: impl FnMut(&rusqlite::Row<'_>) -> rusqlite::Result<()>,
) -> rusqlite::Result<Option<usize>> {
    let mut statement = connection.prepare_cached(&format!("SELECT * FROM {table} WHERE {condition}"))?;
    let places = places(&statement)?;
    let mut rows = statement.query(parameters)?;
    let mut number = 0;
    while let Some(row) = rows.next()? {
        number += 1;
        let mut sum = Sum::default();
        for &place in &places.others {
            sum.add(row.get_ref(place)?);
        }
        if row.get_ref(places.checksum)? != ValueRef::from(&sum.value()) {
            return Ok(Some(number));
        }
        on_row(row)?;
    }
    Ok(None)
}

struct Places {
    checksum: usize,
    others: Vec<usize>,
}

fn places(statement: &Statement<'_>) -> rusqlite::Result<Places> {
    let checksum = statement.column_index(CHECKSUM)?;
    let others = (0..statement.column_count())
        .filter(|place| *place != checksum)
        .collect();
    Ok(Places { checksum, others })
}

/// CRC-32 of a row's values, each with its type and length.
#[derive(Default)]
struct Sum(crc32fast::Hasher);

impl Sum {
    fn add(&mut self, value: ValueRef<'_>) {
        let mut part = |tag: u8, bytes: &[u8]| {
            self.0.update(&[tag]);
            self.0.update(&(bytes.len() as u64).to_le_bytes());
            self.0.update(bytes);
        };
        match value {
            ValueRef::Null => part(0, &[]),
            ValueRef::Integer(number) => part(1, &number.to_le_bytes()),
            ValueRef::Real(number) => part(2, &number.to_bits().to_le_bytes()),
            ValueRef::Text(text) => part(3, text),
            ValueRef::Blob(bytes) => part(4, bytes),
        }
    }

    fn value(self) -> Value {
        Value::Integer(i64::from(self.0.finalize()))
    }
}
