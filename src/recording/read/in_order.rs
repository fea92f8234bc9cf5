//! The chunks of a finished file in the order of their times, where its writer left them in another.
//!
//! A recorder that writes a block late leaves chunks that lie before earlier ones. The summary says where each begins in the file
//! and in time; if those of every channel lie one after another in time, they are read in that order. Chunks of one channel that
//! overlap (a clock set back) stay as they are: nothing says which belongs where.

use super::verify;
use super::wire::Fields;
use mcap::records::op;
use std::collections::{BTreeMap, VecDeque};
use std::io::{self, Read, Seek, SeekFrom};

/// Largest summary looked through \[bytes\].
const MAX_SUMMARY: u64 = 16 << 20;
/// Longest overlap of two chunks of a channel that lie one after another \[ns\].
const OVERLAP_NS: u64 = 1_000_000_000;

/// A file, or its pieces in another order.
pub(super) struct InOrder<R> {
    input: R,
    /// Pieces left to read after the one under way.
    pieces: VecDeque<Piece>,
    /// Bytes left of the piece under way.
    left: u64,
    is_moved: bool,
}

/// A piece of the file: its begin and length \[bytes\]; or bytes that stand before the first moved chunk.
#[derive(Debug, Clone)]
enum Piece {
    File(u64, u64),
    Given(Vec<u8>),
}

/// Where the bytes read stand in the file.
#[derive(Debug, Clone, Default)]
pub(super) struct Places {
    /// Begin of each piece as read and in the file \[bytes\].
    begins: Vec<(u64, u64)>,
}

impl Places {
    /// Position in the file of a byte read.
    pub fn in_file(&self, read: u64) -> u64 {
        let after = self.begins.partition_point(|(begin, _)| *begin <= read);
        match after.checked_sub(1).map(|piece| self.begins[piece]) {
            Some((begin, at)) => at + (read - begin),
            None => read,
        }
    }
}

impl<R> InOrder<R> {
    /// The file as it is.
    pub fn plain(input: R) -> Self {
        Self {
            input,
            pieces: VecDeque::new(),
            left: 0,
            is_moved: false,
        }
    }

    /// True if its pieces are read in another order than they stand.
    pub fn is_moved(&self) -> bool {
        self.is_moved
    }
}

impl<R: Read + Seek> InOrder<R> {
    /// A finished file, its chunks by time, and where they stand.
    pub fn by_time(mut input: R) -> io::Result<(Self, Places)> {
        let layout = Layout::read(&mut input);
        input.seek(SeekFrom::Start(0))?;
        let pieces = match layout {
            Ok(layout) => layout.and_then(Layout::by_time),
            // Shorter than it seems: cut while it was read.
            Err(fault) if fault.kind() == io::ErrorKind::UnexpectedEof => None,
            Err(fault) => return Err(fault),
        };
        let Some(pieces) = pieces else {
            return Ok((Self::plain(input), Places::default()));
        };
        let mut places = Places::default();
        let mut read = 0;
        for piece in &pieces {
            let (at, length) = match piece {
                Piece::File(at, length) => (*at, *length),
                Piece::Given(bytes) => (read, bytes.len() as u64),
            };
            places.begins.push((read, at));
            read += length;
        }
        let moved = Self {
            input,
            pieces: pieces.into(),
            left: 0,
            is_moved: true,
        };
        Ok((moved, places))
    }
}

impl<R: Read + Seek> Read for InOrder<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if !self.is_moved {
            return self.input.read(buffer);
        }
        while self.left == 0 {
            match self.pieces.pop_front() {
                None => return Ok(0),
                Some(Piece::File(at, length)) => {
                    self.input.seek(SeekFrom::Start(at))?;
                    self.left = length;
                }
                Some(Piece::Given(mut bytes)) => {
                    let count = bytes.len().min(buffer.len());
                    buffer[..count].copy_from_slice(&bytes[..count]);
                    bytes.drain(..count);
                    if !bytes.is_empty() {
                        self.pieces.push_front(Piece::Given(bytes));
                    }
                    return Ok(count);
                }
            }
        }
        // Bounded by the buffer.
        let wanted = self.left.min(buffer.len() as u64) as usize;
        let count = self.input.read(&mut buffer[..wanted])?;
        self.left -= count as u64;
        Ok(count)
    }
}

/// A chunk as the summary describes it.
#[derive(Debug, Clone)]
struct Chunk {
    at: u64,
    length: u64,
    from_ns: u64,
    to_ns: u64,
    channels: Vec<u16>,
}

/// Chunks and definitions of a file by its summary.
struct Layout {
    /// In the order of the file.
    chunks: Vec<Chunk>,
    /// Records of schemas and channels, as they stand in the summary.
    definitions: Vec<u8>,
    summary_at: u64,
    size: u64,
}

