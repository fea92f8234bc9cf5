//! The little SQL that SQLite and PostgreSQL share: values in, values out, a transaction.

use rusqlite::ErrorCode;
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
    /// PostgreSQL takes the statement, and not the values.
    #[error("{0}")]
    Content(String),
    /// A commit that is folded already comes again with another content.
    #[error("{0}")]
    Contradiction(String),
    /// Another transaction holds the row for longer than is waited.
    #[error("{0}")]
    Busy(String),
    /// It cannot be opened, or is another program's.
    #[error("{0}")]
    Refused(String),
}

impl From<postgres::Error> for SqlError {
    fn from(error: postgres::Error) -> Self {
        let Some(said) = error.as_db_error() else {
            let cause = std::error::Error::source(&error).map(|cause| format!(": {cause}"));
            return Self::Postgres(format!("{error}{}", cause.unwrap_or_default()));
        };
        let text = format!("{}: {}", said.severity(), said.message());
        if *said.code() == postgres::error::SqlState::LOCK_NOT_AVAILABLE {
            return Self::Busy(text);
        }
        // Data exceptions, broken constraints, and limits as that of a row in an index.
        if ["22", "23", "54"].contains(&&said.code().code()[..2]) {
            Self::Content(text)
        } else {
            Self::Postgres(text)
        }
    }
}

impl SqlError {
    /// True if the database would take another content: the same again is refused again.
    pub fn is_of_content(&self) -> bool {
        match self {
            Self::Content(_) | Self::Contradiction(_) => true,
            Self::Sqlite(error) => matches!(
                error.sqlite_error_code(),
                Some(ErrorCode::ConstraintViolation | ErrorCode::TooBig | ErrorCode::TypeMismatch)
            ),
            Self::Postgres(_) | Self::Busy(_) | Self::Refused(_) => false,
        }
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
