//! Several sensors of one rod: read, put side by side, identified jointly; dead, swapped and skewed ones.

use crate::program::{Said, tirante};
use serde_json::Value;
use std::sync::Arc;
use tirante::analysis::identify::{Plan, Sensed};
use tirante::analysis::inference::Tables;
use tirante::analysis::lab::synthesis::{Message, Synthesis};
use tirante::analysis::rod::beam::Exact;
use tirante::analysis::signal::record::{Record, RodId, Unit};
use tirante::config::Config;

/// A rod with two lasers and a strain gauge, pulled once.
fn config(further: &str) -> String {
    format!(
        r#"
[emulator]
model = "exact"
[abc]
draws = 20000
accept = {{ quantile = 0.02 }}
[[rod]]
id = "north"
length_m = 14.0
section = "square"
[rod.priors]
axial_force_n = {{ mean = 800e3, cv = 0.2 }}
youngs_modulus_pa = {{ mean = 2e11, cv = 0.05 }}
density_kg_m3 = {{ mean = 7700, cv = 0.03 }}
side_m = {{ mean = 0.07, cv = 0.02 }}
spring_left_n_m = {{ mean = 400e3, cv = 0.3 }}
spring_right_n_m = {{ mean = 400e3, cv = 0.3 }}
[rod.channel]
topic = "/laser/1"
at = 0.4
[[rod.sensor]]
topic = "/laser/2"
at = 0.1
[[rod.sensor]]
topic = "/gauge"
unit = "ue"
at = 0.05
[simulation]
start = 2026-03-01T06:00:00Z
fs_hz = 200
records = 1
record_s = 60
[[simulation.rod]]
id = "north"
[simulation.rod.sensor]
at = 0.4
noise_m = 5e-6
[simulation.rod.pull]
at = 0.3
deflection_m = 0.5e-3
first_s = 0
[simulation.rod.truth]
axial_force_n = 700e3
{further}
"#
    )
}

const BOTH: &str = "[[simulation.rod.further]]\ntopic = \"/laser/2\"\nnoise = 3e-6\n[[simulation.rod.further]]\ntopic = \"/gauge\"\nnoise = 2e-7\n";

/// Simulates with one configuration and identifies with another.
fn identified(simulated: &str, read: &str) -> (Said, Vec<Value>) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("made.toml"), simulated).unwrap();
    std::fs::write(folder.path().join("read.toml"), read).unwrap();
    tirante(&folder, "simulate --config made.toml --out pull.mcap").done();
    let said = tirante(&folder, "identify pull.mcap --config read.toml --json");
    let rows = said.lines();
    (said, rows)
}

#[test]
fn sensors_of_one_rod_are_identified_jointly() {
    let text = config(BOTH);
    let (said, rows) = identified(&text, &text);
    said.done();
    let [row] = &rows[..] else { panic!("{rows:?}") };
    let number = |key: &str| row["axial_force_n"][key].as_f64().unwrap();
    let (mean, sd) = (number("mean"), number("sd"));
    assert!((mean - 700e3).abs() < 4.0 * sd, "{mean} +- {sd}");
    let shapes = row["tested"]["shapes"].as_array().unwrap();
    // Two sensors beside the first, three modes.
    assert_eq!(shapes.len(), 6, "{shapes:?}");
    let ratio = |order: u64, at: f64| {
        let shape = shapes
            .iter()
            .find(|s| s["order"] == order && s["at"].as_f64() == Some(at))
            .unwrap();
        shape["ratio"].as_f64().unwrap()
    };
    // Between hinges and clamps: sin(n pi 0.1) / sin(n pi 0.4) with its sign, to the supports' part of it.
    assert!(ratio(1, 0.1) > 0.1 && ratio(1, 0.1) < 0.4);
    assert!(ratio(2, 0.1) > 0.3 && ratio(3, 0.1) < -0.5);
    for conflict in row["tested"]["conflicts"].as_array().unwrap() {
        assert!(conflict["score"].as_f64().unwrap() < 4.0, "{conflict}");
    }
}

#[test]
fn a_sensor_that_died_leaves_the_others() {
    // The second laser was never heard; then the first.
    let gauge = "[[simulation.rod.further]]\ntopic = \"/gauge\"\nnoise = 2e-7\n";
    let (said, rows) = identified(&config(gauge), &config(gauge));
    said.ends(3).says(&["/laser/2"]);
    assert_eq!(rows[0]["tested"]["shapes"].as_array().unwrap().len(), 3);
    let silent = config(BOTH).replace("topic = \"/laser/1\"", "topic = \"/laser/0\"");
    let (said, rows) = identified(&config(BOTH), &silent);
    said.ends(3).says(&["/laser/0"]);
    let mean = rows[0]["axial_force_n"]["mean"].as_f64().unwrap();
    let sd = rows[0]["axial_force_n"]["sd"].as_f64().unwrap();
    assert!((mean - 700e3).abs() < 4.0 * sd, "{mean} +- {sd}");
}

