//! A finished file, read whole in the order of its log times, for those that use its messages themselves.

use super::file::FileReader;
use super::mcap::{Damage, Item, Progress};
use std::fs::{self, File};
use std::io;
use std::path::Path;

/// A finished file. The order of its messages is that of the file alone: the same whenever it is read.
pub struct Finished(FileReader<File>);

impl Finished {
    /// Opens a file; it is first read once for its checksum. Any of its topics may hold samples.
    ///
    /// # Errors
    /// It is no regular file, or cannot be read.
    pub fn open(path: &Path) -> io::Result<Self> {
        // Before it is opened: opening a pipe would wait for its writer.
        if !fs::metadata(path)?.is_file() {
            return Err(io::Error::other("is no regular file"));
        }
        let mut file = FileReader::by_time(File::open(path)?, None)?;
        file.check()?;
        Ok(Self(file))
    }

    /// Takes one step: at most one record, or part of one chunk.
    ///
    /// # Errors
    /// Damage that ends the reading.
    pub fn step(&mut self, each: &mut dyn FnMut(Item<'_>)) -> Result<Progress, Damage> {
        self.0.step(each)
    }

    /// Number of bytes read, about.
    pub fn bytes_read(&self) -> u64 {
        self.0.bytes_read()
    }

    /// Takes the clause on messages that cannot be put in order.
    pub fn take_beyond(&mut self) -> Option<String> {
        self.0.beyond.take()
    }
}
