//! Reads MCAP strictly: everything handed out was checked, or is marked as unchecked.
//!
//! The framing is the `mcap` crate's reader; chunks are decompressed and checked here before anything
//! in them is handed out. Besides broken framing and wrong checksums, these are refused: a message
//! before its channel, a channel or schema that changes under its id, names that are not UTF-8,
//! a chunk in a chunk, messages after the data section, and sizes beyond any recorder's. A chunk of correct
//! length with damaged content is a hole: it is reported, and reading continues after it.

use super::chunk::{BadChunk, ChunkReader, MAX_CHUNK};
use super::decode::SchemaRef;
use super::hole::Hole;
use super::verify::{self, Trust};
use super::wire::Fields;
use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{self, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Largest record accepted, compressed chunks included \[bytes\].
pub const MAX_RECORD: usize = 16 << 20;

/// Largest chunk made of messages that were put in order \[bytes\]: the largest chunk with its definitions.
const MAX_MADE: usize = 33 << 20;

/// Largest uncompressed chunk accepted from a socket \[bytes\]: the largest message with its definitions.
pub const MAX_LIVE_CHUNK: u64 = 12 << 20;

/// Most bytes of schemas and channels held.
const MAX_HELD: usize = 16 << 20;

/// Most bytes of schemas and channels held of a socket's stream.
const MAX_LIVE_HELD: usize = 4 << 20;

/// Bytes of a chunk's records handed out in one step: their results are taken before more follow.
const HANDED_OUT: usize = 256 << 10;

/// Most holes of a file; reading stops beyond.
const MOST_HOLES: usize = 100;

/// Place and kind of damage after which a file cannot be read any further.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// Position in the file \[bytes\].
    pub offset: u64,
    /// Description of the fault.
    pub what: String,
}

/// Result of one step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// There may be more.
    More,
    /// Nothing to read now; the file may grow.
    Wait,
    /// The file ended as it should.
    Complete,
    /// The file ended in the middle.
    Truncated,
}

/// A channel as the file describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChannelInfo {
    /// MCAP topic.
    pub topic: String,
    /// Message encoding, by the MCAP registry.
    pub encoding: String,
    /// The id of its schema, 0 for none; its content does not change within a file.
    pub schema: u16,
    metadata: BTreeMap<String, String>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Schema {
    name: String,
    encoding: String,
    data: Vec<u8>,
}

/// Item read from a file.
#[derive(Debug)]
pub enum Item<'a> {
    /// A channel, before its first message.
    Channel(u16, &'a ChannelInfo, Option<SchemaRef<'a>>),
    /// A message.
    Message(Message<'a>),
    /// The following data could not be checked.
    Unverified,
    /// Data are lost here; what follows is as reliable as what came before.
    Hole(&'a Hole),
}

/// A message with its channel and times.
#[derive(Debug, Clone, Copy)]
pub struct Message<'a> {
    /// Id of its channel.
    pub channel: u16,
    /// Time of recording \[ns since 1970\].
    pub log_time: u64,
    /// Time of sending \[ns since 1970\].
    pub publish_time: u64,
    /// Content of the message.
    pub data: &'a [u8],
}

/// Reads one file from start to end.
pub struct Reader<R> {
    input: R,
    framing: LinearReader,
    contents: Contents,
    /// True if the input may grow.
    live: bool,
    /// Fewest bytes requested of the input at once.
    ahead: usize,
    bytes_read: u64,
}

struct Contents {
    trust: Trust,
    chunk: ChunkReader,
    /// A chunk not yet handed out to its end.
    under_way: Option<UnderWay>,
    /// True if a damaged chunk is skipped.
    passes_holes: bool,
    /// A hole not reported yet: the indices after it may name its channels.
    hole: Option<Hole>,
    holes: usize,
    schemas: HashMap<u16, Schema>,
    channels: HashMap<u16, ChannelInfo>,
    /// Known channel ids, looked up for every message.
    known: Vec<bool>,
    offset: u64,
    previous: u8,
    data_ended: bool,
    messages: u64,
    /// Number of messages by the file's own count.
    counted: Option<u64>,
    unverified: bool,
    /// Bytes of schemas and channels held.
    held: usize,
    max_held: usize,
    max_chunk: u64,
}

/// Position in a chunk.
#[derive(Clone, Copy)]
struct UnderWay {
    /// Begin of the next of its records \[bytes\].
    at: usize,
    /// Size of the chunk in the file \[bytes\].
    bytes: u64,
}

