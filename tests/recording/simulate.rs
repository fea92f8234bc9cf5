//! Simulated recordings: the physics against closed forms, the faults one by one, the bytes.

#![allow(clippy::unwrap_used)]

use std::f64::consts::PI;
use std::fs;
use std::path::Path;
use tirante::analysis::lab::synthesis::{SimulatedRecord, Synthesis, SynthesisError};
use tirante::analysis::rod::beam::{Parameterisation, Section, exact};
use tirante::analysis::signal::record::{Cut, Event};
use tirante::command::simulate;
use tirante::config::{Config, SimulationConfig};
use tirante::recording::read::{Options, Recording};

const ROD: &str = r#"
[[rod]]
id = "a"
length_m = 14.0
section = "square"
[rod.priors]
axial_force_n = 800e3
youngs_modulus_pa = 2e11
density_kg_m3 = 7500
side_m = 0.07
spring_left_n_m = 400e3
spring_right_n_m = 400e3
[rod.channel]
topic = "/a/displacement"
"#;
const THETA: [f64; 7] = [800e3, 2e11, 7500.0, 0.07, 400e3, 400e3, 14.0];

fn simulation(text: &str) -> SimulationConfig {
    let config = Config::parse(&format!("{ROD}{text}"), "test").unwrap_or_else(|error| panic!("{error}"));
    config.simulation.expect("a [simulation]")
}

fn record(text: &str, index: usize) -> SimulatedRecord {
    let settings = simulation(text);
    Synthesis::new(&settings.simulation, 1).record(0, index).unwrap()
}

/// The samples in the order of sending.
fn samples(record: &SimulatedRecord) -> Vec<f64> {
    record
        .displacement
        .iter()
        .flat_map(|message| message.samples.clone())
        .collect()
}

/// |sum of x exp(-2 pi i f t)|^2 with a Hann taper, one-sided density.
fn density(samples: &[f64], fs_hz: f64, f: f64) -> f64 {
    let n = samples.len() as f64;
    let (mut re, mut im, mut power) = (0.0, 0.0, 0.0);
    for (k, x) in samples.iter().enumerate() {
        let taper = 1.0 - (2.0 * PI * (k as f64 + 0.5) / n).cos();
        let (sin, cos) = (2.0 * PI * f * k as f64 / fs_hz).sin_cos();
        re += taper * x * cos;
        im += taper * x * sin;
        power += taper * taper;
    }
    2.0 * (re * re + im * im) / (fs_hz * power)
}

fn exact_hz(theta: &[f64]) -> [f64; 5] {
    let mut f = [0.0; 5];
    exact::frequencies(&Parameterisation::new(Section::Square).beam(theta), &mut f).unwrap();
    f
}

#[test]
fn without_weather_and_change_the_truth_is_the_beam() {
    let record = record("[simulation]", 0);
    // The same formula compiled twice: parts that the compiler evaluates as constants may differ in the last bit.
    for (said, wanted) in record.truth.frequency_hz.iter().zip(exact_hz(&THETA)) {
        assert!((said / wanted - 1.0).abs() < 1e-15, "{said} {wanted}");
    }
    assert_eq!(record.truth.axial_force_n, Some(800e3));
    assert_eq!(record.truth.relative_force, 1.0);
}

#[test]
fn the_ambient_response_has_the_standard_deviation_asked_for() {
    // One mode, no noise, seen where its shape is 1 or nearly: sd of 20 um at the antinode.
    let text = "[simulation]\nrecord_s = 3000\nfs_hz = 50\n[[simulation.rod]]\nid = \"a\"\nmodes = 1\ndamping = 0.01\n\
                [simulation.rod.sensor]\nat = 0.5\nnoise_m = 0\nresolution_m = 0\n";
    let samples = samples(&record(text, 0));
    let sd = (samples.iter().map(|x| x * x).sum::<f64>() / samples.len() as f64).sqrt();
    // Correlation time 1 / (zeta omega) = 3.4 s: about 900 independent values of the variance, sd of sd 2 %.
    assert!((sd / 20e-6 - 1.0).abs() < 0.08, "{sd:e}");
}

