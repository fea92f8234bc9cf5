//! A recording that crashes the program whenever it is read, by lack of memory.

use super::campaign::{Campaign, Material, RODS, huge, tirante};
use super::process::{DEADLINE, Process};
use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::signal::record::{Timestamp, Unit};
use tirante::recording::write::{ChannelSpec, Encoding, Layout, Precision, RecordingWriter, WriterOptions};
use tirante::site::store::Reader;

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
    let mut daemon = loop {
        let mut daemon = Process::with(campaign.folder.path(), &["prlimit", &limit], &VARIABLES);
        let goes_on = daemon.becomes(|log| log.contains("later.mcap is read"));
        if goes_on {
            break daemon;
        }
        assert!(!daemon.wait().success(), "{}", daemon.log());
        deaths += 1;
        assert!(deaths <= 4, "{}", daemon.log());
    };
    // One that blames no step and one alone for reading it, and as many for analysing the data read before, whose first may be the same:
    // both are at work then. A process of its own dies of it then.
    assert!((2..=4).contains(&deaths), "{deaths} deaths: {}", daemon.log());
    assert!(daemon.log().contains("quarantined"), "{}", daemon.log());
    assert!(
        daemon.log().contains("a process of its own ended by SIGABRT"),
        "{}",
        daemon.log()
    );
    let outcomes = |words: &[&str]| -> Vec<(String, String)> {
        let words = [&["files", "--store", "state/site.db", "--format", "json"], words].concat();
        let listed = String::from_utf8(tirante(campaign.folder.path(), &words).stdout).unwrap();
        let files = listed
            .lines()
            .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
        let word = |file: &serde_json::Value, key: &str| file[key].as_str().unwrap().to_owned();
        files
            .map(|file| (word(&file, "file"), word(&file, "outcome")))
            .collect()
    };
    assert_eq!(
        outcomes(&["later"]),
        [("later.mcap".to_owned(), "done".to_owned())]
    );
    let losses = outcomes(&["--losses"]);
    daemon.wait_until("nothing goes on with the last record", |_| {
        let reader = Reader::open(&campaign.path("state/site.db"));
        reader.is_ok_and(|reader| reader.carries("folder/").is_ok_and(|open| open.is_empty()))
    });
    let is_lost = ("huge.mcap".to_owned(), "quarantined".to_owned());
    let store = rusqlite::Connection::open(campaign.path("state/site.db")).unwrap();
    let count = |of: &str| -> usize {
        let sql = format!("SELECT count(*) FROM record WHERE {of}");
        let count: i64 = store.query_row(&sql, (), |row| row.get(0)).unwrap();
        usize::try_from(count).unwrap()
    };
    // Where reading goes through it is the record that is set aside.
    let of_record = count("rejection = 'quarantined'");
    assert!(losses.contains(&is_lost) || of_record > 0, "{losses:?}");
    assert_eq!(count("rod = 'north' AND rejection IS NULL"), material.days + 2);
    daemon.stop("-TERM");
}

/// Step of the first record of a rod, by its identity in the dump of a store.
fn first_record(made: &BTreeMap<String, String>, rod: &str) -> String {
    let first = made[rod].lines().find(|line| line.starts_with("record\t"));
    let (_, rest) = first.unwrap().split_once("identity=Blob([").unwrap();
    let bytes = rest.split_once("])").unwrap().0.split(", ");
    let identity: String = bytes
        .map(|byte| format!("{:02x}", byte.parse::<u8>().unwrap()))
        .collect();
    format!("record {identity} of rod {rod}")
}

/// Stops the process in which the daemon tries a step, as soon as it runs the program: one stopped before would hold the daemon, which
/// waits for it to begin.
fn stopped_trial(daemon: &mut Process) -> u32 {
    let tasks = format!("/proc/{}/task", daemon.pid());
    let is_trial = |pid: &u32| {
        let arguments = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        arguments.split(|byte| *byte == 0).nth(1) == Some(b"trial".as_slice())
    };
    let mut child = None;
    daemon.wait_until("a step is tried", |_| {
        let children = fs::read_dir(&tasks).into_iter().flatten().filter_map(|task| {
            let children = fs::read_to_string(task.ok()?.path().join("children")).ok()?;
            children.split_whitespace().next()?.parse::<u32>().ok()
        });
        child = child.or(children.filter(is_trial).last());
        child.is_some()
    });
    let child = child.unwrap();
    signal(child, "-STOP");
    child
}

fn signal(pid: u32, name: &str) {
    let told = Command::new("kill").args([name, &pid.to_string()]).status();
    assert!(told.unwrap().success());
}

#[test]
fn beside_a_trial_the_daemon_ticks_and_stops_and_an_end_there_is_one_of_the_step() {
    let material = Material::short();
    let campaign = Campaign::new(material, "");
    let step = first_record(material.undisturbed(), "north");
    let list = campaign.path("state/site.db.suspects");
    fs::write(&list, format!("{{\"{step}\": 1}}")).unwrap();
    let ends = || {
        let list: serde_json::Value = serde_json::from_slice(&fs::read(&list).unwrap()).unwrap();
        let of_step = &list[&step];
        of_step["alone"].as_u64().or(of_step.as_u64())
    };
    let mut feed = campaign.feed();
    feed.offer(1.0);
    let mut daemon = campaign.start(&[]);
    stopped_trial(&mut daemon);
    // A tick finds that the store is gone, and that it is back.
    let (store, away) = (campaign.path("state/site.db"), campaign.path("state/away"));
    fs::rename(&store, &away).unwrap();
    daemon.wait_until("it is missed", |log| log.contains("while it was written"));
    fs::rename(&away, &store).unwrap();
    daemon.signal("-TERM");
    assert_eq!(daemon.wait().code(), Some(0), "{}", daemon.log());
    assert!(!daemon.log().contains("still analysed"), "{}", daemon.log());
    assert_eq!(ends(), Some(1));

    let mut daemon = campaign.start(&[]);
    let child = stopped_trial(&mut daemon);
    daemon.signal("-KILL");
    daemon.wait();
    // Without the daemon it leaves.
    signal(child, "-CONT");
    let mut daemon = campaign.start(&[]);
    daemon.wait_until("it is ready", |log| log.contains("ready"));
    assert_eq!(ends(), Some(2));
    let until = Instant::now() + DEADLINE;
    while fs::read_to_string(format!("/proc/{child}/stat")).is_ok_and(|stat| !stat.contains(") Z ")) {
        assert!(Instant::now() < until, "the child stays");
        thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn what_was_only_killed_from_outside_is_tried_apart_and_cleared() {
    let material = Material::short();
    let campaign = Campaign::new(material, "");
    let made = material.undisturbed();
    // A record of every rod, a file and a part of the journal, each as if the daemon had ended at it alone.
    let mut suspects: BTreeMap<String, u32> = RODS.iter().map(|rod| (first_record(made, rod), 1)).collect();
    for file in ["north-000.mcap", "journal/journal.000001.mcap"] {
        suspects.insert(format!("file {file}"), 1);
        suspects.insert(format!("{file}@0+0"), 1);
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