impl Reader<File> {
    /// Opens a finished file; it is first read once for its checksum.
    ///
    /// # Errors
    /// It is no regular file, or cannot be read.
    pub fn open(path: &Path) -> io::Result<Self> {
        // Before it is opened: opening a pipe would wait for its writer.
        if !fs::metadata(path)?.is_file() {
            return Err(io::Error::other("is no regular file"));
        }
        let mut file = File::open(path)?;
        let trust = verify::verify(&mut file)?;
        Ok(Self::new(file, trust, false))
    }
}

impl ChannelInfo {
    /// Value of a channel's metadata under `key`.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.get(key).map(String::as_str)
    }
}

impl<R: Read> Reader<R> {
    /// Starts at the first byte of `input`. With `live`, the end of the input is a pause.
    pub fn new(input: R, trust: Trust, live: bool) -> Self {
        Self::with(input, trust, live, true)
    }

    /// Starts at the first byte of a finished file whose messages come in another order than its checksum was taken in, in chunks that are
    /// not compressed.
    pub(super) fn of_moved(input: R, trust: Trust) -> Self {
        Self::with(input, trust, false, false)
    }

    fn with(input: R, trust: Trust, live: bool, has_checksum: bool) -> Self {
        let most = match has_checksum {
            true => MAX_RECORD,
            false => MAX_MADE,
        };
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_validate_data_section_crc(has_checksum)
            .with_validate_summary_section_crc(true)
            .with_check_finishes_after_end_magic(!live)
            .with_record_length_limit(most);
        Self {
            input,
            framing: LinearReader::new_with_options(options),
            contents: Contents {
                trust,
                chunk: ChunkReader::default(),
                under_way: None,
                passes_holes: !live,
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
            },
            live,
            ahead: 1 << 16,
            bytes_read: 0,
        }
    }

    /// Starts at the first byte of a stream from a socket: waits for missing data, takes smaller chunks and
    /// definitions, and reads no byte past the end.
    pub fn of_stream(input: R) -> Self {
        let mut reader = Self::new(input, Trust::Unverified, true);
        reader.ahead = 1;
        reader.contents.max_held = MAX_LIVE_HELD;
        reader.contents.max_chunk = MAX_LIVE_CHUNK;
        reader
    }

    /// Skips damaged chunks even in a file that is still being written: its writer never goes back.
    pub fn passing_holes(mut self) -> Self {
        self.contents.passes_holes = true;
        self
    }

    /// Reads on, at most to the end of one record or some way into one chunk, and hands out the items read.
    pub fn step(&mut self, each: &mut dyn FnMut(Item<'_>)) -> Result<Progress, Damage> {
        // The framing is not ours: a panic in it ends the file, not the program.
        let offset = self.contents.offset;
        catch_unwind(AssertUnwindSafe(|| self.advance(each))).unwrap_or_else(|_| {
            let what = "the reader gave up".to_owned();
            Err(Damage { offset, what })
        })
    }

    fn advance(&mut self, each: &mut dyn FnMut(Item<'_>)) -> Result<Progress, Damage> {
        let Self {
            input,
            framing,
            contents,
            live,
            ahead,
            bytes_read,
        } = self;
        let offset = contents.offset;
        let damage = |what: String| Damage { offset, what };
        if let Some(under_way) = contents.under_way {
            contents.hand_out(under_way, each).map_err(damage)?;
            if contents.under_way.is_none() {
                contents.offset += under_way.bytes;
            }
            return Ok(Progress::More);
        }
        let mut wanted = 0;
        let event = framing.next_event();
        let is_index = matches!(
            event,
            Some(Ok(LinearReadEvent::ReadRequest(_)
                | LinearReadEvent::Record {
                    opcode: op::MESSAGE_INDEX,
                    ..
                }))
        );
        if !is_index && let Some(hole) = contents.hole.take() {
            each(Item::Hole(&hole));
        }
        match event {
            None => return contents.end(),
            Some(Err(McapError::UnexpectedEof)) => return Ok(Progress::Truncated),
            // The checksum differs because of the holes, which are already reported.
            Some(Err(McapError::BadDataCrc { .. })) if contents.holes > 0 => return Ok(Progress::Complete),
            Some(Err(fault)) => return Err(damage(sentence(&fault))),
            Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                let bytes = 9 + data.len() as u64;
                match opcode {
                    op::CHUNK => contents.begin_chunk(bytes, data, each).map_err(damage)?,
                    _ => contents.record(opcode, data, each).map_err(damage)?,
                }
                if contents.under_way.is_none() {
                    contents.offset += bytes;
                }
            }
            Some(Ok(LinearReadEvent::ReadRequest(count))) => wanted = count,
        }
        if wanted > 0 {
            let buffer = framing.insert(wanted.max(*ahead).min(1 << 20));
            let count = match input.read(buffer) {
                Ok(0) if *live => return Ok(Progress::Wait),
                Ok(count) => count,
                Err(fault) if fault.kind() == std::io::ErrorKind::Interrupted => return Ok(Progress::More),
                Err(fault) => return Err(damage(format!("the file cannot be read: {fault}"))),
            };
            framing.notify_read(count);
            *bytes_read += count as u64;
        }
        Ok(Progress::More)
    }

    /// Number of bytes read so far.
    pub fn bytes_read(&self) -> u64 {
        self.bytes_read
    }

    /// Position of the record or chunk with which the next step continues \[bytes\].
    pub fn offset(&self) -> u64 {
        self.contents.offset
    }

    /// Input of the reader.
    pub fn input(&self) -> &R {
        &self.input
    }

    /// Input of the reader.
    pub fn input_mut(&mut self) -> &mut R {
        &mut self.input
    }

    /// Returns the input, with the part not yet read.
    pub fn into_input(self) -> R {
        self.input
    }

    /// Bytes in memory: an incomplete record, and the definitions.
    pub fn held(&self) -> usize {
        let pending = self.bytes_read.saturating_sub(self.contents.offset);
        pending as usize + self.contents.held + self.contents.chunk.held()
    }

    /// Number of messages handed out so far.
    pub fn messages(&self) -> u64 {
        self.contents.messages
    }

    /// True if the end of the data was reached (a summary may follow).
    pub fn data_ended(&self) -> bool {
        self.contents.data_ended
    }
}

impl Contents {
    /// Result by the file's end: complete or not.
    fn end(&self) -> Result<Progress, Damage> {
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
            return Err("the first record is not a header".to_owned());
        }
        Ok(previous)
    }

