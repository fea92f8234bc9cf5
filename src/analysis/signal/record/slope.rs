//! The smoothed slope of samples and its mean square, which a slow pull hardly moves and a release does.

use std::ops::Range;

/// The smoothed slope of some samples.
#[derive(Debug, Clone)]
pub struct Slope {
    values: Vec<f64>,
    /// Running sum of the squares, one entry more than values.
    energy: Vec<f64>,
}

impl Slope {
    /// Slope at each sample: mean of the next `half` samples less the mean of the last `half`; zero at
    /// the ends.
    pub fn of(samples: &[f64], half: usize) -> Self {
        let mean = samples.iter().sum::<f64>() / samples.len().max(1) as f64;
        let mut sums = Vec::with_capacity(samples.len() + 1);
        let mut sum = 0.0;
        sums.push(sum);
        for x in samples {
            sum += x - mean;
            sums.push(sum);
        }
        let mut values = vec![0.0; samples.len()];
        for i in half..samples.len().saturating_sub(half) {
            values[i] = (sums[i + half] - 2.0 * sums[i] + sums[i - half]) / half as f64;
        }
        let mut energy = Vec::with_capacity(samples.len() + 1);
        let mut sum = 0.0;
        energy.push(0.0);
        for v in &values {
            sum += v * v;
            energy.push(sum);
        }
        Self { values, energy }
    }

    /// The slope at each sample.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Mean square over a range of samples, end excluded.
    pub fn mean_square(&self, from: usize, to: usize) -> f64 {
        (self.energy[to] - self.energy[from]) / (to - from) as f64
    }

    /// Mean square that rounding gives a signal at rest.
    pub fn floor(&self) -> f64 {
        1e-12 * self.energy[self.values.len()] / self.values.len().max(1) as f64
    }

    /// Largest magnitude in a window.
    pub fn peak(&self, window: Range<usize>) -> f64 {
        self.values[window]
            .iter()
            .fold(0.0f64, |peak, v| peak.max(v.abs()))
    }

    /// First sample of a window at which the magnitude exceeds `threshold`.
    pub fn first_above(&self, mut window: Range<usize>, threshold: f64) -> Option<usize> {
        window.find(|&i| self.values[i].abs() > threshold)
    }
}
