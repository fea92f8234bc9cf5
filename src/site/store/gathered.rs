//! A store made of the rows that a copy elsewhere kept: results to read, without the states from which a daemon goes on.

use super::change::Shape;
use super::row::Row;
use super::state::Failure;
use super::{Store, StoreError, schema};
use rusqlite::types::Value;
use rusqlite::{Connection, OptionalExtension};

/// Site of which a store is a copy, if it is one.
pub(super) fn site_of(connection: &Connection) -> rusqlite::Result<Option<String>> {
    if !schema::has(connection, "gathered")? {
        return Ok(None);
    }
    connection
        .query_row("SELECT site FROM gathered", (), |row| row.get(0))
        .optional()
}

impl Store {
    /// Marks this store as a copy of a site's rows: nobody opens it for writing again.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn mark_gathered(&mut self, site: &str) -> Result<(), StoreError> {
        let row = Row::of("gathered").with("site", site.to_owned());
        row.upsert(&self.reader.connection, &["site"])
            .map_err(|error| self.reader.fault(Failure::Sql(error)))
    }

    /// Takes rows of a copied table as they are, each with its checksum; a row of the same key is replaced. Within a
    /// [group](Store::begin_group) they become durable together.
    ///
    /// # Errors
    /// They are not of that table, refer to rows that are not here, or cannot be written.
    pub fn gather(&mut self, shape: &Shape, rows: &[Vec<Value>]) -> Result<(), StoreError> {
        let write = |connection: &Connection| -> rusqlite::Result<()> {
            let mut statement = connection.prepare_cached(&upsert(shape))?;
            for row in rows {
                statement.execute(rusqlite::params_from_iter(row))?;
            }
            Ok(())
        };
        write(&self.reader.connection).map_err(|error| self.reader.fault(Failure::Sql(error)))
    }

    /// Removes the rods that are not among `kept`, which never had a record.
    ///
    /// # Errors
    /// They cannot be removed.
    pub fn gather_no_others(&mut self, kept: &[String]) -> Result<(), StoreError> {
        let write = |connection: &Connection| -> rusqlite::Result<()> {
            let mut statement = connection.prepare_cached("SELECT rod FROM rod")?;
            let here: Vec<String> = statement
                .query_map((), |row| row.get(0))?
                .collect::<rusqlite::Result<_>>()?;
            for rod in here.iter().filter(|rod| !kept.contains(rod)) {
                for table in ["segment", "rod"] {
                    connection.execute(&format!("DELETE FROM {table} WHERE rod = ?"), [rod])?;
                }
            }
            Ok(())
        };
        write(&self.reader.connection).map_err(|error| self.reader.fault(Failure::Sql(error)))
    }

    /// Number of the latest record; 0 without any.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn latest_record(&self) -> Result<i64, StoreError> {
        let latest = || {
            let connection = &self.reader.connection;
            connection
                .query_row("SELECT max(id) FROM record", (), |row| {
                    row.get::<_, Option<i64>>(0)
                })
                .optional()
        };
        let found = latest().map_err(|error| self.reader.fault(Failure::Sql(error)))?;
        Ok(found.flatten().unwrap_or(0))
    }
}

/// Statement that writes one row. Not `REPLACE`, which would remove a row that others refer to.
fn upsert(shape: &Shape) -> String {
    let all: Vec<&str> = shape.columns.iter().map(|column| column.name.as_str()).collect();
    let of = |is_key: bool| {
        let columns = shape
            .columns
            .iter()
            .filter(move |column| (column.key > 0) == is_key);
        columns.map(|column| column.name.as_str())
    };
    let updates: Vec<String> = of(false)
        .map(|name| format!("{name} = excluded.{name}"))
        .collect();
    format!(
        "INSERT INTO {} ({}) VALUES ({}) ON CONFLICT ({}) DO UPDATE SET {}",
        shape.table,
        all.join(", "),
        vec!["?"; all.len()].join(", "),
        of(true).collect::<Vec<_>>().join(", "),
        updates.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::{RodId, Timestamp};
    use crate::site::store::{Asked, ConditionEvent, Durability, Reader, shapes};

    #[test]
    fn gathered_rows_are_those_of_the_store_and_newer_ones_take_their_place() {
        let mut from = Store::in_memory().unwrap();
        from.keep_config("a", "tower", "text").unwrap();
        let begun = ConditionEvent::raised("sink", "mail", Timestamp::from_nanos(1), "refused");
        from.watch(&[begun], None).unwrap();
        let asked = Asked::Rebaseline { reason: None };
        from.request(&RodId("r".to_owned()), &asked, Timestamp::from_nanos(1))
            .unwrap();
        let mut to = Store::in_memory().unwrap();
        for _ in 0..2 {
            for shape in shapes().unwrap() {
                to.gather(&shape, &from.copied_rows(&shape).unwrap()).unwrap();
            }
        }
        for shape in shapes().unwrap() {
            assert_eq!(to.copied_rows(&shape).unwrap(), from.copied_rows(&shape).unwrap());
        }
        to.check_all().unwrap();
        assert_eq!(to.latest_record().unwrap(), 0);
        // Nothing goes on with a copy that is marked, and every command reads it.
        let folder = tempfile::tempdir().unwrap();
        let copy = folder.path().join("copy.db");
        to.mark_gathered("todi").unwrap();
        to.copy_to(&copy).unwrap();
        let refused = Store::open(&copy, Durability::Full);
        let said = refused.err().unwrap().to_string();
        assert!(
            said.contains("copy of site todi") && said.contains("name another store"),
            "{said}"
        );
        assert!(!folder.path().join("copy.db.lock").exists());
        assert_eq!(Reader::open(&copy).unwrap().latest_notice().unwrap(), 1);
        // What refers to nothing is refused.
        let modes = shapes()
            .unwrap()
            .into_iter()
            .find(|shape| shape.table == "mode")
            .unwrap();
        let row = vec![
            Value::Integer(7),
            Value::Integer(1),
            Value::Real(9.0),
            Value::Real(0.1),
            Value::Null,
            Value::Integer(0),
        ];
        assert!(to.gather(&modes, &[row]).is_err());
    }
}
