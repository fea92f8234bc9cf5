//! Whole replays as users run them: the process, its start, its tables, reading and analysis.
//!
//! 60 s records at 200 Hz, one sample a message or arrays of 100; 10 000 and 1 000 000 draws.
//! Ids: `replay::<layout>` with records x draws as argument.

use divan::Bencher;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_tirante");

/// Records and draws: growth with records, then with draws.
const SIZES: [(usize, usize); 4] = [(10, 10_000), (100, 10_000), (400, 10_000), (100, 1_000_000)];

fn main() {
    divan::main();
}

#[divan::bench(args = SIZES, sample_count = 7, sample_size = 1)]
fn one_sample_a_message(bencher: Bencher, (records, draws): (usize, usize)) {
    bench(bencher, 1, records, draws);
}

#[divan::bench(args = SIZES, sample_count = 7, sample_size = 1)]
fn arrays(bencher: Bencher, (records, draws): (usize, usize)) {
    bench(bencher, 100, records, draws);
}

fn bench(bencher: Bencher, samples_per_message: usize, records: usize, draws: usize) {
    let (config, recording) = simulated(samples_per_message, records);
    bencher.bench_local(|| replay(&config, &recording, draws));
}

fn replay(config: &Path, recording: &Path, draws: usize) {
    let status = Command::new(PROGRAM)
        .arg("replay")
        .arg(recording)
        .arg("--config")
        .arg(config)
        .args(["--draws", &draws.to_string(), "--json", "--threads", "2"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .expect("the program starts");
    assert!(status.success(), "replay: {status}");
}

/// A recording of the paper's rod, written once per layout and size.
fn simulated(samples_per_message: usize, records: usize) -> (PathBuf, PathBuf) {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let folder = FOLDER
        .get_or_init(|| tempfile::tempdir().expect("a temporary folder"))
        .path();
    let name = format!("{samples_per_message}-{records}");
    let config = folder.join(format!("{name}.toml"));
    let recording = folder.join(format!("{name}.mcap"));
    if !recording.exists() {
        std::fs::write(&config, configuration(samples_per_message, records)).expect("a configuration");
        let output = Command::new(PROGRAM)
            .arg("simulate")
            .arg("--config")
            .arg(&config)
            .arg("--out")
            .arg(&recording)
            .output()
            .expect("the program starts");
        assert!(
            output.status.success(),
            "simulate: {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    (config, recording)
}

fn configuration(samples_per_message: usize, records: usize) -> String {
    format!(
        r#"
[[rod]]
id = "bench"
length_m = 14.0
section = "square"
discrepancy = 0.01
[rod.priors]
axial_force_n = {{ mean = 800e3, cv = 0.20 }}
youngs_modulus_pa = {{ mean = 2.0e11, cv = 0.30 }}
density_kg_m3 = {{ mean = 7500, cv = 0.10 }}
side_m = {{ mean = 0.07, cv = 0.10 }}
spring_left_n_m = {{ mean = 400e3, cv = 0.30 }}
spring_right_n_m = {{ mean = 400e3, cv = 0.30 }}
[rod.channel]
topic = "/bench/displacement"
field = "{field}"
unit = "m"
fs_hz = 200.0
[simulation]
start = 2026-01-01T00:00:00Z
records = {records}
interval_s = 3600.0
record_s = 60.0
fs_hz = 200.0
samples_per_message = {samples_per_message}
encoding = "json"
[[simulation.rod]]
id = "bench"
modes = 5
damping = [0.002, 0.002, 0.002, 0.002, 0.002]
ambient_m = 30e-6
[simulation.rod.truth]
axial_force_n = 720e3
youngs_modulus_pa = 1.9e11
density_kg_m3 = 7600
side_m = 0.071
spring_left_n_m = 400e3
spring_right_n_m = 400e3
[simulation.rod.sensor]
at = 0.4
noise_m = 1e-6
"#,
        field = if samples_per_message == 1 {
            "value"
        } else {
            "values"
        }
    )
}
