//! Sources of the variance of ln N: the share of each, and the reduction if that source were known exactly.
//!
//! Given the frequencies, ln N is a function of the other quantities x and of the errors e = ln y_0 - ln y_M(x) of measurement and
//! model. The posterior is a sample of both. For a set S of sources, R^2(S) is the share of the posterior variance of ln N that
//! a quadratic function of the sources in S explains (least squares on the particles, corrected for the number of terms). Hence
//!
//! ```text
//! if_known(i) = R^2({i})             = 1 - E[Var(ln N | x_i, y_0)] / Var(ln N | y_0)
//! share(i)    = mean over all orders of R^2(those before and i) - R^2(those before)
//! ```
//!
//! The first answers "by how much would the variance fall if I knew this?". Sources that the frequencies tie together, such as
//! modulus and supports, overlap there; the second (Shapley's value; Lindeman, Merenda and Gold 1980) divides what they have
//! in common evenly and adds up to one.

use super::explained::{Source, Terms, shapley};
use super::{Observation, Posterior};
use crate::numerics::random;
use crate::rod::beam::Quantity;
use crate::rod::beam::forward::ForwardModel;
use crate::rod::prior::{Prior, RodPrior};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Most particles used: a share is then good to about 0.02.
const PARTICLES: usize = 2000;
/// Least effective sample size that determines a dozen terms.
const LEAST_ESS: f64 = 200.0;
/// Particles over which the model's slopes are averaged.
const SLOPES: usize = 64;
/// Draws of the prior's mass per length; its variance is then good to a thirtieth.
const MASS_DRAWS: usize = 2048;
/// Largest share of its variance removed at which the mass counts as not checked by the frequencies.
const UNCHECKED: f64 = 0.2;

/// Part of one source in the variance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SourceShare {
    /// The source.
    pub source: Source,
    /// Share of the variance \[-\]; all shares add up to one.
    pub share: f64,
    /// Part of the variance \[-\] that would vanish if this source alone were known exactly.
    pub if_known: f64,
}

/// Dependence of the force on the mass.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MassDependence {
    /// Relative change of the force per relative change of the mass, with the frequencies and all else
    /// unchanged.
    pub force_per_mass: f64,
    /// Share of the prior variance of the mass that the frequencies remove; 0 for a mass that is a fixed number.
    pub learned: f64,
}

/// Sources of the variance of a force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VarianceShares {
    /// The sources, the largest share first.
    pub sources: Vec<SourceShare>,
    /// Share of the variance that all sources together explain; the rest is curvature beyond squares.
    pub explained: f64,
    /// The mass, which no number of frequencies can separate from the force.
    pub mass: MassDependence,
    /// Sentences for people: the largest source with its remedy, and if the frequencies do not check the
    /// mass.
    pub said: Vec<String>,
}

impl Source {
    fn of(quantity: Quantity) -> Option<Self> {
        Some(match quantity {
            Quantity::AxialForce => return None,
            Quantity::YoungsModulus => Self::Modulus,
            Quantity::Density => Self::Density,
            Quantity::Side | Quantity::Diameter | Quantity::Width | Quantity::Height => Self::Section,
            Quantity::FlexuralRigidity => Self::Rigidity,
            Quantity::MassPerLength => Self::Mass,
            Quantity::SpringLeft | Quantity::SpringRight => Self::Springs,
            Quantity::Length => Self::Length,
        })
    }

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Modulus => "modulus",
            Self::Density => "density",
            Self::Section => "section",
            Self::Rigidity => "flexural rigidity",
            Self::Mass => "mass per length",
            Self::Springs => "supports",
            Self::Length => "length",
            Self::Measurement => "measured frequencies",
            Self::Discrepancy => "model's discrepancy",
        }
    }

    /// Remedy that would make its share smaller.
    fn remedy(self) -> &'static str {
        match self {
            Self::Modulus => "test a sample, or load the rod",
            Self::Density | Self::Mass => "weigh the rod or a piece of it",
            Self::Section => "measure the section at several places",
            Self::Rigidity => "measure the section, or load the rod",
            Self::Springs => "look at the supports and narrow their priors",
            Self::Length => "measure the free length",
            Self::Measurement => "record longer or with less noise",
            Self::Discrepancy => "state a smaller discrepancy if the rod is known to be a good beam",
        }
    }
}

