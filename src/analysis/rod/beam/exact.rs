//! Exact natural frequencies: roots of the characteristic equation of a tensioned beam on rotational springs.
//!
//! The beam equation `EI w'''' - N w'' - m omega^2 w = 0` (paper, section 4.3) has, with `x` in units
//! of the length, solutions `sin(phi x)`, `cos(phi x)`, `exp(-q x)` and `exp(-q (1 - x))`, where
//!
//! ```text
//! q^2 = phi^2 + t,   t = N l^2 / EI,   omega = phi q / l^2 sqrt(EI / m).
//! ```
//!
//! Exponentials that decay from each end keep every digit at any tension, where cosh and sinh lose
//! all of them beyond q of about 35. The supports `EI w'' = +-k w'` turn into
//!
//! ```text
//! A sin(phi) - B cos(phi) + C = 0,   A, B > 0,  B > C,
//! A = (1+r^2)^2 h_l h_r + (1+r^2) coth(q) (h_l c_r + h_r c_l) + (1-r^2) c_l c_r
//! B = (1+r^2) r (h_l c_r + h_r c_l) + 2 r coth(q) c_l c_r
//! C = 2 r c_l c_r / sinh(q),            r = phi / q,
//! ```
//!
//! where each support enters as the ratio `h : c` of `q EI / l` to `k` (a hinge is `1 : 0`, a clamp `0 : 1`).
//! Mode n has `n pi <= phi <= (n+1) pi`, that is, it lies between the hinged frequencies n and n+1,
//! and solves `phi = n pi + atan2(B, A) - (-1)^n asin(C / hypot(A, B))`, whose right-hand side varies
//! slowly: Newton's method needs three or four steps, and the bracket makes a miss or a swap impossible.

use super::OutsideRange;
use super::forward::{ForwardModel, MAX_MODES};
use super::{Beam, Parameterisation};
use std::f64::consts::PI;

/// The first `out.len()` natural frequencies \[Hz\] of `beam`, to about 1e-14 relative.
///
/// Any tension from zero, any end stiffness from zero to infinity.
pub fn frequencies(beam: &Beam, out: &mut [f64]) -> Result<(), OutsideRange> {
    let (tension, supports) = dimensionless(beam)?;
    let unit = unit_hz(beam);
    let mut phase = None;
    for (i, frequency) in out.iter_mut().enumerate() {
        let phi = wavenumber_from(i + 1, tension, &supports, phase);
        phase = Some(phi - (i + 1) as f64 * PI);
        *frequency = unit * phi * (phi * phi + tension).sqrt();
    }
    Ok(())
}

/// The slopes `d ln f_n / d ln N` of the first `out.len()` natural frequencies, by implicit
/// differentiation of the characteristic equation; 0 without tension, 1/2 for a string.
pub fn log_slopes(beam: &Beam, out: &mut [f64]) -> Result<(), OutsideRange> {
    let (t, supports) = dimensionless(beam)?;
    for (i, slope) in out.iter_mut().enumerate() {
        let phi = wavenumber_from(i + 1, t, &supports, None);
        let (_, by_phi) = phase(i + 1, phi, t, &supports, Direction::WAVENUMBER);
        let (_, by_t) = phase(i + 1, phi, t, &supports, Direction::TENSION);
        let phi_t = by_t / (1.0 - by_phi);
        *slope = t * (phi_t / phi + (phi * phi_t + 0.5) / (phi * phi + t));
    }
    Ok(())
}

/// Mode `order`'s wavenumber `phi` (in units of 1/l) for the dimensionless tension
/// `t = N l^2 / EI = 1 / lambda^2` and two supports.
pub fn wavenumber(order: usize, tension: f64, supports: &[Support; 2]) -> f64 {
    wavenumber_from(order, tension, supports, None)
}

/// The same, sooner where it is close to `near`.
pub fn wavenumber_near(order: usize, tension: f64, supports: &[Support; 2], near: f64) -> f64 {
    wavenumber_from(order, tension, supports, Some(near - order as f64 * PI))
}

/// A support as the ratio of the beam's bending stiffness EI / l to its rotational stiffness k.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Support {
    pub(super) hinge: f64,
    pub(super) clamp: f64,
}

impl Support {
    /// From the stiffness k and the bending stiffness EI / l, both \[N m / rad\].
    pub fn from_stiffness(k: f64, bending: f64) -> Self {
        if k <= bending {
            Self {
                hinge: 1.0,
                clamp: k / bending,
            }
        } else {
            Self {
                hinge: bending / k,
                clamp: 1.0,
            }
        }
    }

