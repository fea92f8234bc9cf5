//! A weighted population and the mixture of t kernels around it that proposes the next.
//!
//! Where the posterior is thin and bent each kernel is multiplied with the density of the data, by the derivatives at its own place: what is
//! left of it lies along the posterior there, however thin that is.
//!
//! Coordinates are the priors' real lines ([`Prior::to_line`]), whitened by the population's covariance. The mixture is a kernel
//! density of the population plus one wide t about its mean, so that no region the population missed has weights without bound.

use super::density::{Mask, Problem};
use super::kernels::Kernels;
use crate::numerics::random;
use crate::rod::prior::Prior;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Number of proposals per random stream.
const BLOCK: usize = 256;

/// Share of the wide component, and its width in standard deviations.
const WIDE: (f64, f64) = (0.15, 1.6);

/// Points with weights, their model answers and densities.
#[derive(Debug, Clone, Default)]
pub(super) struct Population {
    /// Parameter vectors, row-major.
    pub(super) thetas: Vec<f64>,
    /// Model answers to all data, row-major.
    pub(super) answers: Vec<f64>,
    /// Log likelihood of the data that count.
    pub(super) likelihood: Vec<f64>,
    /// Log of prior over proposal density.
    pub(super) base: Vec<f64>,
}

impl Population {
    /// Normalised weights `prior / proposal * likelihood^share`.
    pub(super) fn weights(&self, share: f64) -> Vec<f64> {
        let logs: Vec<f64> = self
            .base
            .iter()
            .zip(&self.likelihood)
            // An impossible point stays impossible at any share; 0 * infinity is none.
            .map(|(base, l)| {
                if *l == f64::NEG_INFINITY {
                    *l
                } else {
                    base + share * l
                }
            })
            .collect();
        let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if highest == f64::NEG_INFINITY {
            return vec![0.0; logs.len()];
        }
        let mut weights: Vec<f64> = logs.iter().map(|l| libm::exp(l - highest)).collect();
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= total);
        weights
    }
}

/// Effective sample size of weights that sum to one; 0 if all are zero.
pub(super) fn effective(weights: &[f64]) -> f64 {
    let squares: f64 = weights.iter().map(|w| w * w).sum();
    if squares > 0.0 { 1.0 / squares } else { 0.0 }
}

/// Step of a derivative, in standard deviations of the population.
const STEP: f64 = 1e-4;

/// Variance of a sharpened kernel over that of the linear model: answers bend.
const SLACK: f64 = 1.3;

/// One kernel: its centre, and a root of its covariance with the inverse and the determinant.
struct Kernel {
    centre: DVector<f64>,
    root: DMatrix<f64>,
    inverse: DMatrix<f64>,
    /// 1 / det(root).
    density: f64,
}

/// The mixture.
pub(super) struct Mixture<'a> {
    problem: &'a Problem,
    uncertain: &'a [usize],
    mean: DVector<f64>,
    root: DMatrix<f64>,
    /// In whitened coordinates.
    kernels: Vec<Kernel>,
    /// Degrees of freedom of all components, such that (freedom + dimensions) is even.
    freedom: usize,
}

impl<'a> Mixture<'a> {
    /// Round kernels about equally weighted ancestors (row-major parameter vectors); `None` where they have no spread.
    pub(super) fn around(problem: &'a Problem, uncertain: &'a [usize], ancestors: &[f64]) -> Option<Self> {
        let width = problem.priors.len();
        let d = uncertain.len();
        let count = ancestors.len() / width;
        let rows: Vec<DVector<f64>> = ancestors
            .chunks_exact(width)
            .map(|theta| {
                DVector::from_fn(d, |slot, _| {
                    let quantity = uncertain[slot];
                    problem.priors[quantity].to_line(theta[quantity])
                })
            })
            .collect();
        let all: Vec<&DVector<f64>> = rows.iter().collect();
        let (mean, root) = spread(&all)?;
        let centres: Vec<DVector<f64>> = rows
            .iter()
            .map(|row| root.solve_lower_triangular(&(row - &mean)))
            .collect::<Option<_>>()?;
        // Silverman's rule.
        let exponent = 1.0 / (d as f64 + 4.0);
        let bandwidth = (4.0 / ((d as f64 + 2.0) * count as f64)).powf(exponent);
        let round = DMatrix::from_diagonal_element(d, d, bandwidth);
        Some(Self {
            problem,
            uncertain,
            mean,
            root,
            kernels: centres
                .into_iter()
                .map(|centre| Kernel::new(centre, round.clone()))
                .collect::<Option<_>>()?,
            freedom: 6 - d % 2,
        })
    }

    /// Each kernel times the density of the data in `mask` to the power `share`, for posteriors that are thin and bent.
    pub(super) fn sharpened(self, mask: &Mask, share: f64) -> Option<Self> {
        let kernels = self.kernels.par_iter();
        let kernels = kernels
            .map(|kernel| self.sharp(kernel, mask, share))
            .collect::<Option<_>>()?;
        Some(Self { kernels, ..self })
    }