impl VarianceShares {
    /// One sentence with the largest source and its remedy.
    fn sentence(&self) -> Option<String> {
        let first = self.sources.first()?;
        let name = first.source.name();
        let verb = if matches!(first.source, Source::Springs | Source::Measurement) {
            "they were"
        } else {
            "it were"
        };
        Some(format!(
            "{} of the force's variance comes from the {name}; if {verb} known exactly, the variance would fall by {:.0} %: {}",
            in_words(first.share),
            100.0 * first.if_known,
            first.source.remedy()
        ))
    }

    /// Warning about the mass; `None` where the frequencies do check it.
    fn mass_sentence(&self) -> Option<String> {
        (self.mass.learned < UNCHECKED).then(|| {
            format!(
                "Nothing in these frequencies checks the mass: 1 % more of it is {:.1} % more force",
                self.mass.force_per_mass
            )
        })
    }
}

/// A share in words.
fn in_words(share: f64) -> &'static str {
    const WORDS: [(f64, &str); 9] = [
        (0.97, "Nearly all"),
        (0.9, "Nine tenths"),
        (0.8, "Four fifths"),
        (0.75, "Three quarters"),
        (0.667, "Two thirds"),
        (0.6, "Three fifths"),
        (0.5, "Half"),
        (0.4, "Two fifths"),
        (0.333, "A third"),
    ];
    let nearest = WORDS
        .iter()
        .min_by(|a, b| (a.0 - share).abs().total_cmp(&(b.0 - share).abs()));
    match nearest {
        Some((_, word)) if share > 0.29 => word,
        _ => "The largest part, less than a third,",
    }
}

/// The shares of one posterior. `error_is_discrepancy`: true if the discrepancy is the larger part of the
/// frequencies' error; `prior_mass` is the variance of the logarithm of the mass per length under the prior. `None` if the sample is too small or the force certain.
pub fn variance_shares(
    prior: &RodPrior,
    model: &dyn ForwardModel,
    posterior: &Posterior,
    observation: &Observation,
    error_sd: &[f64],
    error_is_discrepancy: bool,
    prior_mass: f64,
) -> Option<VarianceShares> {
    if posterior.ess < LEAST_ESS {
        return None;
    }
    let width = prior.priors().len();
    let stride = posterior.accepted.div_ceil(PARTICLES).max(1);
    let rows: Vec<&[f64]> = posterior.particles.chunks_exact(width).step_by(stride).collect();
    let weights: Vec<f64> = posterior.weights.iter().step_by(stride).copied().collect();
    let errors = errors(model, &rows, observation)?;
    let valid: Vec<usize> = (0..rows.len())
        .filter(|&i| rows[i][0] > 0.0 && errors.row(i).iter().all(|error| error.is_finite()))
        .collect();
    let total: f64 = valid.iter().map(|&i| weights[i]).sum();
    let weights: Vec<f64> = valid.iter().map(|&i| weights[i] / total).collect();
    let ess = weights.iter().map(|w| w * w).sum::<f64>().recip();

    let mut terms = Terms::new(weights);
    let response = terms.whiten(valid.iter().map(|&i| libm::log(rows[i][0])).collect())?;
    for (source, columns) in groups(prior) {
        let values: Vec<Vec<f64>> = columns
            .iter()
            .map(|&column| {
                let prior = &prior.priors()[column];
                valid
                    .iter()
                    .map(|&i| coordinate(prior, rows[i][column]))
                    .collect()
            })
            .collect();
        terms.add(source, values, true);
    }
    let source = if error_is_discrepancy {
        Source::Discrepancy
    } else {
        Source::Measurement
    };
    let of_errors = errors
        .column_iter()
        .map(|column| valid.iter().map(|&i| column[i]).collect())
        .collect();
    terms.add(source, of_errors, false);

    let explained = terms.explained(&response, ess);
    let count = terms.sources.len();
    let all = explained[explained.len() - 1];
    if all.is_nan() || all <= 0.0 {
        return None;
    }
    let mut sources: Vec<SourceShare> = (0..count)
        .map(|i| SourceShare {
            source: terms.sources[i].0,
            share: shapley(&explained, count, i) / all,
            if_known: explained[1 << i],
        })
        .collect();
    sources.sort_by(|a, b| b.share.total_cmp(&a.share));
    let mut shares = VarianceShares {
        sources,
        explained: all,
        mass: MassDependence {
            force_per_mass: force_per_mass(model, &rows, &valid, observation, error_sd)?,
            learned: if prior_mass > 1e-12 {
                let masses: Vec<f64> = valid.iter().map(|&i| log_mass(prior, rows[i])).collect();
                (1.0 - variance(&masses, &terms.weights) / prior_mass).clamp(0.0, 1.0)
            } else {
                0.0
            },
        },
        said: Vec::new(),
    };
    shares.said = [shares.sentence(), shares.mass_sentence()]
        .into_iter()
        .flatten()
        .collect();
    Some(shares)
}

