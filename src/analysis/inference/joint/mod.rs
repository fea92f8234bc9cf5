//! One posterior of all data of a rod: frequencies, static and dynamic tests, direct measurements.
//!
//! The sampler is chosen by evidence. First rejection ABC: draws from the prior, distances in units of the prior predictive spread
//! of each datum (frequencies in hertz and deflections in metres would not see each other otherwise), the nearest kept and adjusted
//! by regression. Then that population is corrected: kernels around it propose, and the weights are prior times the density of the
//! data's errors over the proposal's. With the density of the error as its kernel, ABC is exact for the model (Wilkinson 2013).
//! Where a correction leaves too few effective draws, the errors' density is widened to the power below one that leaves enough, and
//! the next population is proposed from there: sequential ABC with a shrinking kernel, until the kernel is the error itself. Where
//! these fail too, because the posterior is thin and bent, annealed Markov chains follow it.

mod annealed;
mod conflict;
mod datum;
mod density;
mod kernels;
pub mod next;
mod pilot;
mod population;

pub use conflict::DatumConflict;
pub use datum::{Datum, DatumFault};

use super::{Adjustment, Method, Posterior, Stop};
use crate::numerics::random;
use crate::rod::prior::RodPrior;
use density::{Mask, Problem};
use pilot::Pilot;
use population::{Mixture, Population, effective};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Effort of a posterior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointSettings {
    /// Draws from the prior.
    pub pilot: usize,
    /// Number of proposals of an intermediate population.
    pub population: usize,
    /// Number of proposals of the last population.
    pub sample: usize,
}

/// Gives standard deviations within 2 % of the exact ones at about 2000 effective draws, in 0.2 s.
impl Default for JointSettings {
    fn default() -> Self {
        Self {
            pilot: 20_000,
            population: 2_000,
            sample: 6_000,
        }
    }
}

/// Number of ancestors of a population.
const ANCESTORS: usize = 300;
/// Effective share of a population's proposals above which the next is the last.
const ENOUGH: f64 = 0.25;
/// Effective share that a widened kernel must leave.
const LEAST: f64 = 0.08;
/// Effective share of the last population above which no other is needed.
const WANTED: f64 = 0.15;
/// Most populations of round kernels; where one more is wanted the posterior is thin and bent.
const MOST_ROUND: usize = 3;
/// Most populations of kernels that the data sharpen.
const MOST_SHARP: usize = 15;
/// Score of a datum against all others from which it is named beside those that no rod explains together.
const CONTRADICTED: f64 = 3.0;
/// Least number of effective draws of a posterior.
const FEWEST: f64 = 200.0;

/// Reason why data give no posterior.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum JointError {
    /// A datum is invalid.
    #[error(transparent)]
    Datum(#[from] DatumFault),
    /// Nothing was measured.
    #[error("no measurement is given")]
    Empty,
    /// No rod of the prior gives such a value.
    #[error(
        "{what}: no rod of the prior has it; its rods have {low:.4e} to {high:.4e}, given is {value:.4e}{hint}"
    )]
    OutsidePrior {
        /// The datum.
        what: String,
        /// Lower end of the range of 99 % of the prior's rods.
        low: f64,
        /// Upper end of that range.
        high: f64,
        /// As given.
        value: f64,
        /// A slip that would explain it, with a leading separator, or nothing.
        hint: String,
    },
    /// Data that no rod explains together.
    #[error(
        "no rod explains the data together: the nearest misses them by {score:.1} standard deviations; they contradict each other, or \
         their errors are far too small (most likely: {suspect})"
    )]
    Contradiction {
        /// Distance of the nearest rod, as a normal score of all data.
        score: f64,
        /// The datum farthest from that rod.
        suspect: String,
    },
    /// Data of which some lie far from what the others predict.
    #[error("they contradict each other, so none is used; mend or leave out one of: {}", .0.iter().map(DatumConflict::to_string).collect::<Vec<_>>().join("; "))]
    Conflict(
        /// Those that contradict the others.
        Vec<DatumConflict>,
    ),
    /// The posterior is too thin to be sampled.
    #[error(
        "the posterior is too thin to be sampled: the chains did not mix, and are worth about {ess:.0} independent draws. The data are \
         stated more exactly than the model is: give it a discrepancy (`discrepancy`, 0.002 to 0.01 of a frequency), or data their full \
         standard errors; from Rust, a larger `JointSettings` proposes more"
    )]
    Unmixed {
        /// Independent draws that the chains are worth, as far as they show it.
        ess: f64,
    },
    /// No rod was found that the data allow.
    #[error("no rod of the prior was found that the data allow at all")]
    Unsampled,
}

