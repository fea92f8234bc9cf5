//! Whole processes as users start them, side by side with the program of an earlier commit.
//!
//! `BEFORE=PATH cargo bench --bench whole [-- ROW]`: every row runs both programs in turn, `ROUNDS` times (7; the year
//! once), each with a warm cache of its own, and prints medians of wall and processor time, the largest peak of memory, and
//! the ratio to the earlier program as the median of the pairs with their range. Without `BEFORE` this program alone.
//!
//! | row | work |
//! |---|---|
//! | one | `replay` of one record of 60 s at 200 Hz, five modes, arrays of 100, 10 000 draws: the start |
//! | arrays, scalars | the same of 100 records; one sample a message |
//! | million | 100 records, one sample a message, 1 000 000 draws |
//! | rods | 100 rods, no two alike, one record each, 200 000 draws |
//! | year | 8760 records of 60 s at 40 Hz, three modes, store on disk |

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;
use wait4::Wait4 as _;

/// Commands and files of one row.
struct Row {
    name: &'static str,
    rods: usize,
    records: usize,
    samples_per_message: usize,
    fs_hz: f64,
    modes: usize,
    draws: usize,
    is_stored: bool,
    rounds: usize,
}

const ROW: Row = Row {
    name: "one",
    rods: 1,
    records: 1,
    samples_per_message: 100,
    fs_hz: 200.0,
    modes: 5,
    draws: 10_000,
    is_stored: false,
    rounds: 7,
};

const ROWS: [Row; 6] = [
    ROW,
    Row {
        name: "arrays",
        records: 100,
        ..ROW
    },
    Row {
        name: "scalars",
        records: 100,
        samples_per_message: 1,
        ..ROW
    },
    Row {
        name: "million",
        records: 100,
        samples_per_message: 1,
        draws: 1_000_000,
        ..ROW
    },
    Row {
        name: "rods",
        rods: 100,
        draws: 200_000,
        rounds: 3,
        ..ROW
    },
    Row {
        name: "year",
        records: 8760,
        fs_hz: 40.0,
        modes: 3,
        draws: 200_000,
        is_stored: true,
        rounds: 1,
        ..ROW
    },
];

/// Cost of one run: wall and processor time \[s\], peak memory \[MB\].
#[derive(Clone, Copy)]
struct Cost {
    wall_s: f64,
    cpu_s: f64,
    peak_mb: f64,
}

/// A program with its own cache.
struct Program {
    path: PathBuf,
    cache: PathBuf,
}

fn main() {
    let only: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with('-'))
        .collect();
    let rounds: Option<usize> = std::env::var("ROUNDS")
        .ok()
        .map(|text| text.parse().expect("ROUNDS is a number"));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let program = |path: PathBuf, name: &str| Program {
        path,
        cache: folder.path().join(name),
    };
    let ours = program(env!("CARGO_BIN_EXE_tirante").into(), "ours");
    let before = std::env::var_os("BEFORE").map(|path| program(path.into(), "before"));
    for program in before.iter().chain([&ours]) {
        let bytes = fs::metadata(&program.path).expect("a program").len();
        println!("{}: {:.1} MB", program.path.display(), bytes as f64 / 1e6);
    }
    println!(
        "\n| row | wall | CPU | peak | wall before | CPU before | peak before | wall ratio (range) | CPU ratio (range) |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for row in &ROWS {
        if only.is_empty() || only.iter().any(|name| name == row.name) {
            compare(
                row,
                rounds.unwrap_or(row.rounds),
                &ours,
                before.as_ref(),
                folder.path(),
            );
        }
    }
}

