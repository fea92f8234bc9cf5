//! Speed of tracking's parts; `cargo bench --bench track`.

use divan::{Bencher, black_box};
use rand_distr::{Distribution, StandardNormal};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::Exact;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::emulator::ReducedModel;
use tirante::analysis::rod::prior::RodPrior;
use tirante::analysis::signal::record::Timestamp;
use tirante::analysis::track::alternatives::{Alternatives, Shifted};
use tirante::analysis::track::relative::Shift;
use tirante::analysis::track::{Baseline, LogMode, Observation};

fn main() {
    divan::main();
}

/// Records of the paper's rod over a season: a force that swings by 5 %, errors of 0.1 %.
fn records(count: usize, modes: usize) -> Vec<Observation> {
    let prior = RodPrior::todi();
    let exact = Exact::new(*prior.parameterisation());
    let mut generator = random::stream(1, 0);
    let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
    let mut f = vec![0.0; modes];
    (0..count)
        .map(|t| {
            let mut theta = prior.centre();
            theta[0] *= (0.05 * (0.2 * t as f64).sin()).exp();
            if exact.frequencies(&theta, &mut f).is_err() {
                f.fill(f64::NAN);
            }
            Observation::of_modes(
                Timestamp::from_nanos(t as i64 * 3_600_000_000_000),
                f.iter()
                    .enumerate()
                    .map(|(n, f)| LogMode {
                        order: n + 1,
                        log_frequency: f.ln() + 1e-3 * normal(),
                        log_sd: 1e-3,
                    })
                    .collect(),
            )
        })
        .collect()
}

fn model() -> ReducedModel {
    ReducedModel::new(*RodPrior::todi().parameterisation())
}

fn baseline(records: &[Observation], discrepancy: f64, particles: usize) -> Option<Baseline> {
    Baseline::learn(
        records,
        &RodPrior::todi(),
        &model(),
        &[discrepancy; 5],
        particles,
        1,
    )
    .ok()
}

#[divan::bench(args = [(30, 3), (30, 5), (365, 3)], sample_count = 30)]
fn baseline_learn_records_modes(bencher: Bencher, (count, modes): (usize, usize)) {
    let records = records(count, modes);
    bencher.bench_local(|| baseline(black_box(&records), 0.01, 512));
}

/// A discrepancy of a tenth of a percent: the kernel is tempered.
#[divan::bench(sample_count = 30)]
fn baseline_learn_tempered(bencher: Bencher) {
    let records = records(30, 3);
    bencher.bench_local(|| baseline(black_box(&records), 0.001, 512));
}

#[divan::bench(args = [512, 2048], sample_count = 30)]
fn shift_new_3_modes(bencher: Bencher, particles: usize) {
    if let Some(baseline) = baseline(&records(30, 3), 0.01, particles) {
        bencher.bench_local(|| Shift::new(black_box(&baseline), &model()));
    }
}

#[divan::bench(args = [(512, 1), (512, 3), (512, 5), (2048, 3)])]
fn relative_particles_modes(bencher: Bencher, (particles, modes): (usize, usize)) {
    let records = records(31, modes);
    if let Some(baseline) = baseline(&records[..30], 0.01, particles) {
        let shift = Shift::new(&baseline, &model());
        bencher.bench_local(|| shift.relative(black_box(&records[30]), 3));
    }
}

/// Responses of a rod to changes of every kind: once a baseline.
#[divan::bench(sample_count = 30)]
fn alternatives_new(bencher: Bencher) {
    if let Some(baseline) = baseline(&records(30, 3), 0.01, 512) {
        bencher.bench_local(|| Alternatives::new(black_box(&baseline.particles), &model(), &[0.01; 5]));
    }
}

/// Kinds of change weighed, once an alarm: seven records in which nothing is decided, what would decide included.
#[divan::bench(args = [3, 5], sample_count = 30)]
fn alternatives_explain_modes(bencher: Bencher, modes: usize) {
    let records = records(30, modes);
    let Some(baseline) = baseline(&records, 0.01, 512) else {
        return;
    };
    let Some(alternatives) = Alternatives::new(&baseline.particles, &model(), &[0.01; 5]) else {
        return;
    };
    // A loss of 3 % of the force, roughly.
    let mut late = records[..7].to_vec();
    late.iter_mut()
        .flat_map(|record| &mut record.modes)
        .for_each(|mode| mode.log_frequency -= 0.012);
    let shifted: Vec<Shifted> = late
        .iter()
        .enumerate()
        .map(|(t, record)| Shifted {
            modes: &record.modes,
            expected: 0.05 * (0.2 * t as f64).sin(),
        })
        .collect();
    let shift = alternatives.mean_shift(&baseline, &shifted, 0.001);
    bencher.bench_local(|| {
        shift
            .as_ref()
            .and_then(|shift| alternatives.explain(black_box(shift)))
    });
}
