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

    /// Displacement and velocity `t` seconds after a release at `(q, v)`, `t >= 0`: exp(-zeta omega t)
    /// times a rotation with omega_d = omega sqrt(1 - zeta^2).
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
    pub fn step<R: Rng>(&self, state: (f64, f64), generator: &mut R) -> (f64, f64) {
        self.driven(state, 1.0, generator)
    }

    /// The state one sample later under a load of `amplitude` times the intensity's during that sample.
    pub fn driven<R: Rng>(&self, (q, v): (f64, f64), amplitude: f64, generator: &mut R) -> (f64, f64) {
        let (x, y) = (amplitude * normal(generator), amplitude * normal(generator));
        let [[a11, a12], [a21, a22]] = self.transition;
        let [l11, l12, l22] = self.noise;
        (a11 * q + a12 * v + l11 * x + l12 * y, a21 * q + a22 * v + l22 * y)
    }
}

pub(super) fn normal<R: Rng>(generator: &mut R) -> f64 {
    StandardNormal.sample(generator)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    #[test]
    fn free_decay_solves_the_equation_of_motion() {
        // Oracle: classical Runge-Kutta of order four, independent of the closed form.
        let (f, zeta) = (4.5, 0.03);
        let omega = 2.0 * PI * f;
        let slope = |(q, v): (f64, f64)| (v, -omega * omega * q - 2.0 * zeta * omega * v);
        let (mut q, mut v) = (1.0, -5.0);
        let h = 1e-4;
        for _ in 0..10_000 {
            let (a, b) = slope((q, v));
            let (c, d) = slope((q + 0.5 * h * a, v + 0.5 * h * b));
            let (e, g) = slope((q + 0.5 * h * c, v + 0.5 * h * d));
            let (i, j) = slope((q + h * e, v + h * g));
            q += h / 6.0 * (a + 2.0 * c + 2.0 * e + i);
            v += h / 6.0 * (b + 2.0 * d + 2.0 * g + j);
        }
        let exact = Oscillator::new(f, zeta).free((1.0, -5.0), 1.0);
        // Global error of the method: about (omega h)^4 omega t / 120 = 2e-12 here.
        assert!(
            (exact.0 - q).abs() < 1e-9 && (exact.1 - v).abs() < 1e-7,
            "{exact:?} {q} {v}"
        );
    }

    #[test]
    fn successive_maxima_obey_the_logarithmic_decrement() {
        let (f, zeta) = (9.288, 0.01_f64);
        let oscillator = Oscillator::new(f, zeta);
        let period = 1.0 / (f * (1.0 - zeta * zeta).sqrt());
        let ratio = oscillator.free((1.0, 0.0), period).0 / oscillator.free((1.0, 0.0), 2.0 * period).0;
        let decrement = 2.0 * PI * zeta / (1.0 - zeta * zeta).sqrt();
        assert!((ratio.ln() - decrement).abs() < 1e-12);
    }

    /// One step must reproduce the stationary covariance: P = A P A' + L L'.
    #[test]
    fn the_sampled_response_is_stationary_at_any_sample_rate() {
        for (f, zeta, fs) in [
            (4.5, 0.002, 100.0),
            (0.5, 1e-4, 1000.0),
            (13.0, 0.5, 30.0),
            (4.5, 1e-3, 1e5),
        ] {
            let oscillator = Oscillator::new(f, zeta);
            let Sampled {
                transition: a,
                noise: [l11, l12, l22],
                stationary: [sq, sv],
            } = oscillator.sampled(oscillator.intensity_for(2.0), 1.0 / fs);
            assert!(
                (sq - 2.0).abs() < 1e-12,
                "calibrated to the standard deviation asked for"
            );
            let (p, r) = (sq * sq, sv * sv);
            let noise = [[l11 * l11 + l12 * l12, l12 * l22], [l12 * l22, l22 * l22]];
            for (i, row) in noise.iter().enumerate() {
                for (j, added) in row.iter().enumerate() {
                    let next = a[i][0] * a[j][0] * p + a[i][1] * a[j][1] * r + added;
                    let wanted = if i != j { 0.0 } else { [p, r][i] };
                    let scale = [sq, sv][i] * [sq, sv][j];
                    assert!(
                        (next - wanted).abs() < 1e-12 * scale,
                        "{f} {zeta} {fs}: {i}{j} {next} {wanted}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_spectrum_is_that_of_an_oscillator_under_white_noise() {
        // One-sided G(f) = 2 S / ((w0^2 - w^2)^2 + (2 zeta w0 w)^2), by a bare Fourier sum.
        let (f0, zeta, fs, n, repeats) = (4.0, 0.05, 100.0, 2000, 400);
        let oscillator = Oscillator::new(f0, zeta);
        let intensity = oscillator.intensity_for(1.0);
        let sampled = oscillator.sampled(intensity, 1.0 / fs);
        let frequencies = [2.0, 3.5, 4.0, 4.5, 6.0];
        let mut density = [0.0; 5];
        let mut variance = 0.0;
        for repeat in 0..repeats {
            let mut generator = random::stream(11, repeat);
            let mut state = sampled.stationary(&mut generator);
            let mut sums = [(0.0, 0.0); 5];
            for k in 0..n {
                for (sum, f) in sums.iter_mut().zip(frequencies) {
                    let (sin, cos) = (2.0 * PI * f * k as f64 / fs).sin_cos();
                    sum.0 += state.0 * cos;
                    sum.1 += state.0 * sin;
                }
                variance += state.0 * state.0 / (n as f64 * repeats as f64);
                state = sampled.step(state, &mut generator);
            }
            for (density, (re, im)) in density.iter_mut().zip(sums) {
                *density += 2.0 / (fs * n as f64) * (re * re + im * im) / repeats as f64;
            }
        }
        // 400 records of 20 s with a correlation time of 1 / (zeta omega) = 0.8 s: sd of the variance 1 %.
        assert!((variance - 1.0).abs() < 0.04, "{variance}");
        for (f, density) in frequencies.iter().zip(density) {
            let (w0, w) = (2.0 * PI * f0, 2.0 * PI * f);
            let exact = 2.0 * intensity / ((w0 * w0 - w * w).powi(2) + (2.0 * zeta * w0 * w).powi(2));
            // A mean of 400 exponentials has sd 5 %; leakage of the untapered sum adds a few per cent.
            assert!((density / exact - 1.0).abs() < 0.2, "{f} Hz: {density} {exact}");
        }
    }
}
