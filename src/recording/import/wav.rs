//! WAV files: whole numbers of 8 to 32 bits, floats of 32 and 64 bits, with the full scale given by the user.

use super::numbers::Kind;
use super::{ImportError, MOST_VALUES, Signal, Timing};
use std::io::Read;

/// The longest format chunk read \[bytes\]; the longest in use has 40.
const LONGEST: u32 = 1 << 12;
/// Most channels.
const CHANNELS: usize = 1024;

/// Reads every channel; the value of a sample is its share of full scale times `full_scale`.
///
/// # Errors
/// It is no WAV file, of a kind that is not read, or cut short.
pub fn read(mut from: impl Read, full_scale: f64) -> Result<Vec<Signal>, ImportError> {
    let lead = take(&mut from, 12)?;
    if !lead.starts_with(b"RIFF") || lead.get(8..) != Some(b"WAVE") {
        return Err(ImportError::new("is no WAV file"));
    }
    let mut format = None;
    let (format, bytes) = loop {
        let head = take(&mut from, 8)?;
        let (name, size) = match head[..] {
            [a, b, c, d, e, f, g, h] => ([a, b, c, d], u32::from_le_bytes([e, f, g, h])),
            _ => return Err(cut_short()),
        };
        match (&name, format) {
            (b"data", Some(format)) => break (format, size),
            (b"data", None) => return Err(ImportError::new("has samples before their format: damaged")),
            (b"fmt ", _) if size <= LONGEST => {
                format = Some(Format::parse(&take(&mut from, size as usize)?)?)
            }
            (b"fmt ", _) => return Err(ImportError::new("has a format of too many bytes: damaged")),
            _ => pass(&mut from, u64::from(size))?,
        }
        // Chunks are padded to an even length.
        pass(&mut from, u64::from(size % 2))?;
    };
    // Written by programs that do not know the length yet.
    if bytes == u32::MAX || bytes == 0 {
        return Err(cut_short());
    }
    let frame = format.channels * format.kind.size();
    let frames = bytes as usize / frame;
    if frames.saturating_mul(format.channels) > MOST_VALUES {
        return Err(ImportError::too_long());
    }
    let mut values: Vec<Vec<f64>> = vec![Vec::new(); format.channels];
    let mut place = 0;
    let push = |value: f64| {
        if let Some(channel) = values.get_mut(place % format.channels) {
            channel.push((value - format.middle) / format.most * full_scale);
        }
        place += 1;
    };
    let numbers = frames * format.channels;
    if format.kind.read(&mut from, numbers, true, push)? < numbers {
        return Err(cut_short());
    }
    // A size that was not brought up to date leaves samples behind the chunk, where another chunk's name belongs.
    pass(&mut from, u64::from(bytes % 2)).ok();
    let mut name = Vec::new();
    from.by_ref()
        .take(4)
        .read_to_end(&mut name)
        .map_err(|error| ImportError::unreadable(&error))?;
    if name.len() == 4 && !name.iter().all(|byte| byte.is_ascii_graphic() || *byte == b' ') {
        return Err(ImportError::new(
            "has more behind its samples than its header says: it was never finished, or is damaged",
        ));
    }
    let signal = |(index, values)| Signal {
        name: format!("channel-{}", index + 1),
        number: index + 1,
        unit: None,
        timing: Timing::Rate {
            fs_hz: f64::from(format.rate_hz),
            rounding: 0.0,
            start: None,
        },
        values,
    };
    Ok(values.into_iter().enumerate().map(signal).collect())
}

fn cut_short() -> ImportError {
    ImportError::new("ends within its header or samples: it is cut short, or was never finished")
}

fn take(from: &mut impl Read, count: usize) -> Result<Vec<u8>, ImportError> {
    let mut bytes = Vec::new();
    from.take(count as u64)
        .read_to_end(&mut bytes)
        .map_err(|error| ImportError::unreadable(&error))?;
    match bytes.len() == count {
        true => Ok(bytes),
        false => Err(cut_short()),
    }
}

fn pass(from: &mut impl Read, count: u64) -> Result<(), ImportError> {
    let passed = std::io::copy(&mut from.take(count), &mut std::io::sink());
    match passed.map_err(|error| ImportError::unreadable(&error))? == count {
        true => Ok(()),
        false => Err(cut_short()),
    }
}

/// Content of the format chunk.
#[derive(Debug, Clone, Copy)]
struct Format {
    channels: usize,
    rate_hz: u32,
    kind: Kind,
    /// Stored number for zero; 8-bit samples are unsigned.
    middle: f64,
    /// Stored number for full scale.
    most: f64,
}

impl Format {
    fn parse(bytes: &[u8]) -> Result<Self, ImportError> {
        let word = |at: usize| match bytes.get(at..at + 2) {
            Some(&[a, b]) => Ok(u16::from_le_bytes([a, b])),
            _ => Err(ImportError::new("has a format of too few bytes: damaged")),
        };
        let (tag, channels, rate_hz) = (word(0)?, usize::from(word(2)?), [word(4)?, word(6)?]);
        let (frame, bits) = (usize::from(word(12)?), word(14)?);
        let rate_hz = u32::from(rate_hz[0]) | u32::from(rate_hz[1]) << 16;
        if channels == 0 || rate_hz == 0 {
            return Err(ImportError::new("has no channels or no sample rate"));
        }
        if channels > CHANNELS {
            return Err(ImportError::new(format!(
                "has {channels} channels: at most {CHANNELS} are read"
            )));
        }
        // The extensible format has its kind further on, with the number of valid bits.
        let (tag, valid) = match tag {
            0xfffe => (word(24)?, word(18)?),
            tag => (tag, bits),
        };
        let size = usize::from(bits).div_ceil(8);
        let kind = match (tag, bits) {
            (1, 8) => Kind::U8,
            (1, 16) => Kind::I16,
            (1, 24) => Kind::I24,
            (1, 32) => Kind::I32,
            (3, 32) => Kind::F32,
            (3, 64) => Kind::F64,
            _ => {
                return Err(ImportError::new(format!(
                    "is a kind of WAV that is not read (format {tag}, {bits} bits): whole numbers of 8, 16, 24 and 32 bits and \
                     floats of 32 and 64 are; convert it"
                )));
            }
        };
        // Programs differ in which end of a wider container holds the sample, and a file does not state it.
        if frame != channels * size || valid > bits {
            return Err(ImportError::new(format!(
                "samples of {bits} bits in wider containers are not read: convert it"
            )));
        }
        // Samples of fewer bits than their container are in its upper end: full scale is the container's.
        let (middle, most) = match kind {
            Kind::F32 | Kind::F64 => (0.0, 1.0),
            Kind::U8 => (128.0, 128.0),
            kind => (0.0, 2_f64.powi(8 * kind.size() as i32 - 1)),
        };
        Ok(Self {
            channels,
            rate_hz,
            kind,
            middle,
            most,
        })
    }
}
