//! A site of two rods, simulated into recordings by the real binary and replayed by it.

#![allow(clippy::unwrap_used, dead_code)] // helpers of tests are tests; not every test uses all of them

pub mod rods;

use rods::{RESTRAINED, simulated_rod};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use tirante::analysis::signal::record::Timestamp;
use tirante::site::store::Reader;

/// Two rods, a baseline and learning as short as they may be; a tenth of the usual draws, which every start simulates anew.
pub const SITE: &str = r#"
[site]
name = "Two rods"
seed = 11

[[rod]]
id = "north"
length_m = 8.0
section = "round"
[rod.priors]
axial_force_n = { mean = 150e3, cv = 0.2 }
youngs_modulus_pa = { mean = 2.0e11, cv = 0.05 }
density_kg_m3 = { mean = 7800, cv = 0.01 }
diameter_m = { mean = 0.04, cv = 0.01 }
spring_left_n_m = { low = 0, high = 100e3 }
spring_right_n_m = { low = 0, high = 100e3 }
[rod.channel]
topic = "/north"
field = "values"
unit = "m"
fs_hz = 100.0
[rod.temperature]
topic = "/air"
unit = "degC"

[[rod]]
id = "south"
length_m = 8.0
section = "round"
[rod.priors]
axial_force_n = { mean = 150e3, cv = 0.2 }
youngs_modulus_pa = { mean = 2.0e11, cv = 0.05 }
density_kg_m3 = { mean = 7800, cv = 0.01 }
diameter_m = { mean = 0.04, cv = 0.01 }
spring_left_n_m = { low = 0, high = 100e3 }
spring_right_n_m = { low = 0, high = 100e3 }
[rod.channel]
topic = "/south"
field = "values"
unit = "m"
fs_hz = 100.0
[rod.temperature]
topic = "/air"
unit = "degC"

[abc]
draws = 20000

[track]
baseline_records = 10
learning_periods = 14
particles = 256
"#;

const DAY_NS: i64 = 86_400_000_000_000;

/// Noon of a day of the campaign.
pub fn noon(day: i64) -> Timestamp {
    Timestamp::from_nanos(1_767_268_800_000_000_000 + day * DAY_NS)
}

/// One recording: a record a day.
#[derive(Clone)]
pub struct Part {
    pub first_day: i64,
    pub days: usize,
    /// Further TOML of a rod: changes, masses, faults.
    pub north: String,
    pub south: String,
    /// Edit of the configuration before it is simulated.
    pub wiring: fn(&str) -> String,
}

impl Part {
    pub fn new(first_day: i64, days: usize) -> Self {
        Self {
            first_day,
            days,
            north: String::new(),
            south: String::new(),
            wiring: str::to_owned,
        }
    }

    pub fn north(mut self, toml: &str) -> Self {
        self.north = toml.to_owned();
        self
    }

    pub fn south(mut self, toml: &str) -> Self {
        self.south = toml.to_owned();
        self
    }

    pub fn wired(mut self, wiring: fn(&str) -> String) -> Self {
        self.wiring = wiring;
        self
    }

    pub fn config(&self, site: &str) -> String {
        let rod = |id: &str, force_n: f64, special: &str| {
            simulated_rod(id, force_n, 3, &format!("{RESTRAINED}{special}"))
        };
        let simulation = format!(
            r#"
[simulation]
start = {start}
records = {days}
interval_s = 86_400.0
record_s = 30.0
fs_hz = 100.0
samples_per_message = 100
encoding = "protobuf"
[simulation.climate]
mean_c = 12.0
season_k = 6.0
day_k = 3.0
weather_k = 2.0
between_s = 1800
{north}{south}"#,
            start = noon(self.first_day),
            days = self.days,
            north = rod("north", 142e3, &self.north),
            south = rod("south", 158e3, &self.south),
        );
        (self.wiring)(site) + &simulation
    }
}

/// A folder with the site's configuration and its recordings.
pub struct Site {
    pub folder: tempfile::TempDir,
}

impl Site {
    pub fn new(config: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("site.toml"), config).unwrap();
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Simulates one recording into the folder `archive`.
    pub fn simulate(&self, name: &str, part: &Part) {
        let site = fs::read_to_string(self.path("site.toml")).unwrap();
        fs::create_dir_all(self.path("archive")).unwrap();
        let seed = (1000 + part.first_day).rem_euclid(1 << 20);
        self.simulate_as(&format!("archive/{name}.mcap"), &part.config(&site), seed);
    }

    /// Simulates a configuration into a file of the folder; returns its path.
    pub fn simulate_as(&self, out: &str, config: &str, seed: i64) -> PathBuf {
        fs::write(self.path("simulated.toml"), config).unwrap();
        let seed = seed.to_string();
        let words = [
            "simulate",
            "--config",
            "simulated.toml",
            "--seed",
            &seed,
            "--out",
            out,
        ];
        let output = self.run(&words);
        assert!(output.status.success(), "{}", text(&output.stderr));
        self.path(out)
    }

