//! A file that the daemon writes, watched by its identity, because its name may be given to another file.

use std::fmt;
use std::fs::{self, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Reason why a file is no longer the one that is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lost {
    /// No file has that name.
    Removed,
    /// Another file has its name.
    Replaced,
    /// It is shorter than it was.
    Truncated,
    /// Another program wrote into it.
    Overwritten,
    /// Its file system is read-only.
    ReadOnly,
    /// The system gives no information.
    Unknown,
}

impl fmt::Display for Lost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Removed => "was removed",
            Self::Replaced => "was replaced by another file",
            Self::Truncated => "was cut short",
            Self::Overwritten => "was written by another program (a backup copied over it?)",
            Self::ReadOnly => "is on a file system that was made read-only",
            Self::Unknown => "cannot be looked at",
        })
    }
}

/// A file that is written, by device and inode.
#[derive(Debug, Clone)]
pub struct Owned {
    path: PathBuf,
    identity: (u64, u64),
    /// Greatest length so far \[bytes\].
    length: u64,
}

impl Owned {
    /// File with this name at present; `None` if there is none.
    pub fn of(path: &Path) -> Option<Self> {
        let data = fs::metadata(path).ok()?;
        Some(Self::with(path, &data))
    }

    /// Open file with this metadata, expected under this name.
    pub fn with(path: &Path, data: &Metadata) -> Self {
        Self {
            path: path.to_owned(),
            identity: (data.dev(), data.ino()),
            length: data.len(),
        }
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Checks that the name still belongs to this file, that it is not shorter than before, and that it can
    /// be written.
    ///
    /// # Errors
    /// Reason if not.
    pub fn look(&mut self) -> Result<(), Lost> {
        let data = fs::metadata(&self.path).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => Lost::Removed,
            _ => Lost::Unknown,
        })?;
        if (data.dev(), data.ino()) != self.identity {
            return Err(Lost::Replaced);
        }
        if data.len() < self.length {
            return Err(Lost::Truncated);
        }
        self.length = data.len();
        let disk = rustix::fs::statvfs(&self.path).map_err(|_| Lost::Unknown)?;
        if disk.f_flag.contains(rustix::fs::StatVfsMountFlags::RDONLY) {
            return Err(Lost::ReadOnly);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_missed_whatever_becomes_of_it_and_known_when_it_is_back() {
        let folder = tempfile::tempdir().unwrap();
        let [path, other] = ["file", "other"].map(|name| folder.path().join(name));
        assert!(Owned::of(&path).is_none());
        fs::write(&path, "1234").unwrap();
        let mut owned = Owned::of(&path).unwrap();
        assert_eq!(owned.look(), Ok(()));
        fs::rename(&path, &other).unwrap();
        assert_eq!(owned.look(), Err(Lost::Removed));
        fs::write(&path, "1234").unwrap();
        assert_eq!(owned.look(), Err(Lost::Replaced));
        fs::rename(&other, &path).unwrap();
        assert_eq!(owned.look(), Ok(()));
        fs::File::options()
            .write(true)
            .open(&path)
            .unwrap()
            .set_len(3)
            .unwrap();
        assert_eq!(owned.look(), Err(Lost::Truncated));
    }

    /// A mount over a folder shows the same files, read-only: as after an error of the disk.
    #[test]
    fn a_disk_that_became_read_only_is_noticed_and_its_return_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, "1234").unwrap();
        let mut owned = Owned::of(&path).unwrap();
        let mount = |words: &[&str]| {
            let mut command = std::process::Command::new(words[0]);
            let done = command.args(&words[1..]).arg(folder.path()).output();
            done.is_ok_and(|done| done.status.success())
        };
        let shown = folder.path().display().to_string();
        if !mount(&["mount", "--bind", &shown]) {
            eprintln!("skipped: only root may mount");
            return;
        }
        assert_eq!(owned.look(), Ok(()));
        assert!(mount(&["mount", "-o", "remount,ro,bind"]));
        assert_eq!(owned.look(), Err(Lost::ReadOnly));
        assert!(mount(&["umount"]));
        assert_eq!(owned.look(), Ok(()));
    }
}
