//! Lines of a text table to cells: the delimiter, quotes, heads, and what a cell may be.

use crate::import::heads::{some, split_head};
use crate::import::{ImportError, TimeUnit, lines};
use crate::record::Unit;
use csv_core::{ReadRecordResult, Reader, ReaderBuilder};

/// What stands between the columns of most lines.
pub(super) fn guess(head: &[String], decimal_comma: bool) -> u8 {
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
pub(super) fn check_head(head: &[String], delimiter: u8) -> Result<(), ImportError> {
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

pub(super) fn named(delimiter: u8) -> String {
    match delimiter {
        b' ' => "blank".to_owned(),
        b'\t' => "tab".to_owned(),
        other => char::from(other).to_string(),
    }
}

/// Lines to cells, quotes undone.
pub(super) struct Splitter {
    delimiter: u8,
    reader: Reader,
    text: Vec<u8>,
    ends: Vec<usize>,
}

impl Splitter {
    pub(super) fn new(delimiter: u8) -> Self {
        Self {
            delimiter,
            reader: ReaderBuilder::new().delimiter(delimiter).build(),
            text: Vec::new(),
            ends: Vec::new(),
        }
    }

    pub(super) fn split(&mut self, line: &str, number: u32) -> Result<Vec<String>, ImportError> {
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
            cells.push(lines::text(cell).trim().to_owned());
            begin = end;
        }
        Ok(cells)
    }
}

/// Whether every cell could be a number, a date or nothing, and at least one is.
pub(super) fn is_data(row: &[String], decimal_comma: bool) -> bool {
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

pub(super) fn is_missing(cell: &str) -> bool {
    cell.is_empty()
        || ["nan", "null", "na", "n/a"]
            .iter()
            .any(|word| cell.eq_ignore_ascii_case(word))
}

pub(super) fn number(cell: &str, decimal_comma: bool) -> Option<f64> {
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
pub(super) fn heads(before: &[Vec<String>], width: usize) -> (Vec<String>, Vec<Option<String>>) {
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
