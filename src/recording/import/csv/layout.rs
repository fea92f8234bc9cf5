//! Finds where the data of a text table begin, which columns are text, and the names in the lines above.

use super::cells::{is_missing, is_value};
use crate::import::heads::{some, split_head};
use crate::import::lines::shown;
use crate::import::{ImportError, TimeUnit, is_time_name};
use tirante_analysis::signal::record::Unit;

/// Most lines of heads that have numbers.
const HEADS: usize = 2;
/// Number of rows that define the layout.
const SHOWN: usize = 10;

/// Layout of the rows of data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    /// Index of the first row of data.
    pub(super) first: usize,
    /// Number of cells of a row.
    pub(super) width: usize,
    /// True if a column holds numbers or times.
    is_value: Vec<bool>,
    /// True if a column holds text.
    pub(super) is_text: Vec<bool>,
}

/// True if all cells of a row are empty.
pub(super) fn is_blank(row: &[String]) -> bool {
    row.iter().all(String::is_empty)
}

impl Layout {
    /// Layout from the first rows of a file; `None` if no row holds a number. `first` is the first row of
    /// data, if given.
    pub(super) fn find(rows: &[Vec<String>], first: Option<usize>, decimal_comma: bool) -> Option<Self> {
        let filled: Vec<&Vec<String>> = rows
            .iter()
            .skip(first.unwrap_or_default())
            .filter(|row| !is_blank(row))
            .collect();
        // The last rows are data, if any are; a damaged one is outvoted.
        let shown = filled.len().div_ceil(2).min(SHOWN);
        let of_last = |count: usize| Self::of(&filled[filled.len().saturating_sub(count)..], decimal_comma);
        let mut layout = of_last(shown).or_else(|| of_last(1))?;
        layout.first = match first {
            Some(first) => first,
            None => layout.begin(rows, decimal_comma)?,
        };
        Some(layout)
    }

    /// Layout of most of some rows.
    fn of(rows: &[&Vec<String>], decimal_comma: bool) -> Option<Self> {
        let width = rows.iter().map(|row| row.len()).max_by_key(|width| {
            let alike = rows.iter().filter(|row| row.len() == *width).count();
            (alike, *width)
        })?;
        let count = |column: usize, is: &dyn Fn(&str) -> bool| {
            let cells = rows.iter().filter_map(|row| row.get(column));
            cells.filter(|cell| !is_missing(cell) && is(cell)).count()
        };
        let values = |column| count(column, &|cell| is_value(cell, decimal_comma));
        let texts = |column| count(column, &|cell| !is_value(cell, decimal_comma));
        let is_value: Vec<bool> = (0..width)
            .map(|column| values(column) > 0 && values(column) >= texts(column))
            .collect();
        let is_text = (0..width)
            .map(|column| texts(column) > 0 && !is_value[column])
            .collect();
        let layout = Self {
            first: 0,
            width,
            is_value,
            is_text,
        };
        layout.is_value.contains(&true).then_some(layout)
    }

    /// Returns an error if rows just above the first that fits are data with text in some of their columns: they would be lost for all.
    pub(super) fn check_above(&self, rows: &[Vec<String>], decimal_comma: bool) -> Result<(), ImportError> {
        let is_data = |row: &[String]| {
            let (misfits, has_any) = self.misfits(row, decimal_comma);
            row.len() == self.width && has_any && misfits > 0 && misfits < self.values()
        };
        let above = rows.get(..self.first).unwrap_or_default();
        let count = above.iter().rev().take_while(|row| is_data(row)).count();
        let Some(row) = above.get(above.len() - count).filter(|_| count > HEADS) else {
            return Ok(());
        };
        let misfit = row
            .iter()
            .enumerate()
            .zip(&self.is_value)
            .find(|((_, cell), is_value)| {
                **is_value && !is_missing(cell) && !super::cells::is_value(cell, decimal_comma)
            });
        let (column, cell) = misfit.map_or((0, ""), |((column, cell), _)| (column, cell));
        Err(ImportError::at(
            format_args!("line {}, column {}", above.len() - count + 1, column + 1),
            format!(
                "{} is no number, those below are: leave it empty, name the columns that are wanted (--channel), or say where the data begin (--head-lines {})",
                shown(cell),
                self.first
            ),
        ))
    }