#[test]
fn higher_modes_follow_from_a_load_white_in_time_and_space() {
    // sd_n / sd_1 = (omega_1 / omega_n)^(3/2) for equal damping and sines: read off the spectrum's peaks,
    // G(f_n) = 2 S / (2 zeta omega_n^2)^2 proportional to omega_n^-4.
    let text = "[simulation]\nrecord_s = 600\nrecords = 60\nfs_hz = 40\n[[simulation.rod]]\nid = \"a\"\n\
                frequencies_hz = [4.0, 8.0, 12.0]\ndamping = 0.02\n\
                [simulation.rod.sensor]\nat = 0.35\nnoise_m = 0\nresolution_m = 0\n";
    let settings = simulation(text);
    let synthesis = Synthesis::new(&settings.simulation, 3);
    let mut peaks = [0.0; 3];
    for index in 0..60 {
        let samples = samples(&synthesis.record(0, index).unwrap());
        for (peak, f) in peaks.iter_mut().zip([4.0, 8.0, 12.0]) {
            *peak += density(&samples, 40.0, f);
        }
    }
    for n in [2.0_f64, 3.0] {
        let seen = ((n * PI * 0.35).sin() / (PI * 0.35).sin()).powi(2);
        let ratio = peaks[n as usize - 1] / peaks[0] / seen;
        // Each a mean of 60 exponentials: sd of the ratio 18 %.
        assert!((ratio * n.powi(4)).ln().abs() < 0.6, "mode {n}: {ratio}");
    }
}

#[test]
fn mid_span_sees_no_even_mode() {
    let at = |place: f64| {
        let text = format!(
            "[simulation]\nrecord_s = 120\n[[simulation.rod]]\nid = \"a\"\n\
             [simulation.rod.sensor]\nat = {place}\nnoise_m = 0\nresolution_m = 0\n"
        );
        let record = record(&text, 0);
        let f2 = record.truth.frequency_hz[1];
        density(&samples(&record), 100.0, f2)
    };
    assert!(at(0.5) < 1e-3 * at(0.4), "{:e} {:e}", at(0.5), at(0.4));
}

#[test]
fn a_released_rod_starts_from_its_static_shape_and_decays_as_its_damping_says() {
    let text = |kind: &str| {
        format!(
            "[simulation]\nrecord_s = 30\nfs_hz = 1000\n[[simulation.rod]]\nid = \"a\"\nfrequencies_hz = [4.0]\n\
             damping = 0.01\nambient_m = 0\n[simulation.rod.pull]\nkind = \"{kind}\"\ndeflection_m = 1e-3\nat = 0.5\n\
             [simulation.rod.sensor]\nat = 0.5\nnoise_m = 0\nresolution_m = 0\n"
        )
    };
    let release = samples(&record(&text("release"), 0));
    assert_eq!(release[2999], 0.0);
    assert!(
        (release[4000] - 0.5e-3).abs() < 1e-12,
        "half way up the ramp: {}",
        release[4000]
    );
    assert!(
        (release[5000] - 1e-3).abs() < 1e-12,
        "at release: {}",
        release[5000]
    );
    let blow = samples(&record(&text("blow"), 0));
    assert_eq!(blow[4999], 0.0);
    assert!(
        (blow[5062] / (1e-3 * (-0.01 * PI / 2.0_f64).exp()) - 1.0).abs() < 1e-2,
        "{}",
        blow[5062]
    );
    for samples in [release, blow] {
        let largest = |from: usize| samples[from..from + 300].iter().fold(0.0_f64, |a, b| a.max(*b));
        // 10 s are 40 periods: exp(-zeta omega t).
        let decay = largest(16_000) / largest(6_000);
        assert!(
            (decay / (-0.01 * 2.0 * PI * 4.0 * 10.0_f64).exp() - 1.0).abs() < 0.02,
            "{decay}"
        );
    }
}

#[test]
fn temperature_takes_kappa_e_a_alpha_per_kelvin() {
    let text = "[simulation]\nrecords = 2\nrecord_s = 60\ninterval_s = 15768000\n[simulation.climate]\nday_k = 0\n\
                weather_k = 0\n[[simulation.rod]]\nid = \"a\"\n[simulation.rod.thermal]\nrestraint = 0.5\nlag_h = 0\n";
    for index in [0, 1] {
        let truth = record(text, index).truth;
        let kelvin = truth.rod_c.unwrap() - 14.0;
        assert!(kelvin.abs() > 5.0, "winter and summer: {kelvin}");
        // E A alpha = 2e11 x 0.0049 x 1.2e-5 = 11 760 N/K, half of it.
        let force = 800e3 - 0.5 * 11_760.0 * kelvin;
        assert!((truth.axial_force_n.unwrap() / force - 1.0).abs() < 1e-12);
        let mut theta = THETA;
        theta[0] = force;
        for (f, exact) in truth.frequency_hz.iter().zip(exact_hz(&theta)) {
            assert!((f / exact - 1.0).abs() < 1e-12);
        }
        assert_eq!(truth.relative_force, 1.0, "temperature is no loss");
    }
}

