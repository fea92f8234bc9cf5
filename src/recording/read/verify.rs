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
const DATA_END: u64 = 9 + 4;

/// Reads the file once to check it, and rewinds it.
pub fn verify(file: &mut (impl Read + Seek)) -> io::Result<Trust> {
    let Some(mut check) = Check::begin(file)? else {
        return Ok(Trust::Unverified);
    };
    loop {
        if let Some(trust) = check.step(file)? {
            return Ok(trust);
        }
    }
}

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

/// Begin of the summary of a complete file and of its footer, equal without a summary; `None` if the file has no end \[bytes\].
pub fn summary(file: &mut (impl Read + Seek)) -> io::Result<Option<(u64, u64)>> {
    let length = file.seek(SeekFrom::End(0))?;
    let tail_length = FOOTER + mcap::MAGIC.len() as u64;
    if length < tail_length + DATA_END {
        return Ok(None);
    }
    let footer_at = length - tail_length;
    file.seek(SeekFrom::Start(footer_at))?;
    let mut tail = [0u8; 37];
    file.read_exact(&mut tail)?;
    let (footer, magic) = tail.split_at(29);
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
    Ok((summary_at <= footer_at).then_some((summary_at, footer_at)))
}

/// End of the data of a complete file \[bytes\] and the checksum over them; `None` without.
fn find(file: &mut (impl Read + Seek)) -> io::Result<Option<(u64, u32)>> {
    let Some(end_at) = summary(file)?.and_then(|(summary_at, _)| summary_at.checked_sub(DATA_END)) else {
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