    /// Number of columns of numbers or times.
    pub(super) fn values(&self) -> usize {
        self.is_value.iter().filter(|is_value| **is_value).count()
    }

    /// Number of cells that a row needs: up to the last that holds numbers.
    pub(super) fn needed(&self) -> usize {
        self.is_value
            .iter()
            .rposition(|is_value| *is_value)
            .map_or(0, |last| last + 1)
    }

    /// Number of columns of numbers in which a row has text, and true if it has a number at all.
    fn misfits(&self, row: &[String], decimal_comma: bool) -> (usize, bool) {
        let cells = row.iter().zip(&self.is_value).filter(|(_, is_value)| **is_value);
        cells.fold((0, false), |(misfits, has_any), (cell, _)| {
            match is_missing(cell) {
                true => (misfits, has_any),
                false if is_value(cell, decimal_comma) => (misfits, true),
                false => (misfits + 1, has_any),
            }
        })
    }

    /// The first row that fits, and is followed by one that fits by half at least.
    fn begin(&self, rows: &[Vec<String>], decimal_comma: bool) -> Option<usize> {
        let needed = self.needed();
        let columns = self.values();
        let has_width =
            |row: &[String]| row.len() >= needed && row.iter().skip(self.width).all(String::is_empty);
        let mut filled = rows
            .iter()
            .enumerate()
            .filter(|(_, row)| !is_blank(row))
            .peekable();
        while let Some((index, row)) = filled.next() {
            let fits = has_width(row) && self.misfits(row, decimal_comma) == (0, true);
            let goes_on = filled.peek().is_none_or(|(_, next)| {
                let (misfits, _) = self.misfits(next, decimal_comma);
                2 * misfits <= columns
            });
            if fits && goes_on {
                return Some(index);
            }
        }
        None
    }
}

/// Names and units from the lines just before the data that have enough cells. A line of units gives the
/// units, and the line above it the names, or one further up that names a column the time; without such a
/// line, the line whose heads have units or name a column the time, else the last.
pub(super) fn heads(
    before: &[Vec<String>],
    layout: &Layout,
    delimiter: u8,
) -> (Vec<String>, Vec<Option<String>>) {
    let width = layout.width;
    let needed = layout.needed();
    let is_word = |row: &Vec<String>| row.iter().any(|cell| cell.chars().any(char::is_alphabetic));
    let rows: Vec<Vec<String>> = before
        .iter()
        .rev()
        .filter(|row| !is_blank(row))
        .map(|row| unmarked(row, delimiter))
        .take_while(|row| match delimiter {
            b' ' => row.len() == width,
            _ => row.len() >= needed,
        })
        // Not rules, and not counts of channels.
        .filter(is_word)
        .collect();
    let row_of_units = rows.iter().position(|row| is_of_units(row));
    let says_time = |row: &Vec<String>| row.iter().any(|cell| is_time_name(&split_head(cell).0));
    let says_units = |row: &Vec<String>| {
        let units = row.iter().filter_map(|cell| split_head(cell).1);
        units.into_iter().any(|unit| is_unit(&unit))
    };
    let named = |rows: &[Vec<String>]| {
        let best = rows
            .iter()
            .position(says_units)
            .or_else(|| rows.iter().position(says_time));
        rows.get(best.unwrap_or_default()).cloned()
    };
    let (names_of, units_of) = match row_of_units {
        // "t" and "s" alone could be names as well.
        Some(at) if at + 1 < rows.len() => (named(&rows[at + 1..]), rows.get(at)),
        _ => (named(&rows), None),
    };
    let mut names = vec![String::new(); width];
    let mut units = vec![None; width];
    for ((name, unit), head) in names.iter_mut().zip(&mut units).zip(names_of.iter().flatten()) {
        (*name, *unit) = split_head(head);
    }
    for (unit, cell) in units.iter_mut().zip(units_of.into_iter().flatten()) {
        if unit.is_none() {
            *unit = some(cell);
        }
    }
    (names, units)
}