/// Sources with their columns of `theta`; fixed quantities are left out.
fn groups(prior: &RodPrior) -> Vec<(Source, Vec<usize>)> {
    let mut groups: Vec<(Source, Vec<usize>)> = Vec::new();
    let quantities = prior.parameterisation().quantities().iter();
    for (column, (&quantity, prior)) in quantities.zip(prior.priors()).enumerate() {
        let Some(source) = Source::of(quantity).filter(|_| !prior.is_fixed()) else {
            continue;
        };
        match groups.iter_mut().find(|(other, _)| *other == source) {
            Some((_, columns)) => columns.push(column),
            None => groups.push((source, vec![column])),
        }
    }
    groups
}

/// Maps a value to the scale in which its prior is broad, where force and frequencies follow it smoothly.
fn coordinate(prior: &Prior, value: f64) -> f64 {
    match prior {
        Prior::Fixity(fixity) => fixity.of(value),
        Prior::Uniform { .. } => value,
        _ => libm::log(value),
    }
}

/// ln y_0 - ln y_M, particles by modes; not a number where the model has no answer.
fn errors(model: &dyn ForwardModel, rows: &[&[f64]], observation: &Observation) -> Option<DMatrix<f64>> {
    let modes = *observation.orders.last()?;
    let thetas: Vec<f64> = rows.concat();
    let mut answers = vec![0.0; rows.len() * modes];
    model.frequencies_of_many(&thetas, modes, &mut answers);
    Some(DMatrix::from_fn(
        rows.len(),
        observation.orders.len(),
        |row, i| libm::log(observation.frequency_hz[i] / answers[row * modes + observation.orders[i] - 1]),
    ))
}

/// Relative change of the force per relative change of the mass. A
/// relative change d of the mass moves every frequency by -d/2; the force that undoes this best changes by d
/// sum(w s) / (2 sum(w s^2)), s = d ln f / d ln N, w the inverse variances. `None` where no frequency follows the force.
fn force_per_mass(
    model: &dyn ForwardModel,
    rows: &[&[f64]],
    valid: &[usize],
    observation: &Observation,
    error_sd: &[f64],
) -> Option<f64> {
    let mut slopes = vec![0.0; *observation.orders.last()?];
    let (mut sum, mut squares) = (0.0, 0.0);
    for &i in valid.iter().step_by(valid.len().div_ceil(SLOPES).max(1)) {
        if model.log_slopes(rows[i], &mut slopes).is_err() {
            continue;
        }
        for ((order, frequency), sd) in observation
            .orders
            .iter()
            .zip(&observation.frequency_hz)
            .zip(error_sd)
        {
            // Frequencies given without any error count alike.
            let relative = if *sd > 0.0 { sd / frequency } else { 1.0 };
            let slope = slopes[order - 1];
            sum += slope / (relative * relative);
            squares += slope * slope / (relative * relative);
        }
    }
    Some(0.5 * sum / squares).filter(|change| change.is_finite())
}

/// Variance of the logarithm of the mass per length under a prior: the same for every record of a rod.
pub(super) fn log_mass_variance(prior: &RodPrior) -> f64 {
    let mut generator = random::stream(random::seed(&[b"prior mass"]), 0);
    let mut theta = vec![0.0; prior.priors().len()];
    let draws: Vec<f64> = (0..MASS_DRAWS)
        .map(|_| {
            prior.sample(&mut generator, &mut theta);
            log_mass(prior, &theta)
        })
        .collect();
    variance(&draws, &vec![1.0 / MASS_DRAWS as f64; MASS_DRAWS])
}

fn log_mass(prior: &RodPrior, theta: &[f64]) -> f64 {
    libm::log(prior.parameterisation().beam(theta).mass_per_length_kg_m)
}

fn variance(values: &[f64], weights: &[f64]) -> f64 {
    let mean: f64 = values.iter().zip(weights).map(|(x, w)| w * x).sum();
    values
        .iter()
        .zip(weights)
        .map(|(x, w)| w * (x - mean) * (x - mean))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_said_as_people_say_them() {
        assert_eq!(in_words(0.66), "Two thirds");
        assert_eq!(in_words(0.99), "Nearly all");
        assert_eq!(in_words(0.5), "Half");
        assert!(in_words(0.2).starts_with("The largest part"));
    }
}
