//! Records of a few modes by exact discrete-time simulation, sharing nothing with the fitted model.
//!
//! Each mode is the state (displacement, velocity) of an oscillator under continuous white force,
//! advanced from sample to sample by its exact transition matrix and its exact noise covariance
//! `Q = P - F P F'` (P the stationary covariance).

#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test file uses its part; helpers of tests are tests"
)]

pub mod scene;

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{PI, TAU};
use tirante::analysis::numerics::random;
use tirante::analysis::signal::record::{Excitation, Record, RodId, Timestamp};

#[derive(Debug, Clone, Copy)]
pub struct SimulatedMode {
    pub frequency_hz: f64,
    pub damping: f64,
    /// Standard deviation of the ambient response.
    pub ambient: f64,
    /// Deflection at release; velocity zero.
    pub pull: f64,
}

pub fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

impl SimulatedMode {
    pub fn add(&self, rng: &mut impl Rng, fs: f64, samples: &mut [f64]) {
        self.add_driven(rng, fs, None, samples);
    }

    /// Adds the response to a force whose level moves: `force` multiplies it sample by sample.
    pub fn add_driven(&self, rng: &mut impl Rng, fs: f64, force: Option<&[f64]>, samples: &mut [f64]) {
        let w = TAU * self.frequency_hz;
        let z = self.damping;
        let wd = w * (1.0 - z * z).sqrt();
        let dt = 1.0 / fs;
        let (s, c) = (wd * dt).sin_cos();
        let e = (-z * w * dt).exp();
        let k = z * w / wd;
        let f = [
            [e * (c + k * s), e * s / wd],
            [-e * s * w * w / wd, e * (c - k * s)],
        ];
        let p = [
            self.ambient * self.ambient,
            (self.ambient * w) * (self.ambient * w),
        ];
        let q00 = p[0] - (f[0][0] * f[0][0] * p[0] + f[0][1] * f[0][1] * p[1]);
        let q01 = -(f[0][0] * f[1][0] * p[0] + f[0][1] * f[1][1] * p[1]);
        let q11 = p[1] - (f[1][0] * f[1][0] * p[0] + f[1][1] * f[1][1] * p[1]);
        let l00 = q00.max(0.0).sqrt();
        let l10 = if l00 > 0.0 { q01 / l00 } else { 0.0 };
        let l11 = (q11 - l10 * l10).max(0.0).sqrt();
        let mut x = self.pull + self.ambient * normal(rng);
        let mut v = self.ambient * w * normal(rng);
        for (i, sample) in samples.iter_mut().enumerate() {
            *sample += x;
            let level = force.map_or(1.0, |force| force[i]);
            let (a, b) = (level * normal(rng), level * normal(rng));
            (x, v) = (
                f[0][0] * x + f[0][1] * v + l00 * a,
                f[1][0] * x + f[1][1] * v + l10 * a + l11 * b,
            );
        }
    }
}

/// The ambient standard deviation whose spectral peak is `ratio_db` above white noise of standard
/// deviation `noise`: one-sided peak sigma^2 / (pi zeta f), noise 2 noise^2 / fs.
pub fn ambient_sd(frequency_hz: f64, damping: f64, ratio_db: f64, noise: f64, fs: f64) -> f64 {
    (10f64.powf(ratio_db / 10.0) * 2.0 * noise * noise / fs * PI * damping * frequency_hz).sqrt()
}

pub fn record(fs: f64, samples: Vec<f64>, excitation: Excitation) -> Record {
    Record {
        rod: RodId("simulated".into()),
        start: Timestamp::from_nanos(0),
        fs_hz: fs,
        samples,
        temperature_c: None,
        readings: Vec::new(),
        excitation: Some(excitation),
        clock_sd: 0.0,
        flags: Vec::new(),
    }
}

pub fn simulate(
    seed: u64,
    fs: f64,
    seconds: f64,
    modes: &[SimulatedMode],
    noise: f64,
    excitation: Excitation,
) -> Record {
    let mut rng = random::stream(seed, 0);
    let mut samples: Vec<f64> = (0..(seconds * fs) as usize)
        .map(|_| noise * normal(&mut rng))
        .collect();
    for mode in modes {
        mode.add(&mut rng, fs, &mut samples);
    }
    record(fs, samples, excitation)
}
