//! Coverage of the whole program: rods drawn from their prior, simulated into recordings, replayed by the
//! binary; its 95 % intervals must hold the true frequencies and the true force.
//!
//! The campaign behind `docs/validation.md`:
//! `RODS=1600 cargo test --release --test independent end_to_end:: -- --ignored --nocapture`
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use assert_cmd::Command;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use tirante::analysis::numerics::random;

const SECTIONS: [&str; 4] = ["square", "round", "rectangle", "direct"];

/// One rod: its design cycles through sections, excitations and numbers of modes.
struct Case {
    section: &'static str,
    pull: bool,
    modes: usize,
    config: String,
}

impl Case {
    /// Rod `index`: nominal values at random, the truth drawn from the prior around them.
    fn draw(index: usize) -> Self {
        let mut generator = random::stream(random::seed(&[b"end to end"]), index as u64);
        let section = SECTIONS[index % 4];
        let pull = (index / 4) % 2 == 1;
        let modes = if (index / 8).is_multiple_of(2) { 3 } else { 2 };
        let mut between = |low: f64, high: f64| low + (high - low) * generator.random::<f64>();
        let length = between(6.0, 16.0);
        let side = between(0.03, 0.08);
        let force = between(60e6, 180e6) * side * side;
        let damping = 10f64.powf(between(-3.0, -2.0));
        let ambient = 10f64.powf(between(-5.3, -4.3));
        let sensor = between(0.25, 0.45);
        let record_s = if pull {
            65
        } else {
            [60, 120, 300, 600][between(0.0, 4.0) as usize]
        };
        let (modulus, density): (f64, f64) = (2.0e11, 7700.0);
        let rigidity = modulus * side.powi(4) / 12.0;
        let stiffest = 20.0 * rigidity / length;
        let springs = [between(0.0, stiffest), between(0.0, stiffest)];
        let material = [
            ("youngs_modulus_pa", modulus, 0.08),
            ("density_kg_m3", density, 0.03),
        ];
        let mut known = vec![("axial_force_n", force, 0.25)];
        match section {
            "square" => known.push(("side_m", side, 0.03)),
            "round" => known.push(("diameter_m", 1.1 * side, 0.03)),
            "rectangle" => known.extend([("width_m", 0.7 * side, 0.03), ("height_m", 1.3 * side, 0.03)]),
            _ => known.extend([
                ("flexural_rigidity_n_m2", rigidity, 0.15),
                ("mass_per_length_kg_m", density * side * side, 0.06),
            ]),
        }
        if section != "direct" {
            known.extend(material);
        }
        let (mut priors, mut truth) = (String::new(), String::new());
        for (key, mean, cv) in known {
            let value = loop {
                let z: f64 = StandardNormal.sample(&mut generator);
                if 1.0 + cv * z > 0.0 {
                    break mean * (1.0 + cv * z);
                }
            };
            writeln!(priors, "{key} = {{ mean = {mean:?}, cv = {cv:?} }}").unwrap();
            writeln!(truth, "{key} = {value:?}").unwrap();
        }
        for (key, value) in ["spring_left_n_m", "spring_right_n_m"].iter().zip(springs) {
            writeln!(priors, "{key} = {{ low = 0, high = {stiffest:?} }}").unwrap();
            writeln!(truth, "{key} = {value:?}").unwrap();
        }
        let (cut, loading) = if pull {
            (
                "free-decay",
                "[simulation.rod.pull]\nkind = \"release\"\nat = 0.3\ndeflection_m = 0.5e-3\nfirst_s = 5.0",
            )
        } else {
            ("file", "")
        };
        let config = format!(
            r#"
[site]
seed = {seed}
[[rod]]
id = "rod"
length_m = {length:?}
section = "{section}"
discrepancy = 0.0
[rod.priors]
{priors}
[rod.channel]
topic = "/rod"
field = "values"
unit = "um"
fs_hz = 200.0
[modes]
count = {modes}
[record]
cut = "{cut}"
[simulation]
record_s = {record_s}.0
fs_hz = 200.0
samples_per_message = 200
encoding = "protobuf"
[[simulation.rod]]
id = "rod"
damping = {damping:?}
ambient_m = {ambient:?}
[simulation.rod.truth]
{truth}
[simulation.rod.sensor]
at = {sensor:?}
{loading}
"#,
            seed = index + 1
        );
        Self {
            section,
            pull,
            modes,
            config,
        }
    }

    /// The truth and the program's answer, both as JSON.
    fn run(&self, folder: &Path) -> (Value, Value) {
        fs::write(folder.join("rod.toml"), &self.config).unwrap();
        let tirante = |arguments: &[&str]| {
            let mut command = Command::cargo_bin("tirante").unwrap();
            let output = command
                .current_dir(folder)
                .env("TIRANTE_CACHE_DIR", folder)
                .args(arguments)
                .args(["--config", "rod.toml"])
                .output()
                .unwrap();
            // 3: a rejected record, which the caller counts.
            let code = output.status.code();
            assert!(
                matches!(code, Some(0 | 3)),
                "{}",
                String::from_utf8_lossy(&output.stderr)
            );
            output.stdout
        };
        let files = ["--out", "rod.mcap", "--truth", "truth.jsonl", "--force"];
        tirante(&[&["simulate"], &files[..]].concat());
        let truth = serde_json::from_slice(&fs::read(folder.join("truth.jsonl")).unwrap()).unwrap();
        let answer = tirante(&["replay", "rod.mcap", "--json"]);
        (truth, serde_json::from_slice(&answer).unwrap())
    }
}

