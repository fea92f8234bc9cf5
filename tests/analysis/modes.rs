//! Natural frequencies and their standard errors against simulated records whose truth is known.

// Machinery of tests and benches: a panic is the report.
#![allow(clippy::unwrap_used)]

use crate::labels::{self, CLASSES, Class, Knowledge};
use crate::simulator::scene::{Hum, Pull, Scene};
use crate::simulator::{SimulatedMode, ambient_sd, normal, simulate};
use rand::RngExt;
use rayon::prelude::*;
use rustfft::num_complex::Complex;
use std::f64::consts::PI;
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::{Parameterisation, Section};
use tirante::analysis::rod::prior::{Prior, RodPrior};
use tirante::analysis::signal::modes::{
    Evidence, LabelPlan, Mask, ModalPlan, ModeSettings, ModeWindow, MotionKind, Resonance,
};
use tirante::analysis::signal::record::{Excitation, Record, Rejection};
use tirante::analysis::signal::spectrum::{PeakSettings, WelchSettings};

const TODI: [f64; 3] = [4.492, 9.288, 13.252];
const FS: f64 = 100.0;

/// Label plan of the paper's rod.
fn todi() -> LabelPlan {
    LabelPlan::new(&RodPrior::todi(), &[0.0; 3], ModeSettings::default()).unwrap()
}

fn plan() -> ModalPlan {
    ModalPlan::new(WelchSettings::default(), PeakSettings::default(), todi())
}

#[derive(Debug, Clone, Copy)]
struct Cell {
    excitation: Excitation,
    damping: f64,
    seconds: f64,
    /// Ambient: first mode's spectral peak over the noise [dB]. Decay: pull over noise [dB].
    snr_db: f64,
    /// Decay: ambient response that goes on, relative to the pull.
    ambient: f64,
}

impl Cell {
    fn modes(&self) -> Vec<SimulatedMode> {
        TODI.iter()
            .zip([0.0, -3.0, -6.0])
            .map(|(&frequency_hz, drop_db)| {
                let (ambient, pull) = match self.excitation {
                    Excitation::Ambient => (
                        ambient_sd(frequency_hz, self.damping, self.snr_db + drop_db, 1.0, FS),
                        0.0,
                    ),
                    Excitation::FreeDecay => {
                        let pull = 10f64.powf((self.snr_db + drop_db) / 20.0);
                        (self.ambient * pull, pull)
                    }
                };
                SimulatedMode {
                    frequency_hz,
                    damping: self.damping,
                    ambient,
                    pull,
                }
            })
            .collect()
    }

    /// Seed of its first record: other records in every cell.
    fn seed(&self) -> u64 {
        (self.seconds * 1e6 + self.damping * 1e9 + self.snr_db * 1e3) as u64 * 100_000
    }