/// Method by which a joint posterior was computed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampler {
    /// One correction: the nearest draws of the prior, adjusted, were good enough as proposal.
    Table,
    /// A sequence of kernels that shrink to the errors.
    Sequential,
    /// Markov chains annealed from the prior.
    Chains,
}

/// Posterior of the rod at the first moment, with further results.
#[derive(Debug, Clone, PartialEq)]
pub struct JointPosterior {
    /// Parameters of the rod at the first moment.
    pub posterior: Posterior,
    /// Method of computation.
    pub sampler: Sampler,
    /// Number of populations after the pilot.
    pub populations: usize,
    /// Per particle and mode order from the first, the model's relative discrepancy, drawn given the data.
    pub discrepancies: Vec<Vec<f64>>,
    /// Comparison of each datum, or of one moment's frequencies, with all others.
    pub conflicts: Vec<DatumConflict>,
}

/// All data of one rod, moment by moment. The axial force is constant within a moment and differs between
/// them; everything else is constant throughout.
#[derive(Debug, Clone, Copy)]
pub struct Joint<'a> {
    /// Prior of the rod; every moment's force has the prior of the force.
    pub prior: &'a RodPrior,
    /// Relative model discrepancy of frequencies, per mode order from the first.
    pub discrepancy: &'a [f64],
    /// Data by moment. The posterior is that of the first moment.
    pub moments: &'a [Vec<Datum>],
    /// Effort of the computation.
    pub settings: JointSettings,
}

