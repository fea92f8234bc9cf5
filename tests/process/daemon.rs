//! The daemon as a process: the same store as a replay, whatever happens to it.
//!
//! A few kills in the tests; more with `KILLS=200 cargo test --test process daemon::`.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::site::*;
use rand::RngExt;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;
use tirante::analysis::signal::record::RodId;
use tirante::site::store::Reader;

/// Sections of the daemon's configuration besides the site: no fixed port, so that daemons run side by side.
const OPERATION: &str =
    "\n[store]\npath = \"site.db\"\n[ingest]\nfolder = \"archive\"\n[http]\nlisten = \"off\"\n";
/// Longest wait on a busy machine.
const DEADLINE: Duration = Duration::from_secs(120);

/// A daemon, ended when it is dropped.
struct Daemon {
    child: Child,
    log: PathBuf,
}

impl Daemon {
    fn start(site: &Site, more: &[&str]) -> Self {
        let words = [&["run", "--config", "site.toml"], more].concat();
        Self::spawn(site, &mut site.command(&words))
    }

    fn spawn(site: &Site, command: &mut Command) -> Self {
        let log = site.path("daemon.log");
        let child = command
            .env("TIRANTE_LOG", "info")
            .stdout(Stdio::null())
            .stderr(File::create(&log).unwrap())
            .process_group(0)
            .spawn()
            .unwrap();
        Self { child, log }
    }

    /// A daemon that has opened its store.
    fn ready(site: &Site, more: &[&str]) -> Self {
        let mut daemon = Self::start(site, more);
        daemon.wait_for("ready");
        daemon
    }

    fn log(&self) -> String {
        fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Waits for a word in the log.
    fn wait_for(&mut self, word: &str) {
        let until = Instant::now() + DEADLINE;
        while !self.log().contains(word) {
            assert!(Instant::now() < until, "no {word} in the log:\n{}", self.log());
            let ended = self.child.try_wait().unwrap();
            assert!(ended.is_none(), "ended before {word}:\n{}", self.log());
            thread::sleep(Duration::from_millis(5));
        }
    }

    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(
            Command::new("kill")
                .args([name, &pid])
                .status()
                .unwrap()
                .success()
        );
    }

    fn wait(&mut self) -> ExitStatus {
        let until = Instant::now() + DEADLINE;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < until, "does not end:\n{}", self.log());
            thread::sleep(Duration::from_millis(2));
        }
    }

    /// SIGTERM: ends with 0 within five seconds.
    fn stop(mut self) {
        self.signal("-TERM");
        let begun = Instant::now();
        let status = self.wait();
        assert_eq!(status.code(), Some(0), "{}", self.log());
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            // The whole group: otherwise the program under strace would outlive it.
            let group = format!("-{}", self.child.id());
            let _ = Command::new("kill").args(["-KILL", "--", &group]).status();
            let _ = self.child.wait();
        }
    }
}

/// The campaign of two rods, its configuration fit for a daemon.
fn daemon_site() -> Site {
    let site = crate::site::campaign();
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(site.path("site.toml"), config + OPERATION).unwrap();
    site
}

/// Waits until the store meets a condition.
fn wait_until(site: &Site, what: &str, is_so: impl FnMut(&Reader) -> bool) {
    wait_until_in(&site.path("site.db"), what, is_so);
}

fn wait_until_in(store: &Path, what: &str, mut is_so: impl FnMut(&Reader) -> bool) {
    let until = Instant::now() + DEADLINE;
    // Before the daemon has made it, there is no store.
    while !Reader::open(store).is_ok_and(|reader| is_so(&reader)) {
        assert!(Instant::now() < until, "not so: {what}");
        thread::sleep(Duration::from_millis(20));
    }
}

fn wait_for_files(site: &Site, count: usize) {
    wait_for_files_in(&site.path("site.db"), count);
}

