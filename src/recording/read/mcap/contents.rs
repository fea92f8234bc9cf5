//! Records of one file, checked before any of them is handed out: definitions, chunks, messages, and their limits.

use super::{ChannelInfo, Damage, Item, Message, Progress};
use crate::read::chunk::{BadChunk, ChunkReader, MAX_CHUNK};
use crate::read::decode::SchemaRef;
use crate::read::hole::Hole;
use crate::read::verify::Trust;
use crate::read::wire::Fields;
use mcap::records::op;
use std::collections::HashMap;

/// Most bytes of schemas and channels held.
const MAX_HELD: usize = 16 << 20;

/// Bytes of a chunk's records handed out in one step: their results are taken before more follow.
const HANDED_OUT: usize = 256 << 10;

#[derive(Debug, Clone, PartialEq, Eq)]
struct Schema {
    name: String,
    encoding: String,
    data: Vec<u8>,
}

/// State of reading a file, up to the record under way.
pub(super) struct Contents {
    trust: Trust,
    pub chunk: ChunkReader,
    /// A chunk not yet handed out to its end.
    pub under_way: Option<UnderWay>,
    /// True if a damaged chunk is skipped.
    pub passes_holes: bool,
    /// True if the length of every chunk is right, whatever is in it.
    pub is_framed: bool,
    /// True if the summary tells where the chunks stand and the indices behind them.
    pub is_known: bool,
    /// True if what ended the reading can be left out: it could not be read, but contradicts nothing that was.
    pub is_passable: bool,
    /// True if a chunk was read.
    has_chunk: bool,
    /// A hole not reported yet: the indices after it may name its channels.
    pub hole: Option<Hole>,
    pub holes: usize,
    schemas: HashMap<u16, Schema>,
    channels: HashMap<u16, ChannelInfo>,
    /// Known channel ids, looked up for every message.
    known: Vec<bool>,
    pub offset: u64,
    pub previous: u8,
    pub data_ended: bool,
    pub messages: u64,
    /// Number of messages by the file's own count.
    counted: Option<u64>,
    unverified: bool,
    /// Bytes of schemas and channels held.
    pub held: usize,
    pub max_held: usize,
    pub max_chunk: u64,
}

/// Position in a chunk.
#[derive(Clone, Copy)]
pub(super) struct UnderWay {
    /// Begin of the next of its records \[bytes\].
    at: usize,
    /// Size of the chunk in the file \[bytes\].
    pub bytes: u64,
}

impl Contents {
    /// Nothing read yet. `passes_holes`: damaged chunks are skipped.
    pub fn new(trust: Trust, passes_holes: bool) -> Self {
        Self {
            trust,
            chunk: ChunkReader::default(),
            under_way: None,
            passes_holes,
            is_framed: false,
            is_known: false,
            is_passable: false,
            has_chunk: false,
            hole: None,
            holes: 0,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            known: vec![false; 1 << 16],
            offset: 8,
            previous: 0,
            data_ended: false,
            messages: 0,
            counted: None,
            unverified: false,
            held: 0,
            max_held: MAX_HELD,
            max_chunk: MAX_CHUNK,
        }
    }

    /// Result by the file's end: complete or not.
    pub fn end(&self) -> Result<Progress, Damage> {
        match self.counted {
            Some(counted) if counted != self.messages && self.holes == 0 => Err(Damage {
                offset: self.offset,
                what: format!(
                    "the file counts {counted} messages in itself, but holds {}",
                    self.messages
                ),
            }),
            _ => Ok(Progress::Complete),
        }
    }

    /// Notes the kind of the next record and returns that of the one before.
    fn next_is(&mut self, opcode: u8) -> Result<u8, String> {
        let previous = std::mem::replace(&mut self.previous, opcode);
        if previous == 0 && opcode != op::HEADER {
            return Err(self.passable("the first record is not a header".to_owned()));
        }
        Ok(previous)
    }

