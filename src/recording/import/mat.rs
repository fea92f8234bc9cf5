//! MATLAB files of version 5 to 7 (`save -v6`, `-v7`): real numeric vectors and matrices.
//!
//! <https://www.mathworks.com/help/pdf_doc/matlab/matfile_format.pdf>. Own code, since one existing crate
//! prints to the terminal and drops variables silently, and another refuses files of `scipy.io.savemat`.

use super::numbers::Kind;
use super::stamp::{self, TimeUnit};
use super::{ImportError, MOST_VALUES, Signal, Stamps, Timing, is_time_name};
use flate2::read::ZlibDecoder;
use std::io::Read;
use std::sync::Arc;

/// Most bytes of one variable, unpacked.
const MOST_BYTES: u64 = 8 * MOST_VALUES as u64 + 4096;
/// Most channels.
const CHANNELS: usize = 1024;

/// Content of a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Variables {
    /// Vectors, and the columns of matrices (rows, if those are longer).
    pub signals: Vec<Signal>,
    /// Items left out, one sentence each.
    pub skipped: Vec<String>,
}

/// Reads every numeric variable. `time`: the variable with the stamps; `None`: one named as a time, if
/// `find_time`.
///
/// # Errors
/// It is no such file, damaged, or of a version that is not read.
pub fn read(
    mut from: impl Read,
    time: Option<&str>,
    find_time: bool,
    unit: Option<TimeUnit>,
) -> Result<Variables, ImportError> {
    let is_little = header(&mut from)?;
    let mut found = Variables::default();
    let mut arrays = Vec::new();
    let mut held = 0;
    for number in 1.. {
        let place = format!("variable {number}");
        let Some(bytes) = element(&mut from, is_little).map_err(|what| ImportError::at(&place, what))? else {
            break;
        };
        let Some(bytes) = bytes else { continue };
        let matrix = Cursor {
            bytes: &bytes,
            is_little,
        }
        .matrix()
        .map_err(|what| ImportError::at(&place, what))?;
        match matrix {
            Matrix::Numbers(array) => {
                held += array.values.len();
                if held > MOST_VALUES {
                    return Err(ImportError::too_long());
                }
                arrays.push(array);
            }
            Matrix::Other(what) => found.skipped.push(what),
        }
    }
    let is_time = |array: &Array| match time {
        Some(name) => array.name == name,
        None => find_time && is_time_name(&array.name) && array.values.len() > 1,
    };
    let stamps = match arrays.iter().position(is_time) {
        Some(at) => {
            let array = arrays.remove(at);
            Some(Arc::new(stamp::from_numbers(&array.name, &array.values, unit)?))
        }
        None => match time {
            Some(name) => return Err(missing(name, &arrays, &found.skipped)),
            None => None,
        },
    };
    for array in arrays {
        spread(array, stamps.as_ref(), &mut found)?;
    }
    if found.signals.is_empty() {
        return Err(ImportError::new(format!(
            "holds no numeric vector; it holds {}. Assign the samples to a variable of their own before saving",
            if found.skipped.is_empty() {
                "nothing".to_owned()
            } else {
                found.skipped.join(", ")
            }
        )));
    }
    Ok(found)
}

fn missing(name: &str, arrays: &[Array], skipped: &[String]) -> ImportError {
    let known: Vec<&str> = arrays
        .iter()
        .map(|array| array.name.as_str())
        .chain(skipped.iter().map(String::as_str))
        .collect();
    ImportError::new(format!("no variable {name:?}; there is: {}", known.join(", ")))
}

/// True if numbers are little endian; an error for a file of another kind or version.
fn header(from: &mut impl Read) -> Result<bool, ImportError> {
    let mut bytes = Vec::new();
    from.by_ref()
        .take(128)
        .read_to_end(&mut bytes)
        .map_err(|error| ImportError::unreadable(&error))?;
    let is_hdf = bytes.starts_with(b"\x89HDF\r\n\x1a\n");
    if is_hdf || bytes.starts_with(b"MATLAB 7.3") {
        return Err(ImportError::new(
            "is a MATLAB file of version 7.3 (HDF5), which is not read: save it with save('x.mat', '-v7')",
        ));
    }
    match (bytes.get(124..126), bytes.get(126..128)) {
        (Some([0, 1]), Some(b"IM")) => Ok(true),
        (Some([1, 0]), Some(b"MI")) => Ok(false),
        (_, Some(b"IM" | b"MI")) => Err(ImportError::new(
            "is a MATLAB file of an unknown version: save it with save('x.mat', '-v7')",
        )),
        _ => Err(ImportError::new(
            "is no MATLAB file of version 5 to 7 (one of version 4?): save it with save('x.mat', '-v7')",
        )),
    }
}

