//! Peaks of simulated rods whose orders are known: exact frequencies, independent perturbations, no spectra.

#![allow(dead_code, reason = "each user takes the part it needs")]

use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::f64::consts::PI;
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::{Parameterisation, Section, exact};
use tirante::analysis::rod::fixity::Fixity;
use tirante::analysis::rod::prior::{Prior, RodPrior};
use tirante::analysis::signal::modes::{LabelPlan, ModeSettings, MotionKind, Resonance};

/// Class of a record's peaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// This many modes are clear of the noise.
    Visible(usize, usize),
    FirstMissing,
    MidSpan,
    Holes,
    Foreign(usize),
    Neighbour,
    Harmonics,
    Slack,
    Slender,
    Stocky,
    NoRod,
    AnotherRod,
    /// Orders 2, 6 and 8 alone.
    Odd,
}

pub const CLASSES: [Class; 19] = [
    Class::Visible(2, 2),
    Class::Visible(3, 3),
    Class::Visible(5, 5),
    Class::Visible(8, 9),
    Class::Visible(10, 12),
    Class::FirstMissing,
    Class::MidSpan,
    Class::Holes,
    Class::Foreign(1),
    Class::Foreign(2),
    Class::Foreign(4),
    Class::Neighbour,
    Class::Harmonics,
    Class::Slack,
    Class::Slender,
    Class::Stocky,
    Class::NoRod,
    Class::AnotherRod,
    Class::Odd,
];

/// Prior knowledge of the rod.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Knowledge {
    /// Prior as written by `init`: any force up to 300 MPa, any support.
    FirstContact,
    /// A force known to 20 %, supports to 30 %.
    Known,
}

/// One record: its peaks and their true orders.
pub struct World {
    pub prior: RodPrior,
    pub peaks: Vec<Resonance>,
    /// Order of each peak; `None` for a foreign one.
    pub truth: Vec<Option<usize>>,
    pub limit_hz: f64,
    pub force_n: f64,
    /// The rod's natural frequencies \[Hz\].
    pub frequencies: [f64; 12],
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

fn log_between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low * (high / low).powf(rng.random::<f64>())
}

struct Rod {
    theta: [f64; 7],
    prior: RodPrior,
    frequencies: [f64; 12],
}

fn rod(class: Class, knowledge: Knowledge, rng: &mut ChaCha8Rng) -> Rod {
    let diameter = log_between(rng, 0.02, 0.08);
    let slenderness = match class {
        Class::Slender => log_between(rng, 300.0, 700.0),
        Class::Stocky => log_between(rng, 30.0, 70.0),
        _ => log_between(rng, 80.0, 300.0),
    };
    let length = slenderness * diameter;
    let stress = match class {
        Class::Slack => log_between(rng, 6.5e6, 15e6),
        _ => log_between(rng, 15e6, 200e6),
    };
    let area = PI / 4.0 * diameter * diameter;
    let force = stress * area;
    let (modulus, density) = (190e9, 7650.0);
    let bending = modulus * PI / 64.0 * diameter.powi(4) / length;
    let fixity = |rng: &mut ChaCha8Rng| {
        let share: f64 = between(rng, 0.0, 0.95);
        bending * 10.0 * share / (1.0 - share)
    };
    let springs = [fixity(rng), fixity(rng)];
    let theta = [
        force,
        modulus * (1.0 + 0.1 * normal(rng)),
        density * (1.0 + 0.03 * normal(rng)),
        diameter * (1.0 + 0.02 * normal(rng)),
        springs[0],
        springs[1],
        length,
    ];
    let about = |mean: f64, cv: f64| Prior::TruncatedNormal { mean, sd: cv * mean };
    let any_spring = Prior::Fixity(Fixity {
        low: 0.0,
        high: 0.95,
        ends: 1.0,
        unit_n_m: 3.0 * bending,
    });
    let (of_force, of_springs) = match knowledge {
        Knowledge::FirstContact => {
            let high = 300e6 * area;
            (
                Prior::LogUniform {
                    low: 0.01 * high,
                    high,
                },
                [any_spring; 2],
            )
        }
        Knowledge::Known => (
            about(force * (1.0 + 0.2 * normal(rng)).max(0.3), 0.2),
            springs.map(|k| about((k * (1.0 + 0.3 * normal(rng)).max(0.2)).max(0.1 * bending), 0.3)),
        ),
    };
    let priors = vec![
        of_force,
        about(modulus, 0.1),
        about(density, 0.03),
        about(diameter, 0.02),
        of_springs[0],
        of_springs[1],
        Prior::Fixed { value: length },
    ];
    let parameterisation = Parameterisation::new(Section::Round);
    let mut frequencies = [0.0; 12];
    exact::frequencies(&parameterisation.beam(&theta), &mut frequencies).unwrap();
    Rod {
        theta,
        prior: RodPrior::new(parameterisation, priors).unwrap(),
        frequencies,
    }
}