    /// The normal kernel times that density with the answers linear about its centre; as it is where the model has no derivative there.
    fn sharp(&self, kernel: &Kernel, mask: &Mask, share: f64) -> Option<Kernel> {
        let at = |z: &DVector<f64>| {
            let mut answers = DVector::zeros(self.problem.data.len());
            self.problem.answer(&self.point(z).1, answers.as_mut_slice());
            answers
        };
        let here = at(&kernel.centre);
        let columns: Vec<DVector<f64>> = (0..self.uncertain.len())
            .map(|i| {
                let mut beside = kernel.centre.clone();
                beside[i] += STEP;
                (at(&beside) - &here) / STEP
            })
            .collect();
        let derivatives = DMatrix::from_columns(&columns);
        let (information, slope) = self.problem.information(here.as_slice(), &derivatives, mask);
        let precision = kernel.inverse.tr_mul(&kernel.inverse) + information * share;
        let Some(sharp) = precision
            .cholesky()
            .filter(|_| slope.iter().all(|x| x.is_finite()))
        else {
            return Kernel::new(kernel.centre.clone(), kernel.root.clone());
        };
        let centre = &kernel.centre + sharp.solve(&slope) * share;
        Kernel::new(centre, (sharp.inverse() * SLACK).cholesky()?.l())
    }

    /// `count` proposals with answers and densities; the same bits at any number of threads.
    pub(super) fn propose(&self, count: usize, mask: &Mask, seed: u64) -> Population {
        let kernels = self.kernels.iter();
        let kernels = Kernels::new(
            kernels.map(|kernel| (&kernel.centre, &kernel.inverse, kernel.density)),
            self.uncertain.len(),
            self.freedom,
        );
        let blocks: Vec<Population> = (0..count.div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let rows = BLOCK.min(count - block * BLOCK);
                self.block(rows, &kernels, mask, random::stream(seed, block as u64))
            })
            .collect();
        let mut all = Population::default();
        for mut block in blocks {
            all.thetas.append(&mut block.thetas);
            all.answers.append(&mut block.answers);
            all.likelihood.append(&mut block.likelihood);
            all.base.append(&mut block.base);
        }
        all
    }

    fn block(&self, rows: usize, kernels: &Kernels, mask: &Mask, mut generator: ChaCha8Rng) -> Population {
        let d = self.uncertain.len();
        let count = self.kernels.len();
        let data = self.problem.data.len();
        let mut population = Population::default();
        let normal = |generator: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(generator) };
        for _ in 0..rows {
            let is_wide = generator.random::<f64>() < WIDE.0;
            let ancestor = ((generator.random::<f64>() * count as f64) as usize).min(count - 1);
            let chi: f64 = (0..self.freedom).map(|_| normal(&mut generator).powi(2)).sum();
            let scale = (self.freedom as f64 / chi).sqrt();
            let step = DVector::from_fn(d, |_, _| scale * normal(&mut generator));
            let z = match is_wide {
                true => step * WIDE.1,
                false => &self.kernels[ancestor].centre + &self.kernels[ancestor].root * step,
            };
            let (prior, theta) = self.point(&z);
            let start = population.answers.len();
            population.answers.resize(start + data, f64::NAN);
            let mut likelihood = f64::NEG_INFINITY;
            if prior.is_finite() {
                let answers = &mut population.answers[start..];
                self.problem.answer(&theta, answers);
                likelihood = self.problem.log_density(answers, mask);
            }
            population.thetas.extend(theta);
            population.likelihood.push(likelihood);
            population
                .base
                .push(prior - libm::log(self.density(kernels, z.as_slice())));
        }
        population
    }

    /// Log density of the prior, and the parameters, at whitened coordinates.
    fn point(&self, z: &DVector<f64>) -> (f64, Vec<f64>) {
        let line = &self.mean + &self.root * z;
        let mut theta: Vec<f64> = self.problem.priors.iter().map(Prior::centre).collect();
        let mut prior = 0.0;
        for (slot, &quantity) in self.uncertain.iter().enumerate() {
            let own = &self.problem.priors[quantity];
            theta[quantity] = own.from_line(line[slot]);
            prior += own.log_density_on_line(theta[quantity], line[slot]);
        }
        (prior, theta)
    }

    /// Density of the mixture up to a constant.
    fn density(&self, kernels: &Kernels, z: &[f64]) -> f64 {
        let d = z.len();
        let power = -(((self.freedom + d) / 2) as i32);
        let square: f64 = z.iter().map(|z| z * z).sum();
        let wide =
            (1.0 + square / (self.freedom as f64 * WIDE.1 * WIDE.1)).powi(power) * WIDE.1.powi(-(d as i32));
        (1.0 - WIDE.0) * kernels.density(z) / self.kernels.len() as f64 + WIDE.0 * wide
    }
}

impl Kernel {
    fn new(centre: DVector<f64>, root: DMatrix<f64>) -> Option<Self> {
        let determinant: f64 = root.diagonal().iter().product();
        Some(Self {
            inverse: root.solve_lower_triangular(&DMatrix::identity(root.nrows(), root.nrows()))?,
            density: 1.0 / determinant,
            centre,
            root,
        })
    }
}

/// Mean of points, and a root of their covariance.
pub(super) fn spread(points: &[&DVector<f64>]) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let count = points.len() as f64;
    let d = points.first()?.len();
    let mean = points.iter().fold(DVector::zeros(d), |sum, point| sum + *point) / count;
    let mut covariance = DMatrix::zeros(d, d);
    for point in points {
        let away = *point - &mean;
        covariance += &away * away.transpose() / count;
    }
    for j in 0..d {
        // Kernels need a width in every direction, were it only for numbers' sake.
        covariance[(j, j)] = covariance[(j, j)] * (1.0 + 1e-9) + 1e-18;
    }
    Some((mean, covariance.cholesky()?.l()))
}
