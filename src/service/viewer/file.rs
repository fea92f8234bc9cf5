//! Messages as an MCAP file, to be opened beside the recordings: a message's time there is its own.

use super::{Message, Topic, encode};
use crate::recording::write::{Encoding, SinkError};
use mcap::records::MessageHeader;
use std::collections::BTreeMap;
use std::io::{BufWriter, Write};

/// Writes messages to any output; the same bytes for the same messages.
pub struct ResultsWriter<W: Write> {
    mcap: mcap::Writer<mcap::write::NoSeek<BufWriter<W>>>,
    encoding: Encoding,
    /// Channel ids by topic, with the next sequence number.
    channels: BTreeMap<Topic, (u16, u32)>,
}

impl<W: Write> ResultsWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn new(to: W, encoding: Encoding) -> Result<Self, SinkError> {
        let options = mcap::WriteOptions::new()
            .library(concat!("tirante ", env!("CARGO_PKG_VERSION")))
            .disable_seeking(true)
            .compression_threads(0);
        let to = mcap::write::NoSeek::new(BufWriter::new(to));
        Ok(Self {
            mcap: options.create(to)?,
            encoding,
            channels: BTreeMap::new(),
        })
    }

    /// Writes one message.
    ///
    /// # Errors
    /// Its time lies before 1970, or the file cannot be written.
    pub fn write(&mut self, message: &Message) -> Result<(), SinkError> {
        let Message { topic, time, body } = message;
        let nanos = u64::try_from(time.as_nanos()).map_err(|_| SinkError::Time(*time))?;
        if !self.channels.contains_key(topic) {
            let (name, form, schema) = topic.schema(self.encoding);
            let schema_id = self.mcap.add_schema(&name, form, &schema)?;
            let key = self.encoding.key();
            let id = self
                .mcap
                .add_channel(schema_id, &topic.to_string(), key, &BTreeMap::new())?;
            self.channels.insert(topic.clone(), (id, 0));
        }
        let Some((channel_id, sequence)) = self.channels.get_mut(topic) else {
            return Err(SinkError::Channel);
        };
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        *sequence = sequence.wrapping_add(1);
        self.mcap
            .write_to_known_channel(&header, &encode(topic.kind(), body, self.encoding))?;
        Ok(())
    }

    /// Ends the file and returns the output.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(mut self) -> Result<W, SinkError> {
        self.mcap.finish()?;
        let buffer = self.mcap.into_inner().into_inner();
        buffer.into_inner().map_err(|error| SinkError::Io {
            path: "the results".to_owned(),
            source: error.into_error(),
        })
    }
}
