//! The true scatter of a frequency where the level of the force moves: Godambe's correction from innovations.
//!
//! A likelihood that assumes an even force gives too small an error when most of the information came in a
//! few gusts. Its score is a sum of martingale differences, one per sample of the mode's [`Subband`],
//! whatever the level does; so the sum of their squares is the variance that the score really has, and its
//! ratio to the information is the factor by which the variance was underrated (the "sandwich"; Godambe 1960,
//! Jesus and Chandler 2016).

use super::subband::{LEAST_SAMPLES, Pole, Subband, kurtosis};
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Variance of the unknown first state, in units of the variance of the innovations.
const WIDE: f64 = 1e12;

/// Dispersion of a fit's innovations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dispersion {
    /// Factor on the frequency's standard error, at least 1.
    pub factor: f64,
    /// Goodness of fit: kurtosis of the normalised innovations as a standard normal deviate; large where
    /// the force came in gusts or blows.
    pub misfit: f64,
}

impl Dispersion {
    /// Result where no series is long enough to judge by: nothing is added.
    pub const UNKNOWN: Self = Self {
        factor: 1.0,
        misfit: 0.0,
    };
}

/// Runs the Kalman filter of the fitted mode over its series. `noise` is the noise floor (mean ordinate),
/// `ratio` the height of the peak over it.
pub fn dispersion(subband: &Subband, pole: Pole, noise: f64, ratio: f64) -> Option<Dispersion> {
    let y = &subband.samples;
    if y.len() < LEAST_SAMPLES {
        return None;
    }
    let rho = subband.factor(pole);
    let turn = Complex::new(0.0, TAU / subband.rate_hz);
    // Variance of an innovation: the force's spectral density over B squared.
    let width = TAU * pole.damping * pole.frequency_hz / subband.rate_hz;
    let q = (noise * ratio * width * width).max(1e-6 * noise);
    let r = noise / q;
    let scale = 1.0 / q.sqrt();
    let (mut x, mut dx, mut p) = (Complex::default(), Complex::default(), WIDE);
    let mut steps = Vec::with_capacity(y.len());
    for (m, y) in y.iter().enumerate() {
        if m > 0 {
            dx = rho * turn * x + rho * dx;
            x *= rho;
            p = rho.norm_sqr() * p + 1.0;
        } else {
            // The flat part of the band is an impulse here.
            continue;
        }
        let s = p + r;
        let e = y * scale - x;
        if m >= 2 {
            steps.push((e, -dx, s));
        }
        let gain = p / s;
        x += e * gain;
        dx -= dx * gain;
        p *= r / s;
    }
    let count = steps.len() as f64;
    let variance = steps.iter().map(|(e, _, s)| e.norm_sqr() / s).sum::<f64>() / count;
    let scores: Vec<(f64, f64)> = steps
        .iter()
        .map(|(e, de, s)| {
            let weight = 2.0 / (s * variance);
            (weight * (e.conj() * de).re, weight * de.norm_sqr())
        })
        .collect();
    let information: f64 = scores.iter().map(|s| s.1).sum();
    let mean = scores.iter().map(|s| s.0).sum::<f64>() / information;
    let (mut squares, mut fourths) = (0.0, 0.0);
    for (score, weight) in &scores {
        let s = (score - weight * mean).powi(2);
        squares += s;
        fourths += s * s;
    }
    let kappa = (squares / information).sqrt();
    // Few large terms: the variance found is itself that of a chi-square with so many degrees of freedom, and
    // the 95 % point of Student's t over the normal's is 1 + 1.21 / nu to first order. Even scores of the same
    // information would have `even` of them, which the fit's own error allows for.
    let weights: f64 = scores.iter().map(|s| s.1 * s.1).sum();
    let even = (2.0 / 3.0 * information * information / weights).max(3.0);
    let freedom = (2.0 * squares * squares / fourths).max(3.0);
    let full = (kappa * (1.0 + 1.21 / freedom) / (1.0 + 1.21 / even)).max(1.0);
    let misfit = (kurtosis(steps.iter().map(|(e, _, s)| e.norm_sqr() / s)) - 2.0) * count.sqrt() / 2.0;
    // Without a sign of gusts the scatter of `kappa` itself would only add noise to the error.
    let factor = 1.0 + (full - 1.0) * misfit.clamp(0.0, 1.0);
    (factor.is_finite() && misfit.is_finite()).then_some(Dispersion { factor, misfit })
}
