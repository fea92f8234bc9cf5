//! What can go wrong with a store, in words that say what to do next.

use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Why a store cannot be opened, read or written.
#[derive(Debug, Error)]
pub enum StoreError {
    /// There is no such file.
    #[error("{path}: there is no store; `tirante replay … --store {path}` begins one", path = path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// There is no folder to put it into.
    #[error("{path}: there is no folder {folder} for the store: make it, or name another", path = path.display(), folder = folder.display())]
    NoFolder {
        /// The file.
        path: PathBuf,
        /// The folder.
        folder: PathBuf,
    },
    /// Another program's file.
    #[error("{path} is no store of tirante ({what}): name another file", path = path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What it is instead.
        what: String,
    },
    /// Written by a newer program.
    #[error(
        "{path} has store format {found}, and tirante {version} knows formats up to {known}: use the newer tirante that \
         wrote it, or name another file",
        path = path.display(),
        version = env!("CARGO_PKG_VERSION")
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: i64,
        /// The newest format known here.
        known: i64,
    },
    /// Another process writes to it.
    #[error(
        "{path} is written by another process ({holder}): stop it first, or name another file",
        path = path.display(),
        holder = .pid.map_or_else(|| "of unknown id".to_owned(), |pid| format!("process {pid}"))
    )]
    Held {
        /// The file.
        path: PathBuf,
        /// The process that writes.
        pid: Option<u32>,
    },
    /// Its content contradicts itself.
    #[error(
        "{path} is damaged ({detail}): the next `tirante replay … --store {path}` moves it aside and begins a new one",
        path = path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found.
        detail: String,
    },
    /// Something to be kept would read back as something else.
    #[error("{what} cannot be kept: {detail}")]
    NotStorable {
        /// Which part.
        what: String,
        /// Why.
        detail: String,
    },
    /// What was kept cannot be understood.
    #[error("{what} cannot be read back: {detail}")]
    Unreadable {
        /// Which part.
        what: String,
        /// Why.
        detail: String,
    },
    /// The file system refused.
    #[error("{path} cannot be read or written", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Its answer.
        source: io::Error,
    },
    /// The database refused.
    #[error("{path}: the database refused", path = path.display())]
    Database {
        /// The file.
        path: PathBuf,
        /// Its answer.
        source: rusqlite::Error,
    },
}

/// `SQLITE_IOERR_SHMSIZE`: the index of the log could not grow.
const NO_ROOM_FOR_INDEX: i32 = 4874;

impl StoreError {
    /// Whether the disk has no room: what was refused can be done when it has again.
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
