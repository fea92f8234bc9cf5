//! Reads a file of any format as asked for, and describes its content in words.

use super::asked::tell_apart;
use super::asked::{Asked, Wanted};
use super::format::{Format, Kind, LOOKED_AT, kind};
use super::{ImportError, Signal, Timing, csv, lvm, mat, npy, ramp, tdms, uff, wav};
use crate::read::contents::rounded;
use std::io::{BufReader, Cursor, Read};
use std::path::Path;
use tirante_analysis::signal::record::{RodChannels, Timestamp, Unit};

/// Options for reading a file.
#[derive(Debug, Clone, Default)]
pub struct How {
    /// Format; `None`: detected from the content.
    pub format: Option<Format>,
    /// Layout of tables, and the place of stamps.
    pub table: csv::Table,
    /// The value of a WAV file's full scale.
    pub full_scale: Option<f64>,
    /// Channels asked for; empty: all, or those that the configuration reads.
    pub channels: Vec<Wanted>,
    /// Unit of channels whose unit is not given otherwise.
    pub unit: Option<Unit>,
    /// Sample rate \[Hz\].
    pub rate_hz: Option<f64>,
    /// Time of the first sample.
    pub start: Option<Timestamp>,
    /// Rate to interpolate to \[Hz\].
    pub resample_hz: Option<f64>,
}

impl How {
    /// True if any option gives meaning to the samples.
    pub(super) fn says_something(&self) -> bool {
        self.format.is_some()
            || self.full_scale.is_some()
            || !self.channels.is_empty()
            || self.unit.is_some()
            || self.rate_hz.is_some()
            || self.start.is_some()
            || self.resample_hz.is_some()
    }

    /// Options for the file's channels.
    pub fn asked<'a>(&'a self, rods: &'a [RodChannels]) -> Asked<'a> {
        Asked {
            channels: &self.channels,
            unit: self.unit,
            rate_hz: self.rate_hz,
            start: self.start,
            resample_hz: self.resample_hz,
            rods,
            ..Asked::default()
        }
    }
}

/// Content of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Contents {
    /// Format of the file.
    pub format: Format,
    /// Channels of the file.
    pub signals: Vec<Signal>,
    /// Items left out, one sentence each.
    pub left_out: Vec<String>,
    /// True if its values are shares of an unknown full scale.
    pub is_of_full_scale: bool,
}

impl Contents {
    /// Returns an error if the full scale is unknown.
    ///
    /// # Errors
    /// It is not given.
    pub fn check_full_scale(&self) -> Result<(), ImportError> {
        match self.is_of_full_scale {
            false => Ok(()),
            true => Err(ImportError::new(
                "a WAV file does not say what its numbers mean: --full-scale VALUE --unit UNIT says what full scale is",
            )),
        }
    }
}

/// Reads another program's file; `None` if it is a recording. `path` helps where the content does not
/// determine the format.
///
/// # Errors
/// It is of no format that is read, damaged, or does not fit the options.
pub fn read(mut from: impl Read, path: &Path, how: &How) -> Result<Option<Contents>, ImportError> {
    let mut head = Vec::new();
    from.by_ref()
        .take(LOOKED_AT as u64)
        .read_to_end(&mut head)
        .map_err(|error| ImportError::unreadable(&error))?;
    let format = match (how.format, kind(&head, path)) {
        (Some(format), _) => format,
        (None, Ok(Kind::Mcap)) => return Ok(None),
        (None, Ok(Kind::Foreign(format))) => format,
        (None, Err(error)) => return Err(error),
    };
    if matches!(how.table.time, csv::TimeColumn::Named(_)) && !format.names_stamps() {
        return Err(ImportError::new(
            "has no column or variable that --time could name: only CSV, MATLAB and TDMS files have; --rate HZ says the rate",
        ));
    }
    let from = BufReader::with_capacity(1 << 16, Cursor::new(head).chain(from));
    let mut witnesses = Vec::new();
    let (mut signals, left_out) = match format {
        Format::Csv => {
            let found = csv::read(from, &how.table)?;
            witnesses = found.witnesses;
            (found.signals, found.skipped)
        }
        Format::Uff => {
            let found = uff::read(from, how.table.utc_offset_s)?;
            (found.signals, found.skipped)
        }
        Format::Wav => (wav::read(from, how.full_scale.unwrap_or(1.0))?, Vec::new()),
        Format::Mat => {
            let (time, find) = how.time();
            let found = mat::read(from, time.as_deref(), find, how.table.time_unit)?;
            (found.signals, found.skipped)
        }
        Format::Lvm => {
            let found = lvm::read(from, how.table.utc_offset_s)?;
            (found.signals, found.skipped)
        }
        Format::Tdms => {
            let (time, find) = how.time();
            let found = tdms::read(from, time.as_deref(), find, how.table.time_unit)?;
            (found.signals, found.skipped)
        }
        Format::Npy => (npy::read(from)?, Vec::new()),
    };
    tell_apart(signals.iter_mut().map(|signal| &mut signal.name));
    // Who names the motion and leaves the stamps out has said which column is not the time.
    let is_settled = matches!(how.table.time, csv::TimeColumn::None) && !how.channels.is_empty();
    if let Some(rate_hz) = how.rate_hz.filter(|_| !is_settled) {
        ramp::agree(signals.iter().chain(&witnesses), rate_hz)?;
    }
    Ok(Some(Contents {
        format,
        signals,
        left_out,
        is_of_full_scale: format == Format::Wav && how.full_scale.is_none(),
    }))
}

impl How {
    /// Variable with the stamps, and true if one is to be searched for.
    fn time(&self) -> (Option<String>, bool) {
        match &self.table.time {
            csv::TimeColumn::Found => (None, true),
            csv::TimeColumn::None => (None, false),
            csv::TimeColumn::Named(names) => (Some(names.join(",")), true),
        }
    }
}

/// The samples, unit and rate of a channel in words.
pub fn describe(signal: &Signal) -> String {
    let when = match &signal.timing {
        Timing::Unknown => "rate and start not said (--rate, --time, --start)".to_owned(),
        Timing::Rate { fs_hz, start, .. } => match start {
            Some(start) => format!("{} Hz from {start}", rounded(*fs_hz)),
            None => format!("{} Hz, start not said (--start)", rounded(*fs_hz)),
        },
        Timing::Stamps(stamps) => match stamps.nanos.first() {
            Some(first) if stamps.absolute => format!("stamps from {}", Timestamp::from_nanos(*first)),
            _ => "stamps without a date (--start)".to_owned(),
        },
    };
    let unit = match signal.unit.as_deref() {
        None => "unit not said (--unit)".to_owned(),
        Some(written) => match Unit::as_written(written) {
            Some(unit) => unit.key().to_owned(),
            None => format!("unit {written:?}, none of ours (--unit)"),
        },
    };
    format!("{} samples, {unit}, {when}", signal.values.len())
}
