//! Chunks and definitions of a finished file by its summary.

use super::chunk::{MAX_CHUNK, READABLE};
use super::mcap::MAX_RECORD;
use super::verify::{self, Ends};
use super::wire::Fields;
use mcap::records::op;
use std::collections::BTreeSet;
use std::io::{self, Read, Seek, SeekFrom};

/// Largest summary looked through \[bytes\].
const MAX_SUMMARY: u64 = 16 << 20;

/// A chunk as the summary describes it.
#[derive(Debug, Clone)]
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
    /// Log times of its earliest and its latest message \[ns\].
    pub from_ns: u64,
    pub to_ns: u64,
    /// Channels of its messages, as far as indices stand behind it.
    pub channels: Vec<u16>,
    /// True if its compression is one of those that are read.
    pub is_readable: bool,
    /// Uncompressed \[bytes\].
    pub size: u64,
}

/// Chunks and definitions of a file.
pub(super) struct Layout {
    /// In the order of the file.
    pub chunks: Vec<Chunk>,
    /// Records of schemas and channels, as they stand in the summary.
    pub definitions: Vec<u8>,
    /// Begin of the record that ends the data \[bytes\].
    pub data_end: u64,
    /// True if the summary has a checksum, and it is right; `false` without one.
    pub is_checked: bool,
    /// Size of the file \[bytes\].
    pub size: u64,
}

impl Layout {
    /// Reads the summary; `None` without one, or if something in it is odd.
    pub fn read(input: &mut (impl Read + Seek)) -> io::Result<Option<Self>> {
        let size = input.seek(SeekFrom::End(0))?;
        let Some(ends) = verify::ends(input)? else {
            return Ok(None);
        };
        let length = ends.footer_at - ends.summary_at;
        if length == 0 || length > MAX_SUMMARY {
            return Ok(None);
        }
        input.seek(SeekFrom::Start(ends.summary_at))?;
        let mut bytes = vec![0; length as usize];
        input.read_exact(&mut bytes)?;
        Ok(Self::parse(&bytes, &ends, size).ok().flatten())
    }

    fn parse(bytes: &[u8], ends: &Ends, size: u64) -> Result<Option<Self>, &'static str> {
        let Some(data_end) = ends.summary_at.checked_sub(verify::DATA_END) else {
            return Ok(None);
        };
        let is_checked = match ends.checksum_of(bytes) {
            Some((saved, found)) if saved != found => return Ok(None),
            saved => saved.is_some(),
        };
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
        let mut limit = data_end;
        for (number, chunk) in chunks.iter_mut().enumerate().rev() {
            let own = chunk.record.checked_add(chunk.index);
            let end = own.and_then(|own| chunk.at.checked_add(own));
            let Some(end) = end.filter(|end| *end <= limit && chunk.at >= 8 && chunk.record >= 9) else {
                return Ok(None);
            };
            chunk.number = u32::try_from(number).map_err(|_| "more chunks than any file has")?;
            chunk.end = if limit == data_end { end } else { limit };
            limit = chunk.at;
        }
        Ok((!chunks.is_empty()).then_some(Self {
            chunks,
            definitions,
            data_end,
            is_checked,
            size,
        }))
    }

    /// True if it tells enough to put messages in order.
    pub fn is_whole(&self) -> bool {
        let is_told = |chunk: &Chunk| chunk.is_readable && !chunk.channels.is_empty();
        !self.definitions.is_empty() && self.chunks.iter().all(is_told)
    }

    /// Channels of some topics, or of all.
    pub fn channels(&self, topics: Option<&[String]>) -> BTreeSet<u16> {
        let is_meant =
            |(_, topic): &(u16, &str)| topics.is_none_or(|topics| topics.iter().any(|meant| meant == topic));
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
    /// Opcode and length of its record.
    pub fn head(&self) -> [u8; 9] {
        let mut head = [op::CHUNK; 9];
        // A record is no shorter than its head.
        head[1..].copy_from_slice(&self.record.saturating_sub(9).to_le_bytes());
        head
    }

    fn parse(mut fields: Fields<'_>) -> Result<Self, &'static str> {
        let (from_ns, to_ns) = (fields.u64()?, fields.u64()?);
        let (at, record) = (fields.u64()?, fields.u64()?);
        let length = fields.u32()?;
        let mut places = Fields(fields.bytes(u64::from(length))?);
        let mut channels = Vec::new();
        while !places.0.is_empty() {
            let (channel, _at) = (places.u16()?, places.u64()?);
            channels.push(channel);
        }
        let index = fields.u64()?;
        let (compression, _compressed_size) = (fields.text()?, fields.u64()?);
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
            to_ns,
            channels,
            is_readable: READABLE.contains(&compression),
            size,
        })
    }
}
