//! Welch's density and the peak picking against scipy, the textbook transform and closed forms.

// Machinery of tests and benches: a panic is the report.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{PI, TAU};
use tirante::analysis::numerics::random;
use tirante::analysis::signal::spectrum::{
    PeakSettings, Spectrum, Welch, WelchError, WelchSettings, Window, find_peaks, pick_peaks,
};

/// The samples of the scipy fixtures: a linear congruential generator, a trend and a sine.
fn fixture_samples() -> Vec<f64> {
    let mut state = 12_345u64;
    (0..600)
        .map(|i| {
            state = (state * 1_103_515_245 + 12_345) % (1 << 31);
            let t = f64::from(i);
            state as f64 / (1u64 << 31) as f64 - 0.5 + 0.002 * t + 0.3 * (0.7 * t).sin()
        })
        .collect()
}

fn window(name: &str) -> Window {
    match name {
        "Hann" => Window::Hann,
        "Hamming" => Window::Hamming,
        "Blackman" => Window::Blackman,
        _ => Window::Rectangular,
    }
}

#[test]
fn agrees_with_scipy_to_rounding() {
    let x = fixture_samples();
    for row in include_str!("../fixtures/welch_scipy.txt").lines().skip(1) {
        let fields: Vec<&str> = row.split(' ').collect();
        let (n, overlap): (usize, usize) = (fields[1].parse().unwrap(), fields[2].parse().unwrap());
        let spectrum = Welch::plan(50.0, n, overlap, window(fields[0]))
            .unwrap()
            .run(&x)
            .unwrap();
        let largest = spectrum.psd.iter().fold(0.0f64, |a, &b| a.max(b));
        assert_eq!(spectrum.psd.len(), n / 2 + 1);
        for (k, text) in fields[3..].iter().enumerate() {
            let scipy: f64 = text.parse().unwrap();
            // Rounding of a transform of 128 points: a few ulp of the largest line.
            assert!(
                (spectrum.psd[4 * k] - scipy).abs() < 1e-14 * largest + 1e-12 * scipy,
                "{row:.20} line {}",
                4 * k
            );
        }
    }
}

