//! Tails and quantiles of the normal and of chi-square.
//!
//! Everything goes through `libm`, so that the bits do not depend on the platform.

use std::f64::consts::{FRAC_1_SQRT_2, PI, SQRT_2};

/// Beyond this deviate erfc leaves the normal range of numbers, and the asymptotic series is exact.
const FAR: f64 = 25.0;

/// Most steps to a normal quantile.
const NEWTON: usize = 60;

/// ln P(Z > z) for a standard normal Z.
pub fn ln_upper(z: f64) -> f64 {
    if z < -1.0 {
        // Close to one: the other tail is more exact.
        return libm::log1p(-0.5 * libm::erfc(-z / SQRT_2));
    }
    if z < FAR {
        return libm::log(0.5 * libm::erfc(z / SQRT_2));
    }
    // Mills' ratio, Abramowitz and Stegun 26.2.12; the first left-out term is below 1e-9 at 25.
    let w = 1.0 / (z * z);
    let series = 1.0 - w * (1.0 - 3.0 * w * (1.0 - 5.0 * w * (1.0 - 7.0 * w)));
    -0.5 * z * z - libm::log(z) - 0.5 * libm::log(2.0 * PI) + libm::log(series)
}

/// The standard normal's quantile, by Newton's method on `erfc`; shares closer to 0 or 1 than 1e-5 count as that.
pub fn normal_quantile(share: f64) -> f64 {
    let tail = share.min(1.0 - share).max(1e-5);
    // The tail is convex and falls: steps from the left of the root never pass it.
    let mut x: f64 = 0.0;
    for _ in 0..NEWTON {
        let excess = 0.5 * libm::erfc(x * FRAC_1_SQRT_2) - tail;
        let density = libm::exp(-0.5 * x * x) / (2.0 * PI).sqrt();
        let step = excess / density;
        x += step;
        if step.abs() < 1e-12 {
            break;
        }
    }
    if share < 0.5 { -x } else { x }
}

/// P(chi-square > q) for up to four degrees of freedom in closed form; one without any.
pub fn chi_square_tail(q: f64, freedom: usize) -> f64 {
    let half = 0.5 * q;
    match freedom {
        0 => 1.0,
        1 => libm::erfc(half.sqrt()),
        2 => libm::exp(-half),
        3 => libm::erfc(half.sqrt()) + 2.0 * (half / PI).sqrt() * libm::exp(-half),
        _ => libm::exp(-half) * (1.0 + half),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

    /// z and ln P(Z > z).
    const NORMAL: [(f64, f64); 11] = [
        (-9.0, -1.1285884059538406e-19),
        (-3.0, -0.0013508099647481938),
        (-0.5, -0.368_946_415_288_656_4),
        (0.0, -std::f64::consts::LN_2),
        (0.5, -1.1759117615936186),
        (3.0, -6.607_726_221_510_35),
        (8.0, -35.01343715991455),
        (24.9, -314.14041276161316),
        (25.1, -319.148_387_405_888_6),
        (40.0, -804.608_442_013_753_8),
        (1000.0, -500007.82669481218),
    ];

    #[test]
    fn tails_to_the_printed_digits() {
        for (z, ln_p) in NORMAL {
            // Relative to the tail itself, or to its complement where the tail is nearly one: rounding of erfc.
            let error = (ln_upper(z) - ln_p).abs() / ln_p.abs();
            assert!(error < 1e-13, "{z}: {error}");
        }
    }

    #[test]
    fn normal_quantiles_and_chi_square_tails_are_the_published_ones() {
        assert!((normal_quantile(0.975) - 1.959_963_984_540_054).abs() < 1e-12);
        assert!((normal_quantile(0.1) + 1.281_551_565_544_600_4).abs() < 1e-12);
        assert_eq!(normal_quantile(0.0), normal_quantile(1e-6));
        for step in 1..100 {
            let share = f64::from(step) / 100.0;
            assert!((Normal::standard().cdf(normal_quantile(share)) - share).abs() < 1e-9);
        }
        for freedom in 1..=4 {
            let reference = ChiSquared::new(freedom as f64).unwrap();
            for q in [0.0, 0.1, 1.0, 5.0, 13.8, 30.0] {
                assert!(
                    (chi_square_tail(q, freedom) - reference.sf(q)).abs() < 1e-10,
                    "{freedom} {q}"
                );
            }
        }
        // Far out, where a difference from one would be zero: exp(-500).
        assert!((chi_square_tail(1000.0, 2) / (-500f64).exp() - 1.0).abs() < 1e-9);
    }
}
