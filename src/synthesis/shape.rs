//! The mode shapes of a simulated rod.

use crate::beam::Beam;
use std::f64::consts::PI;

/// Intervals of the grid on which a shape's maximum and norm are found.
const GRID: usize = 400;

/// A mode shape w(x), its largest deflection 1 and its first lobe positive.
///
/// For a beam, w = A sin(beta x) + B cos(beta x) + C exp(-alpha x) + D exp(-alpha (l - x)), where
/// alpha^2 and -beta^2 are the roots s of EI s^2 - N s - m omega^2 = 0, and A to D follow from
/// w(0) = w(l) = 0 and the left spring, EI w''(0) = k_l w'(0); the right spring's condition is what makes
/// omega a natural frequency.
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
    /// The sine of mode `order` of a rod that has no beam behind it.
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

    /// The shape of a beam at one of its natural frequencies \[Hz\].
    pub fn of(beam: &Beam, frequency_hz: f64) -> Self {
        let (l, ei, n) = (beam.length_m, beam.flexural_rigidity_n_m2, beam.axial_force_n);
        let inertia = beam.mass_per_length_kg_m * (2.0 * PI * frequency_hz).powi(2);
        let root = (n * n + 4.0 * ei * inertia).sqrt();
        let alpha_squared = (n + root) / (2.0 * ei);
        // The other root by the product of roots, without cancellation.
        let beta_squared = inertia / (ei * alpha_squared);
        let (alpha, beta) = (alpha_squared.sqrt(), beta_squared.sqrt());
        let spring = beam.end_stiffness_n_m[0] / ei;
        let far = libm::exp(-alpha * l);
        let (sin, cos) = libm::sincos(beta * l);
        let weight = alpha_squared + beta_squared + spring * alpha;
        let (b0, b1) = (-spring * beta / weight, -2.0 * spring * alpha * far / weight);
        let d = -(sin + b0 * (cos - far)) / (1.0 + b1 * (cos - far) - far * far);
        let b = b0 + b1 * d;
        let raw = Self {
            length_m: l,
            alpha,
            beta,
            coefficients: [1.0, b, -b - far * d, d],
            mean_square: 1.0,
        };
        raw.normalised()
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

    /// First and second derivative at `share` of the length, for tests.
    #[cfg(test)]
    fn derivatives(&self, share: f64) -> (f64, f64) {
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
