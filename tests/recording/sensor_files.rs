//! Sensors of one rod in a file each, as loggers of their own write them: one motion, or a refusal that says what is missing.

use crate::site::rods::{rod, simulated_rod};
use crate::site::*;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;

const START: &str = "2026-03-01T00:00:00Z";
const RECORDS: usize = 4;

/// Samples of a sensor by their time [ns since 1970].
type Samples = BTreeMap<u64, f64>;

/// A rod with two lasers, and what each of them measured.
fn lasers() -> (Site, [Samples; 2]) {
    let first = rod("a", 8.0, "values", 100.0) + "at = 0.4\n";
    let second =
        "[[rod.sensor]]\ntopic = \"/a/2\"\nfield = \"values\"\nunit = \"m\"\nfs_hz = 100.0\nat = 0.15\n";
    let config = format!(
        "[site]\nname = \"Two loggers\"\nseed = 5\n[abc]\ndraws = 2000\naccept = {{ quantile = 0.1 }}\n{first}{second}"
    );
    let simulation = format!(
        "{config}\n[simulation]\nstart = {START}\nrecords = {RECORDS}\ninterval_s = 600.0\nrecord_s = 30.0\nfs_hz = 100.0\n\
         samples_per_message = 20\nencoding = \"json\"\n{}",
        simulated_rod(
            "a",
            142e3,
            3,
            "[[simulation.rod.further]]\ntopic = \"/a/2\"\nnoise = 0.5e-6\n"
        )
    );
    let site = Site::new(&config);
    let bytes = fs::read(site.simulate_as("whole.mcap", &simulation, 3)).unwrap();
    let mut found = [Samples::new(), Samples::new()];
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let told: Value = serde_json::from_slice(&message.data).unwrap();
        let samples = &mut found[usize::from(message.channel.topic == "/a/2")];
        for (time, value) in (message.log_time..)
            .step_by(10_000_000)
            .zip(told["values"].as_array().unwrap())
        {
            samples.insert(time, value.as_f64().unwrap());
        }
    }
    (site, found)
}

/// Writes columns with stamps from `origin` on [ns since 1970].
fn csv(site: &Site, name: &str, columns: &[(&str, &Samples)], origin: u64) {
    let names: Vec<&str> = columns.iter().map(|column| column.0).collect();
    let mut lines = format!("time,{}\n", names.join(","));
    for time in columns[0].1.keys() {
        let values: Vec<String> = columns
            .iter()
            .map(|(_, samples)| samples[time].to_string())
            .collect();
        lines += &format!("{:.2},{}\n", (time - origin) as f64 * 1e-9, values.join(","));
    }
    fs::write(site.path(name), lines).unwrap();
}

/// Rows of a replay or of `identify`, standard error and exit code.
fn rows(site: &Site, command: &str, files: &[&str]) -> (Vec<Value>, String, i32) {
    let words = [&[command], files, &["--config", "site.toml", "--json"]].concat();
    let output = site.run(&words);
    (
        lines(&output.stdout),
        text(&output.stderr),
        output.status.code().unwrap(),
    )
}

#[test]
fn two_files_of_one_sensor_each_are_the_one_with_both() {
    let (site, [one, two]) = lasers();
    csv(&site, "both.csv", &[("/a", &one), ("/a/2", &two)], 0);
    csv(&site, "one.csv", &[("/a", &one)], 0);
    csv(&site, "two.csv", &[("/a/2", &two)], 0);
    for command in ["replay", "identify"] {
        let (expected, said, code) = rows(&site, command, &["both.csv"]);
        assert_eq!((expected.len(), code), (RECORDS, 0), "{said}");
        for row in &expected {
            assert_eq!(row["sensors"]["used"], serde_json::json!(["/a", "/a/2"]));
        }
        for files in [["one.csv", "two.csv"], ["two.csv", "one.csv"]] {
            let (found, said, code) = rows(&site, command, &files);
            assert_eq!((&found, code), (&expected, 0), "{command} {files:?}: {said}");
        }
    }
}

#[test]
fn a_file_that_ends_early_leaves_the_other() {
    let (site, [one, two]) = lasers();
    let end = two.keys().next().unwrap() + 700_000_000_000;
    let short: Samples = two.range(..end).map(|(time, value)| (*time, *value)).collect();
    csv(&site, "one.csv", &[("/a", &one)], 0);
    csv(&site, "short.csv", &[("/a/2", &short)], 0);
    let (found, said, code) = rows(&site, "replay", &["short.csv", "one.csv"]);
    assert_eq!((found.len(), code), (RECORDS, 3), "{said}");
    for (number, row) in found.iter().enumerate() {
        let used = row["sensors"]["used"].as_array().unwrap().len();
        assert_eq!(used, if number < 2 { 2 } else { 1 }, "{row}");
        assert!(row["axial_force_n"].is_object(), "{row}");
    }
    // Another rate cannot be joined: named, and the other sensor gives the result.
    let half: Samples = two
        .iter()
        .step_by(2)
        .map(|(time, value)| (*time, *value))
        .collect();
    let slow = fs::read_to_string(site.path("site.toml")).unwrap();
    let (head, tail) = slow.split_once("[[rod.sensor]]").unwrap();
    fs::write(
        site.path("site.toml"),
        format!("{head}[[rod.sensor]]{}", tail.replace("fs_hz = 100.0\n", "")),
    )
    .unwrap();
    csv(&site, "half.csv", &[("/a/2", &half)], 0);
    let (found, said, code) = rows(&site, "replay", &["one.csv", "half.csv"]);
    assert_eq!((found.len(), code), (RECORDS, 3), "{said}");
    for row in &found {
        let left_out = &row["sensors"]["left_out"][0];
        assert_eq!(left_out["sensor"], "/a/2");
        assert!(left_out["why"].as_str().unwrap().contains("Hz"), "{left_out}");
    }
}

#[test]
fn what_no_file_says_is_asked_for_by_name() {
    let (site, [one, two]) = lasers();
    let origin = *one.keys().next().unwrap();
    csv(&site, "one.csv", &[("/a", &one)], origin);
    csv(&site, "two.csv", &[("/a/2", &two)], origin);
    for command in ["replay", "identify"] {
        let (found, said, code) = rows(&site, command, &["one.csv", "two.csv"]);
        assert!(found.is_empty() && code != 0, "{said}");
        assert_eq!(said.matches("does not say when").count(), 2, "{said}");
    }
    // A file whose column does not name its sensor: the end of its own name does, or nothing.
    csv(&site, "monday-a.csv", &[("laser", &one)], 0);
    csv(&site, "monday_A_2.csv", &[("laser", &two)], 0);
    csv(&site, "monday.csv", &[("laser", &two)], 0);
    csv(&site, "both.csv", &[("/a", &one), ("/a/2", &two)], 0);
    let (expected, ..) = rows(&site, "replay", &["both.csv"]);
    let (found, said, code) = rows(&site, "replay", &["monday-a.csv", "monday_A_2.csv"]);
    assert_eq!((found, code), (expected, 0), "{said}");
    let (found, said, code) = rows(&site, "replay", &["monday.csv"]);
    assert!(found.is_empty() && code != 0, "{said}");
    assert!(
        said.contains("several sensors") && said.contains("/a, /a/2"),
        "{said}"
    );
}
