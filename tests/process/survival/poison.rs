//! A recording that crashes the program whenever it is read, by lack of memory.

use super::campaign::{Campaign, Material, RODS, huge};
use super::process::Process;
use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use tirante::analysis::signal::record::{Timestamp, Unit};
use tirante::recording::write::{ChannelSpec, Encoding, Layout, Precision, RecordingWriter, WriterOptions};

/// Memory limit above that of a daemon with harmless input \[kB\].
const MORE_KB: u64 = 24 << 10;
/// One malloc arena, so that address space follows memory use.
const VARIABLES: [(&str, &str); 1] = [("MALLOC_ARENA_MAX", "1")];

/// Peak address space of a process so far \[kB\].
fn peak_kb(pid: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmPeak:"))
        .unwrap();
    line.trim_end_matches("kB").trim().parse().unwrap()
}

#[test]
fn a_recording_the_program_dies_of_is_set_aside_and_the_rest_goes_on() {
    let material = Material::short();
    let campaign = Campaign::new(material, "[record]\nmax_duration_s = 43_200\n");
    let mut feed = campaign.feed();
    feed.offer(1.0);
    let mut daemon = Process::with(campaign.folder.path(), &[], &VARIABLES);
    let all = material.days * RODS.len();
    daemon.wait_until("everything is in", |_| {
        feed.is_done() && campaign.records() >= all
    });
    let limit = format!("--as={}", (peak_kb(daemon.pid()) + MORE_KB) << 10);
    daemon.stop("-TERM");

    fs::write(campaign.path("coming"), huge()).unwrap();
    fs::rename(campaign.path("coming"), campaign.path("archive/huge.mcap")).unwrap();
    // Later days of the rod "north", read after it.
    fs::write(campaign.path("coming"), &Material::long().data.files[3]).unwrap();
    fs::rename(campaign.path("coming"), campaign.path("archive/later.mcap")).unwrap();
    let mut deaths = 0;
    let daemon = loop {
        let mut daemon = Process::with(campaign.folder.path(), &["prlimit", &limit], &VARIABLES);
        let goes_on = daemon.becomes(|log| log.contains("later.mcap is read"));
        if goes_on {
            break daemon;
        }
        assert!(!daemon.wait().success(), "{}", daemon.log());
        deaths += 1;
        assert!(deaths <= 4, "{}", daemon.log());
    };
    // One that blames no step and one alone for reading it, and as many for analysing the data read before; then a process of
    // its own dies of it.
    assert!(deaths == 2 || deaths == 4, "{deaths} deaths: {}", daemon.log());
    assert!(daemon.log().contains("quarantined"), "{}", daemon.log());
    assert!(
        daemon.log().contains("a process of its own ended by SIGABRT"),
        "{}",
        daemon.log()
    );
    let store = rusqlite::Connection::open(campaign.path("state/site.db")).unwrap();
    let sql = "SELECT count(*) FROM record WHERE rod = 'north' AND rejection IS NULL";
    let north: i64 = store.query_row(sql, (), |row| row.get(0)).unwrap();
    assert_eq!(usize::try_from(north).unwrap(), material.days + 2);
    daemon.stop("-TERM");
}

