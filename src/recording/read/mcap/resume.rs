//! Goes on behind damage, at the next place that the summary of the file tells.

use super::passing::MOST_HOLES;
use super::{Damage, MAX_RECORD, Progress, Reader, framing_of};
use crate::read::hole::Hole;
use crate::read::known::{HEAD, Region};
use mcap::records::op;
use mcap::sans_io::linear_reader::LinearReaderOptions;
use std::io::Read;

/// Way on behind a step.
pub(in crate::read) enum Next {
    /// None but the outcome of the step.
    Is(Result<Progress, Damage>),
    /// The input is to be read on from this byte.
    At(u64),
}

/// A place to go on at.
struct Resumed {
    /// Begin of the next record \[bytes\].
    at: u64,
    /// Its opcode and length, where the file's are damaged.
    head: Option<[u8; 9]>,
    /// Kind of the record before it; 0 before the first.
    previous: u8,
    hole: Hole,
}

impl<R: Read> Reader<R> {
    /// Way on behind a step with this outcome. What could not be believed, only not be read, is left out as a hole; a contradiction is the end.
    pub(in crate::read) fn go_on(&mut self, outcome: Result<Progress, Damage>) -> Next {
        let what = match &outcome {
            Err(damage) if self.contents.is_passable => damage.what.clone(),
            Ok(Progress::Truncated) => "a record is longer than the rest of the file".to_owned(),
            _ => return Next::Is(outcome),
        };
        match self.place_behind(&what) {
            Some(place) => Next::At(self.resume(place)),
            // The file has an end, so that it is not cut short.
            None if self.known.is_some() && self.contents.data_ended && outcome.is_ok() => {
                Next::Is(Err(Damage {
                    offset: self.contents.offset,
                    what,
                }))
            }
            None => Next::Is(outcome),
        }
    }

    fn place_behind(&mut self, what: &str) -> Option<Resumed> {
        let offset = self.contents.offset;
        let known = self.known.as_mut()?;
        if self.contents.holes >= MOST_HOLES {
            return None;
        }
        if !std::mem::replace(&mut self.has_magic, true) {
            return Some(Resumed {
                at: 8,
                head: None,
                previous: 0,
                hole: Hole::without_loss(0, "the first bytes are damaged".to_owned()),
            });
        }
        if let Some(head) = known.head(offset) {
            return Some(Resumed {
                at: offset,
                head: Some(head),
                previous: op::HEADER,
                hole: Hole::without_loss(offset, HEAD.to_owned()),
            });
        }
        match known.region(offset) {
            Region::Chunk(chunk) if chunk.is_readable => {
                let span = Some((chunk.from_ns, chunk.to_ns));
                Some(Resumed {
                    at: chunk.at + chunk.record,
                    head: None,
                    previous: op::CHUNK,
                    hole: Hole {
                        channels: chunk.channels.iter().copied().collect(),
                        ..Hole::new(offset, format!("a chunk is damaged ({what})"), span)
                    },
                })
            }
            Region::Chunk(_) => None,
            Region::Index(end) => Some(Resumed {
                at: end,
                head: None,
                previous: op::MESSAGE_INDEX,
                hole: Hole::without_loss(offset, format!("an index behind a chunk is damaged ({what})")),
            }),
            Region::Between(end) => Some(Resumed {
                at: end,
                head: None,
                previous: op::HEADER,
                hole: Hole::new(offset, what.to_owned(), None),
            }),
            Region::End => {
                // All chunks of the summary were read or told.
                self.contents.data_ended |= known.is_checked();
                None
            }
        }
    }

    /// Goes on at a place; returns the byte from which the input is to be read.
    fn resume(&mut self, place: Resumed) -> u64 {
        // A checksum over all of the data would be wrong.
        self.framing = framing_of(
            LinearReaderOptions::default()
                .with_skip_start_magic(true)
                .with_record_length_limit(MAX_RECORD),
            false,
            self.live,
        );
        let mut from = place.at;
        if let Some(head) = place.head {
            let room = self.framing.insert(head.len());
            room.copy_from_slice(&head);
            self.framing.notify_read(head.len());
            from += head.len() as u64;
        }
        self.contents.pass(place.at, place.previous, place.hole);
        self.bytes_read = from;
        from
    }
}
