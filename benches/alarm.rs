//! What the drift alarm's promises cost: the charts' limits, the run-length law, delays.

use tirante::track::arl;
use tirante::track::chart::Design;
use tirante::track::run_length::{Departure, delays, survival};

fn main() {
    divan::main();
}

/// Mean run length of one side, by limit.
#[divan::bench(args = [4.0, 16.0, 40.0])]
fn mean_run_length(h: f64) -> f64 {
    arl::one_sided(0.2, divan::black_box(h), 0.0)
}

/// Limits of the default charts, by mean run length.
#[divan::bench(args = [365.0, 3652.0, 36_525.0], sample_count = 10)]
fn design(periods: f64) -> Design {
    Design::new([0.5, 0.2], divan::black_box(periods))
}

/// A year's law of the run length without a change.
#[divan::bench(sample_count = 10)]
fn first_year(bencher: divan::Bencher<'_, '_>) {
    let design = Design::new([0.5, 0.2], 3652.0);
    bencher.bench(|| survival(&design, 365, |_| 0.0, |_| 1.0));
}

/// Delays of a loss of 2 % a year at 0.3 % noise.
#[divan::bench(sample_count = 10)]
fn ramp_delays(bencher: divan::Bencher<'_, '_>) {
    let design = Design::new([0.5, 0.2], 3652.0);
    bencher.bench(|| delays(&design, Departure::Ramp(-0.0184), 90, 1100, 1));
}
