//! Speed of the two beam solvers; `cargo bench --bench beam`.

use divan::{Bencher, black_box};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::{Beam, exact, finite_elements};
use tirante::analysis::rod::prior::RodPrior;

fn main() {
    divan::main();
}

/// Draws from the paper's prior, so that no solve repeats the one before.
fn beams() -> Vec<Beam> {
    let prior = RodPrior::todi();
    let mut generator = random::stream(1, 0);
    let mut theta = vec![0.0; prior.parameterisation().len()];
    let draw = |_| {
        prior.sample(&mut generator, &mut theta);
        prior.parameterisation().beam(&theta)
    };
    (0..1000).map(draw).collect()
}

/// One solve per iteration, going round the draws.
fn each(bencher: Bencher, solve: impl Fn(&Beam, &mut [f64]) + Sync) {
    let beams = beams();
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % beams.len();
        let mut out = [0.0; 3];
        solve(black_box(&beams[next]), &mut out);
        out
    });
}

#[divan::bench]
fn exact_3_modes(bencher: Bencher) {
    each(bencher, |beam, out| {
        let _ = exact::frequencies(beam, out);
    });
}

#[divan::bench]
fn exact_3_slopes(bencher: Bencher) {
    each(bencher, |beam, out| {
        let _ = exact::log_slopes(beam, out);
    });
}

#[divan::bench(args = [25, 50, 100, 200])]
fn finite_elements_3_modes(bencher: Bencher, elements: usize) {
    each(bencher, |beam, out| {
        let _ = finite_elements::frequencies(beam, elements, out);
    });
}
