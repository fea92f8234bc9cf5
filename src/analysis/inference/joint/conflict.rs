//! Finds data that contradict the others: each is compared with the posterior of the rest.

use super::density::Problem;
use super::{Joint, JointSettings, Pilot};
use crate::rod::query::Query;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};
use std::fmt;

/// Score above which a slip is searched for.
const DOUBTED: f64 = 3.0;
/// Score below which a slip explains the datum.
const EXPLAINED: f64 = 2.0;
/// Upper limit of scores: further out the tail of a normal distribution has no meaning.
const MOST: f64 = 8.0;

/// Comparison of one datum, or of the frequencies of one moment, with all other data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DatumConflict {
    /// In words.
    pub datum: String,
    /// Standard deviations between the datum and its prediction by the others, as a normal score without
    /// sign, at most 8.
    pub score: f64,
    /// Measured value; `None` for a group of frequencies.
    pub value: Option<f64>,
    /// Mean of the prediction by the others.
    pub predicted: Option<f64>,
    /// Standard deviation of the prediction, without the datum's own error; with what the others leave open of an error that it shares
    /// with them.
    pub predicted_sd: Option<f64>,
    /// A slip that would explain the datum.
    pub hint: Option<String>,
}

impl fmt::Display for DatumConflict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}, {:.1} standard deviations from the others",
            self.datum, self.score
        )?;
        match &self.hint {
            Some(hint) => write!(f, ", would agree {hint}"),
            None => Ok(()),
        }
    }
}

/// Compares every datum, with the frequencies of one moment as a group.
pub(super) fn each(joint: &Joint<'_>, problem: &Problem, pilot: &Pilot, seed: u64) -> Vec<DatumConflict> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (i, datum) in problem.data.iter().enumerate() {
        let together = matches!(datum.query, Query::Frequency { .. });
        let same = |group: &&mut Vec<usize>| {
            group.first().is_some_and(|&first| {
                let (a, b) = (problem.data[first].query, datum.query);
                problem.moment_of[first] == problem.moment_of[i] && loaded(a) == loaded(b)
            })
        };
        match groups.iter_mut().find(same).filter(|_| together) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    if groups.len() < 2 {
        return Vec::new();
    }
    // A mean and a standard deviation are all that is asked: a third of the draws serves.
    let settings = JointSettings {
        population: joint.settings.population / 2,
        sample: joint.settings.sample / 3,
        ..joint.settings
    };
    groups
        .iter()
        .filter_map(|group| one(joint, problem, pilot, group, settings, seed))
        .collect()
}

/// Frequencies with different masses are different groups; anything else is its own.
fn loaded(query: Query) -> Option<Option<(u64, u64)>> {
    match query {
        Query::Frequency { mass, .. } => Some(mass.map(|m| (m.mass_kg.to_bits(), m.at.to_bits()))),
        _ => None,
    }
}

fn one(
    joint: &Joint<'_>,
    problem: &Problem,
    pilot: &Pilot,
    group: &[usize],
    settings: JointSettings,
    seed: u64,
) -> Option<DatumConflict> {
    let mask: Vec<bool> = (0..problem.data.len()).map(|i| !group.contains(&i)).collect();
    let found = joint.sampled(problem, pilot, &mask, settings, seed).ok()?;
    let data = problem.data.len();
    let signed = |i: usize| problem.data[i].query.is_signed();
    let scaled = |i: usize, y: f64| if signed(i) { y } else { libm::log(y.abs()) };
    let n = group.len();
    // Per draw the predictions, each with what is left of the shared error and with the datum's own. Data of one group share no error
    // with each other: frequencies of one moment are of different orders.
    let mut left = vec![0.0; n];
    let mut errors = vec![0.0; n];
    let rows: Vec<(DVector<f64>, f64)> = found
        .weights
        .iter()
        .enumerate()
        .filter(|(_, w)| **w > 0.0)
        .map(|(row, &weight)| {
            let y = &found.population.answers[row * data..][..data];
            let means = DVector::from_fn(n, |k, _| {
                let i = group[k];
                let (mean, shared, with_own) = problem.predicted(i, y, &mask);
                let relative = if signed(i) { 1.0 } else { mean };
                left[k] += weight * (shared / relative).powi(2);
                errors[k] += weight * (with_own / relative).powi(2);
                scaled(i, mean)
            });
            (means, weight)
        })
        .collect();
    let mean = rows.iter().fold(DVector::zeros(n), |sum, (y, w)| sum + y * *w);
    let mut covariance = rows.iter().fold(DMatrix::zeros(n, n), |sum, (y, w)| {
        let away = y - &mean;
        sum + &away * away.transpose() * *w
    });
    let predicted = rows.iter().fold(0.0, |sum, (y, w)| {
        sum + w * if signed(group[0]) { y[0] } else { libm::exp(y[0]) }
    });
    let predicted_sd = (covariance[(0, 0)] + left[0]).sqrt() * if signed(group[0]) { 1.0 } else { predicted };
    for (k, error) in errors.iter().enumerate() {
        covariance[(k, k)] += error;
    }
    let root = covariance.cholesky()?;
    let score_of = |values: &[f64]| {
        let away = DVector::from_fn(n, |k, _| scaled(group[k], values[k]) - mean[k]);
        normal_score(away.dot(&root.solve(&away)), n)
    };
    let values: Vec<f64> = group.iter().map(|&i| problem.data[i].value).collect();
    let score = score_of(&values);
    let alone = &problem.data[group[0]];
    let hint = (score > DOUBTED && n == 1)
        .then(|| alone.slips_where(|value| score_of(&[value]) < EXPLAINED))
        .flatten();
    let moment = problem.moment_of[group[0]];
    let suffix = if moment > 0 {
        format!(" (moment {})", moment + 1)
    } else {
        String::new()
    };
    let single = n == 1;
    Some(DatumConflict {
        datum: match single {
            true => alone.query.said() + &suffix,
            false => match alone.query {
                Query::Frequency { mass: Some(mass), .. } => {
                    format!("frequencies with {} kg at {:.3} l{suffix}", mass.mass_kg, mass.at)
                }
                _ => format!("frequencies{suffix}"),
            },
        },
        score,
        value: single.then_some(alone.value),
        predicted: single.then_some(predicted),
        predicted_sd: single.then_some(predicted_sd),
        hint,
    })
}

/// The normal score with the same two-sided probability as a chi-square.
pub(super) fn normal_score(square: f64, freedom: usize) -> f64 {
    let tail = ChiSquared::new(freedom as f64).map_or(1.0, |chi| chi.sf(square));
    let normal = Normal::standard();
    (-normal.inverse_cdf((0.5 * tail).max(1e-300))).clamp(0.0, MOST)
}
