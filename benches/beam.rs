//! Speed of the two beam solvers; `cargo bench --bench beam`.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::receptance::{PointLoad, PointMass};
use tirante::analysis::rod::beam::{Beam, exact, finite_elements};
use tirante::analysis::rod::prior::RodPrior;
use tirante::analysis::rod::query::{Queries, Query};

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

/// Three frequencies and one more datum of a thousand rods: the datum costs the difference to three frequencies alone.
#[divan::bench(sample_count = 300, sample_size = 1, args = ["alone", "frequency", "load", "mass", "strain", "shape"])]
fn three_frequencies_and(bencher: Bencher, datum: &str) {
    let frequency = |order| Query::Frequency { order, mass: None };
    let mut queries: Vec<Query> = (1..=3).map(frequency).collect();
    queries.extend(match datum {
        "frequency" => Some(frequency(4)),
        "load" => Some(Query::Deflection {
            load: PointLoad {
                force_n: 300.0,
                at: 0.5,
            },
            read_at: 0.5,
        }),
        "mass" => Some(Query::FrequencyRatio {
            order: 1,
            mass: PointMass {
                mass_kg: 20.0,
                at: 0.3,
            },
        }),
        "strain" => Some(Query::StrainRatio {
            order: 1,
            strain_at: 0.05,
            read_at: 0.1,
        }),
        "shape" => Some(Query::AmplitudeRatio {
            order: 1,
            at: 0.1,
            reference_at: 0.4,
        }),
        _ => None,
    });
    let prior = RodPrior::todi();
    let asked = Queries::new(*prior.parameterisation(), queries).expect("known queries");
    let mut generator = random::stream(1, 0);
    let mut thetas = Vec::new();
    for _ in 0..1000 {
        let mut theta = prior.centre();
        prior.sample(&mut generator, &mut theta);
        thetas.push(theta);
    }
    let mut out = vec![0.0; asked.all().len()];
    bencher.counter(ItemsCount::new(thetas.len())).bench_local(|| {
        let mut sum = 0.0;
        for theta in &thetas {
            let _ = asked.answers(black_box(theta), &mut out);
            sum += out[0];
        }
        sum
    });
}

#[divan::bench(args = [25, 50, 100, 200])]
fn finite_elements_3_modes(bencher: Bencher, elements: usize) {
    each(bencher, |beam, out| {
        let _ = finite_elements::frequencies(beam, elements, out);
    });
}
