//! The part being written: an MCAP file made in memory and written to disk chunk by chunk.

use super::Definition;
use crate::recording::note::{Note, TOPIC};
use crate::recording::part;
use crate::service::telemetry::owned::Owned;
use crate::site::clock;
use mcap::records::MessageHeader;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Most channels of one part; ids have 16 bits.
const MAX_CHANNELS: usize = 60_000;
/// Most chunks of one part; each costs memory until its part is closed.
const MAX_CHUNKS: usize = 50_000;
/// Most bytes of schemas and channels in one part, as readers count them.
const MAX_HELD: usize = 8 << 20;

/// A channel to be written.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Channel {
    pub topic: String,
    pub encoding: String,
    pub schema: Option<Definition>,
    /// Id in its stream, if another channel of the stream is like it: two sensors on one topic stay two.
    pub twin: Option<u16>,
}

/// Bytes the MCAP writer has made.
#[derive(Clone, Default)]
struct Made(Arc<Mutex<Vec<u8>>>);

impl Made {
    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Write for Made {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The part being written.
pub(super) struct Output {
    pub number: u32,
    path: PathBuf,
    file: File,
    mcap: mcap::Writer<mcap::write::NoSeek<Made>>,
    made: Made,
    /// Bytes made, but not on disk yet. They stay after a full disk, and writing continues where it stopped.
    unwritten: Vec<u8>,
    bytes: u64,
    channels: usize,
    chunks: usize,
    held: usize,
    sequence: u32,
    notes: u16,
    began: Instant,
    has_data: bool,
    is_synced: bool,
}

fn other(fault: mcap::McapError) -> io::Error {
    match fault {
        mcap::McapError::Io(fault) => fault,
        fault => io::Error::other(fault),
    }
}

impl Output {
    /// Creates the file of a new part, which begins with `note`.
    pub fn create(folder: &Path, number: u32, note: &Note) -> io::Result<Self> {
        let path = part::path(folder, number);
        let file = File::options().write(true).create_new(true).open(&path)?;
        // The name is made durable before any content is reported durable.
        if let Err(fault) = File::open(folder).and_then(|folder| folder.sync_all()) {
            // It is still empty: removed, it does not block the next attempt.
            let _ = std::fs::remove_file(&path);
            return Err(fault);
        }
        let made = Made::default();
        let mut mcap = mcap::WriteOptions::new()
            .library(concat!("tirante ", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(None)
            .disable_seeking(true)
            .emit_message_indexes(false)
            .create(mcap::write::NoSeek::new(made.clone()))
            .map_err(other)?;
        let notes = mcap
            .add_channel(0, TOPIC, "json", &BTreeMap::new())
            .map_err(other)?;
        let mut output = Self {
            number,
            path,
            file,
            mcap,
            made,
            unwritten: Vec::new(),
            bytes: 0,
            channels: 1,
            chunks: 0,
            held: 0,
            sequence: 0,
            notes,
            began: Instant::now(),
            has_data: false,
            is_synced: false,
        };
        output.close_chunk(note)?;
        Ok(output)
    }

    /// The file, by its identity.
    pub fn owned(&self) -> Option<Owned> {
        let data = self.file.metadata().ok()?;
        Some(Owned::with(&self.path, &data))
    }

    /// True if this part has room for this many more channels.
    pub fn has_room(&self, channels: usize) -> bool {
        !self.has_data || (self.channels + channels <= MAX_CHANNELS && self.held <= MAX_HELD)
    }

    /// Registers a stream's channel; returns its id in this part.
    pub fn channel(&mut self, stream: &str, channel: &Channel) -> io::Result<u16> {
        let schema = match channel.schema.as_deref() {
            None => 0,
            Some((name, encoding, data)) => {
                self.held += data.len();
                self.mcap.add_schema(name, encoding, data).map_err(other)?
            }
        };
        let mut metadata = BTreeMap::from([(crate::recording::note::STREAM.to_owned(), stream.to_owned())]);
        if let Some(twin) = channel.twin {
            metadata.insert("channel".to_owned(), twin.to_string());
        }
        self.channels += 1;
        self.held += 8 * (channel.topic.len() + stream.len() + 64);
        self.mcap
            .add_channel(schema, &channel.topic, &channel.encoding, &metadata)
            .map_err(other)
    }

    /// Adds a message to the open chunk.
    pub fn message(&mut self, channel: u16, log_time: u64, publish_time: u64, data: &[u8]) -> io::Result<()> {
        self.sequence = self.sequence.wrapping_add(1);
        self.has_data = true;
        let header = MessageHeader {
            channel_id: channel,
            sequence: self.sequence,
            log_time,
            publish_time,
        };
        self.mcap.write_to_known_channel(&header, data).map_err(other)
    }

    /// Closes the open chunk with a note as its last message; [`Output::write`] puts it on disk.
    pub fn close_chunk(&mut self, note: &Note) -> io::Result<()> {
        let now = clock::now_ns();
        let header = MessageHeader {
            channel_id: self.notes,
            sequence: self.sequence,
            log_time: now,
            publish_time: now,
        };
        self.mcap
            .write_to_known_channel(&header, &note.to_json())
            .map_err(other)?;
        self.mcap.flush().map_err(other)?;
        self.unwritten.append(&mut self.made.take());
        self.chunks += 1;
        Ok(())
    }

    /// Writes the bytes not yet on disk. After an error it may be called again: it continues where it
    /// stopped.
    pub fn write(&mut self) -> io::Result<()> {
        let mut written = 0;
        let mut outcome = Ok(());
        while written < self.unwritten.len() {
            match self.file.write(&self.unwritten[written..]) {
                Ok(0) => {
                    outcome = Err(io::ErrorKind::WriteZero.into());
                    break;
                }
                Ok(count) => {
                    written += count;
                    self.is_synced = false;
                }
                Err(fault) if fault.kind() == io::ErrorKind::Interrupted => {}
                Err(fault) => {
                    outcome = Err(fault);
                    break;
                }
            }
        }
        self.unwritten.drain(..written);
        self.bytes += written as u64;
        outcome
    }

    /// Makes the written data durable. A failure is final: data written before may be lost.
    pub fn sync(&mut self) -> io::Result<()> {
        if !self.is_synced {
            self.file.sync_data()?;
            self.is_synced = true;
        }
        Ok(())
    }

    /// Makes the end of the file; nothing can be added afterwards.
    pub fn finish(&mut self) -> io::Result<()> {
        self.mcap.finish().map_err(other)?;
        self.unwritten.append(&mut self.made.take());
        Ok(())
    }

    /// True if the part is full or old enough to be closed.
    pub fn is_due(&self, part_bytes: u64, part_s: f64) -> bool {
        let is_large = self.bytes >= part_bytes || self.chunks >= MAX_CHUNKS;
        self.has_data && (is_large || self.began.elapsed().as_secs_f64() >= part_s)
    }
}
