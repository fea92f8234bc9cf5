//! Opens a store: checks owner, format and integrity; a damaged one is moved aside.

use super::head::{HEAD, head_of};
use super::lock::{Lock, beside};
use super::{StoreError, row, schema};
use crate::analysis::signal::record::RodId;
use rusqlite::{Connection, ErrorCode, OpenFlags};
use std::collections::{HashMap, HashSet};
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest wait of one process for another's transaction.
const PATIENCE: Duration = Duration::from_secs(20);

/// Number of prepared statements kept: all that a commit uses.
const STATEMENTS: usize = 64;

/// First bytes of every SQLite file.
const MAGIC: &[u8; 16] = b"SQLite format 3\0";

/// Finding on a store whose definitions changed.
const OTHER_TABLES: &str = "its tables are not those of its format";

/// Durability of a commit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Durability {
    /// Survives a power failure: every commit is flushed to the disk. For data that comes once.
    Full,
    /// Survives the end of the process, however it comes; a power failure may undo the last commits, but
    /// never a part of one. For data that can be read again.
    Replay,
}

/// A store open for writing.
pub(super) struct Opened {
    pub(super) connection: Connection,
    pub(super) path: PathBuf,
    pub(super) lock: Lock,
    pub(super) known: Known,
    pub(super) moved_aside: Option<PathBuf>,
}

type Known = HashMap<RodId, HashSet<[u8; 32]>>;

/// Reason why a file is not opened as it is.
enum Finding {
    Damaged(String),
    Refused(StoreError),
}

pub(super) fn in_memory() -> rusqlite::Result<Connection> {
    let mut connection = Connection::open_in_memory()?;
    settle(&connection)?;
    schema::migrate(&mut connection, 0)?;
    Ok(connection)
}

pub(super) fn for_writing(path: &Path, durability: Durability) -> Result<Opened, StoreError> {
    let path = resolved(path)?;
    // Every writer leaves the lock file, so a file that is no longer a database was one.
    let was_store = beside(&path, ".lock").exists();
    // A path that cannot be a store gets no lock file.
    exists(&path)?;
    let lock = Lock::take(&path)?;
    let mut moved_aside = None;
    if exists(&path)? {
        match open_whole(&path, durability, was_store) {
            Ok((connection, known)) => {
                return Ok(Opened {
                    connection,
                    path,
                    lock,
                    known,
                    moved_aside,
                });
            }
            Err(Finding::Refused(error)) => {
                if !was_store {
                    let _ = fs::remove_file(beside(&path, ".lock"));
                }
                return Err(error);
            }
            Err(Finding::Damaged(detail)) => {
                let aside = move_aside(&path)?;
                tracing::warn!(
                    "{} is damaged ({detail}): moved to {}, a new store is begun; feed the recordings again to rebuild it",
                    path.display(),
                    aside.display()
                );
                moved_aside = Some(aside);
            }
        }
    }
    begin(&path)?;
    let connection = match open_whole(&path, durability, true) {
        Ok((connection, _)) => connection,
        Err(Finding::Refused(error)) => return Err(error),
        Err(Finding::Damaged(detail)) => return Err(StoreError::Damaged { path, detail }),
    };
    Ok(Opened {
        connection,
        path,
        lock,
        known: Known::new(),
        moved_aside,
    })
}

/// Opens a store for requests while another process may be writing.
pub(super) fn beside_writer(path: &Path) -> Result<(Connection, PathBuf), StoreError> {
    open_of_others(path, OpenFlags::SQLITE_OPEN_READ_WRITE)
}

/// Opens a store for reading while another process may be writing.
pub(super) fn for_reading(path: &Path) -> Result<(Connection, PathBuf), StoreError> {
    open_of_others(path, OpenFlags::SQLITE_OPEN_READ_ONLY)
}

fn open_of_others(path: &Path, flags: OpenFlags) -> Result<(Connection, PathBuf), StoreError> {
    let path = resolved(path)?;
    if !exists(&path)? {
        return Err(StoreError::Missing { path });
    }
    let was_store = beside(&path, ".lock").exists();
    let opened = begins_like_one(&path, was_store).and_then(|()| {
        let connection = connect(&path, flags).map_err(|error| judge(&path, error))?;
        if check_format(&connection, &path)? < schema::FORMAT {
            stand_in(&connection).map_err(|error| judge(&path, error))?;
        }
        Ok(connection)
    });
    match opened {
        Ok(connection) => Ok((connection, path)),
        Err(Finding::Refused(error)) => Err(error),
        Err(Finding::Damaged(detail)) => Err(StoreError::Damaged { path, detail }),
    }
}

