//! Writes recordings as MCAP files, the same bytes for the same samples.

use super::message::{self, Encoding, Layout, Precision};
use crate::atomic::AtomicFile;
use mcap::records::{MessageHeader, Metadata};
use std::collections::BTreeMap;
use std::io::{self, Seek, Write};
use std::path::Path;
use thiserror::Error;
use tirante_analysis::signal::record::{Timestamp, Unit};

/// Reason why a recording could not be written.
#[derive(Debug, Error)]
pub enum SinkError {
    /// The file system returned an error.
    #[error("cannot write {path}: {source}")]
    Io {
        /// Path of the file.
        path: String,
        /// Error of the file system.
        source: io::Error,
    },
    /// The MCAP writer returned an error.
    #[error("cannot write MCAP: {0}")]
    Mcap(#[from] mcap::McapError),
    /// The time is before 1970, where MCAP's times begin.
    #[error("{0} cannot be stored: MCAP time starts in 1970")]
    Time(Timestamp),
    /// The channel id is from another writer.
    #[error("no such channel")]
    Channel,
    /// A sample rate that is not a positive number, or stamps and samples that differ in number.
    #[error("{0}")]
    Samples(&'static str),
}

/// Compression of chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compression {
    /// Zstandard.
    Zstd,
    /// LZ4.
    Lz4,
    /// No compression.
    None,
}

/// Layout of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WriterOptions {
    /// Compression of chunks.
    pub compression: Compression,
    /// Uncompressed size of a chunk \[bytes\]; `None` writes messages without chunks.
    pub chunk_bytes: Option<u64>,
    /// True if checksums are written; without them damage is not detected.
    pub checksums: bool,
    /// Zstandard level, 0 for its default.
    pub level: u32,
}

impl Default for WriterOptions {
    fn default() -> Self {
        Self {
            compression: Compression::Zstd,
            chunk_bytes: Some(1 << 20),
            checksums: true,
            level: 0,
        }
    }
}

/// A channel to be written.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelSpec {
    /// Topic.
    pub topic: String,
    /// Encoding of its messages.
    pub encoding: Encoding,
    /// Number of samples per message: one or a batch.
    pub layout: Layout,
    /// Floating-point precision of a sample.
    pub precision: Precision,
    /// Unit of the samples; named in batches and in the channel's metadata.
    pub unit: Unit,
}

/// A channel of one [`RecordingWriter`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChannelId(usize);

struct Channel {
    id: u16,
    sequence: u32,
    spec: ChannelSpec,
}

/// Writes one recording. Call [`RecordingWriter::finish`], or for a file [`RecordingWriter::save`];
/// a file that is dropped before leaves nothing on disk.
pub struct RecordingWriter<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    channels: Vec<Channel>,
    message: Vec<u8>,
    path: String,
}

impl RecordingWriter<AtomicFile> {
    /// Starts a recording that will appear as `path` when it is [saved](Self::save).
    pub fn create(path: &Path, options: WriterOptions) -> Result<Self, SinkError> {
        let file = AtomicFile::create(path).map_err(|source| SinkError::Io {
            path: path.display().to_string(),
            source,
        })?;
        let mut writer = Self::new(file, options)?;
        writer.path = path.display().to_string();
        Ok(writer)
    }

    /// Finishes the file, makes it durable and gives it its name.
    pub fn save(self) -> Result<(), SinkError> {
        let path = self.path.clone();
        let file = self.finish()?;
        file.commit().map_err(|source| SinkError::Io { path, source })
    }
}

impl<W: Write + Seek> RecordingWriter<W> {
    /// Starts a recording on any output that can be written and sought.
    pub fn new(to: W, options: WriterOptions) -> Result<Self, SinkError> {
        let compression = match options.compression {
            Compression::Zstd => Some(mcap::Compression::Zstd),
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::None => None,
        };
        // One thread: the number of cores must not change the bytes.
        let mcap = mcap::WriteOptions::new()
            .library(concat!("tirante ", env!("CARGO_PKG_VERSION")))
            .compression(compression)
            .compression_level(options.level)
            .compression_threads(0)
            .use_chunks(options.chunk_bytes.is_some())
            .chunk_size(options.chunk_bytes)
            .calculate_chunk_crcs(options.checksums)
            .calculate_data_section_crc(options.checksums)
            .calculate_summary_section_crc(options.checksums)
            .create(to)?;
        Ok(Self {
            mcap,
            channels: Vec::new(),
            message: Vec::new(),
            path: String::new(),
        })
    }

    /// Adds a channel.
    pub fn add_channel(&mut self, spec: ChannelSpec) -> Result<ChannelId, SinkError> {
        let schema = message::schema(spec.encoding, spec.layout, spec.precision);
        let schema_id = self
            .mcap
            .add_schema(&schema.name, schema.encoding, &schema.data)?;
        let metadata = BTreeMap::from([("unit".to_owned(), spec.unit.key().to_owned())]);
        let id = self
            .mcap
            .add_channel(schema_id, &spec.topic, spec.encoding.key(), &metadata)?;
        self.channels.push(Channel {
            id,
            sequence: 0,
            spec,
        });
        Ok(ChannelId(self.channels.len() - 1))
    }

