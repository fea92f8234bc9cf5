//! A folder for copies, which goes with the process.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Beginning of the folder's name; the process id and a number follow.
const NAME: &str = "tirante-hub-";

/// A folder of the process alone, removed when dropped.
#[derive(Debug)]
pub struct Scratch(PathBuf);

impl Scratch {
    /// Creates it among the system's temporary files, and removes those that killed processes left.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn new() -> io::Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let all = std::env::temp_dir();
        for left in fs::read_dir(&all).into_iter().flatten().flatten() {
            let name = left.file_name();
            let of = name.to_str().and_then(|name| name.strip_prefix(NAME));
            let process = of.and_then(|of| of.split_once('-')).map(|(process, _)| process);
            if process.is_some_and(|id| id.parse::<u32>().is_ok() && !Path::new("/proc").join(id).exists()) {
                // Another user's is not ours to remove.
                let _ = fs::remove_dir_all(left.path());
            }
        }
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let folder = all.join(format!("{NAME}{}-{number}", std::process::id()));
        // Of an earlier process of this number. What is not removed lets the next step fail.
        let _ = fs::remove_dir_all(&folder);
        DirBuilder::new().mode(0o700).create(&folder)?;
        Ok(Self(folder))
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
