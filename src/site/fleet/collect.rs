//! Results of all tasks in one SQLite database: the tables of each site's store, with the site in front of every row.

use super::task::Task;
use crate::site::store::{FileState, Reader, StoreError};
use rusqlite::Connection;
use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Application id in the header: `TirF`.
const APPLICATION_ID: i32 = 0x5469_7246;

/// Reason why results cannot be collected.
#[derive(Debug, thiserror::Error)]
pub enum CollectError {
    /// A site's rows cannot be taken over.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The database cannot be written.
    #[error("{path}: the database refused", path = path.display())]
    Database {
        /// Path of the database.
        path: PathBuf,
        /// Error of the database.
        source: rusqlite::Error,
    },
    /// The file cannot be written.
    #[error("{path} cannot be written", path = path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the file system.
        source: std::io::Error,
    },
    /// The target is there and no collection.
    #[error("{path}: is there and no collection of results, and is not replaced: name another file", path = _0.display())]
    Another(PathBuf),
}

/// Numbers of a result that was collected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    /// Number of its records.
    pub records: u64,
    /// Number of those that were rejected.
    pub rejected: u64,
    /// Number of the task's files of which something is lost; `None` if the result tells nothing of its files.
    pub damaged: Option<u64>,
}

/// Numbers of a result, or the reason why it is missing or not to be used.
pub type Collected = Result<Counts, StoreError>;

/// Writes the results of `tasks`, found below `results`, into a database that appears under its name only when it is
/// whole; calls `done` after each task. A result that is missing, damaged or out of reach leaves nothing in it.
///
/// # Errors
/// The database cannot be written.
pub fn into_one(
    tasks: &[Task],
    results: &Path,
    target: &Path,
    done: impl Fn(usize),
) -> Result<Vec<Collected>, CollectError> {
    refuse_another(target)?;
    let beside = |ending: &str| {
        let mut name = target.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    // Two collections at once do not write into one file.
    let part = beside(&format!(".{}.part", std::process::id()));
    let written = write(tasks, results, &part, done);
    let io = |source| CollectError::Io {
        path: target.to_owned(),
        source,
    };
    let collected = match written {
        Ok(collected) => collected,
        Err(error) => {
            // The first error matters more than a failure to remove the file.
            let _ = fs::remove_file(&part);
            return Err(error);
        }
    };
    File::open(&part).and_then(|file| file.sync_all()).map_err(io)?;
    fs::rename(&part, target).map_err(io)?;
    Ok(collected)
}

/// Refuses a target that is there and no collection: it may be a store in use.
fn refuse_another(target: &Path) -> Result<(), CollectError> {
    const HEAD: u64 = 72;
    let mut head = Vec::new();
    match File::open(target).and_then(|file| file.take(HEAD).read_to_end(&mut head)) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(source) => {
            return Err(CollectError::Io {
                path: target.to_owned(),
                source,
            });
        }
        Ok(_) => {}
    }
    // The application id is at byte 68 of a database (SQLite, file format 1.3).
    match head.get(68..72) == Some(&APPLICATION_ID.to_be_bytes()) {
        true => Ok(()),
        false => Err(CollectError::Another(target.to_owned())),
    }
}

fn write(
    tasks: &[Task],
    results: &Path,
    part: &Path,
    done: impl Fn(usize),
) -> Result<Vec<Collected>, CollectError> {
    let sql = |source| CollectError::Database {
        path: part.to_owned(),
        source,
    };
    match fs::remove_file(part) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(CollectError::Io {
                path: part.to_owned(),
                source: error,
            });
        }
        _ => {}
    }
    let connection = Connection::open(part).map_err(sql)?;
    // The file counts only when it is whole: until then nothing needs to survive.
    connection
        .execute_batch(
            "PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; PRAGMA locking_mode = EXCLUSIVE;",
        )
        .map_err(sql)?;
    connection
        .pragma_update(None, "application_id", APPLICATION_ID)
        .map_err(sql)?;
    connection
        .execute_batch(
            "CREATE TABLE task (
                site TEXT PRIMARY KEY,
                result TEXT NOT NULL,
                config_hash TEXT NOT NULL,
                analysis_version INTEGER NOT NULL,
                files INTEGER NOT NULL,
                bytes INTEGER NOT NULL,
                damaged INTEGER
            ) STRICT;",
        )
        .map_err(sql)?;
    let mut collected = Vec::new();
    for (number, task) in tasks.iter().enumerate() {
        // Nothing of a result is written before all of it is known to be good.
        let (reader, counts) = match whole(&task.result_in(results)) {
            Ok(found) => found,
            Err(error) => {
                collected.push(Err(error));
                done(number + 1);
                continue;
            }
        };
        connection
            .execute(
                "INSERT INTO task VALUES (?, ?, ?, ?, ?, ?, ?)",
                (
                    &task.site,
                    &task.result,
                    &task.config_hash,
                    task.analysis_version,
                    task.files.len() as i64,
                    i64::try_from(task.bytes).unwrap_or(i64::MAX),
                    counts.damaged.map(|count| count as i64),
                ),
            )
            .map_err(sql)?;
        reader.append_to(&connection, &task.site)?;
        collected.push(Ok(counts));
        done(number + 1);
    }
    connection.close().map_err(|(_, error)| sql(error))?;
    Ok(collected)
}

/// Opens a result and checks all of it.
fn whole(path: &Path) -> Result<(Reader, Counts), StoreError> {
    let reader = Reader::open_whole(path)?;
    let (records, rejected) = reader.count_records()?;
    let files = reader.files()?;
    let lost = files.values().filter(|file| file.state != FileState::Done);
    let counts = Counts {
        records,
        rejected,
        damaged: (!files.is_empty()).then(|| lost.count() as u64),
    };
    Ok((reader, counts))
}