fn wait_for_files_in(store: &Path, count: usize) {
    wait_until_in(
        store,
        "all files are read, and nothing goes on with the last",
        |reader| {
            let is_read = reader.files().is_ok_and(|files| files.len() == count);
            is_read && reader.carries("folder/").is_ok_and(|open| open.is_empty())
        },
    );
}

fn records(reader: &Reader) -> i64 {
    let rods = reader.rods().unwrap_or_default();
    let counts = rods.iter().filter_map(|rod| reader.counts(rod).ok());
    counts.map(|counts| counts.records as i64).sum()
}

/// The dump of an undisturbed replay.
fn replayed(site: &Site) -> String {
    let (output, code) = site.replay(&["archive"], "replayed.db");
    assert_eq!(code, 3, "{}", text(&output.stderr));
    site.dump("replayed.db")
}

fn remove_store(site: &Site) {
    for suffix in ["", "-wal", "-shm", ".lock", ".working", ".suspects"] {
        let _ = fs::remove_file(site.path(&format!("site.db{suffix}")));
    }
}

#[test]
fn the_daemons_store_is_a_replays_at_any_number_of_threads() {
    let site = daemon_site();
    let whole = replayed(&site);
    for threads in ["1", "2"] {
        let daemon = Daemon::ready(&site, &["--threads", threads]);
        wait_for_files(&site, 7);
        daemon.stop();
        assert_equal_dumps(&whole, &site.dump("site.db"));
        assert_eq!(fs::metadata(site.path("site.db.working")).unwrap().len(), 0);
        remove_store(&site);
    }
}

#[test]
fn killed_again_and_again_it_ends_in_the_same_store() {
    let kills: usize = std::env::var("KILLS").map_or(10, |text| text.parse().unwrap());
    let site = daemon_site();
    let whole = replayed(&site);
    let all = records(&Reader::open(&site.path("replayed.db")).unwrap());
    for (stream, threads) in ["1", "2"].into_iter().enumerate() {
        let mut generator = random::stream(random::seed(&[b"daemon kill"]), stream as u64);
        let mut cut_off = 0;
        for kill in 0..kills {
            let mut daemon = Daemon::start(&site, &["--threads", threads]);
            if kill >= 2 {
                // Some records later; the first ones while the store is being made.
                let before = Reader::open(&site.path("site.db")).map_or(0, |reader| records(&reader));
                let wanted = (before + generator.random_range(0..=2 * all / kills as i64)).min(all);
                wait_until(&site, "records come", |reader| records(reader) >= wanted);
            }
            thread::sleep(Duration::from_micros(generator.random_range(0..60_000)));
            cut_off += usize::from(daemon.child.try_wait().unwrap().is_none());
            daemon.child.kill().unwrap();
            daemon.wait();
        }
        assert!(2 * cut_off > kills, "only {cut_off} of {kills} were cut off");
        let daemon = Daemon::ready(&site, &["--threads", threads]);
        wait_for_files(&site, 7);
        daemon.stop();
        assert_equal_dumps(&whole, &site.dump("site.db"));
        assert!(!fs::exists(site.path("site.db.corrupt-1")).unwrap());
        remove_store(&site);
    }
}

#[test]
fn told_to_stop_it_ends_in_time_and_goes_on_later() {
    let site = daemon_site();
    let whole = replayed(&site);
    for (count, signal) in [(0, "-TERM"), (3, "-INT"), (40, "-TERM"), (80, "-TERM")] {
        let mut daemon = Daemon::start(&site, &["--threads", "2"]);
        if count > 0 {
            wait_until(&site, "records come", |reader| records(reader) >= count);
        } else {
            // Signals are handled from the first output on.
            daemon.wait_for("preparing");
        }
        daemon.signal(signal);
        let begun = Instant::now();
        assert_eq!(daemon.wait().code(), Some(0), "{}", daemon.log());
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    }
    let daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 7);
    daemon.stop();
    assert_equal_dumps(&whole, &site.dump("site.db"));
}

