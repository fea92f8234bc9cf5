//! Recordings in the watched folder that are cut anywhere: the rows of the whole one, found finished, over kills, and while they grow.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::packaging::{DEADLINE, Daemon, packaged, recorded, replayed, write};
use crate::site::*;
use mcap::Message;
use rand::RngExt;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;
use tirante::site::store::Reader;

/// A site whose configuration names a folder to watch, its messages, and what a replay of them all gives.
fn watched(join_s: f64) -> (Site, Vec<Message<'static>>, String) {
    let (site, messages) = recorded(24, 12.0);
    let expected = watch(&site, join_s);
    (site, messages, expected)
}

/// Has the configuration of a site name a folder to watch; what a replay of its recording gives.
fn watch(site: &Site, join_s: f64) -> String {
    let operation = format!(
        "\n[store]\npath = \"live.db\"\n[ingest]\nfolder = \"in\"\njoin_s = {join_s:?}\n[http]\nlisten = \"off\"\n"
    );
    let plain = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(site.path("site.toml"), plain + &operation).unwrap();
    fs::create_dir(site.path("in")).unwrap();
    replayed(site, &[site.path("whole.mcap")], "whole.db").1
}

/// Writes the messages as consecutive files cut at any messages, one of them within a record.
fn cut(folder: &Path, messages: &[Message<'static>], seed: u64) -> Vec<PathBuf> {
    let mut rng = random::stream(seed, 2);
    let mut cuts: Vec<usize> = (0..5).map(|_| rng.random_range(1..messages.len())).collect();
    cuts.extend([0, messages.len()]);
    cuts.sort_unstable();
    cuts.dedup();
    let write_one = |(number, pair): (usize, &[usize])| {
        // Their names are in another order than their times.
        let path = folder.join(format!("{}.mcap", 9 - number));
        write(&path, messages[pair[0]..pair[1]].iter(), Some(20_000));
        path
    };
    cuts.windows(2).enumerate().map(write_one).collect()
}

/// Waits until the daemon's store has the expected rows.
fn wait_for_rows(site: &Site, expected: &str, what: &str) {
    let until = Instant::now() + DEADLINE;
    let mut live = String::new();
    while live != expected {
        if Instant::now() > until {
            eprintln!("{what}");
            assert_equal_dumps(expected, &live);
        }
        thread::sleep(Duration::from_millis(100));
        live = Reader::open(&site.path("live.db"))
            .map_or_else(|_| String::new(), |reader| reader.dump().unwrap());
    }
}

fn open_samples(site: &Site) -> usize {
    let store = Reader::open(&site.path("live.db")).unwrap();
    store.carries("folder/").unwrap().len()
}

#[test]
fn files_cut_anywhere_give_the_rows_of_the_whole() {
    let (site, messages, expected) = watched(1.0);
    for seed in 0..3 {
        cut(&site.path("in"), &messages, seed);
        let daemon = Daemon::start(&site);
        wait_for_rows(&site, &expected, &format!("seed {seed}"));
        // The last samples have waited in vain, and nothing of them is kept.
        let until = Instant::now() + DEADLINE;
        while open_samples(&site) > 0 {
            assert!(Instant::now() < until);
            thread::sleep(Duration::from_millis(100));
        }
        drop(daemon);
        fs::remove_dir_all(site.path("in")).unwrap();
        fs::create_dir(site.path("in")).unwrap();
        forget(&site);
    }
}

/// Files of a few messages each, as a sensor that sends them makes: some within a record, some with temperatures alone.
#[test]
fn files_of_a_few_messages_give_the_rows_of_the_whole() {
    let (site, messages, expected) = watched(1.0);
    for (number, piece) in messages.chunks(6).enumerate() {
        let path = site.path("in").join(format!("{number:04}.mcap"));
        write(&path, piece.iter(), Some(20_000));
    }
    let _daemon = Daemon::start(&site);
    wait_for_rows(&site, &expected, "six messages a file");
}

/// A thermometer that writes files of its own: each comes long after the samples that it is for, or long before them.
#[test]
fn readings_in_files_of_their_own_are_those_of_their_records() {
    let (site, messages) = recorded(9, 12.0);
    let is_reading = |message: &Message<'_>| message.channel.topic == "/air";
    // Behind the last samples readings go on.
    let last = messages.iter().filter(|message| !is_reading(message));
    let last = last.map(|message| message.log_time).max().unwrap();
    let mut messages = messages;
    let minute = 60_000_000_000;
    let reading = messages
        .iter()
        .rfind(|message| is_reading(message))
        .unwrap()
        .clone();
    let behind = [1, 2].map(|minutes| Message {
        log_time: last + minutes * minute,
        publish_time: last + minutes * minute,
        ..reading.clone()
    });
    messages.extend(behind);
    write(&site.path("whole.mcap"), messages.iter(), Some(20_000));
    watch(&site, 0.2);
    // The slow temperature has means of the readings up to each record in a replay, of all of a file here.
    let records = |store: &str| {
        let one = |line: &Value| {
            ["rod", "start", "rejection", "temperature_c", "relative_force"].map(|key| line[key].to_string())
        };
        site.history(store, "records")
            .iter()
            .map(one)
            .collect::<BTreeSet<_>>()
    };
    let expected = records("whole.db");
    let is_used = |record: &&[String; 5]| record[2] == "null";
    assert!(
        expected.iter().filter(is_used).all(|record| record[3] != "null"),
        "{expected:?}"
    );
    let start = messages.iter().map(|message| message.log_time).min().unwrap();
    // Three records a file, of all rods, and the first three after their readings: nothing had come of the thermometer before.
    let part = |message: &Message<'_>| ((message.log_time - start) / (175 * minute)).min(2);
    for readings_first in [[true, false, false], [true, true, true]] {
        let daemon = Daemon::start(&site);
        for (number, readings_first) in (0..).zip(readings_first) {
            for readings in [readings_first, !readings_first] {
                let name = format!("{number}-{readings}.mcap");
                let mine = messages
                    .iter()
                    .filter(|message| part(message) == number && is_reading(message) == readings);
                write(&site.path(&name), mine, Some(20_000));
                fs::rename(site.path(&name), site.path("in").join(&name)).unwrap();
                // Longer than the daemon waits for samples that go on.
                thread::sleep(Duration::from_secs(3));
            }
        }
        let until = Instant::now() + DEADLINE;
        while records("live.db") != expected {
            assert!(Instant::now() < until, "{:?}\n{expected:?}", records("live.db"));
            thread::sleep(Duration::from_millis(100));
        }
        fs::remove_dir_all(site.path("in")).unwrap();
        fs::create_dir(site.path("in")).unwrap();
        drop(daemon);
        forget(&site);
    }
}

/// A file whose samples begin before another's end goes on with nothing of it, not with the first temperature behind it either.
#[test]
fn a_file_that_overlaps_another_keeps_its_samples() {
    let (site, messages, _) = watched(1.0);
    let start = messages.iter().map(|message| message.log_time).min().unwrap();
    let second = |message: &Message<'_>| (message.log_time - start) as f64 * 1e-9 - 4.0 * 3600.0;
    let paths = ["1.mcap", "2.mcap"].map(|name| site.path("in").join(name));
    let until = messages.iter().filter(|message| second(message) < 6.0);
    write(&paths[0], until, Some(20_000));
    let from = messages.iter().filter(|message| second(message) >= 1.5);
    write(&paths[1], from, Some(20_000));
    replayed(&site, &paths, "both.db");
    let _daemon = Daemon::start(&site);
    // The temperatures of the overlap are there twice, and count as they come.
    let records = |store: &str| {
        let lines = site.history(store, "records");
        let one = |line: &Value| {
            format!(
                "{} {} {} {}",
                line["rod"], line["start"], line["duration_s"], line["rejection"]
            )
        };
        lines.iter().map(one).collect::<BTreeSet<_>>()
    };
    let expected = records("both.db");
    assert!(
        expected.iter().any(|record| record.contains(":01.6")),
        "{expected:?}"
    );
    let until = Instant::now() + DEADLINE;
    while !site.path("live.db").exists() || records("live.db") != expected {
        assert!(Instant::now() < until, "{:?}\n{expected:?}", records("live.db"));
        thread::sleep(Duration::from_millis(100));
    }
}

/// Removes what a daemon kept.
fn forget(site: &Site) {
    for entry in fs::read_dir(site.path(".")).unwrap() {
        let path = entry.unwrap().path();
        if path
            .file_name()
            .is_some_and(|name| name.to_string_lossy().starts_with("live.db"))
        {
            fs::remove_file(&path).unwrap();
        }
    }
}

#[test]
fn files_by_topics_and_times_give_the_rows_of_the_whole() {
    in_any_packaging(0..3);
}

#[test]
#[ignore = "a campaign of some ten minutes"]
fn a_hundred_packagings_give_the_rows_of_the_whole() {
    in_any_packaging(100..200);
}

fn in_any_packaging(seeds: std::ops::Range<u64>) {
    let (site, messages, expected) = watched(1.0);
    for seed in seeds {
        fs::remove_dir_all(site.path("in")).unwrap();
        packaged(&site.path("in"), &messages, seed);
        let daemon = Daemon::start(&site);
        wait_for_rows(&site, &expected, &format!("seed {seed}"));
        drop(daemon);
        forget(&site);
    }
}

#[test]
fn kills_between_files_and_within_lose_no_open_sample() {
    let (site, messages, expected) = watched(20.0);
    let mut rng = random::stream(7, 3);
    let paths = cut(&site.path("in"), &messages, 7);
    // They come one by one, whole, over kills at any moment.
    let away = paths.iter().map(|path| (path.with_extension("away"), path));
    let away: Vec<_> = away.collect();
    away.iter()
        .for_each(|(away, path)| fs::rename(path, away).unwrap());
    for (away, path) in &away {
        fs::rename(away, path).unwrap();
        for _ in 0..3 {
            let daemon = Daemon::start(&site);
            thread::sleep(Duration::from_millis(rng.random_range(50..1500)));
            drop(daemon);
        }
    }
    let _daemon = Daemon::start(&site);
    wait_for_rows(&site, &expected, "at the end");
}

#[test]
fn growing_files_go_on_where_the_last_one_ended() {
    let (site, messages, expected) = watched(10.0);
    let whole = site.path("away");
    fs::create_dir(&whole).unwrap();
    let paths = cut(&whole, &messages, 11);
    let _daemon = Daemon::start(&site);
    for path in &paths {
        let bytes = fs::read(path).unwrap();
        let mut file = File::create(site.path("in").join(path.file_name().unwrap())).unwrap();
        // Longer than between two looks into the folder: it is seen while it grows.
        for piece in bytes.chunks(bytes.len().div_ceil(12)) {
            file.write_all(piece).unwrap();
            thread::sleep(Duration::from_millis(200));
        }
    }
    wait_for_rows(&site, &expected, "at the end");
}
