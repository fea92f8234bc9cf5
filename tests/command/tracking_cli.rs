//! Months of simulated recordings through the whole program: cases that must alarm, with the right name, and
//! cases that must never look like drift.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::site::*;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Four weeks of two healthy rods: baseline and charts.
fn healthy() -> Site {
    let site = Site::new(SITE);
    site.simulate("0", &Part::new(0, 28));
    site
}

/// Replays file after file in order of arrival, whatever the clock; returns the alarms as `rod kind`. (One
/// replay of a whole archive sorts its files by their clocks.)
fn alarms(site: &Site) -> Vec<String> {
    for index in 0..fs::read_dir(site.path("archive")).unwrap().count() {
        let (output, code) = site.replay(&[&format!("archive/{index}.mcap")], "site.db");
        assert!(matches!(code, 0 | 3), "{}", text(&output.stderr));
    }
    site.alarms("site.db")
}

/// Reasons why records of a rod from a day on were set aside.
fn set_aside(site: &Site, rod: &str, from_day: i64) -> BTreeSet<String> {
    site.history("site.db", "records")
        .iter()
        .filter(|line| {
            line["rod"] == rod && line["start"].as_str().unwrap() >= noon(from_day).to_string().as_str()
        })
        .map(|line| line["set_aside"].as_str().unwrap_or("none").to_owned())
        .collect()
}

fn only(what: &str) -> BTreeSet<String> {
    BTreeSet::from([what.to_owned()])
}

fn none_drifts(alarms: &[String]) {
    assert!(
        !alarms
            .iter()
            .any(|alarm| alarm.ends_with(" drift") || alarm.ends_with(" limit")),
        "{alarms:?}"
    );
}

#[test]
fn the_shipped_campaign_ends_in_one_drift_alarm_and_no_other() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let site = Site::new(&fs::read_to_string(root.join("config/campaign.toml")).unwrap());
    let recording = root.join("recordings/campaign-2025.mcap");
    let (output, code) = site.replay(&[recording.to_str().unwrap()], "site.db");
    assert_eq!(code, 0, "{}", text(&output.stderr));
    let alarms = site.history("site.db", "alarms");
    assert_eq!(site.alarms("site.db"), ["nave-3 drift"]);
    assert_eq!(alarms[0]["stands"], true);
    // The loss begins on 30 May and reaches 4 % three months later: 1 % after 24 days.
    let raised = alarms[0]["raised"].as_str().unwrap();
    assert!(("2025-06-01".."2025-06-24").contains(&raised), "{raised}");
}

#[test]
fn healthy_rods_raise_nothing() {
    let site = healthy();
    site.simulate("1", &Part::new(28, 28));
    assert_eq!(alarms(&site), [""; 0]);
}

fn swapped(site: &str) -> String {
    site.replace("\"/north\"", "\"/x\"")
        .replace("\"/south\"", "\"/north\"")
        .replace("\"/x\"", "\"/south\"")
}

#[test]
fn swapped_channels_are_a_trouble_of_the_sensor() {
    let site = healthy();
    site.simulate("1", &Part::new(28, 14).wired(swapped));
    let alarms = alarms(&site);
    none_drifts(&alarms);
    assert!(
        ["north sensor", "south sensor"]
            .iter()
            .all(|named| alarms.iter().any(|alarm| alarm == named)),
        "{alarms:?}"
    );
    // One channel alone may have a rod that changed: the first record of the exchange is taken back when the other channel shows it, too.
    for rod in ["north", "south"] {
        assert_eq!(set_aside(&site, rod, 29), only("channel"));
    }
}

#[test]
fn swapped_channels_that_are_mended_leave_no_trace() {
    let site = healthy();
    site.simulate("1", &Part::new(28, 10).wired(swapped));
    site.simulate("2", &Part::new(38, 14));
    none_drifts(&alarms(&site));
    // The first channel that shows its own rod again waits for the other one to do so.
    for rod in ["north", "south"] {
        assert_eq!(set_aside(&site, rod, 39), only("none"));
    }
    assert!(
        site.history("site.db", "alarms")
            .iter()
            .all(|alarm| alarm["stands"] == false)
    );
}