#[test]
fn a_change_grows_from_its_start_over_its_duration_and_stays() {
    let text = "[simulation]\nrecords = 5\ninterval_s = 864000\n[[simulation.rod]]\nid = \"a\"\n\
                [[simulation.rod.change]]\nstart_d = 10\nover_d = 20\nrelative = -0.04\n\
                [[simulation.rod.change]]\nstart_d = 35\nrelative = -0.10\n";
    let relative: Vec<f64> = (0..5).map(|i| record(text, i).truth.relative_force).collect();
    for (found, wanted) in relative.iter().zip([1.0, 1.0, 0.98, 0.96, 0.86]) {
        // Taken 30 s after the start of the record: a share 30 / 864000 of the ramp.
        assert!((found - wanted).abs() < 2e-6, "{relative:?}");
    }
}

#[test]
fn an_added_mass_lowers_odd_modes_as_the_exact_series_says() {
    // Oracle: a hinged beam with a mass M at mid-span has the roots of
    // 1 = 2 M omega^2 / (m l) sum over odd n of 1 / (omega_n^2 - omega^2).
    let text = |mass: f64| {
        format!(
            "[simulation]\n[[simulation.rod]]\nid = \"a\"\n[simulation.rod.truth]\nspring_left_n_m = 0\n\
             spring_right_n_m = 0\n[simulation.rod.added_mass]\nmass_kg = {mass}\n"
        )
    };
    let (rod_mass, rigidity) = (7500.0 * 0.0049 * 14.0, 2e11 * 0.07_f64.powi(4) / 12.0);
    let omega_squared = |n: f64| {
        let k = n * PI / 14.0;
        (rigidity * k.powi(4) + 800e3 * k * k) / (7500.0 * 0.0049)
    };
    let mut theta = THETA;
    (theta[4], theta[5]) = (0.0, 0.0);
    let bare = exact_hz(&theta);
    let mut errors = Vec::new();
    for mass in [2.0, 4.0] {
        let found = record(&text(mass), 0).truth.frequency_hz;
        assert!((found[1] / bare[1] - 1.0).abs() < 1e-12, "a node of mode 2");
        for order in [1.0, 3.0] {
            let excess = |f: f64| {
                let w2 = (2.0 * PI * f).powi(2);
                let sum: f64 = (0..2000)
                    .map(|i| 1.0 / (omega_squared(2.0 * f64::from(i) + 1.0) - w2))
                    .sum();
                2.0 * mass * w2 / rod_mass * sum - 1.0
            };
            let (mut low, mut high) = (
                0.9 * bare[order as usize - 1],
                bare[order as usize - 1] * (1.0 - 1e-12),
            );
            for _ in 0..100 {
                let middle = 0.5 * (low + high);
                if excess(middle) < 0.0 {
                    low = middle
                } else {
                    high = middle
                }
            }
            let shift = low / bare[order as usize - 1] - 1.0;
            let error = found[order as usize - 1] / low - 1.0;
            assert!(shift < -0.003, "{shift}");
            assert!(
                error.abs() < 0.1 * shift.abs(),
                "mode {order}: shift {shift}, error {error}"
            );
            errors.push(error.abs());
        }
    }
    // Right to first order: doubling the mass multiplies the error by about four.
    for (small, large) in errors[..2].iter().zip(&errors[2..]) {
        assert!((3.0..5.5).contains(&(large / small)), "{errors:?}");
    }
}

#[test]
fn a_slack_rod_is_refused() {
    let settings = simulation(
        "[simulation]\n[[simulation.rod]]\nid = \"a\"\n[[simulation.rod.change]]\nrelative = -0.9\n\
         [[simulation.rod.change]]\nrelative = -0.2\n",
    );
    let error = Synthesis::new(&settings.simulation, 1).record(0, 0).unwrap_err();
    assert!(matches!(error, SynthesisError::Slack { .. }), "{error}");
}

#[test]
fn the_thermometer_logs_within_records_and_between_them_if_asked() {
    let text =
        "[simulation]\nrecords = 3\nrecord_s = 60\ninterval_s = 3600\n[simulation.climate]\nevery_s = 20\n";
    let stamps = |text: &str, index: usize| -> Vec<f64> {
        let record = record(text, index);
        record
            .temperature
            .iter()
            .map(|m| m.stamp.seconds_since(record.start).round())
            .collect()
    };
    assert_eq!(stamps(text, 0), [0.0, 20.0, 40.0, 60.0]);
    let more = format!("{text}between_s = 900\n");
    assert_eq!(stamps(&more, 1), [0.0, 20.0, 40.0, 60.0, 960.0, 1860.0, 2760.0]);
    assert_eq!(
        stamps(&more, 2),
        [0.0, 20.0, 40.0, 60.0],
        "nothing after the last record"
    );
    let record = record(text, 0);
    let mean = record.temperature.iter().map(|m| m.samples[0]).sum::<f64>() / 4.0;
    // Four readings with a noise of 0.1 K.
    assert!((mean - record.truth.air_c.unwrap()).abs() < 0.25);
}