fn resonance(frequency_hz: f64, relative_sd: f64, level_db: f64, damping: f64) -> Resonance {
    Resonance {
        frequency_hz,
        frequency_sd_hz: relative_sd * frequency_hz,
        damping,
        damping_log_sd: 0.2,
        peak_to_noise: 10f64.powf(level_db / 10.0),
        evidence: 10.0 * level_db,
        line: false,
        misfit: 0.0,
        foreign_log_odds: 0.0,
    }
}

/// Record number `seed` of a class.
pub fn world(class: Class, knowledge: Knowledge, seed: u64) -> World {
    let name = format!("{class:?} {knowledge:?}");
    let mut rng = random::stream(random::seed(&[b"labels", name.as_bytes()]), seed);
    let rng = &mut rng;
    let mut dampings = random::stream(random::seed(&[b"dampings", name.as_bytes()]), seed);
    // Modes of one rod (and of one neighbour) are damped alike within a third, other things each in their own way.
    let [own, neighbours] = [(); 2].map(|()| log_between(&mut dampings, 7e-4, 0.012));
    let mut alike = |usual: f64| usual * (0.3 * normal(&mut dampings)).exp();
    let mut other = random::stream(random::seed(&[b"other dampings", name.as_bytes()]), seed);
    let mut any = || log_between(&mut other, 0.002, 0.02);
    loop {
        let rod = rod(class, knowledge, rng);
        let place = match class {
            Class::MidSpan => 0.5 + 0.004 * normal(rng),
            _ => between(rng, 0.06, 0.46),
        };
        let shape = |order: usize| (order as f64 * PI * place).sin().abs();
        let seen: Vec<usize> = (1..=12).filter(|&order| shape(order) > 0.25).collect();
        let count = between(rng, 3.0, 8.0) as usize;
        let mut orders: Vec<usize> = match class {
            Class::Visible(low, high) => {
                let count = low + (rng.random::<f64>() * (high - low + 1) as f64) as usize;
                seen.iter().copied().take(count).collect()
            }
            Class::FirstMissing => seen
                .iter()
                .copied()
                .filter(|&order| order > 1)
                .take(count)
                .collect(),
            Class::MidSpan => seen.iter().copied().take(count.min(5)).collect(),
            Class::Holes => {
                let mut all: Vec<usize> = (1..=between(rng, 6.0, 10.0) as usize).collect();
                for _ in 0..3 {
                    let gone = (rng.random::<f64>() * all.len() as f64) as usize;
                    all.remove(gone);
                }
                all
            }
            Class::NoRod | Class::AnotherRod => Vec::new(),
            Class::Odd => vec![2, 6, 8],
            _ => seen.iter().copied().take(count).collect(),
        };
        if let Class::Visible(low, _) = class
            && orders.len() < low
        {
            continue;
        }
        orders.sort_unstable();
        let low_hz = 0.4 * rod.frequencies[0];
        let last_hz = orders
            .last()
            .map_or(rod.frequencies[5], |&order| rod.frequencies[order - 1]);
        let limit_hz = last_hz * log_between(rng, 1.03, 2.5);
        let scatter = [0.001, 0.003, 0.01][(rng.random::<f64>() * 3.0) as usize];
        let mut found: Vec<(Resonance, Option<usize>)> = Vec::new();
        let error = |rng: &mut ChaCha8Rng| log_between(rng, 2e-4, 3e-3);
        for &order in &orders {
            let sd = error(rng);
            let hz = rod.frequencies[order - 1] * (scatter * normal(rng) + sd * normal(rng)).exp();
            let level = 42.0 - 1.5 * order as f64 + 5.0 * normal(rng) + 20.0 * shape(order).max(0.1).log10();
            found.push((resonance(hz, sd, level.max(12.0), alike(own)), Some(order)));
        }
        let foreign = match class {
            Class::Foreign(count) => count,
            Class::NoRod => 1 + (rng.random::<f64>() * 6.0) as usize,
            _ => 0,
        };
        for _ in 0..foreign {
            let hz = log_between(rng, low_hz, limit_hz.max(1.5 * low_hz));
            let level = between(rng, 15.0, 45.0);
            found.push((resonance(hz, error(rng), level, any()), None));
        }
        match class {
            Class::Neighbour => {
                let factor =
                    1.0 + [-1.0, 1.0][(rng.random::<f64>() * 2.0) as usize] * between(rng, 0.03, 0.2);
                let count = 1 + (rng.random::<f64>() * 3.0) as usize;
                for order in seen.iter().copied().take(count) {
                    let hz = rod.frequencies[order - 1] * factor * (0.005 * normal(rng)).exp();
                    let level = between(rng, 15.0, 35.0);
                    found.push((resonance(hz, error(rng), level, alike(neighbours)), None));
                }
            }
            Class::Harmonics => {
                let (first, first_db) = match found.first() {
                    Some((r, _)) => (r.frequency_hz, 10.0 * r.peak_to_noise.log10()),
                    None => continue,
                };
                for multiple in [2.0, 3.0] {
                    let level = (first_db - between(rng, 8.0, 20.0)).max(10.0);
                    found.push((
                        resonance(
                            multiple * first * (1.0 + 3e-4 * normal(rng)),
                            3e-4,
                            level,
                            alike(own),
                        ),
                        None,
                    ));
                }
            }
            Class::AnotherRod => {
                let other = self::rod(Class::Visible(3, 3), Knowledge::FirstContact, rng);
                let count = 2 + (rng.random::<f64>() * 4.0) as usize;
                for order in 1..=count {
                    let sd = error(rng);
                    let hz = other.frequencies[order - 1] * (0.003 * normal(rng)).exp();
                    found.push((
                        resonance(hz, sd, between(rng, 20.0, 40.0), alike(neighbours)),
                        None,
                    ));
                }
            }
            _ => {}
        }
        found.sort_by(|a, b| a.0.frequency_hz.total_cmp(&b.0.frequency_hz));
        // Nearer than 0.7 % a record shows one peak, the stronger.
        let mut apart: Vec<(Resonance, Option<usize>)> = Vec::new();
        for peak in found.into_iter().filter(|(r, _)| r.frequency_hz < limit_hz) {
            match apart.last_mut() {
                Some(last) if peak.0.frequency_hz < 1.007 * last.0.frequency_hz => {
                    if peak.0.peak_to_noise > last.0.peak_to_noise {
                        *last = peak;
                    }
                }
                _ => apart.push(peak),
            }
        }
        if apart.is_empty() {
            continue;
        }
        let (peaks, truth) = apart.into_iter().unzip();
        return World {
            prior: rod.prior,
            peaks,
            truth,
            limit_hz,
            force_n: rod.theta[0],
            frequencies: rod.frequencies,
        };
    }
}

