//! Identity of a file by its content: of its size and both ends, or of every byte.

use crate::site::hex::hex;
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Length of each end that is read \[bytes\]. A finished MCAP file ends with its statistics, the places of its chunks
/// and a checksum over them, so that a change anywhere nearly always shows there.
const END: u64 = 64 << 10;

/// Way to tell a file from another.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Thoroughness {
    /// Size, first and last 64 KiB.
    #[default]
    Ends,
    /// Every byte.
    Whole,
}

/// Size of a file \[bytes\] and its identity: `ends:` or `sha256:` with the SHA-256 of what was read.
///
/// # Errors
/// It cannot be read, or is no regular file.
pub fn of(path: &Path, thoroughness: Thoroughness) -> io::Result<(u64, String)> {
    let mut file = File::open(path)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "no regular file"));
    }
    let bytes = metadata.len();
    let mut hash = Sha256::new();
    let word = match thoroughness {
        Thoroughness::Whole => {
            add(&mut hash, &mut file, u64::MAX)?;
            "sha256"
        }
        Thoroughness::Ends => {
            hash.update(bytes.to_le_bytes());
            add(&mut hash, &mut file, END)?;
            if bytes > END {
                file.seek(SeekFrom::Start(END.max(bytes.saturating_sub(END))))?;
                add(&mut hash, &mut file, END)?;
            }
            "ends"
        }
    };
    Ok((bytes, format!("{word}:{}", hex(&hash.finalize()))))
}

/// Size and identity of a file, found as thoroughly as `like` was.
///
/// # Errors
/// As [`of`].
pub fn again(path: &Path, like: &str) -> io::Result<(u64, String)> {
    let thoroughness = match like.starts_with("sha256:") {
        true => Thoroughness::Whole,
        false => Thoroughness::Ends,
    };
    of(path, thoroughness)
}

fn add(hash: &mut Sha256, file: &mut File, most: u64) -> io::Result<()> {
    let mut buffer = vec![0; 64 << 10];
    let mut input = file.take(most);
    loop {
        match input.read(&mut buffer)? {
            0 => return Ok(()),
            count => hash.update(buffer.get(..count).unwrap_or_default()),
        }
    }
}

/// True if commits of a store wait in its write-ahead log: its file alone is then not its content.
pub fn has_open_log(store: &Path) -> bool {
    let mut log = store.as_os_str().to_owned();
    log.push("-wal");
    fs::metadata(log).is_ok_and(|data| data.len() > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_change_at_either_end_or_of_the_size_shows_and_one_inside_only_to_the_thorough() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let whole = vec![7u8; 400_000];
        let seen = |bytes: &[u8], thoroughness| {
            fs::write(&path, bytes).unwrap();
            of(&path, thoroughness).unwrap()
        };
        let (ends, every) = (
            seen(&whole, Thoroughness::Ends),
            seen(&whole, Thoroughness::Whole),
        );
        assert!(ends.1.starts_with("ends:") && every.1.starts_with("sha256:"));
        for (place, shows) in [
            (0, true),
            (65_535, true),
            (200_000, false),
            (340_000, true),
            (399_999, true),
        ] {
            let mut changed = whole.clone();
            changed[place] = 8;
            assert_eq!(seen(&changed, Thoroughness::Ends) != ends, shows, "{place}");
            assert_ne!(seen(&changed, Thoroughness::Whole), every, "{place}");
        }
        assert_ne!(seen(&whole[1..], Thoroughness::Ends), ends);
        assert_eq!(
            again(&path, &every.1).unwrap().1.split(':').next(),
            Some("sha256")
        );
        // Short enough to be read once.
        assert_ne!(seen(b"ab", Thoroughness::Ends), seen(b"ac", Thoroughness::Ends));
    }
}
