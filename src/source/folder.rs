//! Paths as given on the command line to the recordings they mean, in the order of their data.

use super::SourceError;
use super::wire::Fields;
use std::fs::{self, File};
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Expands folders to their `*.mcap` files (regular files only, not below) and puts all recordings in the
/// order of their first message; files without one come last, by name. Before them stand the paths that
/// lead to no recording, each with its reason: the others are still worth reading.
pub fn recordings(paths: &[PathBuf]) -> Vec<Result<PathBuf, SourceError>> {
    let mut found = Vec::new();
    let mut failed = Vec::new();
    for path in paths {
        match expand(path) {
            Ok(files) => found.extend(files),
            Err(error) => failed.push(Err(error)),
        }
    }
    let mut timed: Vec<(u64, PathBuf)> = found
        .into_iter()
        .map(|path| (first_time_at(&path).unwrap_or(u64::MAX), path))
        .collect();
    timed.sort();
    timed.dedup();
    failed.extend(timed.into_iter().map(|(_, path)| Ok(path)));
    failed
}

/// The recordings of one path: itself, or a folder's.
fn expand(path: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let failed = |source| SourceError::Io {
        path: path.display().to_string(),
        source,
    };
    if !fs::metadata(path).map_err(failed)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in fs::read_dir(path).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let path = entry.path();
        let named = path
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"));
        // The entry's own type: links may lead out of the folder and are not followed.
        if named && entry.file_type().is_ok_and(|kind| kind.is_file()) {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(SourceError::Empty {
            path: path.display().to_string(),
        });
    }
    Ok(files)
}

/// Records looked at for the first message.
const LOOKED_AT: usize = 1000;

fn first_time_at(path: &Path) -> Option<u64> {
    if !fs::metadata(path).ok()?.is_file() {
        return None;
    }
    first_time(&File::open(path).ok()?)
}

/// Log time of the first message \[ns since 1970\], from the first chunk's header or the message itself.
pub fn first_time(file: &File) -> Option<u64> {
    let mut file = BufReader::new(file);
    file.seek(SeekFrom::Start(8)).ok()?;
    for _ in 0..LOOKED_AT {
        let mut head = [0u8; 9];
        file.read_exact(&mut head).ok()?;
        let mut fields = Fields(&head);
        let (opcode, length) = (fields.u8().ok()?, fields.u64().ok()?);
        let skipped = match opcode {
            mcap::records::op::CHUNK => 0,
            // Channel and sequence number come first.
            mcap::records::op::MESSAGE => 6,
            mcap::records::op::FOOTER => return None,
            _ => {
                file.seek_relative(i64::try_from(length).ok()?).ok()?;
                continue;
            }
        };
        file.seek_relative(skipped).ok()?;
        let mut time = [0u8; 8];
        file.read_exact(&mut time).ok()?;
        return Some(u64::from_le_bytes(time));
    }
    None
}
