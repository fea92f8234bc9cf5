//! The objects of a TDMS file: their paths, properties, and the raw data each has in a segment.

use super::DAQMX;
use crate::import::numbers::Kind;
use std::collections::HashMap;

/// Most objects of a file.
const OBJECTS: usize = 4096;

/// Reader over bytes of metadata.
pub(super) struct Bytes<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) is_big: bool,
}

const CUT: &str = "its metadata are longer than it says: damaged";

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.bytes.split_at_checked(count).ok_or(CUT)?;
        self.bytes = rest;
        Ok(taken)
    }

    fn array<const SIZE: usize>(&mut self) -> Result<[u8; SIZE], String> {
        let mut bytes: [u8; SIZE] = self.take(SIZE)?.try_into().map_err(|_| CUT)?;
        if self.is_big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub(super) fn u64(&mut self) -> Result<u64, String> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn text(&mut self) -> Result<String, String> {
        let length = self.u32()? as usize;
        Ok(String::from_utf8_lossy(self.take(length)?).into_owned())
    }
}

/// Type of an object's raw data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Type {
    Number(Kind),
    /// Seconds since 1904 and a fraction.
    Stamp,
    /// Skipped: this many bytes per value.
    Other(usize),
    /// Skipped: texts of this many bytes in all.
    Text(u64),
}

/// Raw data of an object in a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Index {
    pub(super) kind: Type,
    pub(super) count: u64,
}

impl Index {
    /// Size of one value \[bytes\]; `None` if the sizes differ.
    pub(super) fn size(&self) -> Option<usize> {
        match self.kind {
            Type::Number(kind) => Some(kind.size()),
            Type::Stamp => Some(16),
            Type::Other(size) => Some(size),
            Type::Text(_) => None,
        }
    }

    /// Size of all its values in a chunk \[bytes\].
    pub(super) fn bytes(&self) -> Option<u64> {
        match self.kind {
            Type::Text(bytes) => Some(bytes),
            _ => self.count.checked_mul(self.size()? as u64),
        }
    }
}

/// Value of a property that is used.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Property {
    Number(f64),
    Text(String),
    /// Nanoseconds since 1970.
    Stamp(i64),
}

/// Names of the properties that are used.
const USED: [&str; 7] = [
    "wf_increment",
    "wf_start_time",
    "wf_start_offset",
    "unit_string",
    "NI_UnitDescription",
    "NI_Scaling_Status",
    "NI_Number_Of_Scales",
];

/// A file, a group or a channel.
#[derive(Debug, Default)]
pub(super) struct Object {
    /// Names from the outside in: none for the file, one for a group, two for a channel.
    pub(super) path: Vec<String>,
    pub(super) index: Option<Index>,
    /// Index in the list of the segment, if it is there.
    place: usize,
    pub(super) properties: HashMap<String, Property>,
    /// Numeric values read so far.
    pub(super) values: Vec<f64>,
    /// Its stamps \[ns since 1970\].
    pub(super) stamps: Vec<i64>,
    /// Kinds of its raw data that were passed over.
    pub(super) is_passed_over: bool,
}

/// All objects of a file so far, and those with raw data in the segments from here on.
#[derive(Debug, Default)]
pub(super) struct Objects {
    pub(super) all: Vec<Object>,
    by_path: HashMap<String, usize>,
    /// Objects in the order of their raw data, with true if they have some.
    pub(super) list: Vec<(usize, bool)>,
    /// Number of values held by all of them.
    pub(super) held: usize,
}

impl Objects {
    /// Takes the metadata of a segment.
    pub(super) fn update(&mut self, metadata: &[u8], is_big: bool, is_new_list: bool) -> Result<(), String> {
        let mut bytes = Bytes {
            bytes: metadata,
            is_big,
        };
        if is_new_list {
            self.list.clear();
        }
        for _ in 0..bytes.u32()? {
            let path = bytes.text()?;
            let at = match self.by_path.get(&path) {
                Some(at) => *at,
                None if self.all.len() >= OBJECTS => {
                    return Err(format!("holds more than {OBJECTS} groups and channels"));
                }
                None => {
                    self.all.push(Object {
                        path: names(&path)?,
                        ..Object::default()
                    });
                    self.by_path.insert(path, self.all.len() - 1);
                    self.all.len() - 1
                }
            };
            let object = self.all.get_mut(at).ok_or(CUT)?;
            let has_data = match bytes.u32()? {
                u32::MAX => false,
                0 if object.index.is_none() => {
                    return Err(format!(
                        "{}: raw data as before, but there were none: damaged",
                        object.named()
                    ));
                }
                0 => true,
                0x1269 | 0x1369 => return Err(DAQMX.to_owned()),
                _ => {
                    object.index =
                        Some(index(&mut bytes).map_err(|what| format!("{}: {what}", object.named()))?);
                    true
                }
            };
            match self.list.get_mut(object.place) {
                Some((known, has)) if *known == at => *has = has_data,
                _ => {
                    object.place = self.list.len();
                    self.list.push((at, has_data));
                }
            }
            for _ in 0..bytes.u32()? {
                let name = bytes.text()?;
                let value = property(&mut bytes)?;
                if let (true, Some(value)) = (USED.contains(&name.as_str()), value) {
                    object.properties.insert(name, value);
                }
            }
        }
        Ok(())
    }
}

