//! Natural frequencies and their standard errors against simulated records whose truth is known.

mod simulator;

use rayon::prelude::*;
use simulator::{SimulatedMode, ambient_sd, simulate};
use std::f64::consts::PI;
use tirante::modes::{Resonance, refine};
use tirante::record::{Excitation, Record};
use tirante::spectrum::{PeakSettings, Transforms, Welch, WelchSettings, pick_peaks};

const TODI: [f64; 3] = [4.492, 9.288, 13.252];
const FS: f64 = 100.0;

fn resonances(transforms: &Transforms, record: &Record) -> Vec<Resonance> {
    let settings = WelchSettings::default();
    let nperseg = settings.nperseg(record.fs_hz, record.samples.len());
    let welch = Welch::plan_with(transforms, record.fs_hz, nperseg, settings.noverlap(nperseg), settings.window).unwrap();
    let spectrum = welch.run(&record.samples).unwrap();
    let peaks = pick_peaks(&spectrum, &PeakSettings::default(), 2.0, 25.0);
    refine(transforms, record, &peaks, &[], spectrum.df_hz).resonances
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
        let transforms = Transforms::default();
        let all: Vec<Vec<Resonance>> = (0..repeats)
            .into_par_iter()
            .map(|seed| resonances(&transforms, &simulate(seed + 1000, FS, self.seconds, &modes, 1.0, self.excitation)))
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
