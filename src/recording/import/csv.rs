//! Text tables: any delimiter, decimal comma, heads, dates.
//!
//! * `beginning` the first lines: delimiter, decimal sign, layout
//! * `cells`   lines to cells, and kinds of cells
//! * `columns` rows of cells to signals
//! * `layout`  first row of data, and names in the lines above

mod beginning;
mod cells;
mod columns;
mod layout;

use super::lines::Lines;
use super::stamp::{DateOrder, TimeUnit};
use super::{ImportError, Signal};
use beginning::Beginning;
use cells::check_head;
pub(super) use cells::{Splitter, is_missing, number};
use columns::Columns;
use layout::heads;
use std::io::BufRead;

/// Number of lines examined to find delimiter and heads.
const HEAD: usize = 200;

/// Options for reading a text table.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Table {
    /// Delimiter of columns; `None`: detected from the file. A blank stands for any number of blanks and
    /// tabs.
    pub delimiter: Option<u8>,
    /// True if the decimal sign is a comma.
    pub decimal_comma: bool,
    /// Number of lines before the first row of data; `None`: detected from the file.
    pub head_lines: Option<usize>,
    /// Column of the stamps.
    pub time: TimeColumn,
    /// Unit of numbers in the time column; `None`: from its head, else seconds.
    pub time_unit: Option<TimeUnit>,
    /// Order of day and month in dates with slashes.
    pub dates: Option<DateOrder>,
    /// Offset ahead of UTC of dates without an offset of their own \[s\].
    pub utc_offset_s: i32,
    /// Columns asked for, by name or number; empty: all.
    pub columns: Vec<String>,
}

/// Column of the stamps.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum TimeColumn {
    /// The column whose head names the time, if there is one.
    #[default]
    Found,
    /// No column, even if a head names the time.
    None,
    /// This column, or these two (day and time of day), by name or number.
    Named(Vec<String>),
}

/// Content of a table.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tabled {
    /// Columns of numbers.
    pub signals: Vec<Signal>,
    /// Columns not asked for that may give the rate: those that could be the time.
    pub witnesses: Vec<Signal>,
    /// Items left out, one sentence each.
    pub skipped: Vec<String>,
}

