//! Reads one file: verifies its checksum before any of its data is used, then reads it item by item.

use super::hole::Hole;
use super::in_order::{InOrder, Places};
use super::known::Known;
use super::mcap::{Damage, Item, Next, Progress, Reader};
use super::verify::{Check, Trust};
use std::io::{self, Read, Seek};

/// A file that is read in steps.
pub(super) struct FileReader<R> {
    checking: Option<(R, Check)>,
    /// A file without a checksum whose order is not known yet: its indices are read as a step.
    unordered: Option<R>,
    /// `None` until the checksum is verified.
    reader: Option<Box<Reader<InOrder<R>>>>,
    places: Places,
    /// True if messages are read by their times.
    by_time: bool,
    /// Topics of samples; `None`: any of them.
    sampled: Option<Vec<String>>,
    /// Clause on messages that cannot be put in order.
    pub beyond: Option<String>,
}

impl<R: Read + Seek> FileReader<R> {
    /// A file whose checksum is verified first, if it has one. Otherwise `live` states that its end may not
    /// be written yet.
    pub fn checked(mut input: R, live: bool) -> io::Result<Self> {
        Ok(match Check::begin(&mut input)? {
            Some(check) => Self {
                checking: Some((input, check)),
                ..Self::empty()
            },
            None => Self::unchecked(input, live),
        })
    }

    /// A finished file, as [`Self::checked`], whose messages are read in the order of their times.
    /// `sampled`: topics of samples, `None` for all.
    pub fn by_time(mut input: R, sampled: Option<Vec<String>>) -> io::Result<Self> {
        let mut file = Self {
            by_time: true,
            sampled,
            ..Self::empty()
        };
        match Check::begin(&mut input)? {
            Some(check) => file.checking = Some((input, check)),
            None => file.unordered = Some(input),
        }
        Ok(file)
    }

    /// A file that is read without verifying a checksum.
    pub fn unchecked(input: R, live: bool) -> Self {
        Self {
            reader: Some(Box::new(Reader::new(
                InOrder::plain(input),
                Trust::Unverified,
                live,
            ))),
            ..Self::empty()
        }
    }

    fn empty() -> Self {
        Self {
            checking: None,
            unordered: None,
            reader: None,
            places: Places::default(),
            by_time: false,
            sampled: None,
            beyond: None,
        }
    }

    /// Begins to read a finished file at its first byte.
    fn begin(&mut self, mut input: R, trust: Trust) -> io::Result<()> {
        // Nothing of a verified file is damaged.
        let known = match trust {
            Trust::Verified => None,
            Trust::Damaged | Trust::Unverified => Known::read(&mut input)?,
        };
        // Of a damaged file the order is not believed either.
        let input = match self.by_time && trust != Trust::Damaged {
            true => InOrder::by_time(input, self.sampled.as_deref())?,
            false => InOrder::plain(input),
        };
        self.begin_with(input, trust, known);
        Ok(())
    }

    fn begin_with(&mut self, mut input: InOrder<R>, trust: Trust, known: Option<Known>) {
        self.beyond = input.beyond();
        let reader = match input.is_moved() {
            true => Reader::of_moved(input, trust),
            false => Reader::new(input, trust, false).with_known(known),
        };
        self.reader = Some(Box::new(reader));
    }

    /// Returns the reader set to skip holes left by a power cut, unless the file has a checksum.
    pub fn passing_holes(mut self) -> Self {
        self.reader = self.reader.map(|reader| Box::new(reader.passing_holes()));
        self
    }

    /// Verifies the whole checksum, if there is one.
    pub fn check(&mut self) -> io::Result<()> {
        while self.checking.is_some() || self.unordered.is_some() {
            self.check_on()?;
        }
        Ok(())
    }

    /// Takes one step of verifying the checksum, or finds the order of a file without one.
    fn check_on(&mut self) -> io::Result<()> {
        if let Some(input) = self.unordered.take() {
            return self.begin(input, Trust::Unverified);
        }
        if let Some((input, check)) = &mut self.checking
            && let Some(trust) = check.step(input)?
            && let Some((input, _)) = self.checking.take()
        {
            self.begin(input, trust)?;
        }
        Ok(())
    }

    /// Takes one step: at most one record, or part of one chunk or of the checksum.
    pub fn step(&mut self, each: &mut dyn FnMut(Item<'_>)) -> Result<Progress, Damage> {
        if let Some(reader) = &mut self.reader {
            // What a step hands out was read by those before it.
            reader.input_mut().places(&mut self.places);
            for hole in reader.input_mut().take_mended() {
                each(Item::Hole(&hole));
            }
            let places = &self.places;
            let in_file = |offset| places.in_file(offset);
            let outcome = reader.step(&mut |item| match item {
                Item::Hole(hole) => each(Item::Hole(&Hole {
                    offset: in_file(hole.offset),
                    ..hole.clone()
                })),
                other => each(other),
            });
            let outcome = match reader.go_on(outcome) {
                Next::Is(outcome) => outcome,
                Next::At(at) => match reader.input_mut().go_to(at) {
                    Ok(()) => Ok(Progress::More),
                    Err(fault) => Err(Damage {
                        offset: at,
                        what: format!("the file cannot be read: {fault}"),
                    }),
                },
            };
            return outcome.map_err(|damage| Damage {
                offset: in_file(damage.offset),
                ..damage
            });
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
    pub fn reader(&self) -> Option<&Reader<InOrder<R>>> {
        self.reader.as_deref()
    }

    /// Number of bytes of the file that were read, about.
    pub fn bytes_read(&self) -> u64 {
        self.reader()
            .map_or(0, |reader| self.places.in_file(reader.bytes_read()))
    }

    /// Bytes in memory.
    pub fn held(&self) -> usize {
        self.reader()
            .map_or(0, |reader| reader.held() + reader.input().held())
    }

    /// Position in the file of the record or chunk with which the next step continues \[bytes\].
    pub fn offset(&self) -> u64 {
        self.reader()
            .map_or(0, |reader| self.places.in_file(reader.offset()))
    }
}
