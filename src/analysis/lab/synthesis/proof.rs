//! Simulated sites through the real fold: the trackers' alarms about rods whose truth is known.

use super::oscillator::normal;
use super::site_years::{Fate, Moment, SiteYears};
use super::world::World;
use super::{Change, SynthesisError};
use crate::numerics::random;
use crate::rod::beam::Exact;
use crate::rod::beam::forward::ForwardModel;
use crate::rod::prior::RodPrior;
use crate::signal::record::time::DAY_S;
use crate::signal::record::{Reading, Timestamp};
use crate::track::{Input, Kind, LogMode, Observation, Others, RodState, TrackPlan, Tracker, What, Witness};
use serde::Serialize;
use std::sync::Arc;

const RECORD_S: f64 = 120.0;
/// Least share of its force that a rod keeps at the warmest; others are drawn again, as rods near to slack
/// are not followed.
const TAUT: f64 = 0.4;
/// Most draws before a rod is given up.
const TRIES: u64 = 200;
/// Mode disturbed by a line.
const DISTURBED: usize = 2;
/// Root mean square of every record \[m\].
const RMS_M: f64 = 1e-5;

/// Settings of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Prior from which the rods are drawn.
    pub prior: RodPrior,
    /// Standard deviation of the static discrepancy of ln f_n, one per mode measured.
    pub discrepancy: Vec<f64>,
    /// Relative standard error of each frequency.
    pub frequency_sd: f64,
    /// Restraint of the ends, 0 free to expand and 1 rigid; if given, it replaces a slope of one per kelvin
    /// in the world.
    pub restraint: Option<f64>,
    /// Thermal expansion \[1/K\].
    pub expansion_per_k: f64,
    /// Change of the first rod, its time in days from the first record.
    pub change: Option<Change>,
    /// Number of records of the baseline.
    pub baseline: usize,
    /// Number of days simulated.
    pub days: usize,
    /// Midnight before the first record.
    pub midnight: Timestamp,
}

/// An alarm that was raised.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Raised {
    /// Kind of the alarm.
    pub kind: Kind,
    /// Witness of a drift: the statistic that raised it.
    pub witness: Option<Witness>,
    /// Days from the first midnight to the record that raised it.
    pub day: f64,
    /// Coverage of the intervals of size and onset, for a drift of a rod that changed: true where the
    /// interval holds the truth.
    pub held: Option<[bool; 2]>,
}

/// Result of one rod.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outcome {
    /// Alarms, in the order they were raised.
    pub raised: Vec<Raised>,
    /// True if the rod was followed at all.
    pub monitored: bool,
    /// Number of records with a change since the baseline, and of those whose 95 % interval held the truth.
    pub told: [usize; 2],
    /// Number of draws that would have come near to slack.
    pub redrawn: u64,
}

/// A rod of the simulation.
struct Rod {
    theta: Vec<f64>,
    offsets: Vec<f64>,
    moments: Vec<Moment>,
    /// Mean force of the baseline's records over that at the mean temperature.
    reference: f64,
    redrawn: u64,
}

impl Trial {
    /// Follows site number `index` of a world: as many rods as there are plans.
    ///
    /// # Errors
    /// No rod of the prior stays taut.
    pub fn follow(
        &self,
        plans: &[Arc<TrackPlan>],
        world: &World,
        index: u64,
        seed: u64,
    ) -> Result<Vec<Outcome>, SynthesisError> {
        let seed = random::seed(&[b"site proof", &seed.to_le_bytes(), &index.to_le_bytes()]);
        let site = SiteYears::new(
            world,
            plans.len(),
            self.days,
            self.midnight,
            self.change.as_ref(),
            seed,
        );
        let model = Exact::new(*self.prior.parameterisation());
        let mut rods = Vec::with_capacity(plans.len());
        for (place, moments) in site.rods.into_iter().enumerate() {
            rods.push(self.draw(moments, plans[place].as_ref(), seed, place as u64)?);
        }
        let mut trackers: Vec<Tracker> = plans.iter().map(|plan| Tracker::new(plan.clone())).collect();
        let mut outcomes: Vec<Outcome> = rods
            .iter()
            .map(|rod| Outcome {
                redrawn: rod.redrawn,
                ..Outcome::default()
            })
            .collect();
        let mut order: Vec<(Timestamp, usize, usize)> = Vec::new();
        for (place, rod) in rods.iter().enumerate() {
            let there = |(at, moment): (usize, &Moment)| {
                (moment.fate != Fate::Missing).then_some((moment.start, place, at))
            };
            order.extend(rod.moments.iter().enumerate().filter_map(there));
        }
        order.sort_unstable();
        let mut read = vec![0; rods.len()];
        let mut generator = random::stream(random::seed(&[b"site errors", &seed.to_le_bytes()]), 0);
        for (start, place, at) in order {
            let rod = &rods[place];
            let moment = &rod.moments[at];
            let end = start.plus_seconds(RECORD_S);
            let until = site.readings.partition_point(|reading| reading.time <= end);
            let readings = site.readings[read[place]..until].to_vec();
            read[place] = until;
            let input = self.input(&model, rod, moment, readings, &mut generator)?;
            let (before, rest) = trackers.split_at_mut(place);
            let Some((tracker, after)) = rest.split_first_mut() else {
                continue;
            };
            let others = Others::new(before.iter().chain(after.iter()).map(Tracker::state));
            let verdict = tracker.step_beside(&input, &[], &others);
            let outcome = &mut outcomes[place];
            outcome.monitored |= verdict.state == RodState::Monitoring;
            let truth = moment.change / rod.reference;
            if let Some(at_reference) = verdict.at_reference {
                let ratio = at_reference.ratio;
                outcome.told[0] += 1;
                outcome.told[1] += usize::from(ratio.q025 <= 1.0 + truth && 1.0 + truth <= ratio.q975);
            }
            let day = start.seconds_since(self.midnight) / DAY_S;
            for event in verdict.events.iter().filter(|event| event.what == What::Raised) {
                let onset = self.change.filter(|change| place == 0 && day >= change.start_d);
                let held = onset.zip(event.alarm.change.as_ref()).map(|(change, told)| {
                    let begin = self.midnight.plus_seconds(change.start_d * DAY_S);
                    let size = told.size.q025 <= truth && truth <= told.size.q975;
                    // The first record after the change is up to a day later.
                    let onset = told.onset_q025 <= begin.plus_seconds(DAY_S)
                        && begin <= told.onset_q975.plus_seconds(DAY_S);
                    [size, onset]
                });
                outcome.raised.push(Raised {
                    kind: event.alarm.kind,
                    witness: event.alarm.witness,
                    day,
                    held,
                });
            }
        }
        Ok(outcomes)
    }

