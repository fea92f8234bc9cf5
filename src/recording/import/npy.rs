//! NumPy arrays (`numpy.save`): real numbers of one to three dimensions, either order, either byte order.
//!
//! <https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>. Own code, since existing crates
//! allocate arrays of the size in the header before a byte of them is read.

use super::numbers::Kind;
use super::{ImportError, MOST_VALUES, Signal, Timing};
use std::io::Read;

/// Longest header read \[bytes\].
const LONGEST: usize = 1 << 16;
/// Most channels.
const CHANNELS: usize = 4096;
/// Reads an array: its longest dimension is time, each index of the others a channel, named as NumPy would
/// index it.
///
/// # Errors
/// It is no such array, damaged, or too large.
pub fn read(mut from: impl Read) -> Result<Vec<Signal>, ImportError> {
    let header = Header::read(&mut from)?;
    let layout = Layout::of(&header)?;
    let mut signals: Vec<Signal> = (0..layout.channels())
        .map(|channel| Signal {
            name: layout.name(channel),
            number: channel + 1,
            unit: None,
            timing: Timing::Unknown,
            values: Vec::new(),
        })
        .collect();
    let mut place = 0;
    let push = |value| {
        // In either order the samples of one channel come in the order of time.
        if let Some(signal) = signals.get_mut(layout.channel(place)) {
            signal.values.push(value);
        }
        place += 1;
    };
    let read = header
        .kind
        .read(&mut from, layout.numbers(), header.is_little, push)?;
    if read < layout.numbers() {
        return Err(ImportError::new(format!(
            "ends after {read} of {} numbers: it is cut short",
            layout.numbers()
        )));
    }
    if from
        .read(&mut [0])
        .map_err(|error| ImportError::unreadable(&error))?
        > 0
    {
        return Err(ImportError::new(
            "has more behind its array: another one, or it is damaged; save each array in a file of its own",
        ));
    }
    Ok(signals)
}

/// Content before the numbers.
struct Header {
    kind: Kind,
    is_little: bool,
    is_fortran: bool,
    shape: Vec<usize>,
}

impl Header {
    fn read(from: &mut impl Read) -> Result<Self, ImportError> {
        let short = || ImportError::new("ends within its header: it is cut short");
        let mut take = |count: usize| {
            let mut bytes = Vec::new();
            from.by_ref()
                .take(count as u64)
                .read_to_end(&mut bytes)
                .map_err(|error| ImportError::unreadable(&error))?;
            match bytes.len() == count {
                true => Ok(bytes),
                false => Err(short()),
            }
        };
        let lead = take(8)?;
        if !lead.starts_with(b"\x93NUMPY") {
            return Err(ImportError::new("is no NumPy array"));
        }
        let length = match lead.get(6) {
            Some(1) => {
                let bytes = take(2)?;
                bytes
                    .iter()
                    .rev()
                    .fold(0, |sum, byte| sum << 8 | usize::from(*byte))
            }
            Some(2 | 3) => {
                let bytes = take(4)?;
                bytes
                    .iter()
                    .rev()
                    .fold(0, |sum, byte| sum << 8 | usize::from(*byte))
            }
            version => {
                return Err(ImportError::new(format!(
                    "is a NumPy array of version {}: 1 to 3 are read",
                    version.copied().unwrap_or_default()
                )));
            }
        };
        if length > LONGEST {
            return Err(ImportError::new(format!(
                "has a header of more than {LONGEST} bytes: damaged"
            )));
        }
        let text = take(length)?;
        Self::parse(&super::lines::text(&text))
    }