/// View of the periods of an older format with the columns of now.
pub(super) const LISTED_PERIODS: &str = "listed_period";

/// Stands in for the tables that a store of an older format lacks, with empty ones, and for the columns that its periods lack,
/// with NULL; for this connection alone.
fn stand_in(connection: &Connection) -> rusqlite::Result<()> {
    let definitions = in_memory().and_then(|fresh| schema::definitions(&fresh))?;
    for (name, sql) in definitions {
        if schema::TABLES.contains(&name.as_str()) && !schema::has(connection, &name)? {
            connection.execute_batch(&sql.replacen("CREATE TABLE", "CREATE TEMP TABLE", 1))?;
        }
    }
    let columns = |connection: &Connection| -> rusqlite::Result<Vec<String>> {
        let mut statement = connection.prepare("SELECT name FROM pragma_table_info('period')")?;
        statement.query_map((), |row| row.get(0))?.collect()
    };
    let (here, now) = (columns(connection)?, columns(&in_memory()?)?);
    let missing: String = now
        .iter()
        .filter(|name| !here.contains(name))
        .map(|name| format!(", NULL AS {name}"))
        .collect();
    if !missing.is_empty() {
        let sql = format!("CREATE TEMP VIEW {LISTED_PERIODS} AS SELECT *{missing} FROM main.period");
        connection.execute_batch(&sql)?;
    }
    Ok(())
}

/// Opens a store for reading after a check of its tables and of every page, index and row.
pub(super) fn for_reading_whole(path: &Path) -> Result<(Connection, PathBuf), StoreError> {
    let (connection, path) = for_reading(path)?;
    let checked = || -> rusqlite::Result<Result<Known, Finding>> {
        let format: i64 = connection.pragma_query_value(None, "user_version", |row| row.get(0))?;
        if format == schema::FORMAT
            && schema::definitions(&connection)? != schema::definitions(&in_memory()?)?
        {
            return Ok(Err(Finding::Damaged(OTHER_TABLES.to_owned())));
        }
        check_content(&connection)
    };
    match checked().unwrap_or_else(|error| Err(judge(&path, error))) {
        Ok(_) => Ok((connection, path)),
        Err(Finding::Refused(error)) => Err(error),
        Err(Finding::Damaged(detail)) => Err(StoreError::Damaged { path, detail }),
    }
}

/// Resolves all links of a path, so that one store has one lock.
fn resolved(path: &Path) -> Result<PathBuf, StoreError> {
    let io = |source| StoreError::Io {
        path: path.to_owned(),
        source,
    };
    match fs::canonicalize(path) {
        Ok(path) => Ok(path),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            let folder = folder.unwrap_or(Path::new("."));
            let folder = fs::canonicalize(folder).map_err(|error| match error.kind() {
                ErrorKind::NotFound => StoreError::NoFolder {
                    path: path.to_owned(),
                    folder: folder.to_owned(),
                },
                _ => io(error),
            })?;
            let name = path
                .file_name()
                .ok_or_else(|| io(std::io::Error::new(ErrorKind::InvalidInput, "not a file name")))?;
            Ok(folder.join(name))
        }
        Err(error) => Err(io(error)),
    }
}

fn exists(path: &Path) -> Result<bool, StoreError> {
    match fs::metadata(path) {
        Ok(kind) if kind.is_file() => Ok(true),
        Ok(_) => Err(StoreError::Foreign {
            path: path.to_owned(),
            what: "it is no regular file".to_owned(),
        }),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
        Err(source) => Err(StoreError::Io {
            path: path.to_owned(),
            source,
        }),
    }
}

