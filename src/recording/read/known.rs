//! Places of a finished file that its summary tells: reading goes on at them behind damage.

use super::layout::{Chunk, Layout};
use mcap::records::op;
use std::collections::BTreeSet;
use std::io::{self, Read, Seek, SeekFrom};

/// Fault of a chunk's opcode or length.
pub(super) const HEAD: &str = "the kind or the length of a chunk is damaged, and taken from the summary";

/// Places of a file.
pub(super) struct Known {
    layout: Layout,
    /// Begins of the chunks whose opcode or length is not the summary's.
    odd: BTreeSet<u64>,
}

/// Part of a file that a byte belongs to.
#[derive(Debug, Clone, Copy)]
pub(super) enum Region<'a> {
    /// A chunk.
    Chunk(&'a Chunk),
    /// The indices behind a chunk, up to this byte.
    Index(u64),
    /// Neither, up to the begin of a chunk or the end of the data.
    Between(u64),
    /// The end of the data, or what is behind.
    End,
}

impl Known {
    /// Reads the summary of a file and the heads of its chunks, and rewinds it; `None` if it has none, or one that does not fit.
    pub fn read(input: &mut (impl Read + Seek)) -> io::Result<Option<Self>> {
        let found = Self::find(input);
        input.seek(SeekFrom::Start(0))?;
        match found {
            // Shorter than it seems: cut while it was read.
            Err(fault) if fault.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
            found => found,
        }
    }

    fn find(input: &mut (impl Read + Seek)) -> io::Result<Option<Self>> {
        let Some(layout) = Layout::read(input)? else {
            return Ok(None);
        };
        let mut odd = BTreeSet::new();
        for chunk in &layout.chunks {
            let mut head = [0; 9];
            input.seek(SeekFrom::Start(chunk.at))?;
            input.read_exact(&mut head)?;
            if head != chunk.head() {
                odd.insert(chunk.at);
            }
        }
        // Where most differ, the writer counts in another way.
        let fits = odd.len() <= 1 || 2 * odd.len() < layout.chunks.len();
        Ok(fits.then_some(Self { layout, odd }))
    }

    /// True if the summary has a checksum.
    pub fn is_checked(&self) -> bool {
        self.layout.is_checked
    }

    /// True if the data end at this byte.
    pub fn ends_at(&self, offset: u64) -> bool {
        offset == self.layout.data_end
    }

    /// Records of channels and schemas, the first time.
    pub fn take_definitions(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.layout.definitions)
    }

    /// Opcode and length of the chunk that begins here, if the file has others: once.
    pub fn head(&mut self, offset: u64) -> Option<[u8; 9]> {
        match (self.odd.remove(&offset), self.region(offset)) {
            (true, Region::Chunk(chunk)) => Some(chunk.head()),
            _ => None,
        }
    }

    /// Part of the file that a byte belongs to.
    pub fn region(&self, offset: u64) -> Region<'_> {
        let Layout { chunks, data_end, .. } = &self.layout;
        let after = chunks.partition_point(|chunk| chunk.at <= offset);
        if let Some(chunk) = after.checked_sub(1).and_then(|before| chunks.get(before)) {
            let end = chunk.at + chunk.record;
            if offset < end {
                return Region::Chunk(chunk);
            }
            if offset < end + chunk.index {
                return Region::Index(end + chunk.index);
            }
        }
        match chunks.get(after) {
            Some(next) => Region::Between(next.at),
            None if offset < *data_end => Region::Between(*data_end),
            None => Region::End,
        }
    }

    /// Checks that a record may stand where it stands: one whose kind or length is damaged could hide chunks.
    pub fn check(&self, offset: u64, opcode: u8, bytes: u64) -> Result<(), &'static str> {
        if !self.is_checked() {
            return Ok(());
        }
        let is_right = match self.region(offset) {
            // A chunk of another length is right if its content is.
            Region::Chunk(chunk) => opcode == op::CHUNK && offset == chunk.at,
            Region::Index(end) => opcode == op::MESSAGE_INDEX && offset + bytes <= end,
            Region::Between(end) => !matches!(opcode, op::DATA_END | op::FOOTER) && offset + bytes <= end,
            Region::End => opcode == op::DATA_END || !self.ends_at(offset),
        };
        match is_right {
            true => Ok(()),
            false => Err("a record that does not fit the summary"),
        }
    }
}
