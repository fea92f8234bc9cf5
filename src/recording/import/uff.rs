//! Universal file format, dataset 58: time histories as text or binary (58b).

use super::heads::some;
use super::lines::{Lines, shown};
use super::stamp::TimeUnit;
use super::{ImportError, MOST_VALUES, Signal, Stamps, Timing};
use std::io::{BufRead, Read};
use std::sync::Arc;
use tirante_analysis::signal::record::Timestamp;

/// Content of a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Read58 {
    /// Time histories of the file.
    pub signals: Vec<Signal>,
    /// Items left out, one sentence each.
    pub skipped: Vec<String>,
}

/// Reads every time history of a file. Dates have no offset and are taken as `utc_offset_s` ahead of UTC.
///
/// # Errors
/// The first thing that is wrong, with its line.
pub fn read(from: impl BufRead, utc_offset_s: i32) -> Result<Read58, ImportError> {
    let mut lines = Lines::new(from);
    let mut found = Read58::default();
    let (mut number, mut held) = (0, 0);
    while let Some(line) = lines.next_text()? {
        if line.trim().is_empty() {
            continue;
        }
        if line.trim() != "-1" {
            return Err(at(
                &lines,
                "the delimiter -1 of a dataset is expected: no universal file, or a damaged one",
            ));
        }
        let Some(kind) = lines.next_text()?.map(|line| line.trim().to_owned()) else {
            break;
        };
        let name = kind.split_whitespace().next().unwrap_or_default().to_owned();
        if name != "58" && name != "58b" {
            found
                .skipped
                .push(format!("line {}: dataset {}", lines.number(), shown(&name)));
            skip(&mut lines)?;
            continue;
        }
        number += 1;
        let header = Header::read(&mut lines)?;
        let binary = match name == "58b" {
            true => Some(Binary::parse(&kind, &header).map_err(|what| at(&lines, what))?),
            false => None,
        };
        if let Some(reason) = header.foreign() {
            found
                .skipped
                .push(format!("dataset 58 number {number} is {reason}"));
            if let Some(binary) = binary {
                drop_bytes(&mut lines, binary.bytes)?;
            }
            skip(&mut lines)?;
            continue;
        }
        held += header.points * if header.even { 1 } else { 2 };
        if held > MOST_VALUES {
            return Err(ImportError::too_long());
        }
        let values = match &binary {
            Some(binary) => binary.values(&mut lines, &header)?,
            None => header.numbers(&mut lines)?,
        };
        end(&mut lines)?;
        found.signals.push(header.signal(number, values, utc_offset_s)?);
    }
    if found.signals.is_empty() {
        let rest = match found.skipped.is_empty() {
            true => String::new(),
            false => format!(" (but {})", found.skipped.join("; ")),
        };
        return Err(ImportError::new(format!(
            "holds no time history, dataset 58 of function type 1{rest}"
        )));
    }
    Ok(found)
}

fn at<R: BufRead>(lines: &Lines<R>, what: impl Into<String>) -> ImportError {
    ImportError::at(format_args!("line {}", lines.number()), what)
}

/// Skips the rest of a dataset, its closing delimiter included.
fn skip<R: BufRead>(lines: &mut Lines<R>) -> Result<(), ImportError> {
    while let Some(line) = lines.next_bytes()? {
        if line.trim_ascii() == b"-1" {
            return Ok(());
        }
    }
    Ok(())
}

/// Reads the closing delimiter.
fn end<R: BufRead>(lines: &mut Lines<R>) -> Result<(), ImportError> {
    loop {
        let ended = match lines.next_text()? {
            None => return Err(at(lines, "the file ends within a dataset: it is cut short")),
            Some(line) if line.trim().is_empty() => continue,
            Some(line) => line.trim() == "-1",
        };
        return match ended {
            true => Ok(()),
            false => Err(at(lines, "more samples than the header says, or no delimiter -1")),
        };
    }
}