#[test]
fn a_bad_configuration_is_refused_before_the_store_is_opened() {
    let site = Site::new(&(SITE.replace("length_m = 8.0", "length_m = -8.0") + OPERATION));
    let begun = Instant::now();
    let output = site.run(&["run", "--config", "site.toml"]);
    assert!(begun.elapsed() < Duration::from_secs(1), "{:?}", begun.elapsed());
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("site.toml: 2 faults"), "{said}");
    assert!(said.contains("site.toml:8:"), "{said}");
    assert!(!site.path("site.db").exists() && !site.path("site.db.lock").exists());

    let site = Site::new(SITE);
    let output = site.run(&["run", "--config", "site.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("[store]"),
        "{}",
        text(&output.stderr)
    );
    let output = site.run(&["run"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn a_second_instance_is_refused_and_told_who_holds_the_store() {
    let site = Site::new(&(SITE.to_owned() + OPERATION));
    fs::create_dir(site.path("archive")).unwrap();
    let daemon = Daemon::ready(&site, &[]);
    let second = site.run(&["run", "--config", "site.toml"]);
    let said = text(&second.stderr);
    assert_eq!(second.status.code(), Some(1), "{said}");
    assert!(said.contains(&format!("process {}", daemon.child.id())), "{said}");
    daemon.stop();
}

#[test]
fn a_reload_takes_a_good_configuration_and_keeps_the_old_one_for_a_bad() {
    let site = daemon_site();
    fs::create_dir(site.path("later")).unwrap();
    for week in 2..7 {
        let name = format!("week-{week}.mcap");
        fs::rename(
            site.path(&format!("archive/{name}")),
            site.path(&format!("later/{name}")),
        )
        .unwrap();
    }
    let good = fs::read_to_string(site.path("site.toml")).unwrap();
    let mut daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 2);

    fs::write(
        site.path("site.toml"),
        good.replace("learning_periods = 14", "learning_periods = -14") + "[typo]\n",
    )
    .unwrap();
    daemon.signal("-HUP");
    daemon.wait_for("the old one holds");
    let log = daemon.log();
    assert!(log.contains("learning_periods") && log.contains("typo"), "{log}");

    // The rods' numbers keep their meaning, so their segments continue; the site is new to the store.
    fs::write(
        site.path("site.toml"),
        good.replace("Two rods", "The two rods") + "[alarm]\nlimit_loss = 0.2\n",
    )
    .unwrap();
    daemon.signal("-HUP");
    daemon.wait_for(" holds\n");
    for week in 2..7 {
        let name = format!("week-{week}.mcap");
        fs::rename(
            site.path(&format!("later/{name}")),
            site.path(&format!("archive/{name}")),
        )
        .unwrap();
        wait_for_files(&site, week + 1);
    }
    daemon.stop();
    let reader = Reader::open(&site.path("site.db")).unwrap();
    assert_eq!(reader.configs().unwrap().len(), 2);
    for rod in ["north", "south"] {
        assert_eq!(reader.segments(&RodId(rod.to_owned())).unwrap().len(), 1);
    }
    // A loss of 10 % exceeds no limit of 20 %.
    assert_eq!(site.alarms("site.db"), ["north drift"]);
}

/// Settings that would drop a baseline are refused, at a reload and at a start, with the reason. They are
/// accepted if the baseline is given up by name, and when the old settings come back, so does the baseline.
#[test]
fn a_baseline_is_not_dropped_unasked_and_comes_back_with_its_settings() {
    let site = daemon_site();
    let good = fs::read_to_string(site.path("site.toml")).unwrap();
    let other = good.replacen("mean = 150e3", "mean = 151e3", 1);
    let mut daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 7);
    let segments = |rod: &str| {
        let reader = Reader::open(&site.path("site.db")).unwrap();
        reader.segments(&RodId(rod.to_owned())).unwrap().len()
    };
    let state = || Reader::open(&site.path("site.db")).unwrap().states().unwrap();
    let learned = state()[&RodId("north".to_owned())].clone();
    assert!(learned.segment.baseline.is_some());

    // What changes no number opens no segment: where samples stand, sinks, names.
    let elsewhere = good.replace("topic = \"/north\"", "topic = \"/nave/north\"");
    fs::write(site.path("site.toml"), elsewhere + "[alert]\nsettle_s = 5\n").unwrap();
    daemon.signal("-HUP");
    daemon.wait_for(" holds\n");
    fs::write(site.path("site.toml"), &other).unwrap();
    let check = site.run(&["check", "site.toml", "--against", "site.db"]);
    let said = text(&check.stdout);
    assert_eq!(check.status.code(), Some(3), "{said}");
    assert!(said.contains("rod north: the baseline would be lost"), "{said}");
    assert!(
        said.contains("rod.priors.axial_force_n: { mean = 150000") && said.contains("mean = 151000"),
        "{said}"
    );
    assert!(said.contains("rod south: the baseline stays"), "{said}");
    daemon.signal("-HUP");
    daemon.wait_for(
        "would drop a baseline, the old one holds: rod north (rod.priors.axial_force_n: { mean = 150000",
    );
    daemon.stop();
    assert_eq!((segments("north"), segments("south")), (1, 1));
    let refused = site.run(&["run", "--config", "site.toml"]);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    assert!(
        text(&refused.stderr).contains("--accept-new-baseline"),
        "{}",
        text(&refused.stderr)
    );
    let (output, code) = site.replay(&["archive"], "site.db");
    assert_eq!(code, 2, "{}", text(&output.stderr));

    let daemon = Daemon::ready(&site, &["--accept-new-baseline", "north"]);
    daemon.stop();
    assert_eq!((segments("north"), segments("south")), (2, 1));
    assert!(state()[&RodId("north".to_owned())].segment.baseline.is_none());
    fs::write(site.path("site.toml"), &good).unwrap();
    let check = site.run(&["check", "site.toml", "--against", "site.db"]);
    assert!(
        text(&check.stdout).contains("the baseline of segment 1 goes on"),
        "{}",
        text(&check.stdout)
    );
    Daemon::ready(&site, &[]).stop();
    let back = state()[&RodId("north".to_owned())].clone();
    assert_eq!(back.segment, learned.segment);
    assert_eq!(
        (&back.watch, &back.periods, back.latest),
        (&learned.watch, &learned.periods, learned.latest)
    );
    assert_eq!(segments("north"), 2, "no third one");
    // One that is asked for now is the third: numbers are not used twice.
    let asked = site.run(&["rebaseline", "--config", "site.toml", "north"]);
    assert!(asked.status.success(), "{}", text(&asked.stderr));
    let daemon = Daemon::ready(&site, &[]);
    wait_until(&site, "it is applied", |reader| {
        reader.rods_asked().is_ok_and(|rods| rods.is_empty())
    });
    daemon.stop();
    assert_eq!(state()[&RodId("north".to_owned())].segment.number, 3);
}

/// A new name is refused as the loss of a baseline that it is; a rod that is taken out is told, shown as not monitored by whoever
/// reads the store, and goes on when it is back.
#[test]
fn a_rod_that_is_renamed_or_taken_out_is_told() {
    let site = daemon_site();
    let good = fs::read_to_string(site.path("site.toml")).unwrap();
    let mut daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 7);
    let standing = |rod: &str| {
        let output = site.run(&["status", "--store", "site.db", "--format", "json"]);
        let rods: Vec<Value> = text(&output.stdout)
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        let rod = rods.iter().find(|status| status["rod"] == rod).unwrap();
        (rod["state"].clone(), rod["state_reason"].clone())
    };
    let before = standing("north");

    fs::write(
        site.path("site.toml"),
        good.replacen("id = \"north\"", "id = \"North\"", 1),
    )
    .unwrap();
    let check = site.run(&["check", "site.toml", "--against", "site.db"]);
    let said = text(&check.stdout);
    assert_eq!(check.status.code(), Some(3), "{said}");
    assert!(
        said.contains("rod north: the baseline would be lost") && said.contains("the new rod North"),
        "{said}"
    );
    daemon.signal("-HUP");
    daemon.wait_for("would drop a baseline, the old one holds");
    assert_eq!(standing("north"), before);

    let (at, next) = (good.find("[[rod]]").unwrap(), good.rfind("[[rod]]").unwrap());
    fs::write(site.path("site.toml"), good[..at].to_owned() + &good[next..]).unwrap();
    let check = site.run(&["check", "site.toml", "--against", "site.db"]);
    let said = text(&check.stdout);
    assert_eq!(check.status.code(), Some(0), "{said}");
    assert!(
        said.contains("rod north: the configuration has no such rod"),
        "{said}"
    );
    daemon.signal("-HUP");
    daemon.wait_for("north is not in the configuration any more");
    let (state, reason) = standing("north");
    assert_eq!(state, "not-monitoring");
    assert!(
        reason.as_str().unwrap().contains("not in the configuration"),
        "{reason}"
    );

    fs::write(site.path("site.toml"), &good).unwrap();
    daemon.signal("-HUP");
    wait_until(&site, "it is followed again", |reader| {
        reader.unfollowed().is_ok_and(|rods| rods.is_empty())
    });
    assert_ne!(standing("north").0, "not-monitoring");
    daemon.stop();
}

