//! LabVIEW's binary measurements (`.tdms`): segments of metadata and raw data, each adding to the channels before.
//!
//! <https://www.ni.com/en/support/documentation/supplemental/07/tdms-file-format-internal-structure.html>.
//! Own code, since one existing crate allocates the size in a length field before reading a byte, and another
//! fails where a recorder was switched off.
//!
//! * `metadata` the objects of a segment, their properties, and where their raw data lie
//! * `data`     raw data to numbers
//! * `channels` objects to signals

mod channels;
mod data;
mod metadata;

use super::stamp::TimeUnit;
use super::{ImportError, Signal};
use data::{Left, Raw};
use metadata::Objects;
use std::io::Read;

/// Content of a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Groups {
    /// Numeric channels.
    pub signals: Vec<Signal>,
    /// Items left out, one sentence each.
    pub skipped: Vec<String>,
}

/// Most bytes of a segment's metadata.
const METADATA: u64 = 1 << 24;

/// Bits of a segment's table of contents.
const HAS_METADATA: u32 = 1 << 1;
const IS_NEW_LIST: u32 = 1 << 2;
const HAS_RAW: u32 = 1 << 3;
const IS_INTERLEAVED: u32 = 1 << 5;
const IS_BIG: u32 = 1 << 6;
const HAS_DAQMX: u32 = 1 << 7;

/// Reads every numeric channel. `time`: the channel with the stamps; `None`: one named as a time, if
/// `find_time`.
///
/// # Errors
/// It is no such file, damaged, cut short, or holds raw data of a kind that is not read.
pub fn read(
    mut from: impl Read,
    time: Option<&str>,
    find_time: bool,
    unit: Option<TimeUnit>,
) -> Result<Groups, ImportError> {
    let mut objects = Objects::default();
    let mut skipped = Vec::new();
    for number in 1_u64.. {
        let place = format!("segment {number}");
        let refuse = |what: String| ImportError::at(&place, what);
        let Some(segment) = Segment::read(&mut from).map_err(refuse)? else {
            break;
        };
        if segment.toc & HAS_DAQMX != 0 {
            return Err(refuse(DAQMX.to_owned()));
        }
        let is_big = segment.toc & IS_BIG != 0;
        if segment.metadata > METADATA {
            return Err(refuse(format!(
                "has {} bytes of metadata: damaged",
                segment.metadata
            )));
        }
        let metadata = take(&mut from, segment.metadata)?;
        if metadata.len() as u64 != segment.metadata {
            match segment.raw {
                // The recorder stopped while it began a segment.
                None => {
                    skipped.push(format!("{place}, which the recorder did not finish"));
                    break;
                }
                Some(_) => return Err(refuse(CUT.to_owned())),
            }
        }
        if segment.toc & HAS_METADATA != 0 {
            objects
                .update(&metadata, is_big, segment.toc & IS_NEW_LIST != 0)
                .map_err(refuse)?;
        }
        let mut raw = Raw {
            from: &mut from,
            left: segment.raw.map_or(Left::ToTheEnd, Left::Bytes),
            is_big,
        };
        if segment.toc & HAS_RAW != 0 {
            let is_interleaved = segment.toc & IS_INTERLEAVED != 0;
            let lost = raw.read(&mut objects, is_interleaved).map_err(refuse)?;
            if lost > 0 {
                skipped.push(format!(
                    "{place}: {lost} bytes at the end, which the recorder did not finish"
                ));
            }
        }
        if !raw.pass().map_err(refuse)? {
            break;
        }
    }
    channels::signals(objects, skipped, time, find_time, unit)
}

const CUT: &str = "the file ends within it: it is cut short";
const DAQMX: &str = "holds raw data of DAQmx, numbers of the hardware with a scale beside them, which is not read: log with \
                     \"scaled data\", or export it as text";

/// The lead-in of a segment.
struct Segment {
    toc: u32,
    metadata: u64,
    /// Size of the raw data \[bytes\]; `None` if the recorder did not finish the segment.
    raw: Option<u64>,
}

impl Segment {
    /// Reads the next one; `None` at the end of the file.
    fn read(from: &mut impl Read) -> Result<Option<Self>, String> {
        let bytes = take(from, 28).map_err(|error| error.to_string())?;
        if bytes.is_empty() {
            return Ok(None);
        }
        if bytes.starts_with(b"TDSh") {
            return Err("is the index of a TDMS file: give the .tdms beside it".to_owned());
        }
        if !bytes.starts_with(b"TDSm") {
            return Err("does not begin as a segment of a TDMS file: damaged, or another format".to_owned());
        }
        let mut rest = metadata::Bytes {
            bytes: bytes.get(4..).unwrap_or_default(),
            is_big: false,
        };
        let toc = rest.u32()?;
        rest.is_big = toc & IS_BIG != 0;
        let version = rest.u32()?;
        let (next, raw) = (rest.u64()?, rest.u64()?);
        if !matches!(version, 4712 | 4713) {
            return Err(format!("is of version {version}: 4712 (1) and 4713 (2) are read"));
        }
        if next == u64::MAX {
            // Its metadata may not be there either.
            return Ok(Some(Self {
                toc,
                metadata: if raw == u64::MAX { METADATA } else { raw },
                raw: None,
            }));
        }
        let raw_bytes = next
            .checked_sub(raw)
            .ok_or("its raw data begin behind its end: damaged")?;
        Ok(Some(Self {
            toc,
            metadata: raw,
            raw: Some(raw_bytes),
        }))
    }
}

/// Reads `count` bytes, fewer where the file ends.
fn take(from: &mut impl Read, count: u64) -> Result<Vec<u8>, ImportError> {
    let mut bytes = Vec::new();
    from.take(count)
        .read_to_end(&mut bytes)
        .map_err(|error| ImportError::unreadable(&error))?;
    Ok(bytes)
}
