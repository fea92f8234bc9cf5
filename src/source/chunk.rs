//! One chunk of an MCAP file: decompressed into a bounded buffer and checked before it is believed.

use super::wire::Fields;
use std::io::Read;

/// Largest uncompressed chunk accepted \[bytes\]; recorders write about one MiB.
pub const MAX_CHUNK: u64 = 64 << 20;

/// Decompresses chunks, one at a time, into the same buffer.
#[derive(Default)]
pub struct ChunkReader {
    records: Vec<u8>,
    zstd: Option<zstd::bulk::Decompressor<'static>>,
}

/// The records of a chunk.
pub struct Chunk<'a> {
    /// The records, one after another.
    pub records: &'a [u8],
    /// Whether the chunk has a checksum (and it is right).
    pub checked: bool,
}

impl ChunkReader {
    /// Decompresses and checks a chunk record of at most `most` bytes uncompressed.
    pub fn read<'a>(&'a mut self, record: &'a [u8], most: u64) -> Result<Chunk<'a>, String> {
        let mut fields = Fields(record);
        let (_start, _end) = (fields.u64()?, fields.u64()?);
        let size = fields.u64()?;
        let crc = fields.u32()?;
        let compression = fields.text()?;
        let compressed_size = fields.u64()?;
        let compressed = fields.bytes(compressed_size)?;
        if !fields.0.is_empty() {
            return Err("a chunk is longer than its content".to_owned());
        }
        if size > most {
            return Err(format!("a chunk of {size} bytes, at most {most} are read"));
        }
        // Bounded by the limit above.
        let size = size as usize;
        let records = match compression {
            "" => compressed,
            "zstd" => {
                self.zstd(compressed, size)?;
                &self.records
            }
            "lz4" => {
                self.lz4(compressed, size)?;
                &self.records
            }
            other => {
                return Err(format!(
                    "chunk compression `{other}` cannot be read; zstd, lz4 and none can"
                ));
            }
        };
        if records.len() != size {
            return Err(format!(
                "a chunk decompresses to {} bytes, not {size}",
                records.len()
            ));
        }
        if crc != 0 && crc32fast::hash(records) != crc {
            return Err("the checksum of a chunk is wrong".to_owned());
        }
        Ok(Chunk {
            records,
            checked: crc != 0,
        })
    }

    /// Gives the buffer back.
    pub fn release(&mut self) {
        self.records = Vec::new();
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