    pub fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tirante"));
        command
            .current_dir(self.folder.path())
            .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
            .stdin(Stdio::null())
            .args(words);
        command
    }

    pub fn run(&self, words: &[&str]) -> Output {
        self.command(words).output().unwrap()
    }

    /// Replays paths into a store; returns output and exit code.
    pub fn replay(&self, paths: &[&str], store: &str) -> (Output, i32) {
        let words = ["replay", "--config", "site.toml", "--json", "--store", store];
        let output = self.run(&[&words[..], paths].concat());
        let code = output.status.code().unwrap();
        (output, code)
    }

    pub fn dump(&self, store: &str) -> String {
        Reader::open(&self.path(store)).unwrap().dump().unwrap()
    }

    /// `history --what WHAT --format json`, one value a line.
    pub fn history(&self, store: &str, what: &str) -> Vec<Value> {
        let output = self.run(&["history", "--store", store, "--what", what, "--format", "json"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        lines(&output.stdout)
    }

    /// The alarms as `rod kind`, in the order they were raised.
    pub fn alarms(&self, store: &str) -> Vec<String> {
        let one = |alarm: &Value| {
            format!(
                "{} {}",
                alarm["rod"].as_str().unwrap(),
                alarm["kind"].as_str().unwrap()
            )
        };
        self.history(store, "alarms").iter().map(one).collect()
    }
}

/// Messages of a recording.
pub fn messages(recording: &Path) -> Vec<mcap::Message<'static>> {
    let bytes = fs::read(recording).unwrap();
    mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| {
            let message = message.unwrap();
            mcap::Message {
                data: message.data.into_owned().into(),
                ..message
            }
        })
        .collect()
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

pub fn lines(bytes: &[u8]) -> Vec<Value> {
    text(bytes)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// Panics at the first difference of two dumps.
pub fn assert_equal_dumps(one: &str, other: &str) {
    for (line, (a, b)) in one.lines().zip(other.lines()).enumerate() {
        assert_eq!(a, b, "line {line}");
    }
    assert_eq!(one.lines().count(), other.lines().count());
}

pub fn copy(from: &Path, to: &Path) {
    fs::copy(from, to).unwrap();
}

/// 56 days of two rods in seven recordings: baselines, charts, records with several faults, days with
/// temperatures only, a loss of 10 % that alarms.
pub fn campaign() -> Site {
    let site = Site::new(SITE);
    let loss = "[[simulation.rod.change]]\nstart_d = 0.0\nrelative = -0.10\n";
    let fault = |kind: &str, first: usize, last: usize| {
        format!("[[simulation.rod.fault]]\nkind = {kind}\nfirst_record = {first}\nlast_record = {last}\n")
    };
    let held = &fault("\"held\"\nat_s = 3.0\nlength_s = 20.0", 2, 3);
    let scaled = &fault("\"scaled\"\nfactor = 1000.0", 4, 5);
    let clock = &fault("\"clock-step\"\nat_s = 12.0\nstep_s = 7200.0", 5, 5);
    let silent = &fault("\"lost\"\nshare = 1.0", 8, 8);
    for index in 0..7 {
        let part = Part::new(8 * index, 8);
        let part = match index {
            0 => part.north(silent).south(silent),
            1 => part.north(held),
            2 => part.south(clock),
            3 => part.north(&[scaled.as_str(), silent].concat()),
            4 => part.south(&[held.as_str(), silent].concat()),
            _ => part.north(loss),
        };
        site.simulate(&format!("week-{index}"), &part);
    }
    site
}

/// Two weeks of frequencies of north under 340 kN, which hardly any rod of [`SITE`]'s prior bears: `prior_tail` is 0.003. A
/// hinged beam, so that the shape is right.
pub fn doubtful_table() -> String {
    use std::f64::consts::PI;
    let (length_m, mass_kg_m, rigidity) = (8.0, 7800.0 * PI * 4e-4, 2.0e11 * PI * 0.04_f64.powi(4) / 64.0);
    let mut table = "time,rod,f1_hz,sd1_hz,f2_hz,sd2_hz,f3_hz,sd3_hz,temperature_c\n".to_owned();
    for day in 0..14 {
        table += &format!("{},north", noon(day));
        for order in 1..=3 {
            let wave = f64::from(order) * PI / length_m;
            let hz = wave / (2.0 * PI) * ((340e3 + rigidity * wave * wave) / mass_kg_m).sqrt();
            // A ten-thousandth up and down, so that there is a scatter.
            let hz = hz * (1.0 + 1e-4 * ((day * 7 + i64::from(order) * 3) % 5 - 2) as f64);
            table += &format!(",{hz:.6},{:.6}", 1e-3 * hz);
        }
        table += &format!(",{}\n", 12 + day % 3);
    }
    table
}
