//! The displacement of a rod at the sensor: ambient response, free decays, interference, noise.

use super::noise::{Noise, quantised};
use super::oscillator::Oscillator;
use super::rod::{Rod, State, SynthesisError};
use super::settings::{Pull, PullKind};
use crate::random;
use crate::record::Timestamp;
use rand::RngExt;
use std::f64::consts::PI;

/// The rod's state is taken anew this often within a record \[s\].
const REFRESH_S: f64 = 60.0;

/// Random streams of one record.
const MODES: u64 = 0;
const SENSOR: u64 = 8;
const LINES: u64 = 9;
pub(super) const FAULTS: u64 = 10;
/// Streams kept for each record.
const PER_RECORD: u64 = 16;

/// Stream `purpose` of record `index`.
pub(super) fn stream_of(seed: u64, index: usize, purpose: u64) -> rand::rngs::ChaCha8Rng {
    random::stream(seed, index as u64 * PER_RECORD + purpose)
}

/// Displacement at the sensor \[m\], `samples` of them from `start` on, as the sensor gives it.
///
/// Modal superposition: u(t) = sum of w_n(x) q_n(t), each q_n the exactly sampled stationary response of
/// an oscillator to white noise plus the closed-form decays of the pulls. Modes above half the sample
/// rate are left out, as an anti-aliasing filter would. `nominal` is the state that calibrates the load.
pub(super) fn displacement(
    rod: &Rod<'_>,
    nominal: &State,
    fs_hz: f64,
    (index, start): (usize, Timestamp),
    samples: usize,
    seed: u64,
) -> Result<Vec<f64>, SynthesisError> {
    let settings = rod.settings;
    let dt = 1.0 / fs_hz;
    let block = ((REFRESH_S * fs_hz).ceil() as usize).max(1);
    let mut states = Vec::new();
    for begin in (0..samples).step_by(block) {
        let middle = begin as f64 + 0.5 * block.min(samples - begin) as f64;
        states.push(rod.at(start.plus_seconds(middle * dt), 0.0)?);
    }
    let mut output = vec![0.0; samples];
    for n in 0..settings.damping.len() {
        let zeta = settings.damping[n];
        let calibrated = Oscillator::new(nominal.frequency_hz[n], zeta);
        let first = Oscillator::new(nominal.frequency_hz[0], settings.damping[0]);
        // A load that is white in time and space acts on mode n with intensity over modal mass.
        let intensity = first.intensity_for(settings.ambient_m) * nominal.shapes[0].mean_square()
            / nominal.shapes[n].mean_square();
        let mut generator = stream_of(seed, index, MODES + n as u64);
        let mut state = calibrated.sampled(intensity, dt).stationary(&mut generator);
        for (now, chunk) in states.iter().zip(output.chunks_mut(block)) {
            let visible = now.frequency_hz[n] < 0.5 * fs_hz;
            let oscillator = Oscillator::new(now.frequency_hz[n], zeta).sampled(intensity, dt);
            let seen = now.shapes[n].at(settings.sensor.at);
            for sample in chunk {
                if visible {
                    *sample += seen * state.0;
                }
                state = oscillator.step(state, &mut generator);
            }
        }
    }
    if let Some(pull) = &settings.pull {
        add_pulls(rod, pull, &states[0], fs_hz, &mut output);
    }
    let mut generator = stream_of(seed, index, LINES);
    for line in &settings.interference {
        let phase: f64 = generator.random::<f64>() * 2.0 * PI;
        for (k, sample) in output.iter_mut().enumerate() {
            *sample += line.amplitude_m * libm::sin(2.0 * PI * line.frequency_hz * k as f64 * dt + phase);
        }
    }
    let mut generator = stream_of(seed, index, SENSOR);
    let mut noise = Noise::new(&settings.sensor, fs_hz, &mut generator);
    for sample in &mut output {
        *sample = quantised(*sample + noise.next(&mut generator), settings.sensor.resolution_m);
    }
    Ok(output)
}

/// Adds every pull of one record.
///
/// A point force F at x deflects mode n by q_n = F w_n(x) / (omega_n^2 M_n), a point impulse J starts it
/// with q_n' = J w_n(x) / M_n, where M_n is the modal mass.
fn add_pulls(rod: &Rod<'_>, pull: &Pull, state: &State, fs_hz: f64, output: &mut [f64]) {
    let settings = rod.settings;
    let modes: Vec<(Oscillator, f64, f64, f64)> = state
        .frequency_hz
        .iter()
        .zip(&state.shapes)
        .zip(&settings.damping)
        .filter(|((f, _), _)| **f < 0.5 * fs_hz)
        .map(|((f, shape), zeta)| {
            let omega = 2.0 * PI * f;
            let participation = shape.at(pull.at) / shape.mean_square();
            (
                Oscillator::new(*f, *zeta),
                omega,
                participation,
                shape.at(settings.sensor.at),
            )
        })
        .collect();
    let Some((_, first_omega, first_participation, _)) = modes.first() else {
        return;
    };
    let scale = match pull.kind {
        PullKind::Release => {
            let flexibility: f64 = state
                .shapes
                .iter()
                .zip(&modes)
                .map(|(shape, (_, omega, participation, _))| {
                    participation * shape.at(pull.at) / (omega * omega)
                })
                .sum();
            pull.deflection_m / flexibility
        }
        PullKind::Blow => pull.deflection_m * first_omega / first_participation,
    };
    let mut release = pull.first_s;
    while release < output.len() as f64 / fs_hz {
        for (oscillator, omega, participation, seen) in &modes {
            let load = scale * participation;
            let begin = match pull.kind {
                PullKind::Release => (load / (omega * omega), 0.0),
                PullKind::Blow => (0.0, load),
            };
            for (k, sample) in output.iter_mut().enumerate() {
                let since = k as f64 / fs_hz - release;
                if since >= 0.0 {
                    *sample += seen * oscillator.free(begin, since).0;
                } else if since > -pull.ramp_s {
                    *sample += seen * begin.0 * (1.0 + since / pull.ramp_s);
                }
            }
        }
        release += pull.every_s;
    }
}
