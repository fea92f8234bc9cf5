//! The files of a journal: names and listing.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// File name of a part.
pub fn file_name(part: u32) -> String {
    format!("journal.{part:06}.mcap")
}

/// Number of the part with this file name; `None` if it is not a part's.
pub fn number(name: &str) -> Option<u32> {
    let digits = name.strip_prefix("journal.")?.strip_suffix(".mcap")?;
    let part = digits.parse().ok()?;
    (file_name(part) == name).then_some(part)
}

/// Path of a part.
pub fn path(folder: &Path, part: u32) -> PathBuf {
    folder.join(file_name(part))
}

/// Name of a part in the store: `journal/journal.000001.mcap`, wherever the folder is.
pub fn mark_name(part: u32) -> String {
    format!("journal/{}", file_name(part))
}

/// Number of the part with this name in the store.
pub fn number_of_mark(name: &str) -> Option<u32> {
    number(name.strip_prefix("journal/")?)
}

/// Numbers of the parts in a folder, ascending.
///
/// # Errors
/// The folder cannot be read.
pub fn list(folder: &Path) -> io::Result<Vec<u32>> {
    let mut parts = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let part = entry.file_name().to_str().and_then(number);
        if entry.file_type()?.is_file() {
            parts.extend(part);
        }
    }
    parts.sort_unstable();
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_numbers_agree() {
        for part in [1, 999_999, 1_000_000, u32::MAX] {
            assert_eq!(number(&file_name(part)), Some(part));
            assert_eq!(number_of_mark(&mark_name(part)), Some(part));
        }
        for other in [
            "journal.1.mcap",
            "journal.0000001.mcap",
            "journal.+00001.mcap",
            "a.mcap",
        ] {
            assert_eq!(number(other), None);
        }
    }
}
