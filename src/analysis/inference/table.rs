//! The simulated table: parameter vectors drawn from the prior with their model frequencies, drawn once
//! and reused for every record, and the standard normal noise every record reuses with it.

use super::column::{Column, Columns};
use super::joint::JointPosterior;
use crate::numerics::random::{self, BLOCK};
use crate::rod::beam::forward::ForwardModel;
use crate::rod::prior::RodPrior;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

/// Draws (theta, y_M) of prior and model.
///
/// Frequencies are kept as `f32`, block by block of [`BLOCK`] draws and within a block mode by mode;
/// their rounding, 6e-8 of the value, is a thousandth of the smallest standard error a record has.
/// Parameters are kept as `f32` of the uncertain quantities only, block by block, in columns that all tables of a site share
/// where they are equal; fixed ones stay exact.
/// A draw without an answer of the model has NaN in all modes.
#[derive(Debug)]
pub struct Table {
    fixed: Vec<f64>,
    uncertain: Vec<usize>,
    draws: usize,
    modes: usize,
    invalid: usize,
    parameters: Vec<Arc<Column>>,
    frequencies: Vec<f32>,
    logarithms: OnceLock<Vec<f64>>,
}

/// Number of draws among which an observation is placed.
pub(super) const PLACED: usize = 4096;

impl Table {
    /// Draws `draws` parameter vectors from the prior and computes `modes` frequencies of each. Block b uses
    /// stream b of `seed`, so the bits do not depend on the number of threads.
    pub fn draw(prior: &RodPrior, model: &dyn ForwardModel, modes: usize, draws: usize, seed: u64) -> Self {
        Self::conditioned(prior, model, None, modes, draws, seed, &Columns::default())
    }

    /// The same with everything but the axial force from the posterior of tests; the model's discrepancy is
    /// then part of the frequencies.
    fn conditioned(
        prior: &RodPrior,
        model: &dyn ForwardModel,
        statics: Option<&Statics>,
        modes: usize,
        draws: usize,
        seed: u64,
        columns: &Columns,
    ) -> Self {
        let width = prior.priors().len();
        let uncertain: Vec<usize> = (0..width).filter(|&i| !prior.priors()[i].is_fixed()).collect();
        let blocks = draws.div_ceil(BLOCK);
        columns.forget();
        // Rows beyond the last draw stay NaN: like invalid rows they are never accepted.
        let mut frequencies = vec![f32::NAN; blocks * BLOCK * modes];
        let found: Vec<(Vec<Arc<Column>>, usize)> = frequencies
            .par_chunks_mut(BLOCK * modes)
            .enumerate()
            .map_init(
                || (vec![0f64; BLOCK * width], vec![0f64; BLOCK * modes]),
                |(thetas, answers), (block, frequencies)| {
                    let rows = BLOCK.min(draws - block * BLOCK);
                    let thetas = &mut thetas[..rows * width];
                    let answers = &mut answers[..rows * modes];
                    let mut generator = random::stream(seed, block as u64);
                    let mut picked = [0; BLOCK];
                    for (theta, picked) in thetas.chunks_exact_mut(width).zip(&mut picked) {
                        prior.sample(&mut generator, theta);
                        if let Some(statics) = statics {
                            *picked = statics.pick(generator.random(), theta);
                        }
                    }
                    model.frequencies_of_many(thetas, modes, answers);
                    if let Some(statics) = statics {
                        for (answer, &row) in answers.chunks_exact_mut(modes).zip(&picked) {
                            statics.distort(row, answer);
                        }
                    }
                    let parameters = uncertain.iter().map(|&quantity| {
                        let mut values = [0f32; BLOCK];
                        for (value, theta) in values.iter_mut().zip(thetas.chunks_exact(width)) {
                            *value = theta[quantity] as f32;
                        }
                        columns.keep(&values)
                    });
                    let parameters = parameters.collect();
                    let mut invalid = 0;
                    for (row, answer) in answers.chunks_exact(modes).enumerate() {
                        if answer.iter().all(|f| f.is_finite() && *f > 0.0) {
                            for (mode, &frequency) in answer.iter().enumerate() {
                                frequencies[mode * BLOCK + row] = frequency as f32;
                            }
                        } else {
                            invalid += 1;
                        }
                    }
                    (parameters, invalid)
                },
            )
            .collect();
        Self {
            fixed: prior.centre(),
            uncertain,
            draws,
            modes,
            invalid: found.iter().map(|(_, invalid)| invalid).sum(),
            parameters: found.into_iter().flat_map(|(columns, _)| columns).collect(),
            frequencies,
            logarithms: OnceLock::new(),
        }
    }