fn drop_bytes<R: BufRead>(lines: &mut Lines<R>, bytes: u64) -> Result<(), ImportError> {
    let dropped = std::io::copy(&mut lines.rest().take(bytes), &mut std::io::sink());
    match dropped.map_err(|error| ImportError::unreadable(&error))? == bytes {
        true => Ok(()),
        false => Err(at(lines, "the file ends within a binary block: it is cut short")),
    }
}

/// Records 1 to 11 of a dataset.
struct Header {
    id: String,
    date: String,
    function: i64,
    /// Type of the ordinate; 2: real single, 4: real double, others complex.
    ordinate: i64,
    points: usize,
    even: bool,
    first_s: f64,
    step_s: f64,
    /// Half the last digit of the step as written, as a share of it.
    rounding: f64,
    /// Type of the abscissa; 17: time.
    abscissa: i64,
    /// Unit of the time, if it is not the second.
    odd_time: Option<String>,
    unit: Option<String>,
}

impl Header {
    fn read<R: BufRead>(lines: &mut Lines<R>) -> Result<Self, ImportError> {
        let mut records: Vec<String> = Vec::with_capacity(11);
        for _ in 0..11 {
            let Some(line) = lines.next_text()?.map(|line| line.into_owned()) else {
                return Err(at(lines, "the file ends within a header: it is cut short"));
            };
            records.push(line);
        }
        let first = lines.number() - 10;
        let field = |record: usize, place: usize| {
            records
                .get(record - 1)
                .and_then(|line| line.split_whitespace().nth(place))
                .unwrap_or_default()
        };
        let refuse = |record: usize, text: &str, what: &str| {
            ImportError::at(
                format_args!("line {}", first as usize + record - 1),
                format!("{} is no {what}", shown(text)),
            )
        };
        let integer = |record: usize, place: usize, what: &str| {
            let text = field(record, place);
            text.parse::<i64>().map_err(|_| refuse(record, text, what))
        };
        let real = |place: usize, what: &str| {
            let text = field(7, place);
            float(text)
                .filter(|number| number.is_finite())
                .ok_or_else(|| refuse(7, text, what))
        };
        let points = integer(7, 1, "number of points")?;
        let step_s = real(4, "spacing of the time")?;
        let digits = field(7, 4).split(['e', 'E', 'd', 'D']).next().unwrap_or_default();
        let behind = digits
            .split_once('.')
            .map_or(0, |(_, behind)| behind.len().min(18)) as i32;
        let mantissa: f64 = digits.parse::<f64>().unwrap_or(1.0).abs();
        Ok(Self {
            id: records[0].trim().to_owned(),
            date: records[2].trim().to_owned(),
            function: integer(6, 0, "function type")?,
            ordinate: integer(7, 0, "data type")?,
            points: usize::try_from(points)
                .ok()
                .filter(|points| *points <= MOST_VALUES)
                .ok_or_else(|| refuse(7, &points.to_string(), "number of points that could be read"))?,
            even: integer(7, 2, "spacing, 0 or 1")? != 0,
            first_s: real(3, "beginning of the time")?,
            step_s,
            rounding: 0.5 * 10_f64.powi(-behind) / mantissa.max(f64::MIN_POSITIVE),
            abscissa: integer(8, 0, "kind of abscissa")?,
            odd_time: label(&records[7]).filter(|unit| TimeUnit::of(unit) != Some(TimeUnit::S)),
            unit: label(&records[8]),
        })
    }

    /// Kind of a dataset that is not a supported time history.
    fn foreign(&self) -> Option<String> {
        // Type 0 is unspecified; the abscissa then decides.
        let is_time = self.function == 1 || (self.function == 0 && self.abscissa == 17);
        if !is_time {
            return Some(format!(
                "a function of type {}, no time history (1)",
                self.function
            ));
        }
        if !matches!(self.abscissa, 0 | 1 | 17) {
            return Some(format!(
                "over a quantity of type {}, not over time (17)",
                self.abscissa
            ));
        }
        if let Some(unit) = &self.odd_time {
            return Some(format!("over a time in {unit:?}, not in seconds"));
        }
        (self.ordinate != 2 && self.ordinate != 4).then(|| "complex".to_owned())
    }

