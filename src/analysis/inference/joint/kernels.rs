//! Densities of many t kernels at one place, several kernels at once.

use crate::numerics::simd::{Kernel, vectorised};
use nalgebra::{DMatrix, DVector};

/// Number of kernels side by side.
const LANES: usize = 8;

/// Kernels of one number of degrees of freedom, laid out in blocks of [`LANES`]: centres, lower triangles of the inverse roots row by
/// row, and 1 / det(root).
pub(super) struct Kernels {
    blocks: Vec<[f64; LANES]>,
    count: usize,
    dimensions: usize,
    freedom: usize,
}

/// Numbers of one kernel: centre, triangle and scale.
fn numbers(dimensions: usize) -> usize {
    dimensions + dimensions * (dimensions + 1) / 2 + 1
}

impl Kernels {
    /// Lays out kernels, each the centre, the inverse of the root of its covariance, and 1 / det(root). The sum of `freedom` and the
    /// number of dimensions is even.
    pub(super) fn new<'a>(
        kernels: impl ExactSizeIterator<Item = (&'a DVector<f64>, &'a DMatrix<f64>, f64)>,
        dimensions: usize,
        freedom: usize,
    ) -> Self {
        let count = kernels.len();
        let stride = numbers(dimensions);
        let mut blocks = vec![[0.0; LANES]; count.div_ceil(LANES) * stride];
        for (at, (centre, inverse, density)) in kernels.enumerate() {
            let triangle =
                (0..dimensions).flat_map(|row| (0..=row).map(move |column| inverse[(row, column)]));
            let values = centre.iter().copied().chain(triangle).chain([density]);
            for (slot, value) in blocks[at / LANES * stride..].iter_mut().zip(values) {
                slot[at % LANES] = value;
            }
        }
        Self {
            blocks,
            count,
            dimensions,
            freedom,
        }
    }

    /// Sum of the kernels' densities at a place, each (1 + square / freedom)^(-(freedom + d) / 2) / det(root).
    pub(super) fn density(&self, place: &[f64]) -> f64 {
        let mut densities = vec![0.0; self.count];
        vectorised(Each {
            kernels: self,
            place,
            away: &mut vec![[0.0; LANES]; self.dimensions],
            densities: &mut densities,
        });
        densities.iter().sum()
    }
}

/// Density of each kernel at a place.
struct Each<'a> {
    kernels: &'a Kernels,
    place: &'a [f64],
    /// Differences from the centres of a block.
    away: &'a mut [[f64; LANES]],
    densities: &'a mut [f64],
}

impl Kernel for Each<'_> {
    #[inline(always)]
    fn run(self) {
        let Kernels {
            blocks,
            dimensions,
            freedom,
            ..
        } = self.kernels;
        for (block, densities) in blocks
            .chunks_exact(numbers(*dimensions))
            .zip(self.densities.chunks_mut(LANES))
        {
            let (centres, mut rows) = block.split_at(*dimensions);
            for ((away, centre), z) in self.away.iter_mut().zip(centres).zip(self.place) {
                for lane in 0..LANES {
                    away[lane] = z - centre[lane];
                }
            }
            let mut squares = [0.0; LANES];
            for row in 1..=*dimensions {
                let (own, next) = rows.split_at(row);
                rows = next;
                let mut sums = [0.0; LANES];
                for (own, away) in own.iter().zip(&*self.away) {
                    for lane in 0..LANES {
                        sums[lane] += own[lane] * away[lane];
                    }
                }
                for lane in 0..LANES {
                    squares[lane] += sums[lane] * sums[lane];
                }
            }
            let mut factors = [0.0; LANES];
            for lane in 0..LANES {
                factors[lane] = 1.0 + squares[lane] / *freedom as f64;
            }
            let mut powers = [1.0; LANES];
            let mut exponent = (freedom + dimensions) / 2;
            // By squaring, as `powi` does it.
            while exponent > 0 {
                for lane in 0..LANES {
                    if exponent % 2 == 1 {
                        powers[lane] *= factors[lane];
                    }
                    factors[lane] *= factors[lane];
                }
                exponent /= 2;
            }
            for ((density, scale), power) in densities.iter_mut().zip(rows[0]).zip(powers) {
                *density = scale * (1.0 / power);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::numerics::simd::widths;
    use rand::RngExt;

    /// Against the formula written out with matrices; 1e-12 is some thousand roundings of numbers of order one.
    #[test]
    fn densities_are_those_of_the_formula_at_any_width() {
        for (dimensions, freedom, count) in [(1, 5, 1), (2, 6, 8), (7, 5, 21)] {
            let mut generator = random::stream(9, dimensions as u64);
            let mut number = || generator.random::<f64>();
            let kernels: Vec<(DVector<f64>, DMatrix<f64>, f64)> = (0..count)
                .map(|_| {
                    let root = DMatrix::from_fn(dimensions, dimensions, |i, j| match i >= j {
                        true => number() + 0.5,
                        false => 0.0,
                    });
                    let inverse = root.clone().try_inverse().unwrap();
                    (
                        DVector::from_fn(dimensions, |_, _| number()),
                        inverse,
                        1.0 / root.determinant(),
                    )
                })
                .collect();
            let laid = Kernels::new(kernels.iter().map(|(c, i, d)| (c, i, *d)), dimensions, freedom);
            let place = DVector::from_fn(dimensions, |_, _| number());
            let expected: Vec<f64> = kernels
                .iter()
                .map(|(centre, inverse, density)| {
                    let square = (inverse * (&place - centre)).norm_squared();
                    let power = (freedom + dimensions) as f64 / 2.0;
                    density * (1.0 + square / freedom as f64).powf(-power)
                })
                .collect();
            for width in 0..widths::<Each<'_>>().len() {
                let (mut away, mut densities) = (vec![[0.0; LANES]; dimensions], vec![0.0; count]);
                widths()[width](Each {
                    kernels: &laid,
                    place: place.as_slice(),
                    away: &mut away,
                    densities: &mut densities,
                });
                for (density, expected) in densities.iter().zip(&expected) {
                    assert!(
                        (density / expected - 1.0).abs() < 1e-12,
                        "{density} for {expected}"
                    );
                }
            }
            let sum: f64 = expected.iter().sum();
            assert!((laid.density(place.as_slice()) / sum - 1.0).abs() < 1e-12);
        }
    }
}