/// Writes an empty store next to its place and moves it there, so that it is complete or absent.
fn begin(path: &Path) -> Result<(), StoreError> {
    let new = beside(path, ".new");
    let io = |source| StoreError::Io {
        path: new.clone(),
        source,
    };
    for part in ["", "-wal", "-shm", "-journal"] {
        remove(&beside(&new, part))?;
        if !part.is_empty() {
            // A journal of a store that is gone must not be taken for one of the new store's.
            remove(&beside(path, part))?;
        }
    }
    let write = || -> rusqlite::Result<()> {
        let mut connection = Connection::open(&new)?;
        // Only in this order: closing a database does not report that its journal could not be written back, and the file moved to
        // its place would be empty.
        schema::migrate(&mut connection, 0)?;
        connection.pragma_update(None, "journal_mode", "WAL")?;
        connection.close().map_err(|(_, error)| error)
    };
    write().map_err(|source| StoreError::Database {
        path: new.clone(),
        source,
    })?;
    File::open(&new).and_then(|file| file.sync_all()).map_err(io)?;
    fs::rename(&new, path).map_err(io)?;
    if let Some(folder) = path.parent()
        && let Ok(folder) = File::open(folder)
    {
        // Some file systems cannot flush a folder; the store is whole and in its place either way.
        let _ = folder.sync_all();
    }
    Ok(())
}

fn remove(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(StoreError::Io {
            path: path.to_owned(),
            source: error,
        }),
        _ => Ok(()),
    }
}

/// Renames a store and its journals to `….corrupt-1`, or the first number that is free.
fn move_aside(path: &Path) -> Result<PathBuf, StoreError> {
    let aside = (1..)
        .map(|number: u32| beside(path, &format!(".corrupt-{number}")))
        .find(|aside| !aside.exists())
        .unwrap_or_else(|| beside(path, ".corrupt"));
    for part in ["-wal", "-shm", ""] {
        match fs::rename(beside(path, part), beside(&aside, part)) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(StoreError::Io {
                    path: beside(path, part),
                    source: error,
                });
            }
            _ => {}
        }
    }
    Ok(aside)
}

fn connect(path: &Path, flags: OpenFlags) -> rusqlite::Result<Connection> {
    let flags = flags | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_EXRESCODE;
    let connection = Connection::open_with_flags(path, flags)?;
    settle(&connection)?;
    Ok(connection)
}

fn settle(connection: &Connection) -> rusqlite::Result<()> {
    connection.busy_timeout(PATIENCE)?;
    connection.set_prepared_statement_cache_capacity(STATEMENTS);
    connection.pragma_update(None, "foreign_keys", true)?;
    connection.pragma_update(None, "trusted_schema", false)?;
    connection.pragma_update(None, "cell_size_check", true)
}

/// Opens an existing file after checking every page and every row.
fn open_whole(path: &Path, durability: Durability, was_store: bool) -> Result<(Connection, Known), Finding> {
    begins_like_one(path, was_store)?;
    let judged = |error| judge(path, error);
    let mut connection = connect(path, OpenFlags::SQLITE_OPEN_READ_WRITE).map_err(judged)?;
    let format = check_format(&connection, path)?;
    if let Some(site) = super::gathered::site_of(&connection).map_err(judged)? {
        let path = path.to_owned();
        return Err(Finding::Refused(StoreError::Gathered { path, site }));
    }
    let known = check_content(&connection).map_err(judged)??;
    if format < schema::FORMAT {
        schema::migrate(&mut connection, format).map_err(judged)?;
        tracing::info!(
            "{}: brought from store format {format} to {}",
            path.display(),
            schema::FORMAT
        );
    }
    let expected = in_memory()
        .and_then(|fresh| schema::definitions(&fresh))
        .map_err(judged)?;
    if schema::definitions(&connection).map_err(judged)? != expected {
        return Err(Finding::Damaged(OTHER_TABLES.to_owned()));
    }
    let (synchronous, checkpoint) = match durability {
        Durability::Full => ("FULL", 1000),
        // Each checkpoint flushes twice; pages of a log this long are a few tens of megabytes.
        Durability::Replay => ("NORMAL", 8000),
    };
    let write = || -> rusqlite::Result<()> {
        connection.pragma_update(None, "journal_mode", "WAL")?;
        connection.pragma_update(None, "synchronous", synchronous)?;
        connection.pragma_update(None, "wal_autocheckpoint", checkpoint)
    };
    write().map_err(judged)?;
    Ok((connection, known))
}

