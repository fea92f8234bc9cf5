//! A store that the version before wrote goes on: its baselines stay, its records stay as they are, and what comes is told.
//!
//! `fixtures/store-format-N.*` hold the store of 17 days of two healthy rods ([`SITE`] with 64 particles, simulated with seed 1000)
//! and its `history --format json`, both written by the last version of that format; 6 is the format before the present one.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::site::*;
use rusqlite::types::Value;
use std::collections::BTreeMap;
use std::fs;
use tirante::site::store::{Reader, shapes};

#[test]
fn a_store_of_format_4_keeps_its_baselines_and_goes_on() {
    goes_on(
        include_bytes!("../fixtures/store-format-4.db.zst"),
        include_bytes!("../fixtures/store-format-4.jsonl.zst"),
    );
}

#[test]
fn a_store_of_the_version_before_keeps_its_baselines_and_goes_on() {
    goes_on(
        include_bytes!("../fixtures/store-format-6.db.zst"),
        include_bytes!("../fixtures/store-format-6.jsonl.zst"),
    );
}

/// Continues a packed store, whose records were `records` as packed JSON lines.
fn goes_on(store: &[u8], records: &[u8]) {
    let as_then = SITE.replace("[abc]\ndraws = 20000\n\n", "");
    let site = Site::new(&as_then.replace("particles = 256", "particles = 64"));
    let unpacked = |packed: &[u8]| zstd::decode_all(packed).unwrap();
    fs::write(site.path("site.db"), unpacked(store)).unwrap();
    let history = || {
        let output = site.run(&["history", "--store", "site.db", "--format", "json"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let written = text(&unpacked(records));
    assert_eq!(history(), written);

    let output = site.run(&["check", "--config", "site.toml", "--against", "site.db"]);
    let told = text(&output.stdout);
    assert!(output.status.success(), "{told}{}", text(&output.stderr));
    assert_eq!(told.matches("the baseline stays (segment 1").count(), 2, "{told}");

    // A declared rate scales every frequency; where the samples stand changes none. (The version of format 4 did not hash the rate.)
    let toml = fs::read_to_string(site.path("site.toml")).unwrap();
    for (from, to, code, said) in [
        (
            "fs_hz = 100.0",
            "fs_hz = 200.0",
            3,
            "rod.channel.fs_hz: 100.0 -> 200.0",
        ),
        (
            "field = \"values\"\nunit = \"m\"\nfs_hz",
            "field = \"values\"\nunit = \"m\"\ntime = \"publish\"\nfs_hz",
            3,
            "rod.channel.time: nothing -> \"publish\"",
        ),
        (
            "topic = \"/north\"",
            "topic = \"/nave\"",
            0,
            "rod north: the baseline stays",
        ),
    ] {
        assert!(toml.contains(from), "{from}");
        fs::write(site.path("other.toml"), toml.replacen(from, to, 1)).unwrap();
        let output = site.run(&["check", "other.toml", "--against", "site.db"]);
        let told = text(&output.stdout);
        assert!(
            told.contains(said) && told.contains("rod south: the baseline stays"),
            "{told}"
        );
        assert_eq!(output.status.code(), Some(code), "{told}");
        // Quiet: the faults alone.
        let output = site.run(&["check", "other.toml", "--against", "site.db", "--quiet"]);
        let told = text(&output.stdout);
        assert_eq!(
            told.lines().count(),
            told.matches("would be lost").count(),
            "{told}"
        );
        assert_eq!(
            (told.is_empty(), output.status.code()),
            (code == 0, Some(code)),
            "{told}"
        );
    }

    let loss = "[[simulation.rod.change]]\nstart_d = 0.0\nrelative = -0.10\n";
    site.simulate("after", &Part::new(17, 12).north(loss));
    let (output, code) = site.replay(&["archive"], "site.db");
    assert_eq!(code, 0, "{}", text(&output.stderr));
    let now = history();
    // The rods are listed one after the other: 17 records of each are those of the fixture, byte for byte.
    let of = |text: &str, rod: &str| -> Vec<String> {
        let name = format!("\"rod\":\"{rod}\"");
        text.lines()
            .filter(|line| line.contains(&name))
            .map(str::to_owned)
            .collect()
    };
    for rod in ["north", "south"] {
        let (before, after) = (of(&written, rod), of(&now, rod));
        assert_eq!((before.len(), after.len()), (17, 29), "{rod}");
        assert_eq!(before[..], after[..17], "{rod}");
        assert!(
            after.iter().all(|line| line.contains("\"segment\":1")),
            "{rod} began anew"
        );
    }
    // Told of the rod that lost 10 % alone, against the baseline that the version before learned.
    let alarms = site.alarms("site.db");
    assert!(
        alarms.contains(&"north drift".to_owned()) && alarms.contains(&"north limit".to_owned()),
        "{alarms:?}"
    );
    assert!(
        alarms.iter().all(|alarm| alarm.starts_with("north ")),
        "{alarms:?}"
    );
    the_log_holds_every_row(&site);
}

/// The log of changes, applied in order, gives every row that is copied to a centre: those from before the log, too.
fn the_log_holds_every_row(site: &Site) {
    let reader = Reader::open(&site.path("site.db")).unwrap();
    let changes = reader.changes_after(0, usize::MAX).unwrap();
    // A baseline's particles are tens of kilobytes: many of them in one commit make no message.
    for change in &changes {
        let segments = change.rows.iter().filter(|row| row.table == "segment").count();
        assert!(segments <= 1, "{}: {segments}", change.number);
    }
    for shape in shapes().unwrap() {
        let key_of = |values: &[Value]| -> Vec<String> {
            let columns = shape.columns.iter().zip(values);
            let keys = columns.filter(|(column, _)| column.key > 0);
            keys.map(|(_, value)| format!("{value:?}")).collect()
        };
        let mut applied = BTreeMap::new();
        for row in changes.iter().flat_map(|change| &change.rows) {
            if row.table == shape.table {
                applied.insert(key_of(&row.values), row.values.clone());
            }
        }
        let kept = reader.copied_rows(&shape).unwrap();
        let kept: BTreeMap<_, _> = kept.into_iter().map(|row| (key_of(&row), row)).collect();
        assert_eq!(applied, kept, "{}", shape.table);
    }
}