    /// Per mode: (found, lines, covered, mean square of z, median sd, median damping).
    fn run(&self, repeats: u64) -> Vec<Score> {
        let modes = self.modes();
        let base = self.seed();
        let plan = plan();
        let all: Vec<Vec<Resonance>> = (0..repeats)
            .into_par_iter()
            .map(|seed| {
                let record = simulate(base + seed, FS, self.seconds, &modes, 1.0, self.excitation);
                plan.search().evidence(&record, 2.0, 25.0).unwrap().resonances
            })
            .collect();
        TODI.iter()
            .map(|&truth| {
                let mut score = Score {
                    repeats: repeats as usize,
                    ..Score::default()
                };
                let mut sds = Vec::new();
                let mut dampings = Vec::new();
                for found in &all {
                    let nearest = found.iter().min_by(|a, b| {
                        (a.frequency_hz - truth)
                            .abs()
                            .total_cmp(&(b.frequency_hz - truth).abs())
                    });
                    let Some(r) = nearest.filter(|r| (r.frequency_hz - truth).abs() < 0.5) else {
                        continue;
                    };
                    if r.line {
                        score.lines += 1;
                        continue;
                    }
                    score.found += 1;
                    let z = (r.frequency_hz - truth) / r.frequency_sd_hz;
                    score.covered += usize::from(z.abs() < 1.96);
                    score.z2 += z * z;
                    sds.push(r.frequency_sd_hz);
                    dampings.push(r.damping);
                }
                sds.sort_by(f64::total_cmp);
                dampings.sort_by(f64::total_cmp);
                let floor = truth * (self.damping / (2.0 * PI * truth * self.seconds)).sqrt();
                score.sd_over_floor = sds.get(sds.len() / 2).map_or(f64::NAN, |sd| sd / floor);
                score.damping = dampings.get(dampings.len() / 2).copied().unwrap_or(f64::NAN);
                score
            })
            .collect()
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Score {
    repeats: usize,
    found: usize,
    lines: usize,
    covered: usize,
    z2: f64,
    sd_over_floor: f64,
    damping: f64,
}

fn print_cells(cells: &[Cell], repeats: u64) {
    println!(
        "excitation damping_% seconds snr_db mode found_% lines_% coverage_% binomial rms_z sd/floor damping_%"
    );
    for cell in cells {
        for (n, s) in cell.run(repeats).iter().enumerate() {
            let found = s.found.max(1) as f64;
            let p = s.covered as f64 / found;
            println!(
                "{:?} {:5.2} {:4} {:3} {} {:5.1} {:5.1} {:6.1} {:4.1} {:6.2} {:6.2} {:6.3}",
                cell.excitation,
                100.0 * cell.damping,
                cell.seconds,
                cell.snr_db,
                n + 1,
                100.0 * s.found as f64 / s.repeats as f64,
                100.0 * s.lines as f64 / s.repeats as f64,
                100.0 * p,
                100.0 * (p * (1.0 - p) / found).sqrt(),
                (s.z2 / found).sqrt(),
                s.sd_over_floor,
                100.0 * s.damping
            );
        }
    }
}

#[test]
#[ignore = "campaign: statistics over every cell, 10 minutes; run with REPEATS=150 cargo test --release --test analysis modes:: -- --ignored --nocapture"]
fn campaign() {
    let repeats = std::env::var("REPEATS")
        .ok()
        .and_then(|r| r.parse().ok())
        .unwrap_or(100);
    let mut cells = Vec::new();
    let only = std::env::var("ONLY").unwrap_or_default();
    for excitation in [Excitation::Ambient, Excitation::FreeDecay] {
        if !format!("{excitation:?}").starts_with(&only) {
            continue;
        }
        for seconds in [20.0, 60.0, 200.0, 600.0] {
            for damping in [0.001, 0.003, 0.01, 0.02] {
                let (levels, ambient) = match excitation {
                    Excitation::Ambient => ([25.0, 40.0, 60.0], 0.0),
                    Excitation::FreeDecay => ([6.0, 30.0, 60.0], 0.03),
                };
                for snr_db in levels {
                    cells.push(Cell {
                        excitation,
                        damping,
                        seconds,
                        snr_db,
                        ambient,
                    });
                }
            }
        }
    }
    print_cells(&cells, repeats);
}

fn resonance(frequency_hz: f64) -> Resonance {
    Resonance {
        frequency_hz,
        frequency_sd_hz: 0.003 * frequency_hz,
        damping: 0.005,
        damping_log_sd: 0.2,
        peak_to_noise: 1e3,
        evidence: 500.0,
        line: false,
        misfit: 0.0,
        foreign_log_odds: 0.0,
    }
}

/// Reported orders among those that the force uses.
fn labels(frequencies: &[f64], kind: MotionKind) -> Result<Vec<(usize, f64)>, Rejection> {
    let resonances: Vec<Resonance> = frequencies.iter().map(|&f| resonance(f)).collect();
    let labelling = todi()
        .label(&resonances, (0.0, 50.0), kind)
        .map_err(|found| found.rejection)?;
    let used = labelling.modes.iter().filter(|m| m.order <= 3);
    Ok(used.map(|m| (m.order, m.frequency_hz)).collect())
}

#[test]
fn the_papers_frequencies_are_modes_one_to_three() {
    // f3 / f1 = 2.950, although hinged ends force 3 or more. They rang after pulls with a rope.
    assert_eq!(
        labels(&TODI, MotionKind::FreeDecay).unwrap(),
        [(1, TODI[0]), (2, TODI[1]), (3, TODI[2])]
    );
}

#[test]
fn missing_higher_and_foreign_peaks_do_not_shift_the_orders() {
    let pulled = |frequencies: &[f64]| labels(frequencies, MotionKind::FreeDecay);
    // Mid-span: no even orders. The fourth and fifth are not taken for lower ones.
    assert_eq!(pulled(&[5.0, 15.8]).unwrap(), [(1, 5.0), (3, 15.8)]);
    assert_eq!(pulled(&[10.3, 16.2]).unwrap(), [(2, 10.3), (3, 16.2)]);
    let all = [(1, 5.0), (2, 10.3), (3, 16.2)];
    assert_eq!(pulled(&[5.0, 10.3, 16.2, 22.5, 29.7]).unwrap(), all);
    assert_eq!(pulled(&[3.1, 5.0, 7.7, 10.3, 16.2, 19.0]).unwrap(), all);
    // Frequencies that the model gives need no pull.
    for frequencies in [&[5.0, 10.3, 16.2][..], &[5.0, 10.3, 16.2, 22.5, 29.7]] {
        assert_eq!(labels(frequencies, MotionKind::Ambient).unwrap(), all);
    }
}

/// A real case of the whole-program campaign: 383 kN where the prior said 1101 +- 220. The lowest two
/// peaks were called foreign, the next two modes 2 and 3, and the force came out four times too large.
#[test]
fn a_rod_far_from_its_guessed_force_keeps_its_orders() {
    let normal = |mean: f64, cv: f64| Prior::TruncatedNormal { mean, sd: cv * mean };
    let spring = Prior::Uniform {
        low: 0.0,
        high: 2.005e6,
    };
    let priors = vec![
        normal(1.1008e6, 0.2),
        normal(2.0e11, 0.3),
        normal(7700.0, 0.1),
        normal(0.08769, 0.03),
        spring,
        spring,
        Prior::Fixed { value: 6.7157 },
    ];
    let prior = RodPrior::new(Parameterisation::new(Section::Round), priors).unwrap();
    let plan = LabelPlan::new(&prior, &[0.01; 3], ModeSettings::default()).unwrap();
    let peaks: Vec<Resonance> = [8.3085, 19.0571, 34.0965, 53.9982].map(resonance).to_vec();
    let found = plan.label(&peaks, (0.0, 60.0), MotionKind::Ambient).unwrap();
    // The fourth is not used, and reported only if it is even more certain.
    let orders: Vec<usize> = found.modes.iter().map(|mode| mode.order).collect();
    assert!(orders.starts_with(&[1, 2, 3]), "{orders:?}");
    assert!((found.modes[2].frequency_hz - 34.0965).abs() < 1e-9);
}

#[test]
fn one_peak_or_a_wrong_proportion_is_refused() {
    for frequencies in [&[5.0][..], &[5.0, 13.0], &[21.0]] {
        assert!(
            matches!(
                labels(frequencies, MotionKind::Ambient),
                Err(Rejection::NoLabel { .. })
            ),
            "{frequencies:?}"
        );
    }
    // A line is never a mode.
    let lines: Vec<Resonance> = TODI
        .iter()
        .map(|&f| Resonance {
            line: true,
            ..resonance(f)
        })
        .collect();
    assert!(todi().label(&lines, (0.0, 50.0), MotionKind::Ambient).is_err());
}

#[test]
fn foreign_resonances_alone_are_mostly_refused() {
    // Peaks at random positions in the band: any label is by chance. 400 draws of each
    // number: binomial error 2 %. Measured 0, 8, 17, 20 and 15 %: a pair in the right proportion and range does
    // turn up among many.
    let mut rng = random::stream(11, 0);
    let todi = todi();
    for count in [1usize, 2, 3, 5, 8] {
        let mut labelled = 0;
        for _ in 0..400 {
            let mut f: Vec<f64> = (0..count)
                .map(|_| 2.6 * 20f64.powf(rng.random::<f64>()))
                .collect();
            f.sort_by(f64::total_cmp);
            let resonances: Vec<Resonance> = f.iter().map(|&f| resonance(f)).collect();
            labelled += usize::from(todi.label(&resonances, (0.0, 50.0), MotionKind::Ambient).is_ok());
        }
        println!("{count} foreign: {labelled} of 400 labelled");
        assert!(
            labelled <= if count == 1 { 0 } else { 100 },
            "{count} foreign: {labelled}"
        );
    }
}

#[test]
fn noise_alone_is_never_identified() {
    let plan = plan();
    let records = 300;
    let identified: usize = (0..records)
        .into_par_iter()
        .map(|seed| {
            let seconds = [20.0, 60.0, 120.0][seed as usize % 3];
            let excitation = if seed % 2 == 0 {
                Excitation::Ambient
            } else {
                Excitation::FreeDecay
            };
            let mut record = simulate(9_000_000 + seed, FS, seconds, &[], 1.0, excitation);
            if seed % 5 == 0 {
                // Drift of a random walk beneath the noise.
                let mut rng = random::stream(seed, 9);
                let mut level = 0.0;
                for sample in &mut record.samples {
                    level += 0.1 * normal(&mut rng);
                    *sample += level;
                }
            }
            usize::from(plan.identify(&record).is_ok())
        })
        .sum();
    assert!(identified <= 3, "{identified} of {records}");
}

/// The modes of a cell at other frequencies: the paper's own fit its priors badly and are labelled only where
/// the rod was pulled.
fn modes_at(cell: &Cell, frequencies: &[f64]) -> Vec<SimulatedMode> {
    let modes = frequencies.iter().zip(cell.modes());
    modes
        .map(|(&frequency_hz, mode)| SimulatedMode { frequency_hz, ..mode })
        .collect()
}

#[test]
fn lines_are_lines_and_a_mode_between_them_is_found() {
    let cell = Cell {
        excitation: Excitation::Ambient,
        damping: 0.005,
        seconds: 60.0,
        snr_db: 45.0,
        ambient: 0.0,
    };
    let modes = modes_at(&cell, &[5.0, 10.3, 16.2]);
    let quiet = simulate(77, FS, 60.0, &modes, 1.0, Excitation::Ambient);
    let plan = plan();
    // A tone of amplitude 2 at 7.31 Hz, and one of amplitude 1 elsewhere: the resonances at both.
    let with_tone_at = |hz: f64| {
        let mut record = quiet.clone();
        for (i, sample) in record.samples.iter_mut().enumerate() {
            let t = i as f64 / FS;
            *sample += 2.0 * (2.0 * PI * 7.31 * t).sin() + (2.0 * PI * hz * t).cos();
        }
        let estimate = plan.identify(&record).unwrap();
        let orders: Vec<usize> = estimate.modes.iter().map(|m| m.order).collect();
        assert_eq!(orders, [1, 2, 3]);
        [7.31, hz].map(|hz| {
            let mut found = estimate.evidence.resonances.iter();
            *found.find(|r| (r.frequency_hz - hz).abs() < 0.01).unwrap()
        })
    };
    // A third above mode 3, clear of its skirt.
    let apart = with_tone_at(21.743);
    assert!(apart.iter().all(|tone| tone.line), "{apart:?}");
    // On the skirt of mode 3, which makes its amplitude uneven, a tone is at least doubted.
    let [alone, beside] = with_tone_at(17.777);
    assert!(
        alone.line && beside.foreign_log_odds > 0.0,
        "{alone:?} {beside:?}"
    );
}

#[test]
fn a_sensor_at_mid_span_sees_modes_one_and_three() {
    let cell = Cell {
        excitation: Excitation::Ambient,
        damping: 0.005,
        seconds: 60.0,
        snr_db: 45.0,
        ambient: 0.0,
    };
    let modes = modes_at(&cell, &[5.0, 15.8, 29.3]);
    let estimate = plan()
        .identify(&simulate(5, FS, 60.0, &modes, 1.0, Excitation::Ambient))
        .unwrap();
    assert_eq!(estimate.modes.iter().map(|m| m.order).collect::<Vec<_>>(), [1, 3]);
    // The fifth is not used, but it is part of the likeliest assignment.
    let likeliest = &estimate.labels.candidates[0].modes;
    assert_eq!(likeliest.iter().map(|mode| mode.0).collect::<Vec<_>>(), [1, 3, 5]);
}

#[test]
fn two_modes_close_together_are_told_apart() {
    let modes = [4.5, 5.3].map(|frequency_hz| SimulatedMode {
        frequency_hz,
        damping: 0.005,
        ambient: ambient_sd(frequency_hz, 0.005, 45.0, 1.0, FS),
        pull: 0.0,
    });
    let found = plan()
        .search()
        .evidence(
            &simulate(8, FS, 120.0, &modes, 1.0, Excitation::Ambient),
            2.0,
            25.0,
        )
        .unwrap()
        .resonances;
    assert_eq!(found.len(), 2, "{found:?}");
    for (r, mode) in found.iter().zip(modes) {
        assert!(
            (r.frequency_hz - mode.frequency_hz).abs() < 3.5 * r.frequency_sd_hz,
            "{r:?}"
        );
    }
}

#[test]
fn damaged_and_hopeless_records_are_refused_by_name() {
    let plan = plan();
    let mut record = simulate(1, FS, 60.0, &[], 1.0, Excitation::Ambient);
    let with = |samples: Vec<f64>, fs_hz: f64| {
        let found = plan.identify(&Record {
            samples,
            fs_hz,
            ..record.clone()
        });
        found.map_err(|refused| refused.rejection)
    };
    assert!(matches!(
        with(vec![1.0; 6000], FS),
        Err(Rejection::Constant { .. })
    ));
    assert!(matches!(with(vec![], FS), Err(Rejection::TooShort { .. })));
    assert!(matches!(
        with(record.samples[..300].to_vec(), FS),
        Err(Rejection::TooShort { .. })
    ));
    assert!(matches!(
        with(record.samples.clone(), 8.0),
        Err(Rejection::Undersampled { .. })
    ));
    // Noise, sampled below the band of the prior: the band told is the one that was searched.
    let mut state = 1_u64;
    let noise: Vec<f64> = (0..6000)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(u32::MAX)
        })
        .collect();
    for fs_hz in [FS, 30.0] {
        match with(noise.clone(), fs_hz) {
            Err(Rejection::NoPeak { low_hz, high_hz }) => {
                assert!(
                    low_hz < high_hz && high_hz <= 0.5 * fs_hz,
                    "{low_hz} {high_hz} at {fs_hz}"
                );
            }
            other => panic!("{fs_hz} Hz: {:?}", other.err()),
        }
    }
    let huge: Vec<f64> = record.samples.iter().map(|x| x * 1e300).collect();
    assert!(with(huge, FS).is_err());
    record.samples[17] = f64::NAN;
    let refused = plan.identify(&record).unwrap_err();
    assert!(matches!(refused.rejection, Rejection::Missing { .. }));
}

