//! Annealed Markov chains: for posteriors too thin and bent for a mixture of kernels.
//!
//! Walkers start as draws of the prior. The power of the likelihood rises to one in steps that leave half of them effective; after each
//! they are resampled and moved by differential evolution (ter Braak 2006): half of them along differences between members of the other
//! half, which follow the posterior's shape at every place, at several lengths because a bend allows only short ones.
//!
//! The sample counts only if the walkers forgot where they were: after every run the correlation with its beginning is taken along each
//! whitened direction. Walkers keep the order of their ancestors, so relatives are neighbours, and the scatter between the means of blocks of
//! neighbours tells the number of independent draws.

use super::density::{Mask, Problem};
use super::population::{Population, effective, spread};
use crate::numerics::random;
use crate::rod::prior::Prior;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Number of walkers; even.
const WALKERS: usize = 1000;
/// Share of their places that walkers forget (one minus the correlation with the beginning, in the slowest direction), and most sweeps
/// for it: between two steps, and in the end before each of the [`SNAPSHOTS`].
const BETWEEN: (f64, usize) = (0.5, 40);
const LAST: (f64, usize) = (0.7, 200);
/// Number of blocks of neighbouring walkers between whose means the scatter is taken: 19 degrees of freedom.
const FAMILIES: usize = 20;
/// Snapshots of the walkers that make the sample.
const SNAPSHOTS: usize = 3;
/// Most steps of the power.
const STEPS: usize = 200;
/// Lengths of moves, in units of the one that suits a normal distribution.
const LENGTHS: [f64; 3] = [1.0, 0.5, 0.2];
/// Standard deviation of what is added to a move, in its own length: walkers that came of one leave each other.
const JITTER: f64 = 1e-2;
/// Number of walkers per random stream.
const BLOCK: usize = 50;

/// A member of the population.
#[derive(Clone)]
struct Walker {
    /// Uncertain parameters on the priors' real lines.
    line: Vec<f64>,
    theta: Vec<f64>,
    answers: Vec<f64>,
    /// Log densities of prior and data.
    prior: f64,
    likelihood: f64,
}

/// The sample of the chains.
pub(super) struct Sample {
    /// Equally weighted.
    pub(super) population: Population,
    /// Number of points tried.
    pub(super) tried: usize,
    /// Number of independent draws of the posterior that the sample is worth, at most the walkers'.
    pub(super) ess: f64,
    /// True if the walkers forgot their places before every snapshot.
    pub(super) is_mixed: bool,
}

/// A sample of the posterior given the data in `mask`, of all draws of the prior in `pilot` (row-major parameter vectors); `None` if the data
/// allow none of them.
pub(super) fn annealed(
    problem: &Problem,
    uncertain: &[usize],
    pilot: &[f64],
    mask: &Mask,
    seed: u64,
) -> Option<Sample> {
    let chains = Chains {
        problem,
        uncertain,
        mask,
    };
    let mut walkers: Vec<Walker> = pilot
        .par_chunks_exact(problem.priors.len())
        .filter_map(|theta| {
            let line = uncertain.iter().map(|&i| problem.priors[i].to_line(theta[i]));
            chains.at(line.collect())
        })
        .collect();
    let (mut power, mut tried) = (0.0, walkers.len());
    let stream = |what: &[u8], number: usize| {
        random::seed(&[what, &seed.to_le_bytes(), &(number as u64).to_le_bytes()])
    };
    for step in 0..STEPS {
        let next = raised(&walkers, power)?;
        let weights = weights(&walkers, next - power);
        let mut generator = random::stream(stream(b"annealed ancestors", step), 0);
        walkers = random::systematic(&weights, WALKERS, &mut generator)
            .into_iter()
            .map(|row| walkers[row].clone())
            .collect();
        power = next;
        // Between two steps a run may be cut short: the next begin where it ends.
        let seed = stream(b"annealed moves", step);
        tried += chains.moved(&mut walkers, power, BETWEEN, seed).0;
        if power == 1.0 {
            let mut population = Population::default();
            let mut is_mixed = true;
            let mut sums: Vec<DVector<f64>> = vec![DVector::zeros(uncertain.len()); walkers.len()];
            for snapshot in 0..SNAPSHOTS {
                let seed = stream(b"annealed sample", snapshot);
                let (sweeps, has_forgotten) = chains.moved(&mut walkers, power, LAST, seed);
                tried += sweeps;
                is_mixed &= has_forgotten;
                for (walker, sum) in walkers.iter().zip(&mut sums) {
                    *sum += DVector::from_column_slice(&walker.line);
                    population.thetas.extend(&walker.theta);
                    population.answers.extend(&walker.answers);
                    population.likelihood.push(walker.likelihood);
                    population.base.push(-walker.likelihood);
                }
            }
            return Some(Sample {
                population,
                tried,
                ess: independent(&walkers, &sums),
                is_mixed,
            });
        }
    }
    None
}

