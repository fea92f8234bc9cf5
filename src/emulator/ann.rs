//! The abstract's second surrogate: a small multilayer perceptron, trained on the design of the Hermite chaos.
//!
//! Two hidden layers; germs in, standardised logarithms of the frequencies out, by mini-batch Adam on the mean
//! square error. The activation x / sqrt(1 + x^2) is smooth, as slopes need, and made of operations that every
//! processor rounds alike; sums are taken in a fixed order. The same design and seed give the same bits.

use super::design::Design;
use super::domain::Domain;
use super::expansion::LANES;
use super::training::Training;
use super::validate::{self, ErrorReport};
use crate::bayes::RodPrior;
use crate::beam::{Exact, Parameterisation};
use crate::forward::{FEW, ForwardModel, MAX_MODES, OutsideRange};
use crate::random;
use crate::wide::{Kernel, vectorised};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Neurons of each hidden layer.
const HIDDEN: [usize; 2] = [32, 32];
/// Points whose gradients are summed side by side, and such blocks a step of the optimiser.
const BLOCK: usize = 64;
const BLOCKS: usize = 4;
/// Rate of the first and of the last step; between them it falls along a cosine.
const RATE: (f64, f64) = (4e-3, 2e-6);
/// Adam's memory of gradients and of their squares (Kingma and Ba 2015).
const MEMORY: (f64, f64) = (0.9, 0.999);
/// Passes over the design unless told otherwise.
pub const EPOCHS: usize = 150;

/// A trained perceptron.
#[derive(Debug, Clone)]
pub struct Ann {
    prior: RodPrior,
    domain: Domain,
    network: Network,
    /// Mean and standard deviation of the logarithm of each mode's frequency on the design.
    scale: Vec<(f64, f64)>,
    report: ErrorReport,
}

impl Ann {
    /// Trains on solves made for a chaos, and judges; `epochs` passes over the design, of which `passed` is told.
    pub fn train(
        prior: &RodPrior,
        training: &Training,
        epochs: usize,
        seed: u64,
        passed: &(dyn Fn() + Sync),
    ) -> Self {
        let design = &training.design;
        let points = design.len();
        let domain = Domain::new("perceptron", prior, design);
        let inputs = germs(prior, design);
        let logs: Vec<Vec<f64>> = training
            .values
            .iter()
            .map(|values| values.iter().map(|f| libm::log(*f)).collect())
            .collect();
        let scale: Vec<(f64, f64)> = logs.iter().map(|logs| moments(logs)).collect();
        let targets = (0..points).flat_map(|point| {
            let modes = logs.iter().zip(&scale);
            modes.map(move |(logs, (mean, sd))| (logs[point] - mean) / sd)
        });
        let targets: Vec<f64> = targets.collect();
        let mut network = Network::new(
            &[domain.axes.len(), HIDDEN[0], HIDDEN[1], MAX_MODES],
            &mut random::stream(seed, 0),
        );
        let mut adam = Adam::new(network.weights());
        let steps = epochs * points.div_ceil(BLOCK * BLOCKS);
        let mut order: Vec<usize> = (0..points).collect();
        let mut step = 0;
        for epoch in 0..epochs {
            shuffle(&mut order, &mut random::stream(seed, 1 + epoch as u64));
            for batch in order.chunks(BLOCK * BLOCKS) {
                let share = step as f64 / steps as f64;
                let rate = RATE.1 + (RATE.0 - RATE.1) * 0.5 * (1.0 + libm::cos(std::f64::consts::PI * share));
                let gradient = network.gradient(&inputs, &targets, batch);
                adam.step(&mut network, &gradient, rate);
                step += 1;
            }
            passed();
        }
        let mut ann = Self {
            prior: prior.clone(),
            domain,
            network,
            scale,
            report: ErrorReport::default(),
        };
        let exact = Exact::new(*prior.parameterisation());
        let sample = (validate::SAMPLE, validate::SEED);
        ann.report = validate::on_prior(&ann, None, &exact, prior, sample, &|_| ());
        ann
    }

    /// Its errors against the exact model over the prior; draws outside the design's box left out.
    pub fn report(&self) -> &ErrorReport {
        &self.report
    }

    /// Frequencies at `L` points given by their germs, mode by mode.
    #[inline(always)]
    fn block<const L: usize>(&self, germs: &[[f64; L]], scratch: &mut [Vec<[f64; L]>], out: &mut [[f64; L]]) {
        self.network.forward(germs, scratch);
        let Some(last) = scratch.last() else { return };
        for ((out, values), (mean, sd)) in out.iter_mut().zip(last).zip(&self.scale) {
            for l in 0..L {
                out[l] = mean + sd * values[l];
            }
        }
    }

