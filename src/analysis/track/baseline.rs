//! The baseline: mean log-frequencies of the first records and particles of the static parameters.

mod gross;
pub(super) mod levels;
pub(super) mod particles;
pub mod spacing;

pub(crate) use gross::are_sound;

use super::baseline::levels::{Column, LEAST_LOG_SD, Slopes, Square};
use super::baseline::particles::{Population, Target};
use super::observation::Observation;
use crate::inference::joint::{Datum, Joint, JointError, JointSettings};
use crate::numerics::random;
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::prior::RodPrior;
use crate::signal::record::Timestamp;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Number of particles that give the slopes for the levels.
const PILOTS: usize = 64;

/// Standard error of the plain mean of ln f that finds the pilots.
const ROUGH: f64 = 0.01;

/// Half the interval of ln N over which a slope's derivative is taken.
const BEND: f64 = 0.05;

/// Least standard error of a mean frequency beside tests, as a share of the model's discrepancy: it widens their sum by half a per cent,
/// and the posterior is no thread that no sampler follows.
const SHARP: f64 = 0.1;

/// The mean log-frequency of one mode over the baseline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BaselineMode {
    /// Mode order, from 1.
    pub order: usize,
    /// ybar_n: ln f at the baseline's mean force, f in Hz.
    pub log_frequency: f64,
    /// Its standard error.
    pub log_sd: f64,
    /// Number of records of the baseline in which the mode was measured.
    pub records: usize,
}

/// Reference for later records (design 4.5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// Start of the first record.
    pub first: Timestamp,
    /// Start of the last record.
    pub last: Timestamp,
    /// Number of records.
    pub records: usize,
    /// The usual distance between them \[s\]; `None` of fewer than two, and from earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub usual_s: Option<f64>,
    /// The modes, ascending in order.
    pub modes: Vec<BaselineMode>,
    /// Scatter of the frequencies over their standard errors, as a factor, at least one.
    pub overdispersion: f64,
    /// Parameter vectors of equal weight, row-major (particles x quantities), SI: the posterior of the
    /// static parameters and of N_0 given the mean frequencies.
    pub particles: Vec<f64>,
    /// Smallest and largest root mean square of the records' samples, SI of their unit.
    pub rms: (f64, f64),
    /// Distance of the mean frequencies from the model within its discrepancy: smallest chi over the
    /// particles.
    pub misfit: f64,
}

/// Reason why records give no baseline.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum BaselineFault {
    /// No mode was measured often enough.
    #[error("no mode was measured in at least a third of {records} records")]
    NoMode {
        /// Number of records.
        records: usize,
    },
    /// No parameters of the rod give such frequencies.
    #[error("no rod the prior allows has these frequencies")]
    NoParticle,
    /// No rod has these frequencies and the results of its tests, or none was found.
    #[error("the rod's tests are left out of the baseline, because with its mean frequencies {0}")]
    Tests(#[from] JointError),
}