impl Layout {
    /// Reads the summary; `None` without one, or if something in it is odd.
    fn read(input: &mut (impl Read + Seek)) -> io::Result<Option<Self>> {
        let size = input.seek(SeekFrom::End(0))?;
        let Some((summary_at, footer_at)) = verify::summary(input)? else {
            return Ok(None);
        };
        let length = footer_at - summary_at;
        if length == 0 || length > MAX_SUMMARY {
            return Ok(None);
        }
        input.seek(SeekFrom::Start(summary_at))?;
        let mut bytes = vec![0; length as usize];
        input.read_exact(&mut bytes)?;
        let found = Self::parse(&bytes, summary_at, size);
        Ok(found.ok().filter(Self::is_sound))
    }

    fn parse(bytes: &[u8], summary_at: u64, size: u64) -> Result<Self, &'static str> {
        let (mut chunks, mut definitions) = (Vec::new(), Vec::new());
        let mut records = Fields(bytes);
        loop {
            let before = records.0;
            let Some((opcode, fields)) = records.record()? else {
                break;
            };
            match opcode {
                op::SCHEMA | op::CHANNEL => {
                    definitions.extend_from_slice(&before[..before.len() - records.0.len()]);
                }
                op::CHUNK_INDEX => chunks.push(Chunk::parse(fields)?),
                _ => {}
            }
        }
        chunks.sort_by_key(|chunk| chunk.at);
        Ok(Self {
            chunks,
            definitions,
            summary_at,
            size,
        })
    }

    /// True if the chunks lie one after another in the file.
    fn is_sound(&self) -> bool {
        let ends = self.chunks.iter().map(|chunk| chunk.at.checked_add(chunk.length));
        let begins = self.chunks.iter().skip(1).map(|chunk| chunk.at);
        let mut limits = ends.zip(begins.chain([self.summary_at]));
        self.chunks.first().is_some_and(|first| first.at >= 8)
            && limits.all(|(end, limit)| end.is_some_and(|end| end <= limit))
    }

    /// The file's pieces with the chunks by time; `None` if they are so already, or no order is certain.
    fn by_time(self) -> Option<Vec<Piece>> {
        if self.chunks.is_sorted_by_key(|chunk| chunk.from_ns) || self.definitions.is_empty() {
            return None;
        }
        // What stands between two chunks (attachments, metadata) goes with the one before.
        let ends = self.chunks.iter().skip(1).map(|chunk| chunk.at);
        let last = self.chunks.last().map(|chunk| chunk.at + chunk.length)?;
        let mut order: Vec<(&Chunk, u64)> = self.chunks.iter().zip(ends.chain([last])).collect();
        order.sort_by_key(|(chunk, _)| chunk.from_ns);
        let mut until: BTreeMap<u16, u64> = BTreeMap::new();
        for (chunk, _) in &order {
            for channel in &chunk.channels {
                let end = until.entry(*channel).or_default();
                if *end > chunk.from_ns.saturating_add(OVERLAP_NS) {
                    return None;
                }
                *end = chunk.to_ns.max(*end);
            }
        }
        let mut pieces = vec![Piece::File(0, self.chunks.first()?.at)];
        // The chunk that defines a channel may come after one that uses it.
        pieces.push(Piece::Given(chunk_of(&self.definitions)));
        pieces.extend(
            order
                .iter()
                .map(|(chunk, end)| Piece::File(chunk.at, end - chunk.at)),
        );
        pieces.push(Piece::File(last, self.size.checked_sub(last)?));
        Some(pieces)
    }
}

impl Chunk {
    fn parse(mut fields: Fields<'_>) -> Result<Self, &'static str> {
        let (from_ns, to_ns) = (fields.u64()?, fields.u64()?);
        let (at, chunk_length) = (fields.u64()?, fields.u64()?);
        let length = fields.u32()?;
        let mut offsets = Fields(fields.bytes(u64::from(length))?);
        let mut channels = Vec::new();
        while !offsets.0.is_empty() {
            channels.push(offsets.u16()?);
            offsets.u64()?;
        }
        if channels.is_empty() {
            return Err("a chunk that does not name its channels");
        }
        let index_length = fields.u64()?;
        Ok(Self {
            at,
            length: chunk_length
                .checked_add(index_length)
                .ok_or("a chunk without end")?,
            from_ns,
            to_ns,
            channels,
        })
    }
}

/// A chunk of the given records, without messages, not compressed.
fn chunk_of(records: &[u8]) -> Vec<u8> {
    let size = records.len() as u64;
    let mut bytes = vec![op::CHUNK];
    bytes.extend((8 + 8 + 8 + 4 + 4 + 8 + size).to_le_bytes());
    bytes.extend([0; 16]);
    bytes.extend(size.to_le_bytes());
    bytes.extend(crc32fast::hash(records).to_le_bytes());
    bytes.extend(0u32.to_le_bytes());
    bytes.extend(size.to_le_bytes());
    bytes.extend(records);
    bytes
}
