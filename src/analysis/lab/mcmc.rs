//! Metropolis-Hastings on the augmented space of parameters and latent variables (paper, Algorithm 1): the
//! springs are sampled with everything else and integrated out by ignoring them.
//!
//! A random walk in the logarithms of positive quantities (the logit between the ends of a uniform) with a
//! normal proposal. During the burn-in its covariance follows that of the chains (Haario et al. 2001) and its
//! size the share accepted (Robbins and Monro); then both are frozen, so that the draws kept come from a
//! proper Metropolis chain. Chains move in groups side by side: an emulator answers for a group in one block,
//! and a group adapts together. Each chain draws from its own stream: the same seed gives the same bytes at
//! any number of threads.

mod proposal;

use super::chains::Chains;
use super::likelihood::{Likelihood, NoLikelihood};
use crate::inference::{InvalidObservation, Observation};
use crate::numerics::random;
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::prior::{Prior, RodPrior};
use proposal::Adapted;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, Exp1, StandardNormal};
use rayon::prelude::*;
use thiserror::Error;

/// Number of chains in a group.
pub const GROUP: usize = 16;
/// Prior draws a chain chooses its start from. The best of so few is near the posterior, and far from where it
/// is narrow: starts stay more widely spread than the posterior.
const STARTS: usize = 64;
/// Steps between two proposals in the burn-in, and before the first.
const RENEWAL: usize = 50;

/// Posterior to be sampled.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    /// The prior of all quantities.
    pub prior: &'a RodPrior,
    /// The forward model.
    pub model: &'a dyn ForwardModel,
    /// The observed frequencies with their standard errors.
    pub observation: &'a Observation,
    /// Relative standard deviation of the model discrepancy per mode order from the first.
    pub discrepancy: &'a [f64],
}

/// Number and length of the chains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct McmcSettings {
    /// Number of chains.
    pub chains: usize,
    /// Steps of each chain, burn-in included.
    pub steps: usize,
    /// Steps of each chain that adapt the proposal and are discarded.
    pub burn_in: usize,
    /// Steps of a chain per draw kept.
    pub thin: usize,
}

/// The paper's 450 000 steps, by sixteen chains, a quarter of them burn-in.
impl Default for McmcSettings {
    fn default() -> Self {
        Self {
            chains: 16,
            steps: 28_125,
            burn_in: 7_025,
            thin: 1,
        }
    }
}

/// Reason why there are no chains.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum McmcError {
    /// Prior and model have different quantities, or the model gives too few modes.
    #[error("the model {model} does not describe this rod: another section, or fewer than {modes} modes")]
    Model {
        /// Name of the model.
        model: &'static str,
        /// Number of modes needed.
        modes: usize,
    },
    /// Every quantity has a fixed value.
    #[error("every quantity is fixed: nothing is left to infer")]
    NothingUncertain,
    /// No steps would be kept.
    #[error("{0:?}: chains, thinning and the steps after the burn-in must each be at least one")]
    Settings(McmcSettings),
    /// The frequencies are no valid observation.
    #[error(transparent)]
    Observation(#[from] InvalidObservation),
    /// The frequencies have no likelihood.
    #[error(transparent)]
    Likelihood(#[from] NoLikelihood),
    /// No draw of the prior has a likelihood above zero.
    #[error("none of {STARTS} draws of the prior is a rod the model {model} has an answer for")]
    NoStart {
        /// Name of the model.
        model: &'static str,
    },
}

/// Runs the chains.
///
/// # Errors
/// The problem has no posterior to walk on, or the settings keep nothing.
pub fn run(problem: &Problem, settings: &McmcSettings, seed: u64) -> Result<Chains, McmcError> {
    let Problem {
        prior,
        model,
        observation,
        discrepancy,
    } = *problem;
    observation.check()?;
    let likelihood = Likelihood::new(observation, discrepancy)?;
    let modes = likelihood.modes();
    if prior.parameterisation() != model.parameterisation() || modes > model.modes() {
        let model = model.name();
        return Err(McmcError::Model { model, modes });
    }
    if prior.priors().iter().all(Prior::is_fixed) {
        return Err(McmcError::NothingUncertain);
    }
    let McmcSettings {
        chains,
        steps,
        burn_in,
        thin,
    } = *settings;
    if chains == 0 || thin == 0 || steps < burn_in + thin {
        return Err(McmcError::Settings(*settings));
    }
    let groups: Vec<(Vec<Vec<f64>>, Vec<f64>)> = (0..chains.div_ceil(GROUP))
        .into_par_iter()
        .map(|group| {
            let streams = group * GROUP..chains.min((group + 1) * GROUP);
            let generators = streams.map(|chain| random::stream(seed, chain as u64)).collect();
            let mut walk = Walk::start(prior, model, &likelihood, generators)?;
            walk.burn_in(burn_in);
            Ok(walk.draw(steps - burn_in, thin))
        })
        .collect::<Result<_, McmcError>>()?;
    let (draws, acceptance): (Vec<_>, Vec<_>) = groups.into_iter().unzip();
    Ok(Chains {
        parameterisation: *prior.parameterisation(),
        chains,
        kept: (steps - burn_in) / thin,
        thin,
        draws: draws.concat().concat(),
        acceptance: acceptance.concat(),
        seed,
    })
}

/// One number per chain of a group.
type Lanes = [f64; GROUP];

/// A group of chains under way.
struct Walk<'a> {
    prior: &'a RodPrior,
    model: &'a dyn ForwardModel,
    likelihood: &'a Likelihood,
    generators: Vec<ChaCha8Rng>,
    uncertain: Vec<usize>,
    /// Per uncertain quantity, the chains' positions on the real line.
    places: Vec<Lanes>,
    /// Log densities at the positions.
    density: Lanes,
    /// Triangular root of the proposal's covariance, row by row, size included.
    root: Vec<f64>,
    proposed: Vec<Lanes>,
    normals: Vec<Lanes>,
    /// Parameter vectors, row-major (chains x quantities), and their frequencies.
    thetas: Vec<f64>,
    frequencies: Vec<f64>,
}

