//! Results of all tasks in one SQLite database: the tables of each site's store, with the site in front of every row.

use super::task::Task;
use crate::site::store::{Reader, StoreError};
use rusqlite::Connection;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// Application id in the header: `TirF`.
const APPLICATION_ID: i64 = 0x5469_7246;

/// Reason why results cannot be collected.
#[derive(Debug, thiserror::Error)]
pub enum CollectError {
    /// A site's result cannot be read.
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
}

/// Writes the results of `tasks`, found below `results`, into a database that appears under its name only when it is
/// whole; calls `done` after each task.
///
/// # Errors
/// A result cannot be read or is damaged, or the database cannot be written.
pub fn into_one(
    tasks: &[&Task],
    results: &Path,
    target: &Path,
    done: impl Fn(usize),
) -> Result<(), CollectError> {
    let mut part = target.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    let written = write(tasks, results, &part, done);
    let io = |source| CollectError::Io {
        path: target.to_owned(),
        source,
    };
    if let Err(error) = written {
        // The first error matters more than a failure to remove the file.
        let _ = fs::remove_file(&part);
        return Err(error);
    }
    File::open(&part).and_then(|file| file.sync_all()).map_err(io)?;
    fs::rename(&part, target).map_err(io)
}

fn write(tasks: &[&Task], results: &Path, part: &Path, done: impl Fn(usize)) -> Result<(), CollectError> {
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
                bytes INTEGER NOT NULL
            ) STRICT;",
        )
        .map_err(sql)?;
    for (number, task) in tasks.iter().enumerate() {
        let reader = Reader::open(&task.result_in(results))?;
        reader.check_all()?;
        connection
            .execute(
                "INSERT INTO task VALUES (?, ?, ?, ?, ?, ?)",
                (
                    &task.site,
                    &task.result,
                    &task.config_hash,
                    task.analysis_version,
                    task.files.len() as i64,
                    i64::try_from(task.bytes).unwrap_or(i64::MAX),
                ),
            )
            .map_err(sql)?;
        reader.append_to(&connection, &task.site)?;
        done(number + 1);
    }
    connection.close().map_err(|(_, error)| sql(error))
}
