//! Sequential ABC: a sequence of weighted populations with shrinking tolerance (population Monte Carlo:
//! Beaumont, Cornuet, Marin and Robert 2009; Toni et al. 2009).
//!
//! Generation 0 is drawn from the prior. Generation t proposes theta' = theta_j + L z with j drawn by
//! weight and L L' twice the weighted covariance of generation t - 1, simulates y', and keeps it if
//! d(y', y_0) <= epsilon_t; its weight is pi(theta') / sum_j w_j K(theta' | theta_j). Proposals outside
//! the prior's support are drawn again, ancestor included, which changes no ratio of weights.

use super::abc::Accepted;
use super::distance::Target;
use super::posterior::Stop;
use super::{AbcSettings, Accept};
use crate::numerics::{diagnostics, random};
use crate::rod::beam::forward::ForwardModel;
use crate::rod::prior::RodPrior;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Number of proposals that share one stream and one call of the model.
const PROPOSALS: usize = 256;

/// Number of blocks of proposals evaluated before acceptance is counted: a fixed number, so that the
/// amount of work done does not depend on the number of threads.
const ROUND: usize = 16;

/// Settings of a sequence of populations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SequentialSettings {
    /// Number of particles of a population.
    pub population: usize,
    /// Quantile of the accepted distances that becomes the next tolerance, from 0 to 1.
    pub shrink: f64,
    /// Tolerance at which the sequence ends.
    pub target_epsilon: Option<f64>,
    /// Least share of proposals that a generation must accept, or it is given up.
    pub min_acceptance: f64,
    /// Most populations, the first included.
    pub max_generations: usize,
    /// Most model evaluations.
    pub budget: usize,
}

impl From<&AbcSettings> for SequentialSettings {
    /// Takes the draws as the budget. A quantile alpha gives the population size it would accept by
    /// rejection; an epsilon is the target, with populations of 2000.
    fn from(settings: &AbcSettings) -> Self {
        let (population, target_epsilon) = match settings.accept {
            Accept::Quantile(alpha) => (super::abc::count_of(alpha, settings.draws), None),
            Accept::Epsilon(epsilon) => (2000.min(settings.draws / 4), Some(epsilon)),
        };
        Self {
            population,
            shrink: 0.5,
            target_epsilon,
            min_acceptance: 0.01,
            max_generations: 40,
            budget: settings.draws,
        }
    }
}

/// Result of a sequence: the last complete population.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Its particles, simulated frequencies and distances.
    pub accepted: Accepted,
    /// Weights of the particles, of sum one.
    pub weights: Vec<f64>,
    /// Number of model evaluations of all generations.
    pub draws: usize,
    /// Number of evaluations without an answer.
    pub invalid: usize,
    /// Number of populations, the first included.
    pub generations: usize,
    /// Reason why the sequence ended.
    pub stop: Stop,
}

