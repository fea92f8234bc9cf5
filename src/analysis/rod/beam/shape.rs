//! Mode shapes of a beam: deflection and curvature along the rod.

use super::Beam;
use super::exact::Support;
use std::f64::consts::PI;

/// Intervals of the grid on which a shape's maximum and norm are found.
const GRID: usize = 400;

/// A mode shape w(x).
///
/// For a beam, w = A sin(beta x) + B cos(beta x) + C exp(-alpha x) + D exp(-alpha (l - x)), where
/// alpha^2 and -beta^2 are the roots s of EI s^2 - N s - m omega^2 = 0, and A to D follow from
/// w(0) = w(l) = 0 and the left spring, EI w''(0) = k_l w'(0); the right spring's condition is what makes
/// omega a natural frequency. Any end stiffness from a hinge to a clamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    length_m: f64,
    alpha: f64,
    beta: f64,
    /// A, B, C, D.
    coefficients: [f64; 4],
    mean_square: f64,
}

impl Shape {
    /// Sine of mode `order`, for a rod given by its frequencies.
    pub fn sine(order: usize) -> Self {
        let beta = order as f64 * PI;
        Self {
            length_m: 1.0,
            alpha: 1.0,
            beta,
            coefficients: [1.0, 0.0, 0.0, 0.0],
            mean_square: 0.5,
        }
    }

    /// The shape of a beam at one of its natural frequencies \[Hz\], its largest deflection 1 and its first lobe positive.
    pub fn of(beam: &Beam, frequency_hz: f64) -> Self {
        Self::unscaled(beam, frequency_hz).normalised()
    }

    /// The same with A = 1: for ratios, which no scale changes. Its mean square is that of no shape.
    pub fn unscaled(beam: &Beam, frequency_hz: f64) -> Self {
        let (l, ei, n) = (beam.length_m, beam.flexural_rigidity_n_m2, beam.axial_force_n);
        let inertia = beam.mass_per_length_kg_m * (2.0 * PI * frequency_hz).powi(2);
        let root = (n * n + 4.0 * ei * inertia).sqrt();
        let alpha_squared = (n + root) / (2.0 * ei);
        // The other root by the product of roots, without cancellation.
        let beta_squared = inertia / (ei * alpha_squared);
        let (alpha, beta) = (alpha_squared.sqrt(), beta_squared.sqrt());
        let Support { hinge, clamp } = Support::from_stiffness(beam.end_stiffness_n_m[0], ei / l);
        let clamp = clamp / l;
        let far = libm::exp(-alpha * l);
        let (sin, cos) = libm::sincos(beta * l);
        let weight = hinge * (alpha_squared + beta_squared) + clamp * alpha;
        let (b0, b1) = (-clamp * beta / weight, -2.0 * clamp * alpha * far / weight);
        let d = -(sin + b0 * (cos - far)) / (1.0 + b1 * (cos - far) - far * far);
        let b = b0 + b1 * d;
        Self {
            length_m: l,
            alpha,
            beta,
            coefficients: [1.0, b, -b - far * d, d],
            mean_square: 1.0,
        }
    }

    fn normalised(mut self) -> Self {
        let grid: Vec<f64> = (0..=GRID).map(|i| self.at(i as f64 / GRID as f64)).collect();
        let largest = grid.iter().fold(0.0_f64, |largest, w| largest.max(w.abs()));
        let sign = if grid[1] < 0.0 { -1.0 } else { 1.0 };
        for coefficient in &mut self.coefficients {
            *coefficient *= sign / largest;
        }
        // Simpson's rule.
        let sum: f64 = grid
            .iter()
            .enumerate()
            .map(|(i, w)| {
                let weight = if i == 0 || i == GRID {
                    1.0
                } else {
                    2.0 + 2.0 * (i % 2) as f64
                };
                weight * (w / largest).powi(2)
            })
            .sum();
        self.mean_square = sum / (3.0 * GRID as f64);
        self
    }

    /// The deflection at `share` of the length.
    pub fn at(&self, share: f64) -> f64 {
        let x = share * self.length_m;
        let [a, b, c, d] = self.coefficients;
        let (sin, cos) = libm::sincos(self.beta * x);
        a * sin + b * cos + c * libm::exp(-self.alpha * x) + d * libm::exp(-self.alpha * (self.length_m - x))
    }

