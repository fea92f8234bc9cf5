//! Splits lines of a text table into cells: delimiter, quotes, and kinds of cells.

use crate::import::{ImportError, lines};
use csv_core::{ReadRecordResult, Reader, ReaderBuilder};

/// Delimiter between the columns of most lines.
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

/// Returns an error if a line before the first row of data looks like data.
pub(super) fn check_head(head: &[String], delimiter: u8) -> Result<(), ImportError> {
    let is_like_data = |line: &str| {
        line.contains(|c: char| c.is_ascii_digit())
            && line
                .chars()
                .all(|c| c.is_ascii_digit() || "+-.,;:/eE \t|".contains(c))
    };
    // `1;2;3` counts channels.
    let is_count = |line: &str| {
        let cells = line
            .split(char::from(delimiter))
            .map(str::trim)
            .filter(|cell| !cell.is_empty());
        let numbers: Option<Vec<u32>> = cells.map(|cell| cell.parse().ok()).collect();
        numbers.is_some_and(|numbers| {
            numbers.len() > 1
                && numbers
                    .windows(2)
                    .all(|pair| pair[1].checked_sub(pair[0]) == Some(1))
        })
    };
    match head.iter().position(|line| is_like_data(line) && !is_count(line)) {
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

/// Splits lines into cells and removes quotes.
pub(in crate::import) struct Splitter {
    delimiter: u8,
    reader: Reader,
    text: Vec<u8>,
    ends: Vec<usize>,
}

impl Splitter {
    pub(in crate::import) fn new(delimiter: u8) -> Self {
        Self {
            delimiter,
            reader: ReaderBuilder::new().delimiter(delimiter).build(),
            text: Vec::new(),
            ends: Vec::new(),
        }
    }

    pub(in crate::import) fn split(&mut self, line: &str, number: u32) -> Result<Vec<String>, ImportError> {
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

/// True if a cell could be a number or a date.
pub(super) fn is_value(cell: &str, decimal_comma: bool) -> bool {
    // `1,25` is none.
    let has_parts = cell.contains(':') || cell.chars().filter(|c| "-/.".contains(*c)).count() > 1;
    let is_date = has_parts
        && cell.starts_with(|c: char| c.is_ascii_digit())
        && cell
            .chars()
            .all(|c| c.is_ascii_digit() || "-/.:,TZ+ ".contains(c));
    number(cell, decimal_comma).is_some() || is_date
}

pub(in crate::import) fn is_missing(cell: &str) -> bool {
    cell.is_empty()
        || ["nan", "null", "na", "n/a"]
            .iter()
            .any(|word| cell.eq_ignore_ascii_case(word))
}

pub(in crate::import) fn number(cell: &str, decimal_comma: bool) -> Option<f64> {
    if !decimal_comma {
        return cell.parse().ok();
    }
    // A point beside decimal commas would separate thousands.
    if cell.contains('.') {
        return None;
    }
    cell.replace(',', ".").parse().ok()
}