    /// Numbers of a text block: 13 or 20 columns each by the format, unless separated by blanks.
    fn numbers<R: BufRead>(&self, lines: &mut Lines<R>) -> Result<Vec<f64>, ImportError> {
        let wanted = self.points * if self.even { 1 } else { 2 };
        let widths: &[usize] = match (self.ordinate, self.even) {
            (2, _) => &[13],
            (_, true) => &[20],
            (_, false) => &[13, 20],
        };
        let mut values = Vec::new();
        while values.len() < wanted {
            let Some(line) = lines.next_text()?.map(|line| line.into_owned()) else {
                let have = values.len();
                return Err(at(
                    lines,
                    format!("the file ends after {have} of {wanted} numbers: it is cut short"),
                ));
            };
            if line.trim() == "-1" {
                let have = values.len();
                return Err(at(
                    lines,
                    format!("the dataset ends after {have} of {wanted} numbers"),
                ));
            }
            let apart: Option<Vec<f64>> = line.split_whitespace().map(float).collect();
            match apart.or_else(|| columns(&line, widths)) {
                Some(numbers) => values.extend(numbers),
                None => return Err(at(lines, format!("{} are no numbers", shown(&line)))),
            }
            if values.len() > wanted {
                return Err(at(lines, format!("more numbers than the {wanted} of the header")));
            }
        }
        Ok(values)
    }

    fn signal(self, number: usize, values: Vec<f64>, utc_offset_s: i32) -> Result<Signal, ImportError> {
        let name = match self.id.as_str() {
            "" | "NONE" => format!("uff-{number}"),
            id => id.to_owned(),
        };
        let start = date(&self.date, utc_offset_s);
        let refuse = |what: &str| ImportError::at(format_args!("dataset 58 number {number}"), what);
        let (timing, values) = if self.even {
            if self.step_s <= 0.0 {
                return Err(refuse("its time does not advance: the spacing is not positive"));
            }
            let timing = Timing::Rate {
                fs_hz: 1.0 / self.step_s,
                rounding: self.rounding,
                start: start.map(|start| start.plus_seconds(self.first_s)),
            };
            (timing, values)
        } else {
            let from = start.map_or(0, Timestamp::as_nanos);
            let mut nanos = Vec::with_capacity(self.points);
            let mut ordinates = Vec::with_capacity(self.points);
            let mut largest = 0.0_f64;
            for pair in values.chunks_exact(2) {
                if !pair[0].is_finite() || pair[0].abs() >= 1e9 {
                    return Err(refuse("a time beyond thirty years, or none"));
                }
                largest = largest.max(pair[0].abs());
                nanos.push(from.saturating_add((pair[0] * 1e9).round() as i64));
                ordinates.push(pair[1]);
            }
            // Times have six digits; the last ones are the coarsest.
            let coarsest = if largest > 0.0 {
                10_f64.powi(largest.log10().floor() as i32 - 5)
            } else {
                0.0
            };
            let stamps = Stamps {
                nanos,
                absolute: start.is_some(),
                resolution_ns: ((coarsest * 1e9) as i64).max(1),
                says_unit: true,
                lines: Vec::new(),
            };
            (Timing::Stamps(Arc::new(stamps)), ordinates)
        };
        Ok(Signal {
            name,
            number,
            unit: self.unit,
            timing,
            values,
        })
    }
}

/// Unit in the record of an axis.
fn label(record: &str) -> Option<String> {
    some(&record.chars().skip(47).take(20).collect::<String>())
}

/// A number as Fortran writes it, `D` exponents included.
fn float(text: &str) -> Option<f64> {
    text.parse()
        .ok()
        .or_else(|| text.replace(['D', 'd'], "e").parse().ok())
}

/// Numbers in columns of fixed widths, which repeat.
fn columns(line: &str, widths: &[usize]) -> Option<Vec<f64>> {
    let line = line.trim_end();
    let mut numbers = Vec::new();
    let mut begin = 0;
    for width in widths.iter().cycle() {
        if begin >= line.len() {
            break;
        }
        let end = (begin + width).min(line.len());
        numbers.push(float(line.get(begin..end)?.trim())?);
        begin = end;
    }
    Some(numbers)
}