    /// Handles a record of the file other than a chunk.
    pub fn record(&mut self, opcode: u8, data: &[u8], each: &mut dyn FnMut(Item<'_>)) -> Result<(), String> {
        let previous = self.next_is(opcode)?;
        let loose = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE);
        if loose && !self.data_ended {
            match self.trust {
                Trust::Verified => {}
                Trust::Unverified => self.unverified(each),
                Trust::Damaged => {
                    let what = "the checksum of the data is wrong, and this is not in a checked chunk";
                    return Err(self.passable(what.to_owned()));
                }
            }
        }
        match opcode {
            op::HEADER if previous != 0 => Err(self.passable("a second header".to_owned())),
            op::SCHEMA => self.schema(Fields(data)).map_err(str::to_owned),
            op::CHANNEL => self.channel(Fields(data), each).map_err(str::to_owned),
            op::MESSAGE if self.data_ended => Err("a message behind the end of the data".to_owned()),
            op::MESSAGE => {
                let message = self.message(Fields(data))?;
                self.messages += 1;
                each(Item::Message(message));
                Ok(())
            }
            op::DATA_END => {
                self.data_ended = true;
                Ok(())
            }
            op::STATISTICS => {
                self.counted = Some(Fields(data).u64()?);
                Ok(())
            }
            op::MESSAGE_INDEX => match self.message_index(previous, Fields(data)) {
                Err(what) if self.is_known => Err(self.passable(what)),
                Err(what) => self.lose(what, None),
                Ok(()) => Ok(()),
            },
            op::HEADER | op::FOOTER | op::ATTACHMENT | op::METADATA => Ok(()),
            op::CHUNK_INDEX | op::ATTACHMENT_INDEX | op::METADATA_INDEX | op::SUMMARY_OFFSET
                if self.data_ended =>
            {
                Ok(())
            }
            _ if self.trust == Trust::Verified || self.data_ended => Ok(()),
            // Extensions of others; but in a damaged file this may have been a chunk.
            0x80.. if self.trust == Trust::Unverified => Ok(()),
            // No record has this kind: a blank end, after a power cut.
            0 => Err(self.passable("a record of unknown kind 0x00".to_owned())),
            // It may have been a chunk.
            other => self.lose(format!("a record of unknown kind {other:#04x}"), None),
        }
    }

