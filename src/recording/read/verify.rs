//! Verifies the checksum over a whole MCAP file before any of its data is used.

use std::io::{self, Read, Seek, SeekFrom};

/// Result of the checksum over a file's data section.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trust {
    /// Present and correct: nothing in the data section is damaged.
    Verified,
    /// Present and wrong: something is damaged; only checked chunks are used, and only up to the first
    /// fault.
    Damaged,
    /// Absent, or the file has no end yet.
    Unverified,
}

const FOOTER: u64 = 9 + 20;
/// Length of the record that ends the data \[bytes\].
pub(super) const DATA_END: u64 = 9 + 4;

/// Number of bytes that a step reads.
const STEP: usize = 1 << 18;

/// An incremental checksum over a file.
pub struct Check {
    hasher: crc32fast::Hasher,
    left: u64,
    saved: u32,
}

impl Check {
    /// Reads the checksum at the end of a file and rewinds it; `None` if there is none.
    pub fn begin(file: &mut (impl Read + Seek)) -> io::Result<Option<Self>> {
        let found = find(file);
        file.seek(SeekFrom::Start(0))?;
        match found {
            // Shorter than it seems: cut while it was read.
            Err(fault) if fault.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
            Err(fault) => Err(fault),
            Ok(found) => Ok(found.map(|(left, saved)| Self {
                hasher: crc32fast::Hasher::new(),
                left,
                saved,
            })),
        }
    }

    /// Reads on; at the end returns the result and rewinds the file.
    pub fn step(&mut self, file: &mut (impl Read + Seek)) -> io::Result<Option<Trust>> {
        let mut buffer = vec![0u8; STEP];
        // Bounded by the buffer.
        let wanted = self.left.min(STEP as u64) as usize;
        match file.read(&mut buffer[..wanted]) {
            Ok(0) => {}
            Ok(count) => {
                self.hasher.update(&buffer[..count]);
                self.left -= count as u64;
                return Ok(None);
            }
            Err(fault) if fault.kind() == io::ErrorKind::Interrupted => return Ok(None),
            Err(fault) => return Err(fault),
        }
        file.seek(SeekFrom::Start(0))?;
        Ok(Some(if self.left > 0 {
            Trust::Unverified
        } else if self.hasher.clone().finalize() == self.saved {
            Trust::Verified
        } else {
            Trust::Damaged
        }))
    }
}

/// Ends of a complete file.
pub(super) struct Ends {
    /// Begin of the summary; that of the footer without one \[bytes\].
    pub summary_at: u64,
    /// Begin of the footer \[bytes\].
    pub footer_at: u64,
    /// Footer without its checksum, and that.
    footer: [u8; 25],
    checksum: u32,
}

impl Ends {
    /// Checksum of the summary as it is saved and by its bytes; `None` if none is saved.
    pub fn checksum_of(&self, summary: &[u8]) -> Option<(u32, u32)> {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(summary);
        hasher.update(&self.footer);
        (self.checksum != 0).then(|| (self.checksum, hasher.finalize()))
    }
}

/// Ends of a complete file; `None` if it has no end.
pub(super) fn ends(file: &mut (impl Read + Seek)) -> io::Result<Option<Ends>> {
    let length = file.seek(SeekFrom::End(0))?;
    let tail_length = FOOTER + mcap::MAGIC.len() as u64;
    if length < tail_length + DATA_END {
        return Ok(None);
    }
    let footer_at = length - tail_length;
    file.seek(SeekFrom::Start(footer_at))?;
    let (mut footer, mut checksum, mut magic) = ([0u8; 25], [0u8; 4], [0u8; 8]);
    file.read_exact(&mut footer)?;
    file.read_exact(&mut checksum)?;
    file.read_exact(&mut magic)?;
    let (head, content) = footer.split_at(9);
    if magic != mcap::MAGIC || head != [2, 20, 0, 0, 0, 0, 0, 0, 0] {
        return Ok(None);
    }
    let mut summary_at = [0u8; 8];
    summary_at.copy_from_slice(&content[..8]);
    let summary_at = match u64::from_le_bytes(summary_at) {
        0 => footer_at,
        at => at,
    };
    Ok((summary_at <= footer_at).then_some(Ends {
        summary_at,
        footer_at,
        footer,
        checksum: u32::from_le_bytes(checksum),
    }))
}

/// End of the data of a complete file \[bytes\] and the checksum over them; `None` without.
fn find(file: &mut (impl Read + Seek)) -> io::Result<Option<(u64, u32)>> {
    let Some(end_at) = ends(file)?.and_then(|ends| ends.summary_at.checked_sub(DATA_END)) else {
        return Ok(None);
    };
    file.seek(SeekFrom::Start(end_at))?;
    let mut end = [0u8; 13];
    file.read_exact(&mut end)?;
    let [15, 4, 0, 0, 0, 0, 0, 0, 0, a, b, c, d] = end else {
        return Ok(None);
    };
    let saved = u32::from_le_bytes([a, b, c, d]);
    if saved == 0 {
        return Ok(None);
    }
    Ok(Some((end_at, saved)))
}
