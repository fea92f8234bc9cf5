//! LabVIEW measurement files (`.lvm`): text with a header, then segments with headers and rows of their own.
//!
//! <https://www.ni.com/en/support/documentation/supplemental/06/specification-for-the-labview-measurement-file---lvm-.html>
//!
//! * `segment` the header of a segment, its rows, and its channels' pieces

mod segment;

use super::lines::Lines;
use super::{ImportError, MOST_VALUES, Signal, Stamps, Timing, grid};
use segment::{Piece, Segment, When};
use std::io::BufRead;
use std::sync::Arc;

/// Most lines of a header.
const HEADER: usize = 1000;

/// Content of a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Measured {
    /// Channels, the segments of each joined.
    pub signals: Vec<Signal>,
    /// Items left out, one sentence each.
    pub skipped: Vec<String>,
}

/// Facts of a file's header.
#[derive(Debug, Clone)]
struct Header {
    separator: char,
    decimal_comma: bool,
    /// True if times of the x column may count from 1904.
    is_absolute: bool,
    /// Date and time of day of the file.
    date: String,
    time: String,
    /// Offset of dates ahead of UTC \[s\].
    utc_offset_s: i32,
}

/// Reads every channel. Dates have no offset and are taken as `utc_offset_s` ahead of UTC.
///
/// # Errors
/// The first thing that is wrong, with its line.
pub fn read(from: impl BufRead, utc_offset_s: i32) -> Result<Measured, ImportError> {
    let mut lines = Lines::new(from);
    let header = Header::read(&mut lines, utc_offset_s)?;
    let mut found = Measured::default();
    let mut pieces: Vec<Vec<Piece>> = Vec::new();
    let mut held = 0;
    let mut rows: Option<Segment> = None;
    let mut head: Vec<Vec<String>> = Vec::new();
    let mut is_special = false;
    let mut after_blank = false;
    while let Some(line) = lines.next_text()? {
        let cells: Vec<String> = line
            .split(header.separator)
            .map(|cell| cell.trim().to_owned())
            .collect();
        let first = cells.first().map(String::as_str).unwrap_or_default();
        let number = lines.number();
        if is_special {
            is_special = first != "***End_Special***";
        } else if first == "***Start_Special***" {
            is_special = true;
        } else if cells.iter().all(String::is_empty) {
            after_blank = true;
        } else if let Some(segment) = rows.as_mut().filter(|_| !is_key(first)) {
            // The next segment needs its own header, or stamps; otherwise its start is unknown.
            if after_blank && !segment.has_stamps() {
                return Err(ImportError::at(
                    format_args!("line {number}"),
                    "a segment without a header and without X values: nobody says when it began",
                ));
            }
            after_blank = false;
            held += segment.push(&cells, &header, number)?;
            if held > MOST_VALUES {
                return Err(ImportError::too_long());
            }
        } else {
            if let Some(segment) = rows.take() {
                segment.finish(&header, &mut pieces, &mut found.skipped)?;
            }
            after_blank = false;
            if first == "X_Value" {
                rows = Some(Segment::new(std::mem::take(&mut head), cells, &header, number)?);
            } else if head.len() < HEADER {
                head.push(cells);
            } else {
                return Err(ImportError::at(
                    format_args!("line {number}"),
                    format!("a header of more than {HEADER} lines: damaged"),
                ));
            }
        }
    }
    match rows {
        Some(segment) => segment.finish(&header, &mut pieces, &mut found.skipped)?,
        None if !head.is_empty() => {
            return Err(ImportError::new(
                "ends within the header of a segment: it is cut short",
            ));
        }
        None => {}
    }
    for of_channel in pieces {
        let number = found.signals.len() + 1;
        found.signals.extend(joined(of_channel, number)?);
    }
    if found.signals.is_empty() {
        let rest = match found.skipped.is_empty() {
            true => String::new(),
            false => format!(" (but {})", found.skipped.join("; ")),
        };
        return Err(ImportError::new(format!("holds no samples over time{rest}")));
    }
    Ok(found)
}

/// True if a cell is the name of a fact rather than a number or empty.
fn is_key(cell: &str) -> bool {
    cell.starts_with(|c: char| c.is_alphabetic() || c == '*')
        && !cell.to_lowercase().starts_with("nan")
        && !cell.to_lowercase().starts_with("inf")
}

