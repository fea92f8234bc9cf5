//! The first lines of a table: delimiter, decimal sign, and the first row of data.

use super::Table;
use super::cells::{Splitter, guess, named, number};
use super::layout::Layout;
use crate::import::ImportError;

/// Most columns.
const COLUMNS: usize = 1024;

/// Properties of a table found in its first lines.
pub(super) struct Beginning {
    pub(super) delimiter: u8,
    pub(super) decimal_comma: bool,
    pub(super) rows: Vec<Vec<String>>,
    pub(super) layout: Layout,
}

impl Beginning {
    /// Properties as given; else with decimal points, or with decimal commas if more columns are numbers
    /// then.
    pub(super) fn find(head: &[String], table: &Table) -> Result<Self, ImportError> {
        let values = |found: &Option<Self>| found.as_ref().map_or(0, |found| found.layout.values());
        let mut found = Self::with(head, table, table.decimal_comma)?;
        if !table.decimal_comma {
            // The comma that is a delimiter is no decimal sign.
            let is_alike = |commas: &Self| {
                found
                    .as_ref()
                    .is_none_or(|found| found.delimiter == commas.delimiter)
            };
            let with_commas = Self::with(head, table, true).unwrap_or(None).filter(is_alike);
            if values(&with_commas) > values(&found)
                && with_commas.as_ref().is_some_and(Self::is_surely_decimal)
            {
                found = with_commas;
            } else if values(&with_commas) > values(&found) {
                return Err(ImportError::new(
                    "numbers with a comma before three digits may be decimals or thousands: --decimal-comma says the first, the \
                     second must be written without",
                ));
            }
        }
        if let Some(found) = found {
            return Ok(found);
        }
        if let Some(lines) = table.head_lines.filter(|lines| *lines >= head.len()) {
            return Err(ImportError::new(format!(
                "has no line {} to begin with",
                lines + 1
            )));
        }
        if head.iter().all(|line| line.trim().is_empty()) {
            return Err(ImportError::new("no row of numbers: the file is empty"));
        }
        let delimiter = table
            .delimiter
            .unwrap_or_else(|| guess(head, table.decimal_comma));
        Err(ImportError::new(format!(
            "no row of numbers in the first {} lines: is '{}' the delimiter (--delimiter), a comma the decimal sign \
             (--decimal-comma)?",
            head.len(),
            named(delimiter)
        )))
    }

    fn with(head: &[String], table: &Table, decimal_comma: bool) -> Result<Option<Self>, ImportError> {
        let delimiter = table.delimiter.unwrap_or_else(|| guess(head, decimal_comma));
        if decimal_comma && delimiter == b',' {
            return match table.decimal_comma {
                true => Err(ImportError::new(
                    "the comma cannot be delimiter and decimal sign: say --delimiter",
                )),
                false => Ok(None),
            };
        }
        let mut splitter = Splitter::new(delimiter);
        let mut rows = Vec::with_capacity(head.len());
        for (index, line) in head.iter().enumerate() {
            rows.push(splitter.split(line, index as u32 + 1)?);
        }
        let Some(layout) = Layout::find(&rows, table.head_lines, decimal_comma) else {
            return Ok(None);
        };
        if layout.width > COLUMNS {
            return Err(ImportError::at(
                format_args!("line {}", layout.first + 1),
                format!("{} columns: at most {COLUMNS} are read", layout.width),
            ));
        }
        Ok(Some(Self {
            delimiter,
            decimal_comma,
            rows,
            layout,
        }))
    }

    /// True if commas cannot be separators of thousands: some number begins with `0,` or has other than three
    /// digits after one.
    fn is_surely_decimal(&self) -> bool {
        let cells = self.rows.iter().skip(self.layout.first).flatten();
        let numbers = cells.filter(|cell| number(cell, true).is_some());
        numbers
            .filter_map(|cell| cell.split_once(','))
            .any(|(whole, behind)| {
                let digits = behind.bytes().take_while(u8::is_ascii_digit).count();
                digits > 0 && (matches!(whole.trim_start_matches(['-', '+']), "0" | "") || digits != 3)
            })
    }
}
