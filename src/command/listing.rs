//! Output of rows: aligned, JSON, CSV.

use rusqlite::types::Value;
use serde_json::Value as Json;
use std::fmt::Write;

/// Rows in aligned columns, numbers to the right.
pub struct Aligned {
    rows: Vec<Vec<String>>,
    right: Vec<bool>,
}

impl Aligned {
    /// A table with these heads; a head that begins with `>` aligns its column to the right.
    pub fn new(heads: &[&str]) -> Self {
        Self {
            rows: vec![
                heads
                    .iter()
                    .map(|head| head.trim_start_matches('>').to_owned())
                    .collect(),
            ],
            right: heads.iter().map(|head| head.starts_with('>')).collect(),
        }
    }

    /// Adds a row.
    pub fn push(&mut self, row: Vec<String>) {
        self.rows.push(row);
    }

    /// Adds a line under the last row, outside the columns.
    pub fn note(&mut self, text: String) {
        self.rows.push(vec![format!("  {text}")]);
    }

    /// The whole table, with a rule under the heads.
    pub fn print(&self) -> String {
        let length = |text: &String| text.chars().count();
        let columns = self.right.len();
        let mut widths = vec![0; columns];
        for row in self.rows.iter().filter(|row| row.len() == columns) {
            for (width, cell) in widths.iter_mut().zip(row) {
                *width = (*width).max(length(cell));
            }
        }
        let mut out = String::new();
        for (number, row) in self.rows.iter().enumerate() {
            let mut line = String::new();
            for (place, cell) in row.iter().enumerate() {
                let width = if row.len() == columns { widths[place] } else { 0 };
                let gap = if place > 0 { "  " } else { "" };
                // Writing to a string cannot fail.
                let _ = if self.right.get(place) == Some(&true) {
                    write!(line, "{gap}{cell:>width$}")
                } else {
                    write!(line, "{gap}{cell:<width$}")
                };
            }
            out.push_str(line.trim_end());
            out.push('\n');
            if number == 0 {
                let _ = writeln!(out, "{}", "-".repeat(line.trim_end().chars().count()));
            }
        }
        out
    }
}

/// A line of comma-separated values (RFC 4180), with its line end.
pub fn csv<'a>(cells: impl IntoIterator<Item = &'a str>) -> String {
    let mut line = String::new();
    for (place, cell) in cells.into_iter().enumerate() {
        if place > 0 {
            line.push(',');
        }
        if cell.contains([',', '"', '\n', '\r']) {
            line.push('"');
            line.push_str(&cell.replace('"', "\"\""));
            line.push('"');
        } else {
            line.push_str(cell);
        }
    }
    line.push_str("\r\n");
    line
}

/// A value as a cell: empty for NULL, with every digit needed to distinguish two numbers.
pub fn cell(value: &Value) -> String {
    match value {
        Value::Null | Value::Blob(_) => String::new(),
        Value::Integer(number) => number.to_string(),
        Value::Real(number) => format!("{number:?}"),
        Value::Text(text) => text.clone(),
    }
}

/// A row as a JSON object, its columns in alphabetical order.
pub fn object(names: &[String], values: &[Value]) -> Json {
    let entry = |(name, value): (&String, &Value)| {
        let value = match value {
            Value::Null | Value::Blob(_) => Json::Null,
            Value::Integer(number) => Json::from(*number),
            Value::Real(number) => Json::from(*number),
            Value::Text(text) => Json::from(text.as_str()),
        };
        (name.clone(), value)
    };
    Json::Object(names.iter().zip(values).map(entry).collect())
}

/// `2026-03-01 06:00` from RFC 3339 in UTC, cut off at the minute.
pub fn minutes(time: &str) -> String {
    let seconds = seconds(time);
    seconds.get(..16).unwrap_or(&seconds).to_owned()
}

/// `2026-03-01 06:00:00` from RFC 3339 in UTC, fractions of a second cut off.
pub fn seconds(time: &str) -> String {
    time.trim_end_matches('Z')
        .split('.')
        .next()
        .unwrap_or(time)
        .replace('T', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_that_would_break_a_line_are_quoted() {
        assert_eq!(csv(["a", "", "1.5"]), "a,,1.5\r\n");
        assert_eq!(
            csv(["a,b", "say \"no\"", "two\nlines"]),
            "\"a,b\",\"say \"\"no\"\"\",\"two\nlines\"\r\n"
        );
        assert_eq!(cell(&Value::Real(1e-5)), "1e-5");
        assert_eq!(cell(&Value::Real(574_000.0)), "574000.0");
    }

    #[test]
    fn columns_are_aligned_and_notes_do_not_widen_them() {
        let mut table = Aligned::new(&["rod", ">force"]);
        table.push(vec!["è".into(), "5.0".into()]);
        table.note("a long remark about it".into());
        table.push(vec!["longer".into(), "12.5".into()]);
        assert_eq!(
            table.print(),
            "rod     force\n-------------\nè         5.0\n  a long remark about it\nlonger   12.5\n"
        );
    }
}
