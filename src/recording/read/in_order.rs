//! The messages of a finished file in the order of their log times, where its writer left them in another.
//!
//! A recorder that writes a block late, from several threads, or merges two loggers leaves messages that stand before
//! earlier ones. The summary says when each chunk begins, the indices behind them when each message was logged: chunks are opened by
//! time, and the messages of those that overlap are passed on in order, as chunks made anew. No message comes
//! before one of its channel whose stamp is merely late ([`even`]).

mod even;
mod index;
mod merge;
mod window;

use super::hole::Hole;
use super::layout::Layout;
use index::{Order, WINDOW};
use mcap::records::op;
use merge::Merge;
use std::collections::VecDeque;
use std::io::{self, Read, Seek, SeekFrom};
use tirante_analysis::signal::record::Timestamp;

/// A file, or its pieces in another order.
pub(super) struct InOrder<R> {
    input: R,
    moved: Option<Box<Moved>>,
    /// Clause on messages that cannot be put in order, without the name of the file.
    beyond: Option<String>,
}

/// A file whose messages are put in order.
struct Moved {
    /// Pieces before the messages that come next.
    pieces: VecDeque<Piece>,
    merge: Merge,
    /// Records behind the chunks.
    tail: Option<Piece>,
    /// Bytes left of the piece of the file under way.
    left: u64,
    /// Piece made, and the number of its bytes that were read.
    given: (Vec<u8>, usize),
    /// Begin of each piece as read, not yet taken, and of the next one.
    places: Places,
    begin: u64,
}

/// A piece of the file: its begin and length \[bytes\]; or bytes made, and where they stood.
#[derive(Debug, Clone)]
enum Piece {
    File(u64, u64),
    Given(Vec<u8>, u64),
}

/// Where the bytes read stand in the file.
#[derive(Debug, Clone, Default)]
pub(super) struct Places {
    /// Begin of each piece as read and in the file \[bytes\]; true if it stands there as read.
    begins: Vec<(u64, u64, bool)>,
}

impl Places {
    /// Position in the file of a byte read; of messages that were put in order that of a chunk.
    pub fn in_file(&self, read: u64) -> u64 {
        let after = self.begins.partition_point(|(begin, ..)| *begin <= read);
        match after.checked_sub(1).map(|piece| self.begins[piece]) {
            Some((begin, at, true)) => at + (read - begin),
            Some((_, at, false)) => at,
            None => read,
        }
    }
}

impl<R> InOrder<R> {
    /// The file as it is.
    pub fn plain(input: R) -> Self {
        Self {
            input,
            moved: None,
            beyond: None,
        }
    }

    /// True if its pieces are read in another order than they stand.
    pub fn is_moved(&self) -> bool {
        self.moved.is_some()
    }

    /// Takes the places of the pieces read since.
    pub fn places(&mut self, places: &mut Places) {
        if let Some(moved) = &mut self.moved {
            places.begins.append(&mut moved.places.begins);
        }
    }

    /// Takes the clause on messages that cannot be put in order.
    pub fn beyond(&mut self) -> Option<String> {
        self.beyond.take()
    }

    /// Takes the damage that cost no message, of the chunks opened since.
    pub fn take_mended(&mut self) -> Vec<Hole> {
        let moved = self.moved.as_deref_mut();
        moved.map_or_else(Vec::new, |moved| std::mem::take(&mut moved.merge.mended))
    }

    /// Bytes of the messages that are put in order.
    pub fn held(&self) -> usize {
        let held = |moved: &Moved| moved.merge.held() + moved.given.0.capacity();
        self.moved.as_deref().map_or(0, held)
    }
}

impl<R: Read + Seek> InOrder<R> {
    /// A finished file, its messages by time; `sampled`: topics of samples, `None` for all.
    pub fn by_time(mut input: R, sampled: Option<&[String]>) -> io::Result<Self> {
        let ordered = Self::order(&mut input, sampled);
        input.seek(SeekFrom::Start(0))?;
        let (moved, beyond) = match ordered {
            Ok(ordered) => ordered,
            // Shorter than it seems: cut while it was read.
            Err(fault) if fault.kind() == io::ErrorKind::UnexpectedEof => (None, None),
            Err(fault) => return Err(fault),
        };
        Ok(Self {
            input,
            moved: moved.map(Box::new),
            beyond,
        })
    }

