//! One segment of a LabVIEW measurement: its header, by channel, and its rows.

use super::Header;
use crate::import::lines::shown;
use crate::import::stamp::{self, TimeUnit};
use crate::import::{ImportError, Stamps};
use tirante_analysis::signal::record::Timestamp;

/// Seconds from 1904, where LabVIEW's clock begins, to 1970.
const SINCE_1904_S: i64 = 2_082_844_800;
const NANOS: i64 = 1_000_000_000;
/// Most channels.
const CHANNELS: usize = 1024;

/// The samples of one channel in one segment.
pub(super) struct Piece {
    /// Line where the rows of its segment begin.
    pub(super) line: u32,
    pub(super) name: String,
    pub(super) unit: Option<String>,
    pub(super) when: When,
    pub(super) values: Vec<f64>,
}

/// Timing of the samples of a segment.
#[derive(Clone)]
pub(super) enum When {
    /// The file does not give it.
    Unknown,
    /// At even steps.
    Even {
        step_s: f64,
        /// Half the last digit of the step as written, as a share of it.
        rounding: f64,
        start: Option<Timestamp>,
    },
    /// At the times of an x column.
    Stamped(Stamps),
}

/// A segment while it is read.
pub(super) struct Segment {
    head: Vec<Vec<String>>,
    line: u32,
    channels: Vec<Channel>,
    rows: usize,
}

struct Channel {
    name: String,
    column: usize,
    /// Index of the column of x values.
    x: usize,
    values: Vec<f64>,
    /// Number of samples up to the last one present.
    length: usize,
    stamps: Vec<i64>,
    resolution_ns: i64,
}

impl Segment {
    /// A segment from the lines of a header and the names of the columns.
    pub(super) fn new(
        head: Vec<Vec<String>>,
        names: Vec<String>,
        header: &Header,
        line: u32,
    ) -> Result<Self, ImportError> {
        let mut segment = Self {
            head,
            line,
            channels: Vec::new(),
            rows: 0,
        };
        let said = segment.fact("Channels", 1).and_then(|text| number(text, header));
        let mut x = 0;
        for (column, name) in names.iter().enumerate() {
            if name == "X_Value" {
                x = column;
            } else {
                segment.channels.push(Channel {
                    name: name.clone(),
                    column,
                    x,
                    values: Vec::new(),
                    length: 0,
                    stamps: Vec::new(),
                    resolution_ns: i64::MAX,
                });
            }
        }
        // The channels are followed by a comment, and perhaps a separator.
        let count = match said {
            Some(said) if said >= 0.0 && said.fract() == 0.0 => said as usize,
            _ => segment
                .channels
                .iter()
                .take_while(|channel| channel.name != "Comment")
                .count(),
        };
        if count > segment.channels.len() || count > CHANNELS {
            return Err(ImportError::at(
                format_args!("line {line}"),
                format!(
                    "{} columns for {count} channels (at most {CHANNELS} are read)",
                    segment.channels.len()
                ),
            ));
        }
        segment.channels.truncate(count);
        Ok(segment)
    }

    /// True if rows have x values.
    pub(super) fn has_stamps(&self) -> bool {
        self.channels.iter().any(|channel| !channel.stamps.is_empty())
    }

    /// Takes a row; returns the number of values it held.
    pub(super) fn push(
        &mut self,
        cells: &[String],
        header: &Header,
        line: u32,
    ) -> Result<usize, ImportError> {
        self.rows += 1;
        let rows = self.rows;
        let mut held = 0;
        for channel in &mut self.channels {
            let cell = |column: usize| cells.get(column).map(String::as_str).unwrap_or_default();
            let (x, y) = (cell(channel.x), cell(channel.column));
            if y.is_empty() {
                // Missing, or ended before the others.
                channel.values.push(f64::NAN);
            } else {
                let value = number(y, header).ok_or_else(|| {
                    let place = format!("line {line}, column {} ({})", channel.column + 1, channel.name);
                    ImportError::at(place, format!("{} is no number", shown(y)))
                })?;
                channel.values.push(value);
                channel.length = rows;
            }
            held += 1;
            if x.is_empty() {
                if !channel.stamps.is_empty() && !y.is_empty() {
                    return Err(ImportError::at(
                        format_args!("line {line}, column {}", channel.x + 1),
                        "no X value, although there were before",
                    ));
                }
                continue;
            }
            if channel.stamps.len() + 1 < rows {
                return Err(ImportError::at(
                    format_args!("line {line}, column {}", channel.x + 1),
                    "an X value, although there was none before",
                ));
            }
            let written = stamp::number(&plain(x, header), TimeUnit::S).ok_or_else(|| {
                let place = format!("line {line}, column {}", channel.x + 1);
                ImportError::at(place, format!("{} is no time", shown(x)))
            })?;
            channel.resolution_ns = channel.resolution_ns.min(written.resolution_ns);
            channel.stamps.push(written.nanos);
            held += 1;
        }
        Ok(held)
    }

