//! Recordings under a folder, and their names as text.

use std::collections::VecDeque;
use std::ffi::{OsStr, OsString};
use std::fs::{self, DirEntry, Metadata, ReadDir};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Entry under a folder; names and paths are relative to it.
pub(super) enum Entry {
    /// A regular file with the name of a recording.
    Recording(OsString, Metadata),
    /// A link to a recording or a folder. Links may lead out of the folder and are not followed.
    Link(OsString),
    /// A folder that cannot be read; the empty path is the folder itself.
    Unreadable(PathBuf, io::Error),
}

/// Iterator over the recordings under a folder. Hidden files and folders are left out.
pub(super) struct Listing {
    root: Arc<Path>,
    has_subfolders: bool,
    waiting: VecDeque<PathBuf>,
    /// The folder that is listed, with what is left of it.
    open: Option<(PathBuf, ReadDir)>,
}

impl Listing {
    /// Listing of `root`, with all folders below it if `has_subfolders`.
    pub(super) fn of(root: Arc<Path>, has_subfolders: bool) -> Self {
        Self {
            root,
            has_subfolders,
            waiting: VecDeque::from([PathBuf::new()]),
            open: None,
        }
    }

    fn entry(&mut self, folder: &Path, entry: &DirEntry) -> Option<Entry> {
        let own = entry.file_name();
        // The entry's own type: that of a link is not its target's.
        let kind = entry.file_type().ok()?;
        if own.as_bytes().starts_with(b".") {
            return None;
        }
        let name = folder.join(&own).into_os_string();
        if kind.is_symlink() {
            let leads_on =
                || self.has_subfolders && fs::metadata(self.root.join(&name)).is_ok_and(|data| data.is_dir());
            return (is_recording(&own) || leads_on()).then_some(Entry::Link(name));
        }
        if kind.is_dir() && self.has_subfolders {
            self.waiting.push_back(name.into());
            return None;
        }
        // Gone since if it has no data: it is no recording any more.
        (kind.is_file() && is_recording(&own))
            .then(|| entry.metadata().ok())
            .flatten()
            .map(|data| Entry::Recording(name, data))
    }
}

impl Iterator for Listing {
    type Item = Entry;

    fn next(&mut self) -> Option<Entry> {
        loop {
            let Some((folder, mut entries)) = self.open.take() else {
                let folder = self.waiting.pop_front()?;
                match fs::read_dir(self.root.join(&folder)) {
                    Ok(entries) => self.open = Some((folder, entries)),
                    // One below that went since its folder was listed is no fault.
                    Err(fault) if fault.kind() == io::ErrorKind::NotFound && folder != Path::new("") => {}
                    Err(fault) => return Some(Entry::Unreadable(folder, fault)),
                }
                continue;
            };
            match entries.next() {
                None => {}
                Some(Err(fault)) => return Some(Entry::Unreadable(folder, fault)),
                Some(Ok(entry)) => {
                    let found = self.entry(&folder, &entry);
                    self.open = Some((folder, entries));
                    if found.is_some() {
                        return found;
                    }
                }
            }
        }
    }
}

/// True if a file of this name is a recording: `*.mcap`, and not hidden.
fn is_recording(name: &OsStr) -> bool {
    let name = name.as_bytes();
    let ends = name.len() > 5 && name[name.len() - 5..].eq_ignore_ascii_case(b".mcap");
    ends && name[0] != b'.'
}

/// A name as text: bytes that are not UTF-8 as `\xNN`, a backslash as two. One in a folder below begins with `./`, which no part of
/// the journal does.
pub(super) fn label(name: &OsStr) -> String {
    let mut label = String::new();
    if name.as_bytes().contains(&b'/') {
        label.push_str("./");
    }
    for chunk in name.as_bytes().utf8_chunks() {
        label.push_str(&chunk.valid().replace('\\', "\\\\"));
        for byte in chunk.invalid() {
            label.push_str(&format!("\\x{byte:02x}"));
        }
    }
    label
}

/// Name of a label; `None` for a part of the journal.
pub(super) fn name_of(label: &str) -> Option<OsString> {
    let text = match label.strip_prefix("./") {
        Some(below) => below,
        None if label.contains('/') => return None,
        None => label,
    };
    let mut name = Vec::new();
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte != b'\\' {
            name.push(byte);
            continue;
        }
        match after {
            [b'x', high, low, after @ ..] => {
                let digits = [*high, *low];
                let digits = std::str::from_utf8(&digits).ok()?;
                name.push(u8::from_str_radix(digits, 16).ok()?);
                rest = after;
            }
            [b'\\', after @ ..] => {
                name.push(b'\\');
                rest = after;
            }
            _ => return None,
        }
    }
    Some(OsStr::from_bytes(&name).to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_lead_back_to_names() {
        for name in [
            &b"plain.mcap"[..],
            b"\xff\xfe.mcap",
            b"a\\b.mcap",
            b"a\\xff\xc3.mcap",
            "t\u{f6}di.mcap".as_bytes(),
            b"2026/11/\xff.mcap",
            b"journal/journal.000001.mcap",
        ] {
            let name = OsStr::from_bytes(name);
            assert_eq!(name_of(&label(name)).as_deref(), Some(name));
        }
        assert_eq!(name_of("journal/journal.000001.mcap"), None);
    }

    #[test]
    fn only_recordings_count() {
        let is = |name: &str| is_recording(OsStr::new(name));
        assert!(is("a.mcap") && is("A.MCAP"));
        assert!(!is(".mcap") && !is(".a.mcap") && !is("a.mcap.part") && !is("a.tmp") && !is("mcap"));
    }
}
