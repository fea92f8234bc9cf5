//! Reads MCAP strictly: everything handed out was checked, or is marked as unchecked.
//!
//! The framing is the `mcap` crate's reader; chunks are decompressed and checked here before anything
//! in them is handed out. Besides broken framing and wrong checksums, these are refused: a message
//! before its channel, a channel or schema that changes under its id, names that are not UTF-8,
//! a chunk in a chunk, messages after the data section, and sizes beyond any recorder's. A chunk of correct
//! length with damaged content is a hole: it is reported, and reading continues after it; so is damage of the framing, where the summary
//! of the file tells the next place.

mod contents;
mod passing;
mod resume;

pub(super) use resume::Next;

use super::decode::SchemaRef;
use super::hole::Hole;
use super::known::Known;
use super::verify::Trust;
use contents::Contents;
use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Largest record accepted, compressed chunks included \[bytes\].
pub const MAX_RECORD: usize = 16 << 20;

/// Largest chunk made of messages that were put in order \[bytes\]: the largest chunk with its definitions.
const MAX_MADE: usize = 33 << 20;

/// Largest uncompressed chunk accepted from a socket \[bytes\]: the largest message with its definitions.
pub const MAX_LIVE_CHUNK: u64 = 12 << 20;

/// Most bytes of schemas and channels held of a socket's stream.
const MAX_LIVE_HELD: usize = 4 << 20;

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
    /// True if the input began as an MCAP file does.
    has_magic: bool,
    /// Places by the summary of a file that may be damaged.
    known: Option<Known>,
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
        let options = LinearReaderOptions::default().with_record_length_limit(most);
        let mut contents = Contents::new(trust, !live);
        contents.is_framed = !has_checksum;
        Self {
            input,
            framing: framing_of(options, has_checksum, live),
            contents,
            live,
            ahead: 1 << 16,
            bytes_read: 0,
            has_magic: false,
            known: None,
        }
    }

    /// Goes on behind damage at places of the file.
    pub(super) fn with_known(mut self, known: Option<Known>) -> Self {
        self.contents.is_known = known.as_ref().is_some_and(Known::is_checked);
        self.known = known;
        self
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
            has_magic,
            known,
        } = self;
        contents.is_passable = false;
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
            // The chunk that defines the channels of others may be the one that is lost.
            if let Some(known) = known.as_mut().filter(|_| hole.is_loss) {
                contents.define(&known.take_definitions(), known.is_checked(), each);
            }
            each(Item::Hole(&hole));
        }
        match event {
            None => return contents.end(),
            Some(Err(McapError::UnexpectedEof)) => return Ok(Progress::Truncated),
            // The checksum differs because of the holes, which are already reported.
            Some(Err(McapError::BadDataCrc { .. }))
                if contents.holes > 0 && known.as_ref().is_none_or(|known| known.ends_at(offset)) =>
            {
                return Ok(Progress::Complete);
            }
            Some(Err(fault)) => return Err(damage(contents.passable(sentence(&fault)))),
            Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                let bytes = 9 + data.len() as u64;
                if let Some(known) = known {
                    let checked = known.check(offset, opcode, bytes);
                    checked.map_err(|what| damage(contents.passable(what.to_owned())))?;
                }
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
            // At once: a file that is none may be shorter than the first bytes of one that is.
            if let Some(rest) = mcap::MAGIC.get(*bytes_read as usize..).filter(|_| !*has_magic) {
                let begun = count.min(rest.len());
                if buffer[..begun] != rest[..begun] {
                    return Err(damage(contents.passable(sentence(&McapError::BadMagic))));
                }
                *has_magic = begun == rest.len();
            }
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

/// Framing of a file whose checksums are verified, that over all of its data by `has_checksum`.
fn framing_of(options: LinearReaderOptions, has_checksum: bool, live: bool) -> LinearReader {
    let options = options
        .with_emit_chunks(true)
        .with_validate_data_section_crc(has_checksum)
        .with_validate_summary_section_crc(true)
        .with_check_finishes_after_end_magic(!live);
    LinearReader::new_with_options(options)
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