/// Results for the records of a class.
#[derive(Debug, Clone, Default)]
pub struct Score {
    pub records: usize,
    pub identified: usize,
    /// Number of records with every reported order right.
    pub right: usize,
    /// Number of records with right orders beside a foreign peak.
    pub intruders: usize,
    /// Number of records with a true mode under a wrong order.
    pub wrong: usize,
    /// Number of records in which the likeliest candidate's interval holds the true force.
    pub covered: usize,
    /// Stated probability of every record identified, with true if all orders were right.
    pub stated: Vec<(f64, bool)>,
}

/// Labels records of a class; the settings hold for all.
pub fn score(class: Class, knowledge: Knowledge, records: u64, settings: &ModeSettings) -> Score {
    let one = |seed: u64| {
        let world = world(class, knowledge, seed);
        let plan = LabelPlan::new(&world.prior, &[0.01], settings.clone()).unwrap();
        let labelled = plan.label(&world.peaks, (0.0, world.limit_hz), MotionKind::Ambient);
        labelled.ok().map(|labelling| {
            let told: Vec<Option<bool>> = labelling
                .modes
                .iter()
                .map(|mode| {
                    let i = world
                        .peaks
                        .iter()
                        .position(|r| r.frequency_hz == mode.frequency_hz)
                        .unwrap();
                    world.truth[i].map(|order| order == mode.order)
                })
                .collect();
            let [low, _, high] = labelling.labels.candidates[0].axial_force_n.unwrap();
            let covered = (low..=high).contains(&world.force_n);
            (told, labelling.labels.probability, covered)
        })
    };
    let all: Vec<_> = (0..records).into_par_iter().map(one).collect();
    let mut score = Score {
        records: records as usize,
        ..Score::default()
    };
    for (told, probability, covered) in all.into_iter().flatten() {
        score.identified += 1;
        score.covered += usize::from(covered);
        let wrong = told.contains(&Some(false));
        let intruder = told.contains(&None);
        score.wrong += usize::from(wrong);
        score.intruders += usize::from(intruder && !wrong);
        score.right += usize::from(!intruder && !wrong);
        score.stated.push((probability, !intruder && !wrong));
    }
    score
}

