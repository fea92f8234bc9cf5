//! Errors of a store, in words that give the next step.

use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Reason why a store cannot be opened, read or written.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The file does not exist.
    #[error("{path}: there is no store; bring it back if it was moved, or begin one: `tirante replay … --store {path}`", path = path.display())]
    Missing {
        /// Path of the file.
        path: PathBuf,
    },
    /// The folder for it does not exist.
    #[error("{path}: there is no folder {folder} for the store: make it, or name another", path = path.display(), folder = folder.display())]
    NoFolder {
        /// Path of the file.
        path: PathBuf,
        /// Path of the folder.
        folder: PathBuf,
    },
    /// The file is another program's.
    #[error("{path} is no store of tirante ({what}): name another file", path = path.display())]
    Foreign {
        /// Path of the file.
        path: PathBuf,
        /// Kind of file it is instead.
        what: String,
    },
    /// The file was written by a newer program.
    #[error(
        "{path} has store format {found}, and tirante {version} knows formats up to {known}: use the newer tirante that \
         wrote it, or name another file",
        path = path.display(),
        version = env!("CARGO_PKG_VERSION")
    )]
    Newer {
        /// Path of the file.
        path: PathBuf,
        /// Format of the file.
        found: i64,
        /// Newest format supported here.
        known: i64,
    },
    /// Another process writes to it.
    #[error(
        "{path} is written by another process ({holder}): stop it first, or name another file",
        path = path.display(),
        holder = .pid.map_or_else(|| "of unknown id".to_owned(), |pid| format!("process {pid}"))
    )]
    Held {
        /// Path of the file.
        path: PathBuf,
        /// Process id of the writer, if known.
        pid: Option<u32>,
    },
    /// It is a copy to read.
    #[error(
        "{path} is a copy of site {site} that `tirante hub store` wrote, to be read alone: it has none of the states from which \
         monitoring goes on; name another store (`--store FILE`, `[store] path`), and acknowledge at the centre: \
         `tirante hub command {site} acknowledge ALARM`",
        path = path.display()
    )]
    Gathered {
        /// Path of the file.
        path: PathBuf,
        /// Name of the site at the centre.
        site: String,
    },
    /// Its content contradicts itself.
    #[error(
        "{path} is damaged ({detail}): the next `tirante replay … --store {path}` moves it aside and begins a new one",
        path = path.display()
    )]
    Damaged {
        /// Path of the file.
        path: PathBuf,
        /// Contradiction found.
        detail: String,
    },
    /// A value to be kept would not read back equal.
    #[error("{what} cannot be kept: {detail}")]
    NotStorable {
        /// Name of the value.
        what: String,
        /// Reason.
        detail: String,
    },
    /// A value in the store cannot be parsed.
    #[error("{what} cannot be read back: {detail}")]
    Unreadable {
        /// Name of the value.
        what: String,
        /// Reason.
        detail: String,
    },
    /// The file system returned an error.
    #[error("{path} cannot be read or written", path = path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the file system.
        source: io::Error,
    },
    /// The database returned an error.
    #[error("{path}: the database refused", path = path.display())]
    Database {
        /// Path of the file.
        path: PathBuf,
        /// Error of the database.
        source: rusqlite::Error,
    },
}

/// `SQLITE_IOERR_SHMSIZE`: the index of the log could not grow.
const NO_ROOM_FOR_INDEX: i32 = 4874;

impl StoreError {
    /// True if the disk is full: the operation can be repeated once there is room.
    pub fn is_disk_full(&self) -> bool {
        match self {
            Self::Database { source, .. } => {
                source.sqlite_error_code() == Some(rusqlite::ErrorCode::DiskFull)
                    || source
                        .sqlite_error()
                        .is_some_and(|error| error.extended_code == NO_ROOM_FOR_INDEX)
            }
            Self::Io { source, .. } => matches!(
                source.kind(),
                io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded
            ),
            _ => false,
        }
    }
}
