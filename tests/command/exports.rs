//! Exports of `history`, read by other programs: the same numbers as its JSON, in every format.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::archive::*;
use crate::program::{ROOT, program, tirante};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};
use tirante::command::history::{self, What};
use tirante::command::which_store::Format;
use tirante::site::store::{Asked, Durability, Filter, Reader, Store};

const WHAT: [(What, &str); 4] = [
    (What::Records, "records"),
    (What::Rejections, "rejections"),
    (What::Periods, "periods"),
    (What::Alarms, "alarms"),
];

/// Words of the person who acknowledged the alarm.
const SAID: &str = "M. Rossi: wedge, \"sound\"";

fn filled(path: &Path) -> Reader {
    let mut store = Store::open(path, Durability::Replay).unwrap();
    fill(&mut store, 0..50);
    let alarm = store.alarms(&Filter::default()).unwrap().remove(0);
    let said = Some(SAID.to_owned());
    let asked = Asked::Acknowledge {
        alarm: alarm.id,
        said,
    };
    store.request(&alarm.rod, &asked, hour(60)).unwrap();
    let mut states = store.states().unwrap();
    assert_eq!(store.acknowledge_waiting(&mut states).unwrap(), (1, 0));
    drop(store);
    Reader::open(path).unwrap()
}

fn listed(reader: &Reader, what: What, format: Format) -> String {
    let mut out = Vec::new();
    history::write(reader, &Filter::default(), what, format, &mut out).unwrap();
    String::from_utf8(out).unwrap()
}

/// Runs Python in `folder`; without it prints a line and returns `None`. With TIRANTE_REAL_PEERS it is
/// required.
fn python(folder: &Path, script: &str) -> Option<Output> {
    match Command::new("python3")
        .arg("-c")
        .arg(script)
        .current_dir(folder)
        .output()
    {
        Ok(output) => Some(output),
        Err(error) => {
            assert!(
                std::env::var_os("TIRANTE_REAL_PEERS").is_none(),
                "TIRANTE_REAL_PEERS wants python3: {error}"
            );
            eprintln!("left out: no python3 ({error})");
            None
        }
    }
}

fn stdout(output: Output) -> String {
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// Value of a column in a record's JSON line.
fn in_line<'a>(line: &'a Value, column: &str) -> Option<&'a Value> {
    if let Some(rest) = column.strip_prefix("mode_") {
        let (order, field) = rest.split_once('_').unwrap();
        let field = match field {
            "hz" => "frequency_hz",
            other => other,
        };
        let modes = line["modes"].as_array()?;
        let order: u64 = order.parse().unwrap();
        let mode = modes.iter().find(|mode| mode["order"].as_u64() == Some(order))?;
        return mode.get(field);
    }
    for (stem, unit) in [
        ("axial_force", "_n"),
        ("tracked_force", "_n"),
        ("force_at_reference", "_n"),
    ] {
        if let Some(rest) = column.strip_prefix(stem)
            && !column.starts_with("axial_force_cv")
            && let Some(inner) = rest.strip_suffix(unit)
        {
            let inner = inner.strip_prefix('_').unwrap_or("mean");
            return line.get(format!("{stem}{unit}"))?.get(inner);
        }
    }
    for stem in ["relative_force_at_reference", "relative_force"] {
        if let Some(rest) = column.strip_prefix(stem) {
            return line.get(stem)?.get(rest.strip_prefix('_').unwrap_or("mean"));
        }
    }
    match column {
        "rejection" => line["rejection"].get("code"),
        "rejection_message" => line["rejection"].get("message"),
        other => line.get(other),
    }
}

/// True if a cell of text and JSON hold the same value.
fn is_same(cell: &str, value: Option<&Value>) -> bool {
    match value {
        None | Some(Value::Null) => cell.is_empty(),
        Some(Value::Number(number)) if number.is_f64() => {
            cell.parse::<f64>().map(f64::to_bits) == Ok(number.as_f64().unwrap().to_bits())
        }
        Some(Value::Bool(value)) => cell == if *value { "1" } else { "0" },
        Some(Value::String(text)) => cell == text,
        Some(other) => {
            let text = other.to_string();
            cell == text
        }
    }
}

