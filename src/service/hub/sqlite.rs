//! A file as the centre's database.

use super::sql::{Sql, SqlError};
use rusqlite::types::Value;
use rusqlite::{Connection, OpenFlags};
use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;
use std::time::Duration;

/// Longest wait for another connection's transaction.
const PATIENCE: Duration = Duration::from_secs(20);
/// Number of prepared statements kept.
const STATEMENTS: usize = 256;

/// A file as database.
pub struct Sqlite {
    connection: Connection,
    /// Held by the one that folds, to the end of its life.
    _lock: Option<File>,
}

impl Sqlite {
    /// Opens or creates the file for folding, which one process does at a time.
    ///
    /// # Errors
    /// Another hub has it, or it cannot be opened.
    pub fn open(path: &Path) -> Result<Self, SqlError> {
        let refused = |what: String| SqlError::Refused(format!("{}: {what}", path.display()));
        let mut lock = path.as_os_str().to_owned();
        lock.push(".lock");
        let lock = OpenOptions::new()
            .create(true)
            .append(true)
            .open(lock)
            .map_err(|error| refused(error.to_string()))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(refused("another hub folds into it".to_owned())),
            Err(TryLockError::Error(error)) => return Err(refused(error.to_string())),
        }
        let connection = Connection::open(path)?;
        settle(&connection)?;
        connection.pragma_update(None, "journal_mode", "WAL")?;
        connection.pragma_update(None, "synchronous", "FULL")?;
        Ok(Self {
            connection,
            _lock: Some(lock),
        })
    }

    /// Opens the file for reading beside the hub.
    ///
    /// # Errors
    /// There is none, or it cannot be read.
    pub fn beside(path: &Path) -> Result<Self, SqlError> {
        let connection = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE)
            .map_err(|error| SqlError::Refused(format!("{}: {error}", path.display())))?;
        settle(&connection)?;
        Ok(Self {
            connection,
            _lock: None,
        })
    }
}

fn settle(connection: &Connection) -> Result<(), SqlError> {
    connection.busy_timeout(PATIENCE)?;
    connection.set_prepared_statement_cache_capacity(STATEMENTS);
    Ok(())
}

impl Sql for Sqlite {
    fn is_postgres(&self) -> bool {
        false
    }

    fn batch(&mut self, sql: &str) -> Result<(), SqlError> {
        Ok(self.connection.execute_batch(sql)?)
    }

    fn execute(&mut self, sql: &str, values: &[Value]) -> Result<u64, SqlError> {
        let mut statement = self.connection.prepare_cached(sql)?;
        Ok(statement.execute(rusqlite::params_from_iter(values))? as u64)
    }

    fn query(&mut self, sql: &str, values: &[Value]) -> Result<Vec<Vec<Value>>, SqlError> {
        let mut statement = self.connection.prepare_cached(sql)?;
        let width = statement.column_count();
        let rows = statement.query_map(rusqlite::params_from_iter(values), |row| {
            (0..width).map(|place| row.get(place)).collect()
        })?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }
}