    /// Adds a metadata record: facts about the recording, by name.
    pub fn metadata(&mut self, name: &str, facts: BTreeMap<String, String>) -> Result<(), SinkError> {
        self.mcap.write_metadata(&Metadata {
            name: name.to_owned(),
            metadata: facts,
        })?;
        Ok(())
    }

    /// Writes evenly spaced samples from `start` on, cut into the channel's messages. Samples are in
    /// the channel's unit; a value that is not finite is written as missing.
    pub fn write_samples(
        &mut self,
        channel: ChannelId,
        start: Timestamp,
        fs_hz: f64,
        samples: &[f64],
    ) -> Result<(), SinkError> {
        if !(fs_hz.is_finite() && fs_hz > 0.0) {
            return Err(SinkError::Samples("the sample rate must be positive"));
        }
        let layout = self.channel(channel)?.spec.layout;
        let length = match layout {
            Layout::Sample => 1,
            Layout::Batch(length) => length.max(1),
        };
        for (i, values) in samples.chunks(length).enumerate() {
            let time = start.plus_seconds((i * length) as f64 / fs_hz);
            self.write_message(channel, time, fs_hz, values)?;
        }
        Ok(())
    }

    /// Writes one message: a batch of `values` from `time` on, or the first of them alone.
    pub fn write_message(
        &mut self,
        channel: ChannelId,
        time: Timestamp,
        fs_hz: f64,
        values: &[f64],
    ) -> Result<(), SinkError> {
        let stamp = u64::try_from(time.as_nanos()).map_err(|_| SinkError::Time(time))?;
        let Channel { id, sequence, spec } = self.channels.get_mut(channel.0).ok_or(SinkError::Channel)?;
        self.message.clear();
        match (spec.layout, values) {
            (_, []) => return Ok(()),
            (Layout::Sample, [value, ..]) => {
                message::encode_sample(&mut self.message, spec.encoding, spec.precision, *value);
            }
            (Layout::Batch(_), values) => {
                let head = (time, fs_hz, spec.unit);
                message::encode_batch(&mut self.message, spec.encoding, spec.precision, head, values);
            }
        }
        let header = MessageHeader {
            channel_id: *id,
            sequence: *sequence,
            log_time: stamp,
            publish_time: stamp,
        };
        *sequence = sequence.wrapping_add(1);
        self.mcap.write_to_known_channel(&header, &self.message)?;
        Ok(())
    }

    /// Writes the buffer as a chunk, so that a reader can follow.
    pub fn flush(&mut self) -> Result<(), SinkError> {
        Ok(self.mcap.flush()?)
    }

    /// Ends the recording and returns the output.
    pub fn finish(mut self) -> Result<W, SinkError> {
        self.mcap.finish()?;
        Ok(self.mcap.into_inner())
    }

    fn channel(&self, channel: ChannelId) -> Result<&Channel, SinkError> {
        self.channels.get(channel.0).ok_or(SinkError::Channel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn written(options: WriterOptions, encoding: Encoding, layout: Layout) -> Vec<u8> {
        let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), options).unwrap();
        let spec = ChannelSpec {
            topic: "/laser".into(),
            encoding,
            layout,
            precision: Precision::Double,
            unit: Unit::Millimetre,
        };
        let channel = writer.add_channel(spec).unwrap();
        let facts = BTreeMap::from([("simulated".to_owned(), "yes".to_owned())]);
        writer.metadata("tirante", facts).unwrap();
        let samples: Vec<f64> = (0..5000).map(|i| f64::from(i).sin()).collect();
        writer
            .write_samples(channel, Timestamp::from_nanos(1_000_000_000), 200.0, &samples)
            .unwrap();
        writer.finish().unwrap().into_inner()
    }

    #[test]
    fn every_layout_holds_every_message_and_repeats_to_the_byte() {
        for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Ros2] {
            for (layout, messages) in [(Layout::Sample, 5000), (Layout::Batch(64), 79)] {
                for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
                    for chunk_bytes in [None, Some(4096)] {
                        let options = WriterOptions {
                            compression,
                            chunk_bytes,
                            ..Default::default()
                        };
                        let bytes = written(options, encoding, layout);
                        assert_eq!(bytes, written(options, encoding, layout));
                        let stream = mcap::MessageStream::new(&bytes).unwrap();
                        let read: Vec<_> = stream.map(|message| message.unwrap().log_time).collect();
                        assert_eq!(read.len(), messages);
                        assert_eq!(read[1] - read[0], 5_000_000 * 5000_u64.div_ceil(messages as u64));
                    }
                }
            }
        }
    }

    #[test]
    fn a_file_appears_when_saved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let writer = RecordingWriter::create(&path, WriterOptions::default()).unwrap();
        assert!(!path.exists());
        writer.save().unwrap();
        assert!(path.exists());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