    /// Parses a header dictionary: `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }`.
    fn parse(text: &str) -> Result<Self, ImportError> {
        let damaged = |what: &str| ImportError::new(format!("its header {what}: damaged"));
        let behind = |key: &str| {
            let quoted = [format!("'{key}'"), format!("\"{key}\"")];
            let found = quoted.iter().find_map(|quoted| text.split_once(quoted.as_str()));
            let (_, rest) = found.ok_or_else(|| damaged(&format!("has no {key}")))?;
            let rest = rest.trim_start().strip_prefix(':');
            rest.map(str::trim_start)
                .ok_or_else(|| damaged(&format!("has no {key}")))
        };
        let descr = behind("descr")?;
        if descr.starts_with('[') {
            return Err(ImportError::new(
                "holds records of several fields: save one field, numpy.save('x.npy', a['field'])",
            ));
        }
        let quote = descr.chars().next().filter(|quote| matches!(quote, '\'' | '"'));
        let descr = quote.and_then(|quote| descr.get(1..)?.split_once(quote));
        let (descr, _) = descr.ok_or_else(|| damaged("has no type"))?;
        let is_fortran = behind("fortran_order")?.starts_with("True");
        let shape = behind("shape")?
            .strip_prefix('(')
            .and_then(|rest| rest.split_once(')'));
        let (shape, _) = shape.ok_or_else(|| damaged("has no shape"))?;
        let sizes = shape.split(',').map(str::trim).filter(|size| !size.is_empty());
        // Python 2 wrote long numbers with an L.
        let sizes = sizes.map(|size| size.trim_end_matches('L').parse::<usize>());
        let shape: Result<Vec<usize>, _> = sizes.collect();
        let (kind, is_little) = kind(descr)?;
        Ok(Self {
            kind,
            is_little,
            is_fortran,
            shape: shape.map_err(|_| damaged("has a shape of no numbers"))?,
        })
    }
}

/// Kind of the numbers of a type string, and true if they are little endian.
fn kind(descr: &str) -> Result<(Kind, bool), ImportError> {
    let (order, rest) = match descr.split_at_checked(1) {
        Some((order @ ("<" | ">" | "|" | "="), rest)) => (order, rest),
        _ => ("<", descr),
    };
    let kind = match rest {
        "f2" => Kind::F16,
        "f4" => Kind::F32,
        "f8" => Kind::F64,
        "i1" => Kind::I8,
        "i2" => Kind::I16,
        "i4" => Kind::I32,
        "i8" => Kind::I64,
        "u1" | "b1" => Kind::U8,
        "u2" => Kind::U16,
        "u4" => Kind::U32,
        "u8" => Kind::U64,
        _ => {
            let what = match rest.chars().next() {
                Some('c') => "complex numbers",
                Some('O') => "Python objects",
                Some('S' | 'U' | 'a') => "text",
                Some('M' | 'm') => "dates",
                Some('f') => "floats of another size than 16, 32 or 64 bits",
                _ => "something else than numbers",
            };
            return Err(ImportError::new(format!(
                "holds {what} ({}): save real numbers, numpy.save('x.npy', a.astype('f8'))",
                super::lines::shown(descr)
            )));
        }
    };
    Ok((kind, order != ">"))
}

/// Assignment of numbers to channels.
struct Layout {
    shape: Vec<usize>,
    /// Distance between neighbours along each dimension, in numbers.
    strides: Vec<usize>,
    /// Index of the time dimension.
    time: usize,
    numbers: usize,
}

impl Layout {
    fn of(header: &Header) -> Result<Self, ImportError> {
        let shape = header.shape.clone();
        if shape.is_empty() || shape.len() > 3 {
            return Err(ImportError::new(format!(
                "has {} dimensions: arrays of one to three are read",
                shape.len()
            )));
        }
        let numbers = shape
            .iter()
            .try_fold(1_usize, |product, size| product.checked_mul(*size));
        let numbers = numbers
            .filter(|numbers| *numbers <= MOST_VALUES)
            .ok_or_else(ImportError::too_long)?;
        // The first of several equally long ones, as rows are time in a table.
        let longest = shape.iter().copied().max().unwrap_or_default();
        let time = shape.iter().position(|size| *size == longest).unwrap_or_default();
        let mut strides = vec![1; shape.len()];
        let order: Vec<usize> = match header.is_fortran {
            true => (0..shape.len()).collect(),
            false => (0..shape.len()).rev().collect(),
        };
        let mut stride = 1_usize;
        for dimension in order {
            strides[dimension] = stride;
            stride = stride.saturating_mul(shape[dimension]);
        }
        let layout = Self {
            shape,
            strides,
            time,
            numbers,
        };
        if longest < 2 {
            return Err(ImportError::new(format!(
                "holds {numbers} numbers, which is no signal"
            )));
        }
        if layout.channels() > CHANNELS {
            return Err(ImportError::new(format!(
                "has {} channels along its shorter dimensions: at most {CHANNELS} are read",
                layout.channels()
            )));
        }
        Ok(layout)
    }

