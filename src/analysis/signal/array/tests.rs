//! Tests of an array: ratios with their errors, sensors that cannot be compared, the combination of records.

use super::*;
use crate::numerics::random;
use crate::signal::record::{RodId, Timestamp};
use rand_distr::{Distribution, StandardNormal};

const MODES: [(f64, f64, f64); 3] = [(4.5, 1.0, 0.6), (9.3, 0.5, -0.8), (13.9, 0.3, 0.25)];

/// Decays of three modes with amplitudes at two sensors, in noise.
fn decays(seed: u64, noise: f64) -> [Record; 2] {
    let mut generator = random::stream(seed, 0);
    let phases: Vec<f64> = (0..3).map(|n| 0.7 * n as f64 + seed as f64).collect();
    [0, 1].map(|sensor| {
        let samples = (0..12_000)
            .map(|i| {
                let t = f64::from(i) / 200.0;
                let z: f64 = StandardNormal.sample(&mut generator);
                let motion = MODES.iter().zip(&phases).map(|((f, amplitude, ratio), phase)| {
                    let w = 2.0 * PI * f;
                    let seen = if sensor == 0 { 1.0 } else { *ratio };
                    seen * amplitude * libm::exp(-0.002 * w * t) * libm::sin(w * t + phase)
                });
                motion.sum::<f64>() + noise * z
            })
            .collect();
        Record {
            rod: RodId("a".to_owned()),
            start: Timestamp::from_nanos(0),
            fs_hz: 200.0,
            samples,
            temperature_c: None,
            readings: Vec::new(),
            excitation: None,
            clock_sd: 0.0,
            flags: Vec::new(),
        }
    })
}

/// Pulls of modes at multiples of `f1` Hz, the lower the stronger, with amplitudes at sensors; `phase` in degrees turns all but
/// the first.
fn pulls(
    (f1, duration_s, damping): (f64, f64, f64),
    amplitudes: &[[f64; 3]],
    (noise, phase): (f64, f64),
    seed: u64,
) -> Vec<Record> {
    let mut generator = random::stream(seed, 1);
    let [first, _] = decays(seed, 0.0);
    amplitudes
        .iter()
        .enumerate()
        .map(|(sensor, seen)| {
            let turned = if sensor == 0 { 0.0 } else { phase.to_radians() };
            let samples = (0..(200.0 * duration_s) as usize)
                .map(|i| {
                    let t = i as f64 / 200.0;
                    let z: f64 = StandardNormal.sample(&mut generator);
                    let motion = seen
                        .iter()
                        .zip([1.0, 0.5, 0.3])
                        .enumerate()
                        .map(|(k, (seen, a))| {
                            let w = 2.0 * PI * f1 * (k + 1) as f64;
                            let phase = seed as f64 + 0.7 * k as f64 + turned;
                            seen * a * libm::exp(-damping * w * t) * libm::sin(w * t + phase)
                        });
                    motion.sum::<f64>() + noise * z
                })
                .collect();
            Record {
                samples,
                ..first.clone()
            }
        })
        .collect()
}

/// Mode of such pulls.
fn multiple(order: usize, (f1, _, damping): (f64, f64, f64)) -> Mode {
    Mode {
        order,
        frequency_hz: f1 * order as f64,
        sd_hz: 1e-3,
        damping: Some(damping),
    }
}