const CLEAN: &str = "[simulation]\nrecord_s = 10\nrecords = 3\nfs_hz = 100\n[[simulation.rod]]\nid = \"a\"\n";

fn spoiled(fault: &str) -> (SimulatedRecord, SimulatedRecord) {
    let text = format!("{CLEAN}[[simulation.rod.fault]]\nfirst_record = 2\nlast_record = 2\n{fault}\n");
    assert_eq!(record(&text, 0), record(CLEAN, 0), "other records are untouched");
    assert_eq!(record(&text, 2), record(CLEAN, 2));
    (record(&text, 1), record(CLEAN, 1))
}

#[test]
fn faults_of_the_sensor_touch_the_samples_they_should() {
    let (nan, clean) = spoiled("kind = \"nan\"\nat_s = 2\nlength_s = 1");
    let (nan, clean) = (samples(&nan), samples(&clean));
    for (k, (a, b)) in nan.iter().zip(&clean).enumerate() {
        assert!(
            if (200..300).contains(&k) {
                a.is_nan()
            } else {
                a == b
            },
            "{k}"
        );
    }
    let held = samples(&spoiled("kind = \"held\"\nat_s = 2\nlength_s = 1").0);
    assert!(held[200..300].iter().all(|x| *x == clean[199]) && held[300] == clean[300]);
    let spikes = samples(&spoiled("kind = \"spikes\"\nper_hour = 3600\nheight_m = 0.01").0);
    let count = spikes
        .iter()
        .zip(&clean)
        .filter(|(a, b)| (**a - **b).abs() > 0.009)
        .count();
    assert!((2..25).contains(&count), "10 expected: {count}");
    let clipped = samples(&spoiled("kind = \"clipped\"\nlevel_m = 1e-5").0);
    assert!(
        clipped
            .iter()
            .zip(&clean)
            .all(|(a, b)| *a == b.clamp(-1e-5, 1e-5))
    );
    assert!(clipped.iter().any(|x| x.abs() == 1e-5));
    let step = samples(&spoiled("kind = \"step\"\nat_s = 5\nheight_m = 0.001").0);
    assert!(step[499] == clean[499] && (step[500] - clean[500] - 1e-3).abs() < 1e-12);
    let scaled = samples(&spoiled("kind = \"scaled\"\nfactor = 1000").0);
    assert!(scaled.iter().zip(&clean).all(|(a, b)| *a == 1000.0 * b));
}

#[test]
fn faults_of_clock_and_transport_touch_the_messages_they_should() {
    let stamps = |record: &SimulatedRecord| {
        record
            .displacement
            .iter()
            .map(|m| m.stamp.seconds_since(record.start))
            .collect::<Vec<_>>()
    };
    let (dropout, clean) = spoiled("kind = \"dropout\"\nat_s = 2\nlength_s = 1");
    let kept = stamps(&dropout);
    assert_eq!(kept.len(), 900);
    assert!(kept.iter().all(|t| *t < 1.995 || *t > 2.995));
    let clean = stamps(&clean);
    let clock = stamps(&spoiled("kind = \"clock-step\"\nat_s = 5\nstep_s = -3600").0);
    assert_eq!(clock[499], clean[499]);
    assert!((clock[500] - clean[500] + 3600.0).abs() < 1e-6);
    let jitter = stamps(&spoiled("kind = \"jitter\"\nsd_s = 0.002").0);
    let sd = (jitter
        .iter()
        .zip(&clean)
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f64>()
        / 1000.0)
        .sqrt();
    assert!(
        (sd / 0.002 - 1.0).abs() < 0.1,
        "1000 values: sd of the sd 2 %: {sd}"
    );
    let twice = stamps(&spoiled("kind = \"duplicates\"\nshare = 0.1").0);
    let pairs = twice.windows(2).filter(|pair| pair[0] == pair[1]).count();
    assert!(
        twice.len() == 1000 + pairs && (60..140).contains(&pairs),
        "{pairs}"
    );
    let mixed = stamps(&spoiled("kind = \"out-of-order\"\nshare = 0.1").0);
    let back = mixed.windows(2).filter(|pair| pair[0] > pair[1]).count();
    assert!((50..140).contains(&back), "{back}");
    let mut sorted = mixed.clone();
    sorted.sort_by(f64::total_cmp);
    assert_eq!(sorted, clean);
    let lost = stamps(&spoiled("kind = \"lost\"\nshare = 0.1").0).len();
    assert!((850..950).contains(&lost), "{lost}");
}

