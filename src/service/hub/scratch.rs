//! A folder for copies, which goes with the process.

use std::fs::{self, DirBuilder, File};
use std::io::{self, ErrorKind};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

/// Beginning of the folder's name; a number follows.
const NAME: &str = "tirante-copies-";
/// File in it that its process holds locked: a folder whose file anybody can lock was left by a process that was killed.
const LOCK: &str = "held";

/// A folder of the process alone, removed when dropped.
#[derive(Debug)]
pub struct Scratch {
    path: PathBuf,
    _held: File,
}

impl Scratch {
    /// Creates it below a folder, which is created too, and removes those that killed processes left there.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn new(below: &Path) -> io::Result<Self> {
        fs::create_dir_all(below)?;
        for left in fs::read_dir(below)?.flatten() {
            let is_ours = left
                .file_name()
                .to_str()
                .is_some_and(|name| name.starts_with(NAME));
            // The lock is held to the end of the removal. Another user's is not ours to remove.
            if is_ours && let Ok(_held) = hold(&left.path(), false) {
                let _ = fs::remove_dir_all(left.path());
            }
        }
        let mut number = 0_u32;
        loop {
            number += 1;
            let path = below.join(format!("{NAME}{number}"));
            match DirBuilder::new().mode(0o700).create(&path) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
                made => made?,
            }
            // Another process may have taken it for one that was left, and removed it or be about to.
            match hold(&path, true) {
                Ok(held) if path.join(LOCK).exists() => return Ok(Self { path, _held: held }),
                Ok(_) => {}
                Err(error) if [ErrorKind::WouldBlock, ErrorKind::NotFound].contains(&error.kind()) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Locks the file of a folder.
fn hold(folder: &Path, is_new: bool) -> io::Result<File> {
    let file = File::options()
        .write(true)
        .create_new(is_new)
        .open(folder.join(LOCK))?;
    file.try_lock()?;
    Ok(file)
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_was_left_goes_and_one_in_use_stays() {
        let below = tempfile::tempdir().unwrap();
        let all = below.path().join("copies");
        let first = Scratch::new(&all).unwrap();
        fs::write(first.path().join("site.db"), "rows").unwrap();
        let left = all.join(format!("{NAME}7"));
        let other = all.join("other");
        for folder in [&left, &other] {
            fs::create_dir(folder).unwrap();
            fs::write(folder.join(LOCK), "").unwrap();
        }
        let second = Scratch::new(&all).unwrap();
        assert_ne!(first.path(), second.path());
        assert!(first.path().join("site.db").exists() && other.exists() && !left.exists());
        let path = first.path().to_owned();
        drop(first);
        assert!(!path.exists());
    }
}