    /// Number of draws.
    pub fn draws(&self) -> usize {
        self.draws
    }

    /// Number of mode orders, from the first.
    pub fn modes(&self) -> usize {
        self.modes
    }

    /// Number of draws for which the model has no answer.
    pub fn invalid(&self) -> usize {
        self.invalid
    }

    /// Number of entries of a parameter vector.
    pub fn width(&self) -> usize {
        self.fixed.len()
    }

    /// Address and size \[bytes\] of each piece of memory it holds; tables of a site share pieces.
    pub fn pieces(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let piece = |start: usize, length: usize| (start, 4 * length);
        let columns = self
            .parameters
            .iter()
            .map(move |column| piece(column.as_ptr() as usize, BLOCK));
        columns.chain([piece(self.frequencies.as_ptr() as usize, self.frequencies.len())])
    }

    /// Parameter vector of one draw.
    pub fn theta(&self, draw: usize, theta: &mut [f64]) {
        theta.copy_from_slice(&self.fixed);
        let width = self.uncertain.len();
        let columns = &self.parameters[draw / BLOCK * width..][..width];
        for (&quantity, column) in self.uncertain.iter().zip(columns) {
            theta[quantity] = f64::from(column[draw % BLOCK]);
        }
    }

    /// Model frequency of one draw \[Hz\], `mode` counted from zero; NaN for an invalid draw.
    pub fn frequency(&self, draw: usize, mode: usize) -> f32 {
        self.block(draw / BLOCK, mode)[draw % BLOCK]
    }

    /// Natural logarithms of the first [`PLACED`] draws' frequencies in one mode (counted from zero), NaN for invalid draws; each
    /// record asks for the same ones.
    pub(super) fn logarithms(&self, mode: usize) -> &[f64] {
        let draws = self.draws.min(PLACED);
        let all = self.logarithms.get_or_init(|| {
            let modes = 0..self.modes;
            modes
                .flat_map(|mode| (0..draws).map(move |draw| libm::log(f64::from(self.frequency(draw, mode)))))
                .collect()
        });
        &all[mode * draws..][..draws]
    }

    /// Model frequencies of one block in one mode (counted from zero), [`BLOCK`] entries; NaN where
    /// the draw is invalid or beyond the last.
    #[inline]
    pub fn block(&self, block: usize, mode: usize) -> &[f32] {
        &self.frequencies[(block * self.modes + mode) * BLOCK..][..BLOCK]
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.draws.div_ceil(BLOCK)
    }
}

/// Standard normal numbers, one column per mode and one entry per draw of a table, read cyclically.
///
/// A record with shift s pairs draw i with entry (i + s) mod S. For any fixed s this is a one-to-one
/// pairing of two independent samples, so the pairs (theta_i, z_(i+s)) are independent draws from the
/// generative model, and rejection on them is rejection ABC exactly. Only *between* records the same
/// numbers recur: their Monte Carlo errors are dependent, but each posterior is right.
#[derive(Debug, Clone)]
pub struct NoiseTable {
    draws: usize,
    columns: Vec<Arc<Vec<f32>>>,
}