/// Compares every cell of a listing as Python reads it with its JSON; returns the number of filled cells,
/// `None` without Python.
fn compare(folder: &Path, csv: &str, json: &str) -> Option<usize> {
    std::fs::write(folder.join("a.csv"), csv).unwrap();
    let script = "import csv, json\nfor row in csv.DictReader(open('a.csv', newline='', encoding='utf-8'), strict=True): print(json.dumps(row))";
    let rows: Vec<Value> = stdout(python(folder, script)?)
        .lines()
        .map(|row| serde_json::from_str(row).unwrap())
        .collect();
    let lines: Vec<Value> = json
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(rows.len(), lines.len());
    let mut compared = 0;
    for (row, line) in rows.iter().zip(&lines) {
        for (column, cell) in row.as_object().unwrap() {
            // Of the store alone, not of the line.
            if ["rms", "emulator", "file"].contains(&column.as_str()) {
                continue;
            }
            let (cell, value) = (cell.as_str().unwrap(), in_line(line, column));
            assert!(
                is_same(cell, value),
                "{column} is {cell:?} in CSV, {value:?} in JSON"
            );
            compared += usize::from(!cell.is_empty());
        }
    }
    Some(compared)
}

#[test]
fn csv_as_python_reads_it_says_what_json_says() {
    let folder = tempfile::tempdir().unwrap();
    let reader = filled(&folder.path().join("site.db"));
    for (what, least) in [
        (What::Records, 1000),
        (What::Rejections, 20),
        (What::Periods, 30),
        (What::Alarms, 6),
    ] {
        let (csv, json) = (
            listed(&reader, what, Format::Csv),
            listed(&reader, what, Format::Json),
        );
        let Some(compared) = compare(folder.path(), &csv, &json) else {
            return;
        };
        assert!(compared >= least, "{what:?}: only {compared} cells compared");
    }
}

#[test]
fn csv_of_a_replay_says_what_the_replay_printed() {
    let folder = tempfile::tempdir().unwrap();
    let recording = Path::new(ROOT).join("recordings/todi-pull.mcap");
    let run = |line: &str| tirante(&folder, line).done();
    let json = run(&format!(
        "replay {} --format json --store site.db",
        recording.display()
    ));
    assert_eq!(run("history --store site.db --format json"), json);
    let csv = run("history --store site.db --format csv");
    if let Some(compared) = compare(folder.path(), &csv, &json) {
        assert!(compared > 25, "only {compared} cells compared");
    }
}

/// The blocks of Python on a page of docs/.
fn blocks(page: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(page);
    let text = std::fs::read_to_string(path).unwrap();
    let parts = text.split("```python\n").skip(1);
    parts
        .map(|part| part.split("```").next().unwrap().to_owned())
        .collect()
}

#[test]
fn the_python_lines_of_the_documentation_read_the_store() {
    let folder = tempfile::tempdir().unwrap();
    let reader = filled(&folder.path().join("site.db"));
    let blocks = blocks("store.md");
    let short = blocks.first().expect("three lines of Python in docs/store.md");
    assert_eq!(short.lines().count(), 3, "{short}");
    let script = format!("{short}\nimport json\nprint(json.dumps([list(row) for row in rows]))");
    let Some(output) = python(folder.path(), &script) else {
        return;
    };
    let rows: Vec<(String, f64)> = serde_json::from_str(&stdout(output)).unwrap();
    let json = listed(&reader, What::Records, Format::Json);
    let lines: Vec<Value> = json
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let expected: Vec<(String, f64)> = lines
        .iter()
        .filter(|line| line["rod"] == "north")
        .filter_map(|line| {
            Some((
                line["start"].as_str()?.to_owned(),
                line["axial_force_n"]["mean"].as_f64()?,
            ))
        })
        .collect();
    assert!(expected.len() > 10);
    assert_eq!(rows, expected);
}

mod parquet_file {
    use super::*;
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::Field;
    use tirante::analysis::signal::record::Timestamp;

