//! Sensors of one rod in `replay` and the daemon: their moments from any packaging, with one that dies, lags or never comes, live and
//! over kills.

use crate::packaging::{DEADLINE, Daemon, assert_same, events, packaged, write};
use crate::site::rods::{rod_with_air, simulated_rod};
use crate::site::*;
use mcap::Message;
use rand::RngExt;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;
use tirante::analysis::signal::record::{Event, RodId, Timestamp};
use tirante::config::Config;
use tirante::recording::read::{self, Recordings, Step};
use tirante::site::store::Reader;

const START: &str = "2026-03-01T00:00:00Z";
/// Time between two records \[s\].
const INTERVAL_S: f64 = 600.0;

/// A rod with two lasers and a thermometer, and one with a single sensor beside it.
fn site(records: usize) -> (Site, Vec<Message<'static>>) {
    let second =
        "[[rod.sensor]]\ntopic = \"/a/2\"\nfield = \"values\"\nunit = \"m\"\nfs_hz = 100.0\nat = 0.15\n";
    let first = rod_with_air("a", 8.0, "/air").replace("[rod.temperature]", "at = 0.4\n[rod.temperature]");
    let site = format!(
        "[site]\nname = \"Two lasers\"\nseed = 5\n[abc]\ndraws = 2000\naccept = {{ quantile = 0.1 }}\n{first}{second}{}\
         \n[track]\nbaseline_records = 8\nlearning_periods = 10\nparticles = 64\nperiod_h = 1.0\n",
        rod_with_air("b", 8.0, "/air")
    );
    let simulation = format!(
        "{site}\n[simulation]\nstart = {START}\nrecords = {records}\ninterval_s = {INTERVAL_S:?}\nrecord_s = 30.0\nfs_hz = 100.0\n\
         samples_per_message = 20\nencoding = \"protobuf\"\n[simulation.climate]\nmean_c = 12.0\nseason_k = 6.0\nday_k = 3.0\n\
         weather_k = 2.0\nbetween_s = 97\n{}{}",
        simulated_rod(
            "a",
            142e3,
            3,
            "[[simulation.rod.further]]\ntopic = \"/a/2\"\nnoise = 0.5e-6\n"
        ),
        simulated_rod("b", 150e3, 3, ""),
    );
    let made = Site::new(&site);
    let bytes = fs::read(made.simulate_as("whole.mcap", &simulation, 3)).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(|message| {
        let message = message.unwrap();
        Message {
            data: message.data.into_owned().into(),
            ..message
        }
    });
    (made, messages.collect())
}

fn seconds(message: &Message<'_>) -> f64 {
    let start = Timestamp::as_written(START).unwrap();
    Timestamp::from_nanos(i64::try_from(message.log_time).unwrap()).seconds_since(start)
}

