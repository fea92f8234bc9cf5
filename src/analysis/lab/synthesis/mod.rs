//! Displacement histories of a simulated rod: the truth, the response, the faults.
//!
//! A [`Synthesis`] is made once; [`Synthesis::record`] then gives any record of it on its own, so that
//! records can be made in any order and on any number of threads with the same result to the bit.

mod climate;
mod faults;
mod history;
mod load;
mod noise;
mod oscillator;
mod outlook;
mod proof;
mod response;
mod rod;
mod settings;
mod site_years;
mod world;

pub use crate::rod::beam::shape::Shape;
pub use climate::{Lagged, Weather};
pub use faults::Message;
pub use history::{FrequencyErrors, Measured, history};
pub use noise::{Noise, quantised};
pub use oscillator::{Oscillator, Sampled};
pub use outlook::{HORIZON_D, Outlook, Told, Tried};
pub use proof::{Outcome, Raised, Trial};
pub use rod::{State, SynthesisError};
pub use settings::{
    AddedMass, Change, Climate, Fault, FaultKind, FurtherSensor, Gusts, Knocks, Line, Neighbour, Pull,
    PullKind, Resonance, Sensor, SimulatedRod, Simulation, Thermal, Truth,
};
pub use site_years::{Fate, Moment, SiteYears};
pub use world::{FAULT_D, Thermometer, World};

use crate::numerics::random;
use crate::signal::record::{RodId, Timestamp};
use faults::{spoil_messages, spoil_samples};
use oscillator::normal;
use response::Eye;
use rod::Rod;

/// Smallest step of the simulated thermometer \[K\].
const THERMOMETER_STEP_K: f64 = 0.01;

/// A prepared simulation.
pub struct Synthesis<'s> {
    simulation: &'s Simulation,
    seed: u64,
    weather: Option<Weather>,
}

/// One record of one rod, with the truth behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedRecord {
    /// Id of the rod.
    pub rod: RodId,
    /// Number of the record, from 1.
    pub number: usize,
    /// True time of the first sample.
    pub start: Timestamp,
    /// True state in the middle of the record.
    pub truth: State,
    /// Displacement in the order of sending, SI.
    pub displacement: Vec<Message>,
    /// Signals of the further sensors, SI.
    pub further: Vec<Vec<Message>>,
    /// Temperature \[degC\], one sample per message; empty if there is no climate.
    pub temperature: Vec<Message>,
}

impl<'s> Synthesis<'s> {
    /// Prepares a simulation; the same seed gives the same records to the bit.
    pub fn new(simulation: &'s Simulation, seed: u64) -> Self {
        let weather = simulation.climate.map(|climate| {
            let seed = random::seed(&[b"simulated weather", &seed.to_le_bytes()]);
            Weather::new(&climate, simulation.start, simulation.duration_s(), seed)
        });
        Self {
            simulation,
            seed,
            weather,
        }
    }

    /// Record `index` (from 0) of rod `rod` (from 0).
    ///
    /// # Errors
    /// The rod would go slack, or no mode lies below half the sample rate.
    ///
    /// # Panics
    /// If there is no such rod.
    pub fn record(&self, rod: usize, index: usize) -> Result<SimulatedRecord, SynthesisError> {
        let simulation = self.simulation;
        let settings = &simulation.rods[rod];
        let fs_hz = simulation.fs_hz;
        let seed = random::seed(&[
            b"simulated rod",
            &self.seed.to_le_bytes(),
            settings.rod.0.as_bytes(),
        ]);
        let start = simulation.start_of(index);
        let samples = simulation.samples();
        let rod = Rod::new(simulation, settings, self.weather.as_ref());
        let nominal = rod.at(simulation.start, 0.0)?;
        let truth = rod.at(start.plus_seconds(0.5 * samples as f64 / fs_hz), 0.0)?;
        let first = truth.frequency_hz.first().copied().unwrap_or(f64::INFINITY);
        if first >= 0.5 * fs_hz {
            let rod = settings.rod.clone();
            return Err(SynthesisError::Undersampled {
                rod,
                frequency_hz: first,
                fs_hz,
            });
        }
        let signal =
            |eye: &Eye<'_>| response::displacement(&rod, &nominal, fs_hz, (index, start), samples, seed, eye);
        let mut displacement = signal(&Eye {
            sensor: &settings.sensor,
            sees: &|shape| settings.sensor.sees(shape),
            number: 0,
        })?;
        let length = simulation.samples_per_message.max(1);
        let sent = |samples: &[f64]| -> Vec<Message> {
            samples
                .chunks(length)
                .enumerate()
                .map(|(i, samples)| Message {
                    stamp: start.plus_seconds((i * length) as f64 / fs_hz),
                    samples: samples.to_vec(),
                })
                .collect()
        };
        let further = (1..)
            .zip(&settings.further)
            .map(|(number, further)| {
                let samples = signal(&Eye {
                    sensor: &further.sensor,
                    sees: &|shape| further.sees(shape),
                    number,
                })?;
                Ok(sent(&samples))
            })
            .collect::<Result<_, SynthesisError>>()?;
        let number = index + 1;
        let faults: Vec<FaultKind> = settings
            .faults
            .iter()
            .filter(|fault| (fault.first_record..=fault.last_record).contains(&number))
            .map(|fault| fault.kind)
            .collect();
        let mut generator = response::stream_of(seed, index, response::FAULTS);
        spoil_samples(&faults, fs_hz, &mut displacement, &mut generator);
        let mut messages = sent(&displacement);
        spoil_messages(&faults, fs_hz, start, &mut messages, &mut generator);
        Ok(SimulatedRecord {
            rod: settings.rod.clone(),
            number,
            start,
            truth,
            displacement: messages,
            further,
            temperature: self.temperature(index, start),
        })
    }

    /// Readings of the thermometer during record `index` and until the next: the air, with its own
    /// noise; one for all rods.
    fn temperature(&self, index: usize, start: Timestamp) -> Vec<Message> {
        let (Some(weather), Some(climate)) = (&self.weather, &self.simulation.climate) else {
            return Vec::new();
        };
        let seed = random::seed(&[b"simulated thermometer", &self.seed.to_le_bytes()]);
        let mut generator = random::stream(seed, index as u64);
        let record_s = self.simulation.record_s;
        let within = (record_s / climate.every_s).floor() as usize + 1;
        let mut times: Vec<f64> = (0..within).map(|i| i as f64 * climate.every_s).collect();
        if let Some(step) = climate.between_s.filter(|_| index + 1 < self.simulation.records) {
            let between = ((self.simulation.interval_s - record_s) / step).ceil() as usize;
            times.extend((1..between).map(|i| record_s + i as f64 * step));
        }
        times
            .into_iter()
            .map(|seconds| {
                let stamp = start.plus_seconds(seconds);
                let measured = weather.air_c(stamp) + climate.noise_k * normal(&mut generator);
                Message {
                    stamp,
                    samples: vec![quantised(measured, THERMOMETER_STEP_K)],
                }
            })
            .collect()
    }
}

impl Simulation {
    /// Number of samples in a record.
    pub fn samples(&self) -> usize {
        (self.record_s * self.fs_hz).round() as usize
    }

    /// Start of record `index`, from 0.
    fn start_of(&self, index: usize) -> Timestamp {
        self.start.plus_seconds(index as f64 * self.interval_s)
    }

    /// From the first sample to the end of the last record \[s\].
    pub fn duration_s(&self) -> f64 {
        self.records.saturating_sub(1) as f64 * self.interval_s + self.record_s
    }
}