impl Joint<'_> {
    /// The posterior of the first moment's rod. The same data and seed give the same bits on any number of threads.
    ///
    /// # Errors
    /// An invalid datum, or data that no rod explains.
    pub fn posterior(&self, seed: u64) -> Result<JointPosterior, JointError> {
        let (problem, pilot) = self.prepared(seed)?;
        let all = vec![true; problem.data.len()];
        let conflicts = || conflict::each(self, &problem, &pilot, seed);
        match self.sampled(&problem, &pilot, &all, self.settings, seed) {
            Ok(found) => Ok(self.finished(&problem, found, conflicts(), seed)),
            // Which of them, as far as the others tell.
            Err(JointError::Contradiction { score, suspect }) => {
                let mut far = conflicts();
                far.retain(|conflict| conflict.score >= CONTRADICTED);
                Err(match far.is_empty() {
                    true => JointError::Contradiction { score, suspect },
                    false => JointError::Conflict(far),
                })
            }
            Err(refusal) => Err(refusal),
        }
    }

    /// The same without the search for contradicting data, which takes one more posterior per datum.
    ///
    /// # Errors
    /// As [`Joint::posterior`].
    pub fn posterior_alone(&self, seed: u64) -> Result<JointPosterior, JointError> {
        let (problem, pilot) = self.prepared(seed)?;
        let all = vec![true; problem.data.len()];
        let found = self.sampled(&problem, &pilot, &all, self.settings, seed)?;
        Ok(self.finished(&problem, found, Vec::new(), seed))
    }

    fn prepared(&self, seed: u64) -> Result<(Problem, Pilot), JointError> {
        if self.moments.iter().all(Vec::is_empty) {
            return Err(JointError::Empty);
        }
        for datum in self.moments.iter().flatten() {
            datum.check(self.prior)?;
        }
        let problem = Problem::new(self.prior, self.discrepancy, self.moments).ok_or(JointError::Empty)?;
        let pilot = Pilot::drawn(&problem, self.settings.pilot, seed);
        pilot.refuse_outsiders(&problem)?;
        Ok((problem, pilot))
    }

    /// A weighted population of the posterior given the data in `mask`.
    fn sampled(
        &self,
        problem: &Problem,
        pilot: &Pilot,
        mask: &Mask,
        settings: JointSettings,
        seed: u64,
    ) -> Result<Found, JointError> {
        let stream = |what: &[u8], number: usize| {
            let number = (number as u64).to_le_bytes();
            let mask: Vec<u8> = mask.iter().map(|&m| u8::from(m)).collect();
            random::seed(&[b"joint", what, &seed.to_le_bytes(), &number, &mask])
        };
        let by = |shape| kernels(problem, pilot, mask, settings, shape, &stream);
        if let Some(found) = by(Shape::Round) {
            return Ok(found);
        }
        if let Some(found) = by(Shape::Sharp) {
            refuse_contradiction(problem, mask, &found.population)?;
            return Ok(found);
        }
        let chains = annealed::annealed(
            problem,
            &problem.uncertain(),
            &pilot.thetas,
            mask,
            stream(b"annealed", 0),
        );
        let chains = chains.ok_or(JointError::Unsampled)?;
        refuse_contradiction(problem, mask, &chains.population)?;
        if !chains.is_mixed || chains.ess < FEWEST {
            return Err(JointError::Unmixed { ess: chains.ess });
        }
        let weights = chains.population.weights(1.0);
        Ok(Found {
            population: chains.population,
            weights,
            ess: chains.ess,
            draws: pilot.rows + chains.tried,
            populations: 1,
            sampler: Sampler::Chains,
        })
    }

    fn finished(
        &self,
        problem: &Problem,
        found: Found,
        conflicts: Vec<DatumConflict>,
        seed: u64,
    ) -> JointPosterior {
        let Found {
            population,
            weights,
            ess,
            draws,
            populations,
            sampler,
        } = found;
        let (total, own, data) = (problem.priors.len(), problem.width, problem.data.len());
        let all = vec![true; data];
        let rows: Vec<usize> = (0..weights.len()).filter(|&i| weights[i] > 0.0).collect();
        let mut generator = random::stream(random::seed(&[b"joint discrepancy", &seed.to_le_bytes()]), 0);
        let discrepancies = rows
            .iter()
            .map(|&row| {
                let answers = &population.answers[row * data..][..data];
                (1..=self.discrepancy.len())
                    .map(|order| {
                        let (mean, sd) = problem.discrepancy_given(order, answers, &all);
                        let z: f64 = StandardNormal.sample(&mut generator);
                        mean + sd * z
                    })
                    .collect()
            })
            .collect();
        let kept: Vec<f64> = rows.iter().map(|&row| weights[row]).collect();
        JointPosterior {
            posterior: Posterior {
                parameterisation: *self.prior.parameterisation(),
                particles: rows
                    .iter()
                    .flat_map(|&row| &population.thetas[row * total..][..own])
                    .copied()
                    .collect(),
                ess,
                weights: kept,
                epsilon: 0.0,
                draws,
                accepted: rows.len(),
                invalid: 0,
                seed,
                method: match sampler {
                    Sampler::Table => Method::Rejection,
                    Sampler::Sequential | Sampler::Chains => Method::Sequential,
                },
                adjustment: Adjustment::None,
                withheld: None,
                stop: Some(Stop::TargetReached),
            },
            sampler,
            populations,
            discrepancies,
            conflicts,
        }
    }
}