#[test]
fn what_was_only_killed_from_outside_is_tried_apart_and_cleared() {
    let material = Material::short();
    let campaign = Campaign::new(material, "");
    let made = material.undisturbed();
    // A record of every rod, a file and a part of the journal, each as if the daemon had ended at it alone, twice.
    let identity = |rod: &str| {
        let first = made[rod].lines().find(|line| line.starts_with("record\t"));
        let (_, rest) = first.unwrap().split_once("identity=Blob([").unwrap();
        let bytes = rest.split_once("])").unwrap().0.split(", ");
        bytes
            .map(|byte| format!("{:02x}", byte.parse::<u8>().unwrap()))
            .collect::<String>()
    };
    let mut suspects: BTreeMap<String, u32> = RODS
        .iter()
        .map(|rod| (format!("record {} of rod {rod}", identity(rod)), 2))
        .collect();
    for file in ["north-000.mcap", "journal/journal.000001.mcap"] {
        suspects.insert(format!("file {file}"), 2);
        suspects.insert(format!("{file}@0+0"), 2);
    }
    let memory = campaign.path("state/site.db.suspects");
    fs::write(&memory, serde_json::to_vec(&suspects).unwrap()).unwrap();
    let mut feed = campaign.feed();
    let mut daemon = campaign.start(&[]);
    feed.offer(1.0);
    let all = material.days * RODS.len();
    daemon.wait_until("everything is in", |_| {
        feed.is_done() && campaign.records() >= all
    });
    let cleared = daemon
        .log()
        .matches("a process of its own took that step")
        .count();
    assert_eq!(cleared, suspects.len() - 2, "{}", daemon.log());
    assert!(!daemon.log().contains("quarantined"), "{}", daemon.log());
    campaign.finish_with(&mut feed, daemon);
    campaign.check("cleared", false);
}

/// An hour of the rod `east` at 400 Hz, a message a sample: its stretch grows by doubling, and closing it takes several times as much.
fn growing_stretch() -> Vec<u8> {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
    let spec = ChannelSpec {
        topic: "/east".to_owned(),
        encoding: Encoding::Json,
        layout: Layout::Sample,
        precision: Precision::Double,
        unit: Unit::Metre,
    };
    let id = writer.add_channel(spec).unwrap();
    let start = Timestamp::from_nanos(1_767_268_800_000_000_000);
    let values: Vec<f64> = (0..1_400_000).map(|i| f64::from(i % 1000) * 1e-6).collect();
    writer.write_samples(id, start, 400.0, &values).unwrap();
    // The rods of the campaign read `values`.
    writer.finish().unwrap().into_inner()
}

#[test]
fn a_recording_that_is_deadly_before_its_bad_place_too_does_not_keep_the_daemon_down() {
    let material = Material::short();
    let campaign = Campaign::new(material, "[record]\nmax_duration_s = 43_200\n");
    let config = fs::read_to_string(campaign.path("site.toml")).unwrap();
    let east = "topic = \"/east\"\nfield = \"values\"\nunit = \"m\"\nfs_hz = 100.0";
    assert!(config.contains(east));
    let config = config.replace(east, "topic = \"/east\"\nfield = \"value\"\nunit = \"m\"");
    fs::write(campaign.path("site.toml"), config).unwrap();
    let mut feed = campaign.feed();
    feed.offer(1.0);
    let mut daemon = Process::with(campaign.folder.path(), &[], &VARIABLES);
    // The rod `east` reads another field here: three rods have records.
    let all = material.days * (RODS.len() - 1);
    daemon.wait_until("everything is in", |_| campaign.records() >= all);
    let limit = format!("--as={}", (peak_kb(daemon.pid()) + MORE_KB) << 10);
    daemon.stop("-TERM");

    for (name, bytes) in [
        ("stretch", growing_stretch()),
        ("later", Material::long().data.files[3].clone()),
    ] {
        fs::write(campaign.path("coming"), bytes).unwrap();
        let to = campaign.path(&format!("archive/{name}.mcap"));
        fs::rename(campaign.path("coming"), to).unwrap();
    }
    let (mut deaths, mut logs) = (0, String::new());
    let daemon = loop {
        let mut daemon = Process::with(campaign.folder.path(), &["prlimit", &limit], &VARIABLES);
        let goes_on = daemon.becomes(|log| log.contains("later.mcap is read"));
        logs.push_str(&daemon.log());
        if goes_on {
            break daemon;
        }
        assert!(!daemon.wait().success(), "{}", daemon.log());
        deaths += 1;
        // Near its limit the daemon dies at one place or another, and a child, whose threads reserve less, may pass them: the count
        // decides in the end, before systemd gives up (`StartLimitBurst=15`).
        assert!(deaths <= 10, "{logs}");
    };
    println!("{deaths} deaths");
    assert!(
        deaths >= 2 && logs.contains("stretch.mcap") && logs.contains("set aside"),
        "{deaths}: {logs}"
    );
    daemon.stop("-TERM");
}
