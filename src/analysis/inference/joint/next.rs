//! Ranks further measurements by the share of the force's standard deviation that each is expected to leave.
//!
//! Rods are drawn from the prior, or from the posterior of tests already done; each is measured with the
//! errors stated, once with its frequencies alone and once with each candidate beside them, on the same draws
//! of the frequencies' errors. A share is the ratio of the posterior standard deviations, averaged over the rods.

use super::{Datum, Joint, JointError, JointSettings};
use crate::numerics::random;
use crate::rod::beam::forward::MAX_MODES;
use crate::rod::beam::receptance::{PointLoad, PointMass};
use crate::rod::beam::{Quantity, Section};
use crate::rod::prior::RodPrior;
use crate::rod::query::{Queries, Query};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;

/// Least value to which relative errors of signed ratios apply: near its zero a ratio is not measured better
/// than elsewhere.
const LEAST_SIGNED: f64 = 1e-3;

/// A measurement that could be made.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Short name for flags and JSON.
    pub key: &'static str,
    /// In words.
    pub said: String,
    /// Queries to be measured, with the relative standard error of each.
    pub queries: Vec<(Query, f64)>,
    /// Mode orders and standard error \[Hz\] of the frequencies beside them; `None`: the campaign's.
    pub frequencies: Option<(usize, f64)>,
}

/// Mean and standard deviation of a force \[N\]; `None` where the data give no posterior.
pub type Known = Option<(f64, f64)>;

/// Expected result of a measurement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worth {
    /// [`Candidate::key`].
    pub key: &'static str,
    /// In words.
    pub measurement: String,
    /// Mean share of the standard deviation of the force that is left \[-\].
    pub left: f64,
    /// Standard error of the mean over the rods.
    pub error: f64,
    /// Rods.
    pub rods: usize,
}

/// The campaign that a further measurement would join.
#[derive(Debug, Clone, Copy)]
pub struct Campaign<'a> {
    /// Prior of the rod.
    pub prior: &'a RodPrior,
    /// Relative model discrepancy per mode order.
    pub discrepancy: &'a [f64],
    /// Tests already done, moment by moment.
    pub done: &'a [Vec<Datum>],
    /// Mode orders of an ordinary record.
    pub modes: usize,
    /// Standard error of its frequencies \[Hz\].
    pub sd_hz: f64,
    /// Number of rods to average over.
    pub rods: usize,
}

/// Effort of one posterior: standard deviations to about 3 %, which averages out over the rods.
const SETTINGS: JointSettings = JointSettings {
    pilot: 8_000,
    population: 1_000,
    sample: 3_000,
};

