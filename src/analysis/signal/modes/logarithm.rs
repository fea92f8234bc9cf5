//! The natural logarithm without a branch, so that a compiler can vectorise it.

use std::f64::consts::{LN_2, SQRT_2};

/// ln x of a positive, normal, finite `x`, to 3e-16 of the larger of 1 and the result; the result
/// for anything else is meaningless.
///
/// `x = 2^k m` with `m` from sqrt(1/2) to sqrt(2), and `ln m = 2 artanh s`, `s = (m - 1) / (m + 1)`,
/// by its series: `s^2 < 0.0295`, so that the first term left out, `2 s^23 / 23`, is below 3e-19.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    const ROOT: u64 = (SQRT_2 / 2.0).to_bits();
    const ONE: u64 = 1.0f64.to_bits();
    /// 2^52: a double whose low bits count units.
    const UNITS: u64 = 0x4330_0000_0000_0000;
    const BIAS: f64 = 4_503_599_627_370_496.0 + 1023.0;
    let shifted = x.to_bits().wrapping_add(ONE - ROOT);
    let k = f64::from_bits((shifted >> 52) | UNITS) - BIAS;
    let m = f64::from_bits((shifted & 0x000f_ffff_ffff_ffff).wrapping_add(ROOT));
    let s = (m - 1.0) / (m + 1.0);
    let t = s * s;
    let mut series = 1.0 / 21.0;
    series = series * t + 1.0 / 19.0;
    series = series * t + 1.0 / 17.0;
    series = series * t + 1.0 / 15.0;
    series = series * t + 1.0 / 13.0;
    series = series * t + 1.0 / 11.0;
    series = series * t + 1.0 / 9.0;
    series = series * t + 1.0 / 7.0;
    series = series * t + 1.0 / 5.0;
    series = series * t + 1.0 / 3.0;
    k * LN_2 + 2.0 * (s + s * (t * series))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_logarithm() {
        for i in -3000..3000 {
            let x = (0.1 * f64::from(i)).exp() * (1.0 + 1e-3 * f64::from(i % 7));
            let right = x.ln();
            // A rounding of the largest term and a few of the series.
            assert!((ln(x) - right).abs() <= 4e-16 * right.abs().max(1.0), "{x}");
        }
        assert_eq!(ln(1.0), 0.0);
    }
}