    #[test]
    fn parquet_says_what_csv_says() {
        let folder = tempfile::tempdir().unwrap();
        let reader = filled(&folder.path().join("site.db"));
        for (what, name) in WHAT {
            let mut bytes = Vec::new();
            tirante::command::parquet::write(&reader, &Filter::default(), what, &mut bytes).unwrap();
            let mut again = Vec::new();
            tirante::command::parquet::write(&reader, &Filter::default(), what, &mut again).unwrap();
            assert_eq!(bytes, again);
            let mut rows: Vec<Vec<(String, String)>> = Vec::new();
            reader
                .list(
                    what.listing(),
                    &Filter::default(),
                    |names, values| -> anyhow::Result<()> {
                        let cells = values.iter().map(|value| match value {
                            rusqlite::types::Value::Null => String::new(),
                            rusqlite::types::Value::Integer(number) => number.to_string(),
                            rusqlite::types::Value::Real(number) => format!("{number:?}"),
                            rusqlite::types::Value::Text(text) => text.clone(),
                            rusqlite::types::Value::Blob(_) => panic!("a blob"),
                        });
                        rows.push(names.iter().cloned().zip(cells).collect());
                        Ok(())
                    },
                )
                .unwrap();
            let file = SerializedFileReader::new(bytes::Bytes::from(bytes)).unwrap();
            let mut count = 0;
            for (row, expected) in file.get_row_iter(None).unwrap().zip(&rows) {
                count += 1;
                for ((column, field), (name, cell)) in row.unwrap().get_column_iter().zip(expected) {
                    assert_eq!(column, name);
                    let found = match field {
                        Field::Null => String::new(),
                        Field::Str(text) => text.clone(),
                        Field::Double(number) => format!("{number:?}"),
                        Field::Long(number)
                            if ["start", "raised", "acknowledged", "cleared"].contains(&name.as_str()) =>
                        {
                            Timestamp::from_nanos(*number).to_string()
                        }
                        Field::Long(number) => number.to_string(),
                        other => panic!("{name}: {other:?}"),
                    };
                    assert_eq!(&found, cell, "{name}");
                }
            }
            assert_eq!(count, rows.len(), "{name}");
            assert!(count > 0, "{name}");
            let last = rows[0].last().unwrap();
            assert_eq!(
                last.0 == "acknowledged_words" && last.1 == SAID,
                what == What::Alarms
            );
        }
    }
}

#[test]
fn mcap_has_every_force_every_mode_and_every_alarm() {
    let folder = tempfile::tempdir().unwrap();
    let reader = filled(&folder.path().join("site.db"));
    let output = program(&folder)
        .args(["history", "--store", "site.db", "--format", "mcap"])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let mut found: Vec<(String, u64, Value)> = Vec::new();
    for message in mcap::MessageStream::new(&output.stdout).unwrap() {
        let message = message.unwrap();
        assert_eq!(message.channel.message_encoding, "json");
        let schema = message.channel.schema.clone().unwrap();
        let schema: Value = serde_json::from_slice(&schema.data).unwrap();
        let body: Value = serde_json::from_slice(&message.data).unwrap();
        for key in body.as_object().unwrap().keys() {
            assert!(
                schema["properties"].get(key).is_some(),
                "{key} is not in the schema"
            );
        }
        let stamp = &body["timestamp"];
        let nanos = stamp["sec"].as_u64().unwrap() * 1_000_000_000 + stamp["nsec"].as_u64().unwrap();
        assert_eq!(nanos, message.log_time);
        found.push((message.channel.topic.clone(), message.log_time, body));
    }
    let said = |what: What| -> Vec<Value> {
        let text = listed(&reader, what, Format::Json);
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    };
    let forces: Vec<&Value> = found
        .iter()
        .filter(|(topic, ..)| topic.ends_with("/force"))
        .map(|(.., body)| body)
        .collect();
    let records = said(What::Records);
    assert_eq!((forces.len(), records.len()), (50, 50));
    for (force, record) in forces.iter().zip(&records) {
        for key in [
            "axial_force_n",
            "relative_force",
            "temperature_c",
            "state",
            "rejection",
            "conflict",
            "prior_tail",
        ] {
            assert_eq!(
                force[key],
                record.get(key).cloned().unwrap_or(Value::Null),
                "{key}"
            );
        }
    }
    assert!(found.iter().any(|(topic, ..)| topic == "/tirante/south è/force"));
    let alarms: Vec<&Value> = found
        .iter()
        .filter(|(topic, ..)| topic == "/tirante/alarms")
        .map(|(.., body)| &body["file"])
        .collect();
    let told = found
        .iter()
        .find(|(topic, ..)| topic == "/tirante/alarms")
        .unwrap();
    let text = told.2["message"].as_str().unwrap();
    assert!(
        text.ends_with(&format!(" (acknowledged {}, {SAID})", hour(60))),
        "{text}"
    );
    let wanted = said(What::Alarms);
    assert!(!wanted.is_empty());
    assert_eq!(
        alarms,
        wanted.iter().map(|alarm| &alarm["id"]).collect::<Vec<_>>()
    );
}
