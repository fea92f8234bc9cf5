//! Noise of a sensor: white noise, 1/f noise, a finite resolution.

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    #[test]
    fn pink_noise_has_its_variance_and_falls_as_one_over_f() {
        let sensor = Sensor {
            at: 0.5,
            noise_m: 0.0,
            pink_m: 3.0,
            resolution_m: 0.0,
        };
        let (fs, n, repeats) = (64.0, 4096, 150);
        let frequencies = [0.25, 1.0, 4.0];
        let mut density = [0.0; 3];
        let mut variance = 0.0;
        for repeat in 0..repeats {
            let mut generator = random::stream(2, repeat);
            let mut noise = Noise::new(&sensor, fs, &mut generator);
            let series: Vec<f64> = (0..n).map(|_| noise.next(&mut generator)).collect();
            let mean = series.iter().sum::<f64>() / n as f64;
            variance += series.iter().map(|x| x * x).sum::<f64>() / (n as f64 * repeats as f64);
            for (density, f) in density.iter_mut().zip(frequencies) {
                let (mut re, mut im) = (0.0, 0.0);
                for (k, x) in series.iter().enumerate() {
                    let phase = 2.0 * PI * f * k as f64 / fs;
                    let taper = 1.0 - (2.0 * PI * (k as f64 + 0.5) / n as f64).cos();
                    re += taper * (x - mean) * phase.cos();
                    im += taper * (x - mean) * phase.sin();
                }
                *density += re * re + im * im;
            }
        }
        // Slow parts hardly change within 64 s: 150 records hold few independent values of them, sd 7 %.
        assert!((variance / 9.0 - 1.0).abs() < 0.25, "{variance}");
        // Two octaves down the density rises fourfold, within the ripple and 8 % scatter of each mean.
        for pair in density.windows(2) {
            assert!((2.8..5.7).contains(&(pair[0] / pair[1])), "{density:?}");
        }
    }

    #[test]
    fn resolution_rounds_and_zero_does_not() {
        assert_eq!(quantised(1.26, 0.5), 1.5);
        assert_eq!(quantised(-1.2e-7, 1e-8), -12.0 * 1e-8);
        assert_eq!(quantised(1.26, 0.0), 1.26);
    }
}