    fn scratch<const L: usize>(&self) -> Vec<Vec<[f64; L]>> {
        let layers = self.network.layers.iter();
        layers.map(|layer| vec![[0.0; L]; layer.bias.len()]).collect()
    }
}

/// Germs of the design's points, row by row.
fn germs(prior: &RodPrior, design: &Design) -> Vec<f64> {
    let mut theta = vec![0.0; prior.parameterisation().len()];
    let mut all = Vec::with_capacity(design.len() * design.axes.len());
    for point in 0..design.len() {
        design.theta(point, &mut theta);
        all.extend(
            design
                .axes
                .iter()
                .map(|axis| axis.germ.germ(theta[axis.germ.index])),
        );
    }
    all
}

/// Mean and standard deviation.
fn moments(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|x| (x - mean) * (x - mean)).sum();
    (mean, (square / count).sqrt())
}

/// Fisher and Yates.
fn shuffle(order: &mut [usize], generator: &mut ChaCha8Rng) {
    for i in (1..order.len()).rev() {
        order.swap(i, generator.random_range(0..=i));
    }
}

/// One layer: weights row by row (outputs x inputs), and a bias per output.
#[derive(Debug, Clone, PartialEq)]
struct Layer {
    weights: Vec<f64>,
    bias: Vec<f64>,
}

/// Layers with the activation between them, none after the last.
#[derive(Debug, Clone, PartialEq)]
struct Network {
    layers: Vec<Layer>,
}

impl Network {
    /// Random weights of variance 1 / inputs, no bias.
    fn new(widths: &[usize], generator: &mut ChaCha8Rng) -> Self {
        let layer = |pair: &[usize]| {
            let size = (pair[0] as f64).sqrt().recip();
            let weights = (0..pair[0] * pair[1]).map(|_| {
                let z: f64 = StandardNormal.sample(generator);
                size * z
            });
            Layer {
                weights: weights.collect(),
                bias: vec![0.0; pair[1]],
            }
        };
        Self {
            layers: widths.windows(2).map(layer).collect(),
        }
    }

    /// Every weight and bias in the order of the gradient.
    fn iter_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        let layers = self.layers.iter_mut();
        layers.flat_map(|layer| layer.weights.iter_mut().chain(&mut layer.bias))
    }

    fn weights(&self) -> usize {
        let layers = self.layers.iter();
        layers.map(|layer| layer.weights.len() + layer.bias.len()).sum()
    }

    /// The values of every layer, after its activation, at `L` points.
    #[inline(always)]
    fn forward<const L: usize>(&self, input: &[[f64; L]], values: &mut [Vec<[f64; L]>]) {
        let last = self.layers.len() - 1;
        for (at, layer) in self.layers.iter().enumerate() {
            let (before, rest) = values.split_at_mut(at);
            let input = before.last().map_or(input, Vec::as_slice);
            let rows = layer.weights.chunks_exact(input.len());
            for ((out, row), bias) in rest[0].iter_mut().zip(rows).zip(&layer.bias) {
                let mut sum = [*bias; L];
                for (weight, x) in row.iter().zip(input) {
                    for l in 0..L {
                        sum[l] += weight * x[l];
                    }
                }
                if at < last {
                    for value in &mut sum {
                        *value /= (1.0 + *value * *value).sqrt();
                    }
                }
                *out = sum;
            }
        }
    }

    /// Gradient of the mean square error over a batch of points, in the order of the layers, weights first.
    fn gradient(&self, inputs: &[f64], targets: &[f64], batch: &[usize]) -> Vec<f64> {
        let blocks: Vec<Vec<f64>> = batch
            .par_chunks(BLOCK)
            .map(|points| {
                let mut gradient = vec![0.0; self.weights()];
                vectorised(Backward {
                    network: self,
                    inputs,
                    targets,
                    points,
                    gradient: &mut gradient,
                });
                gradient
            })
            .collect();
        let mut sum = vec![0.0; self.weights()];
        let share = 1.0 / batch.len() as f64;
        for block in &blocks {
            for (sum, part) in sum.iter_mut().zip(block) {
                *sum += share * part;
            }
        }
        sum
    }
}

/// Values forward and errors backward for up to [`BLOCK`] points.
struct Backward<'a> {
    network: &'a Network,
    inputs: &'a [f64],
    targets: &'a [f64],
    points: &'a [usize],
    gradient: &'a mut [f64],
}

/// Sum over the lanes in a fixed order that wide vectors can follow.
#[inline(always)]
fn dot(a: &[f64; BLOCK], b: &[f64; BLOCK]) -> f64 {
    let mut sums = [0.0; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for k in 0..8 {
            sums[k] += a[k] * b[k];
        }
    }
    ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))
}

