//! Text tables: any delimiter, decimal comma, heads, dates.

use super::heads::{some, split_head};
use super::lines::{Lines, shown};
use super::stamp::{self, DateOrder, TimeUnit, Written};
use super::{ImportError, MOST_VALUES, Signal, Stamps, Timing, is_time_name};
use crate::record::Unit;
use csv_core::{ReadRecordResult, Reader, ReaderBuilder};
use std::io::BufRead;
use std::sync::Arc;

/// Lines looked at to find delimiter and heads.
const HEAD: usize = 200;
/// The most columns.
const COLUMNS: usize = 1024;

/// How a text table is read.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Table {
    /// What stands between columns; none: found from the file. A blank stands for any number of blanks and tabs.
    pub delimiter: Option<u8>,
    /// Whether decimals stand behind a comma.
    pub decimal_comma: bool,
    /// Lines before the first row of data; none: found from the file.
    pub head_lines: Option<usize>,
    /// Where the stamps are.
    pub time: TimeColumn,
    /// What numbers in the time column count; none: what its head says, else seconds.
    pub time_unit: Option<TimeUnit>,
    /// How dates with slashes are meant.
    pub dates: Option<DateOrder>,
    /// How far dates without an offset of their own are ahead of UTC \[s\].
    pub utc_offset_s: i32,
    /// The columns wanted, by name or number; empty: all.
    pub columns: Vec<String>,
}

/// Where the stamps are.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum TimeColumn {
    /// In the column whose head says so, if there is one.
    #[default]
    Found,
    /// Nowhere: a column of stamps is none.
    None,
    /// In this column, or in these two (day and time of day), by name or number.
    Named(Vec<String>),
}

/// Reads a table.
///
/// # Errors
/// The first thing that is wrong, with line and column.
pub fn read(from: impl BufRead, table: &Table) -> Result<Vec<Signal>, ImportError> {
    let mut lines = Lines::new(from);
    let mut head = Vec::new();
    while head.len() < HEAD
        && let Some(line) = lines.next_text()?
    {
        head.push(line.into_owned());
    }
    let delimiter = table
        .delimiter
        .unwrap_or_else(|| guess(&head, table.decimal_comma));
    if table.decimal_comma && delimiter == b',' {
        return Err(ImportError::new(
            "the comma cannot be delimiter and decimal sign: say --delimiter",
        ));
    }
    let mut splitter = Splitter::new(delimiter);
    let mut rows = Vec::with_capacity(head.len());
    for (index, line) in head.iter().enumerate() {
        rows.push(splitter.split(line, index as u32 + 1)?);
    }
    let first = match table.head_lines {
        Some(lines) => lines,
        None => rows.iter().position(|row| is_data(row, table.decimal_comma)).ok_or_else(|| {
            ImportError::new(format!(
                "no row of numbers in the first {} lines: is '{}' the delimiter (--delimiter), a comma the decimal \
                 sign (--decimal-comma)?",
                rows.len(),
                named(delimiter)
            ))
        })?,
    };
    if table.head_lines.is_none() {
        check_head(&head[..first], delimiter)?;
    }
    let Some(row) = rows.get(first) else {
        return Err(ImportError::new(format!(
            "has no line {} to begin with",
            first + 1
        )));
    };
    let width = row.len();
    if width > COLUMNS {
        return Err(ImportError::at(
            format_args!("line {}", first + 1),
            format!("{width} columns: at most {COLUMNS} are read"),
        ));
    }
    let (names, units) = heads(&rows[..first], width);
    let mut columns = Columns::choose(table, names, units)?;
    for (index, row) in rows.iter().enumerate().skip(first) {
        columns.push(row, index as u32 + 1)?;
    }
    drop(rows);
    while let Some(line) = lines.next_text()? {
        let line = line.into_owned();
        let row = splitter.split(&line, lines.number())?;
        columns.push(&row, lines.number())?;
    }
    if table.delimiter.is_none() && delimiter == b',' && !columns.saw_point && columns.count() > 1 {
        return Err(ImportError::new(
            "only whole numbers with commas between: columns (--delimiter ,) or decimals (--decimal-comma)?",
        ));
    }
    columns.finish()
}