impl Header {
    fn read<R: BufRead>(lines: &mut Lines<R>, utc_offset_s: i32) -> Result<Self, ImportError> {
        let mut header = Self {
            separator: '\t',
            decimal_comma: false,
            is_absolute: false,
            date: String::new(),
            time: String::new(),
            utc_offset_s,
        };
        let first = lines
            .next_text()?
            .map(|line| line.trim().to_owned())
            .unwrap_or_default();
        let rest = first.strip_prefix("LabVIEW Measurement");
        match rest.and_then(|rest| rest.chars().next()) {
            _ if rest.is_none() => return Err(ImportError::new("is no LabVIEW measurement file")),
            Some(separator) if !separator.is_alphanumeric() => header.separator = separator,
            _ => {}
        }
        for _ in 0..HEADER {
            let Some(line) = lines.next_text()? else {
                return Err(ImportError::new("ends within its header: it is cut short"));
            };
            if line.starts_with("***End_of_Header***") {
                return Ok(header);
            }
            // The line of the separator is the first that shows it.
            if let Some(separator) = line
                .strip_prefix("Separator")
                .and_then(|rest| rest.chars().next())
            {
                header.separator = separator;
            }
            let (key, value) = line.split_once(header.separator).unwrap_or((&line, ""));
            let value = value.trim_end_matches(header.separator).trim();
            match key.trim() {
                "Decimal_Separator" => header.decimal_comma = value == ",",
                "Time_Pref" => header.is_absolute = value.eq_ignore_ascii_case("absolute"),
                "Date" => header.date = value.to_owned(),
                "Time" => header.time = value.to_owned(),
                _ => {}
            }
        }
        Err(ImportError::new(
            "has no ***End_of_Header***: damaged, or another format",
        ))
    }
}

/// Joins the pieces of a channel into one signal; `None` without samples.
fn joined(pieces: Vec<Piece>, number: usize) -> Result<Option<Signal>, ImportError> {
    let Some(first) = pieces.first() else {
        return Ok(None);
    };
    let (name, unit) = (first.name.clone(), first.unit.clone());
    let one = match &pieces[..] {
        [one] => Some(one.when.clone()),
        _ => None,
    };
    let timing = match one {
        Some(When::Even {
            step_s,
            rounding,
            start,
        }) => Timing::Rate {
            fs_hz: 1.0 / step_s,
            rounding,
            start,
        },
        Some(When::Unknown) => Timing::Unknown,
        Some(When::Stamped(stamps)) => Timing::Stamps(Arc::new(stamps)),
        None => Timing::Stamps(Arc::new(together(&pieces)?)),
    };
    Ok(Some(Signal {
        name,
        number,
        unit,
        timing,
        values: pieces.into_iter().flat_map(|piece| piece.values).collect(),
    }))
}

/// Relative rounding of a step above which it gives no rate.
const COARSE: f64 = 1e-3;

