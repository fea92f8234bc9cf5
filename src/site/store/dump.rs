//! A store as text, to compare two of them.

use super::schema::RESULTS;
use super::state::Failure;
use super::{Reader, StoreError};
use crate::site::hex::hex;
use rusqlite::Connection;
use rusqlite::types::{ToSqlOutput, ValueRef};
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

    /// Appends the rows of every table of results to a database of many sites: the same tables with the site in front
    /// of each row and of each key.
    ///
    /// # Errors
    /// The store cannot be read, or the database not be written.
    pub fn append_to(&self, many: &Connection, site: &str) -> Result<(), StoreError> {
        self.try_append_to(many, site)
            .map_err(|error| self.fault(Failure::Sql(error)))
    }

    fn try_append_to(&self, many: &Connection, site: &str) -> rusqlite::Result<()> {
        many.execute_batch("BEGIN")?;
        for table in RESULTS.into_iter().chain(["resonance"]) {
            let columns: Vec<(String, String, i64)> = self
                .connection
                .prepare("SELECT name, type, pk FROM pragma_table_info(?)")?
                .query_map([table], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?
                .collect::<rusqlite::Result<_>>()?;
            let mut keys: Vec<(i64, &str)> = columns
                .iter()
                .filter(|(_, _, place)| *place > 0)
                .map(|(name, _, place)| (*place, name.as_str()))
                .collect();
            keys.sort_unstable();
            let keys: Vec<&str> = keys.into_iter().map(|(_, name)| name).collect();
            let declared: Vec<String> = columns
                .iter()
                .map(|(name, kind, _)| match name.as_str() {
                    // The first column is the site of the archive; this one is the name in its configuration.
                    "site" => format!("site_name {kind}"),
                    name => format!("{name} {kind}"),
                })
                .collect();
            many.execute_batch(&format!(
                "CREATE TABLE IF NOT EXISTS {table} (site TEXT NOT NULL, {}, PRIMARY KEY (site, {})) STRICT;",
                declared.join(", "),
                keys.join(", ")
            ))?;
            let mut insert = many.prepare(&format!(
                "INSERT INTO {table} VALUES (?{})",
                ", ?".repeat(columns.len())
            ))?;
            let mut statement = self
                .connection
                .prepare(&format!("SELECT * FROM {table} ORDER BY {}", keys.join(", ")))?;
            let mut rows = statement.query(())?;
            while let Some(row) = rows.next()? {
                insert.raw_bind_parameter(1, site)?;
                for place in 0..columns.len() {
                    insert.raw_bind_parameter(place + 2, ToSqlOutput::Borrowed(row.get_ref(place)?))?;
                }
                insert.raw_execute()?;
            }
        }
        many.execute_batch("COMMIT")
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