impl Baseline {
    /// Learns a baseline from records in event order. `discrepancy`: relative, one per mode order from 1; a
    /// mode beyond it has none. A mode that fewer than a third of the records have is left out.
    ///
    /// The levels ybar_n follow from the two-way fit of `levels`; the particles are the posterior of (theta, x, N_0) for
    ///
    /// ```text
    /// ybar_n = ln f_n(theta, x, N_0) + b_n + e_n,   b_n ~ N(0, discrepancy_n^2),  e_n ~ N(0, sd_ybar_n^2).
    /// ```
    ///
    /// # Errors
    /// The records do not agree on any mode, or no rod has such frequencies.
    pub fn learn(
        observations: &[Observation],
        prior: &RodPrior,
        model: &dyn ForwardModel,
        discrepancy: &[f64],
        particles: usize,
        seed: u64,
    ) -> Result<Self, BaselineFault> {
        let is_kept = are_sound(observations);
        let kept: Vec<Observation>;
        let observations = match is_kept.iter().all(|kept| *kept) {
            true => observations,
            false => {
                let both = observations.iter().zip(&is_kept);
                kept = both
                    .filter(|(_, kept)| **kept)
                    .map(|(one, _)| one.clone())
                    .collect();
                &kept
            }
        };
        let records = observations.len();
        let counts = counts(observations, model.modes().min(MAX_MODES));
        let used = counts.map(|count| count > 0 && 3 * count >= records);
        let modes = used.iter().rposition(|used| *used).map_or(0, |slot| slot + 1);
        let (Some(first), Some(last), 1..) = (observations.first(), observations.last(), modes) else {
            return Err(BaselineFault::NoMode { records });
        };
        let of = |purpose: &[u8]| random::seed(&[purpose, &seed.to_le_bytes()]);
        let draws = Population::of_prior(prior, model, modes, of(b"prior"));
        let pilots = draws
            .pilot(
                &rough_targets(observations, &used, discrepancy),
                PILOTS,
                of(b"pilot"),
            )
            .ok_or(BaselineFault::NoParticle)?;
        let levels = levels::fit(observations, &used, &slopes(&pilots, model, modes));
        let known: Vec<BaselineMode> = (0..modes)
            .filter(|&slot| used[slot])
            .map(|slot| BaselineMode {
                order: slot + 1,
                log_frequency: levels.level[slot],
                log_sd: levels.sd[slot],
                records: counts[slot],
            })
            .collect();
        let targets: Vec<Target> = known
            .iter()
            .map(|mode| Target {
                order: mode.order,
                level: mode.log_frequency,
                variance: stated(discrepancy, mode.order).powi(2) + mode.log_sd.max(LEAST_LOG_SD).powi(2),
            })
            .collect();
        let (population, misfit) = draws
            .posterior(&targets, prior, model, particles.max(1), of(b"posterior"))
            .ok_or(BaselineFault::NoParticle)?;
        let rms = observations
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), observation| {
                (low.min(observation.rms), high.max(observation.rms))
            });
        Ok(Self {
            first: first.start,
            last: last.start,
            records,
            usual_s: spacing::usual_s(observations.iter().map(|one| one.start)),
            modes: known,
            overdispersion: levels.overdispersion,
            particles: population.thetas,
            rms,
            misfit,
        })
    }

    /// The same baseline with particles of the posterior given tests of the rod too, moment by moment: every moment has its own
    /// force, everything else and the model's discrepancy b_n are those of the baseline. Without tests nothing changes.
    ///
    /// # Errors
    /// Tests and mean frequencies that contradict each other, or whose posterior is too thin to be sampled.
    pub fn after(
        &self,
        tests: &[Vec<Datum>],
        prior: &RodPrior,
        discrepancy: &[f64],
        seed: u64,
    ) -> Result<Self, BaselineFault> {
        let mut tested = self.clone();
        if tests.is_empty() {
            return Ok(tested);
        }
        let now = self.modes.iter().map(|mode| {
            let frequency_hz = libm::exp(mode.log_frequency);
            let log_sd = mode
                .log_sd
                .max(LEAST_LOG_SD)
                .max(SHARP * stated(discrepancy, mode.order));
            Datum::frequency(mode.order, frequency_hz, frequency_hz * log_sd)
        });
        let mut moments = vec![now.collect()];
        moments.extend_from_slice(tests);
        let joint = Joint {
            prior,
            discrepancy,
            moments: &moments,
            settings: JointSettings::default(),
        };
        let found = joint.posterior_alone(seed)?.posterior;
        let width = prior.parameterisation().len();
        let mut generator = random::stream(random::seed(&[b"tested", &seed.to_le_bytes()]), 0);
        let count = self.particles.len() / width;
        tested.particles = random::systematic(&found.weights, count, &mut generator)
            .into_iter()
            .flat_map(|row| &found.particles[row * width..][..width])
            .copied()
            .collect();
        Ok(tested)
    }
}

/// Number of records in which each of the first `modes` orders was measured.
fn counts(observations: &[Observation], modes: usize) -> [usize; MAX_MODES] {
    std::array::from_fn(|slot| {
        let measured = |observation: &&Observation| {
            slot < modes
                && observation
                    .mode(slot + 1)
                    .is_some_and(|mode| levels::usable(mode.log_frequency, mode.log_sd))
        };
        observations.iter().filter(measured).count()
    })
}

fn stated(discrepancy: &[f64], order: usize) -> f64 {
    discrepancy.get(order - 1).copied().unwrap_or(0.0)
}

/// Plain means of the log-frequencies, with room for the effects of a moving force and of missing modes.
fn rough_targets(observations: &[Observation], used: &[bool; MAX_MODES], discrepancy: &[f64]) -> Vec<Target> {
    let mean = |order: usize| {
        let (mut sum, mut weights) = (0.0, 0.0);
        for mode in observations
            .iter()
            .filter_map(|observation| observation.mode(order))
        {
            if levels::usable(mode.log_frequency, mode.log_sd) {
                let weight = (mode.log_sd * mode.log_sd + ROUGH * ROUGH).recip();
                sum += weight * mode.log_frequency;
                weights += weight;
            }
        }
        sum / weights
    };
    (1..=MAX_MODES)
        .filter(|order| used[order - 1])
        .map(|order| Target {
            order,
            level: mean(order),
            variance: stated(discrepancy, order).powi(2) + ROUGH * ROUGH,
        })
        .collect()
}

/// Mean, covariance and mean derivative of the slopes d ln f_n / d ln N over a few particles.
fn slopes(pilots: &Population, model: &dyn ForwardModel, modes: usize) -> Slopes {
    let width = model.parameterisation().len();
    let at = |theta: &[f64], u: f64| {
        let mut moved = theta.to_vec();
        moved[0] *= libm::exp(u);
        let mut slopes = [0.0; MAX_MODES];
        model
            .log_slopes(&moved, &mut slopes[..modes])
            .ok()
            .map(|()| Column::from(slopes))
    };
    let rows: Vec<(Column, Column)> = pilots
        .thetas
        .chunks_exact(width)
        .filter_map(|theta| {
            let (below, above) = (at(theta, -BEND)?, at(theta, BEND)?);
            Some(((below + above) * 0.5, (above - below) / (2.0 * BEND)))
        })
        .collect();
    let count = rows.len().max(1) as f64;
    let mean = rows.iter().map(|row| row.0).sum::<Column>() / count;
    let covariance = rows
        .iter()
        .map(|row| (row.0 - mean) * (row.0 - mean).transpose())
        .sum::<Square>()
        / count;
    let curvature = rows.iter().map(|row| row.1).sum::<Column>() / count;
    Slopes {
        mean,
        covariance,
        curvature,
    }
}
