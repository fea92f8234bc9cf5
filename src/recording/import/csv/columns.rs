//! Turns rows of cells into signals: columns, numbers, stamps.

use super::cells::{is_missing, number};
use super::layout::{Layout, is_blank};
use super::{Table, Tabled, TimeColumn};
use crate::import::asked::tell_apart;
use crate::import::lines::shown;
use crate::import::stamp::{self, DateOrder, SINCE_2001, TimeUnit, Written};
use crate::import::{ImportError, MOST_VALUES, Signal, Stamps, Timing, is_time_name};
use std::sync::Arc;

/// State of a column while the table is read.
struct Column {
    place: usize,
    name: String,
    unit: Option<String>,
    values: Vec<f64>,
    /// True if every cell so far was empty.
    is_blank: bool,
    /// True if it was asked for by name.
    is_named: bool,
    /// True if it was found to hold text.
    is_text: bool,
}

/// Columns while the table is read.
pub(super) struct Columns {
    width: usize,
    /// Number of cells that a row needs.
    needed: usize,
    first_row: usize,
    decimal_comma: bool,
    columns: Vec<Column>,
    witnesses: Vec<Column>,
    skipped: Vec<String>,
    /// Number of lines of delimiters alone since the last one with more.
    blank_at_end: usize,
    time: Vec<usize>,
    /// Unit of numbers in the time column, `None` if nothing says it, or the head's text that is no unit.
    time_unit: Result<Option<TimeUnit>, String>,
    dates: Option<DateOrder>,
    utc_offset_s: i32,
    /// True once something says the unit: head, option, a date or time of day.
    says_unit: bool,
    nanos: Vec<i64>,
    lines: Vec<u32>,
    resolution_ns: i64,
    is_date: Option<bool>,
    /// True if any cell had a decimal point.
    pub(super) saw_point: bool,
    held: usize,
}

impl Columns {
    pub(super) fn choose(
        table: &Table,
        decimal_comma: bool,
        layout: Layout,
        mut names: Vec<String>,
        units: Vec<Option<String>>,
        rows: &[Vec<String>],
    ) -> Result<Self, ImportError> {
        tell_apart(&mut names);
        let width = names.len();
        let first = rows.get(layout.first).map(Vec::as_slice).unwrap_or_default();
        let find = |wanted: &String| {
            let named = names.iter().position(|name| name == wanted);
            let numbered = || {
                wanted
                    .parse::<usize>()
                    .ok()?
                    .checked_sub(1)
                    .filter(|place| *place < width)
            };
            named.or_else(numbered).ok_or_else(|| {
                let known: Vec<String> = names
                    .iter()
                    .enumerate()
                    .map(|(place, name)| {
                        if name.is_empty() {
                            (place + 1).to_string()
                        } else {
                            name.clone()
                        }
                    })
                    .collect();
                ImportError::new(format!("no column {wanted:?}; there is: {}", known.join(", ")))
            })
        };
        let time = match &table.time {
            TimeColumn::None => Vec::new(),
            TimeColumn::Named(columns) => columns.iter().map(find).collect::<Result<_, _>>()?,
            TimeColumn::Found => {
                let next = rows.get(layout.first + 1).map(Vec::as_slice).unwrap_or_default();
                found_time(&names, [first, next], decimal_comma)?
            }
        };
        let of_head = time
            .first()
            .and_then(|place| units.get(*place))
            .and_then(|unit| unit.as_deref());
        let time_unit = match (table.time_unit, of_head) {
            (Some(unit), _) => Ok(Some(unit)),
            (None, None) => Ok(None),
            // Heads of date columns have other words: "UTC", "local".
            (None, Some(head)) => TimeUnit::of(head).map(Some).ok_or_else(|| head.to_owned()),
        };
        let time_unit = match (time_unit, &time[..]) {
            (Ok(None), [place]) => {
                let of = |row: usize| number(rows.get(row)?.get(*place)?, decimal_comma);
                let pair = of(layout.first).zip(of(layout.first + 1));
                Ok(pair.and_then(|(first, next)| stamp::are_sheet_days(first, next).then_some(TimeUnit::D)))
            }
            (time_unit, _) => time_unit,
        };
        let mut skipped = Vec::new();
        let mut places: Vec<(usize, bool)> = Vec::new();
        for wanted in &table.columns {
            let place = find(wanted)?;
            if places.iter().all(|(known, _)| *known != place) {
                places.push((place, true));
            }
        }
        if table.columns.is_empty() {
            for place in (0..width).filter(|place| !time.contains(place)) {
                match layout.is_text.get(place) {
                    Some(true) => skipped.push(format!("{} holds text", shown_name(place, &names))),
                    _ => places.push((place, false)),
                }
            }
        }
        let column = |place: usize, is_named: bool| Column {
            place,
            name: names.get(place).cloned().unwrap_or_default(),
            unit: units.get(place).cloned().flatten(),
            values: Vec::new(),
            is_blank: true,
            is_named,
            is_text: false,
        };
        let columns: Vec<Column> = places
            .iter()
            .map(|(place, is_named)| column(*place, *is_named))
            .collect();
        // Without stamps, an unused column may contradict a given rate.
        let could_be_time =
            |place: &usize| *place == 0 || names.get(*place).is_some_and(|name| is_time_name(name));
        let witnesses = (0..width)
            .filter(|place| time.is_empty() && could_be_time(place))
            .filter(|place| columns.iter().all(|column| column.place != *place))
            .map(|place| column(place, false))
            .collect();
        Ok(Self {
            width,
            needed: layout.needed(),
            first_row: layout.first,
            decimal_comma,
            columns,
            witnesses,
            skipped,
            blank_at_end: 0,
            time,
            says_unit: !matches!(time_unit, Ok(None)),
            time_unit,
            dates: table.dates,
            utc_offset_s: table.utc_offset_s,
            nanos: Vec::new(),
            lines: Vec::new(),
            resolution_ns: i64::MAX,
            is_date: None,
            saw_point: false,
            held: 0,
        })
    }