/// What stands between the columns of most lines.
fn guess(head: &[String], decimal_comma: bool) -> u8 {
    let lines = || {
        head.iter()
            .map(|line| line.trim())
            .filter(|line| !line.is_empty())
    };
    let half = lines().count() / 2;
    let is_usual = |delimiter: char| lines().filter(|line| line.contains(delimiter)).count() > half;
    match () {
        () if is_usual(';') => b';',
        () if is_usual('\t') => b'\t',
        () if is_usual(',') && !decimal_comma => b',',
        () if is_usual(' ') => b' ',
        // One column.
        () => b';',
    }
}

/// Refuses to pass over a line that looks like data before the first row of data.
fn check_head(head: &[String], delimiter: u8) -> Result<(), ImportError> {
    let is_like_data = |line: &str| {
        line.contains(|c: char| c.is_ascii_digit())
            && line
                .chars()
                .all(|c| c.is_ascii_digit() || "+-.,;:/eE \t|".contains(c))
    };
    match head.iter().position(|line| is_like_data(line)) {
        None => Ok(()),
        Some(index) => Err(ImportError::at(
            format_args!("line {}", index + 1),
            format!(
                "looks like data but has other columns than what follows (delimiter {}): --head-lines and --delimiter say how \
                 the file is made",
                named(delimiter)
            ),
        )),
    }
}

fn named(delimiter: u8) -> String {
    match delimiter {
        b' ' => "blank".to_owned(),
        b'\t' => "tab".to_owned(),
        other => char::from(other).to_string(),
    }
}

/// Lines to cells, quotes undone.
struct Splitter {
    delimiter: u8,
    reader: Reader,
    text: Vec<u8>,
    ends: Vec<usize>,
}

impl Splitter {
    fn new(delimiter: u8) -> Self {
        Self {
            delimiter,
            reader: ReaderBuilder::new().delimiter(delimiter).build(),
            text: Vec::new(),
            ends: Vec::new(),
        }
    }

    fn split(&mut self, line: &str, number: u32) -> Result<Vec<String>, ImportError> {
        if line.trim().is_empty() {
            return Ok(Vec::new());
        }
        if self.delimiter == b' ' {
            return Ok(line.split_whitespace().map(str::to_owned).collect());
        }
        let mut whole = line.as_bytes().to_vec();
        whole.push(b'\n');
        // Cells are never longer than their line, and never more than its bytes.
        self.text.resize(whole.len() + 1, 0);
        self.ends.resize(whole.len() + 1, 0);
        self.reader.reset();
        let (outcome, _, _, ends) = self.reader.read_record(&whole, &mut self.text, &mut self.ends);
        if !matches!(outcome, ReadRecordResult::Record) {
            return Err(ImportError::at(
                format_args!("line {number}"),
                "a quote is not closed on its line",
            ));
        }
        let mut begin = 0;
        let mut cells = Vec::with_capacity(ends);
        for &end in self.ends.iter().take(ends) {
            let cell = self.text.get(begin..end).unwrap_or_default();
            cells.push(super::lines::text(cell).trim().to_owned());
            begin = end;
        }
        Ok(cells)
    }
}

/// Whether every cell could be a number, a date or nothing, and at least one is.
fn is_data(row: &[String], decimal_comma: bool) -> bool {
    let is_number = |cell: &str| number(cell, decimal_comma).is_some();
    let is_date = |cell: &str| {
        cell.starts_with(|c: char| c.is_ascii_digit())
            && cell
                .chars()
                .all(|c| c.is_ascii_digit() || "-/.:,TZ+ ".contains(c))
    };
    let some = row
        .iter()
        .any(|cell| !is_missing(cell) && (is_number(cell) || is_date(cell)));
    some && row
        .iter()
        .all(|cell| is_missing(cell) || is_number(cell) || is_date(cell))
}

fn is_missing(cell: &str) -> bool {
    cell.is_empty()
        || ["nan", "null", "na", "n/a"]
            .iter()
            .any(|word| cell.eq_ignore_ascii_case(word))
}

