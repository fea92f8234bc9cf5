//! The MCAP stream to a socket: small chunks, each written whole when flushed.

use super::playback::{Channel, Message};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, McapResult, WriteOptions, Writer};
use std::collections::{BTreeMap, HashMap};
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

/// The stream; its bytes collect until they are [taken](Stream::take).
pub(super) struct Stream {
    writer: Writer<NoSeek<Pipe>>,
    pipe: Pipe,
    /// Ids in the stream by the recording's channel ids.
    channels: HashMap<u16, u16>,
    sequence: u32,
    /// Bytes of messages since the last flush.
    pending: usize,
}

impl Stream {
    pub fn new() -> McapResult<Self> {
        let pipe = Pipe::default();
        let writer = WriteOptions::new()
            .library(concat!("tirante ", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Zstd))
            .compression_threads(0)
            .disable_seeking(true)
            .chunk_size(Some(4 << 20))
            .emit_message_indexes(false)
            .emit_chunk_indexes(false)
            .emit_metadata_indexes(false)
            .create(NoSeek::new(pipe.clone()))?;
        Ok(Self {
            writer,
            pipe,
            channels: HashMap::new(),
            sequence: 0,
            pending: 0,
        })
    }

    /// Prepares for the channels of another recording.
    pub fn begin_file(&mut self) {
        self.channels.clear();
    }

    pub fn channel(&mut self, channel: &Channel) -> McapResult<()> {
        let schema = match channel.schema.as_deref() {
            Some((name, encoding, data)) => self.writer.add_schema(name, encoding, data)?,
            None => 0,
        };
        let (topic, encoding) = (&channel.topic, &channel.encoding);
        let mut id = self
            .writer
            .add_channel(schema, topic, encoding, &BTreeMap::new())?;
        // Two channels of a recording that are alike stay two: the daemon must see that two sensors have one topic.
        if self
            .channels
            .iter()
            .any(|(other, known)| *other != channel.id && *known == id)
        {
            let own = BTreeMap::from([("channel".to_owned(), channel.id.to_string())]);
            id = self.writer.add_channel(schema, topic, encoding, &own)?;
        }
        self.channels.insert(channel.id, id);
        Ok(())
    }

    pub fn message(&mut self, message: &Message) -> McapResult<()> {
        let Some(&channel_id) = self.channels.get(&message.channel) else {
            return Err(McapError::UnexpectedEof);
        };
        let header = MessageHeader {
            channel_id,
            sequence: self.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.pending += message.data.len() + 31;
        self.writer.write_to_known_channel(&header, &message.data)
    }

    /// Bytes of messages that wait for a flush.
    pub fn pending(&self) -> usize {
        self.pending
    }

    /// Closes the chunk.
    pub fn flush(&mut self) -> McapResult<()> {
        self.pending = 0;
        self.writer.flush()
    }

    /// Adds a sign of life without other meaning.
    pub fn sign_of_life(&mut self) -> McapResult<()> {
        self.writer.write_metadata(&Metadata {
            name: "tirante-alive".to_owned(),
            metadata: BTreeMap::new(),
        })
    }

    /// Ends the stream.
    pub fn finish(&mut self) -> McapResult<()> {
        self.writer.finish().map(|_| ())
    }

    /// Takes the bytes to be sent now.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.pipe.bytes())
    }
}

/// Buffer between the writer of the stream and that of the socket.
#[derive(Default, Clone)]
struct Pipe(Arc<Mutex<Vec<u8>>>);

impl Pipe {
    fn bytes(&self) -> std::sync::MutexGuard<'_, Vec<u8>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for Pipe {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