    /// Goes on at a position of the file as it is \[bytes\].
    pub fn go_to(&mut self, at: u64) -> io::Result<()> {
        self.input.seek(SeekFrom::Start(at)).map(|_| ())
    }

    fn order(input: &mut R, sampled: Option<&[String]>) -> io::Result<(Option<Moved>, Option<String>)> {
        let Some(layout) = Layout::read(input)?.filter(Layout::is_whole) else {
            return Ok((None, None));
        };
        Ok(match Order::of(&layout, input, sampled)? {
            Order::AsItStands => (None, None),
            Order::Beyond(channel, time) => {
                let time = Timestamp::from_nanos(i64::try_from(time).unwrap_or(i64::MAX));
                let what = format!(
                    "{} at {time}: what was logged then is spread over more than {} MB of messages out of order; they are read as they stand, records end \
                     where a time goes back: put the file in order first (`mcap sort`)",
                    layout.topic(channel),
                    WINDOW >> 20
                );
                (None, Some(what))
            }
            Order::ByTime(kept) => (Moved::new(&layout, Merge::new(&layout, kept)), None),
        })
    }
}

impl Moved {
    fn new(layout: &Layout, merge: Merge) -> Option<Self> {
        let (first, last) = (layout.chunks.first()?, layout.chunks.last()?);
        Some(Self {
            // The chunk that defines a channel may come after one that uses it.
            pieces: VecDeque::from([
                Piece::File(0, first.at),
                Piece::Given(chunk_of(&layout.definitions, true), first.at),
            ]),
            merge,
            tail: Some(Piece::File(last.end, layout.size.checked_sub(last.end)?)),
            left: 0,
            given: Default::default(),
            places: Places::default(),
            begin: 0,
        })
    }

    /// Begins the next piece; false at the end.
    fn go_on(&mut self, input: &mut (impl Read + Seek)) -> io::Result<bool> {
        if self.pieces.is_empty() {
            self.given = Default::default();
            self.pieces.extend(self.merge.next(input)?);
        }
        let Some(piece) = self.pieces.pop_front().or_else(|| self.tail.take()) else {
            return Ok(false);
        };
        let (at, length, stands_there) = match piece {
            Piece::File(at, length) => {
                input.seek(SeekFrom::Start(at))?;
                self.left = length;
                (at, length, true)
            }
            Piece::Given(bytes, at) => {
                let length = bytes.len() as u64;
                self.given = (bytes, 0);
                (at, length, false)
            }
        };
        self.places.begins.push((self.begin, at, stands_there));
        self.begin += length;
        Ok(true)
    }
}

impl<R: Read + Seek> Read for InOrder<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let Some(moved) = &mut self.moved else {
            return self.input.read(buffer);
        };
        loop {
            let (bytes, from) = &mut moved.given;
            let left = bytes.get(*from..).unwrap_or_default();
            if !left.is_empty() {
                let count = left.len().min(buffer.len());
                buffer[..count].copy_from_slice(&left[..count]);
                *from += count;
                return Ok(count);
            }
            if moved.left > 0 {
                // Bounded by the buffer.
                let wanted = moved.left.min(buffer.len() as u64) as usize;
                let count = self.input.read(&mut buffer[..wanted])?;
                moved.left -= count as u64;
                return Ok(count);
            }
            if !moved.go_on(&mut self.input)? {
                return Ok(0);
            }
        }
    }
}

/// A chunk of the given records, not compressed.
fn chunk_of(records: &[u8], has_checksum: bool) -> Vec<u8> {
    let size = records.len() as u64;
    let checksum = if has_checksum { crc32fast::hash(records) } else { 0 };
    let mut bytes = Vec::with_capacity(64 + records.len());
    bytes.push(op::CHUNK);
    bytes.extend((8 + 8 + 8 + 4 + 4 + 8 + size).to_le_bytes());
    bytes.extend([0; 16]);
    bytes.extend(size.to_le_bytes());
    bytes.extend(checksum.to_le_bytes());
    bytes.extend(0u32.to_le_bytes());
    bytes.extend(size.to_le_bytes());
    bytes.extend(records);
    bytes
}