impl Object {
    /// Name in messages.
    pub(super) fn named(&self) -> String {
        match self.path.is_empty() {
            true => "the file".to_owned(),
            false => self.path.join("/"),
        }
    }

    pub(super) fn number(&self, name: &str) -> Option<f64> {
        match self.properties.get(name) {
            Some(Property::Number(number)) => Some(*number),
            _ => None,
        }
    }

    pub(super) fn text(&self, name: &str) -> Option<&str> {
        match self.properties.get(name) {
            Some(Property::Text(text)) => Some(text),
            _ => None,
        }
    }
}

/// `/'group'/'it''s'` as names.
fn names(path: &str) -> Result<Vec<String>, String> {
    let mut names = Vec::new();
    let mut rest = path;
    while !rest.is_empty() && rest != "/" {
        let refuse = || {
            format!(
                "{} is no path of an object: damaged",
                crate::import::lines::shown(path)
            )
        };
        rest = rest.strip_prefix("/'").ok_or_else(refuse)?;
        let mut name = String::new();
        loop {
            let (before, behind) = rest.split_once('\'').ok_or_else(refuse)?;
            name.push_str(before);
            // Two quotes encode one.
            match behind.strip_prefix('\'') {
                Some(behind) => {
                    name.push('\'');
                    rest = behind;
                }
                None => {
                    rest = behind;
                    break;
                }
            }
        }
        names.push(name);
    }
    Ok(names)
}

/// Type of a number in the format.
fn of_number(number: u32) -> Option<Type> {
    Some(match number {
        1 => Type::Number(Kind::I8),
        2 => Type::Number(Kind::I16),
        3 => Type::Number(Kind::I32),
        4 => Type::Number(Kind::I64),
        5 | 0x21 => Type::Number(Kind::U8),
        6 => Type::Number(Kind::U16),
        7 => Type::Number(Kind::U32),
        8 => Type::Number(Kind::U64),
        9 | 0x19 => Type::Number(Kind::F32),
        10 | 0x1a => Type::Number(Kind::F64),
        0x44 => Type::Stamp,
        0x0008_000c => Type::Other(8),
        0x0010_000d => Type::Other(16),
        0x20 => Type::Text(0),
        _ => return None,
    })
}

fn index(bytes: &mut Bytes<'_>) -> Result<Index, String> {
    let number = bytes.u32()?;
    let (dimension, count) = (bytes.u32()?, bytes.u64()?);
    let kind = match of_number(number) {
        Some(Type::Text(_)) => Type::Text(bytes.u64()?),
        Some(kind) => kind,
        None if number == u32::MAX => return Err(DAQMX.to_owned()),
        None => {
            return Err(format!(
                "values of type {number:#x}, which is not read: export it as text"
            ));
        }
    };
    if dimension != 1 {
        return Err(format!("has {dimension} dimensions: damaged"));
    }
    Ok(Index { kind, count })
}

/// Value of a property; `None` if it is not used.
fn property(bytes: &mut Bytes<'_>) -> Result<Option<Property>, String> {
    let number = bytes.u32()?;
    match of_number(number) {
        Some(Type::Text(_)) => Ok(Some(Property::Text(bytes.text()?))),
        Some(Type::Stamp) => {
            let is_big = bytes.is_big;
            let stamp = super::data::stamp(bytes.take(16)?, is_big);
            Ok(stamp.map(Property::Stamp))
        }
        Some(Type::Number(kind)) => {
            let taken = bytes.take(kind.size())?;
            let mut found = None;
            // A whole number beyond a double's is none of those that are used.
            let _ = kind.each(taken, !bytes.is_big, |value| found = Some(value));
            Ok(found.map(Property::Number))
        }
        Some(Type::Other(size)) => bytes.take(size).map(|_| None),
        // Nothing at all, and floats of ten to sixteen bytes, as LabVIEW keeps them.
        None if number == 0 => Ok(None),
        None => Err(format!(
            "a property of type {number:#x}, which is not known: damaged"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_and_their_quotes() {
        assert_eq!(names("/"), Ok(vec![]));
        assert_eq!(names("/'a'/'it''s'"), Ok(vec!["a".to_owned(), "it's".to_owned()]));
        assert_eq!(names("/''"), Ok(vec![String::new()]));
        for bad in ["a", "/a", "/'a", "/'a'b"] {
            assert!(names(bad).is_err(), "{bad}");
        }
    }
}
