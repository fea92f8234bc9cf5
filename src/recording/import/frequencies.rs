//! Tables of natural frequencies identified elsewhere: one row per record, or a temperature alone.

use super::csv::Splitter;
use super::lines::Lines;
use super::stamp::{self, DateOrder, SINCE_2001, TimeUnit};
use super::{ImportError, MOST_VALUES};
use std::io::BufRead;
use tirante_analysis::rod::beam::forward::MAX_MODES;
use tirante_analysis::signal::modes::Mode;
use tirante_analysis::signal::record::{RodId, Timestamp};

/// Highest frequency accepted; no rod vibrates faster \[Hz\].
const HIGHEST_HZ: f64 = 1e5;

/// A table, its rows in the order of the file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Frequencies {
    /// Rows of the table.
    pub rows: Vec<FrequencyRow>,
    /// Names of unknown columns, which are ignored.
    pub unused: Vec<String>,
}

/// One row: a record's frequencies, a temperature, or both.
#[derive(Debug, Clone, PartialEq)]
pub struct FrequencyRow {
    /// Line in the file, from 1.
    pub line: u32,
    /// Time of the record or reading.
    pub time: Timestamp,
    /// Length of the record \[s\], zero if not given.
    pub duration_s: f64,
    /// Rod; `None` where the table does not name it: a temperature then applies to every rod.
    pub rod: Option<RodId>,
    /// The measured modes, ascending in order; none in a row of temperature alone.
    pub modes: Vec<Mode>,
    /// Temperature \[degC\].
    pub temperature_c: Option<f64>,
    /// Root mean square of the record's samples, in any unit, the same throughout the table.
    pub rms: Option<f64>,
}

/// Meaning of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Column {
    Time,
    Rod,
    Frequency(usize),
    Sd(usize),
    Temperature,
    Rms,
    Duration,
}

impl Column {
    /// Column of a head's name.
    fn of(name: &str) -> Option<Self> {
        let order = |prefix: &str| -> Option<usize> {
            let digits = name.strip_prefix(prefix)?.strip_suffix("_hz")?;
            let is_plain = digits.bytes().all(|byte| byte.is_ascii_digit());
            digits.parse().ok().filter(|order| is_plain && *order >= 1)
        };
        Some(match name {
            "time" => Self::Time,
            "rod" => Self::Rod,
            "temperature_c" => Self::Temperature,
            "rms" => Self::Rms,
            "duration_s" => Self::Duration,
            _ => match (order("f"), order("sd")) {
                (Some(order), _) => Self::Frequency(order),
                (_, Some(order)) => Self::Sd(order),
                (None, None) => return None,
            },
        })
    }
}

/// Reads a table. The first line names the columns: `time` (ISO 8601, UTC where no zone is given, or seconds
/// since 1970), `rod`, `f1_hz`, `sd1_hz`, `f2_hz`, ..., `temperature_c`, `rms`, `duration_s`, in any order;
/// only `time` must be there. Empty cells, `nan`, `null`, `NA` and `-` are missing values; every row has as
/// many cells as the first line. The delimiter (comma, semicolon, tab) is the first that the head holds;
/// `decimal_comma` for `4,492`, `dates` for 03/04/2026.
///
/// # Errors
/// The first thing that is wrong, with line and column.
pub fn read(
    from: impl BufRead,
    decimal_comma: bool,
    dates: Option<DateOrder>,
) -> Result<Frequencies, ImportError> {
    let mut lines = Lines::new(from);
    let head = loop {
        match lines.next_text()? {
            None => return Err(ImportError::new("is empty: the first line must name the columns")),
            Some(line) if line.trim().is_empty() => {}
            Some(line) => break line.into_owned(),
        }
    };
    let delimiter = *b",;\t"
        .iter()
        .find(|delimiter| head.as_bytes().contains(delimiter) && !(decimal_comma && **delimiter == b','))
        .unwrap_or(&b',');
    let mut splitter = Splitter::new(delimiter);
    let names = splitter.split(&head, lines.number())?;
    let table = Table::new(names, lines.number(), decimal_comma, dates)?;
    let mut rows = Vec::new();
    while let Some(line) = lines.next_text()? {
        let line = line.into_owned();
        let number = lines.number();
        let cells = splitter.split(&line, number)?;
        if cells.iter().all(String::is_empty) {
            continue;
        }
        if rows.len() * table.names.len() >= MOST_VALUES {
            return Err(ImportError::too_long());
        }
        rows.extend(table.row(&cells, number)?);
    }
    let unused = table.unused();
    Ok(Frequencies { rows, unused })
}