/// A small version of the campaign below: every cell within three binomial errors of 95 %, and the
/// standard error near the ambient floor.
#[test]
fn intervals_cover_the_truth() {
    for (excitation, damping, seconds, snr_db) in [
        (Excitation::Ambient, 0.001, 60.0, 60.0),
        (Excitation::Ambient, 0.01, 20.0, 40.0),
        (Excitation::Ambient, 0.003, 200.0, 40.0),
        (Excitation::Ambient, 0.02, 200.0, 25.0),
        (Excitation::FreeDecay, 0.003, 60.0, 60.0),
        (Excitation::FreeDecay, 0.01, 20.0, 30.0),
    ] {
        let cell = Cell {
            excitation,
            damping,
            seconds,
            snr_db,
            ambient: 0.03,
        };
        let scores = cell.run(40);
        let found: usize = scores.iter().map(|s| s.found).sum();
        let covered: usize = scores.iter().map(|s| s.covered).sum();
        let share = covered as f64 / found as f64;
        println!(
            "{cell:?}: {covered} of {found}, sd/floor {:?}",
            scores.iter().map(|s| s.sd_over_floor).collect::<Vec<_>>()
        );
        assert!(found >= 100, "{cell:?}: found {found} of 120");
        // Three binomial errors of 0.95 at 120: 6 %.
        assert!((0.89..=1.0).contains(&share), "{cell:?}: {covered} of {found}");
        if excitation == Excitation::Ambient {
            assert!(
                scores.iter().all(|s| (0.67..1.5).contains(&s.sd_over_floor)),
                "{cell:?}"
            );
        }
    }
}

/// Classes without the rod, in which no orders may be reported.
const WITHOUT_ROD: [Class; 2] = [Class::NoRod, Class::AnotherRod];

/// A small version of the campaign below, both kinds of prior: labels are right as often as stated.
#[test]
fn labels_of_every_class_are_right_as_often_as_they_say() {
    let settings = ModeSettings::default();
    for knowledge in [Knowledge::FirstContact, Knowledge::Known] {
        let (mut records, mut wrong, mut intruders, mut told) = (0, 0, 0, 0);
        let mut short = 0.0;
        for class in CLASSES.into_iter().filter(|class| !WITHOUT_ROD.contains(class)) {
            let score = crate::labels::score(class, knowledge, 60, &settings);
            let least = match class {
                Class::Visible(3, _) => 52,
                Class::Visible(5.., _) => 56,
                _ => 0,
            };
            // 95 and 98 % less three binomial errors of sixty records.
            assert!(
                score.identified >= least,
                "{class:?} {knowledge:?}: {} of 60",
                score.identified
            );
            records += score.records;
            wrong += score.wrong;
            intruders += score.intruders;
            told += score.identified;
            short += score.stated.iter().map(|(p, _)| 1.0 - p).sum::<f64>();
        }
        println!(
            "{knowledge:?}: {told} of {records} told, {wrong} wrong orders, {intruders} foreign peaks beside right ones, {short:.1} expected"
        );
        // One in a thousand, with an allowance for chance (an expectation of 1 gives more than 4 in 0.4 % of campaigns).
        assert!(wrong <= 4, "{knowledge:?}: {wrong} of {records}");
        // 30 in a thousand and two binomial errors.
        assert!(intruders <= 42, "{knowledge:?}: {intruders} of {records}");
        // The stated probabilities promise so many faults: within three Poisson errors.
        let faults = (wrong + intruders) as f64;
        assert!(
            faults <= short + 3.0 * short.sqrt(),
            "{knowledge:?}: {faults} for {short:.1}"
        );
    }
}

#[test]
fn a_record_without_the_rod_is_hardly_ever_claimed() {
    // One in a hundred at first contact, one in a thousand once known; chance adds three binomial errors.
    let settings = ModeSettings::default();
    for (knowledge, most) in [(Knowledge::FirstContact, 8), (Knowledge::Known, 3)] {
        let score = crate::labels::score(Class::NoRod, knowledge, 300, &settings);
        assert!(
            score.identified <= most,
            "{knowledge:?}: {} of 300",
            score.identified
        );
    }
}

/// The tables of docs/modes.md.
#[test]
#[ignore = "campaign: 2000 records a class, 5 minutes; run with REPEATS=2000 cargo test --release --test analysis labels_campaign -- --ignored --nocapture"]
fn labels_campaign() {
    let records = std::env::var("REPEATS")
        .ok()
        .and_then(|r| r.parse().ok())
        .unwrap_or(300);
    for knowledge in [Knowledge::FirstContact, Knowledge::Known] {
        crate::labels::table(knowledge, records, &ModeSettings::default(), &CLASSES);
    }
    // Results that would be reported below the level: the calibration of the stated probability.
    let any = ModeSettings {
        least_probability: 0.5,
        ..ModeSettings::default()
    };
    crate::labels::table(Knowledge::FirstContact, records, &any, &CLASSES);
}

