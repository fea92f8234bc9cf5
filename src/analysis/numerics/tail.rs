//! The normal's tail probability in logarithms.
//!
//! Everything goes through `libm`, so that the bits do not depend on the platform.

use std::f64::consts::{PI, SQRT_2};

/// Beyond this deviate erfc leaves the normal range of numbers, and the asymptotic series is exact.
const FAR: f64 = 25.0;

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
