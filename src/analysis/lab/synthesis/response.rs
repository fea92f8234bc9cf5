//! The displacement of a rod at the sensor: ambient response, free decays, neighbours and other resonances,
//! interference, noise.

use super::load::{Amplitude, knocks};
use super::noise::{Noise, quantised};
use super::oscillator::Oscillator;
use super::rod::{Rod, State, SynthesisError};
use super::settings::{PullKind, Sensor};
use crate::numerics::random;
use crate::rod::beam::shape::Shape;
use crate::signal::record::Timestamp;
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use std::f64::consts::PI;

/// Interval at which the rod's state is updated within a record \[s\].
const REFRESH_S: f64 = 60.0;

/// Random streams of one record.
const MODES: u64 = 0;
const SENSOR: u64 = 8;
const LINES: u64 = 9;
pub(super) const FAULTS: u64 = 10;
const GUSTS: u64 = 11;
const KNOCKS: u64 = 12;
const RESONANCES: u64 = 13;
/// Streams kept for each record.
const PER_RECORD: u64 = 16;

/// Stream `purpose` of record `index`.
pub(super) fn stream_of(seed: u64, index: usize, purpose: u64) -> ChaCha8Rng {
    random::stream(seed, index as u64 * PER_RECORD + purpose)
}

/// Stream of mode `n` (from 0) of record `index`; modes beyond the first eight have a seed of their own.
fn stream_of_mode(seed: u64, index: usize, n: usize) -> ChaCha8Rng {
    let purpose = MODES + n as u64;
    if purpose < SENSOR {
        return stream_of(seed, index, purpose);
    }
    let higher = random::seed(&[b"simulated higher modes", &seed.to_le_bytes()]);
    stream_of(higher, index, purpose - SENSOR)
}

/// Answer of a sensor to a rod's motion.
pub(super) struct Eye<'a> {
    /// Its noise.
    pub sensor: &'a Sensor,
    /// Modal amplitude that it sees of a shape.
    pub sees: &'a (dyn Fn(&Shape) -> f64 + Sync),
    /// Number among the rod's sensors, from 0: each has noise of its own.
    pub number: u64,
}

/// Signal of a sensor, SI, `samples` of it from `start` on, as the sensor gives it.
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
    eye: &Eye<'_>,
) -> Result<Vec<f64>, SynthesisError> {
    let settings = rod.settings;
    let dt = 1.0 / fs_hz;
    let block = ((REFRESH_S * fs_hz).ceil() as usize).max(1);
    let mut states = Vec::new();
    for begin in (0..samples).step_by(block) {
        let middle = begin as f64 + 0.5 * block.min(samples - begin) as f64;
        states.push(rod.at(start.plus_seconds(middle * dt), 0.0)?);
    }
    let mut generator = stream_of(seed, index, GUSTS);
    let gusts = settings.gusts.map(|gusts| {
        let mut amplitude = Amplitude::new(&gusts, fs_hz, &mut generator);
        (0..samples).map(|_| amplitude.next(&mut generator)).collect()
    });
    let ambient = Ambient {
        rod,
        eye,
        nominal,
        states: &states,
        fs_hz,
        block,
        gusts,
    };
    let mut output = vec![0.0; samples];
    ambient.add_modes(0.0, 1.0, |n| stream_of_mode(seed, index, n), &mut output);
    if let Some(neighbour) = &settings.neighbour {
        let other = random::seed(&[b"simulated neighbour", &seed.to_le_bytes()]);
        let streams = |n| stream_of_mode(other, index, n);
        ambient.add_modes(neighbour.detuning, neighbour.share, streams, &mut output);
    }
    ambient.add_resonances(&mut stream_of(seed, index, RESONANCES), &mut output);
    if let Some(pull) = &settings.pull {
        let onsets = every(pull.first_s, pull.every_s, samples as f64 / fs_hz);
        let stroke = Stroke {
            kind: pull.kind,
            at: pull.at,
            deflection_m: pull.deflection_m,
            ramp_s: pull.ramp_s,
        };
        stroke.add(rod, eye, &states[0], fs_hz, &onsets, &mut output);
    }
    if let Some(settings) = &settings.knocks {
        let mut generator = stream_of(seed, index, KNOCKS);
        let onsets = knocks(settings, samples as f64 / fs_hz, &mut generator);
        let stroke = Stroke {
            kind: PullKind::Blow,
            at: settings.at,
            deflection_m: settings.deflection_m,
            ramp_s: 0.0,
        };
        stroke.add(rod, eye, &states[0], fs_hz, &onsets, &mut output);
    }
    let mut generator = stream_of(seed, index, LINES);
    for line in &settings.interference {
        let phase: f64 = generator.random::<f64>() * 2.0 * PI;
        for (k, sample) in output.iter_mut().enumerate() {
            *sample += line.amplitude_m * libm::sin(2.0 * PI * line.frequency_hz * k as f64 * dt + phase);
        }
    }
    let own = match eye.number {
        0 => seed,
        number => random::seed(&[
            b"simulated further sensor",
            &seed.to_le_bytes(),
            &number.to_le_bytes(),
        ]),
    };
    let mut generator = stream_of(own, index, SENSOR);
    let mut noise = Noise::new(eye.sensor, fs_hz, &mut generator);
    for sample in &mut output {
        *sample = quantised(*sample + noise.next(&mut generator), eye.sensor.resolution_m);
    }
    Ok(output)
}

/// Times and sizes of equal pulls.
fn every(first_s: f64, every_s: f64, duration_s: f64) -> Vec<(f64, f64)> {
    let mut onsets = Vec::new();
    let mut release = first_s;
    while release < duration_s {
        onsets.push((release, 1.0));
        release += every_s;
    }
    onsets
}