#[test]
fn a_peak_in_a_window_is_that_mode_whatever_else_fits() {
    let window = |order, low_hz, high_hz| ModeWindow {
        order,
        low_hz,
        high_hz,
    };
    let plan = |windows: Vec<ModeWindow>| {
        let settings = ModeSettings {
            windows,
            ..ModeSettings::default()
        };
        LabelPlan::new(&RodPrior::todi(), &[0.01], settings).unwrap()
    };
    let told = |windows: Vec<ModeWindow>, frequencies: &[f64]| {
        let resonances: Vec<Resonance> = frequencies.iter().map(|&f| resonance(f)).collect();
        let found = plan(windows).label(&resonances, (0.0, 50.0), MotionKind::Ambient);
        found
            .map(|found| found.labels.told)
            .map_err(|found| found.rejection)
    };
    // One peak alone proves nothing, unless a person declares its order.
    assert!(told(vec![], &[4.6]).is_err());
    assert_eq!(told(vec![window(1, 4.0, 5.0)], &[4.6]).unwrap(), [(1, 4.6)]);
    // Also against the prior: modes 1 and 2 are declared to be 2 and 3.
    let declared = vec![window(2, 4.0, 5.0), window(3, 9.0, 10.0)];
    let against = told(declared, &TODI).unwrap();
    assert!(against.starts_with(&[(2, TODI[0]), (3, TODI[1])]), "{against:?}");
    // Nothing in the window of mode 1: it is not elsewhere.
    let elsewhere = told(vec![window(1, 3.0, 4.0)], &TODI);
    assert!(elsewhere.is_err_and(|rejection| matches!(rejection, Rejection::NoLabel { .. })));
    // Of two peaks in a window the one of more evidence.
    let mut two = [resonance(4.4), resonance(4.6)];
    two[1].evidence *= 2.0;
    let found = plan(vec![window(1, 4.0, 5.0)])
        .label(&two, (0.0, 50.0), MotionKind::Ambient)
        .unwrap();
    assert_eq!(found.labels.told, [(1, 4.6)]);
}

#[test]
fn one_clear_mode_is_enough_where_one_is_asked_for() {
    let settings = ModeSettings {
        count: 1,
        ..ModeSettings::default()
    };
    let plan = LabelPlan::new(&RodPrior::todi(), &[0.01], settings).unwrap();
    let told = |resonances: &[Resonance]| {
        plan.label(resonances, (0.0, 50.0), MotionKind::Ambient)
            .map(|found| found.labels.told)
    };
    assert_eq!(told(&[resonance(4.6)]).unwrap(), [(1, 4.6)]);
    assert_eq!(told(&[resonance(4.6), resonance(21.0)]).unwrap()[0], (1, 4.6));
    // A line is no mode, one asked for or not.
    let line = Resonance {
        line: true,
        foreign_log_odds: 4.0,
        ..resonance(4.6)
    };
    assert!(told(&[line]).is_err());
    // Far from where the first mode may be there is none.
    assert!(told(&[resonance(45.0)]).is_err());
}

/// Even orders alone are nearly those of a rod of four times the force: where the peaks say which, a declared first mode is contradicted,
/// and modes above those of the force count as seen.
#[test]
fn even_orders_are_no_first_mode() {
    let mut identified = 0;
    for seed in 0..24 {
        let world = labels::world(Class::Visible(8, 9), Knowledge::FirstContact, seed);
        let even: Vec<Resonance> = [1, 3, 5, 7].map(|n| resonance(world.frequencies[n])).to_vec();
        let told = |count: usize| {
            let settings = ModeSettings {
                count,
                ..ModeSettings::default()
            };
            let plan = LabelPlan::new(&world.prior, &[0.01], settings).unwrap();
            plan.label(&even, (0.0, world.frequencies[9]), MotionKind::Ambient)
        };
        match told(3) {
            Ok(found) => {
                assert_eq!(found.labels.told[0], (2, world.frequencies[1]), "{seed}");
                assert!(told(1).is_err(), "{seed}: {:?}", world.frequencies);
                identified += 1;
            }
            Err(found) => {
                let reason = found.rejection.to_string();
                assert!(!reason.contains("one peak alone"), "{seed}: {reason}");
            }
        }
    }
    assert!(identified >= 4, "{identified}");
}

#[test]
fn a_band_and_masks_keep_peaks_out() {
    let resonances: Vec<Resonance> = [1.1, 5.0, 7.7, 10.3, 16.2, 40.0].map(resonance).to_vec();
    let settings = ModeSettings {
        band_hz: Some([2.0, 30.0]),
        masks: vec![Mask {
            low_hz: 7.0,
            high_hz: 8.0,
        }],
        ..ModeSettings::default()
    };
    let plan = LabelPlan::new(&RodPrior::todi(), &[0.01], settings).unwrap();
    assert_eq!(plan.band_hz(), (2.0, 30.0));
    let found = plan.label(&resonances, (0.0, 50.0), MotionKind::Ambient).unwrap();
    assert_eq!(found.labels.told, [(1, 5.0), (2, 10.3), (3, 16.2)]);
}

#[test]
fn what_is_refused_shows_candidates_with_their_forces_and_the_remedy() {
    let resonances: Vec<Resonance> = [5.0, 13.0].map(resonance).to_vec();
    let Err(found) = todi().label(&resonances, (0.0, 50.0), MotionKind::Ambient) else {
        panic!("two peaks in no proportion of any rod");
    };
    assert!(!found.labels.candidates.is_empty() && found.labels.told.is_empty());
    let mut total = 0.0;
    for candidate in &found.labels.candidates {
        let [low, middle, high] = candidate.axial_force_n.unwrap();
        assert!(low < middle && middle < high && low > 0.0, "{candidate:?}");
        total += candidate.probability;
    }
    assert!(total <= 1.0 + 1e-12);
    let text = found.rejection.to_string();
    assert!(
        text.contains("what would decide") && text.contains("[rod.modes]"),
        "{text}"
    );
}

#[test]
fn the_same_peaks_have_the_same_labels_to_the_bit() {
    let world = crate::labels::world(Class::Foreign(2), Knowledge::FirstContact, 3);
    let once = || {
        let plan = LabelPlan::new(&world.prior, &[0.01], ModeSettings::default()).unwrap();
        plan.label(&world.peaks, (0.0, world.limit_hz), MotionKind::Ambient)
    };
    let first = once();
    (0..4).into_par_iter().for_each(|_| assert_eq!(once(), first));
}

/// One kind of motion at a sensor.
struct Case {
    name: &'static str,
    scene: Scene,
    kinds: &'static [MotionKind],
}

/// The paper's modes at 0, -3 and -6 dB in a record without declarations.
fn scene(damping: f64, seconds: f64, snr_db: f64) -> Scene {
    let cell = Cell {
        excitation: Excitation::Ambient,
        damping,
        seconds,
        snr_db,
        ambient: 0.0,
    };
    Scene {
        fs_hz: FS,
        seconds,
        modes: cell.modes(),
        noise: 1.0,
        ..Scene::default()
    }
}

fn pull(at_s: f64, ratio: f64, ramp_s: f64) -> Pull {
    Pull { at_s, ratio, ramp_s }
}