/// The definition, with no fast transform: one segment at a time, each less its straight line.
fn textbook(x: &[f64], fs: f64, n: usize, overlap: usize, window: Window) -> Vec<f64> {
    let w = window.weights(n);
    let power: f64 = w.iter().map(|w| w * w).sum();
    let segments: Vec<&[f64]> = x.windows(n).step_by(n - overlap).collect();
    (0..=n / 2)
        .map(|k| {
            let total: f64 = segments
                .iter()
                .map(|segment| {
                    let t = |j: usize| j as f64 - 0.5 * (n as f64 - 1.0);
                    let mean = segment.iter().sum::<f64>() / n as f64;
                    let bend: f64 = (0..n).map(|j| t(j) * t(j)).sum();
                    let slope = (0..n).map(|j| t(j) * segment[j]).sum::<f64>() / bend;
                    let (mut re, mut im) = (0.0, 0.0);
                    for j in 0..n {
                        let value = (segment[j] - mean - slope * t(j)) * w[j];
                        let angle = TAU * (j * k % n) as f64 / n as f64;
                        re += value * angle.cos();
                        im -= value * angle.sin();
                    }
                    re * re + im * im
                })
                .sum();
            let sides = if k == 0 || 2 * k == n { 1.0 } else { 2.0 };
            sides * total / (fs * power * segments.len() as f64)
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn agrees_with_the_textbook(seed in 0u64..1000, n in 2usize..70, share in 0.0f64..0.95, kind in 0usize..4) {
        let mut rng = random::stream(seed, 1);
        let x: Vec<f64> = (0..200).map(|_| StandardNormal.sample(&mut rng)).collect();
        let window = [Window::Hann, Window::Hamming, Window::Blackman, Window::Rectangular][kind];
        let overlap = ((share * n as f64) as usize).min(n - 1);
        let fast = Welch::plan(10.0, n, overlap, window).unwrap().run(&x).unwrap();
        let slow = textbook(&x, 10.0, n, overlap, window);
        for (a, b) in fast.psd.iter().zip(&slow) {
            prop_assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
    }
}

#[test]
fn white_noise_has_its_level_and_its_power() {
    let mut rng = random::stream(1, 0);
    let x: Vec<f64> = (0..200_000).map(|_| StandardNormal.sample(&mut rng)).collect();
    let spectrum = Welch::plan(200.0, 1000, 500, Window::Hann)
        .unwrap()
        .run(&x)
        .unwrap();
    let inner = &spectrum.psd[5..496];
    let mean = inner.iter().sum::<f64>() / inner.len() as f64;
    // One-sided level 2 sigma^2 / fs; 200 000 samples: 0.3 % standard error.
    assert!((mean / 0.01 - 1.0).abs() < 0.012, "{mean}");
    // Parseval: the density integrates to the variance; the straight lines take 2 of 1000.
    let variance = x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64;
    let integral: f64 = spectrum.psd.iter().sum::<f64>() * spectrum.df_hz;
    assert!((integral / variance - 1.0).abs() < 0.01);
    // One untapered segment less its line: exactly its own mean square.
    let part = &x[..1000];
    let one = Welch::plan(200.0, 1000, 0, Window::Rectangular)
        .unwrap()
        .run(part)
        .unwrap();
    let (mean, slope) = tirante::analysis::signal::spectrum::window::line(part);
    let residual: f64 = part
        .iter()
        .enumerate()
        .map(|(i, x)| (x - mean - slope * (i as f64 - 499.5)).powi(2))
        .sum::<f64>()
        / 1000.0;
    assert!((one.psd.iter().sum::<f64>() * one.df_hz / residual - 1.0).abs() < 1e-12);
}

#[test]
fn a_sine_on_a_line_has_half_its_squared_amplitude() {
    let x: Vec<f64> = (0..4000)
        .map(|i| 3.0 * (TAU * 10.0 * f64::from(i) / 200.0).sin())
        .collect();
    let spectrum = Welch::plan(200.0, 400, 200, Window::Hann)
        .unwrap()
        .run(&x)
        .unwrap();
    let power: f64 = spectrum.psd[17..=23].iter().sum::<f64>() * spectrum.df_hz;
    // The straight line through whole periods of a sine is not quite zero: 1e-3 of its power.
    assert!((power / 4.5 - 1.0).abs() < 2e-3, "{power}");
    // Peak of a Hann-tapered sine: A^2/2 over the equivalent noise bandwidth of 1.5 lines.
    assert!((spectrum.psd[20] / (4.5 / 0.75) - 1.0).abs() < 2e-3);
}

#[test]
fn impossible_plans_are_refused() {
    assert!(matches!(
        Welch::plan(0.0, 8, 0, Window::Hann),
        Err(WelchError::SampleRate { .. })
    ));
    assert!(matches!(
        Welch::plan(f64::NAN, 8, 0, Window::Hann),
        Err(WelchError::SampleRate { .. })
    ));
    assert!(matches!(
        Welch::plan(1.0, 1, 0, Window::Hann),
        Err(WelchError::Segment { .. })
    ));
    assert!(matches!(
        Welch::plan(1.0, 8, 8, Window::Hann),
        Err(WelchError::Segment { .. })
    ));
    let plan = Welch::plan(1.0, 8, 4, Window::Hann).unwrap();
    assert_eq!(
        plan.run(&[0.0; 7]),
        Err(WelchError::TooShort {
            samples: 7,
            nperseg: 8
        })
    );
}

#[test]
fn segments_suit_the_record() {
    let automatic = WelchSettings::default();
    for (seconds, low, high) in [
        (5.0, 4.8, 5.0),
        (20.0, 9.7, 10.0),
        (60.0, 9.7, 10.0),
        (600.0, 39.0, 40.0),
    ] {
        let n = automatic.nperseg(200.0, (seconds * 200.0) as usize);
        assert!((low..=high).contains(&(n as f64 / 200.0)), "{seconds} s: {n}");
    }
    let stated = WelchSettings {
        segment_s: Some(8.192),
        ..automatic
    };
    assert_eq!(stated.nperseg(2000.0, 1_000_000), 16_384);
    assert_eq!(stated.nperseg(2000.0, 100), 100);
    assert_eq!(automatic.nperseg(200.0, 0), 2);
}

#[test]
fn prominences_agree_with_scipy() {
    let y: Vec<f64> = fixture_samples()[..400]
        .iter()
        .enumerate()
        .map(|(i, x)| (10.0 * (x + (0.11 * i as f64).sin())).round_ties_even())
        .collect();
    let expected: Vec<(usize, f64)> = include_str!("../fixtures/peaks_scipy.txt")
        .lines()
        .skip(1)
        .map(|row| {
            let (index, prominence) = row.split_once(' ').unwrap();
            (index.parse().unwrap(), prominence.parse().unwrap())
        })
        .collect();
    assert!(expected.len() > 50);
    assert_eq!(find_peaks(&y), expected);
}

#[test]
fn peaks_stand_on_a_coloured_floor_and_noise_has_none() {
    let mut rng = random::stream(4, 0);
    let (df, n) = (0.05, 1000);
    let mut psd: Vec<f64> = (0..n)
        .map(|k| {
            let f = df * f64::from(k) + 0.1;
            // Average of eight segments over a floor that falls like 1/f^2.
            let scatter: f64 = (0..16)
                .map(|_| f64::powi(StandardNormal.sample(&mut rng), 2))
                .sum::<f64>()
                / 16.0;
            scatter / (f * f)
        })
        .collect();
    let settings = PeakSettings::default();
    let noise = Spectrum {
        df_hz: df,
        psd: psd.clone(),
        segments: 8,
    };
    assert_eq!(pick_peaks(&noise, &settings, 2.0, 48.0), []);
    for f0 in [4.5, 9.3, 13.25] {
        for (k, value) in psd.iter_mut().enumerate() {
            let off = (df * k as f64 - f0) / 0.03;
            *value += 100.0 / (f0 * f0) / (1.0 + off * off);
        }
    }
    let spectrum = Spectrum {
        df_hz: df,
        psd,
        segments: 8,
    };
    let peaks = pick_peaks(&spectrum, &settings, 2.0, 48.0);
    let found: Vec<f64> = peaks.iter().map(|p| p.frequency_hz).collect();
    assert_eq!(found.len(), 3, "{found:?}");
    for (f, f0) in found.iter().zip([4.5, 9.3, 13.25]) {
        assert!((f - f0).abs() < df, "{found:?}");
    }
    assert!((peaks[0].height_db - 20.0).abs() < 2.0, "{}", peaks[0].height_db);
    let fewer = PeakSettings {
        max_peaks: 2,
        ..settings
    };
    assert_eq!(pick_peaks(&spectrum, &fewer, 2.0, 48.0).len(), 2);
    assert_eq!(pick_peaks(&spectrum, &settings, 60.0, 50.0), []);
}

#[test]
fn plans_may_be_used_from_many_threads_with_the_same_bits() {
    let x: Vec<f64> = (0..50_000i32)
        .map(|i| (f64::from(i) * PI * 0.01).sin() + f64::from((i % 1013).pow(2) % 1013) * 1e-3)
        .collect();
    let plan = Welch::plan(100.0, 2048, 1024, Window::Hann).unwrap();
    let once = plan.run(&x).unwrap();
    std::thread::scope(|scope| {
        let runs: Vec<_> = (0..4).map(|_| scope.spawn(|| plan.run(&x).unwrap())).collect();
        for run in runs {
            assert_eq!(run.join().unwrap(), once);
        }
    });
}
