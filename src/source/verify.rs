//! The checksum over a whole MCAP file, looked at before anything in it is believed.

use std::io::{self, Read, Seek, SeekFrom};

/// What the checksum over a file's data section says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trust {
    /// It is there and right: nothing in the data section is damaged.
    Verified,
    /// It is there and wrong: something is damaged, only checked chunks can be believed, and only up
    /// to the first oddity.
    Damaged,
    /// There is none, or the file has no end yet.
    Unverified,
}

const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
const FOOTER: u64 = 9 + 20;
const DATA_END: u64 = 9 + 4;

/// Reads the file once to check it, and goes back to its start.
pub fn verify(file: &mut (impl Read + Seek)) -> io::Result<Trust> {
    let trust = check(file);
    file.seek(SeekFrom::Start(0))?;
    match trust {
        // Shorter than it seems: cut while it was read.
        Err(fault) if fault.kind() == io::ErrorKind::UnexpectedEof => Ok(Trust::Unverified),
        trust => trust,
    }
}

fn check(file: &mut (impl Read + Seek)) -> io::Result<Trust> {
    let length = file.seek(SeekFrom::End(0))?;
    let tail_length = FOOTER + MAGIC.len() as u64;
    if length < tail_length + DATA_END {
        return Ok(Trust::Unverified);
    }
    let footer_at = length - tail_length;
    file.seek(SeekFrom::Start(footer_at))?;
    let mut tail = [0u8; 37];
    file.read_exact(&mut tail)?;
    let (footer, magic) = tail.split_at(29);
    let (head, content) = footer.split_at(9);
    if magic != MAGIC || head != [2, 20, 0, 0, 0, 0, 0, 0, 0] {
        return Ok(Trust::Unverified);
    }
    let mut summary_at = [0u8; 8];
    summary_at.copy_from_slice(&content[..8]);
    let summary_at = match u64::from_le_bytes(summary_at) {
        0 => footer_at,
        at => at,
    };
    let Some(end_at) = summary_at
        .checked_sub(DATA_END)
        .filter(|_| summary_at <= footer_at)
    else {
        return Ok(Trust::Unverified);
    };
    file.seek(SeekFrom::Start(end_at))?;
    let mut end = [0u8; 13];
    file.read_exact(&mut end)?;
    let [15, 4, 0, 0, 0, 0, 0, 0, 0, a, b, c, d] = end else {
        return Ok(Trust::Unverified);
    };
    let saved = u32::from_le_bytes([a, b, c, d]);
    if saved == 0 {
        return Ok(Trust::Unverified);
    }
    file.seek(SeekFrom::Start(0))?;
    let mut hasher = crc32fast::Hasher::new();
    let mut data = file.take(end_at);
    let mut buffer = vec![0u8; 1 << 18];
    loop {
        match data.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => hasher.update(&buffer[..count]),
            Err(fault) if fault.kind() == io::ErrorKind::Interrupted => {}
            Err(fault) => return Err(fault),
        }
    }
    Ok(if hasher.finalize() == saved {
        Trust::Verified
    } else {
        Trust::Damaged
    })
}
