//! Speed of fitting and evaluating the emulators; `cargo bench --bench emulator`.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use std::sync::LazyLock;
use tirante::analysis::lab::ann::{self, Ann};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::emulator::fit::Weighting;
use tirante::analysis::rod::emulator::{Pce, Reduced, ReducedModel, Training};
use tirante::analysis::rod::prior::RodPrior;

fn main() {
    divan::main();
}

static TRAINING: LazyLock<Option<Training>> =
    LazyLock::new(|| Training::solve(&RodPrior::todi(), 5, 50, &|_, _| ()).ok());

fn draws(count: usize) -> Vec<f64> {
    let prior = RodPrior::todi();
    let mut generator = random::stream(1, 0);
    let mut thetas = vec![0.0; count * prior.parameterisation().len()];
    thetas
        .chunks_exact_mut(7)
        .for_each(|theta| prior.sample(&mut generator, theta));
    thetas
}

/// Three modes of many points, as inference asks for them; per item is per point.
fn many(bencher: Bencher, model: &dyn ForwardModel, points: usize) {
    let thetas = draws(points);
    let mut out = vec![0.0; 3 * points];
    bencher.counter(ItemsCount::new(points)).bench_local(|| {
        model.frequencies_of_many(black_box(&thetas), 3, &mut out);
        black_box(&out);
    });
}

/// Least squares on 46656 points, 462 terms, three outputs, beyond the model solves.
#[divan::bench(sample_count = 20)]
fn pce_fit_3_modes(bencher: Bencher) {
    if let Some(training) = &*TRAINING {
        bencher.bench_local(|| training.fit(3, Weighting::Equal));
    }
}

#[divan::bench(args = [1, 1000, 100_000])]
fn pce_eval_3_modes(bencher: Bencher, points: usize) {
    if let Some(training) = &*TRAINING {
        let pce = Pce::from_training(&RodPrior::todi(), training, Weighting::Equal);
        many(bencher, &pce, points);
    }
}

/// Ten of the 150 passes over the 46656 points; the error report included.
#[divan::bench(sample_count = 3)]
fn ann_train_10_passes(bencher: Bencher) {
    if let Some(training) = &*TRAINING {
        bencher.bench_local(|| Ann::train(&RodPrior::todi(), training, 10, 1));
    }
}

/// All of them.
#[divan::bench(sample_count = 1, sample_size = 1)]
fn ann_train(bencher: Bencher) {
    if let Some(training) = &*TRAINING {
        bencher.bench_local(|| Ann::train(&RodPrior::todi(), training, ann::EPOCHS, 1));
    }
}

#[divan::bench(args = [1, 1000, 100_000])]
fn ann_eval_3_modes(bencher: Bencher, points: usize) {
    if let Some(training) = &*TRAINING {
        let ann = Ann::train(&RodPrior::todi(), training, 1, 1);
        many(bencher, &ann, points);
    }
}

/// Exact solves included.
#[divan::bench(sample_count = 20)]
fn reduced_fit_5_modes() -> Reduced {
    Reduced::fit()
}

#[divan::bench(args = [1, 1000, 100_000])]
fn reduced_eval_3_modes(bencher: Bencher, points: usize) {
    many(
        bencher,
        &ReducedModel::new(*RodPrior::todi().parameterisation()),
        points,
    );
}