    /// First row of data.
    pub(super) fn first_row(&self) -> usize {
        self.first_row
    }

    pub(super) fn count(&self) -> usize {
        self.columns.len()
    }

    pub(super) fn push(&mut self, row: &[String], line: u32) -> Result<(), ImportError> {
        // Without stamps, a line of delimiters alone is a missing sample; of one column, an empty line.
        let is_sample = self.time.is_empty() && (self.width == 1 || !row.is_empty());
        if is_blank(row) && !is_sample {
            return Ok(());
        }
        self.blank_at_end = if is_blank(row) { self.blank_at_end + 1 } else { 0 };
        let has_more = row.iter().skip(self.width).any(|cell| !cell.is_empty());
        if has_more || row.len() < self.needed && !is_blank(row) {
            return Err(ImportError::at(
                format_args!("line {line}"),
                format!("{} columns, {} in the rows before", row.len(), self.width),
            ));
        }
        self.held += self.columns.len() + self.witnesses.len() + usize::from(!self.time.is_empty());
        if self.held > MOST_VALUES {
            return Err(ImportError::too_long());
        }
        let mut turned_text = false;
        for column in &mut self.columns {
            let cell = row.get(column.place).map(String::as_str).unwrap_or_default();
            let value = if is_missing(cell) {
                column.is_blank &= cell.is_empty();
                f64::NAN
            } else {
                match number(cell, self.decimal_comma) {
                    Some(value) => {
                        self.saw_point |= cell.contains('.');
                        column.is_blank = false;
                        value
                    }
                    // Notes that begin further down.
                    None if column.is_blank
                        && !column.is_named
                        && number(cell, !self.decimal_comma).is_none() =>
                    {
                        column.is_text = true;
                        turned_text = true;
                        f64::NAN
                    }
                    None => return Err(fault(column, cell, line, self.decimal_comma)),
                }
            };
            column.values.push(value);
        }
        if turned_text {
            let of_text = |column: &Column| {
                let name = shown_column(column.place, &column.name);
                column.is_text.then(|| format!("{name} holds text"))
            };
            self.skipped.extend(self.columns.iter().filter_map(of_text));
            self.columns.retain(|column| !column.is_text);
        }
        let decimal_comma = self.decimal_comma;
        self.witnesses.retain_mut(|column| {
            let cell = row.get(column.place).map(String::as_str).unwrap_or_default();
            let value = number(cell, decimal_comma);
            column.values.extend(value);
            value.is_some()
        });
        if !self.time.is_empty() {
            self.stamp(row, line)?;
        }
        Ok(())
    }

    fn stamp(&mut self, row: &[String], line: u32) -> Result<(), ImportError> {
        let cells: Vec<&str> = self
            .time
            .iter()
            .filter_map(|place| row.get(*place))
            .map(String::as_str)
            .collect();
        let text = cells.join(" ");
        let refuse = |what: String| {
            let column = self.time.first().map_or(0, |place| place + 1);
            ImportError::at(
                format_args!("line {line}, column {column}"),
                format!("{} {what}", shown(&text)),
            )
        };
        let decimal = match self.decimal_comma {
            true => text.replace(',', "."),
            false => text.clone(),
        };
        if let (Ok(None), Ok(first)) = (&self.time_unit, decimal.parse())
            && self.nanos.is_empty()
            && stamp::likely_unit(first) != TimeUnit::S
        {
            self.time_unit = Ok(Some(stamp::likely_unit(first)));
            self.says_unit = true;
        }
        let unit = self
            .time_unit
            .as_ref()
            .ok()
            .copied()
            .flatten()
            .unwrap_or(TimeUnit::S);
        let written: Written = match (stamp::number(&decimal, unit), &self.time_unit) {
            (Some(written), Ok(_)) => written,
            (Some(_), Err(head)) => {
                return Err(refuse(format!(
                    "counts {head:?} by its head, which is not known: --time-unit says it"
                )));
            }
            (None, Ok(None)) if decimal.parse::<f64>().is_ok_and(|value| value.abs() > 9e9) => {
                return Err(refuse(
                    "lies beyond 292 years in seconds: --time-unit says the unit, ms, us or ns".to_owned(),
                ));
            }
            (None, _) => {
                self.says_unit = true;
                match stamp::clock(&text) {
                    Some(written) => written,
                    None => stamp::date(&text, self.dates, self.utc_offset_s).map_err(refuse)?,
                }
            }
        };
        if *self.is_date.get_or_insert(written.is_date) != written.is_date {
            return Err(refuse("is of another kind than the stamps before".to_owned()));
        }
        self.saw_point |= text.contains('.');
        self.resolution_ns = self.resolution_ns.min(written.resolution_ns);
        self.nanos.push(written.nanos);
        self.lines.push(line);
        Ok(())
    }