/// One line per class, and the calibration of the stated probability.
pub fn table(knowledge: Knowledge, records: u64, settings: &ModeSettings, classes: &[Class]) {
    println!(
        "class identified_% right_% intruder_per_1000 wrong_per_1000 covered_% ({knowledge:?}, {records} records)"
    );
    let mut stated = Vec::new();
    for &class in classes {
        let score = score(class, knowledge, records, settings);
        let share = |count: usize| count as f64 / score.records as f64;
        println!(
            "{:22} {:5.1} {:5.1} {:6.1} {:6.1} {:5.1}",
            format!("{class:?}"),
            100.0 * share(score.identified),
            100.0 * share(score.right),
            1000.0 * share(score.intruders),
            1000.0 * share(score.wrong),
            100.0 * score.covered as f64 / score.identified.max(1) as f64,
        );
        if !matches!(class, Class::NoRod | Class::AnotherRod) {
            stated.extend(score.stated);
        }
    }
    for (low, high) in [
        (0.0, 0.5),
        (0.5, 0.8),
        (0.8, 0.9),
        (0.9, 0.95),
        (0.95, 0.98),
        (0.98, 0.99),
        (0.99, 0.999),
        (0.999, 1.1),
    ] {
        let bin: Vec<&(f64, bool)> = stated.iter().filter(|(p, _)| (low..high).contains(p)).collect();
        if !bin.is_empty() {
            let mean = bin.iter().map(|(p, _)| p).sum::<f64>() / bin.len() as f64;
            let right = bin.iter().filter(|(_, right)| *right).count() as f64 / bin.len() as f64;
            println!(
                "stated {low} to {high}: {} records, mean {mean:.3}, right {right:.3}",
                bin.len()
            );
        }
    }
}