/// Number of independent draws that the sample is worth: the walkers' variance over that of the mean, by the scatter between the means of
/// families, in the direction in which it is fewest; at most the number of walkers. `sums` over all snapshots, walker by walker.
fn independent(walkers: &[Walker], sums: &[DVector<f64>]) -> f64 {
    let Some(directions) = Directions::of(walkers) else {
        return 0.0;
    };
    let size = sums.len().div_ceil(FAMILIES).max(1);
    let means: Vec<DVector<f64>> = sums
        .chunks(size)
        .filter_map(|family| {
            let count = (family.len() * SNAPSHOTS) as f64;
            let sum = family
                .iter()
                .fold(DVector::zeros(family[0].len()), |sum, x| sum + x);
            directions.whitened(&(sum / count))
        })
        .collect();
    let count = means.len() as f64;
    let Some(first) = means.first().filter(|_| means.len() > 1) else {
        return 0.0;
    };
    let mean = means.iter().fold(DVector::zeros(first.len()), |sum, x| sum + x) / count;
    let scatter = means.iter().fold(DVector::zeros(first.len()), |sum, x| {
        sum + (x - &mean).map(|d| d * d)
    }) / (count - 1.0);
    let fewest = scatter.iter().map(|s| count / s).fold(f64::INFINITY, f64::min);
    fewest.min(walkers.len() as f64)
}

/// Directions in which walkers have unit variance, each independent of those before it.
struct Directions {
    root: DMatrix<f64>,
}

impl Directions {
    /// `None` where the walkers have no spread.
    fn of(walkers: &[Walker]) -> Option<Self> {
        let rows: Vec<DVector<f64>> = walkers
            .iter()
            .map(|walker| DVector::from_column_slice(&walker.line))
            .collect();
        let (_, root) = spread(&rows.iter().collect::<Vec<_>>())?;
        Some(Self { root })
    }

    fn whitened(&self, line: &DVector<f64>) -> Option<DVector<f64>> {
        self.root.solve_lower_triangular(line)
    }

    /// One minus the correlation of the walkers' places with those before, in the slowest direction.
    fn forgotten(&self, before: &[Vec<f64>], walkers: &[Walker]) -> f64 {
        let mut squares = DVector::zeros(self.root.nrows());
        for (before, walker) in before.iter().zip(walkers) {
            let moved = DVector::from_iterator(
                before.len(),
                walker.line.iter().zip(before).map(|(to, from)| to - from),
            );
            let Some(moved) = self.whitened(&moved) else {
                return 0.0;
            };
            squares += moved.map(|d| d * d);
        }
        let slowest = squares.iter().copied().fold(f64::INFINITY, f64::min);
        0.5 * slowest / walkers.len() as f64
    }
}

/// The power of the likelihood that leaves half of the walkers' number effective; at most one.
fn raised(walkers: &[Walker], power: f64) -> Option<f64> {
    let enough = 0.5 * WALKERS.min(walkers.len()) as f64;
    let found = |next: f64| effective(&weights(walkers, next - power));
    if found(1.0) >= enough {
        return Some(1.0);
    }
    // On a logarithmic scale: the first steps are tiny.
    let (mut low, mut high) = (-40.0, libm::log(1.0 - power));
    if found(power + libm::exp(low)) < enough {
        return None;
    }
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        match found(power + libm::exp(middle)) >= enough {
            true => low = middle,
            false => high = middle,
        }
    }
    Some(power + libm::exp(low))
}

