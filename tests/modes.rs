//! Natural frequencies and their standard errors against simulated records whose truth is known.

mod simulator;

use rand::RngExt;
use rayon::prelude::*;
use simulator::{SimulatedMode, ambient_sd, simulate};
use std::f64::consts::PI;
use tirante::bayes::RodPrior;
use tirante::beam::exact::Exact;
use tirante::forward::ForwardModel;
use tirante::modes::{ModalPlan, ModeSettings, Pattern, Resonance, label};
use tirante::random;
use tirante::record::{Excitation, Rejection};
use tirante::spectrum::{PeakSettings, WelchSettings};

const TODI: [f64; 3] = [4.492, 9.288, 13.252];
const FS: f64 = 100.0;

/// The paper's rod: draws from its prior through the exact solver.
fn pattern(modes: usize) -> Pattern {
    let prior = RodPrior::todi();
    let exact = Exact::new(*prior.parameterisation());
    let mut rng = random::stream(5, 0);
    let mut theta = vec![0.0; prior.parameterisation().len()];
    let mut rows = Vec::new();
    for _ in 0..4000 {
        prior.sample(&mut rng, &mut theta);
        let mut row = vec![0.0; modes];
        if exact.frequencies(&theta, &mut row).is_ok() {
            rows.extend(row);
        }
    }
    Pattern::new(&rows, modes).unwrap()
}

fn plan() -> ModalPlan {
    ModalPlan::new(WelchSettings::default(), PeakSettings::default(), ModeSettings::default(), pattern(5), vec![0.0; 3])
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
                    Excitation::Ambient => (ambient_sd(frequency_hz, self.damping, self.snr_db + drop_db, 1.0, FS), 0.0),
                    Excitation::FreeDecay => {
                        let pull = 10f64.powf((self.snr_db + drop_db) / 20.0);
                        (self.ambient * pull, pull)
                    }
                };
                SimulatedMode { frequency_hz, damping: self.damping, ambient, pull }
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
                plan.resonances(&record, 2.0, 25.0).unwrap().1
            })
            .collect();
        TODI.iter()
            .map(|&truth| {
                let mut score = Score { repeats: repeats as usize, ..Score::default() };
                let mut sds = Vec::new();
                let mut dampings = Vec::new();
                for found in &all {
                    let nearest = found.iter().min_by(|a, b| {
                        (a.frequency_hz - truth).abs().total_cmp(&(b.frequency_hz - truth).abs())
                    });
                    let Some(r) = nearest.filter(|r| (r.frequency_hz - truth).abs() < 0.5) else { continue };
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
    println!("excitation damping_% seconds snr_db mode found_% lines_% coverage_% binomial rms_z sd/floor damping_%");
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
#[ignore = "campaign"]
fn campaign() {
    let repeats = std::env::var("REPEATS").ok().and_then(|r| r.parse().ok()).unwrap_or(100);
    let mut cells = Vec::new();
    for excitation in [Excitation::Ambient, Excitation::FreeDecay] {
        for seconds in [20.0, 60.0, 200.0, 600.0] {
            for damping in [0.001, 0.003, 0.01, 0.02] {
                let (levels, ambient) = match excitation {
                    Excitation::Ambient => ([25.0, 40.0, 60.0], 0.0),
                    Excitation::FreeDecay => ([6.0, 30.0, 60.0], 0.03),
                };
                for snr_db in levels {
                    cells.push(Cell { excitation, damping, seconds, snr_db, ambient });
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
    }
}

fn labels(frequencies: &[f64]) -> Result<Vec<(usize, f64)>, Rejection> {
    let resonances: Vec<Resonance> = frequencies.iter().map(|&f| resonance(f)).collect();
    let labelling = label(&resonances, &pattern(5), &ModeSettings::default(), &[0.0; 3])?;
    println!("{frequencies:?} {:?} {:.3e}", labelling.probability, labelling.odds);
    Ok(labelling.modes.iter().map(|m| (m.order, m.frequency_hz)).collect())
}

#[test]
fn try_labels() {
    for f in [&TODI[..], &[5.0, 15.8], &[5.0, 10.3], &[5.0], &[10.3, 16.2], &[5.0,10.3,16.2,22.5,29.7], &[3.1,5.0,7.7,10.3,16.2,19.0], &[5.0,13.0], &[4.492,13.252], &[4.492,9.288],
      &[7.0, 14.5], &[6.2,12.9,20.4], &[3.9,8.0,12.3]] {
        println!("{f:?} {:?}", labels(f));
    }
}

#[test]
fn foreign_peaks_alone_are_rarely_labelled() {
    let mut rng = random::stream(11, 0);
    let pattern = pattern(5);
    for count in [1, 2, 3, 5, 8] {
        let mut labelled = 0;
        let mut two = 0;
        for _ in 0..400 {
            let mut f: Vec<f64> = (0..count).map(|_| (2.6f64.ln() + (51.0f64 / 2.6).ln() * rng.random::<f64>()).exp()).collect();
            f.sort_by(f64::total_cmp);
            let resonances: Vec<Resonance> = f.iter().map(|&f| resonance(f)).collect();
            let l = label(&resonances, &pattern, &ModeSettings::default(), &[0.0; 3]);
            labelled += usize::from(l.is_ok());
            two += usize::from(l.is_ok_and(|l| l.modes.len() > 1));
        }
        println!("{count} foreign: {labelled} of 400 labelled, {two} with two or more");
    }
}

#[test]
#[ignore = "debug"]
fn debug_cell() {
    let var = |n: &str, d: f64| std::env::var(n).ok().and_then(|v| v.parse().ok()).unwrap_or(d);
    let excitation = if var("FD", 1.0) > 0.0 { Excitation::FreeDecay } else { Excitation::Ambient };
    let cell = Cell { excitation, damping: var("Z", 0.02), seconds: var("T", 600.0), snr_db: var("SNR", 30.0), ambient: 0.03 };
    let plan = plan();
    let base = (cell.seconds * 1e6 + cell.damping * 1e9 + cell.snr_db * 1e3) as u64 * 100_000;
    for seed in 0..var("N", 20.0) as u64 {
        let record = simulate(base + seed, FS, cell.seconds, &cell.modes(), 1.0, excitation);
        println!("--- {seed}");
        for r in plan.resonances(&record, 2.0, 25.0).unwrap().1 {
            println!("{:.5} sd {:.3e} zeta {:.5} lsd {:.3} ptn {:.3e} ev {:.1} line {}", r.frequency_hz, r.frequency_sd_hz, r.damping, r.damping_log_sd, r.peak_to_noise, r.evidence, r.line);
        }
    }
}
