//! One simulated history through the real fold: what the tracker would have told about a rod whose truth is known.

use super::{Change, Climate, FrequencyErrors, SimulatedRod, Simulation, SynthesisError, Thermal, Truth};
use super::{Sensor, history, oscillator::normal};
use crate::bayes::RodPrior;
use crate::random;
use crate::record::{Channel, RodId, TimeSource, Timestamp, Unit};
use crate::track::{Input, Kind, RodState, TrackPlan, Tracker, What};
use std::sync::Arc;

const DAY_S: f64 = 86_400.0;
const RECORD_S: f64 = 120.0;
/// Share of its force a rod keeps at the warmest: others are drawn anew, as rods near to slack are not followed.
const TAUT: f64 = 0.4;
/// Rods drawn before a history is given up.
const TRIES: u64 = 200;

/// What is simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Rods are drawn from it.
    pub prior: RodPrior,
    /// Standard deviation of the static discrepancy of ln f_n, one per mode measured.
    pub discrepancy: Vec<f64>,
    /// The weather.
    pub climate: Climate,
    /// How temperature acts on the force.
    pub thermal: Thermal,
    /// How frequencies are measured; its offsets are drawn anew for every history.
    pub errors: FrequencyErrors,
    /// A change of the force, its time counted in days from the first charted period.
    pub change: Option<Change>,
    /// Records before the first charted period.
    pub learned: usize,
    /// Records that are charted.
    pub charted: usize,
    /// From one record to the next \[s\].
    pub interval_s: f64,
    /// The first record of the first history.
    pub start: Timestamp,
}

/// What came of one history.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Kinds of alarms raised and when, in days from the first charted period to the record with which it was told.
    pub raised: Vec<(Kind, f64)>,
    /// Whether the rod was followed when all was learned.
    pub monitored: bool,
    /// Rods drawn anew because they would have come near to slack.
    pub redrawn: u64,
}

impl Trial {
    /// History number `index` of `count`: its own rod, discrepancy and weather; starts are spread over the year.
    ///
    /// # Errors
    /// No rod of the prior stays taut.
    pub fn follow(
        &self,
        plan: &Arc<TrackPlan>,
        index: usize,
        count: usize,
        seed: u64,
    ) -> Result<Outcome, SynthesisError> {
        let seed = random::seed(&[b"proof", &seed.to_le_bytes(), &(index as u64).to_le_bytes()]);
        let spread_d = (365.25 * index as f64 / count as f64).floor();
        let simulation = Simulation {
            fs_hz: 100.0,
            start: self.start.plus_seconds(spread_d * DAY_S),
            record_s: RECORD_S,
            // One more, with which the last period closes.
            records: self.learned + self.charted + 1,
            interval_s: self.interval_s,
            samples_per_message: 1,
            climate: Some(self.climate),
            rods: Vec::new(),
        };
        let (mut redrawn, mut slack) = (0, None);
        for attempt in 0..TRIES {
            let (rod, errors) = self.draw(seed, attempt);
            let records = match history(&simulation, &rod, &errors, random::seed(&[&seed.to_le_bytes()])) {
                Ok(records) => records,
                Err(error) => {
                    slack = Some(error);
                    redrawn += 1;
                    continue;
                }
            };
            let Truth::Beam { theta, .. } = &rod.truth else {
                continue;
            };
            let is_taut =
                |record: &super::Measured| record.axial_force_n > TAUT * theta[0] * record.relative_force;
            if !records.iter().all(is_taut) {
                redrawn += 1;
                continue;
            }
            let begin = simulation.start_of(self.learned);
            let mut tracker = Tracker::new(plan.clone());
            let (mut raised, mut monitored) = (Vec::new(), false);
            for record in records {
                let time = record.observation.start;
                let verdict = tracker.step(&Input::Identified(record.observation), &[]);
                monitored |= verdict.state == RodState::Monitoring;
                let news = verdict.events.iter().filter(|event| event.what == What::Raised);
                raised.extend(news.map(|event| (event.alarm.kind, time.seconds_since(begin) / DAY_S)));
            }
            return Ok(Outcome {
                raised,
                monitored,
                redrawn,
            });
        }
        Err(slack.unwrap_or(SynthesisError::Slack {
            rod: plan.rod().clone(),
            time: simulation.start,
            axial_force_n: 0.0,
        }))
    }

    /// A rod, and how its frequencies are measured.
    fn draw(&self, seed: u64, attempt: u64) -> (SimulatedRod, FrequencyErrors) {
        let mut generator = random::stream(random::seed(&[b"rod", &seed.to_le_bytes()]), attempt);
        let mut theta = vec![0.0; self.prior.parameterisation().len()];
        self.prior.sample(&mut generator, &mut theta);
        let offsets = self
            .discrepancy
            .iter()
            .map(|sd| sd * normal(&mut generator))
            .collect();
        let learned_d = self.learned as f64 * self.interval_s / DAY_S;
        let nowhere = Channel {
            topic: String::new(),
            field: String::new(),
            unit: Unit::Metre,
            time: TimeSource::Log,
            fs_hz: None,
        };
        let rod = SimulatedRod {
            rod: RodId(String::from("proof")),
            displacement: nowhere,
            temperature: None,
            truth: Truth::Beam {
                section: self.prior.parameterisation().section(),
                theta,
            },
            damping: vec![0.002; self.discrepancy.len()],
            ambient_m: 0.0,
            gusts: None,
            pull: None,
            knocks: None,
            neighbour: None,
            resonances: Vec::new(),
            sensor: Sensor {
                at: 0.4,
                noise_m: 0.0,
                pink_m: 0.0,
                resolution_m: 0.0,
            },
            interference: Vec::new(),
            thermal: self.thermal,
            changes: (self.change.iter())
                .map(|change| Change {
                    start_d: change.start_d + learned_d,
                    ..*change
                })
                .collect(),
            added_mass: None,
            faults: Vec::new(),
        };
        (
            rod,
            FrequencyErrors {
                offsets,
                ..self.errors.clone()
            },
        )
    }
}