/// Without the messages of a topic from a time on \[s\].
fn without(messages: &[Message<'static>], topic: &str, from_s: f64) -> Vec<Message<'static>> {
    let stays = |message: &&Message<'static>| message.channel.topic != topic || seconds(message) < from_s;
    messages.iter().filter(stays).cloned().collect()
}

/// Rows of the rod with two sensors, standard error, exit code, and dump of the store.
fn replayed(site: &Site, paths: &[PathBuf], store: &str) -> (Vec<Value>, String, i32, String) {
    let paths: Vec<&str> = paths.iter().map(|path| path.to_str().unwrap()).collect();
    let (output, code) = site.replay(&paths, store);
    let rows = lines(&output.stdout).into_iter().filter(|row| row["rod"] == "a");
    (rows.collect(), text(&output.stderr), code, site.dump(store))
}

fn names(row: &Value, what: &str) -> Vec<String> {
    let listed = row["sensors"][what].as_array().unwrap().iter();
    listed
        .map(|sensor| sensor.as_str().or(sensor["sensor"].as_str()).unwrap().to_owned())
        .collect()
}

#[test]
fn a_replay_gives_what_identify_gives_of_each_moment() {
    let (site, messages) = site(6);
    let (output, code) = site.replay(&["whole.mcap"], "whole.db");
    let (rows, others): (Vec<Value>, Vec<Value>) = lines(&output.stdout)
        .into_iter()
        .partition(|row| row["rod"] == "a");
    assert_eq!((rows.len(), code), (6, 0), "{}", text(&output.stderr));
    // The other rod has one sensor, and its rows say nothing of sensors.
    assert!(others.len() == 6 && others.iter().all(|row| row.get("sensors").is_none()));
    let output = site.run(&["identify", "whole.mcap", "--config", "site.toml", "--json"]);
    let alone = lines(&output.stdout).into_iter().filter(|row| row["rod"] == "a");
    for (row, alone) in rows.iter().zip(alone) {
        assert_eq!(names(row, "used"), ["/a", "/a/2"]);
        assert!(names(row, "left_out").is_empty());
        assert!(row["tested"]["shapes"].as_array().unwrap().len() >= 2, "{row}");
        assert!(row["temperature_c"].is_number());
        for key in [
            "start",
            "modes",
            "axial_force_n",
            "parameters",
            "tested",
            "sensors",
            "seed",
            "temperature_c",
        ] {
            assert_eq!(row[key], alone[key], "{key}");
        }
    }
    // Read again, nothing is new; as one sensor's, the same rod gives other numbers.
    let (rows, ..) = replayed(&site, &[site.path("whole.mcap")], "whole.db");
    assert!(rows.is_empty(), "{rows:?}");
    write(
        &site.path("first.mcap"),
        without(&messages, "/a/2", 0.0).iter(),
        Some(1 << 20),
    );
    let text = fs::read_to_string(site.path("site.toml")).unwrap();
    let (head, tail) = text.split_once("[[rod.sensor]]").unwrap();
    let tail = tail.split_once("[[rod]]").unwrap().1;
    fs::write(
        site.path("site.toml"),
        head.replace("at = 0.4\n", "") + "[[rod]]" + tail,
    )
    .unwrap();
    let (one, said, code, _) = replayed(&site, &[site.path("first.mcap")], "one.db");
    assert_eq!((one.len(), code), (6, 0), "{said}");
    assert!(
        one.iter()
            .all(|row| row.get("sensors").is_none() && row["tested"].is_null())
    );
}

#[test]
fn any_packaging_gives_the_same_moments() {
    let (site, messages) = site(8);
    let config = Config::load(&site.path("site.toml")).unwrap();
    // Whole; one that dies within a record; one that is gone for a while; one that never comes, the first or the second.
    let gone = |message: &&Message<'static>| {
        message.channel.topic != "/a" || !(1000.0..2400.0).contains(&seconds(message))
    };
    let cases = [
        messages.clone(),
        without(&messages, "/a/2", 2.5 * INTERVAL_S),
        without(&messages, "/a/2", 4.0 * INTERVAL_S + 7.0),
        messages.iter().filter(gone).cloned().collect(),
        without(&messages, "/a/2", 0.0),
        without(&messages, "/a", 0.0),
    ];
    for (case, messages) in cases.iter().enumerate() {
        write(&site.path("case.mcap"), messages.iter(), Some(8 << 20));
        let expected = events(&[site.path("case.mcap")], &config);
        let moments = expected
            .iter()
            .filter(|event| event.starts_with("Moment"))
            .count();
        assert!(moments >= 8, "case {case}: {moments}");
        for seed in 0..25 {
            let folder = site.path(&format!("packaged-{seed}"));
            let paths = packaged(&folder, messages, seed);
            let found = events(&paths, &config);
            assert_same(&expected, &found, &format!("case {case}, seed {seed}"));
            fs::remove_dir_all(folder).unwrap();
        }
    }
}

#[test]
fn a_sensor_that_dies_or_never_comes_is_named_and_leaves_the_other() {
    let (site, messages) = site(6);
    let (whole, ..) = replayed(&site, &[site.path("whole.mcap")], "whole.db");
    let cases = [("/a/2", 2.5), ("/a", 2.5), ("/a/2", 0.0), ("/a", 0.0)];
    for (number, (dead, from)) in cases.into_iter().enumerate() {
        let messages = without(&messages, dead, from * INTERVAL_S);
        write(&site.path("case.mcap"), messages.iter(), Some(1 << 20));
        let store = format!("{number}.db");
        let (rows, said, code, dump) = replayed(&site, &[site.path("case.mcap")], &store);
        assert_eq!((rows.len(), code), (6, 3), "{said}");
        let left = if dead == "/a" { "/a/2" } else { "/a" };
        let missing = 6 - from.ceil() as usize;
        for (index, row) in rows.iter().enumerate() {
            if index < 6 - missing {
                assert_eq!(row["axial_force_n"], whole[index]["axial_force_n"], "{index}");
                continue;
            }
            assert_eq!(
                (names(row, "used"), names(row, "left_out")),
                (vec![left.to_owned()], vec![dead.to_owned()])
            );
            assert!(
                row["axial_force_n"].is_object() && row["temperature_c"].is_number(),
                "{row}"
            );
        }
        assert!(
            said.contains(&format!("{missing} records of rod a without {dead}")),
            "{said}"
        );
        assert_eq!(said.matches("warning: rod a").count(), 1, "{said}");
        let status = text(&site.run(&["status", "--store", &store]).stdout);
        assert!(status.contains(&format!("sensor {dead} left out")), "{status}");
        let paths = packaged(
            &site.path(&format!("packaged-{number}")),
            &messages,
            7 + number as u64,
        );
        let (.., again) = replayed(&site, &paths, &format!("again-{number}.db"));
        assert_equal_dumps(&dump, &again);
    }
}

#[test]
fn what_comes_when_its_moment_has_closed_is_refused_by_name() {
    let (site, messages) = site(12);
    // The second sensor's first records come when the first one's tenth is there: more than an hour behind.
    let is_late =
        |message: &&Message<'static>| message.channel.topic == "/a/2" && seconds(message) < 2.5 * INTERVAL_S;
    let late: Vec<Message<'static>> = messages.iter().filter(is_late).cloned().collect();
    let rest = messages.iter().filter(|message| !is_late(message));
    let (before, after): (Vec<_>, Vec<_>) = rest
        .cloned()
        .partition(|message| seconds(message) < 9.5 * INTERVAL_S && message.channel.topic != "/a/2");
    let all = [before, late, after].concat();
    // Without chunks: a file with indices would be read in the order of its times.
    write(&site.path("late.mcap"), all.iter(), None);
    let (rows, said, code, _) = replayed(&site, &[site.path("late.mcap")], "late.db");
    assert_eq!(code, 3, "{said}");
    let refused: Vec<&Value> = rows
        .iter()
        .filter(|row| row["rejection"]["code"] == "late-sensor")
        .collect();
    assert!(refused.len() >= 3, "{said} {rows:?}");
    for row in refused {
        assert_eq!(
            (names(row, "used").len(), names(row, "left_out")),
            (0, vec!["/a/2".to_owned()])
        );
    }
    assert!(said.contains("late-sensor"), "{said}");
}

#[test]
fn every_event_names_the_file_of_its_last_sample() {
    let (site, messages) = site(12);
    let config = Config::load(&site.path("site.toml")).unwrap();
    // The second sensor dies in the first file: what waits for it is complete in the second.
    let messages = without(&messages, "/a/2", 3.0 * INTERVAL_S);
    let split_s = 6.5 * INTERVAL_S;
    for (name, is_second) in [("first.mcap", false), ("second.mcap", true)] {
        let own = messages
            .iter()
            .filter(|message| (seconds(message) >= split_s) == is_second);
        write(&site.path(name), own, Some(1 << 20));
    }
    let start = Timestamp::as_written(START).unwrap();
    let channels = config.rods.iter().map(|rod| rod.channels.clone()).collect();
    let paths = [site.path("first.mcap"), site.path("second.mcap")];
    let files = read::recordings(&paths);
    let (mut seen, mut waited) = (0, 0);
    for step in Recordings::new(files, channels, config.record, false, Arc::default()) {
        let Step::Event(event @ Event::Moment(_), place) = step else {
            continue;
        };
        let Some(begins) = event.record().map(|record| record.start) else {
            continue;
        };
        let expected = match begins.seconds_since(start) < split_s {
            true => "first.mcap",
            false => "second.mcap",
        };
        assert!(place.origin.ends_with(expected), "{begins}: {}", place.origin);
        seen += 1;
        waited += usize::from(place.origin != place.file);
    }
    assert!(seen == 12 && waited >= 3, "{seen} {waited}");
}

/// A file of each sensor, in two runs or in one that cannot read them side by side: a motion has one row.
#[test]
fn files_of_one_sensor_each_never_make_two_rows_of_a_motion() {
    let (site, messages) = site(8);
    for (name, other) in [("first", "/a/2"), ("second", "/a")] {
        let rest = without(&messages, other, 0.0);
        let own = rest
            .iter()
            .filter(|message| name == "first" || message.channel.topic == "/a/2");
        write(&site.path(&format!("{name}.mcap")), own, Some(1 << 20));
    }
    let counted = |rows: &[Value]| {
        let late = rows
            .iter()
            .filter(|row| row["rejection"]["code"] == "late-sensor");
        (rows.len(), late.count())
    };
    let (rows, said, code, _) = replayed(&site, &[site.path("first.mcap")], "two.db");
    assert_eq!((counted(&rows), code), ((8, 0), 3), "{said}");
    let (rows, said, code, _) = replayed(&site, &[site.path("second.mcap")], "two.db");
    assert_eq!((counted(&rows), code), ((8, 8), 3), "{said}");
    assert_eq!(names(&rows[0], "left_out"), ["/a/2"]);
    let listed = text(
        &site
            .run(&["history", "--store", "two.db", "--rod", "a", "--format", "json"])
            .stdout,
    );
    let used = lines(listed.as_bytes())
        .into_iter()
        .filter(|row| row["axial_force_n"].is_object());
    assert_eq!(used.count(), 8);
    // The thermometer is in both: such files are read one after the other.
    for (name, other) in [("c", "/a/2"), ("d", "/a")] {
        let own = without(&messages, other, 0.0);
        let own = own.iter().filter(|message| message.channel.topic != "/b");
        write(&site.path(&format!("{name}.mcap")), own, Some(1 << 20));
    }
    let (rows, said, code, _) = replayed(&site, &[site.path("c.mcap"), site.path("d.mcap")], "one.db");
    assert_eq!((counted(&rows), code), ((16, 8), 3), "{said}");
    assert!(said.contains("8 late-sensor"), "{said}");
}

/// Records in the daemon's store.
fn records(site: &Site) -> u64 {
    let counts = |reader: &Reader| Some(reader.counts(&RodId::from("a")).ok()?.records);
    let reader = Reader::open(&site.path("live.db")).ok();
    reader.as_ref().and_then(counts).unwrap_or(0)
}

/// Rows of a store rod by rod: the daemon does not hold other rods back for one that waits for a sensor.
fn by_rod(site: &Site, store: &str) -> String {
    let rows = |rod| {
        let words = ["history", "--store", store, "--rod", rod, "--format", "json"];
        text(&site.run(&words).stdout)
    };
    rows("a") + &rows("b")
}

/// Starts the daemon and waits until its socket answers.
fn daemon(site: &Site, socket: &Path) -> Daemon {
    let _ = fs::remove_file(socket);
    let mut daemon = Daemon::start(site);
    let until = Instant::now() + DEADLINE;
    while !socket.exists() {
        assert!(Instant::now() < until && daemon.0.try_wait().unwrap().is_none());
        thread::sleep(Duration::from_millis(5));
    }
    daemon
}

#[test]
fn the_daemons_rows_are_those_of_a_replay_of_its_journal_over_kills() {
    let (site, messages) = site(30);
    let socket = site.path("in.sock");
    let address = format!("unix://{}", socket.display());
    let plain = fs::read_to_string(site.path("site.toml")).unwrap();
    let operation = format!(
        "\n[store]\npath = \"live.db\"\n[ingest]\nlisten = [\"{address}\"]\n[journal]\npath = \"journal\"\n[http]\nlisten = \"off\"\n"
    );
    fs::write(site.path("site.toml"), plain + &operation).unwrap();
    // Each sensor by a sender of its own; the second is silent for two hours, and dies.
    let (second, others): (Vec<_>, Vec<_>) = messages
        .into_iter()
        .partition(|message| message.channel.topic == "/a/2");
    let gone = |message: &&Message<'static>| {
        !(6.0 * INTERVAL_S..19.0 * INTERVAL_S).contains(&seconds(message))
            && seconds(message) < 25.0 * INTERVAL_S
    };
    write(
        &site.path("second.mcap"),
        second.iter().filter(gone),
        Some(20_000),
    );
    write(&site.path("others.mcap"), others.iter(), Some(20_000));
    let senders = ["second", "others"].map(|name| {
        let site = site.folder.path().to_owned();
        let words = ["send", "--to", &address, "--speed", "1000", "--sender", name].map(str::to_owned);
        thread::spawn(move || {
            let until = Instant::now() + DEADLINE;
            let mut is_again = false;
            loop {
                let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_tirante"));
                command
                    .current_dir(&site)
                    .args(&words)
                    .arg(format!("{name}.mcap"));
                let output = command.args(is_again.then_some("--resume")).output().unwrap();
                if output.status.success() {
                    return;
                }
                assert!(Instant::now() < until, "{}", text(&output.stderr));
                is_again = true;
                thread::sleep(Duration::from_millis(20));
            }
        })
    });
    let mut generator = random::stream(random::seed(&[b"sensors kill"]), 0);
    let mut daemon = self::daemon(&site, &socket);
    for _ in 0..6 {
        // A record that is killed again and again would be set aside: each has its time.
        let (before, until) = (records(&site), Instant::now() + Duration::from_secs(15));
        while records(&site) == before && Instant::now() < until {
            thread::sleep(Duration::from_millis(10));
        }
        thread::sleep(Duration::from_millis(generator.random_range(0..600)));
        daemon.0.kill().unwrap();
        daemon.0.wait().unwrap();
        daemon = self::daemon(&site, &socket);
    }
    for sender in senders {
        sender.join().unwrap();
    }
    // What the journal holds when nothing comes any more, replayed.
    let until = Instant::now() + DEADLINE;
    let mut before = String::new();
    loop {
        thread::sleep(Duration::from_millis(500));
        let live = by_rod(&site, "live.db");
        if live != std::mem::replace(&mut before, live.clone()) {
            continue;
        }
        let _ = fs::remove_file(site.path("replayed.db"));
        let (rows, said, code, _) = replayed(&site, &[site.path("journal")], "replayed.db");
        let again = by_rod(&site, "replayed.db");
        if live == again {
            assert_eq!(code, 3, "{said}");
            let with = |count: usize| {
                rows.iter()
                    .filter(|row| names(row, "used").len() == count)
                    .count()
            };
            assert!(with(2) >= 1 && with(1) >= 1, "{} {}\n{said}", with(2), with(1));
            return;
        }
        if Instant::now() > until {
            assert_equal_dumps(&again, &live);
        }
    }
}