/// Every excitation of one damping, length and level.
fn classes(damping: f64, seconds: f64, snr_db: f64) -> Vec<Case> {
    use MotionKind::{Ambient, Blow, FreeDecay, FreeDecays};
    let any = &[Ambient, Blow, FreeDecay, FreeDecays][..];
    let base = || scene(damping, seconds, snr_db);
    let pulls = |name, pulls: Vec<Pull>, kinds| Case {
        name,
        scene: Scene { pulls, ..base() },
        kinds,
    };
    vec![
        Case {
            name: "ambient",
            scene: base(),
            kinds: &[Ambient],
        },
        Case {
            name: "gusts 0.6",
            scene: Scene {
                gust: Some((0.6, 5.0)),
                ..base()
            },
            kinds: any,
        },
        Case {
            name: "gusts 1.2",
            scene: Scene {
                gust: Some((1.2, 5.0)),
                ..base()
            },
            kinds: any,
        },
        Case {
            name: "knocks",
            scene: Scene {
                knocks: Some((20.0, 20.0)),
                ..base()
            },
            kinds: any,
        },
        // A release at rest just before the first sample; and a decay whose beginning was missed.
        pulls("decay from sample 0", vec![pull(-1e-4, 30.0, 1.0)], &[FreeDecay]),
        pulls(
            "strong decay from sample 0",
            vec![pull(-1e-4, 300.0, 1.0)],
            &[FreeDecay],
        ),
        pulls("decay begun before", vec![pull(-1.0, 100.0, 1.0)], &[FreeDecay]),
        pulls(
            "0.3 s of quiet, then a blow",
            vec![pull(0.303, 100.0, 0.0)],
            &[FreeDecay],
        ),
        pulls("blow", vec![pull(0.31 * seconds, 30.0, 0.0)], &[FreeDecay, Blow]),
        pulls(
            "static pull and release",
            vec![pull(0.25 * seconds, 300.0, 3.0)],
            &[FreeDecay],
        ),
        pulls(
            "three pulls",
            [0.05, 0.37, 0.69]
                .map(|share| pull(share * seconds, 100.0, 2.0))
                .to_vec(),
            &[FreeDecays],
        ),
        Case {
            name: "blow inside gusts",
            scene: Scene {
                gust: Some((0.6, 5.0)),
                pulls: vec![pull(0.42 * seconds, 8.0, 0.0)],
                ..base()
            },
            kinds: any,
        },
    ]
}

/// Of every mode of every record: found, covered; and number of records with the right motion.
fn tally(class: &Case, repeats: u64, seed: u64) -> (usize, usize, usize) {
    let plan = plan();
    let all: Vec<Evidence> = (0..repeats)
        .into_par_iter()
        .map(|n| {
            plan.search()
                .evidence(&class.scene.record(seed * 100_000 + n), 2.0, 25.0)
                .unwrap()
        })
        .collect();
    let (mut found, mut covered) = (0, 0);
    for evidence in &all {
        for mode in &class.scene.modes {
            let truth = mode.frequency_hz;
            let far = |r: &Resonance| (r.frequency_hz - truth).abs();
            let nearest = evidence
                .resonances
                .iter()
                .min_by(|a, b| far(a).total_cmp(&far(b)));
            let Some(r) = nearest.filter(|r| far(r) < 0.25 && !r.line) else {
                continue;
            };
            found += 1;
            covered += usize::from(far(r) < 1.96 * r.frequency_sd_hz);
        }
    }
    let right = all
        .iter()
        .filter(|e| class.kinds.contains(&e.motion.kind))
        .count();
    (found, covered, right)
}

/// Without declarations the motion is recognised, every mode found, and its interval covers.
#[test]
fn every_excitation_is_recognised_and_covered() {
    let repeats = 20;
    for (n, class) in classes(0.003, 60.0, 40.0).iter().enumerate() {
        let (found, covered, right) = tally(class, repeats, 40 + n as u64);
        println!(
            "{}: {covered} of {found} covered, {right} of {repeats} recognised",
            class.name
        );
        assert!(found >= 57, "{}: {found} of 60 found", class.name);
        // Three binomial errors of 0.95 at 60: 8.4 %.
        assert!(
            covered as f64 >= 0.866 * found as f64,
            "{}: {covered} of {found}",
            class.name
        );
        assert!(right >= 18, "{}: {right} of 20 recognised", class.name);
    }
}

/// Decays of the paper's modes from the first sample on, 60 s, damping of 0.2 %: at their beginning the frequencies are lower
/// by `softening`, and the difference dies out with the amplitude. `level_db` is that of the first mode over the noise.
fn softened_decay(seed: u64, softening: f64, level_db: f64) -> Record {
    let mut rng = random::stream(seed, 17);
    let zeta = 0.002;
    let phases = TODI.map(|_| 2.0 * PI * rng.random::<f64>());
    let samples = (0..6000)
        .map(|i| {
            let t = f64::from(i) / FS;
            let motion = |n: usize| {
                let gamma = 2.0 * PI * zeta * TODI[n];
                let damped = TODI[n] * (1.0f64 - zeta * zeta).sqrt();
                let fallen = softening / zeta * (1.0 - (-gamma * t).exp());
                (-gamma * t).exp() * (2.0 * PI * damped * t - fallen + phases[n]).cos() / (n + 1) as f64
            };
            let sum: f64 = (0..3).map(motion).sum();
            sum + 10f64.powf(-level_db / 20.0) * normal(&mut rng)
        })
        .collect();
    Record {
        samples,
        ..scene(zeta, 60.0, 40.0).record(seed)
    }
}

/// The reported frequency is that of a small swing, whatever the amplitude did to it; and a clean decay of a
/// rod that does not soften keeps its small error.
#[test]
fn a_frequency_that_falls_with_the_amplitude_is_covered() {
    let plan = plan();
    for (softening, level_db) in [
        (0.0, 60.0),
        (2e-4, 40.0),
        (2e-4, 60.0),
        (-1e-3, 60.0),
        (1e-3, 30.0),
    ] {
        let repeats = 24;
        let all: Vec<[Option<(f64, f64)>; 3]> = (0..repeats)
            .into_par_iter()
            .map(|n| {
                let record = softened_decay(n + 1, softening, level_db);
                let found = plan.search().evidence(&record, 2.0, 25.0).unwrap().resonances;
                TODI.map(|truth| {
                    let near = found
                        .iter()
                        .find(|r| (r.frequency_hz / truth - 1.0).abs() < 0.01)?;
                    Some((near.frequency_hz / truth - 1.0, near.frequency_sd_hz / truth))
                })
            })
            .collect();
        let told: Vec<(f64, f64)> = all.iter().flatten().copied().flatten().collect();
        let covered = told.iter().filter(|(off, sd)| off.abs() < 1.96 * sd).count();
        let widest = told.iter().fold(0.0f64, |most, (_, sd)| most.max(*sd));
        println!(
            "{softening} {level_db} dB: {covered} of {} covered, sd up to {widest:.1e}",
            told.len()
        );
        assert!(told.len() >= 70, "{softening} {level_db}: {}", told.len());
        // Three binomial errors of 0.95 at 72: 7.7 %. A linear decay's interval covers 0 to 30 % of the softened ones.
        assert!(
            covered as f64 >= 0.873 * told.len() as f64,
            "{softening} {level_db}: {covered} of {}",
            told.len()
        );
        // 60 dB of such a decay give the frequency to 1e-6 if the softening is known, to 1e-5 if it is not.
        assert!(softening != 0.0 || widest < 1e-5, "{widest}");
    }
}

/// A stationary response whose level steps, four times up and down, from a tenth to one to four.
fn gusts_that_set_in(seed: u64) -> Record {
    let mut rng = random::stream(seed, 23);
    let seconds = 300.0;
    let gusts: Vec<(f64, f64, f64)> = (0..4)
        .map(|_| {
            let from = (seconds - 20.0) * rng.random::<f64>();
            (
                from,
                from + 3.0 + 27.0 * rng.random::<f64>(),
                1.0 + 3.0 * rng.random::<f64>(),
            )
        })
        .collect();
    let level = |t: f64| {
        let at = gusts.iter().filter(|(from, to, _)| (*from..*to).contains(&t));
        at.fold(0.1f64, |level, (_, _, own)| level.max(*own))
    };
    let count = (seconds * FS) as usize;
    let mut samples = vec![0.0; count];
    for (n, truth) in TODI.into_iter().enumerate() {
        let (zeta, mut state) = (0.004, Complex::new(0.0, 0.0));
        let gamma = 2.0 * PI * zeta * truth;
        let step = Complex::from_polar(
            (-gamma / FS).exp(),
            2.0 * PI * truth * (1.0f64 - zeta * zeta).sqrt() / FS,
        );
        let drive = (1.0 - step.norm_sqr()).sqrt() / (n + 1) as f64;
        for (i, sample) in samples.iter_mut().enumerate() {
            let force = Complex::new(normal(&mut rng), normal(&mut rng));
            state = step * state + drive * level(i as f64 / FS) * force;
            *sample += state.re;
        }
    }
    samples
        .iter_mut()
        .for_each(|sample| *sample += 0.02 * normal(&mut rng));
    Record {
        samples,
        excitation: None,
        ..scene(0.004, 60.0, 40.0).record(seed)
    }
}