    fn numbers(&self) -> usize {
        self.numbers
    }

    /// Dimensions other than time.
    fn others(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.shape.len()).filter(|dimension| *dimension != self.time)
    }

    fn channels(&self) -> usize {
        self.others().map(|dimension| self.shape[dimension]).product()
    }

    /// Channel of the number at a place in the file; the last index runs fastest.
    fn channel(&self, place: usize) -> usize {
        self.others().fold(0, |channel, dimension| {
            let size = self.shape[dimension].max(1);
            channel * size + place / self.strides[dimension].max(1) % size
        })
    }

    /// `[3,:,0]`, counted from 0 as NumPy does.
    fn name(&self, mut channel: usize) -> String {
        let mut indices = vec![":".to_owned(); self.shape.len()];
        for dimension in self.others().collect::<Vec<_>>().into_iter().rev() {
            let size = self.shape[dimension].max(1);
            indices[dimension] = (channel % size).to_string();
            channel /= size;
        }
        match self.shape.len() {
            1 => "samples".to_owned(),
            _ => format!("[{}]", indices.join(",")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, numbers: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(numbers);
        bytes
    }

    #[test]
    fn what_is_no_signal_is_refused_by_name() {
        let refused = |header: &str| read(file(header, &[0; 64]).as_slice()).unwrap_err().to_string();
        let of = |descr: &str, shape: &str| {
            refused(&format!(
                "{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n"
            ))
        };
        assert!(of("<c16", "(4,)").contains("complex"));
        assert!(of("|O", "(4,)").contains("Python objects"));
        assert!(of("<f8", "(4000000000, 4000000000, 4)").contains("more than"));
        assert!(of("<f8", "(2, 2, 1, 1)").contains("4 dimensions"));
        assert!(of("<f8", "()").contains("0 dimensions"));
        assert!(of("<f8", "(9,)").contains("cut short"));
        assert!(of("<f8", "(4,)").contains("more behind its array"));
        assert!(of("<f8", "(100, 100)").contains("after 8 of 10000 numbers"));
        assert!(
            refused("{'descr': [('t', '<f8')], 'fortran_order': False, 'shape': (3,)}").contains("fields")
        );
        assert!(refused("{}").contains("damaged"));
        assert!(
            read(&b"\x93NUMPY\x09\x00"[..])
                .unwrap_err()
                .to_string()
                .contains("version 9")
        );
        assert!(read(&b"\x93NUMPY\x02\x00\xff\xff\xff\xff"[..]).is_err());
    }

    #[test]
    fn either_order_gives_the_same_channels() {
        let numbers = |order: [u8; 6]| {
            read(
                file(
                    &format!(
                        "{{'descr': '|u1', 'fortran_order': {}, 'shape': (3, 2), }}",
                        if order[1] == 1 { "False" } else { "True" }
                    ),
                    &order,
                )
                .as_slice(),
            )
        };
        let rows = numbers([0, 1, 2, 3, 4, 5]).unwrap();
        assert_eq!((rows[0].name.as_str(), rows[1].name.as_str()), ("[:,0]", "[:,1]"));
        assert_eq!(
            (rows[0].values.clone(), rows[1].values.clone()),
            (vec![0.0, 2.0, 4.0], vec![1.0, 3.0, 5.0])
        );
        let columns = numbers([0, 2, 4, 1, 3, 5]).unwrap();
        assert_eq!(rows, columns);
    }
}
