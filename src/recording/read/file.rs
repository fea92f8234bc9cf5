//! One file on its way in: its checksum is taken before anything in it is believed, then it is read item by item.

use super::mcap::{Damage, Item, Progress, Reader};
use super::verify::{Check, Trust};
use std::io::{self, Read, Seek};

/// A file that is read a step at a time.
pub(super) struct FileReader<R> {
    checking: Option<(R, Check)>,
    /// `None` until the checksum was taken.
    reader: Option<Box<Reader<R>>>,
}

impl<R: Read + Seek> FileReader<R> {
    /// A file that is read for its checksum first, if it has one; else `live` says that its end may not be there yet.
    pub fn checked(mut input: R, live: bool) -> io::Result<Self> {
        Ok(match Check::begin(&mut input)? {
            Some(check) => Self {
                checking: Some((input, check)),
                reader: None,
            },
            None => Self::unchecked(input, live),
        })
    }

    /// A file that is read without its checksum.
    pub fn unchecked(input: R, live: bool) -> Self {
        Self::reading(Reader::new(input, Trust::Unverified, live))
    }

    fn reading(reader: Reader<R>) -> Self {
        Self {
            checking: None,
            reader: Some(Box::new(reader)),
        }
    }

    /// The same, passing holes that a power cut left, unless it has a checksum.
    pub fn passing_holes(self) -> Self {
        match self.reader {
            Some(reader) => Self::reading(reader.passing_holes()),
            None => self,
        }
    }

    /// Takes the whole checksum, if there is one to be taken.
    pub fn check(&mut self) -> io::Result<()> {
        while self.checking.is_some() {
            self.check_on()?;
        }
        Ok(())
    }

    /// Takes some more of the checksum.
    fn check_on(&mut self) -> io::Result<()> {
        if let Some((input, check)) = &mut self.checking
            && let Some(trust) = check.step(input)?
            && let Some((input, _)) = self.checking.take()
        {
            *self = Self::reading(Reader::new(input, trust, false));
        }
        Ok(())
    }

    /// One step: at most one record is read, or some way into one chunk or the checksum.
    pub fn step(&mut self, each: &mut dyn FnMut(Item<'_>)) -> Result<Progress, Damage> {
        if let Some(reader) = &mut self.reader {
            return reader.step(each);
        }
        match self.check_on() {
            Ok(()) => Ok(Progress::More),
            Err(fault) => Err(Damage {
                offset: 0,
                what: format!("the file cannot be read: {fault}"),
            }),
        }
    }

    /// Its reader, once the checksum was taken.
    pub fn reader(&self) -> Option<&Reader<R>> {
        self.reader.as_deref()
    }
}
