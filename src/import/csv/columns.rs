//! Rows of cells to signals: which columns, their numbers, their stamps.

use super::cells::{is_missing, number};
use super::{Table, TimeColumn};
use crate::import::lines::shown;
use crate::import::stamp::{self, DateOrder, SINCE_2001, TimeUnit, Written};
use crate::import::{ImportError, MOST_VALUES, Signal, Stamps, Timing, is_time_name};
use std::sync::Arc;

/// What becomes of a column.
struct Column {
    place: usize,
    name: String,
    unit: Option<String>,
    values: Vec<f64>,
    /// Whether every cell so far was empty.
    is_blank: bool,
    /// Whether it was asked for by name.
    is_named: bool,
}

/// The columns in the making.
pub(super) struct Columns {
    width: usize,
    decimal_comma: bool,
    columns: Vec<Column>,
    time: Vec<usize>,
    /// What numbers count, or what the head says instead.
    time_unit: Result<TimeUnit, String>,
    dates: Option<DateOrder>,
    utc_offset_s: i32,
    nanos: Vec<i64>,
    lines: Vec<u32>,
    resolution_ns: i64,
    is_date: Option<bool>,
    /// Whether any cell had a decimal point.
    pub(super) saw_point: bool,
    held: usize,
}

impl Columns {
    pub(super) fn choose(
        table: &Table,
        names: Vec<String>,
        units: Vec<Option<String>>,
    ) -> Result<Self, ImportError> {
        let width = names.len();
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
            TimeColumn::Found => names
                .iter()
                .position(|name| is_time_name(name))
                .into_iter()
                .collect(),
        };
        let of_head = time
            .first()
            .and_then(|place| units.get(*place))
            .and_then(|unit| unit.as_deref());
        let time_unit = match (table.time_unit, of_head) {
            (Some(unit), _) => Ok(unit),
            (None, None) => Ok(TimeUnit::S),
            // Heads of dates say other things: "UTC", "local".
            (None, Some(head)) => TimeUnit::of(head).ok_or_else(|| head.to_owned()),
        };
        let mut places: Vec<(usize, bool)> = Vec::new();
        for wanted in &table.columns {
            let place = find(wanted)?;
            if places.iter().all(|(known, _)| *known != place) {
                places.push((place, true));
            }
        }
        if table.columns.is_empty() {
            places.extend(
                (0..width)
                    .filter(|place| !time.contains(place))
                    .map(|place| (place, false)),
            );
        }
        let columns = places.into_iter().map(|(place, is_named)| Column {
            place,
            name: names.get(place).cloned().unwrap_or_default(),
            unit: units.get(place).cloned().flatten(),
            values: Vec::new(),
            is_blank: true,
            is_named,
        });
        Ok(Self {
            width,
            decimal_comma: table.decimal_comma,
            columns: columns.collect(),
            time,
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

    pub(super) fn count(&self) -> usize {
        self.columns.len()
    }

    pub(super) fn push(&mut self, row: &[String], line: u32) -> Result<(), ImportError> {
        if row.is_empty() {
            return Ok(());
        }
        if row.len() != self.width {
            return Err(ImportError::at(
                format_args!("line {line}"),
                format!("{} columns, {} in the rows before", row.len(), self.width),
            ));
        }
        self.held += self.columns.len() + usize::from(!self.time.is_empty());
        if self.held > MOST_VALUES {
            return Err(ImportError::too_long());
        }
        for column in &mut self.columns {
            let Some(cell) = row.get(column.place) else {
                continue;
            };
            let value = if is_missing(cell) {
                column.is_blank &= cell.is_empty();
                f64::NAN
            } else {
                column.is_blank = false;
                self.saw_point |= cell.contains('.');
                number(cell, self.decimal_comma)
                    .ok_or_else(|| fault(column, cell, line, self.decimal_comma))?
            };
            column.values.push(value);
        }
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
                format!(
                    "{} {what}; --time none with --rate leaves stamps out",
                    shown(&text)
                ),
            )
        };
        let decimal = match self.decimal_comma {
            true => text.replace(',', "."),
            false => text.clone(),
        };
        let unit = self.time_unit.as_ref().copied().unwrap_or(TimeUnit::S);
        let written: Written = match (stamp::number(&decimal, unit), &self.time_unit) {
            (Some(written), Ok(_)) => written,
            (Some(_), Err(head)) => {
                return Err(refuse(format!(
                    "counts {head:?} by its head, which is not known: --time-unit says it"
                )));
            }
            (None, _) => stamp::date(&text, self.dates, self.utc_offset_s).map_err(refuse)?,
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

    pub(super) fn finish(self) -> Result<Vec<Signal>, ImportError> {
        let absolute =
            self.is_date == Some(true) || self.nanos.first().is_some_and(|first| *first >= SINCE_2001);
        let timing = if self.time.is_empty() {
            Timing::Unknown
        } else {
            Timing::Stamps(Arc::new(Stamps {
                nanos: self.nanos,
                absolute,
                resolution_ns: self.resolution_ns.max(1),
                lines: self.lines,
            }))
        };
        let kept = self
            .columns
            .into_iter()
            .filter(|column| column.is_named || !column.is_blank);
        let signals: Vec<Signal> = kept
            .map(|column| Signal {
                name: column.name,
                number: column.place + 1,
                unit: column.unit,
                timing: timing.clone(),
                values: column.values,
            })
            .collect();
        if signals.is_empty() {
            return Err(ImportError::new("has no column besides the time"));
        }
        Ok(signals)
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
