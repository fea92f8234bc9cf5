//! Draws from the prior with answers to all data: rejection's nearest, and the gate for data that no rod has.

use super::JointError;
use super::density::{Mask, Problem};
use crate::inference::adjust;
use crate::numerics::random;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Share of the pilot that is kept.
const KEPT: f64 = 0.02;

/// Draws from the prior with the model's answers, drawn once for all posteriors of these data.
pub(super) struct Pilot {
    /// Number of draws.
    pub(super) rows: usize,
    /// Parameter vectors, row-major.
    pub(super) thetas: Vec<f64>,
    /// Answers with the errors of the data.
    answers: Vec<f64>,
    /// Answers of the model alone.
    model: Vec<f64>,
}

/// Distance of a datum from the middle of the prior's answers, over that of the end of 99 % of them, above which no rod has it.
const OUTSIDE: f64 = 2.2;
/// Normal deviate of the ends of 99 %.
const END: f64 = 2.576;
/// A block's parameters, its answers with errors, and those of the model.
type Block = (Vec<f64>, Vec<f64>, Vec<f64>);

/// Number of draws per random stream.
const BLOCK: usize = 256;

impl Pilot {
    /// Draws of the prior, with answers that have the errors of the data.
    pub(super) fn drawn(problem: &Problem, count: usize, seed: u64) -> Self {
        let seed = random::seed(&[b"joint pilot", &seed.to_le_bytes()]);
        let (width, data) = (problem.priors.len(), problem.data.len());
        let blocks: Vec<Block> = (0..count.div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let mut generator: ChaCha8Rng = random::stream(seed, block as u64);
                let mut thetas = vec![0.0; BLOCK * width];
                let mut answers = vec![0.0; BLOCK * data];
                let mut model = vec![0.0; BLOCK * data];
                let rows = answers.chunks_exact_mut(data).zip(model.chunks_exact_mut(data));
                for (theta, (out, exact)) in thetas.chunks_exact_mut(width).zip(rows) {
                    for (value, prior) in theta.iter_mut().zip(&problem.priors) {
                        *value = prior.sample(&mut generator);
                    }
                    problem.answer(theta, out);
                    exact.copy_from_slice(out);
                    for (i, y) in out.iter_mut().enumerate() {
                        let z: f64 = StandardNormal.sample(&mut generator);
                        *y += problem.spread(i, *y) * z;
                    }
                }
                (thetas, answers, model)
            })
            .collect();
        let mut pilot = Self {
            rows: 0,
            thetas: Vec::new(),
            answers: Vec::new(),
            model: Vec::new(),
        };
        for (thetas, answers, model) in blocks {
            let rows = answers.chunks_exact(data).zip(model.chunks_exact(data));
            for (theta, (out, exact)) in thetas.chunks_exact(width).zip(rows) {
                if out.iter().all(|y| y.is_finite()) {
                    pilot.thetas.extend(theta);
                    pilot.answers.extend(out);
                    pilot.model.extend(exact);
                    pilot.rows += 1;
                }
            }
        }
        pilot
    }

    fn column(answers: &[f64], problem: &Problem, datum: usize) -> Vec<f64> {
        let data = problem.data.len();
        answers.iter().skip(datum).step_by(data).copied().collect()
    }

    /// Refuses a datum that lies 2.2 times as far from the middle of the model's answers as the end of 99 % of them, the datum's own
    /// error included: fewer than one in a million normal ones do.
    ///
    /// Errors are taken as relative: one of 3 % of a value a thousand times too large is thirty true values, and must not widen the
    /// range that the value is held against.
    pub(super) fn refuse_outsiders(&self, problem: &Problem) -> Result<(), JointError> {
        for (i, datum) in problem.data.iter().enumerate() {
            let is_signed = datum.query.is_signed();
            let on_scale = |y: f64| if is_signed { y } else { libm::log(y.abs()) };
            let mut column = Self::column(&self.model, problem, i);
            column.sort_unstable_by(f64::total_cmp);
            let at = |share: f64| {
                column
                    .get((share * (column.len().max(1) - 1) as f64) as usize)
                    .copied()
            };
            let (Some(low), Some(middle), Some(high)) = (at(0.005), at(0.5), at(0.995)) else {
                return Err(JointError::Empty);
            };
            // Heavy tails of ratios that pass through zero must not widen the gate: ends of 99 %, three times as far.
            let reach = |value: f64| {
                let error = match is_signed {
                    true if datum.value != 0.0 => {
                        let most = low.abs().max(high.abs());
                        problem.spread(i, middle) * value.abs().min(most) / datum.value.abs()
                    }
                    true => problem.spread(i, middle),
                    false => problem.spread(i, datum.value) / datum.value,
                };
                let (value, middle) = (on_scale(value), on_scale(middle));
                let end = if value < middle { low } else { high };
                let end = (on_scale(end) - middle).hypot(END * error);
                (value - middle).abs() / end.max(1e-12)
            };
            if reach(datum.value) > OUTSIDE {
                let slips = datum.slips_where(|value| reach(value) < 1.0);
                return Err(JointError::OutsidePrior {
                    what: datum.query.said(),
                    low,
                    high,
                    value: datum.value,
                    hint: slips.map_or_else(String::new, |why| format!("; it would agree {why}")),
                });
            }
        }
        Ok(())
    }

    /// The nearest draws, in units of the prior predictive spread, adjusted by regression; row-major parameter vectors.
    pub(super) fn nearest(&self, problem: &Problem, mask: &Mask) -> Vec<f64> {
        let (width, data) = (problem.priors.len(), problem.data.len());
        let used: Vec<usize> = (0..data).filter(|&i| mask[i]).collect();
        let spreads: Vec<f64> = used
            .iter()
            .map(|&i| {
                let mut column = Self::column(&self.answers, problem, i);
                column.sort_unstable_by(f64::total_cmp);
                // Half the distance between the 16 % and 84 % quantiles: a standard deviation that no far tail moves.
                let last = column.len().saturating_sub(1) as f64;
                let at = |share: f64| column.get((share * last) as usize).copied().unwrap_or(0.0);
                (0.5 * (at(0.84) - at(0.16))).max(f64::MIN_POSITIVE)
            })
            .collect();
        let difference = |row: usize, slot: usize| {
            let i = used[slot];
            (self.answers[row * data + i] - problem.data[i].value) / spreads[slot]
        };
        let mut order: Vec<(f64, usize)> = (0..self.rows)
            .map(|row| {
                let square: f64 = (0..used.len()).map(|slot| difference(row, slot).powi(2)).sum();
                (square.sqrt(), row)
            })
            .collect();
        let kept = ((KEPT * self.rows as f64) as usize).clamp(1, self.rows.max(1));
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order.truncate(kept);
        let mut particles: Vec<f64> = order
            .iter()
            .flat_map(|&(_, row)| &self.thetas[row * width..][..width])
            .copied()
            .collect();
        if used.is_empty() {
            return particles;
        }
        let differences: Vec<f64> = order
            .iter()
            .flat_map(|&(_, row)| (0..used.len()).map(move |slot| (row, slot)))
            .map(|(row, slot)| difference(row, slot))
            .collect();
        let distances: Vec<f64> = order.iter().map(|&(distance, _)| distance).collect();
        let epsilon = distances.last().copied().unwrap_or(0.0);
        let mut weights = vec![1.0 / order.len() as f64; order.len()];
        let before = particles.clone();
        let adjusted = adjust::linear(
            &problem.priors,
            &mut particles,
            &differences,
            &distances,
            epsilon,
            &mut weights,
        );
        // Without adjustment the nearest draws propose as they are: the correction makes up for it.
        if adjusted.is_err() || particles.iter().any(|x| !x.is_finite()) {
            return before;
        }
        particles
    }
}
