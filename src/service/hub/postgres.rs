//! A PostgreSQL server as the centre's database.

use super::sql::{Sql, SqlError};
use crate::config::settings::hub::PostgresSettings;
use crate::service::tls;
use bytes::BytesMut;
use postgres::types::{IsNull, ToSql, Type, to_sql_checked};
use postgres::{Client, Config, NoTls, Statement};
use rusqlite::types::Value;
use std::collections::HashMap;
use std::error::Error;
use std::time::{Duration, Instant};
use tokio_postgres_rustls::MakeRustlsConnect;

/// Key of the lock that the folding process holds: `Tirante`.
const LOCK: i64 = 0x0054_6972_616e_7465;
/// Longest time for a connection.
const CONNECT: Duration = Duration::from_secs(10);

/// Longest time for which what was sent may stay unacknowledged, and for which a connection may be silent.
const SILENT: Duration = Duration::from_secs(30);
/// Longest time of a statement that folds.
const FOLDING: Duration = Duration::from_secs(60);
/// Longest time of a statement that reads, which may be a whole table.
const READING: Duration = Duration::from_secs(600);
/// Longest time for which a worker waits for a lock.
const LOCKED: Duration = Duration::from_secs(1);
/// Longest time in which the server notices that the one before has ended.
const RELEASE: Duration = Duration::from_secs(3);

/// A PostgreSQL server as database.
pub struct Postgres {
    client: Client,
    statements: HashMap<String, Statement>,
}

impl Postgres {
    /// Connects for folding, which one process does at a time.
    ///
    /// # Errors
    /// Another hub has it, or the server cannot be reached or refuses.
    pub fn open(settings: &PostgresSettings) -> Result<Self, SqlError> {
        let mut server = Self::connect(settings, FOLDING, "")?;
        let until = Instant::now() + RELEASE;
        loop {
            let taken = server
                .client
                .query_one("SELECT pg_try_advisory_lock($1)", &[&LOCK])?;
            if taken.get::<_, bool>(0) {
                return Ok(server);
            }
            if Instant::now() >= until {
                let what = "another hub folds into this database";
                return Err(SqlError::Refused(what.to_owned()));
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Connects for reading beside the hub.
    ///
    /// # Errors
    /// The server cannot be reached or refuses.
    pub fn beside(settings: &PostgresSettings) -> Result<Self, SqlError> {
        Self::connect(settings, READING, "")
    }

    /// Connects for the work on a site. A transaction that stands still for as long as a lease `lasts` is ended by the server, and no
    /// lock is waited for.
    ///
    /// # Errors
    /// The server cannot be reached or refuses.
    pub fn for_worker(settings: &PostgresSettings, lasts: Duration) -> Result<Self, SqlError> {
        let more = format!(
            "-c idle_in_transaction_session_timeout={} -c lock_timeout={}",
            lasts.as_millis(),
            LOCKED.as_millis()
        );
        Self::connect(settings, READING, &more)
    }

    fn connect(settings: &PostgresSettings, longest: Duration, more: &str) -> Result<Self, SqlError> {
        let refused = |what: &dyn std::fmt::Display| SqlError::Refused(format!("[postgres]: {what}"));
        let mut config: Config = settings.connection.parse()?;
        let own = config.get_options().unwrap_or_default();
        let options = format!("{own} -c statement_timeout={} {more}", longest.as_millis());
        config
            .connect_timeout(CONNECT)
            .tcp_user_timeout(SILENT)
            .keepalives_idle(SILENT)
            .keepalives_interval(SILENT / 3)
            .options(options.trim())
            .application_name("tirante hub");
        if let Some(file) = &settings.password_file {
            let bytes = file.read_private().map_err(|error| refused(&error))?;
            config.password(String::from_utf8_lossy(&bytes).trim_end_matches(['\r', '\n']));
        }
        let mut client = match &settings.ca {
            None => config
                .connect(NoTls)
                .map_err(|error| unreached(error, "without `ca`, not encrypted"))?,
            Some(ca) => {
                let tls = tls::client(Some(ca)).map_err(|error| refused(&error))?;
                config.ssl_mode(postgres::config::SslMode::Require);
                config
                    .connect(MakeRustlsConnect::new(tls))
                    .map_err(|error| unreached(error, &format!("`ca` is {}", ca.as_str())))?
            }
        };
        // Compressing the lines of results was a third of the server's work. A server that was built without lz4 keeps its own way.
        if let Err(error) = client.batch_execute("SET default_toast_compression = 'lz4'") {
            tracing::debug!("the server does not compress with lz4: {error}");
        }
        Ok(Self {
            client,
            statements: HashMap::new(),
        })
    }

    fn prepared(&mut self, sql: &str) -> Result<Statement, SqlError> {
        if let Some(known) = self.statements.get(sql) {
            return Ok(known.clone());
        }
        let statement = self.client.prepare(sql)?;
        self.statements.insert(sql.to_owned(), statement.clone());
        Ok(statement)
    }
}

/// A connection that was not made, with how it was tried.
fn unreached(error: postgres::Error, how: &str) -> SqlError {
    SqlError::Postgres(format!("[postgres]: {} ({how})", SqlError::from(error)))
}

/// A value as the column or comparison wants it.
#[derive(Debug)]
struct Bound<'v>(&'v Value);

impl ToSql for Bound<'_> {
    fn to_sql(&self, kind: &Type, out: &mut BytesMut) -> Result<IsNull, Box<dyn Error + Sync + Send>> {
        match self.0 {
            Value::Null => Ok(IsNull::Yes),
            Value::Integer(number) => number.to_sql_checked(kind, out),
            Value::Real(number) => number.to_sql_checked(kind, out),
            Value::Text(text) => text.to_sql_checked(kind, out),
            Value::Blob(bytes) => bytes.to_sql_checked(kind, out),
        }
    }

    fn accepts(_: &Type) -> bool {
        true
    }

    to_sql_checked!();
}

impl Sql for Postgres {
    fn is_postgres(&self) -> bool {
        true
    }

