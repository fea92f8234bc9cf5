//! Layers of a perceptron, and its error over a set of points with the gradient of that.

use crate::wide::{Kernel, vectorised};
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Points whose gradients are summed side by side.
const BLOCK: usize = 64;
/// Points that are one piece of parallel work.
const PIECE: usize = 16 * BLOCK;

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

    /// Every weight and bias, layer by layer, weights first.
    pub(super) fn weights(&self) -> Vec<f64> {
        let layers = self.layers.iter();
        layers
            .flat_map(|layer| layer.weights.iter().chain(&layer.bias))
            .copied()
            .collect()
    }

    /// The same layers with these weights, in the order of [`Network::weights`].
    pub(super) fn with_weights(&self, weights: &[f64]) -> Self {
        let mut network = self.clone();
        let layers = network.layers.iter_mut();
        let own = layers.flat_map(|layer| layer.weights.iter_mut().chain(&mut layer.bias));
        own.zip(weights).for_each(|(own, weight)| *own = *weight);
        network
    }

    /// Room for the values of every layer at `L` points.
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

    /// Mean over the points of the squared error, and its gradient in the order of [`Network::weights`]; the
    /// sums are taken in an order that does not depend on the number of threads.
    pub(super) fn error_and_gradient(&self, points: &Points) -> (f64, Vec<f64>) {
        let count = points.targets.len() / self.outputs();
        let pieces: Vec<(f64, Vec<f64>)> = (0..count.div_ceil(PIECE))
            .into_par_iter()
            .map(|piece| {
                let begin = piece * PIECE;
                let (mut error, mut gradient) = (0.0, vec![0.0; self.weights().len()]);
                for first in (begin..count.min(begin + PIECE)).step_by(BLOCK) {
                    vectorised(Backward {
                        network: self,
                        points,
                        lanes: first..count.min(first + BLOCK),
                        error: &mut error,
                        gradient: &mut gradient,
                    });
                }
                (error, gradient)
            })
            .collect();
        let (mut error, mut gradient) = (0.0, vec![0.0; self.weights().len()]);
        let share = 1.0 / count as f64;
        for (part, slopes) in &pieces {
            error += share * part;
            for (sum, slope) in gradient.iter_mut().zip(slopes) {
                *sum += share * slope;
            }
        }
        (error, gradient)
    }

    fn outputs(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.bias.len())
    }
}

/// Points to learn: inputs and wanted outputs, point by point.
pub(super) struct Points {
    pub(super) inputs: Vec<f64>,
    pub(super) targets: Vec<f64>,
}

/// Values forward and errors backward for up to [`BLOCK`] points; adds to error and gradient.
struct Backward<'a> {
    network: &'a Network,
    points: &'a Points,
    lanes: std::ops::Range<usize>,
    error: &'a mut f64,
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
        for (l, point) in self.lanes.clone().enumerate() {
            for (i, input) in input.iter_mut().enumerate() {
                input[l] = self.points.inputs[point * variables + i];
            }
        }
        let mut values = self.network.scratch();
        self.network.forward(&input, &mut values);
        // Lanes beyond the last point have no error.
        let mut errors = vec![[0.0; BLOCK]; outputs];
        for (mode, error) in errors.iter_mut().enumerate() {
            for (l, point) in self.lanes.clone().enumerate() {
                error[l] = values[layers.len() - 1][mode][l] - self.points.targets[point * outputs + mode];
            }
            *self.error += dot(error, error);
            error.iter_mut().for_each(|error| *error *= 2.0);
        }
        let mut rest = self.gradient;
        for (at, layer) in layers.iter().enumerate().rev() {
            let before = if at > 0 { &values[at - 1] } else { &input };
            let own = layer.weights.len() + layer.bias.len();
            let (head, gradient) = rest.split_at_mut(rest.len() - own);
            rest = head;
            let (weights, bias) = gradient.split_at_mut(layer.weights.len());
            for ((row, bias), error) in weights.chunks_exact_mut(before.len()).zip(bias).zip(&errors) {
                *bias += error.iter().sum::<f64>();
                for (weight, x) in row.iter_mut().zip(before) {
                    *weight += dot(error, x);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random;

    #[test]
    fn the_gradient_is_that_of_differences() {
        let mut generator = random::stream(2, 0);
        let network = Network::new(&[2, 5, 4, 3], &mut generator);
        let mut numbers = |count: usize| -> Vec<f64> {
            (0..count)
                .map(|_| StandardNormal.sample(&mut generator))
                .collect()
        };
        // More points than a block, and not a whole number of blocks.
        let points = Points {
            inputs: numbers(2 * 100),
            targets: numbers(3 * 100),
        };
        let loss = |network: &Network| -> f64 {
            let mut values = vec![vec![[0.0]; 5], vec![[0.0]; 4], vec![[0.0]; 3]];
            let square = |point: usize| -> f64 {
                let x = &points.inputs[2 * point..];
                network.forward(&[[x[0]], [x[1]]], &mut values);
                (0..3)
                    .map(|i| (values[2][i][0] - points.targets[3 * point + i]).powi(2))
                    .sum()
            };
            (0..100).map(square).sum::<f64>() / 100.0
        };
        let (error, gradient) = network.error_and_gradient(&points);
        assert!((error - loss(&network)).abs() < 1e-12);
        let weights = network.weights();
        assert_eq!(gradient.len(), weights.len());
        let step = 1e-6;
        for (i, gradient) in gradient.iter().enumerate() {
            let at = |by: f64| {
                let mut moved = weights.clone();
                moved[i] += by;
                loss(&network.with_weights(&moved))
            };
            let difference = (at(step) - at(-step)) / (2.0 * step);
            assert!(
                (difference - gradient).abs() < 1e-7,
                "{i} {difference} {gradient}"
            );
        }
    }
}