/// Measurements that are usual for a rod of this prior.
pub fn usual(prior: &RodPrior, modes: usize) -> Vec<Candidate> {
    let parameterisation = prior.parameterisation();
    let beam = parameterisation.beam(&prior.centre());
    let mass_kg = 0.04 * beam.mass_per_length_kg_m * beam.length_m;
    let one = |query, error| vec![(query, error)];
    let each =
        |query: &dyn Fn(usize) -> Query, error| (1..=modes).map(|order| (query(order), error)).collect();
    let middle = PointLoad {
        force_n: 300.0,
        at: 0.5,
    };
    let deflection = Query::Deflection {
        load: middle,
        read_at: 0.5,
    };
    let mass = PointMass { mass_kg, at: 0.3 };
    let mut all = vec![
        (
            "load",
            "a load at mid-span, its deflection to 3 %".to_owned(),
            one(deflection, 0.03),
        ),
        (
            "load-1",
            "a load at mid-span, its deflection to 1 %".to_owned(),
            one(deflection, 0.01),
        ),
        (
            "mass",
            format!("{mass_kg:.1} kg hung at 0.3 L, frequency ratios to 0.14 %"),
            each(&|order| Query::FrequencyRatio { order, mass }, 0.0014),
        ),
        (
            "shape",
            "two sensors at 0.1 and 0.4 L, amplitude ratios to 1 %".to_owned(),
            each(
                &|order| Query::AmplitudeRatio {
                    order,
                    at: 0.1,
                    reference_at: 0.4,
                },
                0.01,
            ),
        ),
        (
            "shape-4",
            "four sensors, 0.1 to 0.4 L, amplitude ratios to 1 %".to_owned(),
            [0.1, 0.2, 0.3]
                .into_iter()
                .flat_map(|at| {
                    (1..=modes).map(move |order| {
                        let query = Query::AmplitudeRatio {
                            order,
                            at,
                            reference_at: 0.4,
                        };
                        (query, 0.01)
                    })
                })
                .collect(),
        ),
        (
            "springs",
            "both supports' springs to 5 %".to_owned(),
            vec![
                (Query::Quantity(Quantity::SpringLeft), 0.05),
                (Query::Quantity(Quantity::SpringRight), 0.05),
            ],
        ),
    ];
    let size: Vec<(Query, f64)> = match parameterisation.section() {
        Section::Square => one(Query::Quantity(Quantity::Side), 0.007),
        Section::Round => one(Query::Quantity(Quantity::Diameter), 0.007),
        Section::Rectangle => vec![
            (Query::Quantity(Quantity::Width), 0.007),
            (Query::Quantity(Quantity::Height), 0.007),
        ],
        Section::Direct => Vec::new(),
    };
    if size.is_empty() {
        let weight = one(Query::Quantity(Quantity::MassPerLength), 0.01);
        all.push(("weight", "the mass per length to 1 %".to_owned(), weight));
    } else {
        let strain = |strain_at| {
            each(
                &|order| Query::StrainRatio {
                    order,
                    strain_at,
                    read_at: 0.1,
                },
                0.02,
            )
        };
        let density = one(Query::Quantity(Quantity::Density), 0.01);
        let both = [size.clone(), density.clone()].concat();
        all.push((
            "strain",
            "strain at 0.05 L over motion at 0.1 L, every mode to 2 %".to_owned(),
            strain(0.05),
        ));
        all.push((
            "strain-there",
            "strain over motion at 0.1 L, every mode to 2 %".to_owned(),
            strain(0.1),
        ));
        all.push(("caliper", "the section by caliper, to 0.7 %".to_owned(), size));
        all.push((
            "density",
            "the density of a weighed sample, to 1 %".to_owned(),
            density,
        ));
        all.push(("caliper-density", "caliper and weighed sample".to_owned(), both));
    }
    let together = |keys: &[&str]| -> Vec<(Query, f64)> {
        all.iter()
            .filter(|(key, ..)| keys.contains(key))
            .flat_map(|(_, _, queries)| queries.clone())
            .collect()
    };
    let everything = together(&["load", "mass", "shape", "strain", "caliper-density", "weight"]);
    all.push((
        "everything",
        "load (3 %), mass, sensors, strain, caliper and density".to_owned(),
        everything,
    ));
    // What is fixed beforehand cannot be learned.
    let is_open = |query: &Query| match query {
        Query::Quantity(quantity) => prior.of(*quantity).is_some_and(|prior| !prior.is_fixed()),
        _ => true,
    };
    all.into_iter()
        .map(|(key, said, queries)| Candidate {
            key,
            said,
            frequencies: None,
            queries: queries.into_iter().filter(|(query, _)| is_open(query)).collect(),
        })
        .filter(|candidate| !candidate.queries.is_empty())
        .collect()
}

/// The worth of each candidate, in their order, without those that the sampler cannot follow in half of the rods; `done` is called for every rod.
///
/// # Errors
/// Tests already done that give no posterior, or a prior whose rods cannot be measured.
pub fn worth(
    campaign: &Campaign<'_>,
    candidates: &[Candidate],
    seed: u64,
    done: &(dyn Fn() + Sync),
) -> Result<Vec<Worth>, JointError> {
    let forces = forces(campaign, candidates, seed, done)?;
    let share = |rod: &[Known], i: usize| Some(rod[i + 1]?.1 / rod[0]?.1);
    let of_candidate = |(i, candidate): (usize, &Candidate)| {
        // A rod whose data the sampler cannot follow with a candidate contributes nothing to that candidate.
        let known: Vec<f64> = forces.iter().filter_map(|rod| share(rod, i)).collect();
        let rods = known.len();
        if rods < 2 || rods < campaign.rods / 2 {
            return None;
        }
        let left = known.iter().sum::<f64>() / rods as f64;
        let square: f64 = known.iter().map(|share| (share - left).powi(2)).sum();
        Some(Worth {
            key: candidate.key,
            measurement: candidate.said.clone(),
            left,
            error: (square / (rods as f64 * (rods as f64 - 1.0))).sqrt(),
            rods,
        })
    };
    let found: Vec<Worth> = candidates.iter().enumerate().filter_map(of_candidate).collect();
    if found.is_empty() {
        return Err(JointError::Unsampled);
    }
    Ok(found)
}