impl<'a> Walk<'a> {
    fn start(
        prior: &'a RodPrior,
        model: &'a dyn ForwardModel,
        likelihood: &'a Likelihood,
        generators: Vec<ChaCha8Rng>,
    ) -> Result<Self, McmcError> {
        let priors = prior.priors();
        let uncertain: Vec<usize> = (0..priors.len()).filter(|&i| !priors[i].is_fixed()).collect();
        let (count, unknowns) = (generators.len(), uncertain.len());
        let empty = vec![[0.0; GROUP]; unknowns];
        let mut walk = Self {
            prior,
            model,
            likelihood,
            thetas: prior.centre().repeat(count),
            frequencies: vec![0.0; count * likelihood.modes().min(MAX_MODES)],
            generators,
            uncertain,
            places: empty.clone(),
            density: [f64::NEG_INFINITY; GROUP],
            root: Vec::new(),
            proposed: empty.clone(),
            normals: empty,
        };
        for _ in 0..STARTS {
            for (chain, generator) in walk.generators.iter_mut().enumerate() {
                for (slot, &quantity) in walk.uncertain.iter().enumerate() {
                    let value = priors[quantity].sample(generator);
                    walk.proposed[slot][chain] = priors[quantity].to_line(value);
                }
            }
            let density = walk.log_density();
            for (chain, density) in density.into_iter().enumerate().take(count) {
                if density > walk.density[chain] {
                    walk.take(chain, density);
                }
            }
        }
        if walk.density[..count].contains(&f64::NEG_INFINITY) {
            let model = model.name();
            return Err(McmcError::NoStart { model });
        }
        Ok(walk)
    }

    /// Log posterior densities on the real line at the proposed places; writes `thetas`.
    fn log_density(&mut self) -> Lanes {
        let count = self.generators.len();
        let width = self.prior.priors().len();
        let mut density = [0.0; GROUP];
        for (&quantity, lanes) in self.uncertain.iter().zip(&self.proposed) {
            let prior = &self.prior.priors()[quantity];
            for chain in 0..count {
                let value = prior.from_line(lanes[chain]);
                self.thetas[chain * width + quantity] = value;
                // The change of variable multiplies the density by the derivative of the value.
                density[chain] += prior.log_density_on_line(value, lanes[chain]);
            }
        }
        let modes = self.likelihood.modes();
        self.model
            .frequencies_of_many(&self.thetas, modes, &mut self.frequencies);
        for (density, row) in density.iter_mut().zip(self.frequencies.chunks_exact(modes)) {
            *density += self.likelihood.log_density(row);
            // A logarithm that left the range of numbers is nowhere.
            if density.is_nan() {
                *density = f64::NEG_INFINITY;
            }
        }
        density
    }

    fn take(&mut self, chain: usize, density: f64) {
        self.density[chain] = density;
        for (place, proposed) in self.places.iter_mut().zip(&self.proposed) {
            place[chain] = proposed[chain];
        }
    }