#[test]
fn what_people_ask_is_done_while_it_runs() {
    let site = daemon_site();
    let daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 7);
    let asked = site.run(&["ack", "--config", "site.toml", "--all"]);
    assert!(asked.status.success(), "{}", text(&asked.stderr));
    let asked = site.run(&["rebaseline", "--config", "site.toml", "south"]);
    assert!(asked.status.success(), "{}", text(&asked.stderr));
    let begun = Instant::now();
    wait_until(&site, "requests are applied", |reader| {
        reader.rods_asked().is_ok_and(|rods| rods.is_empty())
    });
    assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
    daemon.stop();
    assert!(
        site.history("site.db", "alarms")
            .iter()
            .all(|alarm| !alarm["acknowledged"].is_null() || !alarm["cleared"].is_null())
    );
    let reader = Reader::open(&site.path("site.db")).unwrap();
    assert_eq!(reader.segments(&RodId("south".to_owned())).unwrap().len(), 2);
}

#[test]
fn the_clock_finds_silence_and_a_replay_finds_the_same_alarm() {
    let site = Site::new(SITE);
    let now = jiff::Timestamp::now().as_second();
    let today = (now - noon(0).as_nanos() / 1_000_000_000) / 86_400;
    // The last record is eight to nine days old; records a day, so three days of silence are too many.
    site.simulate("early", &Part::new(today - 20, 12));
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(site.path("site.toml"), config.clone() + OPERATION).unwrap();
    let daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 1);
    daemon.stop();
    assert!(
        site.history("site.db", "alarms").is_empty(),
        "it listens since a moment ago only"
    );

    let daemon = Daemon::ready(&site, &[]);
    wait_until(&site, "alarms are raised", |reader| {
        reader
            .alarms(&Default::default())
            .is_ok_and(|alarms| alarms.len() == 2)
    });
    let of_clock = site.history("site.db", "alarms");
    assert!(
        of_clock.iter().all(|alarm| alarm["kind"] == "no-data"),
        "{of_clock:?}"
    );

    // Data again: the alarm is over, and a replay of everything finds one of the same id.
    fs::write(site.path("site.toml"), &config).unwrap();
    site.simulate("late", &Part::new(today - 4, 3));
    fs::write(site.path("site.toml"), config + OPERATION).unwrap();
    wait_until(&site, "alarms are over", |reader| {
        reader
            .alarms(&Default::default())
            .is_ok_and(|alarms| alarms.iter().all(|alarm| alarm.is_over()))
    });
    wait_for_files(&site, 2);
    daemon.stop();
    site.replay(&["archive"], "replayed.db");
    let ids = |store: &str| -> Vec<String> {
        let alarms = site.history(store, "alarms");
        alarms
            .iter()
            .map(|alarm| format!("{} {} {}", alarm["id"], alarm["raised"], alarm["message"]))
            .collect()
    };
    assert_eq!(ids("site.db"), ids("replayed.db"));
}

