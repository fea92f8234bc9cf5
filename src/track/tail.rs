//! Tail probabilities in logarithms: the normal's, its inverse, and Student's t as a normal deviate.
//!
//! Everything goes through `libm`, so that the bits do not depend on the platform.

use std::f64::consts::{LN_2, PI, SQRT_2};

/// Beyond this deviate erfc leaves the normal range of numbers, and the asymptotic series is exact.
const FAR: f64 = 25.0;

/// ln P(Z > z) for a standard normal Z.
pub fn ln_upper(z: f64) -> f64 {
    if z < -1.0 {
        // Close to one: the other tail tells the difference.
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

/// z with ln P(Z > z) = `ln_p`, for `ln_p` <= 0; the deviate is bounded by -38 below.
pub fn upper_deviate(ln_p: f64) -> f64 {
    if ln_p > -LN_2 {
        // P > 1/2: mirror.
        return -upper_deviate(libm::log(-libm::expm1(ln_p)).max(-720.0));
    }
    // Newton on ln P, which is concave: from the right bound it converges from one side.
    let mut z = (-2.0 * (ln_p + LN_2)).max(0.0).sqrt();
    for _ in 0..60 {
        let ln_tail = ln_upper(z);
        // -d ln P/dz: the hazard.
        let hazard = libm::exp(-0.5 * z * z - 0.5 * libm::log(2.0 * PI) - ln_tail);
        let step = (ln_tail - ln_p) / hazard;
        z += step;
        if step.abs() <= 1e-14 * z.abs().max(1.0) {
            break;
        }
    }
    z
}

/// The standard normal deviate z with P(Z > z) = P(T > t), T Student's with `nu` degrees of freedom.
///
/// From twelve degrees on Hill's expansion (Communications of the ACM 13, 1970, algorithm 395); below, the tail itself.
pub fn student_deviate(t: f64, nu: f64) -> f64 {
    if t == 0.0 {
        return 0.0;
    }
    let size = t.abs().min(1e100);
    let z = if nu < 12.0 {
        upper_deviate(ln_student_upper(size, nu))
    } else {
        let a = nu - 0.5;
        let b = 48.0 * a * a;
        let y = a * libm::log1p(size * (size / nu));
        let inner = (((-0.4 * y - 3.3) * y - 24.0) * y - 85.5) / (0.8 * y * y + 100.0 + b);
        ((inner + y + 3.0) / b + 1.0) * y.sqrt()
    };
    z.copysign(t)
}

/// ln P(T > t) for t >= 0, through the continued fraction of the incomplete beta function (Numerical Recipes 6.4).
pub fn ln_student_upper(t: f64, nu: f64) -> f64 {
    let (a, b) = (0.5 * nu, 0.5);
    // x = nu / (nu + t^2) and its logarithm, without cancellation at either end.
    let ratio = t * (t / nu);
    let ln_x = -libm::log1p(ratio);
    let (x, rest) = (
        1.0 / (1.0 + ratio),
        if ratio.is_finite() {
            ratio / (1.0 + ratio)
        } else {
            1.0
        },
    );
    let ln_rest = if ratio < 1e300 {
        libm::log(ratio) + ln_x
    } else {
        0.0
    };
    let ln_front = libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b) + a * ln_x + b * ln_rest;
    if t == 0.0 {
        return -LN_2;
    }
    if x < (a + 1.0) / (a + b + 2.0) {
        ln_front + libm::log(continued(a, b, x) / a) - LN_2
    } else {
        libm::log(0.5 * (1.0 - libm::exp(ln_front) * continued(b, a, rest) / b))
    }
}

/// The continued fraction of I_x(a, b) by Lentz's method.
fn continued(a: f64, b: f64, x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let bounded = |value: f64| if value.abs() < TINY { TINY } else { value };
    let (mut c, mut d) = (1.0, 1.0 / bounded(1.0 - (a + b) * x / (a + 1.0)));
    let mut product = d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        d = 1.0 / bounded(1.0 + even * d);
        c = bounded(1.0 + even / c);
        product *= d * c;
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        d = 1.0 / bounded(1.0 + odd * d);
        c = bounded(1.0 + odd / c);
        product *= d * c;
        if (d * c - 1.0).abs() < 1e-15 {
            break;
        }
    }
    product
}

/// The deviate r with Phi(r) = sum w_i Phi(z_i), weights summing to one: a mixture's distribution function as a
/// standard normal deviate, right in either tail.
pub fn mixture_deviate(parts: &[(f64, f64)]) -> f64 {
    let centre: f64 = parts.iter().map(|(weight, z)| weight * z).sum();
    let sign = if centre < 0.0 { -1.0 } else { 1.0 };
    let tail = |z: f64| {
        let z = sign * z;
        if z < FAR {
            0.5 * libm::erfc(z / SQRT_2)
        } else {
            0.0
        }
    };
    let plain: f64 = parts.iter().map(|&(weight, z)| weight * tail(z)).sum();
    if plain > 1e-100 {
        return sign * upper_deviate(libm::log(plain).min(0.0));
    }
    let logs = || {
        parts
            .iter()
            .filter(|part| part.0 > 0.0)
            .map(|&(weight, z)| libm::log(weight) + ln_upper(sign * z))
    };
    let highest = logs().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = logs().map(|ln| libm::exp(ln - highest)).sum();
    sign * upper_deviate((highest + libm::log(sum)).min(0.0))
}