impl Kernel for Backward<'_> {
    #[inline(always)]
    fn run(self) {
        let layers = &self.network.layers;
        let outputs = layers[layers.len() - 1].bias.len();
        let variables = layers[0].weights.len() / layers[0].bias.len();
        let mut input = vec![[0.0; BLOCK]; variables];
        for (l, &point) in self.points.iter().enumerate() {
            for (i, input) in input.iter_mut().enumerate() {
                input[l] = self.inputs[point * variables + i];
            }
        }
        let mut values: Vec<Vec<[f64; BLOCK]>> = layers
            .iter()
            .map(|layer| vec![[0.0; BLOCK]; layer.bias.len()])
            .collect();
        self.network.forward(&input, &mut values);
        // Lanes beyond the last point have no error.
        let mut errors = vec![[0.0; BLOCK]; outputs];
        for (l, &point) in self.points.iter().enumerate() {
            for (mode, error) in errors.iter_mut().enumerate() {
                error[l] = 2.0 * (values[layers.len() - 1][mode][l] - self.targets[point * outputs + mode]);
            }
        }
        let mut rest = self.gradient;
        for (at, layer) in layers.iter().enumerate().rev() {
            let before = if at > 0 { &values[at - 1] } else { &input };
            let own = layer.weights.len() + layer.bias.len();
            let (head, gradient) = rest.split_at_mut(rest.len() - own);
            rest = head;
            let (weights, bias) = gradient.split_at_mut(layer.weights.len());
            for ((row, bias), error) in weights.chunks_exact_mut(before.len()).zip(bias).zip(&errors) {
                *bias = error.iter().sum();
                for (weight, x) in row.iter_mut().zip(before) {
                    *weight = dot(error, x);
                }
            }
            if at == 0 {
                break;
            }
            let mut next = vec![[0.0; BLOCK]; before.len()];
            for (row, error) in layer.weights.chunks_exact(before.len()).zip(&errors) {
                for (next, weight) in next.iter_mut().zip(row) {
                    for l in 0..BLOCK {
                        next[l] += weight * error[l];
                    }
                }
            }
            // With y = x / sqrt(1 + x^2) the slope is (1 - y^2)^(3/2).
            for (next, y) in next.iter_mut().zip(before) {
                for l in 0..BLOCK {
                    let rest = 1.0 - y[l] * y[l];
                    next[l] *= rest * rest.sqrt();
                }
            }
            errors = next;
        }
    }
}

/// Adam's state.
struct Adam {
    mean: Vec<f64>,
    square: Vec<f64>,
    /// Powers of the memories.
    left: (f64, f64),
}

impl Adam {
    fn new(weights: usize) -> Self {
        Self {
            mean: vec![0.0; weights],
            square: vec![0.0; weights],
            left: (1.0, 1.0),
        }
    }

    fn step(&mut self, network: &mut Network, gradient: &[f64], rate: f64) {
        self.left = (self.left.0 * MEMORY.0, self.left.1 * MEMORY.1);
        let weights = network.iter_mut();
        let state = self.mean.iter_mut().zip(&mut self.square);
        for ((weight, slope), (mean, square)) in weights.zip(gradient).zip(state) {
            *mean += (1.0 - MEMORY.0) * (slope - *mean);
            *square += (1.0 - MEMORY.1) * (slope * slope - *square);
            let (m, v) = (*mean / (1.0 - self.left.0), *square / (1.0 - self.left.1));
            *weight -= rate * m / (v.sqrt() + 1e-8);
        }
    }
}

/// [`Ann::block`] as work to be vectorised.
struct Block<'a> {
    ann: &'a Ann,
    germs: &'a [[f64; LANES]],
    scratch: &'a mut [Vec<[f64; LANES]>],
    out: &'a mut [[f64; LANES]],
}

impl Kernel for Block<'_> {
    #[inline(always)]
    fn run(self) {
        self.ann.block(self.germs, self.scratch, self.out);
    }
}

