//! Tests of the view of a record.

use super::*;
use crate::numerics::random;
use rand_distr::{Distribution, Normal};

#[test]
fn densities_have_the_moments_of_what_they_show() {
    let prior = Prior::TruncatedNormal {
        mean: 800e3,
        sd: 160e3,
    };
    let normal = Normal::new(600e3, 60e3).unwrap();
    let mut generator = random::stream(3, 0);
    let values: Vec<f64> = (0..10_000).map(|_| normal.sample(&mut generator)).collect();
    let weights = vec![1e-4; values.len()];
    let shown = of_quantity("axial_force_n", &prior, values.iter().copied(), &weights);
    let moments = |density: &[f64]| {
        let step = (shown.high - shown.low) / (density.len() - 1) as f64;
        let total: f64 = density.iter().sum();
        let x = |i: usize| shown.low + i as f64 * step;
        let mean: f64 = density.iter().enumerate().map(|(i, d)| d * x(i)).sum::<f64>() / total;
        let square: f64 = density
            .iter()
            .enumerate()
            .map(|(i, d)| d * (x(i) - mean).powi(2))
            .sum::<f64>();
        (mean, (square / total).sqrt())
    };
    // Sampling error of the mean 600; the kernel widens the standard deviation by a hundredth.
    let (mean, sd) = moments(&shown.posterior);
    assert!(
        (mean - 600e3).abs() < 3e3 && (sd - 60e3).abs() < 3e3,
        "{mean} {sd}"
    );
    assert!((shown.posterior_mean_sd.0 - 600e3).abs() < 3e3);
    // Cut at 3.5 standard deviations.
    let (mean, sd) = moments(&shown.prior);
    assert!(
        (mean - 800e3).abs() < 1e3 && (sd - 160e3).abs() < 2e3,
        "{mean} {sd}"
    );
}

#[test]
fn a_long_spectrum_keeps_its_peaks() {
    let mut psd = vec![1e-12; 20_001];
    psd[7_777] = 1e-6;
    let curve = Curve::of(
        &Spectrum {
            df_hz: 0.001,
            psd,
            segments: 4,
        },
        15.0,
    );
    assert!(curve.level_db.len() <= SPECTRUM_POINTS && curve.level_db.len() > SPECTRUM_POINTS / 2);
    let (i, level) = curve
        .level_db
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(b.1))
        .unwrap();
    assert_eq!(*level, -60.0);
    assert!((curve.frequency_hz(i) - 7.777).abs() <= 0.5 * curve.step_hz);
}

#[test]
fn an_empty_or_silent_spectrum_is_no_trouble() {
    let empty = Curve::of(
        &Spectrum {
            df_hz: 0.1,
            psd: vec![],
            segments: 0,
        },
        10.0,
    );
    assert!(empty.level_db.is_empty());
    let silent = Curve::of(
        &Spectrum {
            df_hz: 0.1,
            psd: vec![0.0; 10],
            segments: 1,
        },
        10.0,
    );
    assert!(silent.level_db.iter().all(|&level| level == SILENCE_DB));
}