fn number(cell: &str, decimal_comma: bool) -> Option<f64> {
    if !decimal_comma {
        return cell.parse().ok();
    }
    // A point beside decimal commas would stand for thousands.
    if cell.contains('.') {
        return None;
    }
    cell.replace(',', ".").parse().ok()
}

/// Names and units from the lines with as many cells just before the data: the last of them gives units if it holds any, and the
/// one above then names, else it names.
fn heads(before: &[Vec<String>], width: usize) -> (Vec<String>, Vec<Option<String>>) {
    let matching = before
        .iter()
        .rev()
        .take_while(|row| row.len() == width || row.is_empty());
    let matching: Vec<&Vec<String>> = matching.filter(|row| !row.is_empty()).collect();
    let mut names = vec![String::new(); width];
    let mut units = vec![None; width];
    let is_unit = |cell: &String| {
        some(cell).is_some_and(|unit| Unit::as_written(&unit).is_some() || TimeUnit::of(&unit).is_some())
    };
    let (row_of_units, row_of_names) = match matching[..] {
        // "t" and "s" alone could be names as well.
        [last, above, ..] if last.iter().any(is_unit) => (Some(last), Some(above)),
        [last, ..] => (None, Some(last)),
        [] => (None, None),
    };
    for ((name, unit), head) in names
        .iter_mut()
        .zip(&mut units)
        .zip(row_of_names.into_iter().flatten())
    {
        (*name, *unit) = split_head(head);
    }
    for (unit, cell) in units.iter_mut().zip(row_of_units.into_iter().flatten()) {
        if unit.is_none() {
            *unit = some(cell);
        }
    }
    (names, units)
}

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
struct Columns {
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
    saw_point: bool,
    held: usize,
}

