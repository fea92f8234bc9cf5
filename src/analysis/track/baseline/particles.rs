//! Particles of a rod's parameters given its baseline's frequencies: approximate Bayesian computation with the error's
//! density as the kernel, exact for the model (Wilkinson 2013), by draws from the prior, tempering and Metropolis moves.
//!
//! The kernel is `exp(-chi^2 / 2)`, `chi^2 = sum_n (ln f_n(theta) - y_n)^2 / (b_n^2 + sd_n^2)`, b_n the model's relative
//! discrepancy. Draws from the prior are weighted by the kernel to a power lambda <= 1, the largest that leaves enough
//! effective draws, and resampled; the power is raised to one in as many stages as that takes, and after each one
//! the particles move by Metropolis steps that leave their distribution as it is (Del Moral et al. 2006).

use crate::numerics::random::{self, BLOCK};
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::prior::RodPrior;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Number of draws from the prior.
const DRAWS: usize = 16 * BLOCK;

/// Number of Metropolis steps after the last stage, and after each earlier one.
const LAST_MOVES: usize = 12;
const MOVES: usize = 6;

/// Most stages: beyond, the frequencies lie outside everything that the prior allows.
const STAGES: usize = 40;

/// Halvings of the interval that contains a stage's power.
const HALVINGS: usize = 20;

/// Target of one mode's frequency.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Target {
    /// Mode order, from 1.
    pub order: usize,
    /// y_n.
    pub level: f64,
    /// b_n^2 + sd_n^2.
    pub variance: f64,
}

/// Parameter vectors and their log-frequencies.
#[derive(Debug, Clone)]
pub(crate) struct Population {
    width: usize,
    modes: usize,
    /// Row-major, particles x quantities.
    pub thetas: Vec<f64>,
    /// Row-major, particles x modes; NaN where the model has no answer.
    log_frequencies: Vec<f64>,
}

impl Population {
    /// Draws from the prior and their first `modes` frequencies.
    pub fn of_prior(prior: &RodPrior, model: &dyn ForwardModel, modes: usize, seed: u64) -> Self {
        let width = prior.parameterisation().len();
        let mut thetas = vec![0.0; DRAWS * width];
        for (block, thetas) in thetas.chunks_mut(BLOCK * width).enumerate() {
            let mut generator = random::stream(seed, block as u64);
            for theta in thetas.chunks_exact_mut(width) {
                prior.sample(&mut generator, theta);
            }
        }
        let mut log_frequencies = vec![0.0; DRAWS * modes];
        log_frequencies_of(model, &thetas, modes, &mut log_frequencies);
        Self {
            width,
            modes,
            thetas,
            log_frequencies,
        }
    }

    /// chi^2 of every particle, infinite where the model has no answer.
    fn squares(&self, targets: &[Target]) -> Vec<f64> {
        self.log_frequencies
            .chunks_exact(self.modes)
            .map(|row| square(row, targets))
            .collect()
    }

    /// Resamples `count` particles in proportion to `weights`, systematically (Kitagawa 1996).
    fn resampled(&self, weights: &[f64], count: usize, generator: &mut ChaCha8Rng) -> Self {
        let step = weights.iter().sum::<f64>() / count as f64;
        let mut reach = step * generator.random::<f64>();
        let mut thetas = Vec::with_capacity(count * self.width);
        let mut log_frequencies = Vec::with_capacity(count * self.modes);
        let mut sum = 0.0;
        let mut last = 0;
        for (i, weight) in weights.iter().enumerate() {
            sum += weight;
            if *weight > 0.0 {
                last = i;
            }
            while sum > reach && thetas.len() < count * self.width {
                thetas.extend_from_slice(&self.thetas[i * self.width..][..self.width]);
                log_frequencies.extend_from_slice(&self.log_frequencies[i * self.modes..][..self.modes]);
                reach += step;
            }
        }
        // Rounding may leave the last place empty.
        while thetas.len() < count * self.width {
            thetas.extend_from_slice(&self.thetas[last * self.width..][..self.width]);
            log_frequencies.extend_from_slice(&self.log_frequencies[last * self.modes..][..self.modes]);
        }
        Self {
            width: self.width,
            modes: self.modes,
            thetas,
            log_frequencies,
        }
    }

