//! Output and effect of `history`, `status`, `ack` and `rebaseline` on a store.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::archive::*;
use clap::Parser;
use serde_json::Value;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::ExitCode;
use tirante::analysis::signal::record::RodId;
use tirante::command::history::{self, What};
use tirante::command::which_store::Format;
use tirante::command::{BadArguments, ack, rebaseline, status};
use tirante::site::store::{Asked, Durability, Filter, Reader, Store};

#[derive(Parser)]
enum Command {
    History(history::Args),
    Status(status::Args),
    Ack(ack::Args),
    Rebaseline(rebaseline::Args),
}

fn run(words: &[&str]) -> anyhow::Result<ExitCode> {
    let words = ["tirante"].iter().chain(words);
    match Command::try_parse_from(words).map_err(|error| BadArguments(error.to_string()))? {
        Command::History(args) => history::run(&args),
        Command::Status(args) => status::run(&args),
        Command::Ack(args) => ack::run(&args),
        Command::Rebaseline(args) => rebaseline::run(&args),
    }
}

fn refused(words: &[&str]) -> String {
    let error = run(words).unwrap_err();
    assert!(error.is::<BadArguments>(), "{error:#}");
    error.to_string()
}

fn listed(reader: &Reader, what: What, format: Format) -> String {
    let mut out = Vec::new();
    history::write(reader, &Filter::default(), what, format, &mut out).unwrap();
    String::from_utf8(out).unwrap()
}

fn filled(path: &Path) -> Reader {
    fill(&mut Store::open(path, Durability::Replay).unwrap(), 0..50);
    Reader::open(path).unwrap()
}

/// A reader of RFC 4180 that shares nothing with the writer.
fn parse_csv(text: &str) -> Vec<Vec<String>> {
    let (mut rows, mut row, mut cell, mut quoted) = (Vec::new(), Vec::new(), String::new(), false);
    let mut characters = text.chars().peekable();
    while let Some(c) = characters.next() {
        match (c, quoted) {
            ('"', true) if characters.peek() == Some(&'"') => cell.push(characters.next().unwrap()),
            ('"', _) => quoted = !quoted,
            (',', false) => row.push(std::mem::take(&mut cell)),
            ('\r', false) => {
                assert_eq!(characters.next(), Some('\n'));
                row.push(std::mem::take(&mut cell));
                rows.push(std::mem::take(&mut row));
            }
            (c, _) => cell.push(c),
        }
    }
    assert!(row.is_empty() && cell.is_empty(), "the last line has no end");
    rows
}

#[test]
fn history_as_csv_is_a_rectangle_with_units_in_the_header() {
    let folder = tempfile::tempdir().unwrap();
    let reader = filled(&folder.path().join("site.db"));
    for (what, rows) in [
        (What::Records, 50),
        (What::Rejections, 5),
        (What::Periods, 3),
        (What::Alarms, 1),
    ] {
        let table = parse_csv(&listed(&reader, what, Format::Csv));
        assert_eq!(table.len(), rows + 1, "{what:?}");
        assert!(table.iter().all(|row| row.len() == table[0].len()), "{what:?}");
    }
    let table = parse_csv(&listed(&reader, What::Records, Format::Csv));
    let column = |name: &str| table[0].iter().position(|known| known == name).unwrap();
    assert_eq!(table[1][column("axial_force_n")], "574000.0");
    assert_eq!(table[1][column("mode_2_sd_hz")], "0.004");
    assert_eq!(table[1][column("start")], hour(0).to_string());
    assert_eq!(table[50][column("rod")], "south è");
    assert_eq!(table[50][column("rejection_message")], "no \"peak\", none");
}

#[test]
fn history_as_json_repeats_the_printed_lines() {
    let folder = tempfile::tempdir().unwrap();
    let reader = filled(&folder.path().join("site.db"));
    let north = RodId("north".into());
    let text = listed(&reader, What::Records, Format::Json);
    assert_eq!(text.lines().count(), 50);
    assert_eq!(text.lines().next().unwrap(), line(&identified(&north, 0)));
    let alarm: Value = serde_json::from_str(&listed(&reader, What::Alarms, Format::Json)).unwrap();
    assert_eq!(
        (&alarm["kind"], &alarm["stands"]),
        (&"drift".into(), &true.into())
    );
    let periods = listed(&reader, What::Periods, Format::Json);
    let period: Value = serde_json::from_str(periods.lines().next().unwrap()).unwrap();
    assert_eq!(
        (&period["records"], &period["evidence"]),
        (&24.into(), &0.25.into())
    );
    let table = listed(&reader, What::Records, Format::Table);
    assert!(
        table.contains("~-4.85 ± 0.14") && table.contains("rejected (no-peak)"),
        "{table}"
    );
}

