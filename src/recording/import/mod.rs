//! Measurements of other programs in: one pure reader a format, one grid of time, one writer to MCAP.
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
mod stamp;
pub mod tdms;
pub mod uff;
pub mod wav;
mod write;

pub use self::asked::{Asked, Wanted, unknown_unit};
pub use self::contents::{Contents, How, describe, read};
pub use self::format::Format;
pub use self::open::{Opened, Seen, Whose, begins, format, lacks_rate, open, open_any, topics};
pub use self::plan::Plan;
pub use self::stamp::{DateOrder, TimeUnit, utc_offset};
pub use self::write::write;

use crate::analysis::signal::record::Timestamp;
use std::sync::Arc;
use thiserror::Error;

/// The most values one file may hold, stamps among them: 64 MiB in memory, and about twice that on the way to records.
pub const MOST_VALUES: usize = 1 << 23;

/// What is wrong with a file or with what is asked of it, and where: the line, the record, the channel.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{place}{what}")]
pub struct ImportError {
    place: String,
    what: String,
    is_unknown_format: bool,
}

impl ImportError {
    /// Of the file as a whole.
    pub fn new(what: impl Into<String>) -> Self {
        Self {
            place: String::new(),
            what: what.into(),
            is_unknown_format: false,
        }
    }

    /// Whether nobody knows the format, which an argument may say.
    pub fn is_unknown_format(&self) -> bool {
        self.is_unknown_format
    }

    /// At a place within it.
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

/// One quantity as a file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Signal {
    /// Its name in the file.
    pub name: String,
    /// Its place among the file's channels, from 1; a time column counts.
    pub number: usize,
    /// Its unit as the file writes it.
    pub unit: Option<String>,
    /// When its samples were taken.
    pub timing: Timing,
    /// Its samples in its unit; what the file marks as missing is NaN.
    pub values: Vec<f64>,
}

/// When samples were taken, as a file says it.
#[derive(Debug, Clone, PartialEq)]
pub enum Timing {
    /// The file does not say.
    Unknown,
    /// One after the other at one rate.
    Rate {
        /// Samples a second \[Hz\].
        fs_hz: f64,
        /// How far the file's own rounding may have moved the rate, as a share of it.
        rounding: f64,
        /// The time of the first one.
        start: Option<Timestamp>,
    },
    /// Each has a stamp; those of one file are shared.
    Stamps(Arc<Stamps>),
}

/// The stamps of samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Stamps {
    /// Nanoseconds since 1970, or since a beginning that the file does not say.
    pub nanos: Vec<i64>,
    /// Whether they count from 1970.
    pub absolute: bool,
    /// The finest step they are written in \[ns\], at least 1.
    pub resolution_ns: i64,
    /// The line of each in the file; empty if it has no lines.
    pub lines: Vec<u32>,
}

impl Stamps {
    /// Where a stamp stands, for sentences.
    fn place(&self, index: usize) -> String {
        match self.lines.get(index) {
            Some(line) => format!("line {line}"),
            None => format!("sample {}", index + 1),
        }
    }
}

/// Whether the file says when a channel began.
fn has_start(signal: &Signal) -> bool {
    match &signal.timing {
        Timing::Unknown => false,
        Timing::Rate { start, .. } => start.is_some(),
        Timing::Stamps(stamps) => stamps.absolute,
    }
}

/// Whether a column or variable of this name holds the time.
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