    /// Draws a rod of the prior that stays taut in these moments.
    fn draw(
        &self,
        moments: Vec<Moment>,
        plan: &TrackPlan,
        seed: u64,
        place: u64,
    ) -> Result<Rod, SynthesisError> {
        let mut theta = vec![0.0; self.prior.parameterisation().len()];
        let seed = random::seed(&[b"rod", &seed.to_le_bytes(), &place.to_le_bytes()]);
        let mut least = f64::NAN;
        for attempt in 0..TRIES {
            let mut generator = random::stream(seed, attempt);
            self.prior.sample(&mut generator, &mut theta);
            let own = self.moments_of(&theta, &moments);
            least = own.iter().map(Moment::force).fold(f64::INFINITY, f64::min);
            if least < TAUT {
                continue;
            }
            let learned: Vec<f64> = (own.iter())
                .filter(|moment| moment.fate == Fate::Measured)
                .map(|moment| moment.force() - moment.change)
                .take(self.baseline)
                .collect();
            return Ok(Rod {
                reference: learned.iter().sum::<f64>() / learned.len().max(1) as f64,
                offsets: self
                    .discrepancy
                    .iter()
                    .map(|sd| sd * normal(&mut generator))
                    .collect(),
                moments: own,
                theta,
                redrawn: attempt,
            });
        }
        Err(SynthesisError::Slack {
            rod: plan.rod().clone(),
            time: self.midnight,
            axial_force_n: least * theta[0],
        })
    }

    /// Moments scaled to this restraint, if one is given: kappa E A alpha / N per kelvin.
    fn moments_of(&self, theta: &[f64], moments: &[Moment]) -> Vec<Moment> {
        let Some(restraint) = self.restraint else {
            return moments.to_vec();
        };
        let rigidity = self.prior.parameterisation().axial_rigidity(theta);
        let share = restraint * rigidity * self.expansion_per_k / theta[0];
        let scaled = |moment: &Moment| Moment {
            thermal: share * moment.thermal,
            ..*moment
        };
        moments.iter().map(scaled).collect()
    }

    /// Record as tracking takes it.
    fn input<R: rand::Rng>(
        &self,
        model: &Exact,
        rod: &Rod,
        moment: &Moment,
        readings: Vec<Reading>,
        generator: &mut R,
    ) -> Result<Input, SynthesisError> {
        if moment.fate == Fate::Rejected {
            return Ok(Input::Rejected {
                start: Some(moment.start),
                reason: String::from("simulated"),
                readings,
            });
        }
        let mut theta = rod.theta.clone();
        theta[0] *= moment.force();
        let mut frequency_hz = vec![0.0; self.discrepancy.len()];
        model
            .frequencies(&theta, &mut frequency_hz)
            .map_err(|reason| SynthesisError::Beam {
                rod: crate::signal::record::RodId(String::from("proof")),
                reason,
            })?;
        let mode = |(n, frequency_hz): (usize, &f64)| {
            let order = n + 1;
            let line = if order == DISTURBED { moment.line } else { 0.0 };
            let error = self.frequency_sd * normal(generator);
            LogMode {
                order,
                log_frequency: libm::log(*frequency_hz) + rod.offsets[n] + line + error,
                log_sd: self.frequency_sd,
            }
        };
        Ok(Input::Identified(Observation {
            start: moment.start,
            duration_s: RECORD_S,
            modes: frequency_hz.iter().enumerate().map(mode).collect(),
            readings,
            rms: RMS_M,
            conflict: 0.0,
        }))
    }
}