/// Checks that the file's first bytes are a store's, or those of one that was damaged.
fn begins_like_one(path: &Path, was_store: bool) -> Result<(), Finding> {
    let head = head_of(path).map_err(|source| {
        Finding::Refused(StoreError::Io {
            path: path.to_owned(),
            source,
        })
    })?;
    let id = head
        .get(68..72)
        .map(|id| i64::from(u32::from_be_bytes([id[0], id[1], id[2], id[3]])));
    if head.starts_with(MAGIC) && head.len() == HEAD {
        return Ok(());
    }
    if was_store || id == Some(schema::APPLICATION_ID) || head.starts_with(MAGIC) {
        let detail = if head.is_empty() {
            "it is empty"
        } else {
            "its header is broken"
        };
        return Err(Finding::Damaged(detail.to_owned()));
    }
    Err(Finding::Refused(StoreError::Foreign {
        path: path.to_owned(),
        what: "it is no SQLite database".to_owned(),
    }))
}

/// Checks the owner of the database; returns its format.
fn check_format(connection: &Connection, path: &Path) -> Result<i64, Finding> {
    let number = |pragma: &str| -> Result<i64, Finding> {
        connection
            .pragma_query_value(None, pragma, |row| row.get(0))
            .map_err(|error| judge(path, error))
    };
    if number("application_id")? != schema::APPLICATION_ID {
        let expected = in_memory().and_then(|fresh| schema::definitions(&fresh));
        let is_ours = expected
            .and_then(|expected| Ok(schema::definitions(connection)? == expected))
            .map_err(|error| judge(path, error))?;
        return Err(if is_ours {
            Finding::Damaged("its header is broken".to_owned())
        } else {
            Finding::Refused(StoreError::Foreign {
                path: path.to_owned(),
                what: "it is another program's SQLite database".to_owned(),
            })
        });
    }
    let found = number("user_version")?;
    if found > schema::FORMAT {
        return Err(Finding::Refused(StoreError::Newer {
            path: path.to_owned(),
            found,
            known: schema::FORMAT,
        }));
    }
    if found < 1 {
        return Err(Finding::Damaged(format!("it says it has format {found}")));
    }
    Ok(found)
}

/// Checks every page, every index and every row; returns the identities of the records.
fn check_content(connection: &Connection) -> rusqlite::Result<Result<Known, Finding>> {
    let verdict: String = connection.query_row("PRAGMA integrity_check(1)", (), |row| row.get(0))?;
    if verdict != "ok" {
        return Ok(Err(Finding::Damaged(verdict)));
    }
    let mut known = Known::new();
    for table in schema::TABLES {
        if !schema::has(connection, table)? {
            // An older format; a table missing from its own is found when the definitions are compared.
            continue;
        }
        let is_record = table == "record";
        let bad = row::verify(connection, table, |row| {
            if is_record {
                let rod = RodId(row.get("rod")?);
                known.entry(rod).or_default().insert(row.get("identity")?);
            }
            Ok(())
        })?;
        if let Some(number) = bad {
            return Ok(Err(Finding::Damaged(format!(
                "row {number} of table {table} is not what was written"
            ))));
        }
    }
    Ok(Ok(known))
}

/// Decides if an error of the database means a damaged file or a fault around it.
fn judge(path: &Path, error: rusqlite::Error) -> Finding {
    let around = matches!(
        error.sqlite_error_code(),
        Some(
            ErrorCode::DatabaseBusy
                | ErrorCode::DatabaseLocked
                | ErrorCode::CannotOpen
                | ErrorCode::ReadOnly
                | ErrorCode::PermissionDenied
                | ErrorCode::SystemIoFailure
                | ErrorCode::DiskFull
                | ErrorCode::OutOfMemory
                | ErrorCode::OperationInterrupted
                | ErrorCode::FileLockingProtocolFailed
        )
    );
    if around {
        Finding::Refused(StoreError::Database {
            path: path.to_owned(),
            source: error,
        })
    } else {
        Finding::Damaged(error.to_string())
    }
}

/// Converts an error of a later query; damage if the file is damaged.
pub(super) fn is_damage(path: &Path, error: rusqlite::Error) -> StoreError {
    match error.sqlite_error_code() {
        Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => StoreError::Damaged {
            path: path.to_owned(),
            detail: error.to_string(),
        },
        _ => StoreError::Database {
            path: path.to_owned(),
            source: error,
        },
    }
}