#[test]
fn a_record_the_program_dies_of_whatever_is_tried_is_set_aside_and_the_rest_goes_on() {
    let site = daemon_site();
    replayed(&site);
    let store = rusqlite::Connection::open(site.path("replayed.db")).unwrap();
    let sql =
        "SELECT rod, lower(hex(identity)) FROM record WHERE rejection IS NULL ORDER BY id LIMIT 1 OFFSET 20";
    let (rod, identity): (String, String) = store
        .query_row(sql, (), |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap();
    let offered: i64 = store
        .query_row("SELECT count(*) FROM record", (), |row| row.get(0))
        .unwrap();
    let step = format!("record {identity} of rod {rod}");
    let memory = serde_json::to_vec(&BTreeMap::from([(step, 4)])).unwrap();
    fs::write(site.path("site.db.suspects"), memory).unwrap();
    let mut daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 7);
    daemon.wait_for("quarantined");
    daemon.stop();
    let rejections = site.history("site.db", "rejections");
    let set_aside: Vec<_> = rejections
        .iter()
        .filter(|line| line["rejection"]["code"] == "quarantined")
        .collect();
    assert_eq!(set_aside.len(), 1);
    assert_eq!(set_aside[0]["rod"], rod.as_str());
    assert_eq!(
        records(&Reader::open(&site.path("site.db")).unwrap()),
        offered,
        "one row per record"
    );
}