    pub(super) fn finish(self) -> Result<Tabled, ImportError> {
        let absolute =
            self.is_date == Some(true) || self.nanos.first().is_some_and(|first| *first >= SINCE_2001);
        let timing = if self.time.is_empty() {
            Timing::Unknown
        } else {
            Timing::Stamps(Arc::new(Stamps {
                nanos: self.nanos,
                absolute,
                resolution_ns: self.resolution_ns.max(1),
                says_unit: self.says_unit,
                lines: self.lines,
            }))
        };
        let blank_at_end = self.blank_at_end;
        let signal = |mut column: Column| {
            column
                .values
                .truncate(column.values.len().saturating_sub(blank_at_end));
            Signal {
                name: column.name,
                number: column.place + 1,
                unit: column.unit,
                timing: timing.clone(),
                values: column.values,
            }
        };
        let kept = self
            .columns
            .into_iter()
            .filter(|column| column.is_named || !column.is_blank);
        let signals: Vec<Signal> = kept.map(signal).collect();
        if signals.is_empty() {
            return Err(ImportError::new(match self.skipped.is_empty() {
                true => "has no column besides the time".to_owned(),
                false => format!(
                    "has no column of numbers besides the time ({})",
                    self.skipped.join(", ")
                ),
            }));
        }
        Ok(Tabled {
            signals,
            witnesses: self.witnesses.into_iter().map(signal).collect(),
            skipped: self.skipped,
        })
    }
}

/// Column called the time; with a column of days beside it, both.
/// Columns of the time by their names, from the first two rows: a day and a clock, or one that is called the time.
fn found_time(
    names: &[String],
    [first, next]: [&[String]; 2],
    decimal_comma: bool,
) -> Result<Vec<usize>, ImportError> {
    let called = |words: &[&str]| {
        let is_called = |name: &String| words.contains(&name.trim().to_lowercase().as_str());
        names.iter().position(is_called)
    };
    let is_day = |place: &usize| {
        let cell = first.get(*place).map(String::as_str).unwrap_or_default();
        cell.chars().filter(|c| "-./".contains(*c)).count() == 2 && !cell.contains([':', ' ', 'T'])
    };
    let is_clock = |place: &usize| first.get(*place).is_some_and(|cell| cell.contains(':'));
    let day = called(&["date", "datum", "data", "day", "tag", "giorno"]).filter(is_day);
    let clock = called(&["time", "uhrzeit", "zeit", "ora", "heure", "clock", "tempo"]).filter(is_clock);
    if let (Some(day), Some(clock)) = (day, clock) {
        return Ok(vec![day, clock]);
    }
    let rise = |place: usize| {
        let of = |row: &[String]| row.get(place).and_then(|cell| number(cell, decimal_comma));
        Some(of(next)? - of(first)?)
    };
    let mut called =
        (0..names.len()).filter(|place| names.get(*place).is_some_and(|name| is_time_name(name)));
    let Some(time) = called.next() else {
        return Ok(Vec::new());
    };
    // A count of rows, or the time in another unit.
    let differs = |other: &usize| {
        let (a, b) = (rise(time), rise(*other));
        a.zip(b)
            .is_some_and(|(a, b)| (a - b).abs() > 1e-3 * a.abs().max(b.abs()))
    };
    match called.find(differs) {
        Some(other) => Err(ImportError::new(format!(
            "{} and {} may both be the time, and rise differently: --time NAME says which",
            shown_name(time, names),
            shown_name(other, names)
        ))),
        None => Ok(vec![time]),
    }
}

fn shown_name(place: usize, names: &[String]) -> String {
    shown_column(place, names.get(place).map(String::as_str).unwrap_or_default())
}

fn shown_column(place: usize, name: &str) -> String {
    match name {
        "" => format!("column {}", place + 1),
        name => format!("column {} ({name})", place + 1),
    }
}

fn fault(column: &Column, cell: &str, line: u32, decimal_comma: bool) -> ImportError {
    let next = match decimal_comma {
        false if cell.contains(',') => "; --decimal-comma if the comma is the decimal sign",
        true if cell.contains('.') => "; points and commas in one table cannot be told apart",
        _ => "; --channel chooses columns",
    };
    let name = if column.name.is_empty() {
        String::new()
    } else {
        format!(" ({})", column.name)
    };
    ImportError::at(
        format_args!("line {line}, column {}{name}", column.place + 1),
        format!("{} is no number{next}", shown(cell)),
    )
}
