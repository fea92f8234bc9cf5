//! A record's samples as the columns of a drawing: the lowest and the highest of each stretch.

use serde::{Deserialize, Serialize};

/// Most columns.
const COLUMNS: usize = 600;

/// Lowest and highest sample of even stretches of a record, about its mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Envelope {
    /// Length of a stretch \[s\]; the last may be shorter.
    pub step_s: f64,
    /// The lowest sample of each stretch less the record's mean, SI of the samples' unit, to four digits of the largest.
    pub low: Vec<f64>,
    /// The highest sample of each stretch, in the same way.
    pub high: Vec<f64>,
}

impl Envelope {
    /// Envelope of evenly spaced samples, at least one per stretch. Samples that are not finite are left out,
    /// and a stretch of nothing else lies at the mean.
    pub fn of(samples: &[f64], fs_hz: f64) -> Self {
        let finite = || samples.iter().copied().filter(|x| x.is_finite());
        let mean = finite().sum::<f64>() / finite().count().max(1) as f64;
        let largest = finite().fold(0.0_f64, |largest, x| largest.max((x - mean).abs()));
        let rounded = digits_of(largest);
        let stretch = samples.len().div_ceil(COLUMNS).max(1);
        let about_mean = |x: Option<f64>| rounded(x.unwrap_or(mean) - mean);
        Self {
            step_s: stretch as f64 / fs_hz,
            low: extremes(samples, stretch, f64::min).map(about_mean).collect(),
            high: extremes(samples, stretch, f64::max).map(about_mean).collect(),
        }
    }
}

/// Lowest or highest of the finite samples of each stretch, by `of`.
fn extremes(
    samples: &[f64],
    stretch: usize,
    of: impl Fn(f64, f64) -> f64,
) -> impl Iterator<Item = Option<f64>> {
    let chunks = samples.chunks(stretch);
    chunks.map(move |chunk| chunk.iter().copied().filter(|x| x.is_finite()).reduce(&of))
}

/// Rounds to a ten-thousandth of the decade of `largest`.
fn digits_of(largest: f64) -> impl Fn(f64) -> f64 {
    let decimals = if largest > 0.0 {
        4.0 - libm::floor(libm::log10(largest))
    } else {
        0.0
    };
    // An exact power of ten keeps printed numbers short.
    let scale = libm::pow(10.0, decimals.abs());
    move |value| {
        if decimals >= 0.0 {
            (value * scale).round() / scale
        } else {
            (value / scale).round() * scale
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sample_lies_within() {
        let samples: Vec<f64> = (0..12_345)
            .map(|i| 3.0 + 2e-6 * (f64::from(i) * 0.37).sin())
            .collect();
        let envelope = Envelope::of(&samples, 200.0);
        let stretch = (envelope.step_s * 200.0).round() as usize;
        assert_eq!(envelope.low.len(), samples.len().div_ceil(stretch));
        assert!(envelope.low.len() <= COLUMNS && envelope.low.len() > COLUMNS / 2);
        let mean = samples.iter().sum::<f64>() / samples.len() as f64;
        for (i, x) in samples.iter().enumerate() {
            let (low, high) = (envelope.low[i / stretch], envelope.high[i / stretch]);
            // Half a unit of the last digit kept: a ten-thousandth of 1e-6.
            assert!(
                low - 6e-11 <= x - mean && x - mean <= high + 6e-11,
                "{i}: {low} {x} {high}"
            );
        }
        let most = envelope.high.iter().fold(0.0_f64, |a, b| a.max(*b));
        assert!((most - 2e-6).abs() < 1e-8, "{most}");
        assert!(serde_json::to_string(&envelope).unwrap().len() < 1200 * 14);
    }

    #[test]
    fn few_silent_or_no_samples_are_no_trouble() {
        assert_eq!(Envelope::of(&[], 100.0).low, Vec::<f64>::new());
        let silent = Envelope::of(&[5.0; 3], 100.0);
        assert_eq!((silent.low, silent.high), (vec![0.0; 3], vec![0.0; 3]));
        assert_eq!(Envelope::of(&[1.0, -1.0], 50.0).high, [1.0, -1.0]);
        let holed = Envelope::of(&[1.0, f64::NAN, -1.0, f64::INFINITY], 50.0);
        assert_eq!(holed.high, [1.0, 0.0, -1.0, 0.0]);
    }
}
