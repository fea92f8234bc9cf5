//! `tirante track`: tables of frequencies give the same as the records they came from.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::site::*;
use serde_json::Value;
use std::fmt::Write;
use std::fs;

/// Six weeks of two rods, the last two with a loss of 10 % of north, as `replay --json` gives them, in order of time.
fn replayed() -> (Site, Vec<Value>) {
    let site = Site::new(SITE);
    site.simulate("0", &Part::new(0, 28));
    let loss = "[[simulation.rod.change]]\nstart_d = 0.0\nrelative = -0.10\n";
    site.simulate("1", &Part::new(28, 14).north(loss));
    let (output, code) = site.replay(&["archive/0.mcap", "archive/1.mcap"], "replayed.db");
    assert_eq!(code, 0, "{}", text(&output.stderr));
    let mut records = lines(&output.stdout);
    records.sort_by_key(|record| (record["start"].to_string(), record["rod"].to_string()));
    (site, records)
}

/// The frequencies of records as a table; numbers as the JSON has them, which are exact.
fn table(records: &[Value], with_temperature: bool) -> String {
    let mut text = "time,rod,duration_s,f1_hz,sd1_hz,f2_hz,sd2_hz,f3_hz,sd3_hz,temperature_c\n".to_owned();
    for record in records {
        let plain = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        write!(
            text,
            "{},{},{}",
            plain(&record["start"]),
            plain(&record["rod"]),
            record["duration_s"]
        )
        .unwrap();
        for order in 1..=3 {
            let modes = record["modes"].as_array().unwrap();
            match modes.iter().find(|mode| mode["order"] == order) {
                Some(mode) => write!(text, ",{},{}", mode["frequency_hz"], mode["sd_hz"]).unwrap(),
                None => text += ",,",
            }
        }
        match &record["temperature_c"] {
            celsius if with_temperature => writeln!(text, ",{celsius}").unwrap(),
            _ => text += ",\n",
        }
    }
    text
}

fn track(site: &Site, words: &[&str]) -> (Vec<Value>, String, i32) {
    let output = site.run(&[&["track", "--config", "site.toml", "--json"], words].concat());
    let code = output.status.code().unwrap();
    (lines(&output.stdout), text(&output.stderr), code)
}

fn of<'a>(lines: &'a [Value], rod: &'a str) -> impl Iterator<Item = &'a Value> {
    lines.iter().filter(move |line| line["rod"] == rod)
}

fn raised(lines: &[Value]) -> Vec<String> {
    let events = lines.iter().flat_map(|line| {
        let rod = line["rod"].as_str().unwrap().to_owned();
        let events = line["events"].as_array().unwrap().clone();
        events.into_iter().map(move |event| (rod.clone(), event))
    });
    events
        .filter(|(_, event)| event["what"] == "raised")
        .map(|(rod, event)| format!("{rod} {} {}", event["kind"].as_str().unwrap(), event["time"]))
        .collect()
}

/// Results that depend on frequencies alone are the same numbers as from the samples; temperatures once a
/// record instead of every half hour find the same alarms.
#[test]
fn a_table_of_the_frequencies_is_followed_as_the_records_were() {
    let (site, records) = replayed();
    fs::write(site.path("table.csv"), table(&records, true)).unwrap();
    let (tracked, said, code) = track(&site, &["table.csv"]);
    assert_eq!(code, 0, "{said}");
    assert_eq!(tracked.len(), records.len());
    let mut compared = 0;
    let same = [
        "rod",
        "start",
        "duration_s",
        "relative_force",
        "tracked_force_n",
        "not_axial_p",
        "conflict",
        "set_aside",
    ];
    for (line, record) in tracked.iter().zip(&records) {
        for key in same {
            assert_eq!(line[key], record[key], "{key} of {record}");
        }
        assert!(line["axial_force_n"].is_null() && line["seed"].is_null());
        compared += usize::from(line["relative_force"].is_object());
    }
    assert!(compared > 40, "{compared}");
    for rod in ["north", "south"] {
        let last = |lines| of(lines, rod).last().unwrap()["state"].clone();
        assert_eq!(last(&tracked), last(&records), "{rod}");
    }
    assert_eq!(raised(&tracked), raised(&records));
    assert!(said.contains("drift of north"), "{said}");
}

fn backwards<'a>(rows: &[(usize, &&'a str)]) -> Vec<&'a str> {
    rows.iter().rev().map(|(_, row)| **row).collect()
}

/// Rows split into tables in any way, named in any order; resuming with a store; the same rows twice.
#[test]
fn tables_are_followed_in_the_order_of_time() {
    let (site, records) = replayed();
    let whole = table(&records, true);
    fs::write(site.path("whole.csv"), &whole).unwrap();
    let mut lines = whole.lines();
    let head = lines.next().unwrap();
    let rows: Vec<&str> = lines.collect();
    let part = |name: &str, rows: &[&str]| {
        let text = [&[head], rows].concat().join("\n");
        fs::write(site.path(name), text).unwrap();
    };
    let (even, odd): (Vec<_>, Vec<_>) = rows.iter().enumerate().partition(|(index, _)| index % 2 == 0);
    part("even.csv", &backwards(&even));
    part("odd.csv", &backwards(&odd));
    let (first, second) = rows.split_at(rows.len() / 2);
    part("first.csv", first);
    part("second.csv", second);
    let (at_once, said, code) = track(&site, &["whole.csv", "--store", "whole.db"]);
    assert_eq!(code, 0, "{said}");
    let (shuffled, ..) = track(&site, &["odd.csv", "even.csv"]);
    assert!(shuffled == at_once, "another order of rows, another result");
    let (mut parts, ..) = track(&site, &["first.csv", "--store", "parts.db"]);
    let (again, said, _) = track(&site, &["second.csv", "first.csv", "--store", "parts.db"]);
    parts.extend(again);
    assert!(parts == at_once, "in two runs, another result");
    assert!(said.contains(&format!("{} left out", first.len())), "{said}");
    assert_equal_dumps(&site.dump("parts.db"), &site.dump("whole.db"));
    for words in [
        &["status"][..],
        &["history", "--what", "records"],
        &["report", "--out", "."],
    ] {
        let output = site.run(&[words, &["--store", "whole.db"]].concat());
        assert!(output.status.success(), "{words:?}: {}", text(&output.stderr));
    }
}

