//! Flags for facts missing in another program's file.

use super::progress::Watched;
use super::quantities;
use super::setup::Setup;
use crate::analysis::signal::record::{Timestamp, Unit};
use crate::config::written::positive;
use crate::recording::import::{self, DateOrder, Format, How, TimeUnit, Wanted, csv};
use crate::site::records::Others;
use std::fs::File;
use std::io::Read;

const HEADING: &str = "Files of other programs";

/// Facts about another program's file.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Foreign {
    /// Format, if neither content nor ending of the file determines it.
    #[arg(long, value_enum, help_heading = HEADING)]
    pub input_format: Option<Format>,
    /// Column or channel to read, by name or number, with its topic; may be repeated.
    #[arg(long = "channel", visible_alias = "column", value_name = "SOURCE[=TOPIC][,UNIT]", value_parser = Wanted::parse)]
    pub channels: Vec<Wanted>,
    /// Unit of channels whose unit the file does not give.
    #[arg(long, value_parser = unit, help_heading = HEADING)]
    pub unit: Option<Unit>,
    /// Sample rate in Hz, if the file does not give it; checked if it does.
    #[arg(long, value_name = "HZ", value_parser = quantities::rate, help_heading = HEADING)]
    pub rate: Option<f64>,
    /// Time of the first sample, if the file does not give it.
    #[arg(long, value_name = "TIME", value_parser = time, help_heading = HEADING)]
    pub start: Option<Timestamp>,
    /// Offset ahead of UTC of times without an offset of their own.
    #[arg(long, value_name = "+HH:MM", value_parser = import::utc_offset, default_value = "+00:00", allow_hyphen_values = true, help_heading = HEADING)]
    pub utc_offset: i32,
    /// Interpolate uneven stamps to this rate in Hz; without it they are an error.
    #[arg(long, value_name = "HZ", value_parser = quantities::rate, conflicts_with = "rate", help_heading = HEADING)]
    pub resample: Option<f64>,
    /// CSV, MATLAB, TDMS: column or variable of the stamps (two columns for day and time of day), or none.
    #[arg(long, value_name = "NAME[,NAME]|none", help_heading = HEADING)]
    pub time: Option<String>,
    /// CSV, MATLAB, TDMS: unit of the numbers in the stamps.
    #[arg(long, value_enum, help_heading = HEADING)]
    pub time_unit: Option<TimeUnit>,
    /// CSV: delimiter of columns: one character, tab or space (any number of blanks).
    #[arg(long, value_name = "CHARACTER", value_parser = delimiter, help_heading = HEADING)]
    pub delimiter: Option<u8>,
    /// CSV: the decimal sign is a comma.
    #[arg(long, help_heading = HEADING)]
    pub decimal_comma: bool,
    /// CSV: number of lines before the first row of data.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(0..=190), help_heading = HEADING)]
    pub head_lines: Option<u16>,
    /// CSV: order of day and month in dates such as 03/04/2026.
    #[arg(long, value_enum, help_heading = HEADING)]
    pub dates: Option<DateOrder>,
    /// WAV: the value at full scale, in --unit.
    #[arg(long, value_name = "VALUE", value_parser = positive, help_heading = HEADING)]
    pub full_scale: Option<f64>,
}

impl Foreign {
    /// The flags as options of the readers.
    pub fn how(&self) -> How {
        let time = self.time.as_deref();
        How {
            format: self.input_format,
            table: csv::Table {
                delimiter: self.delimiter,
                decimal_comma: self.decimal_comma,
                head_lines: self.head_lines.map(usize::from),
                time: match time {
                    Some("none") => csv::TimeColumn::None,
                    Some(names) => {
                        csv::TimeColumn::Named(names.split(',').map(|name| name.trim().to_owned()).collect())
                    }
                    None => csv::TimeColumn::Found,
                },
                time_unit: self.time_unit,
                dates: self.dates,
                utc_offset_s: self.utc_offset,
                columns: self.channels.iter().map(|wanted| wanted.source.clone()).collect(),
            },
            full_scale: self.full_scale,
            channels: self.channels.clone(),
            unit: self.unit,
            rate_hz: self.rate,
            start: self.start,
            resample_hz: self.resample,
        }
    }
}

impl Foreign {
    /// The flags for a run over files; with `any_start` a file without a start is accepted.
    pub fn among(&self, setup: &Setup, any_start: bool) -> Others {
        Others {
            how: self.how(),
            is_meant: setup.config.is_some(),
            any_start,
            needs_all: false,
        }
    }
}

/// Wraps a file so that slow reading shows a progress bar.
pub fn watch(file: File, bytes: u64) -> Box<dyn Read> {
    Box::new(Watched::new(file, bytes))
}

/// Parses a unit.
///
/// # Errors
/// It is none.
pub fn unit(text: &str) -> Result<Unit, String> {
    Unit::as_written(text).ok_or_else(|| import::unknown_unit(text))
}

fn time(text: &str) -> Result<Timestamp, String> {
    let time = serde_json::from_value(serde_json::Value::String(text.to_owned()));
    time.map_err(|_| {
        "a time with its offset from UTC is expected: 2026-03-01T06:00:00Z, 2026-03-01T07:00:00+01:00"
            .to_owned()
    })
}

fn delimiter(text: &str) -> Result<u8, String> {
    match (text, text.as_bytes()) {
        ("tab" | "\\t", _) => Ok(b'\t'),
        ("space" | "blank", _) => Ok(b' '),
        (_, [byte]) if byte.is_ascii() && !byte.is_ascii_alphanumeric() && *byte != b'"' => Ok(*byte),
        _ => Err("one character such as ; or the words tab, space".to_owned()),
    }
}
