//! The same archive again, a damaged store, and requests between two replays.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::site::*;
use std::fs;
use tirante::analysis::signal::record::RodId;
use tirante::site::store::{Asked, Durability, Reader, Store};

fn said(output: &std::process::Output) -> String {
    text(&output.stderr)
}

/// The first sample of a file completes the last record of the file before it, which is not its record for that.
#[test]
fn each_record_names_the_file_that_holds_it() {
    let site = Site::new(SITE);
    for week in 0..3 {
        site.simulate(&format!("week-{week}"), &Part::new(4 * week, 4));
    }
    site.replay(&["archive"], "site.db");
    let store = rusqlite::Connection::open(site.path("site.db")).unwrap();
    let rows: Vec<(i64, String)> = store
        .prepare("SELECT start_ns, file FROM record JOIN origin ON origin.record = record.id ORDER BY start_ns, rod")
        .unwrap()
        .query_map((), |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    let expected: Vec<(i64, String)> = (0..12)
        .flat_map(|day| {
            let row = (noon(day).as_nanos(), format!("archive/week-{}.mcap", day / 4));
            [row.clone(), row]
        })
        .collect();
    assert_eq!(rows, expected);
}

#[test]
fn the_same_archive_again_adds_nothing_whatever_the_names() {
    let site = campaign();
    let (output, code) = site.replay(&["archive"], "site.db");
    assert_eq!(code, 3);
    let count = lines(&output.stdout).len();
    let tally = said(&output);
    assert!(
        tally.starts_with(&format!("{count} records from 7 files: ")),
        "{tally}"
    );
    let whole = site.dump("site.db");

    let (output, code) = site.replay(&["archive"], "site.db");
    let tally = said(&output);
    // Nothing was rejected this time and nothing lost: good.
    assert_eq!((code, output.stdout.len()), (0, 0), "{tally}");
    let left_out = format!(
        "{count} records from 7 files: 0 identified, {count} left out (the same data as one before, or in the store)"
    );
    assert!(tally.starts_with(&left_out), "{tally}");
    assert_equal_dumps(&whole, &site.dump("site.db"));

    // Copies under other names, in another order, some of them twice.
    fs::create_dir(site.path("copies")).unwrap();
    for index in 0..7 {
        let copy_name = format!("copies/{}-again.mcap", char::from(b'z' - index));
        copy(
            &site.path(&format!("archive/week-{index}.mcap")),
            &site.path(&copy_name),
        );
    }
    let paths = [
        "archive/week-5.mcap",
        "copies",
        "archive/week-1.mcap",
        "copies/w-again.mcap",
        "archive",
    ];
    let (output, code) = site.replay(&paths, "site.db");
    assert_eq!((code, output.stdout.len()), (0, 0), "{}", said(&output));
    assert_equal_dumps(&whole, &site.dump("site.db"));

    // File by file, each twice: the same store.
    for index in 0..7 {
        let file = format!("archive/week-{index}.mcap");
        let again = format!("copies/{}-again.mcap", char::from(b'z' - index));
        site.replay(&[&file, &again], "single.db");
    }
    assert_equal_dumps(&whole, &site.dump("single.db"));
}

#[test]
fn a_damaged_store_is_moved_aside_and_rebuilt_from_the_recordings() {
    let site = campaign();
    site.replay(&["archive"], "site.db");
    let whole = site.dump("site.db");
    let good = fs::read(site.path("site.db")).unwrap();
    let mut flipped = good.clone();
    // Many places: one alone may lie in a page that holds nothing.
    for place in 1..64 {
        flipped[place * good.len() / 64 + 100] ^= 0x10;
    }
    let damages: [(&str, Vec<u8>); 3] = [
        ("cut", good[..good.len() / 2].to_vec()),
        ("flipped", flipped),
        ("zeroed", vec![0; good.len()]),
    ];
    for (number, (name, damaged)) in damages.into_iter().enumerate() {
        fs::write(site.path("site.db"), &damaged).unwrap();
        let refused = site.run(&["status", "--store", "site.db"]);
        assert_eq!(refused.status.code(), Some(1), "{name}: {}", said(&refused));
        let (output, code) = site.replay(&["archive"], "site.db");
        assert_eq!(code, 3, "{name}: {}", said(&output));
        let aside = format!("site.db.corrupt-{}", number + 1);
        assert!(
            said(&output).contains(&aside) && said(&output).contains("damaged"),
            "{name}: {}",
            said(&output)
        );
        assert_eq!(
            fs::read(site.path(&aside)).unwrap(),
            damaged,
            "{name}: what was there is kept"
        );
        assert_equal_dumps(&whole, &site.dump("site.db"));
    }
}

/// Replays the campaign into a store, with requests after the last week but one; `steps` are the replays
/// after them.
fn with_requests(site: &Site, store: &str, steps: &[&[&str]]) -> String {
    let before: Vec<String> = (0..6).map(|index| format!("archive/week-{index}.mcap")).collect();
    let before: Vec<&str> = before.iter().map(String::as_str).collect();
    site.replay(&before, store);
    let alarms = site.history(store, "alarms");
    let drift = alarms.iter().find(|alarm| alarm["kind"] == "drift");
    let drift = drift.expect("the loss alarms within its first week");
    let mut open = Store::open(&site.path(store), Durability::Replay).unwrap();
    let alarm = drift["id"].as_str().unwrap().to_owned();
    let (north, south) = (RodId("north".into()), RodId("south".into()));
    let requests = [
        (
            &north,
            Asked::Acknowledge {
                alarm,
                said: Some("M. Rossi: looked at".to_owned()),
            },
        ),
        (&south, Asked::Rebaseline { reason: None }),
        (
            &north,
            Asked::Rebaseline {
                reason: Some("understood".to_owned()),
            },
        ),
    ];
    for (rod, what) in &requests {
        open.request(rod, what, noon(48)).unwrap();
    }
    drop(open);
    for paths in steps {
        site.replay(paths, store);
    }
    let reader = Reader::open(&site.path(store)).unwrap();
    for rod in [&north, &south] {
        assert!(reader.waiting(rod).unwrap().is_empty());
        assert_eq!(reader.segments(rod).unwrap().len(), 2, "{rod}");
    }
    reader.dump().unwrap()
}

#[test]
fn what_people_ask_between_two_replays_is_done_once_and_before_the_next_record() {
    let site = campaign();
    let whole = with_requests(&site, "whole.db", &[&["archive"]]);
    let again = with_requests(
        &site,
        "again.db",
        &[
            &["archive/week-3.mcap"],
            &["archive/week-6.mcap"],
            &["archive"],
            &["archive"],
        ],
    );
    assert_equal_dumps(&whole, &again);
    let alarms = site.history("whole.db", "alarms");
    let drift = alarms.iter().find(|alarm| alarm["kind"] == "drift").unwrap();
    assert_eq!(drift["acknowledged"], noon(48).to_string());
}

#[test]
fn temperatures_after_the_last_record_are_kept() {
    let site = campaign();
    site.replay(&["archive/week-0.mcap"], "site.db");
    let reader = Reader::open(&site.path("site.db")).unwrap();
    for (rod, state) in reader.states().unwrap() {
        // The eighth record was lost, the thermometer went on.
        let (last, latest) = (state.readings.last().unwrap().time, state.latest.unwrap());
        assert_eq!(latest, noon(6), "{rod}");
        assert!(last.seconds_since(latest) > 0.9 * 86_400.0, "{rod}: {last}");
    }
}
