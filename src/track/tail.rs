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

#[cfg(test)]
mod tests {
    use super::*;

    /// nu, t, ln P(T > t) and the normal deviate of the same tail, with fifty digits (mpmath 1.3).
    const STUDENT: [(f64, f64, f64, f64); 30] = [
        (0.5, 0.2, -0.80497214074985007, 0.13299066327620435),
        (0.5, 1.5, -1.3706143561492325, 0.66210834095830326),
        (0.5, 4.0, -1.8350216793144204, 0.99606187390089175),
        (0.5, 9.0, -2.2367820041619681, 1.2437182456465677),
        (0.5, 40.0, -2.9817327268074684, 1.638057018842072),
        (3.0, 0.2, -0.85065477105837279, 0.18367256937484396),
        (3.0, 1.5, -2.1602878227377666, 1.198856200308185),
        (3.0, 4.0, -4.2683959945974456, 2.1971679169946122),
        (3.0, 9.0, -6.5376368483569492, 2.9785865672970626),
        (3.0, 40.0, -10.971162936870326, 4.1423222491479674),
        (12.0, 0.2, -0.86176723256353797, 0.19571935560852567),
        (12.0, 1.5, -2.5291250084713423, 1.4068984492070553),
        (12.0, 4.0, -7.0346253394007268, 3.127717158071914),
        (12.0, 9.0, -14.40963614491983, 4.8721165255188013),
        (12.0, 40.0, -31.580946013536055, 7.5659220485306844),
        (30.5, 0.2, -0.86416312676574976, 0.1983028349415978),
        (30.5, 1.5, -2.6318131703721615, 1.4614361712179354),
        (30.5, 4.0, -8.5860625430488551, 3.5582179438489696),
        (30.5, 9.0, -22.256040890451512, 6.2420505927008904),
        (30.5, 40.0, -63.305599828555449, 10.953070164581531),
        (400.0, 0.2, -0.86561874488835642, 0.19987004362139241),
        (400.0, 1.5, -2.7000577980247711, 1.4969615734792263),
        (400.0, 4.0, -10.185046109904724, 3.9583773530941244),
        (400.0, 9.0, -39.917061315181489, 8.5831440591791819),
        (400.0, 40.0, -325.691927449596, 25.358955339509893),
        (7300.0, 0.2, -0.86573290232374801, 0.19999287684295487),
        (7300.0, 1.5, -2.7056207958737661, 1.4998330733943966),
        (7300.0, 4.0, -10.350275022109362, 3.997673933455368),
        (7300.0, 9.0, -43.399619497908435, 8.9748761047884813),
        (7300.0, 40.0, -727.85517695638432, 38.034117966288232),
    ];
    /// z and ln P(Z > z).
    const NORMAL: [(f64, f64); 11] = [
        (-9.0, -1.1285884059538406e-19),
        (-3.0, -0.0013508099647481938),
        (-0.5, -0.36894641528865639),
        (0.0, -std::f64::consts::LN_2),
        (0.5, -1.1759117615936186),
        (3.0, -6.6077262215103495),
        (8.0, -35.01343715991455),
        (24.9, -314.14041276161316),
        (25.1, -319.14838740588863),
        (40.0, -804.60844201375379),
        (1000.0, -500007.82669481218),
    ];

    #[test]
    fn normal_tails_and_back() {
        for (z, ln_p) in NORMAL {
            let found = ln_upper(z);
            assert!((found - ln_p).abs() <= 1e-12 * ln_p.abs(), "{z}: {found} {ln_p}");
            // Below -6 the upper tail is one to the last bits of ln P but for its own size, which is exact here.
            let back = upper_deviate(ln_p);
            assert!((back - z).abs() <= 1e-10 * z.abs().max(1.0), "{z}: {back}");
        }
        assert!(upper_deviate(0.0) < -37.0);
    }

    #[test]
    fn student_tails_to_fifty_digits() {
        for (nu, t, ln_p, z) in STUDENT {
            // lgamma of nu / 2 = 3650 has an absolute error near 1e-11.
            let found = ln_student_upper(t, nu);
            assert!(
                (found - ln_p).abs() <= 1e-10 * ln_p.abs().max(1.0),
                "{nu} {t}: {found} {ln_p}"
            );
            // Hill's expansion at twelve degrees: 2e-6 for deviates up to 5.5, 3e-4 at 7.6; far less from thirty on.
            let tolerance = if z.abs() < 5.5 { 2e-6 } else { 3e-4 };
            for sign in [1.0, -1.0] {
                let found = student_deviate(sign * t, nu);
                assert!((found - sign * z).abs() <= tolerance, "{nu} {t}: {found} {z}");
            }
        }
        assert_eq!(student_deviate(0.0, 3.0), 0.0);
        assert!(student_deviate(f64::MAX, 0.5).is_finite() && student_deviate(f64::MAX, 5000.0).is_finite());
    }

    #[test]
    fn mixtures_in_the_middle_and_far_out() {
        for z in [-300.0, -40.0, -8.0, -2.0, 0.0, 1e-9, 0.5, 3.0, 8.0, 30.0, 200.0] {
            let found = mixture_deviate(&[(0.25, z), (0.75, z)]);
            assert!((found - z).abs() <= 1e-9 * f64::max(1.0, z.abs()), "{z}: {found}");
        }
        // Far out the broader part alone counts, with its weight: P = 1e-3 Q(6).
        let found = mixture_deviate(&[(0.999, 30.0), (0.001, 6.0)]);
        let expected = upper_deviate(libm::log(0.001) + ln_upper(6.0));
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        // Through the middle it is the plain sum.
        let plain: f64 = 0.4 * 0.5 * libm::erfc(0.3 / SQRT_2) + 0.6 * 0.5 * libm::erfc(-1.1 / SQRT_2);
        let found = mixture_deviate(&[(0.4, 0.3), (0.6, -1.1)]);
        assert!((0.5 * libm::erfc(found / SQRT_2) - plain).abs() < 1e-14);
    }
}
