//! One resonance as a time series: its narrow band of Fourier coefficients brought back to the time domain.
//!
//! With `M` neighbouring lines of a record of length `T` the rate is `B = M / T` and
//!
//! ```text
//! y_m = rho y_(m-1) + u_m,    rho = exp((s - 2 pi i f_0) / B)
//! ```
//!
//! where the pole `s` is the mode's and `f_0` the first line. Each coefficient is weighted by
//! `X / (1 - e^-X)`, `X = (2 pi i f_k - s) / B`, which turns the response of the continuous oscillator into that
//! of the recursion, and by `(f_k + f) / (2 f)` for its negative-frequency pole. Then the `u_m` of a mode
//! under white force are independent, and a pull, a blow or a gust shows in them at its own time.
//! Whatever is flat across the band (the record's ends, leakage) is an impulse at `m = 0`.

use super::band::Coefficients;
use crate::signal::spectrum::{Transforms, fast_length};
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Fewest samples of a usable series.
pub const LEAST_SAMPLES: usize = 12;

/// A pole: undamped frequency and damping ratio.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pole {
    /// Natural frequency \[Hz\].
    pub frequency_hz: f64,
    /// Damping ratio \[-\].
    pub damping: f64,
}

impl Pole {
    /// `s = 2 pi (-zeta f + i f_d)`.
    fn complex(self) -> Complex<f64> {
        let damped = self.frequency_hz * (1.0 - self.damping * self.damping).max(0.0).sqrt();
        Complex::new(-TAU * self.damping * self.frequency_hz, TAU * damped)
    }
}

/// A band of a record as a series in time.
#[derive(Debug, Clone)]
pub struct Subband {
    /// Samples per second, `B` \[Hz\].
    pub rate_hz: f64,
    /// Frequency of the first line \[Hz\], which is at rest in the series.
    pub first_hz: f64,
    /// The series; the mean of `|y|^2` is the mean periodogram ordinate.
    pub samples: Vec<Complex<f64>>,
}

impl Subband {
    /// Series of the lines between two frequencies, weighted for `pole`; `rest` is subtracted: the part at a
    /// frequency that does not belong to the resonance. `gain` of a frequency and the weight's square is a further factor. `None` if
    /// too few lines remain.
    pub fn of(
        transforms: &Transforms,
        coefficients: &Coefficients,
        (low_hz, high_hz): (f64, f64),
        pole: Pole,
        rest: impl Fn(f64) -> Complex<f64>,
        gain: impl Fn(f64, f64) -> f64,
    ) -> Option<Self> {
        let duration_s = coefficients.duration_s;
        let first = (low_hz * duration_s).ceil().max(1.0) as usize;
        let end = ((high_hz * duration_s).floor().max(0.0) as usize + 1)
            .min(coefficients.lines.len().saturating_sub(1));
        let count = fast_length(end.saturating_sub(first));
        if count < LEAST_SAMPLES {
            return None;
        }
        // A length the transform is fast at, about the pole.
        let spare = (end - first) - count;
        let centre = pole.frequency_hz * duration_s - 0.5 * count as f64;
        let first = (centre.round().max(0.0) as usize).clamp(first, first + spare);
        let rate_hz = count as f64 / duration_s;
        let s = pole.complex();
        let scale = 1.0 / (count as f64).sqrt();
        let mut samples: Vec<Complex<f64>> = coefficients.lines[first..first + count]
            .iter()
            .zip(first..)
            .map(|(&value, k)| {
                let f = k as f64 / duration_s;
                let x = (Complex::new(0.0, TAU * f) - s) / rate_hz;
                let image = (f + pole.frequency_hz) / (2.0 * pole.frequency_hz);
                let weight = x / (Complex::new(1.0, 0.0) - (-x).exp()) * image;
                (value - rest(f)) * weight * (scale * gain(f, weight.norm_sqr()))
            })
            .collect();
        transforms.back(&mut samples);
        Some(Self {
            rate_hz,
            first_hz: first as f64 / duration_s,
            samples,
        })
    }

    /// Factor `rho` of the recursion from one sample to the next.
    pub fn factor(&self, pole: Pole) -> Complex<f64> {
        ((pole.complex() - Complex::new(0.0, TAU * self.first_hz)) / self.rate_hz).exp()
    }

    /// Pole of the recursion by least squares, independent of the first sample.
    pub fn least_squares(&self) -> Option<Pole> {
        let (mut cross, mut power) = (Complex::new(0.0, 0.0), 0.0);
        for pair in self.samples.windows(2).skip(1) {
            cross += pair[1] * pair[0].conj();
            power += pair[0].norm_sqr();
        }
        let factor = cross / power;
        let radius = factor.norm();
        if !(radius > 0.0 && radius < 1.0) {
            return None;
        }
        // The angle is that of a frequency within the band, 0 to B above its first line.
        let turn = (factor.arg() / TAU).rem_euclid(1.0);
        let frequency_hz = self.first_hz + turn * self.rate_hz;
        Some(Pole {
            frequency_hz,
            damping: (-radius.ln() * self.rate_hz / (TAU * frequency_hz)).clamp(1e-5, 0.2),
        })
    }

    /// Power at the beginning over that which innovations of the same mean power would sustain: exponential
    /// with mean 1 for a stationary response, large for a decay that begins with the record.
    pub fn start_excess(&self) -> Option<f64> {
        let pole = self.least_squares()?;
        let factor = self.factor(pole);
        let innovation = self
            .samples
            .windows(2)
            .skip(1)
            .map(|pair| (pair[1] - factor * pair[0]).norm_sqr())
            .sum::<f64>()
            / (self.samples.len() - 2) as f64;
        // The first sample also holds whatever is flat across the band.
        Some(self.samples[1].norm_sqr() * (1.0 - factor.norm_sqr()) / innovation)
    }

    /// `<|y|^4> / <|y|^2>^2` of the resonance without the noise beside it: 1 for a steady tone, 2 for many
    /// independent fluctuations. Where the resonance has little new energy, the innovations' power is twice
    /// the noise's.
    pub fn unevenness(&self, pole: Pole) -> f64 {
        let factor = self.factor(pole);
        let inner = &self.samples[1..self.samples.len() - 1];
        let count = inner.len() as f64;
        let power = inner.iter().map(Complex::norm_sqr).sum::<f64>() / count;
        let innovation = inner
            .windows(2)
            .map(|pair| (pair[1] - factor * pair[0]).norm_sqr());
        let noise = innovation.sum::<f64>() / (count - 1.0) / (1.0 + factor.norm_sqr());
        let steady = power - noise;
        if steady < 0.5 * power {
            // Too little is above the noise to show that the power is even.
            return 2.0;
        }
        let noisy = (4.0 * steady * noise + 2.0 * noise * noise) / (power * power);
        (kurtosis(inner.iter().map(Complex::norm_sqr)) - noisy) * (power / steady).powi(2)
    }
}

/// `n sum p^2 / (sum p)^2` of powers.
pub fn kurtosis(powers: impl Iterator<Item = f64>) -> f64 {
    let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for p in powers {
        count += 1.0;
        sum += p;
        squares += p * p;
    }
    count * squares / (sum * sum)
}