    /// A few particles near the targets, tempered as far as needed and not moved; `None` if no particle has
    /// frequencies.
    pub fn pilot(&self, targets: &[Target], count: usize, seed: u64) -> Option<Self> {
        let squares = self.squares(targets);
        let power = largest_power(&squares, 1.0, count as f64)?;
        let weights = weights(&squares, power);
        Some(self.resampled(&weights, count, &mut random::stream(seed, 0)))
    }

    /// Particles of equal weight from the posterior, and the smallest chi among them. `None` if the frequencies are out
    /// of the prior's reach.
    pub fn posterior(
        &self,
        targets: &[Target],
        prior: &RodPrior,
        model: &dyn ForwardModel,
        count: usize,
        seed: u64,
    ) -> Option<(Self, f64)> {
        let mut generator = random::stream(seed, 0);
        let mut squares = self.squares(targets);
        let mut done = 0.0;
        let mut population = None;
        for _ in 0..STAGES {
            let source = population.as_ref().unwrap_or(self);
            let wanted = if population.is_none() { 2.0 } else { 0.5 } * count as f64;
            let step = largest_power(&squares, 1.0 - done, wanted.min(0.25 * squares.len() as f64))?;
            let weights = weights(&squares, step);
            let mut next = source.resampled(&weights, count, &mut generator);
            // A step that rounds away would never arrive.
            let finished = step >= 1.0 - done;
            done = if finished { 1.0 } else { done + step };
            next.squares_into(targets, &mut squares);
            let moves = if finished { LAST_MOVES } else { MOVES };
            next.rejuvenate(targets, &mut squares, done, moves, prior, model, &mut generator);
            if finished {
                let least = squares.iter().fold(f64::INFINITY, |least, s| least.min(*s));
                return Some((next, least.sqrt()));
            }
            population = Some(next);
        }
        None
    }

    fn squares_into(&self, targets: &[Target], squares: &mut Vec<f64>) {
        squares.clear();
        squares.extend(
            self.log_frequencies
                .chunks_exact(self.modes)
                .map(|row| square(row, targets)),
        );
    }

    /// Metropolis steps in the logarithms of the uncertain quantities, shaped by the particles' covariance.
    #[expect(clippy::too_many_arguments, reason = "the target density in its parts")]
    fn rejuvenate(
        &mut self,
        targets: &[Target],
        squares: &mut [f64],
        power: f64,
        moves: usize,
        prior: &RodPrior,
        model: &dyn ForwardModel,
        generator: &mut ChaCha8Rng,
    ) {
        let free: Vec<usize> = (0..self.width)
            .filter(|&i| !prior.priors()[i].is_fixed())
            .collect();
        let count = squares.len();
        let Some(shape) = self.shape(&free) else {
            return;
        };
        let mut densities: Vec<f64> = self
            .thetas
            .chunks_exact(self.width)
            .map(|theta| log_density(prior, &free, theta))
            .collect();
        let mut proposed = self.thetas.clone();
        let mut answers = vec![0.0; count * self.modes];
        let mut normals = DVector::zeros(free.len());
        for step in 0..moves {
            // The scale that is best for a normal (Roberts et al. 1997), and half of it where it is none.
            let scale = 2.38 / (free.len() as f64).sqrt() * if step % 2 == 0 { 1.0 } else { 0.5 };
            proposed.copy_from_slice(&self.thetas);
            for theta in proposed.chunks_exact_mut(self.width) {
                normals
                    .iter_mut()
                    .for_each(|z| *z = StandardNormal.sample(generator));
                let jump = &shape * &normals;
                for (&quantity, jump) in free.iter().zip(jump.iter()) {
                    theta[quantity] *= libm::exp(scale * jump);
                }
            }
            log_frequencies_of(model, &proposed, self.modes, &mut answers);
            for i in 0..count {
                let chance: f64 = generator.random();
                let theta = &proposed[i * self.width..][..self.width];
                let answer = &answers[i * self.modes..][..self.modes];
                let (density, new) = (log_density(prior, &free, theta), square(answer, targets));
                let log_ratio = density - densities[i] - 0.5 * power * (new - squares[i]);
                // A particle that is NaN compares as false and stays.
                if libm::log(chance) < log_ratio {
                    self.thetas[i * self.width..][..self.width].copy_from_slice(theta);
                    self.log_frequencies[i * self.modes..][..self.modes].copy_from_slice(answer);
                    densities[i] = density;
                    squares[i] = new;
                }
            }
        }
    }