/// Such a gust was a release, and the motion after it a decay, with frequencies up to 4 % off.
#[test]
fn a_gust_that_sets_in_is_no_release() {
    let (plan, repeats) = (plan(), 60);
    let found: Vec<(u64, MotionKind, Vec<f64>)> = (0..repeats)
        .into_par_iter()
        .map(|seed| {
            let evidence = plan
                .search()
                .evidence(&gusts_that_set_in(seed), 2.0, 25.0)
                .unwrap();
            let far = TODI.iter().filter_map(|truth| {
                let near = evidence
                    .resonances
                    .iter()
                    .filter(|r| !r.line && (r.frequency_hz / truth - 1.0).abs() < 0.04);
                let near = near.min_by(|a, b| {
                    (a.frequency_hz - truth)
                        .abs()
                        .total_cmp(&(b.frequency_hz - truth).abs())
                })?;
                Some((near.frequency_hz - truth) / near.frequency_sd_hz)
            });
            (seed, evidence.motion.kind, far.collect())
        })
        .collect();
    let decays = found
        .iter()
        .filter(|(_, kind, _)| matches!(kind, MotionKind::FreeDecay | MotionKind::FreeDecays));
    let all: Vec<f64> = found.iter().flat_map(|(_, _, far)| far.clone()).collect();
    let covered = all.iter().filter(|z| z.abs() < 1.96).count();
    let far = all.iter().filter(|z| z.abs() > 4.0).count();
    let decays = decays.count();
    println!(
        "{decays} of {repeats} taken for decays; {covered} of {} covered, {far} far off",
        all.len()
    );
    // Six of these; all sixty, and 17 frequencies far off, when every release began a decay.
    assert!(decays <= 12, "{decays} of {repeats}: {found:?}");
    // A record is worth little more than its strongest gust, and standard errors there cover nine in ten (docs/modes.md, "gusts 1.2").
    assert!(
        far <= 6 && covered as f64 >= 0.86 * all.len() as f64,
        "{covered} of {}, {far} far off: {found:?}",
        all.len()
    );
}

/// The same at every damping, length and level: each class between 90 and 99 % within two binomial errors.
#[test]
#[ignore = "campaign: coverage of every excitation, 5 minutes; run with REPEATS=40 cargo test --test analysis excitations -- --ignored --nocapture"]
fn campaign_of_excitations() {
    let repeats = std::env::var("REPEATS")
        .ok()
        .and_then(|r| r.parse().ok())
        .unwrap_or(40);
    let count = classes(0.003, 60.0, 40.0).len();
    let mut low = Vec::new();
    println!("| class | modes | found % | coverage % | recognised % |");
    for index in 0..count {
        let (mut records, mut found, mut covered, mut right) = (0, 0, 0, 0);
        let mut name = "";
        for (cell, (damping, seconds, snr_db)) in [0.001, 0.003, 0.01, 0.02]
            .into_iter()
            .flat_map(|z| {
                [60.0, 200.0]
                    .into_iter()
                    .flat_map(move |t| [25.0, 40.0].map(move |db| (z, t, db)))
            })
            .enumerate()
        {
            let class = &classes(damping, seconds, snr_db)[index];
            let (f, c, r) = tally(class, repeats, 1000 + 100 * index as u64 + cell as u64);
            records += repeats as usize;
            (found, covered, right) = (found + f, covered + c, right + r);
            name = class.name;
        }
        let share = covered as f64 / found as f64;
        println!(
            "| {name} | {} | {:.1} | {:.1} | {:.0} |",
            3 * records,
            100.0 * found as f64 / (3 * records) as f64,
            100.0 * share,
            100.0 * right as f64 / records as f64
        );
        let error = (0.95 * 0.05 / found as f64).sqrt();
        if share < 0.9 - 2.0 * error || share > 0.99 + 2.0 * error {
            low.push(name);
        }
    }
    assert!(low.is_empty(), "coverage out of bounds: {low:?}");
}

/// Noise alone beside a clean decay: with and without quiet before it. As a file it was refused, "all are pure
/// lines", the cleaner the surer.
#[test]
fn a_clean_decay_is_no_line() {
    let plan = plan();
    for damping in [0.001, 0.002] {
        for onset in [-1e-4, 0.303] {
            let mut scene = scene(damping, 60.0, 40.0);
            let strength = 100.0;
            for (mode, frequency_hz) in scene.modes.iter_mut().zip([5.0, 10.3, 16.2]) {
                mode.frequency_hz = frequency_hz;
                mode.ambient = 1e-3;
            }
            scene.pulls = vec![pull(onset, 1e3 * strength, f64::from(onset < 0.0))];
            let class = Case {
                name: "clean",
                scene,
                kinds: &[MotionKind::FreeDecay],
            };
            let (found, covered, right) = tally(&class, 30, 77);
            assert_eq!((found, right), (90, 30), "damping {damping}, onset {onset}");
            // Three binomial errors of 0.95 at 90.
            assert!(covered >= 79, "damping {damping}, onset {onset}: {covered} of 90");
            let estimates = (0..30).filter(|&n| plan.identify(&class.scene.record(n)).is_ok());
            assert_eq!(estimates.count(), 30, "damping {damping}, onset {onset}");
        }
    }
}

/// A steady tone is recognised; one of varying amplitude is not taken for a mode without doubt.
#[test]
fn a_tone_is_told_from_a_decay() {
    for (breathing, sure) in [(0.0, 20), (0.3, 0)] {
        let mut scene = scene(0.003, 60.0, 40.0);
        scene.modes.clear();
        scene.hums = vec![Hum {
            frequency_hz: 9.288,
            amplitude: 5.0,
            breathing,
        }];
        let (mut lines, mut doubted) = (0, 0);
        for seed in 0..20 {
            let found = plan()
                .search()
                .evidence(&scene.record(seed), 2.0, 25.0)
                .unwrap()
                .resonances;
            let tone = found
                .iter()
                .find(|r| (r.frequency_hz - 9.288).abs() < 0.05)
                .unwrap();
            lines += usize::from(tone.line);
            doubted += usize::from(tone.foreign_log_odds > 0.5);
        }
        assert!(lines >= sure, "breathing {breathing}: {lines} of 20 are lines");
        // Of breathing tones 5 to 8 % pass for modes.
        assert!(doubted >= 10, "breathing {breathing}: {doubted} of 20 doubted");
    }
}

/// The weights of a narrow band colour white noise, and the next mode's skirt reaches into it: neither is a second mode.
#[test]
fn a_wide_mode_of_a_long_record_is_one() {
    let cell = Cell {
        excitation: Excitation::Ambient,
        damping: 0.02,
        seconds: 600.0,
        snr_db: 25.0,
        ambient: 0.0,
    };
    // 1.3 to 1.6 of what white force allows is the noise's part; a doubt about two modes made it 2.6 for mode 3.
    for (score, hz) in cell.run(24).iter().zip(TODI) {
        assert!(
            score.found == 24 && score.sd_over_floor < 2.0,
            "{hz} Hz: {score:?}"
        );
    }
}