/// Parses `16-Aug-26 14:03:12`; `None` for anything else, since the record is free text for many programs.
fn date(text: &str, utc_offset_s: i32) -> Option<Timestamp> {
    const MONTHS: [&str; 12] = [
        "jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec",
    ];
    let mut parts = text.split_whitespace();
    let (day, clock) = (parts.next()?, parts.next()?);
    // A third word may be AM or PM, or a zone: free text.
    if parts.next().is_some() {
        return None;
    }
    let mut day = day.split('-');
    let (of_month, month, year) = (day.next()?, day.next()?.to_lowercase(), day.next()?);
    let month = MONTHS.iter().position(|name| *name == month)? + 1;
    let year = match year.parse::<i32>().ok()? {
        year @ 0..70 => 2000 + year,
        year @ 70..100 => 1900 + year,
        year => year,
    };
    let of_month: u8 = of_month.parse().ok()?;
    let written = super::stamp::date(
        &format!("{year:04}-{month:02}-{of_month:02} {clock}"),
        None,
        utc_offset_s,
    )
    .ok()?;
    Some(Timestamp::from_nanos(written.nanos))
}

/// Block of a 58b dataset.
struct Binary {
    is_little: bool,
    bytes: u64,
}

impl Binary {
    /// Parses the dataset's first line: byte order, float format, lines of header, bytes.
    fn parse(line: &str, header: &Header) -> Result<Self, String> {
        let mut fields = line
            .split_whitespace()
            .skip(1)
            .map(|field| field.parse::<u64>().ok());
        let mut field = || fields.next().flatten();
        let (order, format, lines, bytes) = (field(), field(), field(), field());
        let is_little = match order {
            Some(1) => true,
            Some(2) => false,
            _ => return Err("58b without a byte order of 1 or 2".to_owned()),
        };
        if format != Some(2) {
            return Err("58b in another float format than IEEE 754 (2): export it as text".to_owned());
        }
        if lines != Some(11) {
            return Err("58b with another header than eleven lines".to_owned());
        }
        let bytes = bytes.ok_or("58b without a number of bytes")?;
        if header.foreign().is_none() {
            if !header.even {
                return Err(
                    "58b with a time to each sample is read as text only: export it as text".to_owned(),
                );
            }
            let size = if header.ordinate == 4 { 8 } else { 4 };
            if bytes != header.points as u64 * size {
                return Err(format!(
                    "58b of {bytes} bytes, but {} points of {size} bytes",
                    header.points
                ));
            }
        }
        Ok(Self { is_little, bytes })
    }

    fn values<R: BufRead>(&self, lines: &mut Lines<R>, header: &Header) -> Result<Vec<f64>, ImportError> {
        let mut block = Vec::new();
        let read = lines.rest().take(self.bytes).read_to_end(&mut block);
        read.map_err(|error| ImportError::unreadable(&error))?;
        if block.len() as u64 != self.bytes {
            return Err(at(
                lines,
                format!(
                    "the file ends after {} of {} bytes: it is cut short",
                    block.len(),
                    self.bytes
                ),
            ));
        }
        let double = |bytes: &[u8]| {
            <[u8; 8]>::try_from(bytes).map(if self.is_little {
                f64::from_le_bytes
            } else {
                f64::from_be_bytes
            })
        };
        let single = |bytes: &[u8]| {
            <[u8; 4]>::try_from(bytes).map(if self.is_little {
                f32::from_le_bytes
            } else {
                f32::from_be_bytes
            })
        };
        let values = match header.ordinate {
            4 => block
                .chunks_exact(8)
                .filter_map(|bytes| double(bytes).ok())
                .collect(),
            _ => block
                .chunks_exact(4)
                .filter_map(|bytes| single(bytes).ok().map(f64::from))
                .collect(),
        };
        Ok(values)
    }
}
