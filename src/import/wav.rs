//! WAV files: whole numbers or 32-bit floats, full scale given by who knows the recorder.

use super::{ImportError, MOST_VALUES, Signal, Timing};
use hound::{SampleFormat, WavReader};
use std::io::{Cursor, Read};

/// Reads every channel; the value of a sample is its share of full scale times `full_scale`.
///
/// # Errors
/// It is no WAV file, of a kind that is not read, or cut short.
pub fn read(mut from: impl Read, full_scale: f64) -> Result<Vec<Signal>, ImportError> {
    let mut head = Vec::new();
    from.by_ref()
        .take(HEAD)
        .read_to_end(&mut head)
        .map_err(|error| ImportError::unreadable(&error))?;
    let frame_bytes = frame_bytes(&head);
    let reader = WavReader::new(Cursor::new(head).chain(from)).map_err(|error| fault(&error))?;
    let spec = reader.spec();
    // Programs differ in which end of a wider container holds the sample, and a file does not say.
    let tight = u32::from(spec.channels) * u32::from(spec.bits_per_sample).div_ceil(8);
    if frame_bytes != Some(tight) {
        return Err(ImportError::new(format!(
            "samples of {} bits in wider containers, or with their format far from the beginning, are not read: convert it",
            spec.bits_per_sample
        )));
    }
    let channels = usize::from(spec.channels);
    if channels == 0 || spec.sample_rate == 0 {
        return Err(ImportError::new("has no channels or no sample rate"));
    }
    let frames = reader.duration() as usize;
    if frames.saturating_mul(channels) > MOST_VALUES {
        return Err(ImportError::too_long());
    }
    let mut values: Vec<Vec<f64>> = vec![Vec::new(); channels];
    let mut place = 0;
    let mut take = |value: f64| {
        if let Some(channel) = values.get_mut(place % channels) {
            channel.push(value);
        }
        place += 1;
    };
    match spec.sample_format {
        SampleFormat::Int => {
            // Full scale of n bits is 2^(n-1); the quotient is exact.
            let most = 2_f64.powi(i32::from(spec.bits_per_sample) - 1);
            for sample in reader.into_samples::<i32>() {
                take(f64::from(sample.map_err(|error| fault(&error))?) / most * full_scale);
            }
        }
        SampleFormat::Float => {
            for sample in reader.into_samples::<f32>() {
                take(f64::from(sample.map_err(|error| fault(&error))?) * full_scale);
            }
        }
    }
    if values.iter().any(|channel| channel.len() != frames) {
        return Err(ImportError::new("ends within its samples: it is cut short"));
    }
    let signal = |(index, values)| Signal {
        name: format!("channel-{}", index + 1),
        number: index + 1,
        unit: None,
        timing: Timing::Rate {
            fs_hz: f64::from(spec.sample_rate),
            rounding: 0.0,
            start: None,
        },
        values,
    };
    Ok(values.into_iter().enumerate().map(signal).collect())
}

/// Bytes in which the format must stand.
const HEAD: u64 = 4096;

/// The bytes of one sample of all channels, as the format chunk says.
fn frame_bytes(head: &[u8]) -> Option<u32> {
    let mut rest = head.get(12..)?;
    loop {
        let (name, size) = (rest.get(..4)?, rest.get(4..8)?);
        let size = u32::from_le_bytes(size.try_into().ok()?) as usize;
        if name == b"fmt " {
            let align = rest.get(20..22)?;
            return Some(u32::from(u16::from_le_bytes(align.try_into().ok()?)));
        }
        // Chunks are padded to an even length.
        rest = rest.get(8 + size + size % 2..)?;
    }
}

fn fault(error: &hound::Error) -> ImportError {
    ImportError::new(match error {
        hound::Error::IoError(error) => {
            format!("ends within its header or samples: it is cut short, or was never finished ({error})")
        }
        hound::Error::Unsupported => {
            "is a kind of WAV that is not read: whole numbers of 8 to 32 bits and 32-bit floats \
             are; convert it"
                .to_owned()
        }
        other => format!("is no WAV file: {other}"),
    })
}