/// Reads a table.
///
/// # Errors
/// The first thing that is wrong, with line and column.
pub fn read(from: impl BufRead, table: &Table) -> Result<Tabled, ImportError> {
    let mut lines = Lines::new(from);
    let mut head = Vec::new();
    while head.len() < HEAD
        && let Some(line) = lines.next_text()?
    {
        head.push(line.into_owned());
    }
    let Beginning {
        delimiter,
        decimal_comma,
        rows,
        layout,
    } = Beginning::find(&head, table)?;
    if table.head_lines.is_none() {
        check_head(&head[..layout.first], delimiter)?;
        layout.check_above(&rows, decimal_comma)?;
    }
    let mut splitter = Splitter::new(delimiter);
    let (names, units) = heads(&rows[..layout.first], &layout, delimiter);
    let mut columns = Columns::choose(table, decimal_comma, layout, names, units, &rows)?;
    let first = columns.first_row();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::Timing;

    fn signals(text: &str, table: &Table) -> Result<Vec<Signal>, String> {
        read(text.as_bytes(), table)
            .map(|found| found.signals)
            .map_err(|error| error.to_string())
    }

    fn nanos(signal: &Signal) -> &[i64] {
        match &signal.timing {
            Timing::Stamps(stamps) => &stamps.nanos,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn an_empty_line_of_one_column_is_a_missing_sample() {
        let found = signals("d\n0.5\n\n0.25\n\n\n0.5\n\n", &Table::default()).unwrap();
        let finite: Vec<bool> = found[0].values.iter().map(|value| value.is_finite()).collect();
        assert_eq!(finite, [true, false, true, false, false, true]);
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
    fn decimal_commas_are_found_where_they_can_be_nothing_else() {
        for text in [
            "Zeit [ms];Weg\n0;1,25\n5;-0,5\n",
            "Zeit;Weg\n0,000;1,25\n0,005;-0,5\n",
            "Zeit\tWeg\n0,000\t1,250\n0,005\t-0,500\n",
        ] {
            let found = signals(text, &Table::default()).unwrap();
            assert_eq!(found[0].values, [1.25, -0.5], "{text:?}");
            assert_eq!(nanos(&found[0]), [0, 5_000_000], "{text:?}");
        }
        let thousands = signals("n;v\n1;1,250\n2;2,500\n", &Table::default()).unwrap_err();
        assert!(
            thousands.contains("thousands") && thousands.contains("--decimal-comma"),
            "{thousands}"
        );
    }

    #[test]
    fn text_columns_are_left_out_by_name() {
        let text = "t;d [mm];state;note\n0;1.5;ok;\n1;2.5;OVERLOAD;\n2;;ok;late\n3;4.5;7;\n4;5;ok\n";
        let found = read(text.as_bytes(), &Table::default()).unwrap();
        assert_eq!(found.signals.len(), 1);
        assert_eq!(found.signals[0].values.len(), 5);
        assert_eq!(
            found.skipped,
            ["column 3 (state) holds text", "column 4 (note) holds text"]
        );
        let named = Table {
            columns: vec!["state".into()],
            ..Table::default()
        };
        assert!(signals(text, &named).unwrap_err().contains("\"ok\" is no number"));
    }

    #[test]
    fn days_and_times_of_day_are_found_and_blank_ends_left() {
        let text = "Datum;Uhrzeit;Weg\n01.03.2026;06:00:00,000;1.5\n\n01.03.2026;06:00:00,005;2.5\n;;\n";
        let found = signals(text, &Table::default()).unwrap();
        assert_eq!(
            nanos(&found[0]),
            [1_772_344_800_000_000_000, 1_772_344_800_005_000_000]
        );
        assert_eq!(found[0].values, [1.5, 2.5]);
        let found = signals("time,d\n06:00:00.000,1.5\n06:00:00.005,2.5\n", &Table::default()).unwrap();
        let Timing::Stamps(stamps) = &found[0].timing else {
            panic!()
        };
        assert!(!stamps.absolute);
        assert_eq!(stamps.nanos[1] - stamps.nanos[0], 5_000_000);
    }

    #[test]
    fn a_time_in_an_unknown_unit_is_refused() {
        let text = "Time [fortnight],d\n0,1.5\n1,2.5\n";
        let error = signals(text, &Table::default()).unwrap_err();
        assert!(
            error.contains("\"fortnight\"") && error.contains("--time-unit"),
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

    /// Thousandths and less that count from 1970 are known as such; what may be either is for the plan to ask.
    #[test]
    fn the_unit_of_a_time_is_said_or_follows_from_its_date() {
        let stamps = |text: &str| match &signals(text, &Table::default()).unwrap()[0].timing {
            Timing::Stamps(stamps) => (stamps.nanos.clone(), stamps.says_unit, stamps.absolute),
            other => panic!("{other:?}"),
        };
        let six = 1_772_344_800_000_000_000;
        for (first, second) in [
            ("1772344800000", "1772344800005"),
            ("1772344800000000", "1772344800005000"),
            ("1772344800000000000", "1772344800005000000"),
        ] {
            let found = stamps(&format!("time,d\n{first},1.5\n{second},2.5\n"));
            assert_eq!(found, (vec![six, six + 5_000_000], true, true), "{first}");
        }
        assert_eq!(
            stamps("time,d\n0,1.5\n5,2.5\n"),
            (vec![0, 5_000_000_000], false, false)
        );
        assert_eq!(
            stamps("time_ms,d\n0,1.5\n5,2.5\n"),
            (vec![0, 5_000_000], true, false)
        );
        assert!(stamps("time,d\n06:00:00,1.5\n06:00:05,2.5\n").1);
        let beyond = signals("t,d\n9000000000,1.5\n9005000000,2.5\n", &Table::default()).map(|_| ());
        assert_eq!(beyond, Ok(()));
        let beyond = signals("t,d\n9300000000,1.5\n9305000000,2.5\n", &Table::default()).unwrap_err();
        assert!(beyond.contains("--time-unit"), "{beyond}");
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
        assert_eq!(found.signals[0].unit.as_deref(), Some("µm"));
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
        // Two columns of time that rise differently; a thermometer that says "wait" while the laser measures.
        let both = refused("t;time;d\n1;0.005;0.5\n2;0.010;0.25\n");
        assert!(
            both.contains("column 1 (t) and column 2 (time)") && both.contains("--time"),
            "{both}"
        );
        assert!(signals("t;time;d\n0.5;0.5;1\n0.75;0.75;2\n", &Table::default()).is_ok());
        let wait = refused(&format!(
            "t;d;air\n{}3;1.5;20\n4;2.5;21\n5;1.5;20\n6;2.5;21\n7;1.5;20\n8;2.5;21\n9;1.5;20\n",
            "1;1.5;wait\n".repeat(4)
        ));
        assert!(
            wait.starts_with("line 2, column 3: \"wait\" is no number"),
            "{wait}"
        );
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