    pub fn unverified(&mut self, each: &mut dyn FnMut(Item<'_>)) {
        if !std::mem::replace(&mut self.unverified, true) {
            each(Item::Unverified);
        }
    }

    /// Checks an index record: it is not needed, but an odd one may be a damaged chunk. After a hole it names
    /// the channels of the messages lost.
    fn message_index(&mut self, previous: u8, mut fields: Fields<'_>) -> Result<(), String> {
        if self.trust == Trust::Verified && self.hole.is_none() {
            return Ok(());
        }
        let channel = fields.u16()?;
        let length = fields.u32()?;
        let entries = fields.bytes(u64::from(length))?;
        let sound = matches!(previous, op::CHUNK | op::MESSAGE_INDEX)
            && (self.known[usize::from(channel)] || self.hole.is_some())
            && fields.0.is_empty()
            && entries.len() % 16 == 0;
        if !sound {
            return Err("an index that belongs to no chunk".to_owned());
        }
        if let Some(hole) = &mut self.hole {
            hole.channels.insert(channel);
        }
        Ok(())
    }

    /// Reads and checks a chunk of `bytes` bytes in the file.
    pub fn begin_chunk(
        &mut self,
        bytes: u64,
        data: &[u8],
        each: &mut dyn FnMut(Item<'_>),
    ) -> Result<(), String> {
        self.next_is(op::CHUNK)?;
        if self.data_ended {
            return Err("a chunk behind the end of the data".to_owned());
        }
        // Taken out while its buffer is borrowed.
        let mut reader = std::mem::take(&mut self.chunk);
        let outcome = match reader.read(data, self.max_chunk) {
            Ok(is_checked) => {
                self.has_chunk = true;
                self.look_through(is_checked, &reader, each).map(|()| true)
            }
            Err(BadChunk::Broken(what)) if self.is_framed => self.lose(what, None).map(|()| false),
            Err(BadChunk::Foreign { what, from, to }) if self.has_chunk && !self.is_known => {
                self.lose(what, Some((from, to))).map(|()| false)
            }
            Err(BadChunk::Broken(what) | BadChunk::Foreign { what, .. }) => Err(self.passable(what)),
            Err(BadChunk::Spoilt { what, from, to }) => self.lose(what, Some((from, to))).map(|()| false),
        };
        self.chunk = reader;
        match outcome? {
            true => self.hand_out(UnderWay { at: 0, bytes }, each),
            false => {
                self.chunk.release(true);
                Ok(())
            }
        }
    }

    /// Checks the whole chunk before any of its messages is handed out.
    fn look_through(
        &mut self,
        is_checked: bool,
        reader: &ChunkReader,
        each: &mut dyn FnMut(Item<'_>),
    ) -> Result<(), String> {
        match (is_checked, self.trust) {
            (true, _) | (false, Trust::Verified) => {}
            (false, Trust::Unverified) => self.unverified(each),
            (false, Trust::Damaged) => {
                return Err("the checksum of the data is wrong, and this chunk has none".to_owned());
            }
        }
        let mut records = Fields(reader.records());
        while let Some((opcode, fields)) = records.record()? {
            match opcode {
                op::SCHEMA => self.schema(fields)?,
                op::CHANNEL => self.channel(fields, each)?,
                op::MESSAGE => {
                    self.message(fields)?;
                }
                op::CHUNK => return Err("a chunk in a chunk".to_owned()),
                0x80.. => {}
                other => return Err(format!("a record of kind {other:#04x} in a chunk")),
            }
        }
        Ok(())
    }

    /// Hands out more of the current chunk.
    pub fn hand_out(
        &mut self,
        UnderWay { at, bytes }: UnderWay,
        each: &mut dyn FnMut(Item<'_>),
    ) -> Result<(), String> {
        let reader = std::mem::take(&mut self.chunk);
        let whole = reader.records();
        let mut records = Fields(whole.get(at..).unwrap_or_default());
        let until = records.0.len().saturating_sub(HANDED_OUT);
        let mut outcome = Ok(());
        while records.0.len() > until {
            match records.record() {
                Ok(Some((op::MESSAGE, fields))) => match self.message(fields) {
                    Ok(message) => {
                        self.messages += 1;
                        each(Item::Message(message));
                    }
                    Err(what) => outcome = Err(what.to_owned()),
                },
                Ok(Some(_)) => {}
                Ok(None) => break,
                Err(what) => outcome = Err(what.to_owned()),
            }
            if outcome.is_err() {
                break;
            }
        }
        let is_over = records.0.is_empty() || outcome.is_err();
        self.under_way = (!is_over).then_some(UnderWay {
            at: whole.len() - records.0.len(),
            bytes,
        });
        self.chunk = reader;
        if is_over {
            // Of many streams at once none keeps a buffer.
            self.chunk.release(self.max_chunk >= MAX_CHUNK);
        }
        outcome
    }

    pub fn schema(&mut self, mut fields: Fields<'_>) -> Result<(), &'static str> {
        let id = fields.u16()?;
        let name = fields.text()?;
        let encoding = fields.text()?;
        let length = fields.u32()?;
        let data = fields.bytes(u64::from(length))?;
        match self.schemas.get(&id) {
            _ if id == 0 => Err("a schema with id 0"),
            Some(known) if known.name == name && known.encoding == encoding && known.data == data => Ok(()),
            Some(_) => Err("a schema changes under its id"),
            None => {
                self.hold(name.len() + encoding.len() + data.len())?;
                let schema = Schema {
                    name: name.to_owned(),
                    encoding: encoding.to_owned(),
                    data: data.to_vec(),
                };
                self.schemas.insert(id, schema);
                Ok(())
            }
        }
    }

    /// Adds a kept definition to the bytes held.
    fn hold(&mut self, bytes: usize) -> Result<(), &'static str> {
        self.held += bytes;
        if self.held > self.max_held {
            return Err("more schemas and channels than any recorder writes");
        }
        Ok(())
    }

    pub fn channel(
        &mut self,
        mut fields: Fields<'_>,
        each: &mut dyn FnMut(Item<'_>),
    ) -> Result<(), &'static str> {
        let length = fields.0.len();
        let id = fields.u16()?;
        let schema = fields.u16()?;
        let owned = |text: &str| text.to_owned();
        let channel = ChannelInfo {
            topic: owned(fields.text()?),
            encoding: owned(fields.text()?),
            schema,
            metadata: fields
                .map()?
                .into_iter()
                .map(|(key, value)| (owned(key), owned(value)))
                .collect(),
        };
        match self.channels.get(&id) {
            Some(known) if *known == channel => return Ok(()),
            Some(_) => return Err("a channel changes under its id"),
            // Maps of many short texts take several times their bytes.
            None => self.hold(8 * length)?,
        }
        let schema = match self.schemas.get(&schema) {
            Some(known) => Some(SchemaRef {
                name: &known.name,
                encoding: &known.encoding,
                data: &known.data,
            }),
            None if schema == 0 => None,
            None => return Err("a channel before its schema"),
        };
        each(Item::Channel(id, &channel, schema));
        self.channels.insert(id, channel);
        self.known[usize::from(id)] = true;
        Ok(())
    }

    fn message<'a>(&self, mut fields: Fields<'a>) -> Result<Message<'a>, &'static str> {
        let channel = fields.u16()?;
        let _sequence = fields.u32()?;
        if !self.known[usize::from(channel)] {
            return Err("a message before its channel");
        }
        Ok(Message {
            channel,
            log_time: fields.u64()?,
            publish_time: fields.u64()?,
            data: fields.0,
        })
    }
}