#[test]
fn swapped_sensors_are_refused_by_name_or_conflict() {
    let swapped = config(BOTH)
        .replace("/laser/1", "/laser/x")
        .replace("/laser/2", "/laser/1")
        .replace("/laser/x", "/laser/2");
    let (said, rows) = identified(&config(BOTH), &swapped);
    let refused = rows[0]["rejection"]["detail"]
        .as_str()
        .unwrap_or_default()
        .contains("amplitude");
    let scores = rows[0]["tested"]["conflicts"].as_array();
    let worst = scores.map_or(0.0, |all| {
        all.iter().filter_map(|c| c["score"].as_f64()).fold(0.0, f64::max)
    });
    assert!(refused || worst > 3.0, "{said:?}");
}

#[test]
fn a_place_beyond_the_ends_or_left_out_is_a_fault_of_the_configuration() {
    for (from, to, wanted) in [
        ("at = 0.1\n", "at = 1.1\n", "out of range"),
        ("at = 0.1\n", "at = 1.0\n", "support"),
        (
            "topic = \"/laser/1\"\nat = 0.4\n",
            "topic = \"/laser/1\"\n",
            "at is wanted",
        ),
        (
            "topic = \"/laser/2\"",
            "topic = \"/laser/1\"",
            "channel of the rod",
        ),
    ] {
        let text = config("").replacen(from, to, 1);
        let error = Config::parse(&text, "test").unwrap_err().to_string();
        assert!(error.contains(wanted), "{to}: {error}");
    }
}

/// Noise of the sensors alone: what scatters the motion itself, an ambient load, all sensors see alike.
#[test]
#[ignore = "campaign: 60 pulls, identified three times each, minutes of CPU; run with --ignored --nocapture"]
fn frequencies_of_several_sensors_are_better_than_of_the_best() {
    let text = config(BOTH)
        .replace(
            "id = \"north\"\n[simulation",
            "id = \"north\"\nambient_m = 1e-7\n[simulation",
        )
        .replace("noise_m = 5e-6", "noise_m = 2e-5")
        .replace("noise = 3e-6", "noise = 1.6e-5");
    let config = Config::parse(&text, "test").unwrap();
    let rod = &config.rods[0];
    let model = Arc::new(Exact::new(*rod.analysis.prior.parameterisation()));
    let plan = Plan::new(rod.analysis.clone(), model, &Tables::new(1)).unwrap();
    let simulation = &config.simulation.as_ref().unwrap().simulation;
    let record = |messages: &[Message]| Record {
        rod: RodId("north".to_owned()),
        start: messages[0].stamp,
        fs_hz: 200.0,
        samples: messages
            .iter()
            .flat_map(|message| message.samples.clone())
            .collect(),
        temperature_c: None,
        readings: Vec::new(),
        excitation: None,
        clock_sd: 0.0,
        flags: Vec::new(),
    };
    // Squared errors of modes 1 to 3 by the first, the second and both; and squared scores of both.
    let (mut errors, mut scores, mut used) = ([0.0; 3], Vec::new(), 0);
    for seed in 0..60 {
        let made = Synthesis::new(simulation, seed).record(0, 0).unwrap();
        let records = [record(&made.displacement), record(&made.further[0])];
        let sensed = [0, 1].map(|i| Sensed {
            at: rod.analysis.sensors[i].at,
            at_sd_m: rod.analysis.sensors[i].at_sd_m,
            unit: Unit::Metre,
            gain_sd: 0.01,
            record: &records[i],
        });
        let alone = [0, 1].map(|i| plan.run_array(&sensed[i..=i]).outcome);
        let both = plan.run_array(&sensed).outcome.unwrap();
        let [Ok(first), Ok(second)] = alone else { continue };
        used += 1;
        for mode in &both.modes {
            let of = |modes: &[tirante::analysis::signal::modes::Mode]| {
                modes
                    .iter()
                    .find(|m| m.order == mode.order)
                    .map(|m| m.frequency_hz)
            };
            let truth = made.truth.frequency_hz[mode.order - 1];
            let (Some(a), Some(b)) = (of(&first.modes), of(&second.modes)) else {
                continue;
            };
            for (sum, f) in errors.iter_mut().zip([a, b, mode.frequency_hz]) {
                *sum += ((f - truth) / mode.sd_hz).powi(2);
            }
            scores.push(((mode.frequency_hz - truth) / mode.sd_hz).powi(2));
        }
    }
    let count = scores.len() as f64;
    let mean = scores.iter().sum::<f64>() / count;
    eprintln!("{used} pulls, {count} frequencies: squared errors {errors:?}, mean squared score {mean:.2}");
    assert!(used >= 50 && count >= 100.0);
    assert!(errors[2] < errors[0].min(errors[1]), "{errors:?}");
    // Standard errors are not too small.
    assert!(mean < 1.5, "{mean}");
}
