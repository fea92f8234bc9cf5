//! Answer of the beam to a force at one place: static deflection, and natural frequencies with a mass hung on it.
//!
//! With `x` in units of the length, `phi` and `q` as in [`super::exact`], the deflection under a unit force at `a` solves
//! `w'''' - t w'' - phi^2 q^2 w = delta(x - a)`. An unbounded beam has
//!
//! ```text
//! p(d) = -(exp(-q d) / (2 q) + sin(phi d) / (2 phi)) / (phi^2 + q^2),   d = |x - a|,
//! ```
//!
//! and the supports add `A sin(phi x) / phi + B cos(phi x) + C exp(-q x) + D exp(-q (1 - x))`. Nothing here has a pole but at the
//! natural frequencies, nothing grows, and `phi = 0` is the static case. C and D follow from `w(0) = w(1) = 0`, A and B from the
//! supports' `h w'' = +-c w'`.

use super::exact::{self, Support};
use super::{Beam, OutsideRange};
use std::f64::consts::PI;

/// Tension `N l^2 / EI` below which the static answer is that of this tension: an error of 1e-5 at most, where less would cancel.
const LEAST_TENSION: f64 = 1e-4;

/// A place along the rod and a load there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointLoad {
    /// Force across the rod \[N\].
    pub force_n: f64,
    /// Place as a share of the length.
    pub at: f64,
}

/// A mass fixed to the rod at one place; it does not turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointMass {
    /// Mass \[kg\].
    pub mass_kg: f64,
    /// Its place as a share of the length.
    pub at: f64,
}

/// Static deflection \[m\] at `read_at`, a share of the length, under a load across the rod.
///
/// Linear: the axial force is that of the unloaded rod. See [`stiffening`] for what a large deflection adds to it.
///
/// # Errors
/// The parameters are not those of a beam.
pub fn deflection(beam: &Beam, load: PointLoad, read_at: f64) -> Result<f64, OutsideRange> {
    let (tension, supports) = exact::dimensionless(beam)?;
    let unit = beam.length_m.powi(3) / beam.flexural_rigidity_n_m2;
    let response = response(0.0, tension.max(LEAST_TENSION), &supports, load.at, read_at);
    Ok(load.force_n * unit * response)
}

/// Axial strain that a deflection `peak_m` under a point load at `at` adds to a rod whose ends do not move: that of a string bent
/// into a triangle, `peak^2 / (2 l^2 at (1 - at))`; a beam's is smaller.
pub fn stiffening(length_m: f64, at: f64, peak_m: f64) -> f64 {
    (peak_m / length_m).powi(2) / (2.0 * at * (1.0 - at))
}

/// Natural frequency \[Hz\] with a mass on the beam, of the last of `free_hz`, the beam's first frequencies without it: the root of
/// `1 = M omega^2 G(a, a; omega)`, which lies between the last two, to 1e-6 relative.
///
/// # Errors
/// The parameters are not those of a beam.
pub fn loaded_frequency(beam: &Beam, free_hz: &[f64], mass: PointMass) -> Result<f64, OutsideRange> {
    let (t, supports) = exact::dimensionless(beam)?;
    let unit = exact::unit_hz(beam);
    let square = |f: Option<&f64>| f.map_or(0.0, |f| (f / unit) * (f / unit));
    let bracket = [square(free_hz.iter().rev().nth(1)), square(free_hz.last())];
    let ratio = mass.mass_kg / (beam.mass_per_length_kg_m * beam.length_m);
    let sine = libm::sin(PI * free_hz.len() as f64 * mass.at);
    let usual = 2.0 * ratio * sine * sine;
    Ok(unit * loaded_square(bracket, t, &supports, (ratio, mass.at), usual).sqrt())
}

