//! Natural frequencies and their standard errors against simulated records whose truth is known.

// Machinery of tests and benches: a panic is the report.
#![allow(clippy::unwrap_used)]

mod simulator;

use rand::RngExt;
use rayon::prelude::*;
use simulator::{SimulatedMode, ambient_sd, normal, simulate};
use std::f64::consts::PI;
use tirante::bayes::{Prior, RodPrior};
use tirante::beam::{Parameterisation, Section};
use tirante::modes::{LabelPlan, ModalPlan, ModeSettings, ModeWindow, Resonance};
use tirante::random;
use tirante::record::{Excitation, Record, Rejection};
use tirante::spectrum::{PeakSettings, WelchSettings};

const TODI: [f64; 3] = [4.492, 9.288, 13.252];
const FS: f64 = 100.0;

/// What the labels of the paper's rod are inferred from.
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

    /// Per mode: (found, lines, covered, mean square of z, median sd, median damping).
    fn run(&self, repeats: u64) -> Vec<Score> {
        let modes = self.modes();
        // Other records in every cell.
        let base = (self.seconds * 1e6 + self.damping * 1e9 + self.snr_db * 1e3) as u64 * 100_000;
        let plan = plan();
        let all: Vec<Vec<Resonance>> = (0..repeats)
            .into_par_iter()
            .map(|seed| {
                let record = simulate(base + seed, FS, self.seconds, &modes, 1.0, self.excitation);
                plan.evidence(&record, 2.0, 25.0).unwrap().resonances
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
#[ignore = "campaign: statistics over every cell, 10 minutes; run with REPEATS=150 cargo test --release --test modes -- --ignored --nocapture"]
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

fn labels(frequencies: &[f64]) -> Result<Vec<(usize, f64)>, Rejection> {
    let resonances: Vec<Resonance> = frequencies.iter().map(|&f| resonance(f)).collect();
    let labelling = todi().label(&resonances, 50.0).map_err(|found| found.rejection)?;
    Ok(labelling
        .modes
        .iter()
        .map(|m| (m.order, m.frequency_hz))
        .collect())
}

#[test]
fn the_papers_frequencies_are_modes_one_to_three() {
    // f3 / f1 = 2.950, although hinged ends force 3 or more.
    assert_eq!(labels(&TODI).unwrap(), [(1, TODI[0]), (2, TODI[1]), (3, TODI[2])]);
}

#[test]
fn missing_higher_and_foreign_peaks_do_not_shift_the_orders() {
    // Mid-span: no even orders. The fourth and fifth are not taken for lower ones.
    assert_eq!(labels(&[5.0, 15.8]).unwrap(), [(1, 5.0), (3, 15.8)]);
    assert_eq!(labels(&[10.3, 16.2]).unwrap(), [(2, 10.3), (3, 16.2)]);
    let all = [(1, 5.0), (2, 10.3), (3, 16.2)];
    assert_eq!(labels(&[5.0, 10.3, 16.2, 22.5, 29.7]).unwrap(), all);
    assert_eq!(labels(&[3.1, 5.0, 7.7, 10.3, 16.2, 19.0]).unwrap(), all);
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
    let found = plan.label(&peaks, 60.0).unwrap();
    let orders: Vec<usize> = found.modes.iter().map(|mode| mode.order).collect();
    assert_eq!(orders, [1, 2, 3]);
    assert!((found.modes[2].frequency_hz - 34.0965).abs() < 1e-9);
}

#[test]
fn one_peak_or_a_wrong_proportion_is_refused() {
    for frequencies in [&[5.0][..], &[5.0, 13.0], &[21.0]] {
        assert!(
            matches!(labels(frequencies), Err(Rejection::NoLabel { .. })),
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
    assert!(todi().label(&lines, 50.0).is_err());
}

#[test]
fn foreign_resonances_alone_are_mostly_refused() {
    // Peaks thrown at random over the band: what is labelled is labelled by chance. 400 draws of each
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
            labelled += usize::from(todi.label(&resonances, 50.0).is_ok());
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

#[test]
fn lines_are_lines_and_a_mode_between_them_is_found() {
    let cell = Cell {
        excitation: Excitation::Ambient,
        damping: 0.005,
        seconds: 60.0,
        snr_db: 45.0,
        ambient: 0.0,
    };
    let mut record = simulate(77, FS, 60.0, &cell.modes(), 1.0, Excitation::Ambient);
    for (i, sample) in record.samples.iter_mut().enumerate() {
        let t = i as f64 / FS;
        *sample += 2.0 * (2.0 * PI * 7.31 * t).sin() + 1.0 * (2.0 * PI * 17.777 * t).cos();
    }
    let plan = plan();
    let estimate = plan.identify(&record).unwrap();
    let orders: Vec<usize> = estimate.modes.iter().map(|m| m.order).collect();
    assert_eq!(orders, [1, 2, 3]);
    let lines: Vec<f64> = estimate
        .evidence
        .resonances
        .iter()
        .filter(|r| r.line)
        .map(|r| r.frequency_hz)
        .collect();
    assert!(
        lines.iter().any(|f| (f - 7.31).abs() < 0.01) && lines.iter().any(|f| (f - 17.777).abs() < 0.01),
        "{lines:?}"
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
    let modes: Vec<SimulatedMode> = [5.0, 15.8]
        .iter()
        .zip(cell.modes())
        .map(|(&frequency_hz, mode)| SimulatedMode { frequency_hz, ..mode })
        .collect();
    let estimate = plan()
        .identify(&simulate(5, FS, 60.0, &modes, 1.0, Excitation::Ambient))
        .unwrap();
    assert_eq!(estimate.modes.iter().map(|m| m.order).collect::<Vec<_>>(), [1, 3]);
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
