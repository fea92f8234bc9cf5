//! One writer per store: an advisory lock on a file next to it, which names the holder.

use super::StoreError;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Lock for writing a store. The operating system releases it when the process ends, however it ends; the
/// file stays, since removing it could break another process's lock.
#[derive(Debug)]
pub(super) struct Lock {
    file: File,
}

impl Lock {
    /// Takes the lock of the store at `path`.
    pub(super) fn take(path: &Path) -> Result<Self, StoreError> {
        let beside = beside(path, ".lock");
        let io = |source| StoreError::Io {
            path: beside.clone(),
            source,
        };
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&beside)
            .map_err(io)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(held_by(&mut file, path)),
            Err(TryLockError::Error(source)) => return Err(io(source)),
        }
        file.set_len(0).map_err(io)?;
        file.seek(SeekFrom::Start(0)).map_err(io)?;
        writeln!(file, "{}", std::process::id()).map_err(io)?;
        file.flush().map_err(io)?;
        Ok(Self { file })
    }
}

/// Lock of a store that is closed for a while: nobody else writes it meanwhile.
#[derive(Debug)]
pub struct Reserved(#[allow(dead_code, reason = "held, not read")] pub(super) Lock);

/// Error that names the process which writes the store at `path`; `None` if none does. Unlike [`Lock::take`] it creates no
/// file and writes into none: a copy that is only read stays without a lock.
pub(super) fn holder(path: &Path) -> Result<Option<StoreError>, StoreError> {
    let beside = beside(path, ".lock");
    let io = |source| StoreError::Io {
        path: beside.clone(),
        source,
    };
    let mut file = match File::open(&beside) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        file => file.map_err(io)?,
    };
    match file.try_lock_shared() {
        Ok(()) => file.unlock().map(|()| None).map_err(io),
        Err(TryLockError::WouldBlock) => Ok(Some(held_by(&mut file, path))),
        Err(TryLockError::Error(source)) => Err(io(source)),
    }
}

/// Error that names the holder of a locked file.
fn held_by(file: &mut File, path: &Path) -> StoreError {
    let mut text = String::new();
    // A holder that has not written its id yet is a holder all the same.
    let _ = file.read_to_string(&mut text);
    StoreError::Held {
        path: path.to_owned(),
        pid: text.trim().parse().ok(),
    }
}

impl Drop for Lock {
    /// Unlocks for every copy of the descriptor: a process that another thread is just starting holds one until its program
    /// is loaded, and closing ours would not release the lock before.
    fn drop(&mut self) {
        let _ = self.file.unlock();
    }
}

/// The path with `suffix` appended to its name.
pub(super) fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}
