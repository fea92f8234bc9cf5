//! Watches the store's files while the daemon writes them.

use crate::service::telemetry::owned::{Lost, Owned};
use std::path::{Path, PathBuf};

/// The store and its write-ahead log.
#[derive(Debug)]
pub struct Guard {
    store: Option<Owned>,
    log_path: PathBuf,
    /// Write-ahead log, known from the first commit on; it stays the same while the store is open.
    log: Option<Owned>,
}

impl Guard {
    /// Files of the store opened at `path`.
    pub fn of(path: &Path) -> Self {
        let mut log = path.as_os_str().to_owned();
        log.push("-wal");
        let log_path = PathBuf::from(log);
        Self {
            store: Owned::of(path),
            log: None,
            log_path,
        }
    }

    /// Checks them.
    ///
    /// # Errors
    /// First file that is no longer the one written, and the reason.
    pub fn look(&mut self) -> Result<(), (PathBuf, Lost)> {
        if let Some(store) = &mut self.store {
            store.look().map_err(|lost| (store.path().to_owned(), lost))?;
        }
        if self.log.is_none() {
            self.log = Owned::of(&self.log_path);
        }
        match &mut self.log {
            None => Ok(()),
            Some(log) => match log.look() {
                // SQLite itself shortens it when its content is in the store.
                Ok(()) | Err(Lost::Truncated) => Ok(()),
                Err(lost) => Err((log.path().to_owned(), lost)),
            },
        }
    }
}