/// A mask narrower than the resonance it hides leaves its skirts: the mode beside was told between the two.
#[test]
fn a_narrow_mask_over_a_neighbour_does_not_move_the_mode() {
    let (damping, truth) = (0.003, TODI[1]);
    let neighbour = 1.035 * truth;
    let mode = |frequency_hz: f64| SimulatedMode {
        frequency_hz,
        damping,
        ambient: ambient_sd(frequency_hz, damping, 40.0, 1.0, FS),
        pull: 0.0,
    };
    let masks = vec![Mask {
        low_hz: 0.997 * neighbour,
        high_hz: 1.003 * neighbour,
    }];
    let settings = ModeSettings {
        masks,
        ..ModeSettings::default()
    };
    let labels = LabelPlan::new(&RodPrior::todi(), &[0.0; 3], settings).unwrap();
    let plan = ModalPlan::new(WelchSettings::default(), PeakSettings::default(), labels);
    let off: Vec<f64> = (0..24)
        .into_par_iter()
        .map(|seed| {
            let modes = [mode(truth), mode(neighbour)];
            let record = simulate(700 + seed, FS, 60.0, &modes, 1.0, Excitation::Ambient);
            let found = plan.search().evidence(&record, 2.0, 25.0).unwrap().resonances;
            let distance = |r: &&Resonance| (r.frequency_hz - truth).abs();
            let r = found
                .iter()
                .min_by(|a, b| distance(a).total_cmp(&distance(b)))
                .unwrap();
            assert!(
                found
                    .iter()
                    .all(|r| (r.frequency_hz - neighbour).abs() > 0.003 * neighbour)
            );
            (r.frequency_hz - truth) / r.frequency_sd_hz
        })
        .collect();
    // Of 24 normal deviates one in 20 exceeds 3.1; Student's tails and the neighbour's own error allow one more. It was most of them.
    let far = off.iter().filter(|z| z.abs() > 3.1).count();
    assert!(far <= 2, "{off:?}");
}

/// A steady tone within some half-widths of a mode was told as the mode, up to 60 standard errors off. It is a line of its own now, and
/// the mode is fitted without it.
#[test]
fn a_tone_beside_a_mode_does_not_move_it() {
    let (damping, seconds) = (0.004, 120.0);
    let modes = TODI.map(|frequency_hz| SimulatedMode {
        frequency_hz,
        damping,
        ambient: ambient_sd(frequency_hz, damping, 40.0, 1.0, FS),
        pull: 0.0,
    });
    let plan = plan();
    for share in [0.006, -0.02] {
        let (truth, tone_hz) = (TODI[1], (1.0 + share) * TODI[1]);
        // Ten times the power of the mode.
        let amplitude = 20f64.sqrt() * modes[1].ambient;
        let seen: Vec<(f64, bool)> = (0..24)
            .into_par_iter()
            .filter_map(|seed| {
                let mut record = simulate(900 + seed, FS, seconds, &modes, 1.0, Excitation::Ambient);
                let resonances =
                    |record: &Record| plan.search().evidence(record, 2.0, 25.0).unwrap().resonances;
                let is_told = |found: &[Resonance]| {
                    let mut lines = found.iter().filter(|r| r.line);
                    lines.any(|r| (r.frequency_hz - tone_hz).abs() < 0.001)
                };
                assert!(resonances(&record).iter().all(|r| !r.line), "{seed}");
                for (i, sample) in record.samples.iter_mut().enumerate() {
                    let turns = tone_hz * i as f64 / FS + 0.1 * seed as f64;
                    *sample += amplitude * (2.0 * PI * turns).cos();
                }
                let found = resonances(&record);
                let off = |r: &Resonance| (r.frequency_hz - truth).abs();
                let mut modes = found.iter().filter(|r| !r.line);
                let mode = modes.find(|r| off(r) < 0.01 * truth)?;
                let z = (mode.frequency_hz - truth) / mode.frequency_sd_hz;
                Some((z, is_told(&found)))
            })
            .collect();
        // In one of the 48 no single resonance fits both, and neither is told.
        assert!(
            seen.len() >= 23 && seen.iter().all(|(_, told)| *told),
            "{share}: {seen:?}"
        );
        // Of 24 normal deviates one exceeds 4 once in 600 times, and three exceed 2.5 once in 300; all exceeded 4 before.
        let beyond = |most: f64| seen.iter().filter(|(z, _)| z.abs() > most).count();
        assert!(beyond(4.0) == 0 && beyond(2.5) <= 2, "{share}: {seen:?}");
    }
}

/// A series weighted for the weaker mode pushed the stronger one away by a fifth of its width.
#[test]
fn a_weak_neighbour_does_not_push_the_stronger_mode_away() {
    let (damping, truth) = (0.01, 9.0);
    let gamma = damping * truth;
    for side in [-1.0, 1.0] {
        let mode = |frequency_hz: f64, snr_db: f64| SimulatedMode {
            frequency_hz,
            damping,
            ambient: ambient_sd(frequency_hz, damping, snr_db, 1.0, FS),
            pull: 0.0,
        };
        let modes = [mode(truth, 45.0), mode(truth + side * 7.0 * gamma, 37.0)];
        let plan = plan();
        let offsets: Vec<f64> = (0..32)
            .into_par_iter()
            .filter_map(|seed| {
                let record = simulate(300 + seed, FS, 200.0, &modes, 1.0, Excitation::Ambient);
                let found = plan.search().evidence(&record, 2.0, 25.0).unwrap().resonances;
                let near = |hz: f64| {
                    let off = |r: &&Resonance| (r.frequency_hz - hz).abs();
                    found.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap()
                };
                let (strong, weak) = (near(truth), near(truth + side * 7.0 * gamma));
                if strong.frequency_hz == weak.frequency_hz {
                    return None;
                }
                Some((strong.frequency_hz - truth) / gamma)
            })
            .collect();
        assert!(offsets.len() >= 20, "{} told apart", offsets.len());
        let mean = offsets.iter().sum::<f64>() / offsets.len() as f64;
        println!("side {side}: {mean:.3} half-widths of {}", offsets.len());
        // One record scatters by 0.1 half-widths, the mean of 20 by 0.02; it was 0.19 with the weaker mode below.
        assert!(mean.abs() < 0.1, "side {side}: {mean} half-widths");
    }
}

/// A short record leaves fewer periods behind a pull than a part usually needs; across the release neither model fits.
#[test]
fn a_short_decay_after_a_pull_is_fitted_by_itself() {
    let mut scene = scene(0.02, 14.0, 40.0);
    scene.pulls = vec![pull(7.5, 300.0, 3.0)];
    for seed in 0..8 {
        let found = plan().search().evidence(&scene.record(seed), 2.0, 25.0).unwrap();
        assert_eq!(found.motion.kind, MotionKind::FreeDecay);
        assert!((found.motion.onsets_s[0] - 7.5).abs() < 0.1, "{:?}", found.motion);
        for truth in TODI {
            let mut all = found.resonances.iter();
            let r = all.find(|r| (r.frequency_hz / truth - 1.0).abs() < 0.01).unwrap();
            // A fit across the pull states 7e-3 to 2e-2.
            assert!(r.frequency_sd_hz < 2e-3 * truth, "{r:?}");
            assert!(
                (r.frequency_hz - truth).abs() < 4.0 * r.frequency_sd_hz,
                "{truth}: {r:?}"
            );
        }
    }
}

/// Peaks of noise on the skirts of a decay's peak are fitted, too. Beside them the mode's own fit ran to the edge of its band, which
/// passed for a curvature: a standard error of 5e-7 Hz, 0.007 Hz from the truth.
#[test]
fn a_fit_at_the_edge_of_its_band_is_none() {
    let cell = Cell {
        excitation: Excitation::FreeDecay,
        damping: 0.01,
        seconds: 600.0,
        snr_db: 30.0,
        ambient: 0.03,
    };
    let record = simulate(
        cell.seed() + 80,
        FS,
        cell.seconds,
        &cell.modes(),
        1.0,
        cell.excitation,
    );
    let found = plan().search().evidence(&record, 2.0, 25.0).unwrap().resonances;
    for truth in TODI {
        let near = found.iter().filter(|r| (r.frequency_hz - truth).abs() < 0.2);
        let near: Vec<&Resonance> = near.collect();
        assert_eq!(near.len(), 1, "{near:?}");
        let z = (near[0].frequency_hz - truth) / near[0].frequency_sd_hz;
        assert!(z.abs() < 3.0, "{near:?}");
    }
}