    /// Appends the pieces of its channels to those of the segments before.
    pub(super) fn finish(
        mut self,
        header: &Header,
        to: &mut Vec<Vec<Piece>>,
        skipped: &mut Vec<String>,
    ) -> Result<(), ImportError> {
        let line = self.line;
        for mut channel in std::mem::take(&mut self.channels) {
            let named = format!("{} of the segment at line {line}", shown(&channel.name));
            let over = self
                .fact("X_Dimension", channel.column)
                .filter(|over| *over != "Time");
            if let Some(over) = over {
                skipped.push(format!("{named} (over {}, not over time)", shown(over)));
                continue;
            }
            if channel.length == 0 {
                skipped.push(format!("{named} (no samples)"));
                continue;
            }
            let samples = self
                .fact("Samples", channel.column)
                .and_then(|text| number(text, header));
            if let Some(samples) = samples.filter(|samples| *samples > channel.length as f64) {
                skipped.push(format!(
                    "what is missing of {named}: {} samples are there, {samples} are said to be",
                    channel.length
                ));
            }
            channel.values.truncate(channel.length);
            channel.stamps.truncate(channel.length);
            let when = self.when(&mut channel, header)?;
            let unit = self.fact("Y_Unit_Label", channel.column).map(str::to_owned);
            let piece = Piece {
                line,
                name: channel.name,
                unit,
                when,
                values: channel.values,
            };
            // A segment repeats the channels of the one before; another name or unit is another channel, and so is a second one
            // of the same name.
            let known = to.iter_mut().find(|pieces| {
                let is_same =
                    |last: &Piece| last.name == piece.name && last.unit == piece.unit && last.line != line;
                pieces.last().is_some_and(is_same)
            });
            match known {
                Some(pieces) => pieces.push(piece),
                None => to.push(vec![piece]),
            }
        }
        Ok(())
    }

    fn when(&self, channel: &mut Channel, header: &Header) -> Result<When, ImportError> {
        let start = self.start(channel.column, header);
        if channel.stamps.is_empty() {
            let Some(step) = self.fact("Delta_X", channel.column) else {
                return Ok(When::Unknown);
            };
            let step_s = number(step, header).filter(|step| step.is_finite() && *step > 0.0);
            let Some(step_s) = step_s else {
                return Err(ImportError::at(
                    format_args!("the segment at line {}", self.line),
                    format!("Delta_X {} is no positive step", shown(step)),
                ));
            };
            let first_s = self
                .fact("X0", channel.column)
                .and_then(|text| number(text, header));
            return Ok(When::Even {
                step_s,
                rounding: rounding(&plain(step, header)),
                start: start.map(|start| start.plus_seconds(first_s.unwrap_or(0.0))),
            });
        }
        let since_1904 = SINCE_1904_S.saturating_mul(NANOS);
        let is_absolute =
            header.is_absolute && channel.stamps.first().is_some_and(|first| *first >= since_1904);
        let from = match (is_absolute, start) {
            (true, _) => -since_1904,
            (false, Some(start)) => start.as_nanos(),
            (false, None) => 0,
        };
        let nanos = std::mem::take(&mut channel.stamps);
        Ok(When::Stamped(Stamps {
            nanos: nanos.into_iter().map(|nano| nano.saturating_add(from)).collect(),
            absolute: is_absolute || start.is_some(),
            resolution_ns: channel.resolution_ns.max(1),
            says_unit: true,
            lines: Vec::new(),
        }))
    }

    /// Time of x = 0: the channel's own, else the file's.
    fn start(&self, column: usize, header: &Header) -> Option<Timestamp> {
        let date = self.fact("Date", column).unwrap_or(&header.date);
        let time = self.fact("Time", column).unwrap_or(&header.time);
        let (clock, fraction) = time.split_once(['.', ',']).unwrap_or((time, "0"));
        // LabVIEW writes more digits than a nanosecond has.
        let fraction: String = fraction.chars().take(9).collect();
        let written = stamp::date(&format!("{date} {clock}.{fraction}"), None, header.utc_offset_s);
        Some(Timestamp::from_nanos(written.ok()?.nanos))
    }

    /// Fact of the header for a column.
    fn fact(&self, key: &str, column: usize) -> Option<&str> {
        let line = self
            .head
            .iter()
            .rev()
            .find(|line| line.first().is_some_and(|first| first == key))?;
        line.get(column)
            .map(String::as_str)
            .filter(|fact| !fact.is_empty())
    }
}

/// Number with a decimal point.
fn plain(text: &str, header: &Header) -> String {
    match header.decimal_comma {
        true => text.replace(',', "."),
        false => text.to_owned(),
    }
}

fn number(text: &str, header: &Header) -> Option<f64> {
    plain(text, header).parse().ok()
}

/// Half the last digit of a number as a share of it.
fn rounding(text: &str) -> f64 {
    let digits = text.split(['e', 'E']).next().unwrap_or_default();
    let behind = digits
        .split_once('.')
        .map_or(0, |(_, behind)| behind.len().min(18)) as i32;
    let mantissa: f64 = digits.parse::<f64>().unwrap_or(1.0).abs();
    0.5 * 10_f64.powi(-behind) / mantissa.max(f64::MIN_POSITIVE)
}