impl NoiseTable {
    fn column(draws: usize, mode: usize, seed: u64) -> Vec<f32> {
        let mut column = vec![0f32; draws];
        column
            .par_chunks_mut(BLOCK)
            .enumerate()
            .for_each(|(block, values)| {
                let mut generator = random::stream(seed, ((mode as u64) << 32) | block as u64);
                for value in values {
                    let z: f64 = StandardNormal.sample(&mut generator);
                    *value = z as f32;
                }
            });
        // A block that starts before the end and reaches beyond it finds the beginning again here.
        for i in 0..BLOCK {
            column.push(column[i % draws]);
        }
        column
    }

    /// The [`BLOCK`] numbers of one mode (counted from zero) that belong to one block under a shift.
    #[inline]
    pub fn block(&self, block: usize, mode: usize, shift: usize) -> &[f32] {
        &self.columns[mode][(block * BLOCK + shift) % self.draws..][..BLOCK]
    }

    /// The number that belongs to one draw and mode (counted from zero) under a shift.
    pub fn at(&self, draw: usize, mode: usize, shift: usize) -> f32 {
        self.columns[mode][(draw + shift) % self.draws]
    }
}

/// Posterior of a rod after tests, without its force: a weighted sample of its parameters with the model's
/// discrepancies.
#[derive(Debug, Clone, PartialEq)]
pub struct Statics {
    width: usize,
    thetas: Vec<f64>,
    discrepancies: Vec<Vec<f64>>,
    cumulated: Vec<f64>,
}

impl Statics {
    /// Of a joint posterior of tests.
    pub fn of(found: &JointPosterior) -> Self {
        let mut sum = 0.0;
        Self {
            width: found.posterior.parameterisation.len(),
            thetas: found.posterior.particles.clone(),
            discrepancies: found.discrepancies.clone(),
            cumulated: found
                .posterior
                .weights
                .iter()
                .map(|weight| {
                    sum += weight;
                    sum
                })
                .collect(),
        }
    }

    /// Puts the particle at share `u` of the weight into `theta`, but for the axial force, which comes first.
    fn pick(&self, u: f64, theta: &mut [f64]) -> usize {
        let row = self
            .cumulated
            .partition_point(|&sum| sum <= u)
            .min(self.cumulated.len() - 1);
        theta[1..].copy_from_slice(&self.thetas[row * self.width + 1..][..self.width - 1]);
        row
    }

    /// Frequencies as the model with its discrepancy gives them.
    fn distort(&self, row: usize, frequencies: &mut [f64]) {
        for (f, c) in frequencies.iter_mut().zip(&self.discrepancies[row]) {
            *f *= 1.0 + c;
        }
    }
}

/// Everything that a table depends on; equal keys mean equal tables.
#[derive(Debug, PartialEq)]
struct Key {
    prior: RodPrior,
    model: &'static str,
    /// The model's answers at the first draws of the table, to the bit: two models of one name but
    /// with another order or number of elements differ here.
    probe: Vec<u64>,
    modes: usize,
    draws: usize,
    statics: Option<Arc<Statics>>,
}

/// A column of noise that some rod may still use.
#[derive(Debug)]
struct KnownColumn {
    draws: usize,
    mode: usize,
    values: Weak<Vec<f32>>,
}

/// A table that is drawn when it is first used. No plan depends on its content, so a site of many rods is
/// ready before all tables are drawn.
pub struct LaterTable {
    drawn: OnceLock<Table>,
    prior: RodPrior,
    model: Arc<dyn ForwardModel>,
    modes: usize,
    draws: usize,
    seed: u64,
    statics: Option<Arc<Statics>>,
    columns: Arc<Columns>,
}

impl LaterTable {
    /// The table; drawn now if it is not yet.
    pub fn get(&self) -> &Table {
        if let Some(table) = self.drawn.get() {
            return table;
        }
        // Nothing is held while drawing: a thread of the pool that waits for its share of the work could pick up another
        // record of the same rod and wait for itself. Drawn twice, it has the same bits.
        let table = Table::conditioned(
            &self.prior,
            self.model.as_ref(),
            self.statics.as_deref(),
            self.modes,
            self.draws,
            self.seed,
            &self.columns,
        );
        self.drawn.get_or_init(|| table)
    }