/// Runs the sequence. The same seed gives the same bits at any thread count; quantities with a fixed
/// prior keep their value. Always returns the last complete population.
pub fn run(
    prior: &RodPrior,
    model: &dyn ForwardModel,
    target: &Target,
    settings: &SequentialSettings,
    seed: u64,
) -> Run {
    let proposer = Proposer::new(prior, model, target);
    let first = ((settings.population as f64 / settings.shrink) as usize).clamp(1, settings.budget.max(1));
    let mut tried = Draws::default();
    let mut block = 0;
    while tried.distances.len() < first {
        tried.append(proposer.blocks(seed, 0, block, &Source::Prior));
        block += ROUND as u64;
    }
    let (mut draws, mut invalid) = (tried.distances.len(), tried.invalid);
    let mut population = tried.nearest(settings.population, proposer.width, proposer.modes());
    let mut weights = vec![1.0 / population.distances.len().max(1) as f64; population.distances.len()];
    let mut generations = 1;
    let stop = loop {
        let reached = |epsilon| settings.target_epsilon.is_some_and(|wanted| epsilon <= wanted);
        if reached(population.epsilon) {
            break Stop::TargetReached;
        }
        if generations >= settings.max_generations {
            break Stop::MaxGenerations;
        }
        if population.distances.len() < settings.population {
            // Too few valid draws in the prior to begin with.
            break Stop::AcceptanceTooLow;
        }
        let quantile = diagnostics::quantiles(&population.distances, &weights, &[settings.shrink])[0];
        let epsilon = quantile.max(settings.target_epsilon.unwrap_or(0.0));
        if epsilon >= population.epsilon * (1.0 - 1e-6) {
            break Stop::Stalled;
        }
        let source = Source::population(&population, &weights, &proposer);
        let mut next = Draws::default();
        let (mut proposals, mut block) = (0, 0);
        let most = (settings.population as f64 / settings.min_acceptance) as usize;
        while next.distances.len() < settings.population && proposals < most && draws < settings.budget {
            let mut tried = proposer.blocks(seed, generations as u64, block, &source);
            block += ROUND as u64;
            proposals += tried.distances.len();
            draws += tried.distances.len();
            invalid += tried.invalid;
            tried.retain_within(epsilon, proposer.width, proposer.modes());
            next.append(tried);
        }
        if next.distances.len() < settings.population {
            break if proposals >= most {
                Stop::AcceptanceTooLow
            } else {
                Stop::BudgetUsed
            };
        }
        next.truncate(settings.population, proposer.width, proposer.modes());
        weights = source.importance(&next.thetas, &proposer);
        population = Accepted {
            particles: next.thetas,
            simulated: next.simulated,
            distances: next.distances,
            epsilon,
        };
        generations += 1;
    };
    Run {
        accepted: population,
        weights,
        draws,
        invalid,
        generations,
        stop,
    }
}

/// Draws of the generative model; an invalid one has an infinite distance.
#[derive(Default)]
struct Draws {
    thetas: Vec<f64>,
    simulated: Vec<f64>,
    distances: Vec<f64>,
    invalid: usize,
}

impl Draws {
    fn append(&mut self, mut other: Self) {
        self.thetas.append(&mut other.thetas);
        self.simulated.append(&mut other.simulated);
        self.distances.append(&mut other.distances);
        self.invalid += other.invalid;
    }

    fn truncate(&mut self, count: usize, width: usize, modes: usize) {
        self.thetas.truncate(count * width);
        self.simulated.truncate(count * modes);
        self.distances.truncate(count);
    }

    fn select(&self, rows: &[usize], width: usize, modes: usize) -> Self {
        Self {
            thetas: rows
                .iter()
                .flat_map(|&i| &self.thetas[i * width..][..width])
                .copied()
                .collect(),
            simulated: rows
                .iter()
                .flat_map(|&i| &self.simulated[i * modes..][..modes])
                .copied()
                .collect(),
            distances: rows.iter().map(|&i| self.distances[i]).collect(),
            invalid: self.invalid,
        }
    }

    fn retain_within(&mut self, epsilon: f64, width: usize, modes: usize) {
        let rows: Vec<usize> = (0..self.distances.len())
            .filter(|&i| self.distances[i] <= epsilon)
            .collect();
        *self = self.select(&rows, width, modes);
    }

    fn nearest(&self, count: usize, width: usize, modes: usize) -> Accepted {
        let mut rows: Vec<usize> = (0..self.distances.len())
            .filter(|&i| self.distances[i].is_finite())
            .collect();
        rows.sort_by(|&a, &b| self.distances[a].total_cmp(&self.distances[b]));
        rows.truncate(count);
        let kept = self.select(&rows, width, modes);
        Accepted {
            epsilon: kept.distances.last().copied().unwrap_or(f64::INFINITY),
            particles: kept.thetas,
            simulated: kept.simulated,
            distances: kept.distances,
        }
    }
}