    /// The mean of w^2 over the length: modal mass over the rod's mass.
    pub fn mean_square(&self) -> f64 {
        self.mean_square
    }

    /// First \[1/m\] and second \[1/m^2\] derivative at `share` of the length.
    pub fn derivatives(&self, share: f64) -> (f64, f64) {
        let x = share * self.length_m;
        let [a, b, c, d] = self.coefficients;
        let (alpha, beta) = (self.alpha, self.beta);
        let (sin, cos) = libm::sincos(beta * x);
        let (near, far) = (
            c * libm::exp(-alpha * x),
            d * libm::exp(-alpha * (self.length_m - x)),
        );
        (
            beta * (a * cos - b * sin) + alpha * (far - near),
            -beta * beta * (a * sin + b * cos) + alpha * alpha * (near + far),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::dense::{beam, cases};
    use crate::rod::beam::exact;

    fn shapes(beam: &Beam) -> Vec<(f64, Shape)> {
        let mut frequencies = [0.0; 5];
        exact::frequencies(beam, &mut frequencies).unwrap();
        frequencies.iter().map(|f| (*f, Shape::of(beam, *f))).collect()
    }

    #[test]
    fn shapes_hold_at_both_supports() {
        for beam in cases() {
            for (_, shape) in shapes(&beam) {
                assert!(shape.at(0.0).abs() < 1e-9 && shape.at(1.0).abs() < 1e-9);
                let (slope, curvature) = shape.derivatives(1.0);
                let moment = beam.flexural_rigidity_n_m2 * curvature + beam.end_stiffness_n_m[1] * slope;
                let scale = (beam.flexural_rigidity_n_m2 + beam.end_stiffness_n_m[1]) * shape.beta;
                // Not used to find the shape: it holds because omega is a natural frequency.
                assert!(moment.abs() < 1e-7 * scale, "{moment:e} of {scale:e}");
            }
        }
    }

    #[test]
    fn shapes_are_orthogonal_and_their_rayleigh_quotient_is_the_frequency() {
        for beam in cases() {
            let shapes = shapes(&beam);
            let grid = 4000;
            let integral = |f: &dyn Fn(f64) -> f64| {
                // The midpoint rule, another one than the shape's own.
                (0..grid).map(|i| f((i as f64 + 0.5) / grid as f64)).sum::<f64>() / grid as f64
            };
            for (i, (frequency, shape)) in shapes.iter().enumerate() {
                for (_, other) in &shapes[i + 1..] {
                    let product = integral(&|x| shape.at(x) * other.at(x));
                    assert!(product.abs() < 1e-6, "{product:e}");
                }
                let norm = integral(&|x| shape.at(x).powi(2));
                assert!((norm - shape.mean_square()).abs() < 1e-6);
                let bending = integral(&|x| beam.flexural_rigidity_n_m2 * shape.derivatives(x).1.powi(2));
                let tension = integral(&|x| beam.axial_force_n * shape.derivatives(x).0.powi(2));
                let springs: f64 = [0.0, 1.0]
                    .iter()
                    .zip(beam.end_stiffness_n_m)
                    .map(|(end, k)| k * shape.derivatives(*end).0.powi(2) / beam.length_m)
                    .sum();
                let omega = ((bending + tension + springs) / (beam.mass_per_length_kg_m * norm)).sqrt();
                assert!(
                    (omega / (2.0 * PI * frequency) - 1.0).abs() < 1e-5,
                    "{omega} {frequency}"
                );
            }
        }
    }

    #[test]
    fn a_hinged_shape_is_a_sine_and_mid_span_sees_no_even_mode() {
        for (order, (_, shape)) in (1..).zip(shapes(&beam(8e5, [0.0, 0.0]))) {
            for x in [0.1, 0.25, 0.4, 0.77] {
                assert!((shape.at(x) - Shape::sine(order).at(x)).abs() < 1e-4);
            }
        }
        for (_, shape) in shapes(&beam(8e5, [4e5, 4e5])).iter().skip(1).step_by(2) {
            assert!(shape.at(0.5).abs() < 1e-9);
        }
    }
}