    /// Handles a record of the file other than a chunk.
    fn record(&mut self, opcode: u8, data: &[u8], each: &mut dyn FnMut(Item<'_>)) -> Result<(), String> {
        let previous = self.next_is(opcode)?;
        let loose = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE);
        if loose && !self.data_ended {
            match self.trust {
                Trust::Verified => {}
                Trust::Unverified => self.unverified(each),
                Trust::Damaged => {
                    return Err(
                        "the checksum of the data is wrong, and this is not in a checked chunk".to_owned(),
                    );
                }
            }
        }
        match opcode {
            op::HEADER if previous != 0 => Err("a second header".to_owned()),
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
            op::MESSAGE_INDEX => self
                .message_index(previous, Fields(data))
                .or_else(|what| self.lose(what, None)),
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
            0 => Err("a record of unknown kind 0x00".to_owned()),
            // It may have been a chunk.
            other => self.lose(format!("a record of unknown kind {other:#04x}"), None),
        }
    }

    /// Skips a damaged record of correct length; `span`: its first and last log time.
    fn lose(&mut self, what: String, span: Option<(u64, u64)>) -> Result<(), String> {
        if !self.passes_holes || self.holes >= MOST_HOLES {
            return Err(what);
        }
        self.holes += 1;
        let offset = self.offset;
        // An odd index behind a spoilt chunk belongs to that one's hole.
        self.hole.get_or_insert_with(|| Hole::new(offset, what, span));
        Ok(())
    }

    fn unverified(&mut self, each: &mut dyn FnMut(Item<'_>)) {
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
    fn begin_chunk(&mut self, bytes: u64, data: &[u8], each: &mut dyn FnMut(Item<'_>)) -> Result<(), String> {
        self.next_is(op::CHUNK)?;
        if self.data_ended {
            return Err("a chunk behind the end of the data".to_owned());
        }
        // Taken out while its buffer is borrowed.
        let mut reader = std::mem::take(&mut self.chunk);
        let outcome = match reader.read(data, self.max_chunk) {
            Ok(is_checked) => self.look_through(is_checked, &reader, each).map(|()| true),
            Err(BadChunk::Broken(what)) => Err(what),
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
    fn hand_out(
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

    fn schema(&mut self, mut fields: Fields<'_>) -> Result<(), &'static str> {
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

    fn channel(
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

/// Error of the framing in the words of this program.
fn sentence(fault: &McapError) -> String {
    match fault {
        McapError::BadMagic => "not an MCAP file (its first or last bytes are wrong)".to_owned(),
        McapError::RecordTooLarge { len, .. } | McapError::ChunkTooLarge(len) => {
            format!("a record of {len} bytes, at most {MAX_RECORD} are read")
        }
        McapError::BadDataCrc { .. } => "the checksum of the data is wrong".to_owned(),
        McapError::BadSummaryCrc { .. } => "the checksum of the summary is wrong".to_owned(),
        McapError::BytesAfterEndMagic => "bytes after the end of the recording".to_owned(),
        other => other.to_string(),
    }
}
