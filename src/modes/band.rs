//! The Fourier coefficients of a whole record, and a band of them around one peak.

use super::Mask;
use crate::spectrum::{Transforms, fast_length, welch::transform, window::line};
use realfft::num_complex::Complex;

/// The Fourier coefficients `J_k = dt / sqrt(T) sum_t x_t e^(-2 pi i k t / n)` of a record less its
/// straight line, without taper: `|J_k|^2` is the two-sided raw periodogram \[unit^2/Hz\].
#[derive(Debug, Clone)]
pub struct Coefficients {
    /// Length of the stretch transformed, T \[s\]; line `k` stands at `k / T`.
    pub duration_s: f64,
    /// The coefficients from 0 Hz to the Nyquist frequency.
    pub lines: Vec<Complex<f64>>,
}

impl Coefficients {
    /// Transforms the first samples of a record; at most 2.5 % at its end is left out, so that the
    /// length is one the transform is fast at.
    pub fn of(transforms: &Transforms, fs_hz: f64, samples: &[f64]) -> Self {
        let n = fast_length(samples.len());
        let samples = &samples[..n];
        let plan = transforms.plan(n);
        let mut input = plan.make_input_vec();
        let mut lines = plan.make_output_vec();
        let mut scratch = plan.make_scratch_vec();
        let (mean, slope) = line(samples);
        let middle = 0.5 * (n as f64 - 1.0);
        for (i, (slot, x)) in input.iter_mut().zip(samples).enumerate() {
            *slot = x - (mean + slope * (i as f64 - middle));
        }
        transform(&*plan, &mut input, &mut lines, &mut scratch);
        let duration_s = n as f64 / fs_hz;
        let scale = 1.0 / (fs_hz * duration_s.sqrt());
        for value in &mut lines {
            *value *= scale;
        }
        Self { duration_s, lines }
    }

    /// The band `low_hz` to `high_hz` without masked lines; abscissae relative to its middle.
    pub fn band(&self, low_hz: f64, high_hz: f64, masks: &[Mask]) -> Band {
        let n = self.lines.len();
        // Neither 0 Hz nor the Nyquist line: their coefficients are real.
        let first = (low_hz * self.duration_s).ceil().max(1.0) as usize;
        let end = ((high_hz * self.duration_s).floor().max(0.0) as usize + 1).min(n.saturating_sub(1));
        let middle = 0.5 * (low_hz + high_hz);
        let half = 0.5 * (high_hz - low_hz);
        let mut band = Band {
            duration_s: self.duration_s,
            middle_hz: middle,
            half_width_hz: half,
            ..Band::default()
        };
        for k in first..end {
            let f = k as f64 / self.duration_s;
            if masks.iter().any(|m| (m.low_hz..=m.high_hz).contains(&f)) {
                continue;
            }
            band.frequency_hz.push(f);
            band.x.push((f - middle) / half);
            band.re.push(self.lines[k].re);
            band.im.push(self.lines[k].im);
            band.floor.push(1.0);
        }
        band.largest = (0..band.len()).map(|i| band.power(i)).fold(0.0, f64::max);
        band
    }
}

/// The coefficients of one record in a narrow band, one entry a line.
#[derive(Debug, Clone, Default)]
pub struct Band {
    /// Length of the record, T \[s\].
    pub duration_s: f64,
    /// The band's middle \[Hz\].
    pub middle_hz: f64,
    /// Half its width \[Hz\].
    pub half_width_hz: f64,
    /// Frequencies \[Hz\].
    pub frequency_hz: Vec<f64>,
    /// Frequencies as -1 to 1 across the band.
    pub x: Vec<f64>,
    /// Real parts of the coefficients.
    pub re: Vec<f64>,
    /// Imaginary parts.
    pub im: Vec<f64>,
    /// Shape of the noise floor: 1, or more where the skirts of other modes lie.
    pub floor: Vec<f64>,
    /// Largest raw periodogram ordinate.
    pub largest: f64,
}

impl Band {
    /// How many lines.
    pub fn len(&self) -> usize {
        self.re.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.re.is_empty()
    }

    /// The noise floor as the quietest fifth of the ordinates suggests it: the lower quintile of an
    /// exponential distribution is 0.223 of its mean.
    pub fn quiet_level(&self) -> f64 {
        let mut powers: Vec<f64> = (0..self.len()).map(|i| self.power(i)).collect();
        let fifth = powers.len() / 5;
        if powers.is_empty() {
            return f64::MIN_POSITIVE;
        }
        let (_, value, _) = powers.select_nth_unstable_by(fifth, f64::total_cmp);
        (*value / 0.223).max(f64::MIN_POSITIVE)
    }

    /// Raw periodogram ordinate of entry `i`.
    pub fn power(&self, i: usize) -> f64 {
        self.re[i] * self.re[i] + self.im[i] * self.im[i]
    }
}