/// Columns of a table.
struct Table {
    names: Vec<String>,
    columns: Vec<Option<Column>>,
    decimal_comma: bool,
    dates: Option<DateOrder>,
}

impl Table {
    fn new(
        names: Vec<String>,
        line: u32,
        decimal_comma: bool,
        dates: Option<DateOrder>,
    ) -> Result<Self, ImportError> {
        let columns: Vec<Option<Column>> = names.iter().map(|name| Column::of(name)).collect();
        let refuse = |what: String| Err(ImportError::at(format_args!("line {line}"), what));
        for (index, column) in columns.iter().enumerate() {
            let Some(column) = column else { continue };
            let name = &names[index];
            if columns[..index].contains(&Some(*column)) {
                return refuse(format!("two columns are called {name}"));
            }
            match column {
                Column::Frequency(order) | Column::Sd(order) if *order > MAX_MODES => {
                    return refuse(format!("{name}: modes 1 to {MAX_MODES} are followed"));
                }
                Column::Frequency(order) if !columns.contains(&Some(Column::Sd(*order))) => {
                    return refuse(format!(
                        "{name} has no sd{order}_hz beside it: tracking needs the standard error of every frequency"
                    ));
                }
                Column::Sd(order) if !columns.contains(&Some(Column::Frequency(*order))) => {
                    return refuse(format!("{name} has no f{order}_hz beside it"));
                }
                _ => {}
            }
        }
        if !columns.contains(&Some(Column::Time)) {
            return refuse(format!(
                "no column is called time: the first line must name the columns (time, rod, f1_hz, sd1_hz, f2_hz, ..., \
                 temperature_c), and names {}",
                names.join(", ")
            ));
        }
        if !columns
            .iter()
            .any(|column| matches!(column, Some(Column::Frequency(_) | Column::Temperature)))
        {
            return refuse("neither f1_hz nor temperature_c is among the columns".to_owned());
        }
        Ok(Self {
            names,
            columns,
            decimal_comma,
            dates,
        })
    }

    fn unused(&self) -> Vec<String> {
        let named = self.names.iter().zip(&self.columns);
        named
            .filter(|(name, column)| column.is_none() && !name.is_empty())
            .map(|(name, _)| name.clone())
            .collect()
    }

    /// A row; `None` if it holds neither frequency nor temperature.
    fn row(&self, cells: &[String], line: u32) -> Result<Option<FrequencyRow>, ImportError> {
        let (count, named) = (cells.len(), self.names.len());
        if count != named {
            let hint = if count < named {
                ": it is cut off, or its last delimiters are missing (a missing value is an empty cell)"
            } else {
                ""
            };
            return Err(ImportError::at(
                format_args!("line {line}"),
                format!("{count} cells, the first line names {named}{hint}"),
            ));
        }
        let cells = Cells {
            table: self,
            cells,
            line,
        };
        let time = cells.time()?;
        let rod = cells.text(Column::Rod).map(|name| RodId(name.to_owned()));
        let temperature_c =
            cells.number(Column::Temperature, |_| true, "a temperature in degrees Celsius")?;
        let rms = cells.number(Column::Rms, |rms| rms >= 0.0, "a number from 0 on")?;
        let duration_s = cells.number(
            Column::Duration,
            |duration_s| duration_s >= 0.0,
            "a length in seconds",
        )?;
        let modes = cells.modes()?;
        if modes.is_empty() && temperature_c.is_none() {
            return Ok(None);
        }
        // An amplitude that comes and goes would be judged against the records that have one.
        if !modes.is_empty() && rms.is_none() && self.columns.contains(&Some(Column::Rms)) {
            return Err(cells.at(
                Column::Rms,
                "is empty: state it for every record, or leave the column out",
            ));
        }
        Ok(Some(FrequencyRow {
            line,
            time,
            duration_s: duration_s.unwrap_or(0.0),
            rod,
            modes,
            temperature_c,
            rms,
        }))
    }
}

