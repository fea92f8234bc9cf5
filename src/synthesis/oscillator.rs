//! One mode as an oscillator: exact sampled response to white noise, and free decay.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::PI;

/// An oscillator of natural frequency f and damping ratio zeta:
/// q'' + 2 zeta omega q' + omega^2 q = load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Oscillator {
    omega: f64,
    zeta: f64,
}

impl Oscillator {
    /// From natural frequency \[Hz\] and damping ratio, 0 < zeta < 1.
    pub fn new(frequency_hz: f64, zeta: f64) -> Self {
        Self {
            omega: 2.0 * PI * frequency_hz,
            zeta,
        }
    }

    /// Displacement and velocity `t` seconds after it was let go at `(q, v)`, `t >= 0`:
    /// exp(-zeta omega t) times a rotation with omega_d = omega sqrt(1 - zeta^2).
    pub fn free(&self, (q, v): (f64, f64), t: f64) -> (f64, f64) {
        let (omega, zeta) = (self.omega, self.zeta);
        let damped = omega * (1.0 - zeta * zeta).sqrt();
        let decay = libm::exp(-zeta * omega * t);
        let (sin, cos) = libm::sincos(damped * t);
        (
            decay * (q * cos + (v + zeta * omega * q) / damped * sin),
            decay * (v * cos - (omega * omega * q + zeta * omega * v) / damped * sin),
        )
    }

    /// The intensity S of a white load, E[w(t) w(s)] = S delta(t - s), that gives the stationary
    /// response the standard deviation `sd`: sd^2 = S / (4 zeta omega^3).
    pub fn intensity_for(&self, sd: f64) -> f64 {
        4.0 * self.zeta * self.omega.powi(3) * sd * sd
    }

    /// The response to a white load of intensity `intensity`, sampled every `dt` seconds.
    pub fn sampled(&self, intensity: f64, dt: f64) -> Sampled {
        // Columns of the transition matrix: free response to unit displacement, unit velocity.
        let (a11, a21) = self.free((1.0, 0.0), dt);
        let (a12, a22) = self.free((0.0, 1.0), dt);
        // The stationary covariance P is diagonal; one step adds Q = P - A P A'.
        let p1 = intensity / (4.0 * self.zeta * self.omega.powi(3));
        let p2 = intensity / (4.0 * self.zeta * self.omega);
        let q11 = p1 - (a11 * a11 * p1 + a12 * a12 * p2);
        let q12 = -(a11 * a21 * p1 + a12 * a22 * p2);
        let q22 = p2 - (a21 * a21 * p1 + a22 * a22 * p2);
        // Cholesky from the velocity down: at high sample rates Q11 = S dt^3 / 3 drowns in the rounding
        // of P, Q22 = S dt never does.
        let l22 = q22.max(0.0).sqrt();
        let l12 = if l22 > 0.0 { q12 / l22 } else { 0.0 };
        let l11 = (q11 - l12 * l12).max(0.0).sqrt();
        Sampled {
            transition: [[a11, a12], [a21, a22]],
            noise: [l11, l12, l22],
            stationary: [p1.sqrt(), p2.sqrt()],
        }
    }
}

/// An oscillator under white noise, stepped from sample to sample without discretisation error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampled {
    transition: [[f64; 2]; 2],
    noise: [f64; 3],
    stationary: [f64; 2],
}

impl Sampled {
    /// A state drawn from the stationary distribution.
    pub fn stationary<R: Rng>(&self, generator: &mut R) -> (f64, f64) {
        let (x, y) = (normal(generator), normal(generator));
        (self.stationary[0] * x, self.stationary[1] * y)
    }

    /// The state one sample later.
    pub fn step<R: Rng>(&self, (q, v): (f64, f64), generator: &mut R) -> (f64, f64) {
        let (x, y) = (normal(generator), normal(generator));
        let [[a11, a12], [a21, a22]] = self.transition;
        let [l11, l12, l22] = self.noise;
        (a11 * q + a12 * v + l11 * x + l12 * y, a21 * q + a22 * v + l22 * y)
    }
}

pub(super) fn normal<R: Rng>(generator: &mut R) -> f64 {
    StandardNormal.sample(generator)
}
