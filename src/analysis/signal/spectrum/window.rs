//! Tapers and the straight line that is taken out before one is applied.

use super::Window;
use std::f64::consts::TAU;

impl Window {
    /// The `n` weights, periodic (sample `n` would equal sample 0), as for spectral estimation.
    pub fn weights(self, n: usize) -> Vec<f64> {
        let cosines: &[f64] = match self {
            Self::Rectangular => &[1.0],
            Self::Hann => &[0.5, -0.5],
            Self::Hamming => &[0.54, -0.46],
            Self::Blackman => &[0.42, -0.5, 0.08],
        };
        (0..n)
            .map(|i| {
                let turn = TAU * i as f64 / n as f64;
                (0..)
                    .zip(cosines)
                    .map(|(m, a)| a * (f64::from(m) * turn).cos())
                    .sum()
            })
            .collect()
    }
}

/// The least-squares straight line through evenly spaced samples: value at the middle and slope per
/// sample.
///
/// Sums run in four lanes of fixed order, so that the result is the same on every machine.
pub fn line(samples: &[f64]) -> (f64, f64) {
    let n = samples.len() as f64;
    if samples.len() < 2 {
        return (samples.first().copied().unwrap_or(0.0), 0.0);
    }
    let middle = 0.5 * (n - 1.0);
    let (mut sum, mut moment) = ([0.0; 4], [0.0; 4]);
    let mut position = [-middle, 1.0 - middle, 2.0 - middle, 3.0 - middle];
    let blocks = samples.chunks_exact(4);
    for (&x, t) in blocks.remainder().iter().rev().zip(0..) {
        sum[0] += x;
        moment[0] += (middle - f64::from(t)) * x;
    }
    for block in blocks {
        for lane in 0..4 {
            sum[lane] += block[lane];
            moment[lane] += position[lane] * block[lane];
            position[lane] += 4.0;
        }
    }
    let total = (sum[0] + sum[1]) + (sum[2] + sum[3]);
    let moment = (moment[0] + moment[1]) + (moment[2] + moment[3]);
    (total / n, moment / (n * (n * n - 1.0) / 12.0))
}

/// Subtracts the least-squares straight line and multiplies by the weights: `out = (x - line) w`.
pub fn detrend_and_taper(samples: &[f64], weights: &[f64], out: &mut [f64]) {
    let (mean, slope) = line(samples);
    let middle = 0.5 * (samples.len() as f64 - 1.0);
    for (i, ((out, x), w)) in out.iter_mut().zip(samples).zip(weights).enumerate() {
        *out = (x - (mean + slope * (i as f64 - middle))) * w;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_straight_line_is_found_exactly() {
        for n in [2usize, 3, 4, 5, 11, 64, 101] {
            let samples: Vec<f64> = (0..n).map(|i| 3.0 - 0.25 * i as f64).collect();
            let (mean, slope) = line(&samples);
            assert!((mean - (3.0 - 0.125 * (n as f64 - 1.0))).abs() < 1e-12, "n = {n}");
            assert!((slope + 0.25).abs() < 1e-13, "n = {n}: {slope}");
        }
    }

    #[test]
    fn windows_are_periodic() {
        for window in [
            Window::Hann,
            Window::Hamming,
            Window::Blackman,
            Window::Rectangular,
        ] {
            let w = window.weights(64);
            for i in 1..64 {
                assert!((w[i] - w[64 - i]).abs() < 1e-15);
            }
            assert!((w[32] - 1.0).abs() < 1e-15);
        }
    }
}