/// Populations proposed by mixtures of kernels; `None` if they cannot follow the posterior.
fn kernels(
    problem: &Problem,
    pilot: &Pilot,
    mask: &Mask,
    settings: JointSettings,
    shape: Shape,
    stream: &dyn Fn(&[u8], usize) -> u64,
) -> Option<Found> {
    let most = match shape {
        Shape::Round => MOST_ROUND,
        Shape::Sharp => MOST_SHARP,
    };
    let (width, uncertain) = (problem.priors.len(), problem.uncertain());
    let mut ancestors = pilot.nearest(problem, mask);
    let (mut populations, mut unwidened, mut is_last) = (0, 0, false);
    let (mut draws, mut share) = (pilot.rows, 1.0);
    while populations < most || is_last {
        let mut mixture = Mixture::around(problem, &uncertain, &ancestors)?;
        if shape == Shape::Sharp {
            mixture = mixture.sharpened(mask, share)?;
        }
        let count = if is_last {
            settings.sample
        } else {
            settings.population
        };
        let population = mixture.propose(count, mask, stream(b"proposals", populations));
        populations += 1;
        draws += count;
        let weights = population.weights(1.0);
        let found = effective(&weights);
        if is_last && (found >= WANTED * count as f64 || unwidened >= 6) {
            return (found >= FEWEST.min(0.5 * count as f64)).then_some(Found {
                population,
                weights,
                ess: found,
                draws,
                populations,
                sampler: match shape {
                    Shape::Round if populations <= 2 => Sampler::Table,
                    _ => Sampler::Sequential,
                },
            });
        }
        share = match found >= LEAST * count as f64 || is_last {
            true => 1.0,
            false => tempered(&population, LEAST * count as f64),
        };
        unwidened += usize::from(share == 1.0);
        // Three populations at the errors' own density have sharpened the proposal as far as they can; a last one that falls
        // short, because a few of its draws carry much of the weight, proposes once more.
        is_last = is_last || found >= ENOUGH * count as f64 || unwidened >= 3;
        let next = population.weights(share);
        if effective(&next) == 0.0 {
            return None;
        }
        let rows = random::systematic(
            &next,
            ANCESTORS,
            &mut random::stream(stream(b"ancestors", populations), 0),
        );
        ancestors.clear();
        for row in rows {
            ancestors.extend(&population.thetas[row * width..][..width]);
        }
    }
    None
}

/// Shape of the kernels of a mixture.
#[derive(Clone, Copy, PartialEq)]
enum Shape {
    /// The population's.
    Round,
    /// That of the posterior at each kernel's place.
    Sharp,
}

/// A population of a posterior.
struct Found {
    population: Population,
    weights: Vec<f64>,
    /// Effective sample size.
    ess: f64,
    draws: usize,
    populations: usize,
    sampler: Sampler,
}

/// Score above which data are refused, because no rod explains them.
const REFUSED: f64 = 6.0;

/// Refuses data of which even the nearest point of a sample is too far.
fn refuse_contradiction(problem: &Problem, mask: &Mask, sample: &Population) -> Result<(), JointError> {
    let count = problem.data.len();
    let used: Vec<usize> = (0..count).filter(|&i| mask[i]).collect();
    let square = |answers: &[f64]| problem.square(answers, mask);
    let rows = sample.answers.chunks_exact(count);
    let Some(nearest) = rows.min_by(|a, b| square(a).total_cmp(&square(b))) else {
        return Err(JointError::Unsampled);
    };
    let score = conflict::normal_score(square(nearest), used.len());
    if score <= REFUSED {
        return Ok(());
    }
    let away = |answers: &[f64], i: usize| {
        let (mean, _, sd) = problem.predicted(i, answers, mask);
        (problem.data[i].value - mean) / sd
    };
    let farthest = used
        .into_iter()
        .max_by(|&a, &b| away(nearest, a).abs().total_cmp(&away(nearest, b).abs()));
    Err(JointError::Contradiction {
        score,
        suspect: farthest.map_or_else(String::new, |i| problem.data[i].query.said()),
    })
}

/// Power of the likelihood that leaves `wanted` effective draws, by bisection; if none does, the one that leaves most: proposals made for
/// the posterior suit the prior as badly as the prior's suit it.
fn tempered(population: &Population, wanted: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..40 {
        let middle = if low == 0.0 {
            high / 8.0
        } else {
            0.5 * (low + high)
        };
        match effective(&population.weights(middle)) >= wanted {
            true => low = middle,
            false => high = middle,
        }
    }
    if low > 0.0 {
        return low;
    }
    let left = |power: &f64| effective(&population.weights(*power));
    let powers = (0..60).map(|k| 0.75f64.powi(k));
    powers.max_by(|a, b| left(a).total_cmp(&left(b))).unwrap_or(1.0)
}