#[test]
fn status_says_what_stands_and_what_is_not_compensated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let reader = filled(&path);
    let table = status::text(&reader, None, Format::Table, None).unwrap();
    for wanted in [
        "~-4.85 (",
        "uncompensated",
        "drift since",
        "20.0 %",
        "the \"drift\" of record 40",
    ] {
        let words: Vec<&str> = table.split_whitespace().collect();
        assert!(words.join(" ").contains(wanted), "{wanted}:\n{table}");
    }
    let north = RodId("north".into());
    let row: Value =
        serde_json::from_str(&status::text(&reader, Some(&north), Format::Json, None).unwrap()).unwrap();
    assert_eq!(
        (&row["state"], &row["compensated"]),
        (&"alarm".into(), &false.into())
    );
    assert_eq!(row["since"], hour(40).to_string());
    assert_eq!(row["latest_record"], hour(48).to_string());
    assert_eq!((&row["records"], &row["rejected"]), (&25.into(), &0.into()));
    // No daemon ever worked on this store, and its configuration does not say when data are stale.
    let unknown = [&row["monitoring"], &row["stale_after_s"]];
    assert!(
        unknown.iter().all(|value| value.is_null()) && row["is_stale"] == false,
        "{row}"
    );
    let table = parse_csv(&status::text(&reader, None, Format::Csv, None).unwrap());
    assert!(table.len() == 3 && table.iter().all(|row| row.len() == table[0].len()));
    let empty = folder.path().join("empty.db");
    drop(Store::open(&empty, Durability::Full).unwrap());
    assert_eq!(
        status::text(&Reader::open(&empty).unwrap(), None, Format::Table, None).unwrap(),
        ""
    );
}

#[test]
fn acknowledging_works_beside_a_writer_and_without_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let reader = filled(&path);
    let north = RodId("north".into());
    let id = reader.alarms(&Filter::default()).unwrap()[0].id.clone();
    let store = path.to_str().unwrap();
    {
        let _writer = Store::open(&path, Durability::Full).unwrap();
        run(&["ack", "--store", store, &id]).unwrap();
        assert!(reader.alarm(&id).unwrap().unwrap().acknowledged.is_none());
        assert_eq!(reader.waiting(&north).unwrap().len(), 1);
        let table = status::text(&reader, None, Format::Table, None).unwrap();
        assert!(
            table.contains(&format!("waits for the next record: acknowledge {id}")),
            "{table}"
        );
    }
    run(&["ack", "--store", store, "--rod", "north"]).unwrap();
    assert!(reader.alarm(&id).unwrap().unwrap().acknowledged.is_some());
    assert!(reader.waiting(&north).unwrap().is_empty());
    // No event is repeated, and an alarm whose condition lasts stays active.
    assert_eq!(reader.events(&north).unwrap().len(), 2);
    assert_eq!(reader.standings().unwrap()[0].state.code(), "alarm");
    run(&["ack", "--store", store, "--all"]).unwrap();
    assert_eq!(reader.events(&north).unwrap().len(), 2);
}

#[test]
fn who_acknowledged_and_why_is_told_with_the_alarm() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let reader = filled(&path);
    let lists = |format| listed(&reader, What::Alarms, format);
    let last = |text: &str| {
        parse_csv(text)
            .iter()
            .map(|row| row.last().cloned())
            .collect::<Vec<_>>()
    };
    let column = Some("acknowledged_words".to_owned());
    assert_eq!(last(&lists(Format::Csv)), [column.clone(), Some(String::new())]);

    let (store, said) = (path.to_str().unwrap(), "M. Rossi: wedge, \"sound\" <b>");
    let words = ["--by", "M. Rossi", "--note", "wedge, \"sound\" <b>"];
    run(&[&["ack", "--store", store, "--all"], &words[..]].concat()).unwrap();
    assert_eq!(last(&lists(Format::Csv)), [column, Some(said.to_owned())]);
    let alarm: Value = serde_json::from_str(&lists(Format::Json)).unwrap();
    assert_eq!(alarm["acknowledged_words"], said);
    let flat = |text: String| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let table = flat(lists(Format::Table));
    assert!(table.contains(&format!("({said}); ")), "{table}");

    let status = |format| status::text(&reader, None, format, None).unwrap();
    let table = flat(status(Format::Table));
    assert!(table.contains(&format!("acknowledged ({said})")), "{table}");
    let row: Value = serde_json::from_str(status(Format::Json).lines().next().unwrap()).unwrap();
    assert_eq!(row["alarms"][0]["acknowledged_words"], said, "{row}");
    let id = row["alarms"][0]["id"].as_str().unwrap();
    assert_eq!(
        last(&status(Format::Csv))[..2],
        [
            Some("acknowledged_words".to_owned()),
            Some(format!("{id} {said}"))
        ]
    );

    let report = tirante::command::report::load(&reader, None).unwrap();
    let page = tirante::command::report_page::page(&report);
    let escaped = "M. Rossi: wedge, &quot;sound&quot; &lt;b&gt;";
    assert_eq!(
        page.matches(escaped).count(),
        2,
        "beside the alarm, and in the table"
    );
    assert!(page.contains("Acknowledged by"));
}