/// Runs both programs in turn and prints the row.
fn compare(row: &Row, rounds: usize, ours: &Program, before: Option<&Program>, folder: &Path) {
    let config = folder.join(format!("{}.toml", row.name));
    let recording = folder.join(format!("{}.mcap", row.name));
    fs::write(&config, configuration(row)).expect("a configuration");
    simulate(ours, &config, &recording);
    let mut pairs = Vec::with_capacity(rounds);
    for round in 0..=rounds {
        let theirs = before.map(|program| replay(row, program, &config, &recording, folder));
        let cost = replay(row, ours, &config, &recording, folder);
        // The first round fills the caches.
        if round > 0 || rounds == 1 {
            pairs.push((cost, theirs));
        }
    }
    fs::remove_file(recording).expect("the recording");
    let of = |pick: fn(&Cost) -> f64| median(pairs.iter().map(|pair| pick(&pair.0)).collect());
    let peak = |costs: &mut dyn Iterator<Item = Cost>| costs.map(|cost| cost.peak_mb).fold(0.0, f64::max);
    print!(
        "| {} | {:.3} s | {:.3} s | {:.0} MB |",
        row.name,
        of(|cost| cost.wall_s),
        of(|cost| cost.cpu_s),
        peak(&mut pairs.iter().map(|pair| pair.0)),
    );
    let both: Vec<(Cost, Cost)> = pairs
        .iter()
        .filter_map(|(ours, theirs)| Some((*ours, (*theirs)?)))
        .collect();
    if both.is_empty() {
        println!();
        return;
    }
    print!(
        " {:.3} s | {:.3} s | {:.0} MB |",
        median(both.iter().map(|pair| pair.1.wall_s).collect()),
        median(both.iter().map(|pair| pair.1.cpu_s).collect()),
        peak(&mut both.iter().map(|pair| pair.1)),
    );
    for pick in [|cost: &Cost| cost.wall_s, |cost: &Cost| cost.cpu_s] {
        let ratios: Vec<f64> = both
            .iter()
            .map(|(ours, theirs)| pick(ours) / pick(theirs))
            .collect();
        let least = ratios.iter().copied().fold(f64::INFINITY, f64::min);
        let largest = ratios.iter().copied().fold(0.0, f64::max);
        print!(" {:.2} ({least:.2} to {largest:.2}) |", median(ratios));
    }
    println!();
}

fn simulate(program: &Program, config: &Path, recording: &Path) {
    let output = Command::new(&program.path)
        .arg("simulate")
        .arg("--config")
        .arg(config)
        .arg("--out")
        .arg(recording)
        .output()
        .expect("the program starts");
    assert!(
        output.status.success(),
        "simulate: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}

fn replay(row: &Row, program: &Program, config: &Path, recording: &Path, folder: &Path) -> Cost {
    let store = tempfile::tempdir_in(folder).expect("a temporary folder");
    let mut command = Command::new(&program.path);
    command
        .arg("replay")
        .arg(recording)
        .arg("--config")
        .arg(config)
        .args(["--draws", &row.draws.to_string(), "--json", "--threads", "2"])
        .env("TIRANTE_CACHE_DIR", &program.cache)
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    if row.is_stored {
        command.arg("--store").arg(store.path().join("site.db"));
    }
    let start = Instant::now();
    let ended = command
        .spawn()
        .expect("the program starts")
        .wait4()
        .expect("the program ends");
    let wall_s = start.elapsed().as_secs_f64();
    // 3: some record was refused, which a row of a hundred different rods may have.
    assert!(
        matches!(ended.status.code(), Some(0 | 3)),
        "replay: {}",
        ended.status
    );
    Cost {
        wall_s,
        cpu_s: (ended.rusage.utime + ended.rusage.stime).as_secs_f64(),
        peak_mb: ended.rusage.maxrss as f64 / 1e6,
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Configuration and simulation of a row's rods: the paper's, and others of slightly different length.
fn configuration(row: &Row) -> String {
    let field = if row.samples_per_message == 1 {
        "value"
    } else {
        "values"
    };
    let mut text = String::new();
    for rod in 0..row.rods {
        text += &format!(
            r#"
[[rod]]
id = "rod-{rod}"
length_m = {length}
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
topic = "/rod-{rod}/displacement"
field = "{field}"
unit = "m"
fs_hz = {fs}
"#,
            length = 14.0 + 0.01 * rod as f64,
            fs = row.fs_hz,
        );
    }
    text += &format!(
        r#"
[simulation]
start = 2026-01-01T00:00:00Z
records = {records}
interval_s = 3600.0
record_s = 60.0
fs_hz = {fs}
samples_per_message = {samples}
encoding = "json"
"#,
        records = row.records,
        fs = row.fs_hz,
        samples = row.samples_per_message,
    );
    for rod in 0..row.rods {
        text += &format!(
            r#"
[[simulation.rod]]
id = "rod-{rod}"
modes = {modes}
damping = [{damping}]
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
            modes = row.modes,
            damping = vec!["0.002"; row.modes].join(", "),
        );
    }
    text
}