    /// From the fixity `s = k / (k + sqrt(EI N))` and `lambda = sqrt(EI / (N l^2))`.
    pub fn from_fixity(s: f64, lambda: f64) -> Self {
        Self {
            hinge: (1.0 - s) * lambda,
            clamp: s,
        }
    }
}

/// `t`, the supports, and a check that the beam is one.
pub(super) fn dimensionless(beam: &Beam) -> Result<(f64, [Support; 2]), OutsideRange> {
    beam.check("exact model")?;
    let bending = beam.flexural_rigidity_n_m2 / beam.length_m;
    let tension = beam.axial_force_n * beam.length_m / bending;
    Ok((
        tension,
        beam.end_stiffness_n_m
            .map(|k| Support::from_stiffness(k, bending)),
    ))
}

/// `sqrt(EI / m) / (2 pi l^2)` \[Hz\].
pub(super) fn unit_hz(beam: &Beam) -> f64 {
    (beam.flexural_rigidity_n_m2 / beam.mass_per_length_kg_m).sqrt()
        / (2.0 * PI * beam.length_m * beam.length_m)
}

/// Newton's method inside the bracket `0 <= phi - n pi <= pi`; `guess` is a first `phi - n pi`.
fn wavenumber_from(order: usize, t: f64, supports: &[Support; 2], guess: Option<f64>) -> f64 {
    let base = order as f64 * PI;
    let (mut low, mut high) = (0.0, PI);
    let mut delta = match guess {
        Some(guess) => guess.clamp(low, high),
        None => phase(order, base, t, supports, Direction::WAVENUMBER)
            .0
            .clamp(low, high),
    };
    // Each step that is not Newton's halves the bracket: 60 steps exhaust double precision.
    for _ in 0..60 {
        let (value, slope) = phase(order, base + delta, t, supports, Direction::WAVENUMBER);
        let excess = delta - value;
        if excess > 0.0 {
            high = delta;
        } else {
            low = delta;
        }
        let newton = delta - excess / (1.0 - slope);
        let inside = newton >= low && newton <= high;
        let next = if inside { newton } else { 0.5 * (low + high) };
        let step = (next - delta).abs();
        delta = next;
        // The phase varies on the scale of phi itself, so a Newton step of 1e-9 leaves about 1e-18.
        if inside && step <= 1e-9 * delta || step <= 1e-16 * base {
            break;
        }
    }
    base + delta
}

/// A direction of differentiation in (phi, t).
#[derive(Clone, Copy)]
struct Direction {
    phi: f64,
    t: f64,
}

impl Direction {
    const WAVENUMBER: Self = Self { phi: 1.0, t: 0.0 };
    const TENSION: Self = Self { phi: 0.0, t: 1.0 };
}

/// `atan2(B, A) - (-1)^n asin(C / hypot(A, B))` and its derivative along `direction`.
#[inline]
fn phase(order: usize, phi: f64, t: f64, supports: &[Support; 2], direction: Direction) -> (f64, f64) {
    let [left, right] = supports;
    let q = (phi * phi + t).sqrt();
    let q_d = (phi * direction.phi + 0.5 * direction.t) / q;
    let r = phi / q;
    let r_d = (direction.phi - r * q_d) / q;
    let decay = libm::exp(-q);
    let inverse = 1.0 / (1.0 - decay * decay);
    let (coth, csch) = ((1.0 + decay * decay) * inverse, 2.0 * decay * inverse);
    let (coth_d, csch_d) = (-csch * csch * q_d, -coth * csch * q_d);

    let hinged = left.hinge * right.hinge * q * q;
    let hinged_d = 2.0 * left.hinge * right.hinge * q * q_d;
    let mixed_unit = left.hinge * right.clamp + right.hinge * left.clamp;
    let (mixed, mixed_d) = (mixed_unit * q, mixed_unit * q_d);
    let clamped = left.clamp * right.clamp;
    let (e, e_d) = (1.0 + r * r, 2.0 * r * r_d);

    // 1 - r^2 = t / q^2 without cancellation.
    let a = e * e * hinged + e * coth * mixed + t / (q * q) * clamped;
    let a_d =
        2.0 * e * e_d * hinged + e * e * hinged_d + (e_d * coth + e * coth_d) * mixed + e * coth * mixed_d
            - e_d * clamped;
    let b = e * r * mixed + 2.0 * r * coth * clamped;
    let b_d = (e_d * r + e * r_d) * mixed + e * r * mixed_d + 2.0 * (r_d * coth + r * coth_d) * clamped;
    let square = a * a + b * b;
    let angle = libm::atan2(b, a);
    let angle_d = (b_d * a - b * a_d) / square;
    if clamped == 0.0 {
        return (angle, angle_d);
    }
    let c = 2.0 * r * csch * clamped;
    let c_d = 2.0 * (r_d * csch + r * csch_d) * clamped;
    let ratio = c / square.sqrt();
    let ratio_d = c_d / square.sqrt() - ratio * (a * a_d + b * b_d) / square;
    let tilt = libm::asin(ratio);
    let tilt_d = ratio_d / (1.0 - ratio * ratio).sqrt();
    if order.is_multiple_of(2) {
        (angle - tilt, angle_d - tilt_d)
    } else {
        (angle + tilt, angle_d + tilt_d)
    }
}

