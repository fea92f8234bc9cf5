//! The messages of chunks that overlap in time, as chunks in the order of their times.

use super::super::chunk::{ChunkReader, MAX_CHUNK};
use super::super::hole::Hole;
use super::super::known::HEAD;
use super::super::layout::{Chunk, Layout};
use super::super::wire::Fields;
use super::even::Kept;
use super::index::sorted;
use super::window::{Entry, Window};
use super::{Piece, chunk_of};
use mcap::records::op;
use std::collections::{BTreeMap, VecDeque};
use std::io::{self, Read, Seek, SeekFrom};
use std::iter::Peekable;
use std::vec::IntoIter;

/// Bytes of messages in a chunk that is made, about.
const MADE: usize = 256 << 10;

/// Chunks of a file, and what is read of those that overlap.
pub(super) struct Merge {
    /// By time.
    chunks: Peekable<IntoIter<Chunk>>,
    kept: Kept,
    open: BTreeMap<u32, Open>,
    window: Window,
    /// Messages whose turn it is.
    ready: VecDeque<Entry>,
    /// Definitions in the chunks opened since the last one was made.
    definitions: Vec<u8>,
    reader: ChunkReader,
    /// Damage of the chunks opened that cost no message.
    pub mended: Vec<Hole>,
}

/// A chunk whose messages are not all passed on.
struct Open {
    records: Vec<u8>,
    left: usize,
    is_checked: bool,
    at: u64,
}

impl Merge {
    pub fn new(layout: &Layout, kept: Kept) -> Self {
        Self {
            chunks: sorted(&layout.chunks).into_iter().peekable(),
            kept,
            open: BTreeMap::new(),
            window: Window::default(),
            ready: VecDeque::new(),
            definitions: Vec::new(),
            reader: ChunkReader::default(),
            mended: Vec::new(),
        }
    }

    /// Bytes of the chunks that are open.
    pub fn held(&self) -> usize {
        self.open.values().map(|open| open.records.capacity()).sum()
    }

    /// The next pieces: a chunk made of messages in order, or what cannot be used as it stands; empty at the end.
    pub fn next(&mut self, input: &mut (impl Read + Seek)) -> io::Result<Vec<Piece>> {
        while self.ready.is_empty() {
            let Some(chunk) = self.chunks.next() else {
                break;
            };
            let pieces = self.open(chunk, input)?;
            let next = self.chunks.peek().map(|next| next.from_ns);
            self.ready.extend(self.window.settled(next));
            if !pieces.is_empty() {
                return Ok(pieces);
            }
        }
        // Definitions of a last chunk without messages are in the summary too.
        Ok(self.made().into_iter().collect())
    }

    /// Reads a chunk; returns what stands behind it, or the chunk itself if it is damaged: the reader says why.
    fn open(&mut self, chunk: Chunk, input: &mut (impl Read + Seek)) -> io::Result<Vec<Piece>> {
        // Bounded by the layout.
        let mut record = vec![0; chunk.record as usize];
        input.seek(SeekFrom::Start(chunk.at))?;
        input.read_exact(&mut record)?;
        let as_it_stands = |from: u64| (chunk.end > from).then(|| Piece::File(from, chunk.end - from));
        let head = chunk.head();
        let (own, content) = record.split_at_checked(head.len()).unwrap_or_default();
        // The head is the summary's: it says where the chunk ends.
        let whole = || {
            let head = Piece::Given(head.to_vec(), chunk.at);
            std::iter::once(head).chain(as_it_stands(chunk.at + 9)).collect()
        };
        let Ok(is_checked) = self.reader.read(content, MAX_CHUNK) else {
            return Ok(whole());
        };
        if own != head {
            self.mended.push(Hole::without_loss(chunk.at, HEAD.to_owned()));
        }
        drop(record);
        let records = self.reader.take();
        let Ok(Some((entries, definitions))) = look_through(chunk.number, &records) else {
            return Ok(whole());
        };
        self.definitions.extend(definitions);
        if !entries.is_empty() {
            let open = Open {
                records,
                left: entries.len(),
                is_checked,
                at: chunk.at,
            };
            self.open.insert(chunk.number, open);
        }
        let kept = &mut self.kept;
        self.window.add(entries.into_iter().map(|entry| Entry {
            time: kept.time(entry.channel, entry.time),
            ..entry
        }));
        Ok(as_it_stands(chunk.at + chunk.record + chunk.index)
            .into_iter()
            .collect())
    }

    /// A chunk of the messages whose turn it is.
    fn made(&mut self) -> Option<Piece> {
        let first = self.ready.front()?;
        let at = self.open.get(&first.chunk).map_or(0, |open| open.at);
        let mut records = std::mem::take(&mut self.definitions);
        let mut is_checked = true;
        while records.len() < MADE
            && let Some(entry) = self.ready.pop_front()
        {
            let Some(open) = self.open.get_mut(&entry.chunk) else {
                continue;
            };
            let from = open.records.get(entry.offset as usize..).unwrap_or_default();
            let mut rest = Fields(from);
            if matches!(rest.record(), Ok(Some(_))) {
                records.extend_from_slice(&from[..from.len() - rest.0.len()]);
            }
            is_checked &= open.is_checked;
            open.left -= 1;
            if open.left == 0 {
                self.open.remove(&entry.chunk);
            }
        }
        Some(Piece::Given(chunk_of(&records, is_checked), at))
    }
}

/// Messages of a chunk, and its definitions as they stand.
type Content = (Vec<Entry>, Vec<u8>);

/// Looks through the records of a chunk; `None` if something else is in it.
fn look_through(number: u32, records: &[u8]) -> Result<Option<Content>, &'static str> {
    let (mut entries, mut definitions) = (Vec::new(), Vec::new());
    let mut rest = Fields(records);
    loop {
        let offset = records.len() - rest.0.len();
        let Some((opcode, mut fields)) = rest.record()? else {
            return Ok(Some((entries, definitions)));
        };
        match opcode {
            op::MESSAGE => {
                let (channel, _sequence) = (fields.u16()?, fields.u32()?);
                let (time, _publish) = (fields.u64()?, fields.u64()?);
                entries.push(Entry {
                    time,
                    chunk: number,
                    // Bounded by the largest chunk.
                    offset: offset as u32,
                    channel,
                });
            }
            op::SCHEMA | op::CHANNEL => {
                definitions.extend_from_slice(&records[offset..records.len() - rest.0.len()]);
            }
            0x80.. => {}
            _ => return Ok(None),
        }
    }
}