/// Bytes of the next variable, unpacked; `None` within for another element; `None` at the end.
fn element(from: &mut impl Read, is_little: bool) -> Result<Option<Option<Vec<u8>>>, String> {
    let mut tag = Vec::new();
    from.by_ref()
        .take(8)
        .read_to_end(&mut tag)
        .map_err(|error| error.to_string())?;
    let (kind, bytes) = match tag[..] {
        [] => return Ok(None),
        [a, b, c, d, e, f, g, h] => (word([a, b, c, d], is_little), word([e, f, g, h], is_little)),
        _ => return Err(CUT.to_owned()),
    };
    let mut raw = from.by_ref().take(u64::from(bytes));
    let whole = match kind {
        COMPRESSED => {
            let mut unpacked = Vec::new();
            ZlibDecoder::new(&mut raw)
                .take(MOST_BYTES + 1)
                .read_to_end(&mut unpacked)
                .map_err(|error| format!("cannot be unpacked, it is damaged or cut short ({error})"))?;
            if unpacked.len() as u64 > MOST_BYTES {
                return Err(format!("unpacks to more than {MOST_BYTES} bytes"));
            }
            let inner = element_once(unpacked, is_little)?;
            std::io::copy(&mut raw, &mut std::io::sink()).map_err(|error| error.to_string())?;
            inner
        }
        MATRIX => Some(exactly(&mut raw, u64::from(bytes))?),
        _ => {
            std::io::copy(&mut raw, &mut std::io::sink()).map_err(|error| error.to_string())?;
            None
        }
    };
    if raw.limit() > 0 {
        return Err(CUT.to_owned());
    }
    Ok(Some(whole))
}

/// The matrix in an unpacked element, which may not contain a packed element again.
fn element_once(mut unpacked: Vec<u8>, is_little: bool) -> Result<Option<Vec<u8>>, String> {
    let mut cursor = Cursor {
        bytes: &unpacked,
        is_little,
    };
    let (kind, inner) = cursor.part()?;
    // In place: a second copy would be as large as the limit.
    let begin = inner.as_ptr() as usize - unpacked.as_ptr() as usize;
    let end = begin + inner.len();
    unpacked.truncate(end);
    unpacked.drain(..begin);
    Ok((kind == MATRIX).then_some(unpacked))
}

fn exactly(from: &mut impl Read, wanted: u64) -> Result<Vec<u8>, String> {
    if wanted > MOST_BYTES {
        return Err(format!("says it has {wanted} bytes, more than {MOST_BYTES}"));
    }
    let mut bytes = Vec::new();
    from.read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    match bytes.len() as u64 == wanted {
        true => Ok(bytes),
        false => Err(CUT.to_owned()),
    }
}

const CUT: &str = "the file ends within it: it is cut short";
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;

fn word(bytes: [u8; 4], is_little: bool) -> u32 {
    if is_little {
        u32::from_le_bytes(bytes)
    } else {
        u32::from_be_bytes(bytes)
    }
}

