//! Measurements of other programs in: one pure reader per format, one time grid, one writer to MCAP.
//!
//! ```text
//! csv, uff, wav, mat, lvm, tdms, npy -> Signal -> plan (topic, unit, rate, stretches) -> write -> MCAP
//!                                                                                    -> open  -> records
//! ```

mod agree;
mod asked;
mod choose;
mod contents;
pub mod csv;
mod format;
pub mod frequencies;
mod grid;
mod heads;
mod lines;
pub mod lvm;
pub mod mat;
pub mod npy;
mod numbers;
mod open;
mod order;
pub mod plan;
mod ramp;
mod resample;
mod stamp;
pub mod tdms;
pub mod uff;
pub mod wav;
mod write;

pub use self::asked::{Asked, Wanted, unknown_unit};
pub use self::contents::{Contents, How, describe, read};
pub use self::format::Format;
pub use self::open::{
    Opened, Seen, Whose, begins, format, lacks_rate, lacks_time_unit, open, open_any, span, topics,
};
pub use self::plan::Plan;
pub use self::stamp::{DateOrder, TimeUnit, utc_offset};
pub use self::write::write;

use std::sync::Arc;
use thiserror::Error;
use tirante_analysis::signal::record::Timestamp;

/// Most values of one file, stamps included: 64 MiB in memory, and about twice that on the way to records.
pub const MOST_VALUES: usize = 1 << 23;

/// Fault of a file or of the options for it, with its place: line, record, channel.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{place}{what}")]
pub struct ImportError {
    place: String,
    what: String,
    is_unknown_format: bool,
}

impl ImportError {
    /// A fault of the file as a whole.
    pub fn new(what: impl Into<String>) -> Self {
        Self {
            place: String::new(),
            what: what.into(),
            is_unknown_format: false,
        }
    }

    /// True if the format is unknown, which an option may give.
    pub fn is_unknown_format(&self) -> bool {
        self.is_unknown_format
    }

    /// A fault at a place in the file.
    pub fn at(place: impl std::fmt::Display, what: impl Into<String>) -> Self {
        Self {
            place: format!("{place}: "),
            ..Self::new(what)
        }
    }

    fn too_long() -> Self {
        Self::new(format!(
            "holds more than {MOST_VALUES} values, more than one recording should: split it, or choose channels"
        ))
    }

    fn unreadable(error: &std::io::Error) -> Self {
        Self::new(format!("cannot be read: {error}"))
    }
}

/// One quantity of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Signal {
    /// Name in the file.
    pub name: String,
    /// Number among the file's channels, from 1; a time column counts.
    pub number: usize,
    /// Unit as the file writes it.
    pub unit: Option<String>,
    /// Times of its samples.
    pub timing: Timing,
    /// Samples in the signal's unit; missing ones are NaN.
    pub values: Vec<f64>,
}

/// Times of samples, as the file gives them.
#[derive(Debug, Clone, PartialEq)]
pub enum Timing {
    /// The file does not give them.
    Unknown,
    /// One sample after the other at one rate.
    Rate {
        /// Sample rate \[Hz\].
        fs_hz: f64,
        /// Largest error of the rate by the file's own rounding, as a share of it.
        rounding: f64,
        /// Time of the first sample.
        start: Option<Timestamp>,
    },
    /// One stamp per sample; the stamps of one file are shared.
    Stamps(Arc<Stamps>),
}

/// Stamps of a file's samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Stamps {
    /// Nanoseconds since 1970, or since an origin that the file does not give.
    pub nanos: Vec<i64>,
    /// True if they count from 1970.
    pub absolute: bool,
    /// Finest step in which they are written \[ns\], at least 1.
    pub resolution_ns: i64,
    /// False if nothing says the unit of their numbers, which then pass for seconds.
    pub says_unit: bool,
    /// Line of each in the file; empty if it has no lines.
    pub lines: Vec<u32>,
}

impl Stamps {
    /// Place of a stamp in words.
    fn place(&self, index: usize) -> String {
        match self.lines.get(index) {
            Some(line) => format!("line {line}"),
            None => format!("sample {}", index + 1),
        }
    }
}

/// True if the file gives the start of a channel.
fn has_start(signal: &Signal) -> bool {
    match &signal.timing {
        Timing::Unknown => false,
        Timing::Rate { start, .. } => start.is_some(),
        Timing::Stamps(stamps) => stamps.absolute,
    }
}

/// True if a column or variable of this name holds the time.
fn is_time_name(name: &str) -> bool {
    const NAMES: [&str; 12] = [
        "t",
        "time",
        "times",
        "timestamp",
        "time stamp",
        "date",
        "datetime",
        "date time",
        "date/time",
        "zeit",
        "tempo",
        "temps",
    ];
    NAMES.contains(&name.trim().to_lowercase().as_str())
}
