//! First bytes of a store's file, by which a write into it by anything but SQLite is noticed.

use super::FileId;
use super::lock::beside;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Length of the header of an SQLite file \[bytes\].
pub(super) const HEAD: usize = 100;

/// Header of a store's file while it is open, and the standing of its write-ahead log.
///
/// In WAL mode the file changes only when the log's content is copied into it, by whichever process. That moves the marks of the
/// log's index: its salt (bytes 32 to 39), the number of pages copied (96 to 99) and that of pages about to be copied (128 to 131),
/// which is set before the first of them (<https://sqlite.org/walformat.html>, 2.3).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Head {
    header: Vec<u8>,
    copied: Vec<u8>,
}

impl Head {
    /// Header of the store at `path` now; `None` if it cannot be read, or is being written.
    pub fn of(path: &Path) -> Option<Self> {
        let copied = copied(path)?;
        let header = head_of(path).ok()?;
        (copied == self::copied(path)?).then_some(Self { header, copied })
    }

    /// True if `later` of the same file has another header and SQLite copied nothing in between: something else wrote into the file.
    pub fn was_overwritten(&self, later: &Self) -> bool {
        self.copied == later.copied && self.header != later.header
    }
}

/// Marks of the log's index that move when its content is copied; `None` without an index.
fn copied(path: &Path) -> Option<Vec<u8>> {
    let index = first_bytes(&beside(path, "-shm"), 132).ok()?;
    let parts = [32..40, 96..100, 128..132].map(|part| index.get(part));
    let parts: Option<Vec<&[u8]>> = parts.into_iter().collect();
    Some(parts?.concat())
}

/// The first bytes of a file, at most [`HEAD`].
pub(super) fn head_of(path: &Path) -> io::Result<Vec<u8>> {
    first_bytes(path, HEAD)
}

/// The first bytes of a file, at most so many.
///
/// It stays open to the end of the process: who closes a file lets go of every POSIX lock the process has on it, those of SQLite's
/// connections among them, and the next process that ends its own would take the write-ahead log away from under them
/// (<https://sqlite.org/howtocorrupt.html>, 2.2). The room of a store that is removed is free when the process ends.
fn first_bytes(path: &Path, most: usize) -> io::Result<Vec<u8>> {
    static OPEN: Mutex<Vec<(FileId, File)>> = Mutex::new(Vec::new());
    let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
    let wanted = FileId::from(&fs::metadata(path)?);
    let known = open.iter().position(|(known, _)| *known == wanted);
    let place = known.unwrap_or(open.len());
    if known.is_none() {
        // Another file may have come to this place by now.
        let file = File::open(path)?;
        let found = FileId::from(&file.metadata()?);
        open.push((found, file));
    }
    let mut head = vec![0; most];
    let mut length = 0;
    if let Some((_, file)) = open.get(place) {
        while let Some(rest) = head.get_mut(length..).filter(|rest| !rest.is_empty()) {
            match file.read_at(rest, length as u64) {
                Ok(0) => break,
                Ok(read) => length += read,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }
    head.truncate(length);
    Ok(head)
}