/// Source of the proposals.
enum Source {
    Prior,
    Population {
        /// Uncertain quantities of the ancestors in the coordinates of the walk, row-major.
        ancestors: Vec<f64>,
        weights: Vec<f64>,
        /// Cumulated weights.
        cumulated: Vec<f64>,
        /// Lower triangle of the kernel's covariance.
        kernel: DMatrix<f64>,
    },
}

struct Proposer<'a> {
    prior: &'a RodPrior,
    model: &'a dyn ForwardModel,
    target: &'a Target,
    uncertain: Vec<usize>,
    width: usize,
    /// Number of model frequencies needed: up to the highest observed mode.
    asked: usize,
}

impl<'a> Proposer<'a> {
    fn new(prior: &'a RodPrior, model: &'a dyn ForwardModel, target: &'a Target) -> Self {
        let priors = prior.priors();
        Self {
            prior,
            model,
            target,
            uncertain: (0..priors.len()).filter(|&i| !priors[i].is_fixed()).collect(),
            width: priors.len(),
            asked: target.terms().iter().map(|term| term.mode + 1).max().unwrap_or(1),
        }
    }

    fn modes(&self) -> usize {
        self.target.terms().len()
    }

    /// One round of blocks, numbered on from `first`, in the order of their numbers.
    fn blocks(&self, seed: u64, generation: u64, first: u64, source: &Source) -> Draws {
        let blocks: Vec<Draws> = (first..first + ROUND as u64)
            .into_par_iter()
            .map(|block| self.block(random::stream(seed, (generation << 40) | block), source))
            .collect();
        let mut all = Draws::default();
        blocks.into_iter().for_each(|draws| all.append(draws));
        all
    }

    fn block(&self, mut generator: ChaCha8Rng, source: &Source) -> Draws {
        let mut thetas = vec![0.0; PROPOSALS * self.width];
        for theta in thetas.chunks_exact_mut(self.width) {
            self.propose(source, &mut generator, theta);
        }
        let mut answers = vec![0.0; PROPOSALS * self.asked];
        self.model.frequencies_of_many(&thetas, self.asked, &mut answers);
        let mut simulated = Vec::with_capacity(PROPOSALS * self.modes());
        let mut distances = Vec::with_capacity(PROPOSALS);
        let mut invalid = 0;
        for answer in answers.chunks_exact(self.asked) {
            let start = simulated.len();
            for term in self.target.terms() {
                let z: f64 = StandardNormal.sample(&mut generator);
                let y = Target::simulated(term, answer[term.mode] as f32, z as f32);
                simulated.push(f64::from(y));
            }
            let squared = self.target.distance_squared(simulated[start..].iter().copied());
            if squared.is_finite() {
                distances.push(squared.sqrt());
            } else {
                invalid += 1;
                distances.push(f64::INFINITY);
            }
        }
        Draws {
            thetas,
            simulated,
            distances,
            invalid,
        }
    }

    fn propose(&self, source: &Source, generator: &mut ChaCha8Rng, theta: &mut [f64]) {
        let Source::Population {
            ancestors,
            cumulated,
            kernel,
            ..
        } = source
        else {
            return self.prior.sample(generator, theta);
        };
        let free = self.uncertain.len();
        theta.copy_from_slice(&self.prior.centre());
        // Ancestors lie inside the support, so at least a good part of all moves do.
        loop {
            let u: f64 = generator.random();
            let ancestor = cumulated
                .partition_point(|&sum| sum <= u)
                .min(cumulated.len() - 1);
            let z = DVector::from_fn(free, |_, _| StandardNormal.sample(generator));
            let step = kernel * z;
            for (slot, &quantity) in self.uncertain.iter().enumerate() {
                let place = ancestors[ancestor * free + slot] + step[slot];
                theta[quantity] = self.prior.priors()[quantity].from_walk(place);
            }
            if self.prior.log_density_of_walk(theta) > f64::NEG_INFINITY {
                return;
            }
        }
    }
}

