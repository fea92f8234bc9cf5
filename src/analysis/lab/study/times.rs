//! Times of emulators and samplers on this machine, on one thread: the one part of the study that is not
//! reproducible, measured only on request.

use super::setting::Setting;
use super::table2::{self, Plan, Sampler, Which};
use super::{Effort, Emulators, ORDER, StudyError, models};
use crate::lab::ann::Ann;
use crate::numerics::random::{self, BLOCK};
use crate::rod::beam::finite_elements;
use crate::rod::beam::forward::ForwardModel;
use crate::rod::emulator::fit::Weighting;
use crate::rod::emulator::{Reduced, Training};
use crate::rod::prior::RodPrior;
use serde::Serialize;
use std::sync::Arc;

/// Time for which an evaluation is repeated \[s\].
const LONG_ENOUGH_S: f64 = 0.3;

/// Time of one task.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Time {
    /// The task.
    pub what: &'static str,
    /// Name of the model.
    pub model: &'static str,
    /// Time taken \[s\].
    pub seconds: f64,
}

/// Trains, evaluates and samples once more, on one thread, timed by `clock` \[s\].
///
/// # Errors
/// As the study.
pub fn measure(
    effort: &Effort,
    seed: u64,
    clock: &(dyn Fn() -> f64 + Sync),
) -> Result<Vec<Time>, StudyError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| on_this_thread(effort, seed, clock))
}

fn on_this_thread(effort: &Effort, seed: u64, clock: &dyn Fn() -> f64) -> Result<Vec<Time>, StudyError> {
    let setting = Setting::AsInferred;
    let prior = setting.prior();
    let mut all = Vec::new();
    let mut time = |what, model, begun: f64| {
        let seconds = clock() - begun;
        all.push(Time { what, model, seconds });
    };
    let begun = clock();
    let training = Training::solve(&prior, ORDER, finite_elements::ELEMENTS, &|_, _| ())?;
    time("solves of the design", "finite-elements", begun);
    let begun = clock();
    training.fit(crate::rod::beam::forward::MAX_MODES, Weighting::Equal);
    time("training", "pce", begun);
    let begun = clock();
    Ann::train(&prior, &training, effort.epochs, seed);
    time("training", "ann", begun);
    let begun = clock();
    Reduced::fit();
    time("training", "reduced", begun);
    let emulators = Emulators::train(&prior, effort, seed, &|_| ())?;
    let models = models(&prior, &emulators);
    for model in &models {
        all.push(Time {
            what: "three frequencies of one rod",
            model: model.name(),
            seconds: evaluation(&**model, &prior, clock),
        });
    }
    let plan = Plan {
        setting,
        prior: &prior,
        models: &models,
        effort,
        seed,
    };
    for (sampler, what) in [(Sampler::Abc, "one ABC"), (Sampler::Mcmc, "one MCMC")] {
        for model in &models {
            let model: &Arc<dyn ForwardModel> = model;
            let name = model.name();
            let begun = clock();
            table2::one(&plan, Which { sampler, model: name }, model, 0)?;
            all.push(Time {
                what,
                model: name,
                seconds: clock() - begun,
            });
        }
    }
    Ok(all)
}

/// Time of one point, asked for in blocks as inference does \[s\].
fn evaluation(model: &dyn ForwardModel, prior: &RodPrior, clock: &dyn Fn() -> f64) -> f64 {
    let width = prior.priors().len();
    let mut generator = random::stream(0, 0);
    let mut thetas = vec![0.0; BLOCK * width];
    for theta in thetas.chunks_exact_mut(width) {
        prior.sample(&mut generator, theta);
    }
    let mut y = vec![0.0; BLOCK * 3];
    let (begun, mut points) = (clock(), 0);
    while clock() - begun < LONG_ENOUGH_S {
        model.frequencies_of_many(&thetas, 3, std::hint::black_box(&mut y));
        points += BLOCK;
    }
    (clock() - begun) / points as f64
}