fn run(config: &Path, out: &Path, seed: Option<u64>, force: bool) -> bool {
    let args = simulate::Args {
        config: config.to_owned(),
        out: out.to_owned(),
        truth: Some(out.with_extension("jsonl")),
        seed,
        force,
    };
    // `ExitCode` has no equality: its debug form does.
    let success = format!("{:?}", std::process::ExitCode::SUCCESS);
    simulate::run(&args).is_ok_and(|code| format!("{code:?}") == success)
}

#[test]
fn recording_and_truth_are_two_files() {
    let folder = tempfile::tempdir().unwrap();
    let both = folder.path().join("both");
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_tirante"))
        .args(["simulate", "--config", "config/campaign.toml", "--out"])
        .arg(&both)
        .arg("--truth")
        .arg(&both)
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(2));
    assert!(!both.exists());
}

#[test]
fn the_same_seed_gives_the_same_bytes_at_any_thread_count() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("c.toml");
    let text = "[simulation]\nrecords = 9\nrecord_s = 20\nencoding = \"ros2\"\n[simulation.climate]\n";
    let rod = ROD.replace(
        "topic = \"/a/displacement\"",
        "topic = \"/a/displacement\"\nfield = \"data\"",
    );
    fs::write(&config, format!("{rod}{text}")).unwrap();
    let mut files = Vec::new();
    for (name, threads, seed) in [("a", 1, 5), ("b", 2, 5), ("c", 7, 5), ("d", 2, 6)] {
        let out = folder.path().join(name).with_extension("mcap");
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        assert!(pool.install(|| run(&config, &out, Some(seed), false)));
        files.push((
            fs::read(&out).unwrap(),
            fs::read(out.with_extension("jsonl")).unwrap(),
        ));
    }
    assert!(files[0] == files[1] && files[0] == files[2]);
    assert!(files[0].0 != files[3].0, "another seed, another recording");
    assert!(
        !run(&config, &folder.path().join("a.mcap"), None, false),
        "never overwrites unasked"
    );
    assert!(run(&config, &folder.path().join("a.mcap"), Some(5), true));
    assert!(fs::read(folder.path().join("a.mcap")).unwrap() == files[0].0);
}

#[test]
fn the_recording_says_that_it_is_simulated_and_holds_the_samples() {
    let folder = tempfile::tempdir().unwrap();
    let (config, out) = (folder.path().join("c.toml"), folder.path().join("r.mcap"));
    let text = format!(
        "{ROD}unit = \"um\"\n{}",
        CLEAN.replace("fs_hz = 100", "fs_hz = 100\nprecision = \"double\"")
    );
    fs::write(&config, &text).unwrap();
    assert!(run(&config, &out, None, false));
    let bytes = fs::read(&out).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let facts = mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap();
    assert_eq!(facts.name, "tirante.simulation");
    assert!(facts.metadata["simulated"].starts_with("yes"));
    assert_eq!(facts.metadata["seed"], "1");
    let again = Config::parse(&facts.metadata["config"], "the recording's own").unwrap();
    let settings = again.simulation.unwrap();
    let synthesis = Synthesis::new(&settings.simulation, 1);
    let expected: Vec<(i64, f64)> = (0..3)
        .flat_map(|index| synthesis.record(0, index).unwrap().displacement)
        .map(|message| (message.stamp.as_nanos(), message.samples[0]))
        .collect();
    let read: Vec<(i64, f64)> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| {
            let message = message.unwrap();
            let value: serde_json::Value = serde_json::from_slice(&message.data).unwrap();
            (message.log_time as i64, value["value"].as_f64().unwrap())
        })
        .collect();
    assert_eq!(read.len(), expected.len());
    for ((stamp, micrometres), (wanted, metres)) in read.iter().zip(&expected) {
        assert_eq!(stamp, wanted);
        assert!(
            (micrometres - metres * 1e6).abs() <= 1e-12 * micrometres.abs(),
            "{micrometres} um, {metres} m"
        );
    }
}

/// Topic, time and content of every message, and the metadata.
type Content = (
    Vec<(String, u64, Vec<u8>)>,
    std::collections::BTreeMap<String, String>,
);

fn content(bytes: &[u8]) -> Content {
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    let facts = mcap::read::metadata(bytes, &summary.metadata_indexes[0]).unwrap();
    let messages = mcap::MessageStream::new(bytes).unwrap().map(|message| {
        let message = message.unwrap();
        (
            message.channel.topic.clone(),
            message.log_time,
            message.data.to_vec(),
        )
    });
    (messages.collect(), facts.metadata)
}

