//! Puts a finished result into its place: on the file system of the results, flushed, under its name in one step.

use crate::service::telemetry::process;
use std::fs::{self, File};
use std::io;
use std::path::Path;

/// Copies a file to its place. The name of the copy under way is of this machine and process alone: two that run the
/// same task end with one result, and neither sees a part of the other's.
///
/// # Errors
/// The file system refuses; nothing is left behind under the name.
pub fn put(from: &Path, target: &Path) -> io::Result<()> {
    let name = target
        .file_name()
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "not a file name"))?;
    let mut part = std::ffi::OsString::from(".");
    part.push(name);
    part.push(format!(".{}.{}.part", process::host(), std::process::id()));
    let part = target.with_file_name(part);
    let copy = || -> io::Result<()> {
        let mut into = File::create(&part)?;
        io::copy(&mut File::open(from)?, &mut into)?;
        into.sync_all()?;
        fs::rename(&part, target)
    };
    let copied = copy();
    if copied.is_err() {
        // The first error matters more than a failure to remove the file.
        let _ = fs::remove_file(&part);
    }
    copied?;
    if let Some(folder) = target.parent()
        && let Ok(folder) = File::open(folder)
    {
        // Some file systems cannot flush a folder; the result is whole and in its place either way.
        let _ = folder.sync_all();
    }
    Ok(())
}
