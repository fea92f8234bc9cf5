//! Natural frequencies of the dimensionless rod with their derivatives: one Newton step where the last
//! answer is near.
//!
//! The equation is that of [`crate::rod::beam::exact`]; its supports are given by fixities `y = k / (k + EI/l)`
//! (0 hinged, 1 clamped). Good to 1e-7, which is far below what labels need.

use std::f64::consts::PI;
use std::ops::{Add, Mul, Sub};

/// Inputs of the derivatives: wavenumber, tension, left and right fixity.
const INPUTS: usize = 4;
/// Value of `q` beyond which the two ends do not interact: exp(-q) is 1e-7.
const FAR: f64 = 16.0;
/// Newton step below which the remaining error, its square, is negligible.
const CONVERGED: f64 = 1e-4;

/// A number with its derivatives along the inputs.
#[derive(Clone, Copy)]
struct Dual {
    value: f64,
    slope: [f64; INPUTS],
}

impl Dual {
    fn input(value: f64, which: usize) -> Self {
        let mut slope = [0.0; INPUTS];
        slope[which] = 1.0;
        Self { value, slope }
    }

    /// Applies a function given by its value and derivative here.
    #[inline]
    fn map(self, value: f64, derivative: f64) -> Self {
        Self {
            value,
            slope: self.slope.map(|slope| slope * derivative),
        }
    }

    #[inline]
    fn plus(self, constant: f64) -> Self {
        Self {
            value: self.value + constant,
            ..self
        }
    }

    #[inline]
    fn times(self, factor: f64) -> Self {
        self.map(self.value * factor, factor)
    }

    #[inline]
    fn recip(self) -> Self {
        let value = 1.0 / self.value;
        self.map(value, -value * value)
    }

    #[inline]
    fn sqrt(self) -> Self {
        let value = self.value.sqrt();
        self.map(value, 0.5 / value)
    }
}

impl Add for Dual {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            slope: std::array::from_fn(|i| self.slope[i] + other.slope[i]),
        }
    }
}

impl Sub for Dual {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        self + other.times(-1.0)
    }
}

impl Mul for Dual {
    type Output = Self;

    #[inline]
    #[expect(clippy::suspicious_arithmetic_impl, reason = "the product rule adds")]
    fn mul(self, other: Self) -> Self {
        Self {
            value: self.value * other.value,
            slope: std::array::from_fn(|i| self.slope[i] * other.value + self.value * other.slope[i]),
        }
    }
}

/// One natural frequency of the dimensionless rod.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frequency {
    /// Wavenumber less order times pi: first guess of the next solution.
    pub(super) phase: f64,
    /// Natural logarithm of `phi sqrt(phi^2 + t)`.
    pub(super) log: f64,
    /// Its derivatives along tension `t`, left and right fixity.
    pub(super) slope: [f64; 3],
}

/// Mode `order` under tension `t = N l^2 / EI` between two fixities; `guess` is an earlier
/// [`Frequency::phase`] of a similar rod, if there is one.
pub(super) fn frequency(order: usize, t: f64, fixities: [f64; 2], guess: Option<f64>) -> Frequency {
    let base = order as f64 * PI;
    let (mut low, mut high) = (0.0, PI);
    let mut phase = guess.unwrap_or_else(|| end_phases(order, base, t, fixities).value);
    phase = phase.clamp(low, high);
    let mut right = end_phases(order, base + phase, t, fixities);
    // Each step that is not Newton's halves the bracket: 60 steps exhaust double precision.
    for _ in 0..60 {
        let excess = phase - right.value;
        if excess > 0.0 {
            high = phase;
        } else {
            low = phase;
        }
        let newton = phase - excess / (1.0 - right.slope[0]);
        let inside = newton >= low && newton <= high;
        let next = if inside { newton } else { 0.5 * (low + high) };
        let step = (next - phase).abs();
        phase = next;
        if step <= CONVERGED {
            break;
        }
        right = end_phases(order, base + phase, t, fixities);
    }
    let phi = base + phase;
    let square = phi * phi + t;
    let by_phi = 1.0 / phi + phi / square;
    let implicit = by_phi / (1.0 - right.slope[0]);
    Frequency {
        phase,
        log: libm::log(phi) + 0.5 * libm::log(square),
        slope: [
            implicit * right.slope[1] + 0.5 / square,
            implicit * right.slope[2],
            implicit * right.slope[3],
        ],
    }
}

