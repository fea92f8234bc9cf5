//! `kill -9` at random moments. With those of `tests/process/daemon.rs` and `tests/site/kill.rs` the tests kill 200 times; thousands by hand,
//! `KILLS=3000 cargo test --test process survival::kill -- --nocapture`.

use super::campaign::{Campaign, Material};
use rand::RngExt;
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;

#[test]
fn killed_at_random_moments_it_loses_nothing_doubles_nothing_and_says_the_same() {
    let kills = std::env::var("KILLS").map_or(80, |kills| kills.parse().unwrap());
    let seed = std::env::var("SEED").map_or(1, |seed| seed.parse().unwrap());
    let material = Material::long();
    material.undisturbed();
    let begun = Instant::now();
    let mut generator = random::stream(seed, 0);
    let (mut cut_off, mut acks, mut welcomes, mut ready) = (0, 0, 0, Vec::new());
    // Many kills are several campaigns: the data of one are in after some hundreds.
    let rounds = usize::div_ceil(kills, 250);
    for round in 0..rounds {
        let campaign = Campaign::new(material, "");
        let mut feed = campaign.feed();
        let here = kills / rounds + usize::from(round < kills % rounds);
        for kill in 0..here {
            let mut daemon = campaign.start(&[]);
            let started = Instant::now();
            // A sender gets its first acknowledgement after a second; some processes live long enough for that.
            let most_ms = if generator.random_range(0..10) == 0 {
                3000
            } else {
                400
            };
            let life = Duration::from_millis(generator.random_range(0..most_ms));
            if generator.random_range(0..5) < 3 {
                // At work; the others are cut off while they start.
                daemon.wait_until("it is ready", |log| log.contains("ready"));
                ready.push(started.elapsed());
            }
            // Something comes before the kill, something while the daemon starts or works.
            feed.offer((kill as f64 + generator.random_range(0.0..1.0)) / here as f64);
            thread::sleep(life / 2);
            feed.offer((kill + 1) as f64 / here as f64);
            thread::sleep(life / 2);
            cut_off += usize::from(daemon.is_running());
            daemon.child.kill().unwrap();
            daemon.wait();
            if generator.random_range(0..4) > 0 {
                feed.kill_sender();
            }
        }
        println!(
            "round {round}: {} records before the last start",
            campaign.records()
        );
        campaign.finish(&mut feed);
        campaign.check(&format!("seed {seed}, round {round}"), false);
        acks += feed.acks();
        welcomes += feed.welcomes();
    }
    ready.sort_unstable();
    println!(
        "{cut_off} of {kills} were cut off, {acks} acknowledgements and {welcomes} welcomes that are some seen, {:?}; ready after {:?} (median), {:?} (longest)",
        begun.elapsed(),
        ready.get(ready.len() / 2),
        ready.last()
    );
    assert!(
        cut_off * 10 >= kills * 9,
        "only {cut_off} of {kills} were cut off"
    );
    assert!(
        acks > 0 && welcomes > 0,
        "nothing was acknowledged: the test proves nothing about it"
    );
}
