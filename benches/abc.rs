//! Speed of the inference: drawing tables, one record by rejection, adjustment and sequence, conflict.
//!
//! `cargo bench --bench abc`; one core: `RAYON_NUM_THREADS=1 cargo bench --bench abc`.

use divan::{Bencher, black_box};
use std::sync::Arc;
use tirante::analysis::inference::{
    AbcSettings, Accept, Adjustment, Inference, Method, Observation, Table, Tables,
};
use tirante::analysis::rod::beam::Quantity;
use tirante::analysis::rod::beam::exact::Exact;
use tirante::analysis::rod::emulator::fallback::OrExact;
use tirante::analysis::rod::emulator::reduced::ReducedModel;
use tirante::analysis::rod::prior::RodPrior;

fn main() {
    divan::main();
}

fn todi(settings: AbcSettings) -> Inference {
    let prior = RodPrior::todi();
    let model = Arc::new(Exact::new(*prior.parameterisation()));
    Inference::plan(prior, model, vec![0.0; 3], settings, 3, &Tables::new(1)).expect("a plan")
}

fn rejection(draws: usize) -> AbcSettings {
    AbcSettings {
        draws,
        accept: Accept::Quantile(0.01),
        method: Method::Rejection,
        adjustment: Adjustment::None,
        ..AbcSettings::default()
    }
}

/// Frequencies of a rod of the prior as a record gives them: mean frequencies and 10 mHz.
fn record() -> Observation {
    Observation::first(&[5.05, 10.30, 15.95], 0.01).expect("an observation")
}

#[divan::bench(args = [10_000, 100_000, 1_000_000], sample_count = 5)]
fn table_exact(draws: usize) -> Table {
    let prior = RodPrior::todi();
    let model = Exact::new(*prior.parameterisation());
    Table::draw(&prior, &model, 3, draws, 1)
}

#[divan::bench(args = [10_000, 100_000, 1_000_000], sample_count = 5)]
fn table_reduced(draws: usize) -> Table {
    let prior = RodPrior::todi();
    let model = OrExact::new(ReducedModel::new(*prior.parameterisation()));
    Table::draw(&prior, &model, 3, draws, 1)
}

#[divan::bench(args = [10_000, 100_000, 200_000, 1_000_000])]
fn run(bencher: Bencher<'_, '_>, draws: usize) {
    let (inference, record) = (todi(rejection(draws)), record());
    let mut seed = 0;
    bencher.bench_local(|| {
        seed += 7919;
        black_box(inference.run(&record, seed))
    });
}

#[divan::bench(args = [10_000, 1_000_000])]
fn run_with_discrepancy(bencher: Bencher<'_, '_>, draws: usize) {
    let prior = RodPrior::todi();
    let model = Arc::new(Exact::new(*prior.parameterisation()));
    let inference = Inference::plan(prior, model, vec![0.01; 3], rejection(draws), 3, &Tables::new(1));
    let (inference, record) = (inference.expect("a plan"), record());
    bencher.bench_local(|| black_box(inference.run(&record, 5)));
}

#[divan::bench(args = [10_000, 1_000_000])]
fn run_adjusted(bencher: Bencher<'_, '_>, draws: usize) {
    let settings = AbcSettings {
        adjustment: Adjustment::Linear,
        ..rejection(draws)
    };
    let (inference, record) = (todi(settings), record());
    bencher.bench_local(|| black_box(inference.run(&record, 5)));
}

/// The table drawn for this record alone, then the record.
#[divan::bench(sample_count = 5)]
fn run_without_table_1000000_reduced(bencher: Bencher<'_, '_>) {
    let (prior, record) = (RodPrior::todi(), record());
    let model = Arc::new(OrExact::new(ReducedModel::new(*prior.parameterisation())));
    bencher.bench_local(|| {
        let settings = rejection(1_000_000);
        let inference = Inference::plan(
            prior.clone(),
            model.clone(),
            vec![0.0; 3],
            settings,
            3,
            &Tables::new(1),
        );
        black_box(inference.expect("a plan").run(&record, 5))
    });
}

#[divan::bench(sample_count = 20)]
fn run_default(bencher: Bencher<'_, '_>) {
    let (inference, record) = (todi(AbcSettings::default()), record());
    bencher.bench_local(|| black_box(inference.run(&record, 5)));
}

#[divan::bench(args = [10_000, 200_000], sample_count = 5)]
fn sequential_exact(bencher: Bencher<'_, '_>, draws: usize) {
    let settings = AbcSettings {
        method: Method::Sequential,
        ..rejection(draws)
    };
    let (inference, record) = (todi(settings), record());
    bencher.bench_local(|| black_box(inference.run(&record, 5)));
}

#[divan::bench(args = [10_000, 1_000_000])]
fn marginals_of_seven_quantities(bencher: Bencher<'_, '_>, draws: usize) {
    let posterior = todi(rejection(draws)).run(&record(), 5).expect("a posterior");
    bencher.bench_local(|| {
        let quantities = posterior.parameterisation.quantities();
        quantities
            .iter()
            .filter_map(|&q: &Quantity| posterior.marginal(q))
            .count()
    });
}

#[divan::bench(args = ["none", "todi"])]
fn conflict(bencher: Bencher<'_, '_>, case: &str) {
    let inference = todi(rejection(10_000));
    let observation = match case {
        "none" => record(),
        _ => Observation::first(&[4.492, 9.288, 13.252], 1e-3f64.sqrt()).expect("an observation"),
    };
    bencher.bench_local(|| black_box(inference.conflict(&observation)));
}