/// Blows at exactly even intervals while the rod still rings: the spectrum of the whole is a comb of lines at multiples of 1/4.3 Hz.
#[test]
fn blows_at_even_intervals_are_fitted_between_them() {
    let damping = 0.003;
    let plan = plan();
    let (mut covered, mut all) = (0, 0);
    for seed in 0..16 {
        let mut rng = random::stream(seed, 31);
        let mut record = scene(damping, 60.0, 40.0).record(seed);
        record.samples.fill_with(|| 1e-2 * normal(&mut rng));
        let blows: Vec<f64> = (0..14).map(|n| 1.0037 + 4.3 * f64::from(n)).collect();
        for &at in &blows {
            let size = 0.5 + rng.random::<f64>();
            for (i, x) in record.samples.iter_mut().enumerate() {
                let t = i as f64 / FS - at;
                for (mode, f) in TODI.iter().enumerate().filter(|_| t >= 0.0) {
                    let omega = 2.0 * PI * f;
                    *x += size / (mode + 1) as f64 * (-damping * omega * t).exp() * (omega * t).sin();
                }
            }
        }
        let found = plan.search().evidence(&record, 2.0, 25.0).unwrap();
        assert_eq!(found.motion.kind, MotionKind::FreeDecays);
        let told = &found.motion.onsets_s;
        assert_eq!(told.len(), blows.len(), "{told:?}");
        assert!(
            told.iter().zip(&blows).all(|(a, b)| (a - b).abs() < 0.03),
            "{told:?}"
        );
        assert!(found.resonances.len() >= 2, "{:?}", found.resonances);
        for r in &found.resonances {
            let off = |f: &&f64| (r.frequency_hz - **f).abs();
            let f = TODI.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
            let natural_hz = f / (1.0 - damping * damping).sqrt();
            let z = (r.frequency_hz - natural_hz) / r.frequency_sd_hz;
            assert!(z.abs() < 5.0, "{f}: {z} of {r:?}");
            covered += usize::from(z.abs() < 1.96);
            all += 1;
        }
    }
    println!("{covered} of {all} within 1.96 errors");
    assert!(10 * covered >= 8 * all, "{covered} of {all}");
}

/// A hum goes on from the first sample to the last, which a free start explains as well as a decay.
#[test]
fn ambient_motion_beside_a_hum_is_ambient() {
    for (frequency_hz, amplitude) in [(21.7, 40.0), (16.67, 100.0)] {
        let mut scene = scene(0.003, 60.0, 40.0);
        scene.hums = vec![Hum {
            frequency_hz,
            amplitude,
            breathing: 0.0,
        }];
        for seed in 0..12 {
            let motion = plan()
                .search()
                .evidence(&scene.record(seed), 2.0, 25.0)
                .unwrap()
                .motion;
            assert_eq!(motion.kind, MotionKind::Ambient, "{frequency_hz} Hz, {seed}");
        }
    }
}

/// Half a period in which two modes cancel is no quiet before a release.
#[test]
fn ambient_records_hardly_ever_begin_with_a_release() {
    let mut scene = scene(0.05, 20.0, 60.0);
    scene.modes.truncate(2);
    let plan = plan();
    let decays = (0..400u64)
        .into_par_iter()
        .filter(|&seed| {
            let motion = plan
                .search()
                .evidence(&scene.record(seed), 2.0, 25.0)
                .unwrap()
                .motion;
            motion.onsets_s.iter().any(|&at| at > 0.0 && at < 0.5)
        })
        .count();
    assert_eq!(decays, 0);
}

/// Three decays of one mode at frequencies that differ by a hundred times their errors: the error told is their scatter.
#[test]
fn decays_that_disagree_widen_the_error() {
    let zeta = 0.002;
    for seed in 0..4 {
        let mut rng = random::stream(seed, 23);
        let mut record = scene(zeta, 60.0, 40.0).record(seed);
        record.samples = [-5e-4, 0.0, 5e-4]
            .iter()
            .flat_map(|shift| (0..5900).map(move |i| (shift, f64::from(i) / FS)))
            .map(|(shift, t)| {
                let motion = |truth: &f64| {
                    let omega = 2.0 * PI * truth * (1.0 + shift);
                    (-zeta * omega * t).exp() * (omega * t).cos()
                };
                TODI.iter().map(motion).sum::<f64>() + 1e-3 * normal(&mut rng)
            })
            .collect();
        let found = plan().search().evidence(&record, 2.0, 25.0).unwrap();
        assert_eq!(found.motion.kind, MotionKind::FreeDecays);
        for truth in TODI {
            let mut all = found.resonances.iter();
            let r = all.find(|r| (r.frequency_hz / truth - 1.0).abs() < 0.01).unwrap();
            // The standard error of the mean of three equal ones is 2.9e-4, that of one of them below 1e-5.
            assert!(r.frequency_sd_hz > 5e-5 * truth, "{r:?}");
        }
    }
}

/// A force known more finely than the labels' grid, or a rod so stocky that no force shows, still has a band of frequencies.
#[test]
fn every_prior_has_a_band() {
    let with = |of: &dyn Fn(usize, Prior) -> Prior| {
        let todi = RodPrior::todi();
        let priors: Vec<Prior> = todi.priors().iter().enumerate().map(|(i, p)| of(i, *p)).collect();
        let prior = RodPrior::new(*todi.parameterisation(), priors).unwrap();
        LabelPlan::new(&prior, &[0.0; 3], ModeSettings::default())
            .unwrap()
            .band_hz()
    };
    let length = |metres: f64| {
        move |i: usize, prior: Prior| match (i, prior) {
            (6, _) => Prior::Fixed { value: metres },
            (_, prior) => prior,
        }
    };
    let exact = |i: usize, prior: Prior| match i {
        0 => Prior::Uniform {
            low: 800e3,
            high: 800.000_1e3,
        },
        _ => prior,
    };
    for (low_hz, high_hz) in [with(&exact), with(&length(0.3)), with(&length(14.0))] {
        assert!(
            low_hz > 0.0 && low_hz < high_hz && high_hz.is_finite(),
            "{low_hz} to {high_hz}"
        );
    }
    // The first mode of 800 kN is at 5.4 Hz.
    let (low_hz, high_hz) = with(&exact);
    assert!(low_hz < 5.4 && high_hz > 40.0, "{low_hz} to {high_hz}");
}

/// A mode assigned by hand is looked for where the hand says, also beyond the frequencies that the prior expects.
#[test]
fn windows_beyond_the_priors_band_are_searched() {
    let window = |order, low_hz, high_hz| ModeWindow {
        order,
        low_hz,
        high_hz,
    };
    let settings = ModeSettings {
        windows: vec![window(1, 0.2, 0.4), window(12, 400.0, 410.0)],
        ..ModeSettings::default()
    };
    let plan = LabelPlan::new(&RodPrior::todi(), &[0.0; 3], settings).unwrap();
    assert_eq!(plan.band_hz(), (0.2, 410.0));
}

/// Orders that rivals share are not hidden behind a sample rate below what the stiffest rod of the prior would need.
#[test]
fn modes_in_view_are_not_called_undersampled() {
    let todi = RodPrior::todi();
    let mut priors = todi.priors().to_vec();
    priors[0] = Prior::LogUniform { low: 10e3, high: 8e6 };
    let prior = RodPrior::new(*todi.parameterisation(), priors).unwrap();
    let labels = LabelPlan::new(&prior, &[0.0; 3], ModeSettings::default()).unwrap();
    let plan = ModalPlan::new(WelchSettings::default(), PeakSettings::default(), labels);
    let found = |frequencies: &[f64]| {
        let resonances: Vec<Resonance> = frequencies.iter().map(|&hz| resonance(hz)).collect();
        plan.label(&resonances, MotionKind::Ambient, 60.0, 30.0)
    };
    // Two peaks that may be modes 1, 2 or 2, 4.
    let (rejection, labels) = found(&[4.0, 8.1]).unwrap_err();
    assert_eq!(rejection.code(), "no-label", "{rejection} {labels:?}");
    // No peak at all, and one alone, may be for want of samples.
    for few in [&[][..], &[4.0]] {
        assert_eq!(found(few).unwrap_err().0.code(), "undersampled", "{few:?}");
    }
}
