//! Speed of Metropolis-Hastings, 450 000 steps as in the paper; `RAYON_NUM_THREADS=1 cargo bench --bench mcmc`.

use divan::{Bencher, black_box};
use tirante::analysis::inference::Observation;
use tirante::analysis::lab::chains::{self, Chains};
use tirante::analysis::lab::mcmc::{self, McmcError, McmcSettings, Problem};
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::beam::{Exact, FiniteElements, Quantity, finite_elements};
use tirante::analysis::rod::emulator::{OrExact, Pce, ReducedModel};
use tirante::analysis::rod::prior::RodPrior;

fn main() {
    divan::main();
}

fn walk(model: &dyn ForwardModel) -> Result<Chains, McmcError> {
    let prior = RodPrior::todi();
    let observation = Observation::first(&[4.492, 9.288, 13.252], 1.0)?;
    let problem = Problem {
        prior: &prior,
        model,
        observation: &observation,
        discrepancy: &[0.0; 3],
    };
    mcmc::run(&problem, &McmcSettings::default(), black_box(1))
}

#[divan::bench(sample_count = 10)]
fn chaos(bencher: Bencher) {
    if let Ok(pce) = Pce::fit(&RodPrior::todi(), 5, finite_elements::ELEMENTS, &|_, _| ()) {
        let model = OrExact::new(pce);
        bencher.bench_local(|| walk(&model));
    }
}

#[divan::bench(sample_count = 10)]
fn reduced(bencher: Bencher) {
    let model = ReducedModel::new(*RodPrior::todi().parameterisation());
    bencher.bench_local(|| walk(&model));
}

#[divan::bench(sample_count = 10)]
fn exact(bencher: Bencher) {
    let model = Exact::new(*RodPrior::todi().parameterisation());
    bencher.bench_local(|| walk(&model));
}

#[divan::bench(sample_count = 2)]
fn elements(bencher: Bencher) {
    let model = FiniteElements::new(*RodPrior::todi().parameterisation(), finite_elements::ELEMENTS);
    bencher.bench_local(|| walk(&model));
}

/// Effective sample size of one quantity of the chains above.
#[divan::bench(sample_count = 10)]
fn effective_sample_size(bencher: Bencher) {
    let model = ReducedModel::new(*RodPrior::todi().parameterisation());
    if let Some((values, kept)) = walk(&model)
        .ok()
        .and_then(|chains| Some((chains.values(Quantity::AxialForce)?, chains.kept)))
    {
        bencher.bench_local(|| chains::effective_sample_size(&values, kept));
    }
}
