//! Times of reading a configuration and of making a simulated record, by size.

use divan::{Bencher, black_box};
use tirante::analysis::lab::synthesis::Synthesis;
use tirante::config::Config;

fn main() {
    divan::main();
}

/// A configuration with this many rods.
#[divan::bench(args = [1, 10, 100])]
fn parse_rods(bencher: Bencher, rods: usize) {
    let minimal = include_str!("../config/minimal.toml");
    let text: String = (0..rods)
        .map(|i| minimal.replace("rod-1", &format!("rod-{i}")))
        .collect();
    bencher.bench(|| Config::parse(black_box(&text), "bench").is_ok());
}

/// One record of the built-in campaign's rod at 200 Hz, three modes, with 1/f noise.
#[divan::bench(args = [60, 600, 3600])]
fn record_seconds(bencher: Bencher, seconds: usize) {
    let text = include_str!("../config/campaign.toml")
        .replace("record_s = 120.0", &format!("record_s = {seconds}"))
        .replace("fs_hz = 40.0", "fs_hz = 200.0");
    let config = Config::parse(&text, "bench").expect("the campaign at another rate");
    let settings = config.simulation.expect("a simulation");
    let synthesis = Synthesis::new(&settings.simulation, 1);
    bencher.bench(|| synthesis.record(0, black_box(7)).is_ok());
}
