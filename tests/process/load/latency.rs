//! Many rods live, in real time: latency from a record's last sample to its result in the store.
//!
//! `RODS=400` tries another number; `SAMPLES=1` sends one sample a message.

use super::plant::{Plan, Plant, Take, wait};
use super::usage::{Usage, metric, metrics};
use super::witness::{Seen, Witness, spread};
use std::collections::BTreeMap;
use std::thread;
use std::time::{Duration, Instant};

/// Sensors' computers, each with a tenth of the rods.
const SENDERS: usize = 10;
/// Records of each rod.
const RECORDS: usize = 2;
/// Latency required \[s\].
const LIMIT_S: f64 = 1.0;

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// Every rod sends for a little more than two records; its senders begin `apart` one after another.
fn live(apart: Duration) {
    let (rods, samples_per_message) = (number("RODS", 100), number("SAMPLES", 20));
    let plan = Plan {
        rods,
        field: if samples_per_message == 1 {
            "data"
        } else {
            "values"
        },
        ..Plan::default()
    };
    let window_s = plan.window_s;
    let plant = Plant::new(plan);
    let share = rods / SENDERS;
    for sender in 0..SENDERS {
        plant.simulate(&Take {
            name: &format!("part-{sender}"),
            rods: sender * share..(sender + 1) * share,
            record_s: RECORDS as f64 * window_s + 4.0,
            samples_per_message,
            ..Take::default()
        });
    }
    let mut daemon = plant.start();
    let witness = Witness::start(&plant);
    let (begun, before) = (Instant::now(), Usage::of(daemon.pid()));
    let senders: Vec<_> = (0..SENDERS)
        .map(|sender| {
            if sender > 0 {
                thread::sleep(apart);
            }
            let file = format!("part-{sender}.mcap");
            plant.send(&format!("sender-{sender}"), &[&file], &["--stamp-now"])
        })
        .collect();
    for sender in senders {
        sender.finish();
    }
    let (after, wall_s) = (Usage::of(daemon.pid()), begun.elapsed().as_secs_f64());
    let offered = (rods * RECORDS) as i64;
    wait(
        &mut daemon,
        "every record is there",
        Duration::from_secs(60),
        || plant.count("SELECT count(*) FROM record WHERE duration_s > 59") == offered,
    );
    let mut seen = witness.finish();
    // The seconds behind the last window are a record, too short to be used.
    seen.retain(|seen| seen.end_s.is_finite());
    let said = metrics(&daemon);
    let mean_ms = |name: &str| {
        1e3 * metric(&said, &format!("tirante_{name}_seconds_sum"))
            / metric(&said, &format!("tirante_{name}_seconds_count"))
    };
    let of = |records: &[Seen]| {
        let [least, median, most, worst] = spread(records);
        format!("least {least:.3} s, median {median:.3} s, 95 % {most:.3} s, largest {worst:.3} s")
    };
    let whole = whole_windows(&seen, window_s);
    println!("{rods} rods, {samples_per_message} samples a message, senders {apart:?} apart:");
    println!("  latency of {} records: {}", whole.len(), of(&whole));
    println!(
        "  analysis {:.2} ms, commit {:.2} ms a record; daemon {:.1} % of two cores, peak {:.0} MB",
        mean_ms("analysis"),
        mean_ms("commit"),
        100.0 * (after.cpu_s - before.cpu_s) / (2.0 * wall_s),
        after.peak_mb
    );
    assert_eq!(whole.len() as i64, offered);
    let identified = plant.count("SELECT count(*) FROM record WHERE duration_s > 59 AND rejection IS NULL");
    assert!(
        identified * 10 > offered * 9,
        "{identified} of {offered} identified"
    );
    assert!(spread(&whole)[3] < LIMIT_S);
    daemon.stop("-TERM");
}

/// The first records of every rod, without the rest behind them.
fn whole_windows(seen: &[Seen], window_s: f64) -> Vec<Seen> {
    let mut last = BTreeMap::new();
    let mut whole = Vec::new();
    for one in seen {
        let before: Option<f64> = last.insert(one.rod.clone(), one.end_s);
        if before.is_none_or(|before| one.end_s - before > 0.9 * window_s) {
            whole.push(one.clone());
        }
    }
    whole
}

#[test]
#[ignore = "two minutes of real time on a quiet machine"]
fn a_hundred_rods_at_once() {
    live(Duration::ZERO);
}

#[test]
#[ignore = "three minutes of real time on a quiet machine"]
fn a_hundred_rods_staggered() {
    live(Duration::from_secs(6));
}