#[test]
fn another_unit_is_a_trouble_of_the_sensor() {
    let site = healthy();
    let metres = "[[simulation.rod.fault]]\nkind = \"scaled\"\nfactor = 1000.0\n";
    site.simulate("1", &Part::new(28, 14).north(metres));
    assert_eq!(alarms(&site), ["north sensor"]);
    assert_eq!(set_aside(&site, "north", 28), only("amplitude"));
    assert_eq!(set_aside(&site, "south", 28), only("none"));
    // None is rejected, and yet none counts: the status says how many.
    let status = |words: &[&str]| {
        site.run(&[&["status", "--store", "site.db"], words].concat())
            .stdout
    };
    let rows = lines(&status(&["--format", "json"]));
    let counts = |rod: usize| ["records", "rejected", "set_aside"].map(|count| rows[rod][count].as_i64());
    assert_eq!(counts(0), [42, 0, 14].map(Some));
    assert_eq!(counts(1), [42, 0, 0].map(Some));
    let table = text(&status(&[]))
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ");
    assert!(
        table.contains("42 records, 0.0 % rejected, 14 set aside"),
        "{table}"
    );
}

/// Days from the first noon of the campaign to 1970 and to 2100.
const DAY_OF_1970: i64 = -20_454;
const DAY_OF_2100: i64 = 27_028;

#[test]
fn a_clock_set_to_1970_is_a_trouble_of_the_sensor() {
    let site = healthy();
    site.simulate("1", &Part::new(DAY_OF_1970, 10));
    site.simulate("2", &Part::new(38, 14));
    let alarms = alarms(&site);
    none_drifts(&alarms);
    let sensors = alarms.iter().filter(|alarm| alarm.ends_with(" sensor")).count();
    assert_eq!(sensors, 2, "{alarms:?}");
    let early = set_aside(&site, "north", DAY_OF_1970);
    assert!(early.contains("late"), "{early:?}");
    assert_eq!(set_aside(&site, "north", 38), only("none"));
    assert!(
        site.history("site.db", "alarms")
            .iter()
            .all(|alarm| alarm["stands"] == false)
    );
}

#[test]
fn a_clock_that_jumps_to_2100_is_a_trouble_of_the_sensor() {
    let site = healthy();
    site.simulate("1", &Part::new(DAY_OF_2100, 2));
    site.simulate("2", &Part::new(30, 14));
    assert_eq!(alarms(&site), [""; 0]);
    assert_eq!(set_aside(&site, "north", DAY_OF_2100), only("clock"));
    let back: BTreeSet<String> = site
        .history("site.db", "records")
        .iter()
        .filter(|line| line["start"].as_str().unwrap() >= noon(30).to_string().as_str())
        .filter(|line| line["start"].as_str().unwrap() < "2100")
        .map(|line: &Value| line["set_aside"].as_str().unwrap_or("none").to_owned())
        .collect();
    assert_eq!(back, only("none"));
}

#[test]
fn a_clock_that_stays_in_2100_raises_no_drift() {
    let site = healthy();
    site.simulate("1", &Part::new(DAY_OF_2100, 20));
    let alarms = alarms(&site);
    none_drifts(&alarms);
    assert!(alarms.contains(&"north sensor".to_owned()), "{alarms:?}");
}

#[test]
fn a_mass_at_mid_span_is_not_axial_and_no_drift() {
    let site = healthy();
    let mass = "[simulation.rod.added_mass]\nmass_kg = 1.0\nat = 0.5\nstart_d = 0.0\n";
    site.simulate("1", &Part::new(28, 14).south(mass));
    let alarms = alarms(&site);
    none_drifts(&alarms);
    assert_eq!(alarms, ["south not-axial"]);
}

#[test]
fn the_frequencies_of_the_paper_conflict() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = fs::read_to_string(root.join("config/todi.toml")).unwrap();
    let config = config.replace(
        "[simulation]\n",
        "[simulation]\nrecords = 6\ninterval_s = 86_400.0\n",
    );
    let site = Site::new(&config);
    let output = site.run(&["simulate", "--config", "site.toml", "--out", "pulls.mcap"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let (output, code) = site.replay(&["pulls.mcap"], "site.db");
    assert_eq!(code, 0, "{}", text(&output.stderr));
    assert_eq!(site.alarms("site.db"), ["todi conflict"]);
}
