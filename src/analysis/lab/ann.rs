//! The abstract's second surrogate: a small multilayer perceptron, trained on the design of the Hermite chaos.
//!
//! Two hidden layers; germs in, standardised logarithms of the frequencies out, by mini-batch Adam on the mean
//! square error. The activation x / sqrt(1 + x^2) is smooth, as slopes need, and made of operations that every
//! processor rounds alike; sums are taken in a fixed order. The same design and seed give the same bits.

mod network;

use crate::numerics::random;
use crate::numerics::simd::{Kernel, vectorised};
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::beam::{Exact, OutsideRange, Parameterisation};
use crate::rod::emulator::design::Design;
use crate::rod::emulator::domain::Domain;
use crate::rod::emulator::expansion::LANES;
use crate::rod::emulator::training::Training;
use crate::rod::emulator::validate::{self, ErrorReport};
use crate::rod::prior::RodPrior;
use network::{Adam, BATCH, Network};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;

/// Neurons of each hidden layer.
const HIDDEN: [usize; 2] = [32, 32];
/// Rate of the first and of the last step; between them the rate falls along a cosine.
const RATE: (f64, f64) = (4e-3, 2e-6);
/// Default number of passes over the design.
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
    /// Trains on the solves made for a chaos, with `epochs` passes over the design, and measures the errors.
    pub fn train(prior: &RodPrior, training: &Training, epochs: usize, seed: u64) -> Self {
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
        let steps = epochs * points.div_ceil(BATCH);
        let mut order: Vec<usize> = (0..points).collect();
        let mut step = 0;
        for epoch in 0..epochs {
            shuffle(&mut order, &mut random::stream(seed, 1 + epoch as u64));
            for batch in order.chunks(BATCH) {
                let share = step as f64 / steps as f64;
                let rate = RATE.1 + (RATE.0 - RATE.1) * 0.5 * (1.0 + libm::cos(std::f64::consts::PI * share));
                let gradient = network.gradient(&inputs, &targets, batch);
                adam.step(&mut network, &gradient, rate);
                step += 1;
            }
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

    /// Errors against the exact model over the prior; draws outside the design's box left out.
    pub fn report(&self) -> &ErrorReport {
        &self.report
    }

    /// Frequencies \[Hz\] at `L` points given by their germs, mode by mode.
    #[inline(always)]
    fn block<const L: usize>(&self, germs: &[[f64; L]], scratch: &mut [Vec<[f64; L]>], out: &mut [[f64; L]]) {
        self.network.forward(germs, scratch);
        let Some(last) = scratch.last() else { return };
        for ((out, values), (mean, sd)) in out.iter_mut().zip(last).zip(&self.scale) {
            for l in 0..L {
                out[l] = libm::exp(mean + sd * values[l]);
            }
        }
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
        let mut rows = [[0.0]; MAX_MODES];
        self.block(
            &self.domain.germs(theta),
            &mut self.network.scratch(),
            &mut rows[..out.len()],
        );
        out.iter_mut().zip(rows).for_each(|(out, [f])| *out = f);
        Ok(())
    }

    fn frequencies_of_many(&self, thetas: &[f64], modes: usize, out: &mut [f64]) {
        let mut scratch = self.network.scratch();
        self.domain.in_blocks(self, (thetas, modes, out), |germs, rows| {
            vectorised(Block {
                ann: self,
                germs,
                scratch: &mut scratch,
                out: rows,
            });
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            pool.install(|| Ann::train(&prior, &training, 300, 5))
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
        // Three hundred passes over 729 points already fit the rod to a few per cent.
        let report = ann.report();
        assert!(
            report.modes[..3].iter().all(|mode| mode.relative.rms < 0.05),
            "{report:?}"
        );
    }
}