#[test]
fn neighbouring_modes_are_not_taken_for_noise() {
    // Bands that a short record or much damping make as wide as modes are apart.
    for how in [(1.5, 20.0, 0.003), (4.5, 600.0, 0.012)] {
        let wanted = [0.6, 0.8, -0.6];
        let mut scores = Vec::new();
        for seed in 0..20 {
            let records = pulls(how, &[[1.0; 3], wanted], (0.01, 0.0), seed);
            let (array, _) = Array::new(&[(&records[0], 0), (&records[1], 0)]);
            for (order, wanted) in (1..).zip(wanted) {
                let ratio = array.sight(&multiple(order, how)).unwrap().unwrap().ratios[0];
                // A tenth of a percent of noise at each end of a ratio, and twice the standard error that none falls below.
                assert!(
                    (ratio.value / wanted - 1.0).abs() < 0.06,
                    "{how:?} seed {seed} mode {order}: {ratio:?}"
                );
                scores.push(((ratio.value - wanted) / ratio.sd).powi(2));
            }
        }
        let square = scores.iter().sum::<f64>() / scores.len() as f64;
        assert!(square < 1.5, "{how:?}: {square}");
    }
}

#[test]
fn a_phase_is_seen_in_a_short_record_too() {
    // Forty windows: what is out of phase, counted as noise, was thought to explain itself.
    let how = (4.5, 10.0, 0.003);
    for phase in [65.0, 89.0, 130.0] {
        let records = pulls(how, &[[1.0; 3], [0.6, 0.8, -0.6]], (0.01, phase), 1);
        let (array, _) = Array::new(&[(&records[0], 0), (&records[1], 0)]);
        let (sensor, why) = array.sight(&multiple(1, how)).unwrap_err();
        assert_eq!(sensor, 1);
        let Unsynchronised::Phase { degrees, .. } = why else {
            panic!("{why}")
        };
        assert!((degrees - phase).abs() < 5.0, "{degrees} {phase}");
    }
    // Five degrees, a filter's: within the limits, and the amplitude is not the worse for it.
    let records = pulls(how, &[[1.0; 3], [0.6, 0.8, -0.6]], (0.01, 5.0), 1);
    let (array, _) = Array::new(&[(&records[0], 0), (&records[1], 0)]);
    let ratio = array.sight(&multiple(1, how)).unwrap().unwrap().ratios[0];
    assert!((ratio.value - 0.6).abs() < 3.0 * ratio.sd, "{ratio:?}");
}

#[test]
fn the_lead_is_never_the_one_out_of_phase() {
    // The lead near a node of mode 2: the other is what it is compared with, and what has to go.
    let how = (4.5, 60.0, 0.003);
    let mut refused = 0;
    for seed in 0..20 {
        let records = pulls(how, &[[1.0, 0.2, 1.0], [0.6, 5.0, -0.6]], (0.3, 90.0), seed);
        let (array, _) = Array::new(&[(&records[0], 0), (&records[1], 0)]);
        // Some are not clear enough to tell.
        if let Err((sensor, why)) = array.sight(&multiple(2, how)) {
            assert_eq!(sensor, 1, "{why}");
            let Unsynchronised::Phase { degrees, .. } = why else {
                panic!("{why}")
            };
            assert!((degrees - 90.0).abs() < 45.0, "{why}");
            refused += 1;
        }
    }
    // About four standard errors, which is the limit: some are above it.
    assert!(refused >= 3, "{refused}");
}

#[test]
fn ratios_over_one_reference_are_worth_no_more_than_they_are() {
    // The mean of three equal ratios over one noisy reference: its error is the reference's, whatever their number.
    let how = (4.5, 60.0, 0.003);
    let (mut square, mut told, mut runs) = (0.0, 0.0, 0.0);
    for seed in 0..40 {
        let mut records = pulls(how, &[[1.0; 3]; 4], (0.01, 0.0), seed);
        let [noisy] = &pulls(how, &[[1.0; 3]], (0.3, 0.0), seed)[..] else {
            panic!()
        };
        records[0] = noisy.clone();
        let all: Vec<(&Record, i32)> = records.iter().map(|record| (record, 0)).collect();
        let (array, _) = Array::new(&all);
        let ratios = array.sight(&multiple(1, how)).unwrap().unwrap().ratios;
        assert_eq!(ratios.len(), 3);
        let precision: f64 = ratios.iter().map(|ratio| ratio.sd.powi(-2)).sum();
        let mean: f64 = ratios
            .iter()
            .map(|ratio| ratio.value * ratio.sd.powi(-2))
            .sum::<f64>()
            / precision;
        square += (mean - 1.0).powi(2);
        told += 1.0 / precision;
        runs += 1.0;
    }
    // Forty runs: 1 +- 0.22 if the variance told is right; 3 where they count as independent.
    assert!(square / told < 1.9, "{} runs: {}", runs, square / told);
}

