//! kill -9 during a replay, then the same command again, ends in the store of an undisturbed run.
//!
//! A dozen kills in the tests; more with `KILLS=200 cargo test --test site kill::`.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::site::*;
use rand::RngExt;
use std::fs;
use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::thread;
use std::time::Duration;
use tirante::analysis::numerics::random;

/// Kills `kills` replays, each at another point, then lets one finish.
fn killed(site: &Site, store: &str, threads: &str, kills: usize, stream: u64) -> i32 {
    let mut generator = random::stream(random::seed(&[b"kill"]), stream);
    let words = [
        "replay",
        "archive",
        "--config",
        "site.toml",
        "--json",
        "--store",
        store,
        "--threads",
        threads,
    ];
    let mut cut_off = 0;
    for kill in 0..kills {
        let mut child = site
            .command(&words)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // The first ones while the store is being made, the others some records later.
        let records = if kill < 3 {
            0
        } else {
            generator.random_range(0..=2 * 112 / kills)
        };
        let pause = if kill < 3 {
            generator.random_range(0..60_000)
        } else {
            generator.random_range(0..10_000)
        };
        let mut printed = BufReader::new(child.stdout.take().unwrap()).lines();
        for _ in 0..records {
            if printed.next().is_none() {
                break;
            }
        }
        thread::sleep(Duration::from_micros(pause));
        cut_off += usize::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
    }
    assert!(
        2 * cut_off > kills,
        "only {cut_off} of {kills} replays were cut off"
    );
    let output = site.run(&words);
    output.status.code().unwrap()
}

#[test]
fn a_replay_killed_again_and_again_ends_as_an_undisturbed_one() {
    let kills = std::env::var("KILLS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(12);
    let site = crate::site::campaign();
    let (output, code) = site.replay(&["archive"], "whole.db");
    assert_eq!(code, 3, "{}", text(&output.stderr));
    assert_eq!(
        site.alarms("whole.db"),
        ["north suspected", "north drift", "north limit"]
    );
    assert!(site.history("whole.db", "rejections").len() >= 4);
    let whole = site.dump("whole.db");
    for (threads, store) in [("1", "one.db"), ("2", "two.db")] {
        let code = killed(
            &site,
            store,
            threads,
            kills,
            threads.len() as u64 + threads.as_bytes()[0] as u64,
        );
        assert!(matches!(code, 0 | 3), "{threads}");
        assert_equal_dumps(&whole, &site.dump(store));
        assert!(!fs::exists(site.path(&format!("{store}.corrupt-1"))).unwrap());
    }
}
