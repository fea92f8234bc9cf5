//! e^x and ln(1 + x) of many numbers at once, to two units in the last place.
//!
//! ```text
//! e^x = 2^k e^r,    k = round(x / ln 2),    |r| <= ln(2) / 2,    e^r by its Taylor series to r^13
//! ln(2^k m) = k ln 2 + 2 artanh s,    s = (m - 1) / (m + 1),    2/3 <= m < 4/3,    artanh by its Taylor series to s^21
//! ```

use super::simd::{Kernel, vectorised};
use std::f64::consts::LOG2_E;

/// Range of arguments; below it the result is zero, above it infinite.
const LEAST: f64 = -708.0;
const MOST: f64 = 709.0;
/// 1.5 * 2^52: in a sum with it a number is rounded to an integer, which the lowest bits hold.
const ROUNDING: f64 = 6_755_399_441_055_744.0;
/// ln 2 in two parts; products of the first with integers of eleven bits are exact.
const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
/// 1 / n! from n = 13 down to 0.
const SERIES: [f64; 14] = [
    1.0 / 6_227_020_800.0,
    1.0 / 479_001_600.0,
    1.0 / 39_916_800.0,
    1.0 / 3_628_800.0,
    1.0 / 362_880.0,
    1.0 / 40_320.0,
    1.0 / 5040.0,
    1.0 / 720.0,
    1.0 / 120.0,
    1.0 / 24.0,
    1.0 / 6.0,
    0.5,
    1.0,
    1.0,
];

/// Puts e^x in the place of each x.
pub fn exp_each(values: &mut [f64]) {
    vectorised(Each(values));
}

struct Each<'a>(&'a mut [f64]);

impl Kernel for Each<'_> {
    #[inline(always)]
    fn run(self) {
        for value in self.0 {
            *value = exp(*value);
        }
    }
}

/// e^x, for loops that run as a [`Kernel`].
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    let rounded = x * LOG2_E + ROUNDING;
    let k = rounded - ROUNDING;
    let r = (x - k * LN_2[0]) - k * LN_2[1];
    let of_r = SERIES.iter().fold(0.0, |sum, term| sum * r + term);
    let power_of_two = f64::from_bits(rounded.to_bits().wrapping_add(1023) << 52);
    if x < LEAST {
        0.0
    } else if x > MOST {
        f64::INFINITY
    } else {
        of_r * power_of_two
    }
}

/// 2^52: in a sum with it the lowest bits of a number are an integer below 2^52.
const INTEGERS: f64 = 4_503_599_627_370_496.0;
/// Bits of 2/3: from there to the next power of two times 2/3 numbers share an exponent.
const TWO_THIRDS_BITS: u64 = 0x3fe5_5555_5555_5555;
/// Exponent bits of a number, less those of 2/3.
const EXPONENT: u64 = 0xfff0_0000_0000_0000;
/// 1 / (2 n + 1) from n = 10 down to 1.
const ARTANH: [f64; 10] = [
    1.0 / 21.0,
    1.0 / 19.0,
    1.0 / 17.0,
    1.0 / 15.0,
    1.0 / 13.0,
    1.0 / 11.0,
    1.0 / 9.0,
    1.0 / 7.0,
    1.0 / 5.0,
    1.0 / 3.0,
];

/// ln(1 + x) of x >= 0, for loops that run as a [`Kernel`].
#[inline(always)]
pub fn ln_1p(x: f64) -> f64 {
    let sum = 1.0 + x;
    let lost = (x - (sum - 1.0)) / sum;
    let above = sum.to_bits().wrapping_sub(TWO_THIRDS_BITS);
    let k = f64::from_bits((above >> 52) | INTEGERS.to_bits()) - INTEGERS;
    let m = f64::from_bits(sum.to_bits().wrapping_sub(above & EXPONENT));
    let s = (m - 1.0) / (m + 1.0);
    let square = s * s;
    let series = ARTANH.iter().fold(0.0, |sum, term| (sum + term) * square);
    let of_m = 2.0 * s + 2.0 * s * series;
    if sum < f64::INFINITY {
        k * LN_2[0] + (of_m + (k * LN_2[1] + lost))
    } else {
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::super::simd::widths;
    use super::*;

    /// Against the scalar function of the library, which is right to one unit in the last place.
    #[test]
    fn powers_of_e_are_right_to_two_units_in_the_last_place() {
        let steps = (-70_800..=70_900).map(|step| 0.01 * f64::from(step) + 1e-3 * f64::from(step % 7));
        let x: Vec<f64> = steps.filter(|x| (LEAST..=MOST).contains(x)).collect();
        let mut found = x.clone();
        exp_each(&mut found);
        for (x, found) in x.iter().zip(&found) {
            let off = (found / libm::exp(*x) - 1.0).abs();
            // One more unit for the library's.
            assert!(off <= 3.0 * f64::EPSILON, "{x}: {off:e}");
        }
        let mut ends = [0.0, f64::NEG_INFINITY, -709.0, 710.0, f64::INFINITY];
        exp_each(&mut ends);
        assert_eq!(ends, [1.0, 0.0, 0.0, f64::INFINITY, f64::INFINITY]);
        let mut none = [f64::NAN];
        exp_each(&mut none);
        assert!(none[0].is_nan());
    }

    /// Against the scalar function of the library, which is right to one unit in the last place.
    #[test]
    fn logarithms_are_right_to_two_units_in_the_last_place() {
        let powers = (0..40_000).map(|step| libm::exp2(0.05 * f64::from(step) - 1000.0));
        for x in powers.chain((0..10_000).map(|step| 1e-3 * f64::from(step))) {
            let (found, expected) = (ln_1p(x), libm::log1p(x));
            // One more unit for the library's.
            assert!(
                (found - expected).abs() <= 3.0 * f64::EPSILON * expected,
                "{x:e}: {found} {expected}"
            );
        }
        assert_eq!((ln_1p(0.0), ln_1p(f64::INFINITY)), (0.0, f64::INFINITY));
        assert!(ln_1p(f64::NAN).is_nan());
    }

    #[test]
    fn every_width_gives_the_same_bits() {
        let x: Vec<f64> = (0..1001).map(|step| 0.37 * f64::from(step) - 180.0).collect();
        let bits_of = |width: usize| {
            let mut values = x.clone();
            widths()[width](Each(&mut values));
            values.iter().map(|value| value.to_bits()).collect::<Vec<_>>()
        };
        let found: Vec<_> = (0..widths::<Each<'_>>().len()).map(bits_of).collect();
        assert!(found.iter().all(|bits| *bits == found[0]));
    }
}
