//! Told to stop, or to read its configuration again, at random moments of work.

use super::campaign::{Campaign, Material};
use rand::RngExt;
use std::fs;
use std::thread;
use std::time::Duration;
use tirante::analysis::numerics::random;

/// A dozen; more with `SIGNALS=300`.
#[test]
fn signals_at_random_moments_end_it_in_time_and_lose_nothing() {
    let campaign = Campaign::new(Material::long(), "");
    let mut feed = campaign.feed();
    let mut generator = random::stream(2, 0);
    let good = fs::read_to_string(campaign.path("site.toml")).unwrap();
    let times = std::env::var("SIGNALS").map_or(12, |times| times.parse().unwrap());
    for time in 0..times {
        let mut daemon = campaign.start(&[]);
        // From its first word on it answers to signals.
        daemon.wait_until("it says something", |log| !log.is_empty());
        feed.offer(f64::from(time) / f64::from(times));
        let mut wait = || thread::sleep(Duration::from_millis(generator.random_range(0..500)));
        wait();
        match time % 3 {
            0 => {}
            1 => {
                daemon.signal("-HUP");
                wait();
            }
            _ => {
                daemon.wait_until("it is ready", |log| log.contains("ready"));
                fs::write(campaign.path("site.toml"), format!("{good}[typo]\n")).unwrap();
                daemon.signal("-HUP");
                daemon.wait_until("the bad one is refused", |log| log.contains("the old one holds"));
                fs::write(campaign.path("site.toml"), &good).unwrap();
            }
        }
        daemon.stop(if time % 2 == 0 { "-TERM" } else { "-INT" });
    }
    campaign.finish(&mut feed);
    campaign.check("signals", false);
}