impl Source {
    fn population(population: &Accepted, weights: &[f64], proposer: &Proposer<'_>) -> Self {
        let ancestors = proposer.free_columns(&population.particles);
        let mut sum = 0.0;
        let cumulated = weights
            .iter()
            .map(|weight| {
                sum += weight;
                sum
            })
            .collect();
        Self::Population {
            kernel: twice_covariance_root(&ancestors, weights, proposer.uncertain.len()),
            ancestors,
            weights: weights.to_vec(),
            cumulated,
        }
    }

    /// Weights pi(theta) / sum_j w_j K(theta | theta_j), normalised.
    fn importance(&self, thetas: &[f64], proposer: &Proposer<'_>) -> Vec<f64> {
        let Self::Population {
            ancestors,
            weights,
            kernel,
            ..
        } = self
        else {
            let points = thetas.len() / proposer.width;
            return vec![1.0 / points as f64; points];
        };
        let free = proposer.uncertain.len();
        let ancestors = whitened(kernel, ancestors, free);
        let points = whitened(kernel, &proposer.free_columns(thetas), free);
        let mut logarithms: Vec<f64> = thetas
            .par_chunks_exact(proposer.width)
            .zip(points.par_chunks_exact(free.max(1)))
            .map(|(theta, point)| {
                let density: f64 = ancestors
                    .chunks_exact(free.max(1))
                    .zip(weights)
                    .map(|(ancestor, weight)| {
                        let squared: f64 = point.iter().zip(ancestor).map(|(a, b)| (a - b) * (a - b)).sum();
                        weight * libm::exp(-0.5 * squared)
                    })
                    .sum();
                proposer.prior.log_density_of_walk(theta) - libm::log(density)
            })
            .collect();
        let highest = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        logarithms
            .iter_mut()
            .for_each(|value| *value = libm::exp(*value - highest));
        let total: f64 = logarithms.iter().sum();
        logarithms.iter_mut().for_each(|value| *value /= total);
        logarithms
    }
}

impl Proposer<'_> {
    fn free_columns(&self, thetas: &[f64]) -> Vec<f64> {
        thetas
            .chunks_exact(self.width)
            .flat_map(|theta| {
                let priors = self.prior.priors();
                self.uncertain
                    .iter()
                    .map(|&quantity| priors[quantity].to_walk(theta[quantity]))
            })
            .collect()
    }
}

/// Rows solved against the lower triangle: coordinates in which the kernel is a standard normal.
fn whitened(kernel: &DMatrix<f64>, rows: &[f64], free: usize) -> Vec<f64> {
    let columns = DMatrix::from_column_slice(free, rows.len() / free.max(1), rows);
    match kernel.solve_lower_triangular(&columns) {
        Some(solved) => solved.as_slice().to_vec(),
        None => rows.to_vec(),
    }
}

/// Lower Cholesky triangle of twice the weighted covariance of `rows` (points x free). A population
/// without spread in some direction gets a thousandth of its scale there, so that the triangle exists.
fn twice_covariance_root(rows: &[f64], weights: &[f64], free: usize) -> DMatrix<f64> {
    let column = |slot: usize| {
        rows.iter()
            .skip(slot)
            .step_by(free)
            .copied()
            .collect::<Vec<f64>>()
    };
    let columns: Vec<Vec<f64>> = (0..free).map(column).collect();
    let means: Vec<f64> = columns
        .iter()
        .map(|values| diagnostics::mean(values, weights))
        .collect();
    let covariance = DMatrix::from_fn(free, free, |i, j| {
        columns[i]
            .iter()
            .zip(&columns[j])
            .zip(weights)
            .map(|((a, b), w)| 2.0 * w * (a - means[i]) * (b - means[j]))
            .sum()
    });
    if let Some(cholesky) = covariance.clone().cholesky() {
        return cholesky.l();
    }
    let diagonal = DVector::from_fn(free, |i, _| {
        covariance[(i, i)]
            .sqrt()
            .max(1e-3 * means[i].abs())
            .max(f64::MIN_POSITIVE)
    });
    DMatrix::from_diagonal(&diagonal)
}