/// `(phi q)^2` of the mode with the mass. In `s = (phi q)^2` the function `(s_n - s)(s - s_(n-1)) (1 - mu s G)` is smooth up to both
/// ends, where `1 - mu s G` itself has poles, positive on the left of the root and negative on the right. `usual` is the mass in units
/// of the mode's own, were its shape a sine: the search begins there.
fn loaded_square(
    [lower, upper]: [f64; 2],
    t: f64,
    supports: &[Support; 2],
    (ratio, at): (f64, f64),
    usual: f64,
) -> f64 {
    let value = |s: f64| {
        let phi = (2.0 * s / (t + (t * t + 4.0 * s).sqrt())).sqrt();
        let raw = 1.0 - ratio * s * response(phi, t, supports, at, at);
        (upper - s) * (s - lower) * raw
    };
    let (mut low, mut high) = (lower, upper);
    // One mode alone, its share of the response read where a sine would have the root.
    let width = upper - lower;
    let near = (upper / (1.0 + usual))
        .max(upper - 0.5 * width)
        .min(upper - 0.01 * width);
    let at_near = value(near);
    let share = (1.0 - at_near / ((upper - near) * (near - lower))) * (upper - near) / near;
    let mut previous = (near, at_near);
    match at_near > 0.0 {
        true => low = near,
        false => high = near,
    }
    let mut s = (upper / (1.0 + share.max(0.0))).clamp(low, high);
    let mut before = (s - near).abs();
    // Slope of s over the value between the two points before, and the value at the older of them.
    let mut older: Option<(f64, f64)> = None;
    // Inverse interpolation inside a bracket that at least halves every third step: 60 exhaust double precision.
    for step in 0..60 {
        if s <= lower || s >= upper {
            s = 0.5 * (low + high);
        }
        let found = value(s);
        // At a node of the mode numerator and denominator vanish together: the mass does not move it.
        if !found.is_finite() || found == 0.0 {
            return s;
        }
        match found > 0.0 {
            true => low = s,
            false => high = s,
        }
        // The parabola of s over the last three values; of two the line.
        let slope = (s - previous.0) / (found - previous.1);
        let bend = older.map_or(0.0, |(last, value)| (slope - last) / (found - value));
        let guess = s - found * (slope - previous.1 * bend);
        older = Some((slope, previous.1));
        previous = (s, found);
        let inside = guess > low && guess < high;
        let is_close = (guess - s).abs() < 1e-3 * s;
        let next = match inside && (is_close || step % 3 != 2) {
            true => guess,
            false => 0.5 * (low + high),
        };
        let moved = (next - s).abs();
        s = next;
        // A line's error is about the product of the last two, which the steps are; a parabola's is smaller.
        if moved * before <= 3e-7 * s * s && inside || high - low <= 1e-15 * s {
            break;
        }
        before = moved;
    }
    s
}

/// The four solutions at a distance `d` from an end or a force: `sin(phi d) / phi` (`d` itself where phi is zero), `cos(phi d)`,
/// `exp(-q d)`.
#[derive(Clone, Copy)]
struct Waves {
    sine: f64,
    cosine: f64,
    decay: f64,
}

impl Waves {
    fn new(phi: f64, q: f64, d: f64) -> Self {
        let decay = libm::exp(-q * d);
        if phi > 0.0 {
            let (sin, cosine) = libm::sincos(phi * d);
            Self {
                sine: sin / phi,
                cosine,
                decay,
            }
        } else {
            Self {
                sine: d,
                cosine: 1.0,
                decay,
            }
        }
    }

    /// Over both distances together, by the addition theorems.
    fn and(self, phi: f64, other: Self) -> Self {
        Self {
            sine: self.sine * other.cosine + self.cosine * other.sine,
            cosine: self.cosine * other.cosine - phi * phi * self.sine * other.sine,
            decay: self.decay * other.decay,
        }
    }

    /// Deflection `p` of the unbounded beam.
    fn free(self, q: f64, sum: f64) -> f64 {
        -(self.decay / q + self.sine) / (2.0 * sum)
    }

    /// Its slope.
    fn slope(self, sum: f64) -> f64 {
        (self.cosine - self.decay) / (2.0 * sum)
    }
}

