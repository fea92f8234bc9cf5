//! What a sensor adds by itself: white noise, 1/f noise, a finite resolution.

use super::oscillator::normal;
use super::settings::Sensor;
use rand::Rng;
use std::f64::consts::PI;

/// Lowest corner of the 1/f noise \[Hz\].
const LOWEST_HZ: f64 = 1e-3;

/// The noise of one sensor, sample by sample.
///
/// The 1/f part is a sum of Ornstein-Uhlenbeck processes of equal variance whose corner frequencies lie
/// a factor of four apart from half the sample rate down to 1 mHz; between those the sum's density falls
/// as 1/f within a decibel or two.
#[derive(Debug, Clone)]
pub struct Noise {
    white: f64,
    pink: Vec<(f64, f64, f64)>,
}

impl Noise {
    /// The noise of `sensor` sampled at `fs_hz`, from a stationary start.
    pub fn new<R: Rng>(sensor: &Sensor, fs_hz: f64, generator: &mut R) -> Self {
        let mut pink = Vec::new();
        if sensor.pink_m > 0.0 {
            let mut corner = 0.5 * fs_hz;
            while corner >= LOWEST_HZ {
                pink.push(corner);
                corner *= 0.25;
            }
        }
        let sd = sensor.pink_m / (pink.len().max(1) as f64).sqrt();
        let pink = pink
            .into_iter()
            .map(|corner| {
                let memory = libm::exp(-2.0 * PI * corner / fs_hz);
                (
                    memory,
                    sd * (1.0 - memory * memory).sqrt(),
                    sd * normal(generator),
                )
            })
            .collect();
        Self {
            white: sensor.noise_m,
            pink,
        }
    }

    /// The next sample \[m\].
    pub fn next<R: Rng>(&mut self, generator: &mut R) -> f64 {
        let mut sum = if self.white > 0.0 {
            self.white * normal(generator)
        } else {
            0.0
        };
        for (memory, innovation, value) in &mut self.pink {
            *value = *memory * *value + *innovation * normal(generator);
            sum += *value;
        }
        sum
    }
}

/// `value` rounded to whole steps of `resolution`; unchanged if that is 0.
pub fn quantised(value: f64, resolution: f64) -> f64 {
    if resolution > 0.0 {
        (value / resolution).round() * resolution
    } else {
        value
    }
}