/// A thermometer of its own, named by no rod, compensates every rod; without any, the change is reported as
/// not compensated.
#[test]
fn rows_of_temperature_alone_are_of_every_rod() {
    let (site, records) = replayed();
    fs::write(site.path("frequencies.csv"), table(&records, false)).unwrap();
    let mut weather = "time,temperature_c\n".to_owned();
    for record in records.iter().filter(|record| record["rod"] == "north") {
        writeln!(
            weather,
            "{},{}",
            record["start"].as_str().unwrap(),
            record["temperature_c"]
        )
        .unwrap();
    }
    fs::write(site.path("weather.csv"), weather).unwrap();
    let (warm, said, code) = track(&site, &["frequencies.csv", "weather.csv"]);
    assert_eq!(code, 0, "{said}");
    let (cold, ..) = track(&site, &["frequencies.csv"]);
    for rod in ["north", "south"] {
        let last = |lines| of(lines, rod).last().unwrap().clone();
        assert!(last(&warm)["relative_force_at_reference"].is_object(), "{rod}");
        assert!(last(&cold)["relative_force_at_reference"].is_null(), "{rod}");
        // The sudden loss of north is seen without a temperature, too.
        let state = if rod == "north" { "alarm" } else { "not-monitoring" };
        assert_eq!(last(&cold)["state"], state, "{rod}");
    }
    let output = site.run(&["track", "frequencies.csv", "weather.csv", "--config", "site.toml"]);
    let shown = text(&output.stdout);
    assert!(
        shown.contains("ALARM drift of north") && shown.contains("mode 3"),
        "{shown}"
    );
    assert!(
        text(&output.stderr).contains("84 records: 84 followed; "),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn faults_name_file_line_and_column() {
    let site = Site::new(SITE);
    let refused = |name: &str, text: &str| {
        fs::write(site.path(name), text).unwrap();
        let (lines, said, code) = track(&site, &[name]);
        assert!(lines.is_empty());
        (said, code)
    };
    let (said, code) = refused(
        "a.csv",
        "time,rod,f1_hz,sd1_hz\n2026-03-01,north,4.49,0.01\n2026-03-02,north,x,0.01\n",
    );
    assert_eq!(code, 1);
    assert!(
        said.contains("a.csv: line 3, column 3 (f1_hz): \"x\" is not a number"),
        "{said}"
    );
    let (said, code) = refused("b.csv", "time,rod,f1_hz,sd1_hz\n2026-03-01,west,4.49,0.01\n");
    assert_eq!(code, 2);
    assert!(
        said.contains("b.csv: line 2: no rod west is configured: there is north, south"),
        "{said}"
    );
    let (said, code) = refused("c.csv", "time,f1_hz,sd1_hz\n2026-03-01,4.49,0.01\n");
    assert_eq!(code, 2);
    assert!(said.contains("column rod is needed"), "{said}");
    let (said, code) = refused("d.csv", "time,rod,f4_hz,sd4_hz\n2026-03-01,north,4.49,0.01\n");
    assert_eq!(code, 2);
    assert!(said.contains("[modes] count = 4"), "{said}");
    let (_, said, code) = track(&site, &["absent.csv"]);
    assert_eq!(code, 1);
    assert!(said.contains("absent.csv"), "{said}");
    // No rod of the prior has 40 Hz as its first mode.
    fs::write(
        site.path("e.csv"),
        "time,rod,f1_hz,sd1_hz\n2026-03-01,north,40.0,0.01\n",
    )
    .unwrap();
    let (lines, said, code) = track(&site, &["e.csv"]);
    assert_eq!(code, 3, "{said}");
    assert_eq!(lines[0]["rejection"]["code"], "outside-prior");
    assert!(said.contains("1 refused"), "{said}");
}

/// A baseline does not mend what its records are doubted for: the mark stands wherever the force does.
#[test]
fn a_baseline_of_doubtful_records_keeps_the_mark() {
    let site = Site::new(SITE);
    fs::write(site.path("table.csv"), doubtful_table()).unwrap();
    let (tracked, said, code) = track(&site, &["table.csv", "--store", "site.db"]);
    assert_eq!(code, 0, "{said}");
    let last = tracked.last().unwrap();
    assert!(
        last["prior_tail"].as_f64().unwrap() <= 0.01 && last["tracked_force_n"].is_object(),
        "{last}"
    );
    let shown = |words: &[&str]| {
        let output = site.run(words);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let status = shown(&["status", "--store", "site.db", "--rod", "north"]);
    let row = status.lines().find(|line| line.starts_with("north")).unwrap();
    assert!(row.contains("  ! "), "{status}");
    assert!(
        status.contains("hardly any rod of the prior has these"),
        "{status}"
    );
    assert!(!status.contains("of the latest record alone"), "{status}");

    let history = shown(&["history", "--store", "site.db"]);
    let marked = history.lines().filter(|line| line.contains("! ")).count();
    let with_force = tracked.iter().filter(|line| line["tracked_force_n"].is_object());
    assert_eq!(marked, with_force.count(), "{history}");
}
