//! Posterior densities on a common grid, and the Kullback-Leibler divergence between two of them.

use crate::rod::prior::Prior;

/// Points of a grid.
pub const POINTS: usize = 512;
/// Span of a grid in prior standard deviations on either side of the prior mean.
const SPAN_SD: f64 = 4.0;
/// Least density, as a share of the uniform's, so that a divergence stays finite.
const FLOOR: f64 = 1e-9;

/// An even grid over the prior of one quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// First point, SI.
    pub low: f64,
    /// Distance between points, SI.
    pub step: f64,
}

impl Grid {
    /// Grid over a prior.
    pub fn of(prior: &Prior) -> Self {
        let (mean, sd) = prior.mean_and_sd();
        if let Prior::LogUniform { low, high } = *prior {
            let step = (high - low) / (POINTS - 1) as f64;
            return Self { low, step };
        }
        let low = (mean - SPAN_SD * sd).max(0.0);
        Self {
            low,
            step: (mean + SPAN_SD * sd - low) / (POINTS - 1) as f64,
        }
    }

    /// Point number `i`, SI.
    pub fn at(&self, i: usize) -> f64 {
        self.low + i as f64 * self.step
    }

    /// The density of a prior, of integral one over the grid.
    pub fn prior(&self, prior: &Prior) -> Vec<f64> {
        self.normalised((0..POINTS).map(|i| libm::exp(prior.log_density(self.at(i)))))
    }

    /// The density behind a sample, of integral one over the grid: a Gaussian kernel of Silverman's width
    /// 0.9 sd n^(-1/5), n the effective sample size `worth`, on linearly binned values.
    pub fn density(&self, values: &[f64], worth: f64) -> Vec<f64> {
        let count = values.len() as f64;
        let mut mass = vec![0.0; POINTS];
        for value in values {
            let place = (value - self.low) / self.step;
            if place >= 0.0 && place < (POINTS - 1) as f64 {
                let (i, share) = (place as usize, place.fract());
                mass[i] += 1.0 - share;
                mass[i + 1] += share;
            }
        }
        let mean = values.iter().sum::<f64>() / count;
        let square: f64 = values.iter().map(|x| (x - mean) * (x - mean)).sum();
        let width = 0.9 * (square / (count - 1.0)).sqrt() * libm::pow(worth.max(2.0), -0.2);
        let width = (width / self.step).max(0.5);
        let reach = (5.0 * width).ceil() as usize;
        let kernel: Vec<f64> = (0..=reach)
            .map(|j| libm::exp(-0.5 * (j as f64 / width).powi(2)))
            .collect();
        self.normalised((0..POINTS).map(|i| {
            let window = i.saturating_sub(reach)..=(i + reach).min(POINTS - 1);
            window.map(|j| mass[j] * kernel[i.abs_diff(j)]).sum()
        }))
    }

    fn normalised(&self, values: impl Iterator<Item = f64>) -> Vec<f64> {
        let values: Vec<f64> = values.map(|v| if v.is_finite() { v } else { 0.0 }).collect();
        let integral = values.iter().sum::<f64>() * self.step;
        values.iter().map(|v| v / integral).collect()
    }

    /// Kullback-Leibler divergence of `p` from `q`, integral of p ln(p / q).
    pub fn divergence(&self, p: &[f64], q: &[f64]) -> f64 {
        let floor = FLOOR / (self.step * POINTS as f64);
        let term = |(&p, &q): (&f64, &f64)| {
            let (p, q) = (p.max(floor), q.max(floor));
            p * libm::log(p / q)
        };
        p.iter().zip(q).map(term).sum::<f64>() * self.step
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, Normal};

    #[test]
    fn the_divergence_of_normals_is_the_closed_form() {
        let prior = |mean, sd| Prior::TruncatedNormal { mean, sd };
        let grid = Grid::of(&prior(100.0, 10.0));
        let p = grid.prior(&prior(98.0, 5.0));
        let q = grid.prior(&prior(102.0, 7.0));
        let wanted = (7.0f64 / 5.0).ln() + (25.0 + 16.0) / (2.0 * 49.0) - 0.5;
        assert!((grid.divergence(&p, &q) - wanted).abs() < 1e-4);
        assert!(grid.divergence(&p, &p).abs() < 1e-12);
        let normal = Normal::new(98.0, 5.0).unwrap();
        let mut generator = random::stream(4, 0);
        let values: Vec<f64> = (0..50_000).map(|_| normal.sample(&mut generator)).collect();
        let found = grid.density(&values, 50_000.0);
        assert!((found.iter().sum::<f64>() * grid.step - 1.0).abs() < 1e-12);
        assert!(grid.divergence(&found, &p) < 3e-3);
        // Apart altogether: large, not infinite.
        let far = grid.divergence(&grid.density(&[70.0; 9], 9.0), &grid.density(&[130.0; 9], 9.0));
        assert!(far > 10.0 && far.is_finite());
    }
}