#[test]
fn a_damaged_store_is_moved_aside_and_everything_is_read_again() {
    let site = daemon_site();
    let daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 7);
    daemon.stop();
    let whole = site.dump("site.db");
    let length = fs::metadata(site.path("site.db")).unwrap().len();
    fs::write(site.path("site.db"), vec![0; usize::try_from(length).unwrap()]).unwrap();
    let daemon = Daemon::ready(&site, &[]);
    assert!(daemon.log().contains("damaged"), "{}", daemon.log());
    wait_for_files(&site, 7);
    daemon.stop();
    assert!(site.path("site.db.corrupt-1").exists());
    assert_equal_dumps(&whole, &site.dump("site.db"));
}

#[test]
fn old_lines_go_and_nothing_else_does() {
    let site = daemon_site();
    let daemon = Daemon::ready(&site, &["--set", "store.keep_lines_d=7"]);
    wait_for_files(&site, 7);
    let store = rusqlite::Connection::open(site.path("site.db")).unwrap();
    store.busy_timeout(Duration::from_secs(20)).unwrap();
    let count = |sql: &str| -> i64 { store.query_row(sql, (), |row| row.get(0)).unwrap() };
    let old = "SELECT count(*) FROM line JOIN record ON record.id = line.record WHERE start_ns <
        (SELECT max(start_ns) FROM record AS other WHERE other.rod = record.rod AND rejection IS NULL) - 7 * 86400000000000";
    let until = Instant::now() + DEADLINE;
    while count(old) > 0 {
        assert!(Instant::now() < until, "{} are still there", count(old));
        thread::sleep(Duration::from_millis(20));
    }
    let records = count("SELECT count(*) FROM record");
    assert!(count("SELECT count(*) FROM line") >= 2 * 7 && records > 100);
    daemon.stop();
    let status = site.run(&["status", "--config", "site.toml"]);
    assert!(status.status.success(), "{}", text(&status.stderr));
    // The same data again is known still.
    let (_, code) = site.replay(&["archive"], "site.db");
    assert_eq!(code, 0);
    assert_eq!(count("SELECT count(*) FROM record"), records);
}