impl Columns {
    fn choose(table: &Table, names: Vec<String>, units: Vec<Option<String>>) -> Result<Self, ImportError> {
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

    fn count(&self) -> usize {
        self.columns.len()
    }

    fn push(&mut self, row: &[String], line: u32) -> Result<(), ImportError> {
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

    fn finish(self) -> Result<Vec<Signal>, ImportError> {
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

/// Numbers from here on count from 1970: 10^9 s, in September 2001.
pub(super) const SINCE_2001: i64 = 1_000_000_000_000_000_000;

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

#[cfg(test)]
mod tests {
    use super::*;

    fn signals(text: &str, table: &Table) -> Result<Vec<Signal>, String> {
        read(text.as_bytes(), table).map_err(|error| error.to_string())
    }

    fn nanos(signal: &Signal) -> &[i64] {
        match &signal.timing {
            Timing::Stamps(stamps) => &stamps.nanos,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_plain_table() {
        let found = signals(
            "Time [ms],disp [mm],air (°C)\n0,0.1,20\n5,-0.25,\n",
            &Table::default(),
        )
        .unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!(
            (found[0].name.as_str(), found[0].unit.as_deref(), found[0].number),
            ("disp", Some("mm"), 2)
        );
        assert_eq!(
            (found[1].name.as_str(), found[1].unit.as_deref()),
            ("air", Some("°C"))
        );
        assert_eq!(found[0].values, [0.1, -0.25]);
        assert!(found[1].values[1].is_nan());
        assert_eq!(nanos(&found[0]), [0, 5_000_000]);
    }

    #[test]
    fn decimal_commas_day_first_dates_preamble_and_a_row_of_units() {
        let text = "Logger 7;\r\nSerial;12\r\nDatum;Uhrzeit;Weg 1;\r\n;;µm;\r\n01.03.2026;06:00:00,000;1,5;\r\n01.03.2026;06:00:00,005;-2,25E-3;\r\n";
        let table = Table {
            decimal_comma: true,
            time: TimeColumn::Named(vec!["Datum".into(), "2".into()]),
            ..Table::default()
        };
        let found = signals(text, &table).unwrap();
        assert_eq!(found.len(), 1, "the empty last column is none");
        assert_eq!(
            (found[0].name.as_str(), found[0].unit.as_deref()),
            ("Weg 1", Some("µm"))
        );
        assert_eq!(found[0].values, [1.5, -2.25e-3]);
        assert_eq!(nanos(&found[0])[1] - nanos(&found[0])[0], 5_000_000);
        assert_eq!(nanos(&found[0])[0], 1_772_344_800_000_000_000);
    }

    #[test]
    fn names_stand_above_units_and_below_everything_else() {
        let text = "Kanal;1;2\nName;Weg;Luft\n[ms];µm;°C\n0;1.5;20\n5;2.5;21\n";
        let table = Table {
            time: TimeColumn::Named(vec!["1".into()]),
            ..Table::default()
        };
        let found = signals(text, &table).unwrap();
        assert_eq!(
            (found[0].name.as_str(), found[0].unit.as_deref()),
            ("Weg", Some("µm"))
        );
        assert_eq!(
            (found[1].name.as_str(), found[1].unit.as_deref()),
            ("Luft", Some("°C"))
        );
        assert_eq!(nanos(&found[0]), [0, 5_000_000]);
        let found = signals("Kanal;1;2\nt;Weg;Luft\n0;1.5;20\n5;2.5;21\n", &Table::default()).unwrap();
        assert_eq!((found[0].name.as_str(), found[0].unit.as_deref()), ("Weg", None));
    }

    #[test]
    fn a_time_in_an_unknown_unit_is_refused() {
        let text = "Time [min],d\n0,1.5\n1,2.5\n";
        let error = signals(text, &Table::default()).unwrap_err();
        assert!(
            error.contains("\"min\"") && error.contains("--time-unit"),
            "{error}"
        );
        let table = Table {
            time_unit: Some(TimeUnit::Ms),
            ..Table::default()
        };
        assert_eq!(nanos(&signals(text, &table).unwrap()[0]), [0, 1_000_000]);
        let dated = signals("time [UTC],d\n2026-03-01 06:00:00,1.5\n", &Table::default());
        assert!(dated.is_ok());
    }

    #[test]
    fn blanks_and_columns_by_number() {
        let table = Table {
            columns: vec!["2".into()],
            ..Table::default()
        };
        let found = signals(
            "  1.0   2.0 x\n 3.0 4.0 y\n",
            &Table {
                head_lines: Some(0),
                ..table
            },
        )
        .unwrap();
        assert_eq!(found[0].values, [2.0, 4.0]);
        assert_eq!(found[0].timing, Timing::Unknown);
    }

    #[test]
    fn latin_1_is_read() {
        let found = read(&b"d [\xb5m]\n0.5\n0.25\n"[..], &Table::default()).unwrap();
        assert_eq!(found[0].unit.as_deref(), Some("µm"));
    }

    #[test]
    fn faults_name_line_and_column_and_the_next_step() {
        let refused = |text: &str| signals(text, &Table::default()).unwrap_err();
        assert_eq!(
            refused("t;d\n0;0.1\n1;abc\n"),
            "line 3, column 2 (d): \"abc\" is no number; --channel chooses columns"
        );
        assert!(refused("t;d\n0;1\n1;0,5\n").contains("--decimal-comma"));
        assert!(refused("0,125\n0,250\n").contains("(--decimal-comma)?"));
        assert_eq!(
            refused("t;d\n0;1.5\n1\n"),
            "line 3: 1 columns, 2 in the rows before"
        );
        assert!(refused("01/02/2026|06:00\n0;1.5\n1;2.5\n").starts_with("line 1: looks like data"));
        assert!(refused("").contains("no row of numbers"));
        assert!(refused("a,\"b\n1,2.5\n").contains("quote"));
        assert!(refused("t;d\n01/02/2026 00:00;1.5\n").contains("--dates"));
        assert!(refused("\u{0}PK").contains("no text file"));
        assert!(
            read(&b"\xff\xfea\0"[..], &Table::default())
                .unwrap_err()
                .to_string()
                .contains("UTF-16")
        );
        let table = Table {
            columns: vec!["x".into()],
            ..Table::default()
        };
        assert!(
            signals("t;d\n0;1.5\n", &table)
                .unwrap_err()
                .contains("there is: t, d")
        );
    }
}