#[test]
fn the_shipped_recordings_are_what_their_commands_write() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let mut size = 0;
    for (config, recording) in [
        ("todi.toml", "todi-pull.mcap"),
        ("aisle.toml", "aisle.mcap"),
        ("campaign.toml", "campaign-2025.mcap"),
    ] {
        let (config, out) = (root.join("config").join(config), folder.path().join(recording));
        assert!(run(&config, &out, None, false));
        let shipped = fs::read(root.join("recordings").join(recording)).unwrap();
        size += shipped.len();
        // The file's own bytes also hold the version that wrote it.
        let ((messages, mut facts), (wanted, mut made)) =
            (content(&shipped), content(&fs::read(&out).unwrap()));
        assert!(
            messages == wanted,
            "{recording} is not what its command writes: make it again"
        );
        assert_eq!(facts["config"], fs::read_to_string(&config).unwrap());
        facts.remove("by");
        made.remove("by");
        assert_eq!(facts, made);
    }
    assert!(size < 10_000_000, "{size} bytes");
}

/// The shipped recordings through the reader with their configurations: every record, at its time, with
/// its temperature, none refused.
#[test]
fn the_shipped_recordings_are_read_with_their_configurations() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (config, recording) in [
        ("todi.toml", "todi-pull.mcap"),
        ("aisle.toml", "aisle.mcap"),
        ("campaign.toml", "campaign-2025.mcap"),
    ] {
        let config = Config::load(&root.join("config").join(config)).unwrap();
        let rods: Vec<_> = config.rods.iter().map(|rod| rod.channels.clone()).collect();
        let path = root.join("recordings").join(recording);
        let reader = Recording::open(&path, &rods, &config.record, Options::default()).unwrap();
        let simulation = &config.simulation.as_ref().unwrap().simulation;
        let synthesis = Synthesis::new(simulation, config.seed);
        let mut found = 0;
        for event in reader {
            let Event::Record(record) = event else {
                panic!("{event:?}")
            };
            let simulated = synthesis.record(0, found).unwrap();
            assert_eq!(record.flags, [], "{}", record.start);
            assert_eq!(record.fs_hz, simulation.fs_hz);
            let late_s = record.start.seconds_since(simulated.start);
            if matches!(config.record.cut, Cut::Auto | Cut::File) {
                assert_eq!(late_s, 0.0);
                assert_eq!(record.samples.len(), simulation.samples());
            } else {
                // Struck after 5 s: the onset is found within a few samples.
                assert!((5.0..5.1).contains(&late_s), "{late_s}");
            }
            let skipped = (late_s * simulation.fs_hz).round() as usize;
            for (read, made) in record.samples.iter().zip(&samples(&simulated)[skipped..]) {
                // Written as 32-bit numbers.
                assert!((read - made).abs() <= 6e-8 * made.abs(), "{read} {made}");
            }
            match (record.temperature_c, simulated.truth.air_c) {
                // Thirteen readings with a noise of 0.1 K.
                (Some(read), Some(air)) => assert!((read - air).abs() < 0.15, "{read} {air}"),
                (read, air) => assert!(read.is_none() && air.is_none()),
            }
            found += 1;
        }
        assert_eq!(found, simulation.records);
    }
}

const BARE: &str = "[simulation.rod.sensor]\nat = 0.35\nnoise_m = 0\nresolution_m = 0\n";

#[test]
fn twelve_modes_stand_in_the_spectrum_where_the_beam_has_them() {
    let text = "[simulation]\nrecord_s = 120\nfs_hz = 400\n[[simulation.rod]]\nid = \"a\"\nmodes = 12\ndamping = 0.002\n\
         [simulation.rod.sensor]\nat = 0.04\nnoise_m = 0\nresolution_m = 0\n";
    let record = record(text, 0);
    let beam = Parameterisation::new(Section::Square).beam(&THETA);
    let mut exact = [0.0; 12];
    exact::frequencies(&beam, &mut exact).unwrap();
    assert_eq!(record.truth.frequency_hz.len(), 12);
    let samples = samples(&record);
    for (order, f) in (1..).zip(exact) {
        assert!((record.truth.frequency_hz[order - 1] / f - 1.0).abs() < 1e-15);
        // A mode of 0.2 % is 48 dB above its own skirt 10 % away; the line nearest to it may hold a fiftieth by chance.
        let peak = (-4..=4).map(|i| density(&samples, 400.0, f + f64::from(i) / 240.0));
        let peak = peak.fold(0.0, f64::max);
        for aside in [0.93, 1.07] {
            let beside = density(&samples, 400.0, aside * f);
            assert!(
                peak > 30.0 * beside,
                "mode {order} at {f} Hz: {peak:e} {beside:e}"
            );
        }
    }
}

