//! Reads one file: verifies its checksum before any of its data is used, then reads it item by item.

use super::mcap::{Damage, Item, Progress, Reader};
use super::verify::{Check, Trust};
use std::io::{self, Read, Seek};

/// A file that is read in steps.
pub(super) struct FileReader<R> {
    checking: Option<(R, Check)>,
    /// `None` until the checksum is verified.
    reader: Option<Box<Reader<R>>>,
}

impl<R: Read + Seek> FileReader<R> {
    /// A file whose checksum is verified first, if it has one. Otherwise `live` states that its end may not
    /// be written yet.
    pub fn checked(mut input: R, live: bool) -> io::Result<Self> {
        Ok(match Check::begin(&mut input)? {
            Some(check) => Self {
                checking: Some((input, check)),
                reader: None,
            },
            None => Self::unchecked(input, live),
        })
    }

    /// A file that is read without verifying a checksum.
    pub fn unchecked(input: R, live: bool) -> Self {
        Self::reading(Reader::new(input, Trust::Unverified, live))
    }

    fn reading(reader: Reader<R>) -> Self {
        Self {
            checking: None,
            reader: Some(Box::new(reader)),
        }
    }

    /// Returns the reader set to skip holes left by a power cut, unless the file has a checksum.
    pub fn passing_holes(self) -> Self {
        match self.reader {
            Some(reader) => Self::reading(reader.passing_holes()),
            None => self,
        }
    }

    /// Verifies the whole checksum, if there is one.
    pub fn check(&mut self) -> io::Result<()> {
        while self.checking.is_some() {
            self.check_on()?;
        }
        Ok(())
    }

    /// Takes one step of verifying the checksum.
    fn check_on(&mut self) -> io::Result<()> {
        if let Some((input, check)) = &mut self.checking
            && let Some(trust) = check.step(input)?
            && let Some((input, _)) = self.checking.take()
        {
            *self = Self::reading(Reader::new(input, trust, false));
        }
        Ok(())
    }

    /// Takes one step: at most one record, or part of one chunk or of the checksum.
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

    /// Reader of the items, once the checksum is verified.
    pub fn reader(&self) -> Option<&Reader<R>> {
        self.reader.as_deref()
    }
}
