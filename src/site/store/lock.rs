//! One writer per store: an advisory lock on a file next to it, which names the holder and says why it stores nothing at present.

use super::{FileId, StoreError};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Length of the file \[bytes\]: written once, so that its room is there when the disk is full.
const LENGTH: usize = 4096;

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
        // What the last holder left for the next daemon stays until one tells something.
        file.write_all_at(&content(&left(path), ""), 0).map_err(io)?;
        Ok(Self { file })
    }

    /// Writes a line for the next holder and a text for those who cannot ask this one, beneath its id; empty if it is at work. What of
    /// the text has no room is cut off.
    pub(super) fn tell(&self, line: &str, text: &str) -> std::io::Result<()> {
        self.file.write_all_at(&content(line, text), 0)
    }

    /// True if the file of the store at `path` is still the one that is locked.
    fn is_in_place(&self, path: &Path) -> bool {
        let held = self.file.metadata().map(|held| FileId::from(&held));
        held.is_ok_and(|held| held == FileId::of(&beside(path, ".lock")))
    }

    /// Takes the lock anew if its file was removed or replaced; returns true if it had to.
    pub(super) fn renew(&mut self, path: &Path) -> Result<bool, StoreError> {
        if self.is_in_place(path) {
            return Ok(false);
        }
        *self = Self::take(path)?;
        Ok(true)
    }
}

/// Content of the file: id of this process, line for the next holder, text, line feeds to the length.
fn content(line: &str, text: &str) -> Vec<u8> {
    let mut bytes = format!("{}\n{line}\n{text}", std::process::id()).into_bytes();
    bytes.resize(LENGTH, b'\n');
    bytes
}

/// Lock of a store that is closed for a while: nobody else writes it meanwhile.
#[derive(Debug)]
pub struct Reserved(pub(super) Lock);

impl Reserved {
    /// See [`Store::tell`](super::Store::tell).
    pub fn tell(&self, line: &str, text: &str) {
        let _ = self.0.tell(line, text);
    }
}

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

/// Text of the process that writes the store at `path`; `None` if none does, or it has nothing to tell.
pub(super) fn told(path: &Path) -> Option<String> {
    let mut file = File::open(beside(path, ".lock")).ok()?;
    if !matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)) {
        return None;
    }
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    let told = text.splitn(3, '\n').nth(2)?.trim_end();
    (!told.is_empty()).then(|| told.to_owned())
}

/// Line that the last process to tell something left beside the store at `path` for the next one; empty if none.
pub(super) fn left(path: &Path) -> String {
    let bytes = std::fs::read(beside(path, ".lock")).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    text.lines().nth(1).unwrap_or_default().to_owned()
}

/// Error that names the holder of a locked file.
fn held_by(file: &mut File, path: &Path) -> StoreError {
    let mut text = String::new();
    // A holder that has not written its id yet is a holder all the same.
    let _ = file.read_to_string(&mut text);
    StoreError::Held {
        path: path.to_owned(),
        pid: text.lines().next().and_then(|pid| pid.trim().parse().ok()),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_holder_is_told_with_its_words_and_takes_a_lock_that_was_removed_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site.db");
        let mut lock = Lock::take(&path).unwrap();
        let file = beside(&path, ".lock");
        assert_eq!(std::fs::metadata(&file).unwrap().len(), LENGTH as u64);
        assert_eq!(told(&path), None);
        lock.tell("", "no room\non the disk").unwrap();
        assert_eq!(told(&path).as_deref(), Some("no room\non the disk"));
        lock.tell("", &"x".repeat(10_000)).unwrap();
        assert!(told(&path).unwrap().len() < LENGTH);
        let holder = |path: &Path| match holder(path).unwrap() {
            Some(StoreError::Held { pid, .. }) => pid,
            _ => None,
        };
        assert_eq!(holder(&path), Some(std::process::id()));
        assert!(!lock.renew(&path).unwrap());
        std::fs::remove_file(&file).unwrap();
        assert!(lock.renew(&path).unwrap());
        assert!(Lock::take(&path).is_err());
        // Another program was quicker.
        std::fs::remove_file(&file).unwrap();
        let other = Lock::take(&path).unwrap();
        assert!(matches!(lock.renew(&path), Err(StoreError::Held { .. })));
        drop(other);
        assert_eq!(told(&path), None);
    }

    #[test]
    fn the_next_holder_finds_the_line_that_was_left_and_others_between_them_keep_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site.db");
        let lock = Lock::take(&path).unwrap();
        assert_eq!(left(&path), "");
        lock.tell("what stands", "no room").unwrap();
        drop(lock);
        let of_a_command = Lock::take(&path).unwrap();
        assert_eq!(told(&path), None, "the text was of another process");
        drop(of_a_command);
        let lock = Lock::take(&path).unwrap();
        assert_eq!(left(&path), "what stands");
        lock.tell("", "").unwrap();
        assert_eq!(left(&path), "");
    }
}