    /// Moves every chain by one step; returns true for each that moved.
    fn step(&mut self) -> [bool; GROUP] {
        let count = self.generators.len();
        let mut patience = [0.0; GROUP];
        for (chain, generator) in self.generators.iter_mut().enumerate() {
            for normal in &mut self.normals {
                normal[chain] = StandardNormal.sample(generator);
            }
            // The negative logarithm of a uniform number.
            patience[chain] = Exp1.sample(generator);
        }
        let mut row = self.root.as_slice();
        for (slot, (proposed, place)) in self.proposed.iter_mut().zip(&self.places).enumerate() {
            *proposed = *place;
            let (factors, rest) = row.split_at(slot + 1);
            row = rest;
            for (factor, normal) in factors.iter().zip(&self.normals) {
                for chain in 0..GROUP {
                    proposed[chain] += factor * normal[chain];
                }
            }
        }
        let density = self.log_density();
        let mut moved = [false; GROUP];
        for chain in 0..count {
            // The proposal is symmetric: q cancels.
            if density[chain] - self.density[chain] > -patience[chain] {
                moved[chain] = true;
                self.take(chain, density[chain]);
            }
        }
        moved
    }

    fn burn_in(&mut self, steps: usize) {
        let (count, unknowns) = (self.generators.len() as f64, self.uncertain.len());
        let mut adapted = Adapted::new(unknowns);
        self.root = adapted.root();
        for step in 0..steps {
            let moved = self.step();
            let rate = 1.0 / libm::pow(step as f64 + 2.0, 0.7);
            let accepted = moved.iter().filter(|&&moved| moved).count() as f64 / count;
            adapted.follow(&self.places, self.generators.len(), accepted, rate);
            if step % RENEWAL == RENEWAL - 1 {
                self.root = adapted.root();
            }
        }
        self.root = adapted.root();
    }

    /// Draws kept, and shares accepted, chain by chain.
    fn draw(&mut self, steps: usize, thin: usize) -> (Vec<Vec<f64>>, Vec<f64>) {
        let count = self.generators.len();
        let mut theta = self.prior.centre();
        let mut kept = vec![Vec::with_capacity(steps / thin * theta.len()); count];
        let mut accepted = [0u32; GROUP];
        for step in 1..=steps {
            let moved = self.step();
            for (accepted, moved) in accepted.iter_mut().zip(moved) {
                *accepted += u32::from(moved);
            }
            if step % thin == 0 {
                for (chain, kept) in kept.iter_mut().enumerate() {
                    for (&quantity, place) in self.uncertain.iter().zip(&self.places) {
                        theta[quantity] = self.prior.priors()[quantity].from_line(place[chain]);
                    }
                    kept.extend_from_slice(&theta);
                }
            }
        }
        let shares = accepted[..count].iter().map(|&n| f64::from(n) / steps as f64);
        (kept, shares.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::Exact;

    fn paper() -> (RodPrior, Exact, Observation) {
        let prior = RodPrior::todi();
        let exact = Exact::new(*prior.parameterisation());
        let observation = Observation::first(&[4.492, 9.288, 13.252], 1.0).unwrap();
        (prior, exact, observation)
    }

    #[test]
    fn what_cannot_be_walked_on_is_named() {
        let (prior, exact, observation) = paper();
        let settings = McmcSettings {
            chains: 2,
            steps: 20,
            burn_in: 10,
            thin: 1,
        };
        let run = |prior: &RodPrior, observation: &Observation, settings| {
            let problem = Problem {
                prior,
                model: &exact,
                observation,
                discrepancy: &[0.0; 3],
            };
            super::run(&problem, &settings, 1)
        };
        assert_eq!(
            run(&prior, &observation, settings).map(|c| c.draws.len()),
            Ok(140)
        );
        let nothing = McmcSettings {
            burn_in: 20,
            ..settings
        };
        assert_eq!(
            run(&prior, &observation, nothing),
            Err(McmcError::Settings(nothing))
        );
        let sure = Observation::first(&[4.492], 0.0).unwrap();
        assert!(matches!(
            run(&prior, &sure, settings),
            Err(McmcError::Likelihood(_))
        ));
        let centre = prior.centre();
        let fixed = centre.iter().map(|&value| Prior::Fixed { value });
        let known = RodPrior::new(*prior.parameterisation(), fixed.collect()).unwrap();
        assert_eq!(
            run(&known, &observation, settings),
            Err(McmcError::NothingUncertain)
        );
    }
}
