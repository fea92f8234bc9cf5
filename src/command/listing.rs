//! Output of rows: aligned, JSON, CSV.

use crate::site::text::escaped;
use rusqlite::types::Value;
use serde_json::Value as Json;
use std::env;
use std::fmt::Write;
use std::io::{self, IsTerminal};
use std::path::Path;

/// Width in characters that a line exceeds only for a word that is longer.
pub(super) const WIDTH: usize = 80;

/// Least width of a wrapped last column; a narrower one goes on lines of its own.
const NARROWEST: usize = 32;

/// A path as a word of a command line to be pasted into a shell.
pub(super) fn pasted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "_-./+,:@%=".contains(c);
    match !text.is_empty() && !text.starts_with('-') && text.chars().all(is_plain) {
        true => text,
        false => {
            // A word that begins with a hyphen would be taken for a flag.
            let text = if text.starts_with('-') {
                format!("./{text}")
            } else {
                text
            };
            format!("'{}'", text.replace('\'', "'\\''"))
        }
    }
}

/// Rows in aligned columns, numbers to the right, within 80 columns.
pub struct Aligned {
    rows: Vec<Row>,
    right: Vec<bool>,
}

struct Row {
    /// One cell per column, or a single one.
    cells: Vec<String>,
    is_loud: bool,
}

/// True if a table on stdout may have colours: on a terminal, unless `NO_COLOR` is set (no-color.org).
pub fn is_coloured() -> bool {
    io::stdout().is_terminal() && env::var_os("NO_COLOR").is_none_or(|set| set.is_empty())
}

impl Aligned {
    /// A table with these heads; a head that begins with `>` aligns its column to the right.
    pub fn new(heads: &[&str]) -> Self {
        Self {
            rows: vec![Row {
                cells: heads
                    .iter()
                    .map(|head| head.trim_start_matches('>').to_owned())
                    .collect(),
                is_loud: false,
            }],
            right: heads.iter().map(|head| head.starts_with('>')).collect(),
        }
    }

    /// Adds a row. Names may come from anywhere: what no line should have is escaped.
    pub fn push(&mut self, cells: Vec<String>) {
        self.rows.push(Row {
            cells: cells.iter().map(|cell| escaped(cell).into_owned()).collect(),
            is_loud: false,
        });
    }

    /// Adds a line under the last row, outside the columns.
    pub fn note(&mut self, text: String) {
        self.push(vec![text.replace('\n', " ")]);
    }

    /// Emphasises the last row or line where there are colours.
    pub fn stress(&mut self) {
        if let Some(row) = self.rows.last_mut() {
            row.is_loud = true;
        }
    }

    /// All of it, with a rule under the heads; `is_coloured`: with escape sequences for a terminal.
    pub fn print(&self, is_coloured: bool) -> String {
        let length = |text: &String| text.chars().count();
        let columns = self.right.len();
        let is_whole = |row: &&Row| row.cells.len() == columns;
        let mut widths = vec![0; columns];
        for row in self.rows.iter().filter(is_whole) {
            for (width, cell) in widths.iter_mut().zip(&row.cells) {
                *width = (*width).max(length(cell));
            }
        }
        // Words in the last column are broken where they would pass the margin.
        let before: usize = widths.iter().rev().skip(1).map(|width| width + 2).sum();
        let room = WIDTH.saturating_sub(before);
        let mut out = String::new();
        for (number, row) in self.rows.iter().enumerate() {
            let mut lines = if is_whole(&row) {
                self.lines(row, &widths, before, room)
            } else {
                hanging(&row.cells.concat(), 2, 4)
            };
            if number == 0 {
                let longest = lines.iter().map(length).max().unwrap_or(0);
                lines.push("-".repeat(longest));
            }
            for line in lines {
                let _ = if is_coloured && row.is_loud {
                    writeln!(out, "\x1b[1;31m{line}\x1b[0m")
                } else {
                    writeln!(out, "{line}")
                };
            }
        }
        out
    }

    /// Lines of a row, with its last cell in the remaining width or on lines of its own.
    fn lines(&self, row: &Row, widths: &[usize], before: usize, room: usize) -> Vec<String> {
        let last = self.right.len().saturating_sub(1);
        let is_broken = self.right.last() == Some(&false)
            && row.cells.last().is_some_and(|cell| cell.chars().count() > room);
        let mut line = String::new();
        for (place, (cell, width)) in row.cells.iter().zip(widths).enumerate() {
            if place == last && is_broken {
                break;
            }
            let gap = if place > 0 { "  " } else { "" };
            // Wider formats panic.
            let width = *width.min(&usize::from(u16::MAX));
            // Writing to a string cannot fail.
            let _ = if self.right.get(place) == Some(&true) {
                write!(line, "{gap}{cell:>width$}")
            } else {
                write!(line, "{gap}{cell:<width$}")
            };
        }
        let words = row.cells.last().filter(|_| is_broken);
        let Some(words) = words else {
            return vec![line.trim_end().to_owned()];
        };
        if room < NARROWEST {
            let mut lines = vec![line.trim_end().to_owned()];
            lines.extend(hanging(words, 4, 4));
            return lines;
        }
        let mut lines = hanging(words, before, before);
        if let Some(first) = lines.first_mut() {
            *first = format!("{line}  {}", first.trim_start());
        }
        lines
    }
}