/// Normalised weights `likelihood^share`.
fn weights(walkers: &[Walker], share: f64) -> Vec<f64> {
    let highest = walkers
        .iter()
        .map(|w| w.likelihood)
        .fold(f64::NEG_INFINITY, f64::max);
    let mut weights: Vec<f64> = walkers
        .iter()
        .map(|w| libm::exp(share * (w.likelihood - highest)))
        .collect();
    let total: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= total);
    weights
}

struct Chains<'a> {
    problem: &'a Problem,
    uncertain: &'a [usize],
    mask: &'a Mask,
}

impl Chains<'_> {
    /// The walker at a point; `None` where prior or data have no density.
    fn at(&self, line: Vec<f64>) -> Option<Walker> {
        let problem = self.problem;
        let mut theta: Vec<f64> = problem.priors.iter().map(Prior::centre).collect();
        let mut prior = 0.0;
        for (&x, &quantity) in line.iter().zip(self.uncertain) {
            let own = &problem.priors[quantity];
            theta[quantity] = own.from_line(x);
            prior += own.log_density_on_line(theta[quantity], x);
        }
        if !prior.is_finite() {
            return None;
        }
        let mut answers = vec![0.0; problem.data.len()];
        problem.answer(&theta, &mut answers);
        let likelihood = problem.log_density(&answers, self.mask);
        likelihood.is_finite().then_some(Walker {
            line,
            theta,
            answers,
            prior,
            likelihood,
        })
    }

    /// Moves all walkers until they forgot so much of their places, or so often; returns the number of points tried, and false if
    /// it was the latter.
    fn moved(
        &self,
        walkers: &mut [Walker],
        power: f64,
        (far, sweeps): (f64, usize),
        seed: u64,
    ) -> (usize, bool) {
        let before: Vec<Vec<f64>> = walkers.iter().map(|walker| walker.line.clone()).collect();
        let count = walkers.len();
        let half = count / 2;
        for sweep in 0..sweeps {
            for side in 0..2 {
                let (first, second) = walkers.split_at_mut(half);
                let (moving, others) = match side {
                    0 => (first, &*second),
                    _ => (second, &*first),
                };
                let seed = random::seed(&[&seed.to_le_bytes(), &[side], &(sweep as u64).to_le_bytes()]);
                moving
                    .par_chunks_mut(BLOCK)
                    .enumerate()
                    .for_each(|(block, walkers)| {
                        let mut generator = random::stream(seed, block as u64);
                        for walker in walkers {
                            self.step(walker, others, power, &mut generator);
                        }
                    });
            }
            // In the spread they have now: what came of few ancestors has little of it at first.
            if Directions::of(walkers).is_some_and(|now| now.forgotten(&before, walkers) >= far) {
                return ((sweep + 1) * count, true);
            }
        }
        (sweeps * count, false)
    }

    /// One move of a walker along the difference of two others, which stay.
    fn step(&self, walker: &mut Walker, others: &[Walker], power: f64, generator: &mut ChaCha8Rng) {
        let d = self.uncertain.len() as f64;
        let mut index = |count: usize| ((generator.random::<f64>() * count as f64) as usize).min(count - 1);
        let (a, b) = (index(others.len()), index(others.len()));
        let share = LENGTHS[index(LENGTHS.len())];
        let length = 2.38 / (2.0 * d).sqrt() * share;
        let line = walker
            .line
            .iter()
            .zip(others[a].line.iter().zip(&others[b].line))
            .map(|(x, (a, b))| {
                let z: f64 = StandardNormal.sample(generator);
                x + length * (a - b) * (1.0 + JITTER * z)
            })
            .collect();
        let u: f64 = generator.random();
        let Some(proposed) = self.at(line) else { return };
        let gain = proposed.prior - walker.prior + power * (proposed.likelihood - walker.likelihood);
        if libm::log(u) < gain {
            *walker = proposed;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inference::joint::Datum;
    use crate::rod::prior::RodPrior;

    #[test]
    fn a_normal_posterior_has_its_mean_and_standard_deviation() {
        // A side of 0.07 m +- 10 %, read to 1 %: normal on a line that is its logarithm or the side itself.
        use crate::rod::beam::Quantity;
        let datum = Datum::readings(Quantity::Side, &[0.073], 0.0007).unwrap();
        let prior = RodPrior::todi();
        let problem = Problem::new(&prior, &[0.0; 3], &[vec![datum]]).unwrap();
        let uncertain = problem.uncertain();
        let mut generator = random::stream(3, 0);
        let mut pilot = Vec::new();
        for _ in 0..4000 {
            pilot.extend(problem.priors.iter().map(|prior| prior.sample(&mut generator)));
        }
        let sample = annealed(&problem, &uncertain, &pilot, &[true], 5).unwrap();
        assert!(sample.is_mixed && sample.ess > 500.0, "{}", sample.ess);
        let sample = sample.population;
        let sides: Vec<f64> = sample.answers.clone();
        let count = sides.len() as f64;
        let mean = sides.iter().sum::<f64>() / count;
        let sd = (sides.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / count).sqrt();
        // Conjugate: precisions add.
        let (p, q) = (0.007f64.powi(-2), 0.0007f64.powi(-2));
        let expected = (0.07 * p + 0.073 * q) / (p + q);
        // 3000 draws, of which at least 1000 count: four standard errors.
        assert!(
            (mean - expected).abs() < 4.0 * 0.0007 / 1000f64.sqrt(),
            "{mean} {expected}"
        );
        assert!((sd * (p + q).sqrt() - 1.0).abs() < 4.0 / 2000f64.sqrt(), "{sd}");
        // What the datum does not tell of keeps its prior.
        let forces: Vec<f64> = sample
            .thetas
            .iter()
            .step_by(problem.priors.len())
            .copied()
            .collect();
        let mean = forces.iter().sum::<f64>() / count;
        assert!((mean / 8e5 - 1.0).abs() < 4.0 * 0.2 / 1000f64.sqrt(), "{mean}");
    }

    #[test]
    fn chains_that_do_not_mix_say_so() {
        // Three frequencies to ten in a million, and a model without discrepancy: a thread in six dimensions.
        let (theta, mut answers) = (RodPrior::todi().centre(), [0.0; 3]);
        let exact = |order| Datum::frequency(order, 1.0, 1.0);
        let problem = Problem::new(&RodPrior::todi(), &[0.0; 3], &[(1..=3).map(exact).collect()]).unwrap();
        problem.answer(&theta, &mut answers);
        let data = (1..=3)
            .zip(answers)
            .map(|(order, f)| Datum::frequency(order, f, 1e-5 * f));
        let problem = Problem::new(&RodPrior::todi(), &[0.0; 3], &[data.collect()]).unwrap();
        let mut generator = random::stream(3, 0);
        let mut pilot = Vec::new();
        for _ in 0..4000 {
            pilot.extend(problem.priors.iter().map(|prior| prior.sample(&mut generator)));
        }
        let uncertain: Vec<usize> = (0..6).collect();
        let sample = annealed(&problem, &uncertain, &pilot, &[true; 3], 5).unwrap();
        assert!(!sample.is_mixed, "{}", sample.ess);
    }

    #[test]
    fn relatives_count_as_one_draw() {
        // A thousand walkers that came of forty and never left each other.
        let mut generator = random::stream(4, 0);
        let mut of = |count: usize, copies: usize| -> Vec<Walker> {
            let mut walkers = Vec::new();
            for _ in 0..count {
                let line: Vec<f64> = (0..3).map(|_| StandardNormal.sample(&mut generator)).collect();
                let walker = Walker {
                    line,
                    theta: Vec::new(),
                    answers: Vec::new(),
                    prior: 0.0,
                    likelihood: 0.0,
                };
                walkers.extend(std::iter::repeat_n(walker, copies));
            }
            walkers
        };
        let ess = |walkers: &[Walker]| {
            let sums = walkers
                .iter()
                .map(|walker| DVector::from_column_slice(&walker.line) * SNAPSHOTS as f64);
            independent(walkers, &sums.collect::<Vec<_>>())
        };
        // 19 degrees of freedom, the least of three directions: a factor of three either way.
        let (related, free) = (of(40, 25), of(1000, 1));
        let found = ess(&related);
        assert!((13.0..120.0).contains(&found), "{found}");
        let found = ess(&free);
        assert!((333.0..=1000.0).contains(&found), "{found}");
    }
}
