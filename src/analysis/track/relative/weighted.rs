//! Evenly spread shares to draw at, and moments and quantiles of weighted draws.

use super::shift::{LANES, Lanes};
use crate::numerics::simd::{Kernel, vectorised};

/// Number of draws of u per particle.
pub(super) const PER_PARTICLE: usize = 4;

/// Bins of a quantile.
const BINS: usize = 1024;

/// Weighted mean, standard deviation and effective number of draws.
pub(super) struct Moments {
    pub mean: f64,
    pub sd: f64,
    pub ess: f64,
}

impl Moments {
    pub fn of(weights: &[f64], values: &[f64]) -> Self {
        // Counted from the first value, so that nothing cancels.
        let from = values[0];
        let mut sums = [[0.0; LANES]; 4];
        vectorised(Powers {
            weights,
            values,
            from,
            sums: &mut sums,
        });
        let [sum, squares, first, second] = sums.map(|lanes| lanes.iter().sum::<f64>());
        let mean = first / sum;
        Self {
            mean: from + mean,
            sd: (second / sum - mean * mean).max(0.0).sqrt(),
            ess: sum * sum / squares,
        }
    }
}

/// Sums of the weights, their squares, and their products with the values and with the squares of these, lane by lane.
struct Powers<'a> {
    weights: &'a [f64],
    values: &'a [f64],
    from: f64,
    sums: &'a mut [Lanes; 4],
}

impl Kernel for Powers<'_> {
    #[inline(always)]
    fn run(self) {
        let mut sums = [[0.0; LANES]; 4];
        let (weights, values) = (self.weights.chunks_exact(LANES), self.values.chunks_exact(LANES));
        for (w, x) in weights.zip(values) {
            for l in 0..LANES {
                let off = x[l] - self.from;
                sums[0][l] += w[l];
                sums[1][l] += w[l] * w[l];
                sums[2][l] += w[l] * off;
                sums[3][l] += w[l] * off * off;
            }
        }
        *self.sums = sums;
    }
}

/// Quantiles of weighted values, to a thousandth of their range: the weight is summed in narrow bins and taken as even
/// within each.
pub(super) fn quantiles<const S: usize>(values: &[f64], weights: &[f64], shares: [f64; S]) -> [f64; S] {
    let (low, high) = values
        .iter()
        .zip(weights)
        .filter(|(_, weight)| **weight > 0.0)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (x, _)| {
            (low.min(*x), high.max(*x))
        });
    let step = (high - low) / BINS as f64;
    if step.is_nan() || step <= 0.0 {
        return [low; S];
    }
    let mut bins = [0.0; BINS];
    for (x, weight) in values.iter().zip(weights) {
        // Values outside have no weight; the cast saturates.
        bins[(((x - low) / step) as usize).min(BINS - 1)] += weight;
    }
    let sum: f64 = bins.iter().sum();
    shares.map(|share| {
        let mut below = 0.0;
        for (bin, weight) in bins.iter().enumerate() {
            if below + weight >= share * sum && *weight > 0.0 {
                return low + step * (bin as f64 + (share * sum - below) / weight);
            }
            below += weight;
        }
        high
    })
}

/// Shares from 0 to 1, [`PER_PARTICLE`] for each particle of `blocks`: one in each of as many equal strata,
/// at places that run evenly through it from particle to particle by the golden ratio.
pub(super) fn lattice(blocks: usize) -> Vec<Lanes> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let count = (blocks * LANES) as f64;
    let mut lattice = vec![[0.0; LANES]; blocks * PER_PARTICLE];
    for (block, rows) in lattice.chunks_exact_mut(PER_PARTICLE).enumerate() {
        for (j, row) in rows.iter_mut().enumerate() {
            for (l, share) in row.iter_mut().enumerate() {
                let particle = (block * LANES + l) as f64;
                // Strata of one particle are not to be in step with each other.
                let place = (GOLDEN * particle + 0.5 / count + j as f64 / PER_PARTICLE as f64).fract();
                *share = (j as f64 + place) / PER_PARTICLE as f64;
            }
        }
    }
    lattice
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lattice_spreads_evenly_over_all_and_within_each() {
        let lattice = lattice(64);
        let mut all: Vec<f64> = lattice.as_flattened().to_vec();
        all.sort_by(f64::total_cmp);
        let count = all.len() as f64;
        for (i, share) in all.iter().enumerate() {
            // The golden ratio leaves gaps of a few spacings.
            assert!((share - (i as f64 + 0.5) / count).abs() < 4.0 / count);
        }
        for block in lattice.chunks(PER_PARTICLE) {
            for l in 0..LANES {
                for (j, lanes) in block.iter().enumerate() {
                    assert_eq!((lanes[l] * PER_PARTICLE as f64) as usize, j);
                }
            }
        }
    }

    #[test]
    fn quantiles_of_weighted_values() {
        let values: Vec<f64> = (0..4000).map(|i| f64::from(i) / 4000.0).collect();
        let weights: Vec<f64> = values.clone();
        // Density 2 x: the quantile is the root of the share.
        for (share, quantile) in
            [0.025, 0.5, 0.975]
                .into_iter()
                .zip(quantiles(&values, &weights, [0.025, 0.5, 0.975]))
        {
            assert!((quantile - f64::sqrt(share)).abs() < 2e-3);
        }
        assert_eq!(quantiles(&[3.0; 8], &[1.0; 8], [0.5]), [3.0]);
    }
}
