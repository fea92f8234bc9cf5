//! The order in which a file's messages stand, by the indices behind its chunks.

use super::super::layout::{Chunk, Layout};
use super::super::wire::Fields;
use super::even::{Even, Kept};
use super::window::{Entry, WEIGHT, Window};
use mcap::records::op;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read, Seek, SeekFrom};

/// Most bytes of messages that are put in order at once, chunks that overlap in time.
pub(super) const WINDOW: usize = 32 << 20;

/// Order in which a file is read.
pub(super) enum Order {
    /// It is in order, or no other order is certain.
    AsItStands,
    /// Its messages are out of order by more than the window; channel and log time of the first that is \[ns\].
    Beyond(u16, u64),
    /// By time, but for what keeps its order.
    ByTime(Kept),
}

impl Order {
    /// Looks through the indices of a file; `sampled`: topics of samples, `None` for all.
    pub fn of(
        layout: &Layout,
        input: &mut (impl Read + Seek),
        sampled: Option<&[String]>,
    ) -> io::Result<Self> {
        let mut bytes = Vec::new();
        let mut latest = 0;
        let mut is_in_order = true;
        for chunk in &layout.chunks {
            let Some(entries) = entries(chunk, input, &mut bytes)? else {
                return Ok(Self::AsItStands);
            };
            is_in_order = entries.iter().all(|entry| {
                let before = std::mem::replace(&mut latest, entry.time);
                before <= entry.time
            });
            if !is_in_order {
                break;
            }
        }
        match is_in_order {
            true => Ok(Self::AsItStands),
            false => Self::by_time(layout, input, &layout.channels(sampled)),
        }
    }

    fn by_time(layout: &Layout, input: &mut (impl Read + Seek), sampled: &BTreeSet<u16>) -> io::Result<Self> {
        let begins: Vec<u64> = layout.chunks.iter().map(|chunk| chunk.from_ns).collect();
        let mut even = Even::new(&begins, sampled);
        let (mut bytes, mut window, mut latest) = (Vec::new(), Window::default(), 0);
        // Messages left of each open chunk, and its size.
        let mut open: BTreeMap<u32, (usize, u64)> = BTreeMap::new();
        let chunks = sorted(&layout.chunks);
        let nexts = chunks.iter().skip(1).map(|chunk| Some(chunk.from_ns));
        for (chunk, next) in chunks.iter().zip(nexts.chain([None])) {
            let Some(entries) = entries(chunk, input, &mut bytes)?.filter(|found| !found.is_empty()) else {
                return Ok(Self::AsItStands);
            };
            open.insert(chunk.number, (entries.len(), chunk.size));
            window.add(entries);
            let sizes = open.values().map(|(_, size)| size).sum::<u64>();
            if open.len() > 1
                && sizes + (WEIGHT * window.len()) as u64 > WINDOW as u64
                && let Some(Entry { channel, time, .. }) = window.first()
            {
                return Ok(Self::Beyond(*channel, *time));
            }
            for entry in window.settled(next) {
                // A chunk holds what came before its begin: the summary is wrong.
                if entry.time < latest {
                    return Ok(Self::AsItStands);
                }
                latest = entry.time;
                if let Some((left, _)) = open.get_mut(&entry.chunk) {
                    *left -= 1;
                }
                even.push(entry);
            }
            open.retain(|_, (left, _)| *left > 0);
        }
        Ok(even.finish().map_or(Self::AsItStands, Self::ByTime))
    }
}

/// Chunks in the order of their first log times.
pub(super) fn sorted(chunks: &[Chunk]) -> Vec<Chunk> {
    let mut chunks = chunks.to_vec();
    chunks.sort_by_key(|chunk| chunk.from_ns);
    chunks
}

/// Messages of a chunk as they stand in it, by the indices behind it; `None` if these are odd.
fn entries(
    chunk: &Chunk,
    input: &mut (impl Read + Seek),
    bytes: &mut Vec<u8>,
) -> io::Result<Option<Vec<Entry>>> {
    // Bounded by the layout.
    bytes.resize(chunk.index as usize, 0);
    input.seek(SeekFrom::Start(chunk.at + chunk.record))?;
    input.read_exact(bytes)?;
    Ok(parse(chunk.number, bytes).ok().flatten())
}

fn parse(chunk: u32, bytes: &[u8]) -> Result<Option<Vec<Entry>>, &'static str> {
    let mut found = Vec::with_capacity(bytes.len() / 16);
    let mut records = Fields(bytes);
    while let Some((opcode, mut fields)) = records.record()? {
        if opcode != op::MESSAGE_INDEX {
            return Ok(None);
        }
        let channel = fields.u16()?;
        let length = fields.u32()?;
        let mut entries = Fields(fields.bytes(u64::from(length))?);
        while !entries.0.is_empty() {
            let (time, offset) = (entries.u64()?, entries.u64()?);
            found.push(Entry {
                time,
                chunk,
                offset: u32::try_from(offset).map_err(|_| "an offset beyond any chunk")?,
                channel,
            });
        }
    }
    found.sort_by_key(|entry| entry.offset);
    Ok(Some(found))
}