/// A numeric array, column by column.
struct Array {
    name: String,
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

enum Matrix {
    Numbers(Array),
    Other(String),
}

/// Reader over the bytes of one variable.
struct Cursor<'a> {
    bytes: &'a [u8],
    is_little: bool,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self
            .bytes
            .split_at_checked(count)
            .ok_or("its parts are longer than it is: damaged")?;
        self.bytes = rest;
        Ok(taken)
    }

    fn word(&mut self) -> Result<u32, String> {
        let bytes = <[u8; 4]>::try_from(self.take(4)?).map_err(|error| error.to_string())?;
        Ok(word(bytes, self.is_little))
    }

    /// Kind and bytes of the next part; small ones are stored in their own tag.
    fn part(&mut self) -> Result<(u32, &'a [u8]), String> {
        let first = self.word()?;
        if first >> 16 != 0 {
            let (count, kind) = ((first >> 16) as usize, first & 0xffff);
            let bytes = self
                .take(4)?
                .get(..count)
                .ok_or("a small part of more than four bytes: damaged")?;
            return Ok((kind, bytes));
        }
        let count = self.word()? as usize;
        let bytes = self.take(count)?;
        let padding = (8 - count % 8) % 8;
        // The last part of a file may lack its padding.
        self.bytes = self.bytes.get(padding..).unwrap_or_default();
        Ok((first, bytes))
    }

    fn matrix(&mut self) -> Result<Matrix, String> {
        let (_, flags) = self.part()?;
        let flags = match flags {
            [a, b, c, d, ..] => word([*a, *b, *c, *d], self.is_little),
            _ => return Err("has no flags: damaged".to_owned()),
        };
        let (kind, bytes) = self.part()?;
        let sizes = numbers(kind, bytes, self.is_little)?;
        let (kind, bytes) = self.part()?;
        if kind != 1 && kind != 16 {
            return Err("has no name: damaged".to_owned());
        }
        let name = super::lines::text(bytes).into_owned();
        let class = flags & 0xff;
        if !(6..=15).contains(&class) {
            const CLASSES: [&str; 5] = [
                "a cell array",
                "a structure",
                "an object",
                "text",
                "a sparse matrix",
            ];
            let what = CLASSES
                .get((class as usize).wrapping_sub(1))
                .unwrap_or(&"of an unknown class");
            return Ok(Matrix::Other(format!("{name} ({what})")));
        }
        if flags & 0x800 != 0 {
            return Ok(Matrix::Other(format!("{name} (complex)")));
        }
        let [rows, columns] = sizes[..] else {
            return Ok(Matrix::Other(format!("{name} (of {} dimensions)", sizes.len())));
        };
        let (kind, bytes) = self.part()?;
        let values = numbers(kind, bytes, self.is_little)?;
        let (rows, columns) = (rows as usize, columns as usize);
        if rows.checked_mul(columns) != Some(values.len()) {
            return Err(format!(
                "{name}: {} numbers for {rows} x {columns}: damaged",
                values.len()
            ));
        }
        Ok(Matrix::Numbers(Array {
            name,
            rows,
            columns,
            values,
        }))
    }
}

/// Numbers of any stored kind as doubles; integers that a double cannot represent are an error.
fn numbers(kind: u32, bytes: &[u8], is_little: bool) -> Result<Vec<f64>, String> {
    let kind = match kind {
        1 => Kind::I8,
        2 => Kind::U8,
        3 => Kind::I16,
        4 => Kind::U16,
        5 => Kind::I32,
        6 => Kind::U32,
        7 => Kind::F32,
        9 => Kind::F64,
        12 => Kind::I64,
        13 => Kind::U64,
        other => return Err(format!("holds numbers of an unknown kind ({other}): damaged")),
    };
    if !bytes.len().is_multiple_of(kind.size()) {
        return Err("its bytes are no whole number of numbers: damaged".to_owned());
    }
    if bytes.len() / kind.size() > MOST_VALUES {
        return Err(ImportError::too_long().to_string());
    }
    let mut values = Vec::with_capacity(bytes.len() / kind.size());
    kind.each(bytes, is_little, |value| values.push(value))
        .map_err(|inexact| inexact.to_string())?;
    Ok(values)
}

/// Appends the channels of a variable to the others.
fn spread(array: Array, stamps: Option<&Arc<Stamps>>, to: &mut Variables) -> Result<(), ImportError> {
    let Array {
        name,
        rows,
        columns,
        values,
    } = array;
    let (length, count) = (rows.max(columns), rows.min(columns));
    if length < 2 {
        let what = match values.first() {
            Some(value) => format!("{name} (the number {value})"),
            None => format!("{name} (empty)"),
        };
        to.skipped.push(what);
        return Ok(());
    }
    if to.signals.len() + count > CHANNELS {
        return Err(ImportError::at(&name, format!("more than {CHANNELS} channels")));
    }
    let timing = match stamps {
        Some(stamps) if stamps.nanos.len() == length => Timing::Stamps(Arc::clone(stamps)),
        Some(stamps) => {
            to.skipped.push(format!(
                "{name} ({length} numbers, the time has {})",
                stamps.nanos.len()
            ));
            return Ok(());
        }
        None => Timing::Unknown,
    };
    let is_long = rows >= columns;
    let mut values = values;
    for channel in 0..count {
        let at = |sample: usize| {
            if is_long {
                channel * rows + sample
            } else {
                sample * rows + channel
            }
        };
        let (label, values) = match (count, is_long) {
            (1, _) => (name.clone(), std::mem::take(&mut values)),
            (_, true) => (format!("{name}(:,{})", channel + 1), gather(&values, length, at)),
            (_, false) => (format!("{name}({},:)", channel + 1), gather(&values, length, at)),
        };
        to.signals.push(Signal {
            name: label,
            number: to.signals.len() + 1,
            unit: None,
            timing: timing.clone(),
            values,
        });
    }
    Ok(())
}

fn gather(values: &[f64], length: usize, at: impl Fn(usize) -> usize) -> Vec<f64> {
    (0..length)
        .filter_map(|sample| values.get(at(sample)).copied())
        .collect()
}
