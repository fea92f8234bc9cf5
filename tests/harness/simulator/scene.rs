//! Records as real sensors make them: gusts, knocks, pulls, tones, neighbours, each beside ambient response.
//!
//! Exact from sample to sample like the stationary response; what begins between two samples (a knock, a
//! release) is advanced to the next one by the closed form of a free decay.

use super::{SimulatedMode, normal, record};
use rand::{Rng, RngExt};
use std::f64::consts::TAU;
use tirante::analysis::numerics::random;
use tirante::analysis::signal::record::Record;

/// A pull and release, or a blow.
#[derive(Debug, Clone, Copy)]
pub struct Pull {
    /// Time \[s\].
    pub at_s: f64,
    /// Amplitude over each mode's ambient standard deviation.
    pub ratio: f64,
    /// Duration of the slow pull before \[s\]; 0 for a blow.
    pub ramp_s: f64,
}

/// A machine's hum.
#[derive(Debug, Clone, Copy)]
pub struct Hum {
    pub frequency_hz: f64,
    pub amplitude: f64,
    /// Standard deviation of the logarithm of its amplitude, over 5 s.
    pub breathing: f64,
}

#[derive(Debug, Clone, Default)]
pub struct Scene {
    pub fs_hz: f64,
    pub seconds: f64,
    /// `ambient` is each mode's level; `pull` is not used.
    pub modes: Vec<SimulatedMode>,
    pub noise: f64,
    /// Standard deviation of the logarithm of the force, and its correlation time \[s\].
    pub gust: Option<(f64, f64)>,
    /// Knocks: interval \[s\], and size as a multiple of each mode's ambient standard deviation.
    pub knocks: Option<(f64, f64)>,
    pub pulls: Vec<Pull>,
    pub hums: Vec<Hum>,
    /// Step of the sensor; 0 for none.
    pub step: f64,
}

/// A stationary Gaussian process of unit variance with an exponential correlation.
fn wander(rng: &mut impl Rng, count: usize, dt: f64, correlation_s: f64) -> Vec<f64> {
    let keep = (-dt / correlation_s).exp();
    let new = (1.0 - keep * keep).sqrt();
    let mut x = normal(rng);
    (0..count)
        .map(|_| {
            let now = x;
            x = keep * x + new * normal(rng);
            now
        })
        .collect()
}

/// Displacement and velocity of a free decay `t` after `(x, v)`.
fn decay(mode: &SimulatedMode, (x, v): (f64, f64), t: f64) -> f64 {
    let w = TAU * mode.frequency_hz;
    let wd = w * (1.0 - mode.damping * mode.damping).sqrt();
    let (s, c) = (wd * t).sin_cos();
    (-mode.damping * w * t).exp() * (x * c + (v + mode.damping * w * x) / wd * s)
}

impl Scene {
    pub fn record(&self, seed: u64) -> Record {
        let mut rng = random::stream(seed, 0);
        let count = (self.seconds * self.fs_hz) as usize;
        let dt = 1.0 / self.fs_hz;
        let mut samples: Vec<f64> = (0..count).map(|_| self.noise * normal(&mut rng)).collect();
        let force: Option<Vec<f64>> = self.gust.map(|(sd, time_s)| {
            let level = wander(&mut rng, count, dt, time_s);
            level.iter().map(|g| (sd * g - sd * sd).exp()).collect()
        });
        // (time, amplitude over ambient, displacement rather than velocity)
        let mut events: Vec<(f64, f64, bool)> = Vec::new();
        if let Some((every_s, ratio)) = self.knocks {
            let mut t = every_s * rng.random::<f64>();
            while t < self.seconds {
                events.push((t, ratio * (0.5 + rng.random::<f64>()), false));
                t += every_s;
            }
        }
        events.extend(
            self.pulls
                .iter()
                .map(|pull| (pull.at_s, pull.ratio, pull.ramp_s > 0.0)),
        );
        for mode in &self.modes {
            mode.add_driven(&mut rng, self.fs_hz, force.as_deref(), &mut samples);
            for &(at_s, ratio, displaced) in &events {
                let amplitude = ratio * mode.ambient;
                let state = match displaced {
                    true => (amplitude, 0.0),
                    false => (0.0, amplitude * TAU * mode.frequency_hz),
                };
                let first = (at_s * self.fs_hz).ceil() as usize;
                for (i, sample) in samples.iter_mut().enumerate().skip(first) {
                    *sample += decay(mode, state, i as f64 * dt - at_s);
                }
            }
            for pull in &self.pulls {
                let begins = pull.at_s - pull.ramp_s;
                for (i, sample) in samples.iter_mut().enumerate() {
                    let t = i as f64 * dt;
                    if t >= begins && t < pull.at_s {
                        *sample += pull.ratio * mode.ambient * (t - begins) / pull.ramp_s;
                    }
                }
            }
        }
        for hum in &self.hums {
            let phase = TAU * rng.random::<f64>();
            let level = wander(&mut rng, count, dt, 5.0);
            for (i, (sample, g)) in samples.iter_mut().zip(level).enumerate() {
                let turn = TAU * hum.frequency_hz * i as f64 * dt + phase;
                *sample += hum.amplitude * (hum.breathing * g).exp() * turn.sin();
            }
        }
        if self.step > 0.0 {
            for sample in &mut samples {
                *sample = (*sample / self.step).round() * self.step;
            }
        }
        let mut record = record(
            self.fs_hz,
            samples,
            tirante::analysis::signal::record::Excitation::Ambient,
        );
        record.excitation = None;
        record
    }
}
