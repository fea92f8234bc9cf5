//! Puts a finished result into its place: on the file system of the results, flushed, under its name in one step.

use crate::service::telemetry::process;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// Name beside its place of a file under way, of this machine and process alone: two that run the same task end with one result, and
/// neither sees a part of the other's.
///
/// # Errors
/// The place is no file name.
pub fn under_way(target: &Path) -> io::Result<PathBuf> {
    let name = target
        .file_name()
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "not a file name"))?;
    let mut part = std::ffi::OsString::from(".");
    part.push(name);
    part.push(format!(".{}.{}.part", process::host(), std::process::id()));
    Ok(target.with_file_name(part))
}

/// Copies a file to its place.
///
/// # Errors
/// The file system refuses; nothing is left behind under the name.
pub fn put(from: &Path, target: &Path) -> io::Result<()> {
    let part = under_way(target)?;
    let copied = File::create(&part).and_then(|mut into| io::copy(&mut File::open(from)?, &mut into));
    if let Err(error) = copied {
        // The first error matters more than a failure to remove the file.
        let _ = fs::remove_file(&part);
        return Err(error);
    }
    settle(&part, target)
}

/// Flushes a file [under way](under_way) and gives it its name.
///
/// # Errors
/// The file system refuses; nothing is left behind.
pub fn settle(part: &Path, target: &Path) -> io::Result<()> {
    let named = File::open(part)
        .and_then(|file| file.sync_all())
        .and_then(|()| fs::rename(part, target));
    if named.is_err() {
        let _ = fs::remove_file(part);
    }
    named?;
    if let Some(folder) = target.parent()
        && let Ok(folder) = File::open(folder)
    {
        // Some file systems cannot flush a folder; the result is whole and in its place either way.
        let _ = folder.sync_all();
    }
    Ok(())
}
