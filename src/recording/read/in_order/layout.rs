//! Chunks and definitions of a finished file by its summary.

use super::super::chunk::MAX_CHUNK;
use super::super::mcap::MAX_RECORD;
use super::super::verify;
use super::super::wire::Fields;
use mcap::records::op;
use std::collections::BTreeSet;
use std::io::{self, Read, Seek, SeekFrom};

/// Largest summary looked through \[bytes\].
const MAX_SUMMARY: u64 = 16 << 20;

/// A chunk as the summary describes it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    /// Place among the chunks of the file.
    pub number: u32,
    /// Begin in the file \[bytes\].
    pub at: u64,
    /// Length of its record, and of the indices behind it \[bytes\].
    pub record: u64,
    pub index: u64,
    /// Begin of the next chunk, or end of the last one's indices: attachments stand between.
    pub end: u64,
    /// Log time of its earliest message \[ns\].
    pub from_ns: u64,
    /// Uncompressed \[bytes\].
    pub size: u64,
}

/// Chunks and definitions of a file.
pub(super) struct Layout {
    /// In the order of the file.
    pub chunks: Vec<Chunk>,
    /// Records of schemas and channels, as they stand in the summary.
    pub definitions: Vec<u8>,
    /// Size of the file \[bytes\].
    pub size: u64,
}

impl Layout {
    /// Reads the summary; `None` without one, or if something in it is odd.
    pub fn read(input: &mut (impl Read + Seek)) -> io::Result<Option<Self>> {
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
        Ok(Self::parse(&bytes, summary_at, size).ok().flatten())
    }

    fn parse(bytes: &[u8], summary_at: u64, size: u64) -> Result<Option<Self>, &'static str> {
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
        // One after another in the file.
        let mut limit = summary_at;
        for (number, chunk) in chunks.iter_mut().enumerate().rev() {
            let own = chunk.record.checked_add(chunk.index);
            let end = own.and_then(|own| chunk.at.checked_add(own));
            let Some(end) = end.filter(|end| *end <= limit && chunk.at >= 8) else {
                return Ok(None);
            };
            chunk.number = u32::try_from(number).map_err(|_| "more chunks than any file has")?;
            chunk.end = if limit == summary_at { end } else { limit };
            limit = chunk.at;
        }
        let is_usable = !chunks.is_empty() && !definitions.is_empty();
        Ok(is_usable.then_some(Self {
            chunks,
            definitions,
            size,
        }))
    }

    /// Channels of some topics.
    pub fn channels(&self, topics: &[String]) -> BTreeSet<u16> {
        let is_meant = |(_, topic): &(u16, &str)| topics.iter().any(|meant| meant == topic);
        self.named().filter(is_meant).map(|(id, _)| id).collect()
    }

    /// Topic of a channel.
    pub fn topic(&self, channel: u16) -> String {
        let found = self.named().find(|(id, _)| *id == channel);
        found.map_or_else(|| format!("channel {channel}"), |(_, topic)| topic.to_owned())
    }

    /// Channels with their topics.
    fn named(&self) -> impl Iterator<Item = (u16, &str)> {
        let mut records = Fields(&self.definitions);
        let all = std::iter::from_fn(move || records.record().ok()?);
        let channels = all.filter(|(opcode, _)| *opcode == op::CHANNEL);
        channels.filter_map(|(_, mut fields)| {
            let (id, _schema) = (fields.u16().ok()?, fields.u16().ok()?);
            Some((id, fields.text().ok()?))
        })
    }
}

impl Chunk {
    fn parse(mut fields: Fields<'_>) -> Result<Self, &'static str> {
        let (from_ns, _to_ns) = (fields.u64()?, fields.u64()?);
        let (at, record) = (fields.u64()?, fields.u64()?);
        let length = fields.u32()?;
        if fields.bytes(u64::from(length))?.is_empty() {
            return Err("a chunk that does not name its channels");
        }
        let index = fields.u64()?;
        let (_compression, _compressed_size) = (fields.text()?, fields.u64()?);
        let size = fields.u64()?;
        if record > MAX_RECORD as u64 || index > MAX_CHUNK || size > MAX_CHUNK {
            return Err("a chunk larger than those that are read");
        }
        Ok(Self {
            number: 0,
            at,
            record,
            index,
            end: 0,
            from_ns,
            size,
        })
    }
}
