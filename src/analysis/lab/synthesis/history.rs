//! Months of a simulated rod at the level of frequencies, without waveforms: thousands of years in minutes.

use super::climate::Weather;
use super::oscillator::normal;
use super::rod::Rod;
use super::{SimulatedRod, Simulation, SynthesisError};
use crate::numerics::random;
use crate::signal::record::{Reading, Timestamp};
use crate::track::{LogMode, Observation};

/// Errors of the measured frequencies.
#[derive(Debug, Clone, PartialEq)]
pub struct FrequencyErrors {
    /// Relative standard error of each frequency; the modes are those of the rod's damping list.
    pub log_sd: f64,
    /// Static model discrepancy, added to ln f_n of every record.
    pub offsets: Vec<f64>,
    /// Standard deviation of the force's own fluctuation, relative to the force.
    pub fluctuation: f64,
    /// Correlation of that fluctuation from one record to the next.
    pub autocorrelation: f64,
    /// Orders that are not measured.
    pub missing: Vec<usize>,
}

/// One record of a history with the truth behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Observation that tracking takes.
    pub observation: Observation,
    /// True axial force \[N\].
    pub axial_force_n: f64,
    /// Force over the force before any change, without temperature and fluctuation.
    pub relative_force: f64,
    /// True temperature of the rod \[degC\].
    pub rod_c: Option<f64>,
}

/// The records of one rod; the same seed gives the same history. Temperature is read every
/// `climate.between_s` (an hour by default) and at the end of each record.
///
/// # Errors
/// The rod would go slack.
pub fn history(
    simulation: &Simulation,
    rod: &SimulatedRod,
    errors: &FrequencyErrors,
    seed: u64,
) -> Result<Vec<Measured>, SynthesisError> {
    let weather = simulation.climate.map(|climate| {
        let seed = random::seed(&[b"simulated weather", &seed.to_le_bytes()]);
        Weather::new(&climate, simulation.start, simulation.duration_s(), seed)
    });
    let rod = Rod::new(simulation, rod, weather.as_ref());
    let mut generator = random::stream(random::seed(&[b"simulated frequencies", &seed.to_le_bytes()]), 0);
    let memory = errors.autocorrelation;
    let innovation = (1.0 - memory * memory).sqrt();
    let mut fluctuation = normal(&mut generator);
    let mut read_until: Option<Timestamp> = None;
    let mut records = Vec::with_capacity(simulation.records);
    for index in 0..simulation.records {
        let start = simulation.start_of(index);
        let middle = start.plus_seconds(0.5 * simulation.record_s);
        let state = rod.at(middle, errors.fluctuation * fluctuation)?;
        fluctuation = memory * fluctuation + innovation * normal(&mut generator);
        let mut modes = Vec::with_capacity(state.frequency_hz.len());
        for (n, frequency_hz) in state.frequency_hz.iter().enumerate() {
            let order = n + 1;
            let error = errors.log_sd * normal(&mut generator);
            if !errors.missing.contains(&order) {
                modes.push(LogMode {
                    order,
                    log_frequency: libm::log(*frequency_hz)
                        + errors.offsets.get(n).copied().unwrap_or(0.0)
                        + error,
                    log_sd: errors.log_sd,
                });
            }
        }
        let end = start.plus_seconds(simulation.record_s);
        let readings = match (&weather, &simulation.climate) {
            (Some(weather), Some(climate)) => {
                let step = climate.between_s.unwrap_or(3600.0);
                let mut readings = Vec::new();
                let mut time = read_until.unwrap_or(start.plus_seconds(-simulation.interval_s));
                while end.seconds_since(time) > step {
                    time = time.plus_seconds(step);
                    readings.push(time);
                }
                readings.push(end);
                read_until = Some(end);
                readings
                    .into_iter()
                    .map(|time| Reading {
                        time,
                        celsius: weather.air_c(time) + climate.noise_k * normal(&mut generator),
                    })
                    .collect()
            }
            _ => Vec::new(),
        };
        records.push(Measured {
            observation: Observation {
                start,
                duration_s: simulation.record_s,
                modes,
                readings,
                rms: 1e-5,
                conflict: 0.0,
            },
            axial_force_n: state.axial_force_n.unwrap_or(0.0),
            relative_force: state.relative_force,
            rod_c: state.rod_c,
        });
    }
    Ok(records)
}
