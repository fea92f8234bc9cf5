//! One chunk of an MCAP file: decompressed into a bounded buffer and checked before use.

use super::wire::Fields;
use std::io::Read;

/// Largest uncompressed chunk accepted \[bytes\]; recorders write about one MiB.
pub const MAX_CHUNK: u64 = 32 << 20;

/// Compressions of chunks that are read.
pub const READABLE: [&str; 3] = ["", "zstd", "lz4"];

/// Largest buffer kept after its chunk \[bytes\], so that many files at once take little memory.
const KEPT: usize = 4 << 20;

/// Decompresses chunks, one at a time, into the same buffer.
#[derive(Default)]
pub struct ChunkReader {
    records: Vec<u8>,
    zstd: Option<zstd::bulk::Decompressor<'static>>,
}

/// Reason why a chunk is refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BadChunk {
    /// Malformed: the place of the next record is doubtful too.
    Broken(String),
    /// Correct length, but its content is damaged.
    Spoilt {
        /// Description of the fault.
        what: String,
        /// Log times of its first and last message, by its header \[ns since 1970\].
        from: u64,
        to: u64,
    },
    /// Correct length, but of a compression or size that is not read: damaged, if others of its file are.
    Foreign {
        /// As for a spoilt one.
        what: String,
        from: u64,
        to: u64,
    },
}

impl From<&str> for BadChunk {
    fn from(what: &str) -> Self {
        Self::Broken(what.to_owned())
    }
}

impl ChunkReader {
    /// Decompresses and checks a chunk record of at most `most` bytes uncompressed; returns true if it has a
    /// (correct) checksum.
    pub fn read(&mut self, record: &[u8], most: u64) -> Result<bool, BadChunk> {
        let mut fields = Fields(record);
        let (from, to) = (fields.u64()?, fields.u64()?);
        let size = fields.u64()?;
        let crc = fields.u32()?;
        let compression = fields.text()?;
        let compressed_size = fields.u64()?;
        let compressed = fields.bytes(compressed_size)?;
        if !fields.0.is_empty() {
            return Err("a chunk is longer than its content".into());
        }
        if size > most {
            let what = format!("a chunk of {size} bytes, at most {most} are read");
            return Err(BadChunk::Foreign { what, from, to });
        }
        self.fill(compression, compressed, size, crc)
            .map(|()| crc != 0)
            .map_err(|what| match READABLE.contains(&compression) {
                true => BadChunk::Spoilt { what, from, to },
                false => BadChunk::Foreign { what, from, to },
            })
    }

    /// Records of the chunk that was read last, one after another.
    pub fn records(&self) -> &[u8] {
        &self.records
    }

    /// Takes those records.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.records)
    }

    /// Frees the buffer if it is large, or without `keep` whatever its size.
    pub fn release(&mut self, keep: bool) {
        if keep && self.records.capacity() <= KEPT {
            self.records.clear();
        } else {
            self.records = Vec::new();
        }
    }

    /// Size of the buffer \[bytes\].
    pub fn held(&self) -> usize {
        self.records.capacity()
    }

    fn fill(&mut self, compression: &str, compressed: &[u8], size: u64, crc: u32) -> Result<(), String> {
        // Bounded by the limit of the caller.
        let size = size as usize;
        match compression {
            "" => {
                self.records.clear();
                self.records.extend_from_slice(compressed);
            }
            "zstd" => self.zstd(compressed, size)?,
            "lz4" => self.lz4(compressed, size)?,
            other => {
                return Err(format!(
                    "chunk compression `{other}` cannot be read; zstd, lz4 and none can"
                ));
            }
        }
        if self.records.len() != size {
            return Err(format!(
                "a chunk decompresses to {} bytes, not {size}",
                self.records.len()
            ));
        }
        if crc != 0 && crc32fast::hash(&self.records) != crc {
            return Err("the checksum of a chunk is wrong".to_owned());
        }
        Ok(())
    }

    fn zstd(&mut self, compressed: &[u8], size: usize) -> Result<(), String> {
        let decompressor = match &mut self.zstd {
            Some(decompressor) => decompressor,
            empty => {
                let fresh = zstd::bulk::Decompressor::new().map_err(|fault| fault.to_string())?;
                empty.insert(fresh)
            }
        };
        self.records.resize(size, 0);
        // Straight into the buffer: no window is allocated, whatever the frame header asks for.
        let written = decompressor
            .decompress_to_buffer(compressed, &mut self.records[..])
            .map_err(|fault| format!("a chunk cannot be decompressed (zstd: {fault})"))?;
        self.records.truncate(written);
        Ok(())
    }

    fn lz4(&mut self, compressed: &[u8], size: usize) -> Result<(), String> {
        let broken = |fault: std::io::Error| format!("a chunk cannot be decompressed (lz4: {fault})");
        self.records.clear();
        let decoder = lz4::Decoder::new(compressed).map_err(broken)?;
        // One byte more than announced, so that too much is noticed.
        let mut bounded = decoder.take(size as u64 + 1);
        bounded.read_to_end(&mut self.records).map_err(broken)?;
        Ok(())
    }
}