    /// The Cholesky factor of the covariance of the logarithms of the quantities in `free`.
    fn shape(&self, free: &[usize]) -> Option<DMatrix<f64>> {
        if free.is_empty() {
            return None;
        }
        let count = self.thetas.len() / self.width;
        let logs = DMatrix::from_fn(count, free.len(), |i, j| {
            libm::log(self.thetas[i * self.width + free[j]])
        });
        let mean = logs.row_mean();
        let centred = DMatrix::from_fn(count, free.len(), |i, j| logs[(i, j)] - mean[j]);
        let mut covariance = centred.transpose() * &centred / count as f64;
        for i in 0..free.len() {
            // Duplicates of one particle have no spread of their own.
            covariance[(i, i)] += 1e-9 + 1e-6 * covariance[(i, i)];
        }
        covariance.cholesky().map(|factor| factor.unpack())
    }
}

/// The prior's density in the logarithms of the uncertain quantities.
fn log_density(prior: &RodPrior, free: &[usize], theta: &[f64]) -> f64 {
    free.iter()
        .map(|&i| prior.priors()[i].log_density(theta[i]) + libm::log(theta[i]))
        .sum()
}

fn square(row: &[f64], targets: &[Target]) -> f64 {
    let sum: f64 = targets
        .iter()
        .map(|target| (row[target.order - 1] - target.level).powi(2) / target.variance)
        .sum();
    if sum.is_nan() { f64::INFINITY } else { sum }
}

fn weights(squares: &[f64], power: f64) -> Vec<f64> {
    let least = squares.iter().fold(f64::INFINITY, |least, s| least.min(*s));
    squares
        .iter()
        .map(|s| libm::exp(-0.5 * power * (s - least)))
        .collect()
}

/// Largest power up to `most` that leaves an effective sample size of `wanted` (if any does). `None` if no
/// particle has frequencies.
fn largest_power(squares: &[f64], most: f64, wanted: f64) -> Option<f64> {
    if !squares.iter().any(|s| s.is_finite()) {
        return None;
    }
    let enough = |power: f64| {
        let weights = weights(squares, power);
        let sum: f64 = weights.iter().sum();
        let sum_of_squares: f64 = weights.iter().map(|w| w * w).sum();
        sum * sum >= wanted * sum_of_squares
    };
    if enough(most) {
        return Some(most);
    }
    // By magnitude: kernels may be narrower than the prior by orders.
    let (mut low, mut high) = (-30.0 * std::f64::consts::LN_2, 0.0);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if enough(most * libm::exp(middle)) {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(most * libm::exp(low))
}

/// ln f of many parameter vectors, NaN where the model has no answer.
pub(crate) fn log_frequencies_of(model: &dyn ForwardModel, thetas: &[f64], modes: usize, out: &mut [f64]) {
    debug_assert!(modes <= MAX_MODES);
    model.frequencies_of_many(thetas, modes, out);
    out.iter_mut().for_each(|f| *f = libm::log(*f));
}
