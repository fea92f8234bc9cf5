//! Raw data of TDMS segments to numbers: chunks of channels one after another, or interleaved.

use super::CUT;
use super::metadata::{Index, Objects, Type};
use crate::import::MOST_VALUES;
use std::io::Read;

/// Number of bytes read at once.
const BLOCK: usize = 1 << 16;
/// Seconds from 1904, where LabVIEW's clock begins, to 1970.
const SINCE_1904_S: i64 = 2_082_844_800;

/// Amount of raw data left of a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Left {
    Bytes(u64),
    /// Up to the end of the file: the recorder did not finish the segment.
    ToTheEnd,
}

/// Raw data of a segment.
pub(super) struct Raw<'a, R> {
    pub(super) from: &'a mut R,
    pub(super) left: Left,
    pub(super) is_big: bool,
}

impl<R: Read> Raw<'_, R> {
    /// Appends the data to their objects; returns the number of bytes left over where the recorder did not
    /// finish.
    pub(super) fn read(&mut self, objects: &mut Objects, is_interleaved: bool) -> Result<u64, String> {
        let with_data: Vec<(usize, Index)> = objects
            .list
            .iter()
            .filter(|(_, has)| *has)
            .filter_map(|(at, _)| Some((*at, objects.all.get(*at)?.index?)))
            .filter(|(_, index)| index.bytes() != Some(0))
            .collect();
        let sizes = with_data.iter().map(|(_, index)| index.bytes());
        let chunk = sizes.sum::<Option<u64>>().filter(|bytes| *bytes < u64::MAX / 2);
        let chunk = chunk.ok_or("says it has more raw data than there could be: damaged")?;
        if chunk == 0 {
            return Ok(0);
        }
        loop {
            match self.left {
                Left::Bytes(0) => return Ok(0),
                Left::Bytes(left) if left < chunk => {
                    return Err(format!(
                        "has {left} bytes of raw data left, no whole chunk of {chunk}: damaged"
                    ));
                }
                _ => {}
            }
            let missing = match is_interleaved {
                true => self.rows(objects, &with_data)?,
                false => self.one_after_another(objects, &with_data)?,
            };
            match (missing, self.left) {
                (None, _) => {}
                (Some(lost), Left::ToTheEnd) => return Ok(lost),
                (Some(_), Left::Bytes(_)) => return Err(CUT.to_owned()),
            }
        }
    }

    /// Skips the rest; returns true if another segment may follow.
    pub(super) fn pass(self) -> Result<bool, String> {
        let Left::Bytes(left) = self.left else {
            return Ok(false);
        };
        let passed = std::io::copy(&mut self.from.take(left), &mut std::io::sink());
        match passed.map_err(|error| format!("cannot be read: {error}"))? == left {
            true => Ok(true),
            false => Err(CUT.to_owned()),
        }
    }

    /// Reads `bytes` bytes, fewer where the file ends.
    fn block(&mut self, bytes: usize, into: &mut Vec<u8>) -> Result<(), String> {
        into.clear();
        self.from
            .by_ref()
            .take(bytes as u64)
            .read_to_end(into)
            .map_err(|error| format!("cannot be read: {error}"))?;
        if let Left::Bytes(left) = &mut self.left {
            *left -= into.len() as u64;
        }
        Ok(())
    }

    /// Reads a chunk of one object after another; returns the number of bytes of an incomplete last value
    /// where the file ends.
    fn one_after_another(
        &mut self,
        objects: &mut Objects,
        with_data: &[(usize, Index)],
    ) -> Result<Option<u64>, String> {
        let mut block = Vec::new();
        for (at, index) in with_data {
            let mut left = index.bytes().unwrap_or_default();
            let size = index.size().unwrap_or(1).max(1);
            while left > 0 {
                let wanted = usize::try_from(left)
                    .unwrap_or(usize::MAX)
                    .min(BLOCK / size * size);
                self.block(wanted, &mut block)?;
                let whole = block.len() / size * size;
                objects.push(
                    *at,
                    index.kind,
                    block.get(..whole).unwrap_or_default(),
                    self.is_big,
                )?;
                if block.len() < wanted {
                    return Ok(Some((block.len() - whole) as u64));
                }
                left -= wanted as u64;
            }
        }
        Ok(None)
    }

    /// Reads a chunk of rows with a value of each object; returns the number of bytes of an incomplete last
    /// row where the file ends.
    fn rows(&mut self, objects: &mut Objects, with_data: &[(usize, Index)]) -> Result<Option<u64>, String> {
        let mut sizes = Vec::with_capacity(with_data.len());
        for (_, index) in with_data {
            sizes.push(
                index
                    .size()
                    .ok_or("holds interleaved texts, which are not read")?,
            );
        }
        let rows = with_data.first().map_or(0, |(_, index)| index.count);
        if with_data.iter().any(|(_, index)| index.count != rows) {
            return Err("holds interleaved channels of different lengths: damaged".to_owned());
        }
        let row = sizes.iter().sum::<usize>().max(1);
        let mut left = rows;
        let mut block = Vec::new();
        while left > 0 {
            let count = left.min((BLOCK / row).max(1) as u64);
            // A row has at most 4096 values of 16 bytes.
            let wanted = count as usize * row;
            self.block(wanted, &mut block)?;
            let whole = block.len() / row * row;
            for values in block.get(..whole).unwrap_or_default().chunks_exact(row) {
                let mut begin = 0;
                for ((at, index), size) in with_data.iter().zip(&sizes) {
                    let value = values.get(begin..begin + size).unwrap_or_default();
                    objects.push(*at, index.kind, value, self.is_big)?;
                    begin += size;
                }
            }
            if block.len() < wanted {
                return Ok(Some((block.len() - whole) as u64));
            }
            left -= count;
        }
        Ok(None)
    }
}

