//! A free decay whose frequency falls with its amplitude.
//!
//! Supports slip and rods stretch: at the amplitude a decay begins with, its frequency differs by a share `b` from
//! that of a small swing, and the difference dies out with the amplitude, `f (1 - b e^(-gamma t))`, `gamma = 2 pi zeta f`.
//! Its state is the linear one times a phase,
//!
//! ```text
//! z(t) = z(0) e^(st) e^(-i beta (1 - e^(-gamma t))),     beta = b / zeta
//! ```
//!
//! and, the exponential of an exponential being a power series, a sum of decays of one frequency:
//!
//! ```text
//! z(t) = z(0) e^(-i beta) sum_n (i beta)^n / n! e^((s - n gamma) t)
//! ```
//!
//! Each has its coefficients `(1 - e^((s - n gamma) T)) / (2 pi i f_k - s + n gamma)` at the Fourier frequencies, exact for any
//! record length.

use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Most terms of the series; with [`MOST_PHASE`] the first one left out is below 1e-7 of the largest.
const MOST_TERMS: usize = 24;
/// Largest phase beta \[rad\].
const MOST_PHASE: f64 = 4.0;
/// Terms below this share of the first are left out: a decay 120 dB above its noise does not show them.
const LEAST_TERM: f64 = 1e-6;

/// Transient of a mode at unit amplitude, 1 at the peak of the linear one.
#[derive(Debug, Clone, Copy)]
pub struct Softened {
    damped_hz: f64,
    gamma_hz: f64,
    terms: [Complex<f64>; MOST_TERMS],
    count: usize,
}

impl Softened {
    /// A decay of a record of `duration_s`; `softening` is `b`. `None` where the phase is beyond the series.
    pub fn new(frequency_hz: f64, damping: f64, softening: f64, duration_s: f64) -> Option<Self> {
        let phase = softening / damping;
        if phase.is_nan() || phase.abs() > MOST_PHASE {
            return None;
        }
        let damped_hz = frequency_hz * (1.0 - damping * damping).max(0.0).sqrt();
        let gamma_hz = damping * frequency_hz;
        let shrunk = (-TAU * gamma_hz * duration_s).exp();
        let turned = Complex::from_polar(1.0, TAU * damped_hz * duration_s);
        let one = Complex::new(1.0, 0.0);
        let mut end = turned * shrunk;
        let first = one - end;
        let mut terms = [Complex::default(); MOST_TERMS];
        let mut power = one;
        let mut count = 0;
        for (n, term) in terms.iter_mut().enumerate() {
            *term = power * (one - end) / first;
            count = n + 1;
            power *= Complex::new(0.0, phase / (n + 1) as f64);
            end *= shrunk;
            if power.norm_sqr() < LEAST_TERM * LEAST_TERM {
                break;
            }
        }
        Some(Self {
            damped_hz,
            gamma_hz,
            terms,
            count,
        })
    }

    /// Real and imaginary parts at some frequencies.
    #[inline(always)]
    pub fn at_each<const N: usize>(&self, f: &[f64; N]) -> [[f64; N]; 2] {
        let (mut re, mut im) = ([0.0; N], [0.0; N]);
        for (n, term) in self.terms[..self.count].iter().enumerate() {
            let width = self.gamma_hz * (n + 1) as f64;
            for l in 0..N {
                let detuning = f[l] - self.damped_hz;
                let scale = self.gamma_hz / (width * width + detuning * detuning);
                re[l] += scale * (term.re * width + term.im * detuning);
                im[l] += scale * (term.im * width - term.re * detuning);
            }
        }
        for l in 0..N {
            // The negative-frequency pole of a displacement.
            let image = 2.0 * self.damped_hz / (f[l] + self.damped_hz);
            re[l] *= image;
            im[l] *= image;
        }
        [re, im]
    }

    /// The transient at one frequency.
    pub fn at(&self, f: f64) -> Complex<f64> {
        let [[re], [im]] = self.at_each(&[f]);
        Complex::new(re, im)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the sum over the samples of the decay itself, so fine that it is the integral: the trapezoidal rule's error
    /// is its step squared, 1e-7 here.
    #[test]
    fn it_is_the_transform_of_such_a_decay() {
        let (f, zeta, duration_s) = (5.0, 0.002, 20.0);
        let damped = f * (1.0f64 - zeta * zeta).sqrt();
        for softening in [0.0, 3e-4, 2e-3, -5e-3] {
            let softened = Softened::new(f, zeta, softening, duration_s).unwrap();
            let steps = 200_000;
            let dt = duration_s / steps as f64;
            let transform = |at: f64| -> Complex<f64> {
                let sum: Complex<f64> = (0..=steps)
                    .map(|i| {
                        let t = i as f64 * dt;
                        let fallen = 1.0 - (-TAU * zeta * f * t).exp();
                        let angle = TAU * (damped - at) * t - softening / zeta * fallen;
                        let weight = if i == 0 || i == steps { 0.5 } else { 1.0 };
                        Complex::from_polar(weight * (-TAU * zeta * f * t).exp(), angle)
                    })
                    .sum();
                sum * dt
            };
            let reference = transform(5.0);
            let image = |at: f64| 2.0 * damped / (at + damped);
            for k in 80..=120 {
                let at = f64::from(k) / duration_s;
                let expected = transform(at) / reference * (image(at) / image(5.0));
                let found = softened.at(at) / softened.at(5.0);
                assert!(
                    (found - expected).norm() < 1e-5 * expected.norm().max(0.01),
                    "{softening} {k}: {found} {expected}"
                );
            }
        }
    }
}