#[test]
fn more_modes_do_not_change_the_ones_before() {
    let text = |frequencies: &str| {
        format!(
            "[simulation]\nrecord_s = 5\nfs_hz = 50\n[[simulation.rod]]\nid = \"a\"\nfrequencies_hz = {frequencies}\n{BARE}"
        )
    };
    // Those above half the sample rate are left out.
    let few = samples(&record(&text("[4.0, 8.0]"), 0));
    let many = samples(&record(
        &text("[4.0, 8.0, 26.0, 27.0, 28.0, 29.0, 30.0, 31.0, 32.0, 33.0, 34.0, 35.0]"),
        0,
    ));
    assert_eq!(few, many);
}

/// Mean squares of pieces of `length` samples.
fn levels(samples: &[f64], length: usize) -> Vec<f64> {
    samples
        .chunks_exact(length)
        .map(|piece| piece.iter().map(|x| x * x).sum::<f64>() / length as f64)
        .collect()
}

#[test]
fn gusts_change_the_level_and_keep_its_mean() {
    let text = |gusts: &str| {
        format!(
            "[simulation]\nrecord_s = 20000\nfs_hz = 25\n[[simulation.rod]]\nid = \"a\"\nfrequencies_hz = [4.0]\n\
             damping = 0.05\n{gusts}{BARE}"
        )
    };
    let spread = |gusts: &str| {
        let levels = levels(&samples(&record(&text(gusts), 0)), 100);
        let mean = levels.iter().sum::<f64>() / levels.len() as f64;
        let variance = levels.iter().map(|x| (x / mean - 1.0).powi(2)).sum::<f64>() / levels.len() as f64;
        (mean, variance)
    };
    let (steady, calm) = spread("");
    let (gusty, wild) = spread("[simulation.rod.gusts]\nlog_sd = 0.6\ncorrelation_s = 50\n");
    // 20 000 s hold 400 independent gusts, each a^2 with variance exp(4 0.36) - 1 = 3.2: sd of the mean 9 %.
    assert!((gusty / steady - 1.0).abs() < 0.3, "{gusty} {steady}");
    // Steady: the response forgets in 0.8 s, so that pieces of 4 s vary by some 0.4 squared. Gusts add 3.2 (1 + that), less what
    // 400 draws of so skewed a number do not reach.
    assert!(calm < 0.4 && (1.5..7.0).contains(&(wild - calm)), "{calm} {wild}");
}

#[test]
fn knocks_come_at_random_times_and_decay() {
    let text = format!(
        "[simulation]\nrecord_s = 600\nfs_hz = 100\n[[simulation.rod]]\nid = \"a\"\nfrequencies_hz = [4.0]\n\
         damping = 0.02\nambient_m = 0\n[simulation.rod.knocks]\nevery_s = 20\ndeflection_m = 1e-3\nlog_sd = 0.2\n{BARE}"
    );
    let samples = samples(&record(&text, 0));
    // Without an ambient load every period of the decay is lower than the one before, but where a knock falls.
    let levels = levels(&samples, 25);
    let onsets: Vec<usize> = (1..levels.len())
        .filter(|&i| levels[i] > 1.5 * levels[i - 1] + 1e-10)
        .collect();
    let knocks = onsets.iter().filter(|i| !onsets.contains(&(*i - 1))).count();
    // Poisson with mean 30; of those nearer than a few decay times some hide.
    assert!((15..=42).contains(&knocks), "{knocks}");
    let gaps: Vec<f64> = onsets
        .windows(2)
        .map(|pair| 0.25 * (pair[1] - pair[0]) as f64)
        .collect();
    let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
    let sd = (gaps.iter().map(|gap| (gap - mean).powi(2)).sum::<f64>() / gaps.len() as f64).sqrt();
    assert!(sd > 0.4 * mean, "they are not on a schedule: {mean} +- {sd}");
    // sin(0.35 pi) of a millimetre in the median.
    let largest = levels.iter().copied().fold(0.0, f64::max).sqrt();
    assert!((0.4e-3..3e-3).contains(&largest), "{largest:e}");
}