/// The ambient response of one record.
struct Ambient<'a, 's> {
    rod: &'a Rod<'s>,
    eye: &'a Eye<'a>,
    nominal: &'a State,
    states: &'a [State],
    fs_hz: f64,
    /// Number of samples for which one state holds.
    block: usize,
    /// Amplitude of the load at each sample; `None`: one throughout.
    gusts: Option<Vec<f64>>,
}

impl Ambient<'_, '_> {
    fn amplitude(&self, sample: usize) -> f64 {
        self.gusts
            .as_ref()
            .and_then(|gusts| gusts.get(sample).copied())
            .unwrap_or(1.0)
    }

    /// Adds the modes of the rod, or of one whose frequencies differ by `detuning` and of which the sensor sees a `share`. The
    /// start is drawn as if the first sample's gust had lasted.
    fn add_modes(
        &self,
        detuning: f64,
        share: f64,
        streams: impl Fn(usize) -> ChaCha8Rng,
        output: &mut [f64],
    ) {
        let (settings, nominal) = (self.rod.settings, self.nominal);
        let dt = 1.0 / self.fs_hz;
        let factor = 1.0 + detuning;
        for (n, &zeta) in settings.damping.iter().enumerate() {
            let calibrated = Oscillator::new(factor * nominal.frequency_hz[n], zeta);
            let first = Oscillator::new(nominal.frequency_hz[0], settings.damping[0]);
            // A load that is white in time and space acts on mode n with intensity over modal mass.
            let intensity = first.intensity_for(settings.ambient_m) * nominal.shapes[0].mean_square()
                / nominal.shapes[n].mean_square();
            let mut generator = streams(n);
            let start = calibrated.sampled(intensity, dt).stationary(&mut generator);
            let mut state = (start.0 * self.amplitude(0), start.1 * self.amplitude(0));
            let mut time = 0;
            for (now, chunk) in self.states.iter().zip(output.chunks_mut(self.block)) {
                let visible = factor * now.frequency_hz[n] < 0.5 * self.fs_hz;
                let oscillator = Oscillator::new(factor * now.frequency_hz[n], zeta).sampled(intensity, dt);
                let seen = share * (self.eye.sees)(&now.shapes[n]);
                for sample in chunk {
                    if visible {
                        *sample += seen * state.0;
                    }
                    state = oscillator.driven(state, self.amplitude(time), &mut generator);
                    time += 1;
                }
            }
        }
    }

    /// Adds resonances that are no modes of the rod.
    fn add_resonances(&self, generator: &mut ChaCha8Rng, output: &mut [f64]) {
        for resonance in &self.rod.settings.resonances {
            let oscillator = Oscillator::new(resonance.frequency_hz, resonance.damping);
            let intensity = oscillator.intensity_for(resonance.ambient_m);
            let sampled = oscillator.sampled(intensity, 1.0 / self.fs_hz);
            let start = sampled.stationary(generator);
            let mut state = (start.0 * self.amplitude(0), start.1 * self.amplitude(0));
            for (time, sample) in output.iter_mut().enumerate() {
                *sample += state.0;
                state = sampled.driven(state, self.amplitude(time), generator);
            }
        }
    }
}

/// A pull or a blow at one place.
struct Stroke {
    kind: PullKind,
    at: f64,
    deflection_m: f64,
    ramp_s: f64,
}

impl Stroke {
    /// Adds this stroke at each onset, times its size.
    ///
    /// A point force F at x deflects mode n by q_n = F w_n(x) / (omega_n^2 M_n), a point impulse J starts it
    /// with q_n' = J w_n(x) / M_n, where M_n is the modal mass.
    fn add(
        &self,
        rod: &Rod<'_>,
        eye: &Eye<'_>,
        state: &State,
        fs_hz: f64,
        onsets: &[(f64, f64)],
        output: &mut [f64],
    ) {
        let settings = rod.settings;
        let modes: Vec<(Oscillator, f64, f64, f64)> = state
            .frequency_hz
            .iter()
            .zip(&state.shapes)
            .zip(&settings.damping)
            .filter(|((f, _), _)| **f < 0.5 * fs_hz)
            .map(|((f, shape), zeta)| {
                let omega = 2.0 * PI * f;
                let participation = shape.at(self.at) / shape.mean_square();
                (
                    Oscillator::new(*f, *zeta),
                    omega,
                    participation,
                    (eye.sees)(shape),
                )
            })
            .collect();
        let Some((_, first_omega, first_participation, _)) = modes.first() else {
            return;
        };
        let scale = match self.kind {
            PullKind::Release => {
                let flexibility: f64 = state
                    .shapes
                    .iter()
                    .zip(&modes)
                    .map(|(shape, (_, omega, participation, _))| {
                        participation * shape.at(self.at) / (omega * omega)
                    })
                    .sum();
                self.deflection_m / flexibility
            }
            PullKind::Blow => self.deflection_m * first_omega / first_participation,
        };
        for &(release, size) in onsets {
            for (oscillator, omega, participation, seen) in &modes {
                let load = size * scale * participation;
                let begin = match self.kind {
                    PullKind::Release => (load / (omega * omega), 0.0),
                    PullKind::Blow => (0.0, load),
                };
                for (k, sample) in output.iter_mut().enumerate() {
                    let since = k as f64 / fs_hz - release;
                    if since >= 0.0 {
                        *sample += seen * oscillator.free(begin, since).0;
                    } else if since > -self.ramp_s {
                        *sample += seen * begin.0 * (1.0 + since / self.ramp_s);
                    }
                }
            }
        }
    }
}