/// Knowledge of the force of each rod by its frequencies alone, and after each candidate, in their order; `done` is called for
/// every rod.
///
/// # Errors
/// Tests already done that give no posterior, or a prior whose rods cannot be measured.
pub fn forces(
    campaign: &Campaign<'_>,
    candidates: &[Candidate],
    seed: u64,
    done: &(dyn Fn() + Sync),
) -> Result<Vec<Vec<Known>>, JointError> {
    let of_rod = |(rod, truth): (usize, Vec<f64>)| {
        let seed = random::seed(&[b"next", &seed.to_le_bytes(), &(rod as u64).to_le_bytes()]);
        let known = of_rod(campaign, candidates, &truth, seed);
        done();
        known
    };
    truths(campaign, seed)?
        .into_par_iter()
        .enumerate()
        .map(of_rod)
        .collect()
}

/// Parameters of the rods to be measured.
fn truths(campaign: &Campaign<'_>, seed: u64) -> Result<Vec<Vec<f64>>, JointError> {
    let mut generator = random::stream(random::seed(&[b"next rods", &seed.to_le_bytes()]), 0);
    let found = match campaign.done.is_empty() {
        true => None,
        false => {
            let joint = Joint {
                prior: campaign.prior,
                discrepancy: campaign.discrepancy,
                moments: campaign.done,
                settings: JointSettings::default(),
            };
            Some(joint.posterior_alone(seed)?.posterior)
        }
    };
    Ok((0..campaign.rods)
        .map(|_| {
            let mut theta = campaign.prior.centre();
            campaign.prior.sample(&mut generator, &mut theta);
            if let Some(posterior) = &found {
                let u: f64 = generator.random();
                let mut sum = 0.0;
                let row = posterior.weights.iter().position(|w| {
                    sum += w;
                    sum > u
                });
                let width = theta.len();
                let row = row.unwrap_or(posterior.accepted - 1);
                theta[1..].copy_from_slice(&posterior.particles[row * width + 1..][..width - 1]);
            }
            theta
        })
        .collect())
}

/// Knowledge of the force of one rod.
fn of_rod(
    campaign: &Campaign<'_>,
    candidates: &[Candidate],
    truth: &[f64],
    seed: u64,
) -> Result<Vec<Known>, JointError> {
    let mut generator = random::stream(seed, 0);
    let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
    let discrepancies: Vec<f64> = (0..MAX_MODES)
        .map(|i| campaign.discrepancy.get(i).copied().unwrap_or(0.0) * normal())
        .collect();
    // The errors of all frequencies in units of their standard error, so that campaigns share them.
    let errors: Vec<f64> = (0..MAX_MODES).map(|_| normal()).collect();
    let mut measured = |queries: &[(Query, f64)], sd_hz: f64| -> Result<Vec<Datum>, JointError> {
        let asked = queries.iter().map(|(query, _)| *query).collect();
        let asked = Queries::new(*campaign.prior.parameterisation(), asked).ok_or(JointError::Empty)?;
        let mut answers = vec![0.0; queries.len()];
        asked
            .answers(truth, &mut answers)
            .map_err(|_| JointError::Empty)?;
        Ok(queries
            .iter()
            .zip(answers)
            .map(|((query, error), y)| {
                let (centre, sd, z) = match query {
                    Query::Frequency { order, .. } => {
                        (y * (1.0 + discrepancies[order - 1]), sd_hz, errors[order - 1])
                    }
                    _ if query.is_signed() => (y, error * y.abs().max(LEAST_SIGNED), normal()),
                    _ => (y, error * y.abs(), normal()),
                };
                Datum {
                    query: *query,
                    value: centre + sd * z,
                    sd,
                    gain_sd: 0.0,
                }
            })
            .collect())
    };
    let own = (campaign.modes, campaign.sd_hz);
    let alone = std::iter::once((own, &[][..]));
    let with = candidates
        .iter()
        .map(|candidate| (candidate.frequencies.unwrap_or(own), &candidate.queries[..]));
    let mut sets = Vec::new();
    for ((modes, sd_hz), queries) in alone.chain(with) {
        let frequencies = (1..=modes).map(|order| (Query::Frequency { order, mass: None }, 0.0));
        let all: Vec<(Query, f64)> = frequencies.chain(queries.iter().copied()).collect();
        sets.push(measured(&all, sd_hz)?);
    }
    let known_of = |set: Vec<Datum>| {
        let mut moments = vec![set];
        moments.extend(campaign.done.iter().cloned());
        let joint = Joint {
            prior: campaign.prior,
            discrepancy: campaign.discrepancy,
            moments: &moments,
            settings: SETTINGS,
        };
        let posterior = joint.posterior_alone(seed).ok()?.posterior;
        Some((
            posterior.mean(Quantity::AxialForce)?,
            posterior.sd(Quantity::AxialForce)?,
        ))
    };
    Ok(sets.into_iter().map(known_of).collect())
}