/// Joins the stamps of several pieces.
fn together(pieces: &[Piece]) -> Result<Stamps, ImportError> {
    let mut all = Stamps {
        nanos: Vec::new(),
        absolute: true,
        resolution_ns: 1,
        says_unit: true,
        lines: Vec::new(),
    };
    for piece in pieces {
        match &piece.when {
            When::Even { rounding, .. } if *rounding > COARSE => {
                return Err(ImportError::at(
                    format_args!("the segment at line {}", piece.line),
                    "of several segments, with a Delta_X of too few digits to say where each one ends: export it with X values",
                ));
            }
            When::Unknown => {
                return Err(ImportError::at(
                    format_args!("the segment at line {}", piece.line),
                    "of several segments, and neither X values nor Delta_X say when its samples were taken",
                ));
            }
            When::Stamped(stamps) => {
                all.absolute &= stamps.absolute;
                all.resolution_ns = all.resolution_ns.max(stamps.resolution_ns);
                all.nanos.extend(&stamps.nanos);
            }
            When::Even {
                step_s,
                rounding,
                start,
            } => {
                all.absolute &= start.is_some();
                let from = start.map_or(0, |start| start.as_nanos());
                let step_ns = grid::simplest(step_s * 1e9, step_s * 1e9 * rounding);
                let stamp = |index: usize| from.saturating_add((index as f64 * step_ns).round() as i64);
                all.nanos.extend((0..piece.values.len()).map(stamp));
            }
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::{Asked, Plan};
    use crate::write::Encoding;
    use tirante_analysis::signal::record::Unit;

    const HEAD: &str = "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nMulti_Headings\tYes\nX_Columns\tNo\nTime_Pref\tRelative\nDate\t2026/03/01\nTime\t06:00:00,1970510124996275989\n***End_of_Header***\t\n\t\n";
    const SEGMENT: &str = "Channels\t2\t\t\nSamples\t3\t3\t\nDate\t2026/03/01\t2026/03/01\t\nTime\t06:00:01,5\t06:00:01,5\t\nY_Unit_Label\tNewtons\tm/s^2\t\nX_Dimension\tTime\tTime\t\nX0\t0,0000000000000000E+0\t0,0000000000000000E+0\t\nDelta_X\t3,906250E-3\t3,906250E-3\t\n***End_of_Header***\t\t\t\nX_Value\tForce\tResponse\tComment\n\t0,5\t1,25\n\t-0,5\t1,5\tok\n\t1,0E-3\t\n";

    fn signals(text: &str) -> Result<Vec<Signal>, String> {
        let found = read(text.as_bytes(), 0);
        found
            .map(|found| found.signals)
            .map_err(|error| error.to_string())
    }

    #[test]
    fn columns_without_x_and_decimal_commas() {
        let found = signals(&format!("{HEAD}{SEGMENT}")).unwrap();
        assert_eq!(
            (found[1].name.as_str(), found[1].unit.as_deref()),
            ("Response", Some("m/s^2"))
        );
        assert_eq!(found[0].values, [0.5, -0.5, 1e-3]);
        assert_eq!(
            found[1].values,
            [1.25, 1.5],
            "a channel that ends earlier is shorter"
        );
        let Timing::Rate { fs_hz, start, .. } = &found[0].timing else {
            panic!()
        };
        assert_eq!(*fs_hz, 256.0);
        assert_eq!(start.unwrap().to_string(), "2026-03-01T06:00:01.5Z");
    }

    #[test]
    fn several_segments_are_stretches_with_their_own_times() {
        let first = format!("{SEGMENT}{}", "\t0,25\t0,5\t\n".repeat(20));
        let later = first.replace("06:00:01,5", "06:00:09,25");
        let found = signals(&format!("{HEAD}{first}\n{later}")).unwrap();
        assert_eq!(found[0].values.len(), 46);
        let asked = Asked {
            unit: Some(Unit::Millimetre),
            ..Asked::default()
        };
        let plan = Plan::new(vec![found[0].clone()], &asked, Encoding::Json).unwrap();
        let starts: Vec<String> = plan.channels[0]
            .stretches
            .iter()
            .map(|(start, _)| start.to_string())
            .collect();
        assert_eq!(starts, ["2026-03-01T06:00:01.5Z", "2026-03-01T06:00:09.25Z"]);
        assert_eq!(plan.channels[0].fs_hz, 256.0);
    }

    #[test]
    fn one_x_column_counts_more_than_the_step_of_single_points() {
        let text = "LabVIEW Measurement,\nSeparator,Comma\nX_Columns,One\nTime_Pref,Absolute\nDate,2026/03/01\nTime,06:00:00\n***End_of_Header***,\n,\nChannels,1,\nSamples,1,\nDelta_X,1.000000,\n***End_of_Header***,\nX_Value,Weg,Comment\n0.000,1.5,LOST\n0.005,2.5,OK\n0.010,3.5\n";
        let found = signals(text).unwrap();
        assert_eq!(found[0].values, [1.5, 2.5, 3.5]);
        let Timing::Stamps(stamps) = &found[0].timing else {
            panic!()
        };
        assert!(stamps.absolute);
        assert_eq!(stamps.nanos[1] - stamps.nanos[0], 5_000_000);
        // Counted from 1904.
        let text = text.replace("\n0.0", "\n3855189600.0");
        let Timing::Stamps(stamps) = &signals(&text).unwrap()[0].timing else {
            panic!()
        };
        assert_eq!(stamps.nanos[0], 1_772_344_800_000_000_000);
    }

    #[test]
    fn each_channel_may_have_its_x_column() {
        let text = "LabVIEW Measurement\t\nX_Columns\tMulti\n***End_of_Header***\t\n\t\nChannels\t2\t\t\t\nY_Unit_Label\tVolts\t\tg\t\nX_Dimension\tTime\t\tFrequency\t\n***End_of_Header***\nX_Value\tVoltage\tX_Value\tLevel\tComment\n0.00\t1\t5\t7\n0.01\t2\t6\t8\n";
        let found = read(text.as_bytes(), 0).unwrap();
        assert_eq!(found.signals.len(), 1);
        assert_eq!(
            (found.signals[0].name.as_str(), found.signals[0].unit.as_deref()),
            ("Voltage", Some("Volts"))
        );
        assert!(
            found.skipped[0].contains("over \"Frequency\""),
            "{:?}",
            found.skipped
        );
    }

    #[test]
    fn faults_name_the_line() {
        let refused = |text: &str| signals(text).unwrap_err();
        let broken = SEGMENT.replace("-0,5", "broken");
        assert_eq!(
            refused(&format!("{HEAD}{broken}")),
            "line 24, column 2 (Force): \"broken\" is no number"
        );
        assert!(refused(&format!("{HEAD}{SEGMENT}\n\t1,5\t2,5\n")).contains("nobody says when it began"));
        assert!(refused("LabVIEW Measurement\t\n").contains("cut short"));
        assert!(refused("LabVIEW\n").contains("is no LabVIEW"));
        assert!(refused(&format!("{HEAD}Channels\t2\n")).contains("cut short"));
        assert!(refused(HEAD).contains("holds no samples"));
        let double = SEGMENT.replace("Channels\t2", "Channels\t9");
        assert!(refused(&format!("{HEAD}{double}")).contains("9 channels"));
    }
}