    fn batch(&mut self, sql: &str) -> Result<(), SqlError> {
        Ok(self.client.batch_execute(sql)?)
    }

    fn execute(&mut self, sql: &str, values: &[Value]) -> Result<u64, SqlError> {
        let statement = self.prepared(sql)?;
        let values: Vec<Bound<'_>> = values.iter().map(Bound).collect();
        let values: Vec<&(dyn ToSql + Sync)> = values.iter().map(|value| value as _).collect();
        Ok(self.client.execute(&statement, &values)?)
    }

    fn query(&mut self, sql: &str, values: &[Value]) -> Result<Vec<Vec<Value>>, SqlError> {
        let statement = self.prepared(sql)?;
        let values: Vec<Bound<'_>> = values.iter().map(Bound).collect();
        let values: Vec<&(dyn ToSql + Sync)> = values.iter().map(|value| value as _).collect();
        let rows = self.client.query(&statement, &values)?;
        let value = |row: &postgres::Row, place: usize| -> Result<Value, SqlError> {
            let kind = row.columns()[place].type_();
            Ok(match *kind {
                Type::INT8 => row.try_get::<_, Option<i64>>(place)?.map(Value::Integer),
                Type::FLOAT8 => row.try_get::<_, Option<f64>>(place)?.map(Value::Real),
                Type::TEXT => row.try_get::<_, Option<String>>(place)?.map(Value::Text),
                Type::BYTEA => row.try_get::<_, Option<Vec<u8>>>(place)?.map(Value::Blob),
                _ => return Err(SqlError::Refused(format!("a column of type {kind}"))),
            }
            .unwrap_or(Value::Null))
        };
        rows.iter()
            .map(|row| (0..row.len()).map(|place| value(row, place)).collect())
            .collect()
    }
}