/// Deflection at `x` under a unit force at `at`, in units of `l^3 / EI`.
fn response(phi: f64, t: f64, supports: &[Support; 2], at: f64, x: f64) -> f64 {
    let [left, right] = supports;
    let q = (phi * phi + t).sqrt();
    let sum = phi * phi + q * q;
    let (a, b) = (Waves::new(phi, q, at), Waves::new(phi, q, 1.0 - at));
    let whole = a.and(phi, b);
    let (p0, p1) = (a.free(q, sum), b.free(q, sum));
    let decay = whole.decay;
    let inverse = 1.0 / (1.0 - decay * decay);
    let (coth, csch) = ((1.0 + decay * decay) * inverse, 2.0 * decay * inverse);
    let (sin, cos) = (whole.sine, whole.cosine);

    // Coefficients of A and B, and the right-hand side: the left support, then the right one.
    let (h, c) = (left.hinge, left.clamp);
    let l_a = c * (q * csch * sin - 1.0);
    let l_b = -h * sum + c * q * (csch * cos - coth);
    let l_0 = -0.5 * h * a.sine + c * (a.slope(sum) + q * (p0 * coth - p1 * csch));
    let (h, c) = (right.hinge, right.clamp);
    let r_a = -h * sum * sin + c * (cos - q * coth * sin);
    let r_b = -h * sum * cos - c * (phi * phi * sin + q * (coth * cos - csch));
    let r_0 = -0.5 * h * b.sine + c * (b.slope(sum) + q * (p1 * coth - p0 * csch));
    let determinant = l_a * r_b - l_b * r_a;
    let big_a = (l_0 * r_b - l_b * r_0) / determinant;
    let big_b = (l_a * r_0 - l_0 * r_a) / determinant;

    let (u, v) = (-p0 - big_b, -p1 - big_a * sin - big_b * cos);
    let near = (u - decay * v) * inverse;
    let far = (v - decay * u) * inverse;
    // Read under the force, as a mass does, everything is there already.
    let (here, decay_from_right, free) = match x == at {
        true => (a, b.decay, -(1.0 / q) / (2.0 * sum)),
        false => (
            Waves::new(phi, q, x),
            libm::exp(-q * (1.0 - x)),
            Waves::new(phi, q, (x - at).abs()).free(q, sum),
        ),
    };
    big_a * here.sine + big_b * here.cosine + near * here.decay + far * decay_from_right + free
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::dense::{Elements, beam, cases};
    use rand::RngExt;

    #[test]
    fn deflections_are_those_of_finite_elements() {
        for beam in cases() {
            let elements = Elements::new(&beam, 200);
            for (at, read_at) in [(0.5, 0.5), (0.3, 0.4), (0.1, 0.8), (0.95, 0.05)] {
                let closed = deflection(&beam, PointLoad { force_n: 300.0, at }, read_at).unwrap();
                let found = elements.deflection(300.0, at, read_at);
                // Hermite elements under nodal loads are wrong by 1e-8 to 1e-7 here (the tautest most), the solver by 1e-9.

                assert!(
                    (closed / found - 1.0).abs() < 5e-7,
                    "{beam:?} {at} {read_at} {closed} {found}"
                );
            }
        }
    }

    #[test]
    fn deflections_of_textbooks_and_of_a_string() {
        let read = |beam: &Beam, at: f64| deflection(beam, PointLoad { force_n: 300.0, at }, at).unwrap();
        let unit = 300.0 * 14f64.powi(3) / 4e5;
        // Without tension: hinged P l^3 / 48 EI, clamped P l^3 / 192 EI; to the error of the least tension.
        assert!((read(&beam(0.0, [0.0; 2]), 0.5) / (unit / 48.0) - 1.0).abs() < 1.2e-5);
        assert!((read(&beam(0.0, [f64::INFINITY; 2]), 0.5) / (unit / 192.0) - 1.0).abs() < 1.2e-5);
        // A string: P l a (1 - a) / N; the beam's boundary layers shorten it by lambda / 2 of 1.6e-4.
        let mut string = beam(8e5, [0.0; 2]);
        string.flexural_rigidity_n_m2 = 4.0;
        assert!((read(&string, 0.3) / (300.0 * 14.0 * 0.21 / 8e5) - 1.0).abs() < 1e-3);
        // Maxwell: load and reading change places.
        let beam = beam(8e5, [0.0, 2e6]);
        let place = |at, read_at| deflection(&beam, PointLoad { force_n: 1.0, at }, read_at).unwrap();
        assert!((place(0.2, 0.7) / place(0.7, 0.2) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_root_lies_between_its_neighbours_a_millionth_away() {
        let mut generator = crate::numerics::random::stream(9, 0);
        let mut even_in_log = |low: f64, high: f64| low * (high / low).powf(generator.random::<f64>());
        for draw in 0..300 {
            let beam = Beam {
                flexural_rigidity_n_m2: even_in_log(1e5, 1e6),
                mass_per_length_kg_m: even_in_log(20.0, 50.0),
                ..beam(
                    even_in_log(5e4, 2e6),
                    [even_in_log(1e3, 1e7), even_in_log(1e3, 1e7)],
                )
            };
            let (t, supports) = exact::dimensionless(&beam).unwrap();
            let unit = exact::unit_hz(&beam);
            let mut free = [0.0; 3];
            exact::frequencies(&beam, &mut free).unwrap();
            let at = 0.07 + 0.0013 * f64::from(draw);
            for mass_kg in [0.5, 20.0, 700.0] {
                let ratio = mass_kg / (beam.mass_per_length_kg_m * beam.length_m);
                for order in 1..=3 {
                    let found = loaded_frequency(&beam, &free[..order], PointMass { mass_kg, at }).unwrap();
                    let left = |f: f64| {
                        let s = (f / unit).powi(2);
                        let phi = (2.0 * s / (t + (t * t + 4.0 * s).sqrt())).sqrt();
                        1.0 - ratio * s * response(phi, t, &supports, at, at)
                    };
                    let (low, high) = (found * (1.0 - 1e-6), found * (1.0 + 1e-6));
                    // At a node the mass hardly moves the mode: the root is the pole.
                    let is_inside = high < free[order - 1] && (order == 1 || low > free[order - 2]);
                    assert!(
                        !is_inside || (left(low) > 0.0 && left(high) < 0.0),
                        "draw {draw}, {mass_kg} kg at {at}, mode {order}"
                    );
                }
            }
        }
    }

    #[test]
    fn frequencies_with_a_mass_are_those_of_finite_elements() {
        for beam in cases() {
            let elements = Elements::new(&beam, 100);
            let alone = elements.frequencies(0.0, 0.5);
            let mut free = [0.0; 5];
            exact::frequencies(&beam, &mut free).unwrap();
            for (mass_kg, at) in [(20.0, 0.3), (0.1, 0.07), (300.0, 0.5), (5000.0, 0.81)] {
                let found = elements.frequencies(mass_kg, at);
                for order in 1..=5 {
                    let closed = loaded_frequency(&beam, &free[..order], PointMass { mass_kg, at }).unwrap();
                    // The elements' own error, (n pi h)^4 / 1440 and more in the boundary layers, cancels in the ratio but for
                    // what the mass changes of it; the dense solver loses 1e-9 of the highest eigenvalue.
                    let error = (closed / free[order - 1]) / (found[order - 1] / alone[order - 1]) - 1.0;
                    assert!(error.abs() < 3e-5, "{beam:?} {mass_kg} {at} {order} {error:e}");
                }
            }
        }
    }

    #[test]
    fn a_mass_at_a_node_or_of_nothing_moves_nothing() {
        let beam = beam(8e5, [4e5, 4e5]);
        let mut free = [0.0; 5];
        exact::frequencies(&beam, &mut free).unwrap();
        for order in [2, 4] {
            let loaded = loaded_frequency(
                &beam,
                &free[..order],
                PointMass {
                    mass_kg: 50.0,
                    at: 0.5,
                },
            )
            .unwrap();
            assert!((loaded / free[order - 1] - 1.0).abs() < 1e-9, "{order} {loaded}");
        }
        for order in 1..=5 {
            let light = PointMass {
                mass_kg: 1e-6,
                at: 0.3,
            };
            let loaded = loaded_frequency(&beam, &free[..order], light).unwrap();
            assert!((loaded / free[order - 1] - 1.0).abs() < 1e-8);
        }
    }

    #[test]
    fn the_first_order_ratio_is_the_limit_of_small_masses() {
        use crate::rod::beam::shape::Shape;
        let beam = beam(8e5, [4e5, 1e5]);
        let mut free = [0.0; 3];
        exact::frequencies(&beam, &mut free).unwrap();
        for (order, f) in (1..).zip(free) {
            let shape = Shape::of(&beam, f);
            let mass = PointMass {
                mass_kg: 0.05,
                at: 0.3,
            };
            let share = mass.mass_kg * shape.at(0.3).powi(2) / (37.0 * 14.0 * shape.mean_square());
            let ratio = loaded_frequency(&beam, &free[..order], mass).unwrap() / f;
            // 1 / sqrt(1 + share) but for what the mass mixes in of other modes: its share of the rod's mass, 1e-4, times this one.
            assert!(
                (ratio - (1.0 + share).sqrt().recip()).abs() < 10.0 * share * 0.05 / 518.0,
                "{order} {ratio}"
            );
        }
    }
}
