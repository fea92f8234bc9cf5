//! The little SQL that SQLite and PostgreSQL share: values in, values out, a transaction.

use rusqlite::types::Value;

/// Error of the centre's database.
#[derive(Debug, thiserror::Error)]
pub enum SqlError {
    /// SQLite.
    #[error(transparent)]
    Sqlite(#[from] rusqlite::Error),
    /// PostgreSQL, in the server's own words.
    #[error("{0}")]
    Postgres(String),
    /// It cannot be opened, or is another program's.
    #[error("{0}")]
    Refused(String),
}

impl From<postgres::Error> for SqlError {
    fn from(error: postgres::Error) -> Self {
        Self::Postgres(match error.as_db_error() {
            Some(said) => format!("{}: {}", said.severity(), said.message()),
            None => {
                let cause = std::error::Error::source(&error).map(|cause| format!(": {cause}"));
                format!("{error}{}", cause.unwrap_or_default())
            }
        })
    }
}

/// Database of the centre. Placeholders are `$1`, `$2`, … in the order of their first use.
pub trait Sql: Send {
    /// True for PostgreSQL: tables are partitioned, bytes and numbers have its names.
    fn is_postgres(&self) -> bool;

    /// Runs statements without values.
    ///
    /// # Errors
    /// The database refuses.
    fn batch(&mut self, sql: &str) -> Result<(), SqlError>;

    /// Runs a statement; returns the number of rows it changed.
    ///
    /// # Errors
    /// The database refuses.
    fn execute(&mut self, sql: &str, values: &[Value]) -> Result<u64, SqlError>;

    /// Rows of a query.
    ///
    /// # Errors
    /// The database refuses.
    fn query(&mut self, sql: &str, values: &[Value]) -> Result<Vec<Vec<Value>>, SqlError>;
}

/// Integer of a value; 0 for anything else.
pub fn integer(value: Option<&Value>) -> i64 {
    match value {
        Some(Value::Integer(number)) => *number,
        _ => 0,
    }
}

/// Text of a value; empty for anything else.
pub fn text(value: Option<&Value>) -> String {
    match value {
        Some(Value::Text(text)) => text.clone(),
        _ => String::new(),
    }
}