#[test]
fn a_record_begins_at_a_blow_or_inside_a_decay() {
    let text = |pull: &str| {
        format!(
            "[simulation]\nrecord_s = 10\nfs_hz = 1000\n[[simulation.rod]]\nid = \"a\"\nfrequencies_hz = [4.0]\n\
             damping = 0.01\nambient_m = 0\n[simulation.rod.pull]\nat = 0.5\ndeflection_m = 1e-3\n{pull}\n\
             [simulation.rod.sensor]\nat = 0.5\nnoise_m = 0\nresolution_m = 0\n"
        )
    };
    let struck = samples(&record(&text("kind = \"blow\"\nfirst_s = 0"), 0));
    assert_eq!(struck[0], 0.0, "a blow gives a velocity");
    // After a quarter of a period of 0.25 s.
    assert!((struck[62] / (1e-3 * (-0.01 * PI / 2.0_f64).exp()) - 1.0).abs() < 1e-2);
    // A second before the record: the same decay, a second later.
    let before = samples(&record(&text("kind = \"release\"\nfirst_s = -1"), 0));
    let after = samples(&record(&text("kind = \"release\"\nfirst_s = 0"), 0));
    assert!((after[0] - 1e-3).abs() < 1e-12);
    for (early, late) in before.iter().zip(&after[1000..]) {
        assert!((early - late).abs() < 1e-15, "{early} {late}");
    }
}

#[test]
fn a_neighbour_and_a_foreign_resonance_stand_where_and_as_high_as_asked() {
    let text = |more: &str| {
        format!(
            "[simulation]\nrecord_s = 2000\nfs_hz = 40\n[[simulation.rod]]\nid = \"a\"\nfrequencies_hz = [4.0, 8.0]\n\
             damping = 0.005\n{more}{BARE}"
        )
    };
    let plain = samples(&record(&text(""), 0));
    let neighbour = samples(&record(
        &text("[simulation.rod.neighbour]\ndetuning = 0.1\nshare = 0.5\n"),
        0,
    ));
    // Only the neighbour is added: the rod's own random numbers stay.
    let other: Vec<f64> = neighbour.iter().zip(&plain).map(|(a, b)| a - b).collect();
    let band = |samples: &[f64], f: f64| {
        let lines = (-40..=40).map(|i| density(samples, 40.0, f + f64::from(i) * 0.0005 * f / 4.0 * 10.0));
        lines.sum::<f64>()
    };
    for order in [1.0, 2.0] {
        let own = 4.0 * order;
        let ratio = band(&other, 1.1 * own) / band(&plain, own);
        // Power 0.25, times (1 / 1.1)^3 for the same load on a stiffer rod, over a band of lines in proportion; some 60 independent
        // values a side.
        assert!(
            (ratio / (0.25 / 1.1f64.powi(4))).ln().abs() < 0.7,
            "mode {order}: {ratio}"
        );
        assert!(band(&other, own) < 0.1 * band(&plain, own));
    }
    let foreign = samples(&record(
        &text("[[simulation.rod.resonance]]\nfrequency_hz = 5.5\ndamping = 0.01\nambient_m = 3e-5\n"),
        0,
    ));
    let other: Vec<f64> = foreign.iter().zip(&plain).map(|(a, b)| a - b).collect();
    let sd = (other.iter().map(|x| x * x).sum::<f64>() / other.len() as f64).sqrt();
    // Correlation time 1 / (zeta omega) = 2.9 s: 700 independent values, sd of the sd 2 %.
    assert!((sd / 3e-5 - 1.0).abs() < 0.1, "{sd:e}");
    assert!(density(&other, 40.0, 5.5) > 100.0 * density(&other, 40.0, 6.5));
}

#[test]
fn a_coarse_sensor_gives_whole_steps() {
    let text = "[simulation]\nrecord_s = 20\n[[simulation.rod]]\nid = \"a\"\n\
         [simulation.rod.sensor]\nat = 0.4\nnoise_m = 0\nresolution_m = 1e-5\n";
    let samples = samples(&record(text, 0));
    let mut seen: Vec<i64> = Vec::new();
    for x in samples {
        let step = (x / 1e-5).round();
        assert!((x - step * 1e-5).abs() < 1e-18);
        seen.push(step as i64);
    }
    seen.sort_unstable();
    seen.dedup();
    // A response of 20 um takes some ten steps of 10 um.
    assert!((4..20).contains(&seen.len()), "{seen:?}");
}

#[test]
fn one_message_is_stamped_late() {
    let stamps = |record: &SimulatedRecord| -> Vec<f64> {
        let messages = record.displacement.iter();
        messages.map(|m| m.stamp.seconds_since(record.start)).collect()
    };
    let (late, clean) = spoiled("kind = \"late\"\nat_s = 5\nlate_s = 0.003");
    assert_eq!(samples(&late), samples(&clean));
    for (k, (said, right)) in stamps(&late).iter().zip(stamps(&clean)).enumerate() {
        let wanted = if k == 500 { 0.003 } else { 0.0 };
        assert!((said - right - wanted).abs() < 2e-9, "{k}: {said} {right}");
    }
}
