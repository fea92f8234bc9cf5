//! A copy of a store, taken while another process may be writing.

use super::lock::beside;
use super::state::Failure;
use super::{Reader, StoreError, open};
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;

impl Reader {
    /// Writes the present content of the store to `target`, as one file, checked row by row before it gets
    /// its name; an older copy of that name is replaced. The writer continues meanwhile.
    ///
    /// # Errors
    /// `target` is a store in use by a writer, or cannot be written; the store cannot be read; the copy
    /// differs from it.
    pub fn copy_to(&self, target: &Path) -> Result<(), StoreError> {
        let io = |source| StoreError::Io {
            path: target.to_owned(),
            source,
        };
        let is_itself = fs::canonicalize(target).is_ok_and(|target| target == self.path);
        if is_itself || beside(target, ".lock").exists() || target.is_dir() {
            let what = "a store that is written, or a folder: name another file for the copy";
            return Err(io(io::Error::new(ErrorKind::AlreadyExists, what)));
        }
        let part = beside(target, ".part");
        let result = self.copy_and_check(&part);
        let result = result.and_then(|()| fs::rename(&part, target).map_err(io));
        if result.is_err() {
            // The first error matters more than a failure to remove the file.
            let _ = fs::remove_file(&part);
        }
        result?;
        let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
            // Some file systems cannot flush a folder; the copy is whole and in its place either way.
            let _ = folder.sync_all();
        }
        Ok(())
    }

    fn copy_and_check(&self, part: &Path) -> Result<(), StoreError> {
        let io = |source| StoreError::Io {
            path: part.to_owned(),
            source,
        };
        match fs::remove_file(part) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(io(error)),
            _ => {}
        }
        let name = part.to_str().ok_or_else(|| {
            io(io::Error::new(
                ErrorKind::InvalidInput,
                "the name is not UTF-8: name another file for the copy",
            ))
        })?;
        self.connection
            .execute("VACUUM INTO ?", [name])
            .map_err(|error| self.fault(Failure::Sql(error)))?;
        open::for_reading_whole(part)?;
        File::open(part).and_then(|file| file.sync_all()).map_err(io)
    }
}