    /// Number of modes of each draw.
    pub fn modes(&self) -> usize {
        self.modes
    }
}

/// The tables of one site, shared between rods of equal prior, model, modes and number of draws.
pub struct Tables {
    seed: u64,
    simulated: Mutex<Vec<(Key, Weak<LaterTable>)>>,
    noise: Mutex<Vec<KnownColumn>>,
    columns: Arc<Columns>,
}

impl Tables {
    /// An empty set; its tables are drawn from `seed`.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            simulated: Mutex::default(),
            noise: Mutex::default(),
            columns: Arc::default(),
        }
    }

    /// Seed of all tables.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    fn stream_seed(&self, use_: &[u8]) -> u64 {
        random::seed(&[use_, &self.seed.to_le_bytes()])
    }

    /// Table of this prior and model: a new one, unless a rod still holds an equal one.
    pub fn simulated(
        &self,
        prior: &RodPrior,
        model: &Arc<dyn ForwardModel>,
        modes: usize,
        draws: usize,
        statics: Option<Arc<Statics>>,
    ) -> Arc<LaterTable> {
        let seed = self.stream_seed(b"simulated table");
        let key = Key {
            prior: prior.clone(),
            model: model.name(),
            probe: probe(prior, model.as_ref(), modes, seed),
            modes,
            draws,
            statics: statics.clone(),
        };
        let mut known = self.simulated.lock().unwrap_or_else(PoisonError::into_inner);
        known.retain(|(_, table)| table.strong_count() > 0);
        let equal = known.iter().find(|(other, _)| *other == key);
        if let Some(table) = equal.and_then(|(_, table)| table.upgrade()) {
            return table;
        }
        let table = Arc::new(LaterTable {
            drawn: OnceLock::new(),
            prior: prior.clone(),
            model: Arc::clone(model),
            modes,
            draws,
            seed,
            statics,
            columns: Arc::clone(&self.columns),
        });
        known.push((key, Arc::downgrade(&table)));
        table
    }

    /// Noise for tables of this many draws and modes; drawn now unless a rod still holds it.
    pub fn noise(&self, draws: usize, modes: usize) -> NoiseTable {
        let seed = self.stream_seed(b"noise table");
        let columns = (0..modes)
            .map(|mode| {
                let same = |known: &KnownColumn| known.draws == draws && known.mode == mode;
                if let Some(column) = find(&self.noise, same, |known| known.values.upgrade()) {
                    return column;
                }
                let column = Arc::new(NoiseTable::column(draws, mode, seed));
                let mut known = self.noise.lock().unwrap_or_else(PoisonError::into_inner);
                known.retain(|known| known.values.strong_count() > 0);
                known.push(KnownColumn {
                    draws,
                    mode,
                    values: Arc::downgrade(&column),
                });
                column
            })
            .collect();
        NoiseTable { draws, columns }
    }
}

fn find<E, T>(
    entries: &Mutex<Vec<E>>,
    same: impl Fn(&E) -> bool,
    held: impl Fn(&E) -> Option<Arc<T>>,
) -> Option<Arc<T>> {
    let entries = entries.lock().unwrap_or_else(PoisonError::into_inner);
    entries.iter().filter(|entry| same(entry)).find_map(held)
}

/// The model's answers at the first four draws, to the bit.
fn probe(prior: &RodPrior, model: &dyn ForwardModel, modes: usize, seed: u64) -> Vec<u64> {
    let width = prior.priors().len();
    let mut generator = random::stream(seed, 0);
    let mut thetas = vec![0f64; 4 * width];
    for theta in thetas.chunks_exact_mut(width) {
        prior.sample(&mut generator, theta);
    }
    let mut answers = vec![0f64; 4 * modes];
    model.frequencies_of_many(&thetas, modes, &mut answers);
    answers.iter().map(|f| f.to_bits()).collect()
}