/// A small file system of its own, gone when it is dropped.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts one; `None` where that is not allowed.
    fn mount(path: PathBuf, megabytes: usize) -> Option<Self> {
        fs::create_dir(&path).unwrap();
        let size = format!("size={megabytes}m");
        let mount = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &size, "tmpfs"])
            .arg(&path)
            .output();
        if mount.is_ok_and(|output| output.status.success()) {
            return Some(Self(path));
        }
        eprintln!("skipped: no file system can be mounted here");
        None
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

#[test]
fn a_full_disk_is_waited_for_and_nothing_is_lost() {
    let site = daemon_site();
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(
        site.path("site.toml"),
        config.replace("\"site.db\"", "\"small/site.db\""),
    )
    .unwrap();
    let whole = replayed(&site);
    let Some(_disk) = SmallDisk::mount(site.path("small"), 32) else {
        return;
    };
    let fill = |free_kilobytes: usize| {
        fs::write(
            site.path("small/ballast"),
            vec![1; (32 << 20) - (free_kilobytes << 10)],
        )
        .unwrap();
    };
    for free_kilobytes in [16, 700, 1500] {
        fill(free_kilobytes);
        let mut daemon = Daemon::start(&site, &["--threads", "2"]);
        daemon.wait_for("no room on the disk");
        if free_kilobytes == 700 {
            // It can be stopped while it waits.
            daemon.stop();
            daemon = Daemon::start(&site, &["--threads", "2"]);
        }
        fs::remove_file(site.path("small/ballast")).unwrap();
        daemon.wait_for("week-6.mcap is read");
        wait_for_files_in(&site.path("small/site.db"), 7);
        daemon.stop();
        assert_equal_dumps(&whole, &site.dump("small/site.db"));
        // This process read the store, and keeps its file open: without its content, it takes no room.
        File::options()
            .write(true)
            .open(site.path("small/site.db"))
            .and_then(|file| file.set_len(0))
            .unwrap();
        for suffix in ["", "-wal", "-shm"] {
            let _ = fs::remove_file(site.path(&format!("small/site.db{suffix}")));
        }
    }
}

#[test]
fn a_failed_write_or_flush_ends_the_daemon_and_nothing_is_lost() {
    if Command::new("strace").arg("-V").output().is_err() {
        eprintln!("skipped: no strace");
        return;
    }
    let site = daemon_site();
    let whole = replayed(&site);
    // Few enough calls that each round leaves records for the next one to write. Four in a row: SQLite keeps the failure of some to
    // itself, by what shares a commit.
    for (calls, number) in [("fsync,fdatasync", 25), ("pwrite64", 30), ("fsync,fdatasync", 3)] {
        let mut strace = Command::new("strace");
        strace
            .current_dir(site.folder.path())
            .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
            .args(["-f", "-o", "/dev/null", "-e"])
            .args([
                &format!("trace={calls}"),
                "-e",
                &format!("inject={calls}:error=EIO:when={number}..{}", number + 3),
            ])
            .args([env!("CARGO_BIN_EXE_tirante"), "run", "--config", "site.toml"]);
        let mut daemon = Daemon::spawn(&site, &mut strace);
        assert_eq!(daemon.wait().code(), Some(1), "{calls}: {}", daemon.log());
        assert!(daemon.log().contains("site.db"), "{calls}: {}", daemon.log());
    }
    let daemon = Daemon::ready(&site, &[]);
    wait_for_files(&site, 7);
    daemon.stop();
    assert_equal_dumps(&whole, &site.dump("site.db"));
}
