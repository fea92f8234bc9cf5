//! Places of a file between two steps of reading, and their names.

use serde::{Deserialize, Serialize};
use std::fmt;

/// A place of a file: the same whenever it is read.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// Offset of the step \[bytes\].
    pub offset: u64,
    /// Number of steps before it at this offset, with data.
    pub taken: u64,
}

impl Place {
    /// Number of bytes of a place for another process.
    pub const BYTES: usize = 16;

    /// As bytes for another process.
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        ((u128::from(self.taken) << 64) | u128::from(self.offset)).to_le_bytes()
    }

    /// From such bytes.
    pub fn of_bytes(bytes: [u8; Self::BYTES]) -> Self {
        let both = u128::from_le_bytes(bytes);
        Self {
            offset: both as u64,
            taken: (both >> 64) as u64,
        }
    }

    /// From its text.
    pub fn parse(text: &str) -> Option<Self> {
        let (offset, taken) = text.split_once('+')?;
        Some(Self {
            offset: offset.parse().ok()?,
            taken: taken.parse().ok()?,
        })
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}+{}", self.offset, self.taken)
    }
}

/// Counts the steps of one file: a chunk is read in many, all at one offset. With one name for all, a step that went well
/// would clear a later one that crashes, and the file would never be set aside. Steps without data do not count.
#[derive(Debug, Default)]
pub struct Steps {
    offset: u64,
    taken: u64,
}

impl Steps {
    /// Place of the next step.
    pub fn next(&mut self, offset: u64) -> Place {
        if offset != self.offset {
            (self.offset, self.taken) = (offset, 0);
        }
        Place {
            offset,
            taken: self.taken,
        }
    }

    /// Notes that the step brought data.
    pub fn brought_something(&mut self) {
        self.taken += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_survives_text_and_bytes() {
        let place = Place {
            offset: u64::MAX - 1,
            taken: 7,
        };
        assert_eq!(Place::parse(&place.to_string()), Some(place));
        assert_eq!(Place::of_bytes(place.to_bytes()), place);
        assert_eq!(Place::parse("12+end"), None);
    }
}
