//! Evaluating a chaos expansion for a block of points: lanes are points, sums are nested.
//!
//! The variables are split into two groups. Sorted by importance, the inner group's basis functions that go
//! with one outer function are always the first few, so that
//!
//! ```text
//! f(x, y) = sum_a A_a(x) ( sum_{b < run_a} c_ab B_b(y) )
//! ```
//!
//! needs one multiplication and one addition per coefficient and point. Every point is computed by the same
//! operations in the same order whatever its lane and whatever the processor (no fused multiply-add), so
//! results are the same to the bit alone, in a block, and on any machine.

use serde::{Deserialize, Serialize};

/// Points evaluated together.
pub const LANES: usize = 16;

/// One output's coefficients, by outer function.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Expansion {
    /// Per outer function, the number of inner functions that go with it.
    runs: Vec<usize>,
    /// The coefficients, run after run.
    coefficients: Vec<f64>,
}

impl Expansion {
    /// From one row of coefficients per outer function.
    pub fn new<'a>(rows: impl IntoIterator<Item = &'a [f64]>) -> Self {
        let mut expansion = Self::default();
        for row in rows {
            expansion.runs.push(row.len());
            expansion.coefficients.extend_from_slice(row);
        }
        expansion
    }

    /// Number of coefficients.
    pub fn terms(&self) -> usize {
        self.coefficients.len()
    }

    /// Largest number of inner functions that go with one outer function.
    pub fn longest_run(&self) -> usize {
        self.runs.iter().copied().max().unwrap_or(0)
    }

    /// The coefficients with their outer and inner functions.
    pub fn iter(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        let places = self.runs.iter().enumerate();
        places
            .flat_map(|(outer, &run)| (0..run).map(move |inner| (outer, inner)))
            .zip(&self.coefficients)
            .map(|((outer, inner), &c)| (outer, inner, c))
    }

    /// True if the expansion fits these numbers of outer and inner functions, every coefficient finite.
    pub fn fits(&self, outer: usize, inner: usize) -> bool {
        self.runs.len() == outer
            && self.runs.iter().all(|&run| run <= inner)
            && self.runs.iter().sum::<usize>() == self.coefficients.len()
            && self.coefficients.iter().all(|c| c.is_finite())
    }

    /// The expansion at `L` points, from the values of the outer and the inner functions there.
    #[inline(always)]
    pub fn evaluate<const L: usize>(&self, outer: &[[f64; L]], inner: &[[f64; L]]) -> [f64; L] {
        let mut sum = [0.0; L];
        let mut rest = self.coefficients.as_slice();
        for (a, &run) in outer.iter().zip(&self.runs) {
            let (row, next) = rest.split_at(run);
            rest = next;
            let mut part = [0.0; L];
            for (c, b) in row.iter().zip(inner) {
                for l in 0..L {
                    part[l] += c * b[l];
                }
            }
            for l in 0..L {
                sum[l] += a[l] * part[l];
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::simd::{Kernel, vectorised};

    #[test]
    fn nested_sums_are_the_plain_sum_and_lanes_do_not_matter() {
        let rows = [vec![1.5, -2.0, 0.25], vec![], vec![3.0]];
        let expansion = Expansion::new(rows.iter().map(Vec::as_slice));
        assert!(expansion.fits(3, 3) && !expansion.fits(3, 2) && expansion.terms() == 4);
        let point = |l: usize| ([1.0, 0.3 + l as f64, -0.7], [1.0, 0.1 * l as f64, 2.0]);
        let mut outer = [[0.0; LANES]; 3];
        let mut inner = [[0.0; LANES]; 3];
        for l in 0..LANES {
            let (a, b) = point(l);
            for i in 0..3 {
                (outer[i][l], inner[i][l]) = (a[i], b[i]);
            }
        }
        struct Evaluate<'a>(&'a Expansion, [&'a [[f64; LANES]]; 2], &'a mut [f64; LANES]);
        impl Kernel for Evaluate<'_> {
            #[inline(always)]
            fn run(self) {
                *self.2 = self.0.evaluate(self.1[0], self.1[1]);
            }
        }
        let mut block = [0.0; LANES];
        vectorised(Evaluate(&expansion, [&outer, &inner], &mut block));
        for (l, value) in block.into_iter().enumerate() {
            let (a, b) = point(l);
            let alone = expansion.evaluate(&a.map(|x| [x]), &b.map(|x| [x]))[0];
            assert_eq!(value.to_bits(), alone.to_bits());
            let plain = a[0] * (1.5 * b[0] - 2.0 * b[1] + 0.25 * b[2]) + a[2] * 3.0 * b[0];
            assert!((value - plain).abs() < 1e-14);
        }
    }
}