#[test]
fn a_new_baseline_waits_for_the_next_record() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let reader = filled(&path);
    let store = path.to_str().unwrap();
    run(&["rebaseline", "--store", store, "north", "--reason", "retensioned"]).unwrap();
    // Asked twice, it is done once.
    run(&["rebaseline", "--store", store, "north", "--reason", "again"]).unwrap();
    let waiting = reader.waiting(&RodId("north".into())).unwrap();
    assert_eq!(waiting.len(), 1);
    let reason = Some("retensioned".to_owned());
    assert_eq!(waiting[0].what, Asked::Rebaseline { reason });
}

#[test]
fn arguments_that_make_no_sense_name_what_would() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    filled(&path);
    let store = path.to_str().unwrap();
    assert!(refused(&["status"]).contains("--store FILE"));
    let config = folder.path().join("todi.toml");
    std::fs::copy(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("config/todi.toml"),
        &config,
    )
    .unwrap();
    let text = refused(&["status", "--config", config.to_str().unwrap()]);
    assert!(text.contains("[store]") && text.contains("todi.toml"), "{text}");
    assert!(refused(&["history", "--store", store, "--rod", "nord"]).contains("north, south è"));
    assert!(
        refused(&[
            "history",
            "--store",
            store,
            "--from",
            "2026-03-02",
            "--to",
            "2026-03-01"
        ])
        .contains("--from")
    );
    assert!(refused(&["history", "--store", store, "--from", "March"]).contains("2026-03-01"));
    assert!(refused(&["ack", "--store", store, "0000"]).contains("no alarm 0000"));
    assert!(refused(&["ack", "--store", store]).contains("required"));
    assert!(refused(&["rebaseline", "--store", store, "nord"]).contains("north"));
    let none = folder.path().join("none.db");
    let error = run(&["status", "--store", none.to_str().unwrap()]).unwrap_err();
    assert!(error.to_string().contains("there is no store"), "{error}");
    run(&[
        "history",
        "--store",
        store,
        "--what",
        "periods",
        "--from",
        "2023-11-14",
        "--format",
        "csv",
    ])
    .unwrap();
}

/// A daemon writes while its page reads in the same process, and people query from other processes meanwhile.
#[test]
fn what_is_written_while_others_come_and_go_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let mut store = Store::open(&path, Durability::Full).unwrap();
    fill(&mut store, 0..45);
    let _page = Reader::open(&path).unwrap();
    let tirante = |words: &[&str]| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_tirante"))
            .args(words)
            .args(["--store", "site.db"])
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8(output.stdout).unwrap()
    };
    let listed = || tirante(&["history", "--format", "json"]).lines().count();
    // SQLite's lock on the file, which keeps others from taking the write-ahead log away; any close of the file by this process
    // would have let go of it.
    let is_locked = || {
        let inode = std::fs::metadata(&path).unwrap().ino();
        let (own, of_file) = (format!(" {} ", std::process::id()), format!(":{inode} "));
        std::fs::read_to_string("/proc/locks")
            .unwrap()
            .lines()
            .any(|lock| lock.contains("POSIX") && lock.contains(&own) && lock.contains(&of_file))
    };
    assert!(is_locked());
    for last in [50, 55, 60] {
        // It opens the store, writes its request, and is the last to leave but for this process.
        tirante(&["rebaseline", "north"]);
        drop(Reader::open(&path).unwrap());
        fill(&mut store, last - 5..last);
        assert_eq!(
            listed(),
            usize::try_from(last).unwrap(),
            "others see what was committed"
        );
    }
    // A kill at this point loses nothing: everything is on the disk.
    for part in ["site.db", "site.db-wal", "site.db-shm"] {
        std::fs::copy(
            folder.path().join(part),
            folder.path().join(part.replace("site", "copy")),
        )
        .unwrap();
    }
    let copy = Reader::open(&folder.path().join("copy.db")).unwrap();
    assert_eq!(copy.rows_after(0, 1000).unwrap().len(), 60);
}

#[test]
fn records_without_their_lines_are_counted_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let reader = filled(&path);
    let rod = RodId("south è".into());
    let counted = |reader: &Reader| {
        let report = tirante::command::report::load(reader, Some(&rod)).unwrap();
        let report = &report.rods[0];
        (report.used(), report.rejections.clone(), report.segment)
    };
    let before = counted(&reader);
    assert_eq!(before.0, 20);
    assert_eq!(before.1[0].count, 5);
    assert!(before.1[0].last.is_some());
    Store::open(&path, Durability::Replay)
        .unwrap()
        .forget_lines(&rod, None, hour(30), None)
        .unwrap();
    let gone = reader.without_line(&Filter::default()).unwrap();
    assert_eq!((gone.records, gone.refused, gone.used), (15, 3, 12));
    assert_eq!(counted(&reader), before);
}
