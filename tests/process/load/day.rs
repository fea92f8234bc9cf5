//! A day of three channels at 1 kHz, as fast as the daemon takes it: memory flat, descriptors constant.

use super::plant::{Plan, Plant, Take};
use super::usage::Usage;
use std::thread;
use std::time::{Duration, Instant};

const HOURS: usize = 24;
const RODS: usize = 3;
/// Hours after which buffers and caches have their final size.
const SETTLED_H: f64 = 4.0;
const PEAK_MB: f64 = 256.0;
const GROWTH_MB_PER_H: f64 = 1.0;

#[test]
#[ignore = "minutes"]
fn a_day_of_three_channels_at_1_khz() {
    let plant = Plant::new(Plan {
        rods: RODS,
        fs_hz: 1000.0,
        ..Plan::default()
    });
    let begun = Instant::now();
    let name = |hour: usize| format!("hour-{hour:02}");
    for hour in 0..HOURS {
        plant.simulate(&Take {
            name: &name(hour),
            rods: 0..RODS,
            start: &format!("2026-01-01T{hour:02}:00:00Z"),
            record_s: 3600.0,
            samples_per_message: 100,
            ..Take::default()
        });
    }
    println!("{HOURS} hours simulated in {:?}", begun.elapsed());

    let mut daemon = plant.start();
    let pid = daemon.pid();
    let begun = Instant::now();
    let files: Vec<String> = (0..HOURS).map(|hour| name(hour) + ".mcap").collect();
    let files: Vec<&str> = files.iter().map(String::as_str).collect();
    let sender = plant.send("tower", &files, &["--speed", "max"]);
    // Hours of data whose results are in the store, and the daemon's resource usage then.
    let mut samples: Vec<(f64, Usage)> = Vec::new();
    let all_h = (HOURS * RODS * 60) as f64 / (60 * RODS) as f64;
    loop {
        assert!(daemon.is_running(), "ended:\n{}", daemon.log());
        assert!(
            begun.elapsed() < Duration::from_secs(3600),
            "too slow:\n{}",
            daemon.log()
        );
        let hours = plant.count("SELECT count(*) FROM record") as f64 / (60 * RODS) as f64;
        samples.push((hours, Usage::of(pid)));
        if hours >= all_h - 1e-9 {
            break;
        }
        thread::sleep(Duration::from_millis(500));
    }
    let wall_s = begun.elapsed().as_secs_f64();
    sender.finish();
    let cpu_s = Usage::of(pid).cpu_s;
    let settled: Vec<_> = samples.iter().filter(|(hours, _)| *hours >= SETTLED_H).collect();
    let growth = slope(settled.iter().map(|(hours, usage)| (*hours, usage.resident_mb)));
    let (fewest, most) = settled.iter().fold((usize::MAX, 0), |(low, high), (_, usage)| {
        (low.min(usage.descriptors), high.max(usage.descriptors))
    });
    let peak_mb = samples.iter().map(|(_, usage)| usage.peak_mb).fold(0.0, f64::max);
    for hour in [1.0, 4.0, 8.0, 16.0, 24.0] {
        if let Some((hours, usage)) = samples.iter().find(|(hours, _)| *hours >= hour) {
            println!(
                "  {hours:5.1} h: {:.1} MB resident, {} descriptors",
                usage.resident_mb, usage.descriptors
            );
        }
    }
    println!(
        "a day in {wall_s:.0} s with {cpu_s:.0} s of processor; peak {peak_mb:.0} MB, {growth:+.2} MB an hour of data from \
         {SETTLED_H} h on, {fewest} to {most} descriptors"
    );
    let records = plant.count("SELECT count(*) FROM record");
    assert_eq!(records, (HOURS * RODS * 60) as i64);
    assert!(peak_mb < PEAK_MB);
    assert!(growth < GROWTH_MB_PER_H);
    // A scan of the folder or a new part of the journal holds one or two for a moment.
    assert!(most - fewest <= 3);
    daemon.stop("-TERM");
}

/// The slope of the straight line through the points, by least squares.
pub fn slope(points: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
    let count = points.clone().count() as f64;
    let mean = |of: fn((f64, f64)) -> f64| points.clone().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let up: f64 = points.clone().map(|point| (point.0 - x) * (point.1 - y)).sum();
    let across: f64 = points.map(|point| (point.0 - x).powi(2)).sum();
    up / across
}