impl Objects {
    /// Appends whole values to an object.
    fn push(&mut self, at: usize, kind: Type, bytes: &[u8], is_big: bool) -> Result<(), String> {
        let Some(object) = self.all.get_mut(at) else {
            return Ok(());
        };
        let before = object.values.len() + object.stamps.len();
        match kind {
            Type::Number(kind) => {
                if !object.stamps.is_empty() {
                    return Err(format!("{}: numbers behind stamps: damaged", object.named()));
                }
                let values = &mut object.values;
                let pushed = kind.each(bytes, !is_big, |value| values.push(value));
                pushed.map_err(|inexact| format!("{} {inexact}", object.named()))?;
            }
            Type::Stamp => {
                if !object.values.is_empty() {
                    return Err(format!("{}: stamps behind numbers: damaged", object.named()));
                }
                for bytes in bytes.chunks_exact(16) {
                    let nanos = stamp(bytes, is_big);
                    let nanos =
                        nanos.ok_or_else(|| format!("{}: a time beyond 292 years", object.named()))?;
                    object.stamps.push(nanos);
                }
            }
            Type::Other(_) | Type::Text(_) => object.is_passed_over = true,
        }
        self.held += object.values.len() + object.stamps.len() - before;
        match self.held <= MOST_VALUES {
            true => Ok(()),
            false => Err(format!(
                "holds more than {MOST_VALUES} values by here: split the file"
            )),
        }
    }
}

/// Converts a stamp of 16 bytes to nanoseconds since 1970: a fraction of 2^-64 s and the seconds since 1904,
/// in reverse order in big endian; `None` if beyond 292 years.
pub(super) fn stamp(bytes: &[u8], is_big: bool) -> Option<i64> {
    let mut bytes: [u8; 16] = bytes.try_into().ok()?;
    if is_big {
        bytes.reverse();
    }
    let both = u128::from_le_bytes(bytes);
    let (seconds, fraction) = ((both >> 64) as i64, both & u128::from(u64::MAX));
    let nanos = ((fraction * 1_000_000_000 + (1 << 63)) >> 64) as i64;
    seconds
        .checked_sub(SINCE_1904_S)?
        .checked_mul(1_000_000_000)?
        .checked_add(nanos)
}
