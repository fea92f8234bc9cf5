//! A store as text, to compare two of them.

use super::schema::RESULTS;
use super::state::Failure;
use super::{Reader, StoreError};
use crate::site::hex::hex;
use rusqlite::types::ValueRef;
use std::fmt::Write;

impl Reader {
    /// Every row of every table of results, one per line, in the order of the keys. Tables that describe how
    /// a store came to be (sources, requests) are left out: two stores with equal results have equal dumps.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn dump(&self) -> Result<String, StoreError> {
        self.try_dump().map_err(|error| self.fault(Failure::Sql(error)))
    }

    fn try_dump(&self) -> rusqlite::Result<String> {
        let mut out = String::new();
        for table in RESULTS {
            let mut keys = self
                .connection
                .prepare("SELECT name FROM pragma_table_info(?) WHERE pk > 0 ORDER BY pk")?;
            let keys: Vec<String> = keys
                .query_map([table], |row| row.get(0))?
                .collect::<rusqlite::Result<_>>()?;
            let sql = format!("SELECT * FROM {table} ORDER BY {}", keys.join(", "));
            let mut statement = self.connection.prepare(&sql)?;
            let names: Vec<&str> = statement.column_names().collect();
            // Writing to a string cannot fail.
            let _ = writeln!(out, "# {table}: {}", names.join(" "));
            let columns = statement.column_count();
            let mut rows = statement.query(())?;
            while let Some(row) = rows.next()? {
                for place in 0..columns {
                    let separator = if place > 0 { "\t" } else { "" };
                    let _ = match row.get_ref(place)? {
                        ValueRef::Null => write!(out, "{separator}-"),
                        ValueRef::Integer(number) => write!(out, "{separator}{number}"),
                        ValueRef::Real(number) => write!(out, "{separator}{number:?}"),
                        ValueRef::Text(text) => write!(out, "{separator}{:?}", String::from_utf8_lossy(text)),
                        ValueRef::Blob(bytes) => write!(out, "{separator}x{}", hex(bytes)),
                    };
                }
                out.push('\n');
            }
        }
        Ok(out)
    }
}