/// Results of a group of rods.
#[derive(Default)]
struct Score {
    rods: usize,
    refused: usize,
    modes_missing: usize,
    frequencies: usize,
    frequencies_held: usize,
    mislabelled: usize,
    forces_held: usize,
    /// Tenths of the posterior (as a normal) in which the true force lies.
    ranks: [usize; 10],
}

impl Score {
    fn add(&mut self, case: &Case, truth: &Value, answer: &Value) {
        self.rods += 1;
        if !answer["rejection"].is_null() {
            self.refused += 1;
            return;
        }
        let found = answer["modes"].as_array().unwrap();
        self.modes_missing += case.modes - found.len();
        for mode in found {
            let order = mode["order"].as_u64().unwrap() as usize;
            let wanted = truth["frequency_hz"][order - 1].as_f64().unwrap();
            let (f, sd) = (
                mode["frequency_hz"].as_f64().unwrap(),
                mode["sd_hz"].as_f64().unwrap(),
            );
            self.frequencies += 1;
            self.frequencies_held += usize::from((f - wanted).abs() < 1.96 * sd);
            self.mislabelled += usize::from((f / wanted - 1.0).abs() > 0.05);
        }
        let force = truth["axial_force_n"].as_f64().unwrap();
        let said = |key: &str| answer["axial_force_n"][key].as_f64().unwrap();
        self.forces_held += usize::from((said("q025")..=said("q975")).contains(&force));
        let z = (force - said("mean")) / said("sd");
        let rank = 0.5 * (1.0 + statrs::function::erf::erf(z / 2f64.sqrt()));
        self.ranks[((10.0 * rank) as usize).min(9)] += 1;
    }

    fn identified(&self) -> usize {
        self.rods - self.refused
    }

    fn force_coverage(&self) -> f64 {
        self.forces_held as f64 / self.identified() as f64
    }

    fn frequency_coverage(&self) -> f64 {
        self.frequencies_held as f64 / self.frequencies as f64
    }

    fn row(&self, name: &str) -> String {
        format!(
            "| {name} | {} | {} | {} | {} | {:.1} | {} | {:.1} | {} |",
            self.rods,
            self.refused,
            self.frequencies,
            self.modes_missing,
            100.0 * self.frequency_coverage(),
            self.mislabelled,
            100.0 * self.force_coverage(),
            self.ranks.map(|count| count.to_string()).join(" ")
        )
    }
}

fn judge(rods: usize) -> Vec<(String, Score)> {
    use rayon::prelude::*;
    let results: Vec<(Case, Value, Value)> = (0..rods)
        .into_par_iter()
        .map(|index| {
            let folder = tempfile::tempdir().unwrap();
            let case = Case::draw(index);
            let (truth, answer) = case.run(folder.path());
            (case, truth, answer)
        })
        .collect();
    let group = |name: &str, belongs: &dyn Fn(&Case) -> bool| {
        let mut score = Score::default();
        for (case, truth, answer) in results.iter().filter(|(case, ..)| belongs(case)) {
            score.add(case, truth, answer);
        }
        (name.to_owned(), score)
    };
    let mut groups = vec![group("all", &|_| true)];
    for section in SECTIONS {
        groups.push(group(section, &|case| case.section == section));
    }
    groups.push(group("ambient", &|case| !case.pull));
    groups.push(group("pull", &|case| case.pull));
    groups.push(group("2 modes", &|case| case.modes == 2));
    groups.push(group("3 modes", &|case| case.modes == 3));
    groups
}

#[test]
fn a_few_rods_are_identified_and_their_intervals_hold_the_truth() {
    let rods = 32;
    let groups = judge(rods);
    let (_, all) = &groups[0];
    // Fixed seeds: this either always holds or never. Of 32 forces at 95 % fewer than 26 are held once in 10^4.
    assert!(all.refused <= 3 && all.mislabelled == 0, "{}", all.row("all"));
    assert!(all.forces_held + all.refused >= 26, "{}", all.row("all"));
    assert!(all.frequency_coverage() > 0.85, "{}", all.row("all"));
}

#[test]
#[ignore = "campaign: 1600 rods take 4 minutes; RODS=1600 cargo test --release --test independent end_to_end:: -- --ignored --nocapture"]
fn campaign() {
    let rods = std::env::var("RODS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(400);
    let groups = judge(rods);
    println!(
        "| rods | drawn | refused | frequencies | modes missing | held % | mislabelled | forces held % | ranks of the true force |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (name, score) in &groups {
        println!("{}", score.row(name));
    }
    let (_, all) = &groups[0];
    assert_eq!(all.mislabelled, 0);
    assert!((0.93..=0.97).contains(&all.force_coverage()));
    assert!((0.93..=0.97).contains(&all.frequency_coverage()));
}