fn mode(order: usize) -> Mode {
    Mode {
        order,
        frequency_hz: MODES[order - 1].0,
        sd_hz: 1e-3,
        damping: Some(0.002),
    }
}

#[test]
fn ratios_have_their_sign_and_standard_error() {
    let mut scores = Vec::new();
    for seed in 0..40 {
        let [a, b] = decays(seed, 0.1);
        let (array, refused) = Array::new(&[(&a, 0), (&b, 0)]);
        assert!(refused.is_empty());
        for order in 1..=3 {
            let sight = array.sight(&mode(order)).unwrap().unwrap();
            let ratio = sight.ratios[0];
            assert_eq!((ratio.sensor, ratio.reference), (1, 0));
            scores.push((ratio.value - MODES[order - 1].2) / ratio.sd);
        }
    }
    let count = scores.len() as f64;
    let mean = scores.iter().sum::<f64>() / count;
    let square = scores.iter().map(|z| z * z).sum::<f64>() / count;
    // 120 scores: mean 0 +- 0.09, mean square 1 +- 0.13; four standard errors.
    assert!(mean.abs() < 0.37, "{mean}");
    assert!((0.5..1.5).contains(&square), "{square}");
}

#[test]
fn another_rate_time_or_clock_is_refused() {
    let [a, b] = decays(1, 0.05);
    let rate = Record {
        fs_hz: 250.0,
        ..b.clone()
    };
    let late = Record {
        start: Timestamp::from_nanos(40_000_000_000),
        ..b.clone()
    };
    let (array, refused) = Array::new(&[(&a, 0), (&rate, 0), (&late, 0)]);
    assert_eq!(array.len(), 1);
    assert!(
        matches!(refused[0], (1, Unsynchronised::Rate { .. })),
        "{refused:?}"
    );
    assert!(
        matches!(refused[1], (2, Unsynchronised::Apart { .. })),
        "{refused:?}"
    );
    // Stamps that are wrong by 30 ms: 49 degrees of the first mode.
    let skewed = Record {
        start: Timestamp::from_nanos(30_000_000),
        ..b.clone()
    };
    let (array, refused) = Array::new(&[(&a, 0), (&skewed, 0)]);
    assert!(refused.is_empty());
    let (sensor, why) = array.sight(&mode(1)).unwrap_err();
    assert_eq!(sensor, 1);
    assert!(why.to_string().contains("degrees out of phase"), "{why}");
    // A start between two samples is no such fault.
    let between = Record {
        start: Timestamp::from_nanos(2_000_000),
        ..b
    };
    let (array, _) = Array::new(&[(&a, 0), (&between, 0)]);
    assert!(array.sensors[1].delay_s > 0.0019);
}

#[test]
fn the_combination_sees_a_mode_better_than_either_sensor() {
    let [a, b] = decays(3, 0.3);
    let (array, _) = Array::new(&[(&a, 0), (&b, 0)]);
    let sight = array.sight(&mode(2)).unwrap().unwrap();
    let both = array.combined(&a, &sight.weights);
    let clarity = |record: &Record| {
        let (alone, _) = Array::new(&[(record, 0)]);
        View::of(&alone.sensors[0], 200.0, 9.3, 0.12).clarity()
    };
    // Signal over noise of equal noise adds: 1 + 0.8^2 of the first alone, to the noise's own scatter.
    let gain = clarity(&both) / clarity(&a);
    assert!((1.3..2.1).contains(&gain), "{gain}");
}