/// Cells of one line.
struct Cells<'a> {
    table: &'a Table,
    cells: &'a [String],
    line: u32,
}

impl Cells<'_> {
    /// Text of a column, unless it is missing.
    fn text(&self, column: Column) -> Option<&str> {
        let index = self
            .table
            .columns
            .iter()
            .position(|named| *named == Some(column))?;
        self.cells
            .get(index)
            .map(String::as_str)
            .filter(|cell| !super::csv::is_missing(cell) && *cell != "-")
    }

    fn at(&self, column: Column, what: impl Into<String>) -> ImportError {
        let index = self.table.columns.iter().position(|named| *named == Some(column));
        let name = index.and_then(|index| self.table.names.get(index));
        let name = name.map_or("", String::as_str);
        let number = index.map_or(0, |index| index + 1);
        ImportError::at(format_args!("line {}, column {number} ({name})", self.line), what)
    }

    fn time(&self) -> Result<Timestamp, ImportError> {
        let Some(text) = self.text(Column::Time) else {
            return Err(self.at(Column::Time, "is empty"));
        };
        if let Some(written) = stamp::number(text, TimeUnit::S) {
            if written.nanos < SINCE_2001 {
                let what = format!("{text} lies before 2001: seconds since 1970 are expected");
                return Err(self.at(Column::Time, what));
            }
            return Ok(Timestamp::from_nanos(written.nanos));
        }
        let day = Timestamp::as_written(text);
        day.or_else(|_| {
            stamp::date(text, self.table.dates, 0).map(|written| Timestamp::from_nanos(written.nanos))
        })
        .map_err(|what| self.at(Column::Time, format!("\"{text}\" {what}")))
    }

    fn number(
        &self,
        column: Column,
        is_possible: impl Fn(f64) -> bool,
        wanted: &str,
    ) -> Result<Option<f64>, ImportError> {
        let Some(text) = self.text(column) else {
            return Ok(None);
        };
        let value = super::csv::number(text, self.table.decimal_comma);
        match value.filter(|value| value.is_finite() && is_possible(*value)) {
            Some(value) => Ok(Some(value)),
            None if value.is_none() && super::csv::number(text, true).is_some() => Err(self.at(
                column,
                format!("\"{text}\" is no number; --decimal-comma reads 4,492 as 4.492"),
            )),
            None => Err(self.at(column, format!("\"{text}\" is not {wanted}"))),
        }
    }

    fn modes(&self) -> Result<Vec<Mode>, ImportError> {
        let is_hz = |value: f64| value > 0.0 && value <= HIGHEST_HZ;
        let mut modes: Vec<Mode> = Vec::new();
        for order in 1..=MAX_MODES {
            let (frequency, sd) = (Column::Frequency(order), Column::Sd(order));
            let wanted = "a number of hertz above 0 and up to 100000";
            let Some(frequency_hz) = self.number(frequency, is_hz, wanted)? else {
                continue;
            };
            let wanted = "a standard error in hertz above 0: no frequency is measured without one";
            let Some(sd_hz) = self.number(sd, is_hz, wanted)? else {
                return Err(self.at(sd, format!("is empty beside f{order}_hz = {frequency_hz}")));
            };
            if modes
                .last()
                .is_some_and(|below| below.frequency_hz >= frequency_hz)
            {
                return Err(self.at(frequency, "is not above the modes before it"));
            }
            modes.push(Mode {
                order,
                frequency_hz,
                sd_hz,
                damping: None,
            });
        }
        Ok(modes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &str) -> Result<Vec<FrequencyRow>, String> {
        read(text.as_bytes(), false, None)
            .map(|table| table.rows)
            .map_err(|error| error.to_string())
    }

    #[test]
    fn records_and_temperatures_stand_in_one_table() {
        let text = "time,rod,f1_hz,sd1_hz,f2_hz,sd2_hz,temperature_c,zeta1\n\
                    2026-03-01T06:00:00Z,north,4.49,0.004,9.3,0.01,8.5,0.002\n\
                    \n\
                    2026-03-01 07:00,,,,,,9.0,\n\
                    1772352000,north,-,,9.31,0.01,nan,\n\
                    2026-03-02,north,,,,,,\n";
        let table = read(text.as_bytes(), false, None).unwrap();
        assert_eq!(table.unused, ["zeta1"]);
        let [first, warm, second] = &table.rows[..] else {
            panic!("{:?}", table.rows)
        };
        assert_eq!(first.modes.len(), 2);
        assert_eq!((first.line, first.temperature_c), (2, Some(8.5)));
        assert_eq!((warm.rod.as_ref(), warm.temperature_c), (None, Some(9.0)));
        assert_eq!(second.modes[0].order, 2);
        assert_eq!(second.time.seconds_since(first.time), 7200.0);
        assert_eq!(second.temperature_c, None);
    }

    #[test]
    fn semicolons_and_decimal_commas() {
        let text = "time;f1_hz;sd1_hz\n01.03.2026 06:00;4,492;0,004\n";
        let table = read(text.as_bytes(), true, None).unwrap();
        assert_eq!(table.rows[0].modes[0].frequency_hz, 4.492);
        assert_eq!(table.rows[0].time.as_nanos(), 1_772_344_800_000_000_000);
        assert!(rows(text).unwrap_err().contains("--decimal-comma"));
    }

    #[test]
    fn faults_name_line_and_column() {
        let of = |line: &str| rows(&format!("time,rod,f1_hz,sd1_hz,f2_hz,sd2_hz\n{line}\n")).unwrap_err();
        assert_eq!(
            of("2026-03-01T06:00:00Z,a,4.5x,0.01,,"),
            "line 2, column 3 (f1_hz): \"4.5x\" is not a number of hertz above 0 and up to 100000"
        );
        assert!(of("2026-03-01T06:00:00Z,a,4.5,,,").contains("line 2, column 4 (sd1_hz): is empty beside"));
        assert!(
            of("2026-03-01T06:00:00Z,a,4.5,0,,").contains("column 4 (sd1_hz): \"0\" is not a standard error")
        );
        assert!(of("2026-03-01T06:00:00Z,a,4.5,0.01,4.4,0.01").contains("column 5 (f2_hz): is not above"));
        assert!(of(",a,4.5,0.01,,").contains("column 1 (time): is empty"));
        assert!(of("12.5,a,4.5,0.01,,").contains("before 2001"));
        assert!(of("yesterday,a,4.5,0.01,,").contains("\"yesterday\""));
        assert!(of("2026-03-01T06:00:00Z,a,4.5,0.01,,,,7").contains("8 cells, the first line names 6"));
        assert!(
            of("2026-03-01T06:00:00Z,a,4.5,0.01")
                .contains("line 2: 4 cells, the first line names 6: it is cut off")
        );
        let american = "time,f1_hz,sd1_hz\n03/04/2026 06:00,4.5,0.01\n";
        assert!(rows(american).unwrap_err().contains("--dates"));
        let read = read(american.as_bytes(), false, Some(DateOrder::MonthFirst)).unwrap();
        assert_eq!(read.rows[0].time.to_string(), "2026-03-04T06:00:00Z");
        for (head, says) in [
            ("rod,f1_hz,sd1_hz", "no column is called time"),
            ("time,f1_hz", "has no sd1_hz"),
            ("time,sd1_hz,temperature_c", "has no f1_hz"),
            ("time,f9_hz,sd9_hz", "modes 1 to"),
            ("time,time,temperature_c", "two columns"),
            ("time,rod", "neither"),
        ] {
            let said = rows(&format!("{head}\n")).unwrap_err();
            assert!(said.starts_with("line 1: ") && said.contains(says), "{said}");
        }
        assert!(rows("").unwrap_err().contains("is empty"));
        let amplitudes = "time,f1_hz,sd1_hz,rms\n2026-03-01,4.5,0.01,1e-5\n2026-03-02,4.5,0.01,\n";
        assert!(
            rows(amplitudes)
                .unwrap_err()
                .contains("line 3, column 4 (rms): is empty")
        );
    }
}
