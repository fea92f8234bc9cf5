//! Hours of data, accelerated, with every fault at random from a seed: data that are spoiled, packed badly or come twice, clients that
//! send garbage, sinks that fail, disks that fill, files that are taken away, signals and kills. In the end the invariants hold: each record
//! once (I1), the rows of an undisturbed replay (I2), nothing acknowledged that is lost (I3), no force of failed records (I4), one id an
//! alarm, at every sink (I5), no fault that is not counted, shown and logged (I6); memory is flat.
//!
//! `SEED=3 cargo test --release --test process -- --ignored --nocapture day::a_day`; `HOURS=6` for a shorter one.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod judge;
mod material;
mod scene;

use material::Material;
use rand::RngExt;
use scene::{Scene, Trouble};
use std::time::Instant;
use tirante::analysis::numerics::random;

/// Every trouble comes so often in an hour of data, on the average.
const RATE_PER_H: f64 = 0.3;
/// Part of the time in which nothing ends the daemon, so that its memory can be judged.
const ONE_LIFE: std::ops::Range<f64> = 0.4..0.9;
/// Looks at the daemon in an hour of data.
const LOOKS_PER_H: usize = 12;

/// Troubles at their shares of the time, in its order: each at least once.
fn schedule(hours: usize, rng: &mut impl rand::Rng) -> Vec<(f64, Trouble)> {
    let mut troubles = Vec::new();
    for trouble in Trouble::ALL {
        let most = (2.0 * RATE_PER_H * hours as f64) as usize;
        let times = if most > 1 { rng.random_range(1..=most) } else { 1 };
        for _ in 0..times {
            let share = loop {
                let share = rng.random_range(0.02..0.98);
                if !(trouble.ends_the_daemon() && ONE_LIFE.contains(&share)) {
                    break share;
                }
            };
            troubles.push((share, trouble));
        }
    }
    troubles.sort_by(|one, other| one.0.total_cmp(&other.0));
    troubles
}

fn survive(seed: u64, hours: usize) {
    let begun = Instant::now();
    let material = Material::new(seed, hours);
    println!(
        "seed {seed}, {hours} h: {} records of {} rods, {} broken files; prepared in {:.0?}",
        material.records,
        material.replayed.len(),
        material.broken.len(),
        begun.elapsed()
    );
    let mut rng = random::stream(seed, 2);
    let troubles = schedule(hours, &mut rng);
    let Some(mut scene) = Scene::new(material, rng) else {
        eprintln!("skipped: no file system can be mounted here");
        return;
    };
    scene.start();
    let looks = hours * LOOKS_PER_H;
    let mut next = troubles.iter().peekable();
    for look in 1..=looks {
        let share = look as f64 / looks as f64;
        while let Some((at, trouble)) = next.next_if(|(at, _)| *at < share) {
            scene.feed.offer(*at);
            scene.suffer(*trouble, *at);
        }
        scene.feed.offer(share);
        scene.keep_up(share);
    }
    scene.finish();
    println!("  survived {:?} in {:.0?}", scene.done, begun.elapsed());
}

#[test]
fn an_hour_with_every_trouble() {
    survive(1, 1);
}

/// Another with `SEED=...`, a shorter one with `HOURS=...`.
#[test]
#[ignore = "minutes"]
fn a_day_with_every_trouble() {
    let variable = |name: &str, usual: u64| std::env::var(name).map_or(usual, |text| text.parse().unwrap());
    survive(variable("SEED", 1), variable("HOURS", 24) as usize);
}