fn is_unit(text: &str) -> bool {
    Unit::as_written(text).is_some() || TimeUnit::of(text).is_some()
}

/// True if a row holds units: at least one supported unit, and nothing too long for a unit.
fn is_of_units(row: &[String]) -> bool {
    const LONGEST: usize = 12;
    row.iter()
        .any(|cell| some(cell).is_some_and(|unit| is_unit(&unit)))
        && row
            .iter()
            .all(|cell| cell.chars().count() <= LONGEST && !is_time_name(cell))
}

/// Head without comment sign, with detached units joined to their names.
fn unmarked(row: &[String], delimiter: u8) -> Vec<String> {
    let mut cells: Vec<String> = row.to_vec();
    if let Some(first) = cells.first_mut() {
        *first = first.trim_start_matches(['#', '%']).trim_start().to_owned();
    }
    if delimiter != b' ' {
        return cells;
    }
    let mut joined: Vec<String> = Vec::new();
    for cell in cells.into_iter().filter(|cell| !cell.is_empty()) {
        match joined.last_mut() {
            Some(last) if cell.starts_with(['[', '(']) => {
                last.push(' ');
                last.push_str(&cell);
            }
            _ => joined.push(cell),
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &str) -> Vec<Vec<String>> {
        let cells = |line: &str| line.split(';').map(|cell| cell.trim().to_owned()).collect();
        text.lines().map(cells).collect()
    }

    fn found(text: &str) -> (usize, Vec<String>, Vec<String>) {
        let rows = rows(text);
        let layout = Layout::find(&rows, None, false).unwrap();
        let (names, units) = heads(&rows[..layout.first], &layout, b';');
        let units = units.into_iter().map(Option::unwrap_or_default).collect();
        (layout.first, names, units)
    }

    fn words(text: &str) -> Vec<String> {
        text.split(';').map(str::to_owned).collect()
    }

    #[test]
    fn names_and_units_of_many_heads() {
        for (text, first, names, units) in [
            ("t;d\n0;1\n1;2", 1, "t;d", ";"),
            // Trailing cells of the head, of the rows, blank lines.
            ("t [s];d [mm];;\n0;1\n1;2", 1, "t;d", "s;mm"),
            ("t [s];d [mm]\n0;1;\n1;2;", 1, "t;d;", "s;mm;"),
            ("t;d;note\n\n0;1\n1;2", 2, "t;d", ";"),
            // A third line below, between and above.
            ("t [s];d [mm]\nSensor A;Sensor B\n0;1\n1;2", 2, "t;d", "s;mm"),
            (
                "Time;Disp\ns;mm\nSensor A;Sensor B\n0;1\n1;2",
                3,
                "Time;Disp",
                "s;mm",
            ),
            ("Time;Disp\nSN 17;SN 18\ns;mm\n0;1\n1;2", 3, "Time;Disp", "s;mm"),
            ("1;2\nTime;Disp\n[s];[mm]\n0;1\n1;2", 3, "Time;Disp", "s;mm"),
            ("Time;Disp\n---;---\n0;1\n1;2", 2, "Time;Disp", ";"),
            ("# Time;Disp [g]\n0;1\n1;2", 1, "Time;Disp", ";g"),
        ] {
            assert_eq!(found(text), (first, words(names), words(units)), "{text:?}");
        }
    }

    #[test]
    fn text_columns_are_told_from_heads() {
        let rows = rows("t;d;state\n0;1;ok\n1;2;\n2;3;5\n3;4;ok\n4;5;ok");
        let layout = Layout::find(&rows, None, false).unwrap();
        assert_eq!((layout.first, layout.is_text[2]), (1, true));
        assert_eq!(layout.needed(), 2);
    }

    #[test]
    fn a_damaged_row_moves_nothing() {
        let rows = rows("t;d\n0;0.1\n1;abc");
        assert_eq!(
            Layout::find(&rows, None, false).map(|layout| layout.first),
            Some(1)
        );
        assert_eq!(Layout::find(&[], None, false), None);
    }
}