/// Breaks a text between words so that no line exceeds the width, with indents for the first line and the
/// others.
pub(super) fn hanging(text: &str, first: usize, others: usize) -> Vec<String> {
    // A percent sign stays with its number.
    let mut words: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match words.last_mut().filter(|_| word.starts_with('%')) {
            Some(number) => *number += &format!(" {word}"),
            None => words.push(word.to_owned()),
        }
    }
    let mut lines = Vec::new();
    let mut line = " ".repeat(first);
    let mut is_begun = false;
    for word in &words {
        if is_begun && line.chars().count() + 1 + word.chars().count() > WIDTH {
            lines.push(std::mem::replace(&mut line, " ".repeat(others)));
            is_begun = false;
        }
        if is_begun {
            line.push(' ');
        }
        line += word;
        is_begun = true;
    }
    lines.push(line);
    lines
}

/// Text with its lines of more than [`WIDTH`] columns broken between words, as far in as they begin.
pub(super) fn folded(text: &str) -> String {
    text.lines()
        .flat_map(|line| {
            let begin = line.chars().take_while(|c| *c == ' ').count();
            match line.chars().count() > WIDTH {
                true => hanging(line, begin, begin + 2),
                false => vec![line.to_owned()],
            }
        })
        .map(|line| line + "\n")
        .collect()
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

/// Decimals that give a value three significant digits: none from 100 on, four at most.
pub(super) fn decimals(value: f64) -> usize {
    (0..4)
        .find(|digits| value.abs() >= 10_f64.powi(2 - digits))
        .map_or(4, |digits| digits.unsigned_abs() as usize)
}

/// `2026-03-01 06:00` from RFC 3339 in UTC, cut off at the minute.
pub fn minutes(time: &str) -> String {
    let seconds = seconds(time);
    seconds.get(..16).unwrap_or(&seconds).to_owned()
}

/// `2026-03-01 06:00:00` from RFC 3339 in UTC, fractions of a second cut off.
fn seconds(time: &str) -> String {
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
    fn names_tear_no_table() {
        let mut table = Aligned::new(&["file", ">bytes"]);
        table.push(vec!["x\nforged".to_owned(), "1".to_owned()]);
        table.note("by Eve\nfake \u{1b}]0;title\u{7}".to_owned());
        let text = table.print(false);
        assert_eq!(text.lines().count(), 4, "{text}");
        assert!(
            text.contains("x\\nforged") && text.contains("by Eve fake \\u{1b}]0;title\\u{7}"),
            "{text}"
        );
    }

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
            table.print(false),
            "rod     force\n-------------\nè         5.0\n  a long remark about it\nlonger   12.5\n"
        );
        table.note("stands".into());
        table.stress();
        assert!(table.print(true).ends_with("\n\u{1b}[1;31m  stands\u{1b}[0m\n"));
        assert!(!table.print(false).contains('\u{1b}'));
    }

    #[test]
    fn no_line_passes_the_margin() {
        let words =
            "the loss of axial force at the reference temperature is 9.2 \u{b1} 0.6 %, above the limit"
                .repeat(3);
        for columns in 1..6 {
            let mut heads = vec!["column"; columns];
            heads.push("words");
            let mut table = Aligned::new(&heads);
            let mut row = vec!["2026-03-01 06:00".to_owned(); columns];
            row.push(words.clone());
            table.push(row);
            table.note(words.clone());
            let text = table.print(false);
            // Five such columns alone are wider.
            let widest = 80.max(18 * columns);
            assert!(text.lines().all(|line| line.chars().count() <= widest), "{text}");
            let all: Vec<&str> = text.split_whitespace().collect();
            assert_eq!(all.iter().filter(|word| **word == "loss").count(), 6, "{text}");
        }
    }

    #[test]
    fn a_path_is_pasted_as_one_word() {
        for (path, word) in [
            ("a/b-1_c.csv", "a/b-1_c.csv"),
            ("Navata nord.csv", "'Navata nord.csv'"),
            ("dell'organo.csv", "'dell'\\''organo.csv'"),
            ("$HOME.csv", "'$HOME.csv'"),
            ("-x.csv", "'./-x.csv'"),
        ] {
            assert_eq!(pasted(Path::new(path)), word);
        }
    }
}
