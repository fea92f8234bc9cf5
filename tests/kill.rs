//! kill -9 during a replay, then the same command again, ends in the store of an undisturbed run.
//!
//! A dozen kills in the tests; more with `KILLS=200 cargo test --test kill`.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod site;

use rand::RngExt;
use site::*;
use std::fs;
use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::thread;
use std::time::Duration;
use tirante::random;

/// 56 days of two rods in seven recordings: baselines, charts, records spoiled in several ways, a loss of 10 % that alarms.
fn campaign() -> Site {
    let site = Site::new(SITE);
    let loss = "[[simulation.rod.change]]\nstart_d = 0.0\nrelative = -0.10\n";
    let held = "[[simulation.rod.fault]]\nkind = \"held\"\nat_s = 3.0\nlength_s = 20.0\nfirst_record = 2\nlast_record = 3\n";
    let scaled =
        "[[simulation.rod.fault]]\nkind = \"scaled\"\nfactor = 1000.0\nfirst_record = 4\nlast_record = 5\n";
    let clock = "[[simulation.rod.fault]]\nkind = \"clock-step\"\nat_s = 12.0\nstep_s = 7200.0\nfirst_record = 5\nlast_record = 5\n";
    for index in 0..7 {
        let part = Part::new(8 * index, 8);
        let part = match index {
            1 => part.north(held),
            2 => part.south(clock),
            3 => part.north(scaled),
            4 => part.south(held),
            5 | 6 => part.north(loss),
            _ => part,
        };
        site.simulate(&format!("week-{index}"), &part);
    }
    site
}

/// Kills so many replays, each at another point, then lets one finish.
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
    let site = campaign();
    let (output, code) = site.replay(&["archive"], "whole.db");
    assert_eq!(code, 3, "{}", text(&output.stderr));
    assert_eq!(site.alarms("whole.db"), ["north drift", "north limit"]);
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
