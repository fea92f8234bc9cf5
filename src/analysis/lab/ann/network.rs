//! Layers of a perceptron, the gradient of its error, and the optimiser that follows it.

use crate::numerics::simd::{Kernel, vectorised};
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Points whose gradients are summed side by side.
const BLOCK: usize = 64;
/// Points of one step of the optimiser.
pub(super) const BATCH: usize = 4 * BLOCK;
/// Adam's memory of gradients and of their squares (Kingma and Ba 2015).
const MEMORY: (f64, f64) = (0.9, 0.999);

/// One layer: weights row by row (outputs x inputs), and a bias per output.
#[derive(Debug, Clone, PartialEq)]
struct Layer {
    weights: Vec<f64>,
    bias: Vec<f64>,
}

/// Layers with the activation between them, none after the last.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Network {
    layers: Vec<Layer>,
}

impl Network {
    /// Random weights of variance 1 / inputs, no bias.
    pub(super) fn new(widths: &[usize], generator: &mut ChaCha8Rng) -> Self {
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
    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        let layers = self.layers.iter_mut();
        layers.flat_map(|layer| layer.weights.iter_mut().chain(&mut layer.bias))
    }

    pub(super) fn weights(&self) -> usize {
        let layers = self.layers.iter();
        layers.map(|layer| layer.weights.len() + layer.bias.len()).sum()
    }

    /// Buffers for the values of every layer at `L` points.
    pub(super) fn scratch<const L: usize>(&self) -> Vec<Vec<[f64; L]>> {
        let layers = self.layers.iter();
        layers.map(|layer| vec![[0.0; L]; layer.bias.len()]).collect()
    }

    /// The values of every layer, after its activation, at `L` points.
    #[inline(always)]
    pub(super) fn forward<const L: usize>(&self, input: &[[f64; L]], values: &mut [Vec<[f64; L]>]) {
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
    pub(super) fn gradient(&self, inputs: &[f64], targets: &[f64], batch: &[usize]) -> Vec<f64> {
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
        let mut values = self.network.scratch();
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
pub(super) struct Adam {
    mean: Vec<f64>,
    square: Vec<f64>,
    /// Powers of the memories reached so far.
    left: (f64, f64),
}

impl Adam {
    pub(super) fn new(weights: usize) -> Self {
        Self {
            mean: vec![0.0; weights],
            square: vec![0.0; weights],
            left: (1.0, 1.0),
        }
    }

    pub(super) fn step(&mut self, network: &mut Network, gradient: &[f64], rate: f64) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

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
}