/// Phase that both ends add to `order` times pi, at the wavenumber `phi`.
fn end_phases(order: usize, phi: f64, t: f64, fixities: [f64; 2]) -> Dual {
    let phi = Dual::input(phi, 0);
    let t = Dual::input(t, 1);
    let clamp = [Dual::input(fixities[0], 2), Dual::input(fixities[1], 3)];
    let hinge = clamp.map(|clamp| clamp.times(-1.0).plus(1.0));
    let q = (phi * phi + t).sqrt();
    let r = phi * q.recip();
    let e = (r * r).plus(1.0);
    if q.value > FAR {
        let [left, right] = std::array::from_fn(|end| {
            let tangent = r * clamp[end] * (e * q * hinge[end] + clamp[end]).recip();
            tangent.map(
                libm::atan(tangent.value),
                1.0 / (1.0 + tangent.value * tangent.value),
            )
        });
        return left + right;
    }
    let decay = libm::exp(-q.value);
    let inverse = 1.0 / (1.0 - decay * decay);
    let (coth, csch) = ((1.0 + decay * decay) * inverse, 2.0 * decay * inverse);
    let (coth, csch) = (q.map(coth, -csch * csch), q.map(csch, -coth * csch));
    let hinged = hinge[0] * hinge[1] * q * q;
    let mixed = (hinge[0] * clamp[1] + hinge[1] * clamp[0]) * q;
    let clamped = clamp[0] * clamp[1];
    let inverse_q = q.recip();
    let a = e * e * hinged + e * coth * mixed + t * inverse_q * inverse_q * clamped;
    let b = e * r * mixed + (r * coth * clamped).times(2.0);
    let square = a * a + b * b;
    let angle = Dual {
        value: libm::atan2(b.value, a.value),
        slope: std::array::from_fn(|i| (a.value * b.slope[i] - b.value * a.slope[i]) / square.value),
    };
    let ratio = (r * csch * clamped).times(2.0) * square.sqrt().recip();
    let tilt = ratio.map(
        libm::asin(ratio.value.min(1.0)),
        1.0 / (1.0 - ratio.value * ratio.value).max(1e-12).sqrt(),
    );
    if order.is_multiple_of(2) {
        angle - tilt
    } else {
        angle + tilt
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::forward::MAX_ORDERS;
    use crate::rod::beam::{Beam, exact};
    use proptest::prelude::*;

    /// Frequencies in units of sqrt(EI / m) / (2 pi l^2).
    fn solve(t: f64, fixities: [f64; 2]) -> [f64; MAX_ORDERS] {
        let beam = Beam {
            length_m: 1.0,
            flexural_rigidity_n_m2: 1.0,
            mass_per_length_kg_m: 1.0 / (4.0 * PI * PI),
            axial_force_n: t,
            end_stiffness_n_m: fixities.map(|y| y / (1.0 - y)),
        };
        let mut out = [0.0; MAX_ORDERS];
        exact::frequencies(&beam, &mut out).unwrap();
        out
    }

    proptest! {
        #![proptest_config(crate::rod::beam::seeded(400))]

        #[test]
        fn twelve_orders_and_their_slopes_are_the_exact_ones(
            log_t in -1.5f64..6.0, left in 0.0f64..0.999, right in 0.0f64..0.999, off in -0.05f64..0.05,
        ) {
            let t = 10f64.powf(log_t);
            let exact = solve(t, [left, right]);
            for (i, &truth) in exact.iter().enumerate() {
                let cold = frequency(i + 1, t, [left, right], None);
                let warm = frequency(i + 1, t, [left, right], Some(cold.phase + off));
                // The square of a Newton step of 1e-4 times a curvature of order one, and exp(-16).
                prop_assert!((cold.log - truth.ln()).abs() < 3e-7, "{} {}", cold.log, truth.ln());
                prop_assert!((warm.log - truth.ln()).abs() < 3e-7);
                let h = 1e-4;
                let moved = |dt: f64, dl: f64, dr: f64| {
                    let at = |sign: f64| {
                        let ends = [left * (1.0 - dl * sign * h), right * (1.0 - dr * sign * h)];
                        solve(t * (1.0 + dt * sign * h), ends)[i].ln()
                    };
                    (at(1.0) - at(-1.0)) / (2.0 * h)
                };
                let slopes = [t * cold.slope[0], -left * cold.slope[1], -right * cold.slope[2]];
                for (slope, difference) in
                    slopes.into_iter().zip([moved(1.0, 0.0, 0.0), moved(0.0, 1.0, 0.0), moved(0.0, 0.0, 1.0)])
                {
                    // The slopes are those one Newton step (up to 1e-4) before the solution.
                    prop_assert!((slope - difference).abs() < 1e-4 * (1.0 + difference.abs()), "{slope} {difference}");
                }
            }
        }
    }
}