impl ForwardModel for Ann {
    fn name(&self) -> &'static str {
        "ann"
    }

    fn parameterisation(&self) -> &Parameterisation {
        self.prior.parameterisation()
    }

    fn modes(&self) -> usize {
        MAX_MODES
    }

    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        self.domain.check(theta)?;
        let axes = self.domain.axes.iter();
        let germs: Vec<[f64; 1]> = axes
            .map(|axis| [axis.germ.germ(theta[axis.germ.index])])
            .collect();
        let mut rows = [[0.0]; MAX_MODES];
        self.block(&germs, &mut self.scratch(), &mut rows);
        out.iter_mut()
            .zip(rows)
            .for_each(|(out, [log])| *out = libm::exp(log));
        Ok(())
    }

    fn frequencies_of_many(&self, thetas: &[f64], modes: usize, out: &mut [f64]) {
        let width = self.parameterisation().len();
        let mut rows = [[0.0; LANES]; MAX_MODES];
        let mut germs = vec![[0.0; LANES]; self.domain.axes.len()];
        let mut scratch = self.scratch();
        for (thetas, out) in thetas.chunks(LANES * width).zip(out.chunks_mut(LANES * modes)) {
            if thetas.len() / width < FEW {
                self.one_by_one(thetas, modes, out);
                continue;
            }
            for (l, theta) in thetas.chunks_exact(width).enumerate() {
                for (axis, z) in self.domain.axes.iter().zip(&mut germs) {
                    z[l] = axis.germ.germ(theta[axis.germ.index]);
                }
            }
            vectorised(Block {
                ann: self,
                germs: &germs,
                scratch: &mut scratch,
                out: &mut rows,
            });
            let points = thetas.chunks_exact(width).zip(out.chunks_exact_mut(modes));
            for (l, (theta, out)) in points.enumerate() {
                let mut axes = self.domain.axes.iter().zip(&germs);
                let inside = axes.all(|(axis, z)| axis.holds(z[l])) && self.domain.has_fixed(theta);
                for (out, row) in out.iter_mut().zip(&rows) {
                    *out = if inside { libm::exp(row[l]) } else { f64::NAN };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_is_that_of_differences() {
        let mut generator = random::stream(2, 0);
        let mut network = Network::new(&[2, 5, 4, 3], &mut generator);
        let mut numbers = |count: usize| -> Vec<f64> {
            (0..count)
                .map(|_| StandardNormal.sample(&mut generator))
                .collect()
        };
        // More points than a block, and not a whole number of blocks.
        let (inputs, targets) = (numbers(2 * 100), numbers(3 * 100));
        let batch: Vec<usize> = (0..100).collect();
        let gradient = network.gradient(&inputs, &targets, &batch);
        let loss = |network: &Network| -> f64 {
            let mut values = vec![vec![[0.0]; 5], vec![[0.0]; 4], vec![[0.0]; 3]];
            let square = |point: usize| -> f64 {
                network.forward(&[[inputs[2 * point]], [inputs[2 * point + 1]]], &mut values);
                (0..3)
                    .map(|i| (values[2][i][0] - targets[3 * point + i]).powi(2))
                    .sum()
            };
            batch.iter().copied().map(square).sum::<f64>() / 100.0
        };
        let step = 1e-6;
        for (i, gradient) in gradient.iter().enumerate() {
            let at = |by: f64| {
                let mut moved = network.clone();
                if let Some(weight) = moved.iter_mut().nth(i) {
                    *weight += by;
                }
                loss(&moved)
            };
            let difference = (at(step) - at(-step)) / (2.0 * step);
            assert!(
                (difference - gradient).abs() < 1e-7,
                "{i} {difference} {gradient}"
            );
        }
        assert_eq!(gradient.len(), network.iter_mut().count());
    }

    #[test]
    fn the_same_bits_alone_in_a_block_and_at_any_number_of_threads() {
        let prior = RodPrior::todi();
        let Ok(training) = Training::solve(&prior, 2, 20, &|_, _| ()) else {
            panic!("a small chaos can be solved");
        };
        let train = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| Ann::train(&prior, &training, 300, 5, &|| ()))
        };
        let ann = train(1);
        assert_eq!(ann.network, train(3).network);
        let mut generator = random::stream(9, 0);
        let mut thetas = vec![0.0; 50 * 7];
        for theta in thetas.chunks_exact_mut(7) {
            prior.sample(&mut generator, theta);
        }
        let (mut block, mut alone) = (vec![0.0; 150], vec![0.0; 150]);
        ann.frequencies_of_many(&thetas, 3, &mut block);
        ann.one_by_one(&thetas, 3, &mut alone);
        assert!(block.iter().any(|f| f.is_nan()) && block.iter().any(|f| *f > 0.0));
        assert_eq!(
            block.iter().map(|f| f.to_bits()).collect::<Vec<_>>(),
            alone.iter().map(|f| f.to_bits()).collect::<Vec<_>>()
        );
        // Three hundred passes over 729 points already know the rod to a few per cent.
        let report = ann.report();
        assert!(
            report.modes[..3].iter().all(|mode| mode.relative.rms < 0.05),
            "{report:?}"
        );
    }
}