/// The exact model of a parameterised rod.
#[derive(Debug, Clone)]
pub struct Exact {
    parameterisation: Parameterisation,
}

impl Exact {
    /// The exact model of rods with these quantities.
    pub fn new(parameterisation: Parameterisation) -> Self {
        Self { parameterisation }
    }
}

impl ForwardModel for Exact {
    fn name(&self) -> &'static str {
        "exact"
    }

    fn parameterisation(&self) -> &Parameterisation {
        &self.parameterisation
    }

    fn modes(&self) -> usize {
        MAX_MODES
    }

    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        frequencies(&self.parameterisation.beam(theta), out)
    }

    fn log_slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        log_slopes(&self.parameterisation.beam(theta), out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::hinged_frequency;
    use proptest::prelude::*;

    fn beam(n: f64, k: [f64; 2]) -> Beam {
        Beam {
            length_m: 14.0,
            flexural_rigidity_n_m2: 2e11 * 0.07f64.powi(4) / 12.0,
            mass_per_length_kg_m: 7500.0 * 0.0049,
            axial_force_n: n,
            end_stiffness_n_m: k,
        }
    }

    fn solve(beam: &Beam) -> [f64; 5] {
        let mut f = [0.0; 5];
        frequencies(beam, &mut f).unwrap();
        f
    }

    #[test]
    fn a_wavenumber_is_the_same_from_wherever_it_is_sought() {
        for (stiffness, tension) in [
            (0.0, 0.0),
            (0.0, 100.0),
            (3.0, 0.01),
            (3.0, 1e6),
            (1e9, 0.0),
            (1e9, 40.0),
        ] {
            let supports = [stiffness, 0.3 * stiffness].map(|k| Support::from_stiffness(k, 1.0));
            for order in 1..=5 {
                let found = wavenumber(order, tension, &supports);
                for near in [0.0, 0.9 * found, found, 1.000_001 * found, 3.0 * found] {
                    // A handful of roundings.
                    let again = wavenumber_near(order, tension, &supports, near);
                    assert!(
                        (again / found - 1.0).abs() < 1e-14,
                        "{order} {stiffness} {tension} {near}"
                    );
                }
            }
        }
    }

    #[test]
    fn hinged_beams_have_the_closed_form() {
        for n in [0.0, 1.0, 8e5, 1e12] {
            let beam = beam(n, [0.0; 2]);
            for (i, f) in solve(&beam).into_iter().enumerate() {
                // A handful of roundings.
                assert!((f / hinged_frequency(&beam, i + 1) - 1.0).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn without_tension_the_beam_constants_are_the_tabulated_ones() {
        let unit = unit_hz(&beam(0.0, [0.0; 2]));
        // Clamped-clamped, cos x cosh x = 1; clamped-hinged, tan x = tanh x.
        let clamped = [
            4.730_040_744_862_704,
            7.853_204_624_095_838,
            10.995_607_838_001_67,
            14.137_165_491_257_46,
            17.278_759_657_399_48,
        ];
        let propped = [
            3.926_602_312_047_919,
            7.068_582_745_628_732,
            10.210_176_122_813_03,
            13.351_768_777_754_09,
            16.493_361_431_346_41,
        ];
        let inf = f64::INFINITY;
        for (ends, constants) in [
            ([inf, inf], clamped),
            ([inf, 0.0], propped),
            ([0.0, inf], propped),
        ] {
            for (f, x) in solve(&beam(0.0, ends)).into_iter().zip(constants) {
                // The constants carry 16 digits.
                assert!((f / (unit * x * x) - 1.0).abs() < 2e-15 * 4.0, "{f} {x}");
            }
        }
    }

    #[test]
    fn without_bending_it_is_a_string() {
        let mut string = beam(8e5, [4e5, f64::INFINITY]);
        string.flexural_rigidity_n_m2 = 1e-6;
        let first = (8e5f64 / string.mass_per_length_kg_m).sqrt() / 28.0;
        for (i, f) in solve(&string).into_iter().enumerate() {
            // The end layers shorten the string by lambda each, 8e-8 here.
            assert!((f / (first * (i + 1) as f64) - 1.0).abs() < 2e-7);
        }
    }

    #[test]
    fn what_is_no_beam_is_refused() {
        for (n, k) in [
            (-1.0, 0.0),
            (f64::NAN, 0.0),
            (1.0, -1.0),
            (1.0, f64::NAN),
            (f64::INFINITY, 0.0),
        ] {
            assert!(frequencies(&beam(n, [0.0, k]), &mut [0.0]).is_err());
        }
    }

    /// The determinant of the four support conditions for sin, cos and the two decaying
    /// exponentials, by cofactors: shares nothing with the reduced equation.
    fn determinant(phi: f64, t: f64, kappa: [f64; 2]) -> f64 {
        let q = (phi * phi + t).sqrt();
        let e = (-q).exp();
        let (s, c) = phi.sin_cos();
        let (p2, q2) = (phi * phi, q * q);
        let rows = nalgebra::Matrix4::new(
            0.0,
            1.0,
            1.0,
            e,
            s,
            c,
            e,
            1.0,
            -kappa[0] * phi,
            -p2,
            q2 + kappa[0] * q,
            (q2 - kappa[0] * q) * e,
            -p2 * s + kappa[1] * phi * c,
            -p2 * c - kappa[1] * phi * s,
            (q2 - kappa[1] * q) * e,
            q2 + kappa[1] * q,
        );
        rows.determinant()
    }

    proptest! {
        #![proptest_config(crate::rod::beam::seeded(500))]

        #[test]
        fn roots_are_zeros_of_the_full_determinant_and_one_per_interval(
            log_lambda in -4.0f64..1.0, s_l in 0.0f64..=1.0, s_r in 0.0f64..=1.0, order in 1usize..=5,
        ) {
            let lambda = 10f64.powf(log_lambda);
            let t = 1.0 / (lambda * lambda);
            let supports = [Support::from_fixity(s_l, lambda), Support::from_fixity(s_r, lambda)];
            let phi = wavenumber(order, t, &supports);
            let n = order as f64;
            prop_assert!(phi >= n * PI && phi <= (n + 1.0) * PI);
            let kappa = [s_l / (1.0 - s_l) / lambda, s_r / (1.0 - s_r) / lambda];
            if kappa.iter().all(|&k| k < 1e6 && k > 1e-6) {
                // The determinant changes sign within a relative 1e-9 of the root.
                let below = determinant(phi * (1.0 - 1e-9), t, kappa);
                let above = determinant(phi * (1.0 + 1e-9), t, kappa);
                prop_assert!(below * above < 0.0, "{below} {above}");
            }
        }

        #[test]
        fn stiffer_ends_and_more_tension_raise_every_frequency(
            log_n in -2.0f64..9.0, log_l in -2.0f64..10.0, log_r in -2.0f64..10.0,
        ) {
            let n = 10f64.powf(log_n);
            let k = [10f64.powf(log_l), 10f64.powf(log_r)];
            let base = solve(&beam(n, k));
            for other in [beam(1.01 * n, k), beam(n, [1.01 * k[0], k[1]]), beam(n, [k[0], 1.01 * k[1]])] {
                for (a, b) in base.iter().zip(solve(&other)) {
                    // Rounding may hide an increase below 1e-14.
                    prop_assert!(b >= a * (1.0 - 1e-14));
                }
            }
            prop_assert!(base.windows(2).all(|pair| pair[0] < pair[1]));
        }

        #[test]
        fn slopes_are_the_derivatives(log_n in -1.0f64..8.0, log_l in -2.0f64..9.0, log_r in -2.0f64..9.0) {
            let n = 10f64.powf(log_n);
            let k = [10f64.powf(log_l), 10f64.powf(log_r)];
            let mut slopes = [0.0; 5];
            log_slopes(&beam(n, k), &mut slopes).unwrap();
            let h = 1e-4f64;
            let (up, down) = (solve(&beam(n * h.exp(), k)), solve(&beam(n * (-h).exp(), k)));
            for i in 0..5 {
                let difference = (up[i] / down[i]).ln() / (2.0 * h);
                // Truncation h^2 and rounding 1e-15 / h.
                prop_assert!((slopes[i] - difference).abs() < 1e-8, "{} {difference}", slopes[i]);
                prop_assert!((-1e-12..=0.5 + 1e-12).contains(&slopes[i]));
            }
        }
    }
}
