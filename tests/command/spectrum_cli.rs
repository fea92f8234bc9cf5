//! `tirante spectrum` as users run it, and the output for records without a force.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use serde_json::Value as Json;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

const PULL: &str = "recordings/todi-pull.mcap";

/// The frequencies of the shipped recording \[Hz\] (config/todi.toml).
const TODI_HZ: [f64; 3] = [4.492, 9.288, 13.252];

/// Configuration under which the shipped recording has only one mode, which is not enough for a force.
const ONE_MODE: [&str; 2] = ["--set", "modes.masks=[{low_hz=6,high_hz=1000}]"];

fn tirante(cache: &TempDir, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tirante"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("TIRANTE_CACHE_DIR", cache.path())
        .env_remove("TIRANTE_LOG")
        .args(arguments)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

fn said(output: &Output) -> String {
    text(&output.stdout) + &text(&output.stderr)
}

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

fn json(output: &Output) -> Vec<Json> {
    text(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn is_drawn(text: &str) -> bool {
    text.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c))
}

/// Peaks of a JSON line, as frequency and nature.
fn peaks(line: &Json) -> Vec<(f64, String)> {
    let peaks = line["peaks"].as_array().unwrap().iter();
    peaks
        .map(|peak| {
            (
                peak["frequency_hz"].as_f64().unwrap(),
                peak["taken_for"].as_str().unwrap().to_owned(),
            )
        })
        .collect()
}

#[test]
fn a_recording_shows_its_peaks_without_rod_or_configuration() {
    let cache = tempfile::tempdir().unwrap();
    let output = tirante(&cache, &["spectrum", PULL, "--plot", "always"]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let table = text(&output.stdout);
    assert!(table.lines().all(|line| line.chars().count() <= 80), "{table}");
    assert!(is_drawn(&table));
    for wanted in [
        "recordings/todi-pull.mcap, /todi/displacement [m]",
        "candidate",
        "4.49",
        "9.28",
        "13.25",
    ] {
        assert!(table.contains(wanted), "no {wanted} in\n{table}");
    }
    let piped = tirante(&cache, &["spectrum", PULL]);
    assert!(!is_drawn(&text(&piped.stdout)));
}

#[test]
fn json_says_the_same_and_a_band_narrows_it() {
    let cache = tempfile::tempdir().unwrap();
    let looks = json(&tirante(&cache, &["spectrum", PULL, "--json"]));
    assert_eq!(looks.len(), 1);
    let look = &looks[0];
    for field in [
        "file",
        "channel",
        "rod",
        "unit",
        "start",
        "duration_s",
        "fs_hz",
        "excitation",
        "band_hz",
        "peaks",
        "label_probability",
        "candidates",
        "axial_force_n",
        "flags",
        "rejection",
    ] {
        assert!(look.get(field).is_some(), "no {field} in {look}");
    }
    assert_eq!(
        (look["unit"].as_str(), look["fs_hz"].as_f64()),
        (Some("m"), Some(100.0))
    );
    for wanted in TODI_HZ {
        let near = |peak: &&Json| (peak["frequency_hz"].as_f64().unwrap() - wanted).abs() < 0.05;
        let peak = look["peaks"].as_array().unwrap().iter().find(near).unwrap();
        let (f, sd) = (
            peak["frequency_hz"].as_f64().unwrap(),
            peak["sd_hz"].as_f64().unwrap(),
        );
        // Five standard errors: the recording is fixed, so this either always holds or never.
        assert!((f - wanted).abs() < 5.0 * sd && sd < 0.02, "{peak}");
        assert_eq!(peak["taken_for"], "candidate", "{peak}");
    }
    let low = json(&tirante(&cache, &["spectrum", PULL, "--json", "--band", "6..11"]));
    let found = peaks(&low[0]);
    assert!(
        found.iter().any(|(f, _)| (f - TODI_HZ[1]).abs() < 0.05),
        "{found:?}"
    );
    assert!(found.iter().all(|(f, _)| (5.9..11.1).contains(f)), "{found:?}");
}

#[test]
fn a_configuration_gives_orders_and_force() {
    let cache = tempfile::tempdir().unwrap();
    let arguments = ["spectrum", PULL, "--config", "config/todi.toml"];
    let output = tirante(&cache, &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let table = text(&output.stdout);
    for wanted in [
        "rod todi",
        "mode 1",
        "mode 2",
        "mode 3",
        "axial force",
        "probability",
    ] {
        assert!(table.contains(wanted), "no {wanted} in\n{table}");
    }
    let look = &json(&tirante(&cache, &[&arguments[..], &["--json"]].concat()))[0];
    let orders: Vec<u64> = look["peaks"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|peak| peak["order"].as_u64())
        .collect();
    assert_eq!(orders, [1, 2, 3]);
    assert!(look["axial_force_n"]["mean"].as_f64().unwrap() > 1e5, "{look}");
}

#[test]
fn a_page_needs_nothing_else() {
    let cache = tempfile::tempdir().unwrap();
    let page = path(&cache, "pull.html");
    let output = tirante(&cache, &["spectrum", PULL, "--html", &page]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let html = fs::read_to_string(&page).unwrap();
    for wanted in [
        "<h1>todi-pull.mcap</h1>",
        "Vibration spectrum of /todi/displacement",
        "Waveform of /todi/displacement",
        "Taken for",
        "candidate",
        "power density [m\u{b2}/Hz]",
    ] {
        assert!(html.contains(wanted), "no {wanted}");
    }
    for foreign in ["http://", "https://", "<script", "src=", "NaN"] {
        assert!(!html.contains(foreign), "{foreign}");
    }
    // The recording itself is never written over.
    let copy = path(&cache, "copy.mcap");
    fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join(PULL), &copy).unwrap();
    let output = tirante(&cache, &["spectrum", &copy, "--html", &copy]);
    assert_eq!(output.status.code(), Some(2), "{}", said(&output));
}

#[test]
fn what_cannot_be_looked_at_is_named_with_the_next_step() {
    let cache = tempfile::tempdir().unwrap();
    let broken = path(&cache, "broken.mcap");
    fs::write(&broken, b"this is no recording").unwrap();
    for (arguments, code, wanted) in [
        (vec!["spectrum"], 2, "FILE"),
        (vec!["spectrum", PULL, "--band", "40..2"], 2, "lower end"),
        (vec!["spectrum", PULL, "--band", "forty"], 2, "LOW..HIGH"),
        (vec!["spectrum", PULL, "--unit", "furlong"], 2, "furlong"),
        (vec!["spectrum", PULL, "--rate", "0"], 2, "--rate"),
        (vec!["spectrum", PULL, "--no-such-flag"], 2, "--no-such-flag"),
        (vec!["spectrum", "no/such.mcap"], 1, "no/such.mcap"),
        (vec!["spectrum", &broken], 1, "broken.mcap"),
        (vec!["spectrum", &broken, PULL], 3, "broken.mcap"),
        (
            vec!["spectrum", PULL, "--topic", "/nave"],
            1,
            "it has /todi/displacement",
        ),
        (vec!["spectrum", PULL, "--field", "point.z"], 3, "there is: value"),
        (vec!["spectrum", PULL, "--band", "200..400"], 3, "refused"),
    ] {
        let output = tirante(&cache, &arguments);
        let said = said(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(wanted), "{arguments:?}: {said}");
        assert!(!said.contains("panicked"), "{said}");
    }
}

#[test]
fn a_refused_record_is_shown_with_its_peaks() {
    let cache = tempfile::tempdir().unwrap();
    let identify = |more: &[&str]| tirante(&cache, &[&["identify", PULL], &ONE_MODE[..], more].concat());
    let output = identify(&["--plot", "always"]);
    assert_eq!(output.status.code(), Some(3), "{}", said(&output));
    let shown = text(&output.stdout);
    for wanted in [
        "rejected (no-label): cannot number the modes",
        "taken for",
        "4.49",
        "record of",
    ] {
        assert!(shown.contains(wanted), "no {wanted} in\n{shown}");
    }
    assert!(is_drawn(&shown), "{shown}");
    let line = &json(&identify(&["--json"]))[0];
    let found = peaks(line);
    assert!(
        found.iter().any(|(f, _)| (f - TODI_HZ[0]).abs() < 0.05),
        "{found:?}"
    );
    assert!(
        line["excitation"]["kind"].is_string() && line["candidates"].is_array(),
        "{line}"
    );
    assert!(line["label_probability"].is_null(), "{line}");
    // Of one that gave a force the peaks are in its picture.
    let line = &json(&tirante(&cache, &["identify", PULL, "--json"]))[0];
    assert!(
        line["peaks"].is_null() && line["excitation"]["kind"].is_string(),
        "{line}"
    );
    assert!(line["label_probability"].as_f64().unwrap() > 0.5, "{line}");
    assert!(line["modes"][0]["misfit"].is_number(), "{line}");
}

#[test]
fn store_report_and_results_keep_the_picture_of_a_refused_record() {
    let cache = tempfile::tempdir().unwrap();
    let (store, page, results) = (
        path(&cache, "site.db"),
        path(&cache, "page"),
        path(&cache, "results.mcap"),
    );
    let arguments = [
        "replay",
        PULL,
        "--store",
        &store,
        "--report",
        &page,
        "--results",
        &results,
    ];
    let output = tirante(&cache, &[&arguments[..], &ONE_MODE].concat());
    assert_eq!(output.status.code(), Some(3), "{}", said(&output));
    let html = fs::read_dir(&page).unwrap().next().unwrap().unwrap().path();
    let html = fs::read_to_string(html).unwrap();
    for wanted in [
        "<strong>No force</strong>",
        "Vibration spectrum of the latest refused record of rod todi",
        "Waveform of the latest refused record of rod todi",
        "cannot number the modes",
        "Taken for",
    ] {
        assert!(html.contains(wanted), "no {wanted}");
    }
    let reader = tirante::site::store::Reader::open(Path::new(&store)).unwrap();
    let kept = reader
        .snapshots(&tirante::analysis::signal::record::RodId("todi".to_owned()))
        .unwrap();
    let refused = kept.refused.unwrap();
    assert!(kept.latest.is_none() && refused.densities.is_empty() && refused.waveform.is_some());
    assert_eq!(refused.rejection.unwrap().code, "no-label");
    assert!(!refused.peaks.is_empty() && refused.curve.level_db.len() > 50);

    // The results hold waveform and spectrum too, with the reason.
    let file = fs::read(&results).unwrap();
    let mut topics = Vec::new();
    for message in mcap::MessageStream::new(&file).unwrap() {
        let message = message.unwrap();
        let body: Json = serde_json::from_slice(&message.data).unwrap();
        assert!(!body["rejection"].is_null(), "{}: {body}", message.channel.topic);
        topics.push(message.channel.topic.clone());
    }
    topics.sort();
    assert_eq!(
        topics,
        [
            "/tirante/todi/force",
            "/tirante/todi/spectrum",
            "/tirante/todi/waveform"
        ]
    );
}

/// Two decays from the first sample on and noise of a hundredth, as another program writes it; 200 Hz, 40 s.
fn table() -> String {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut noise = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut text = "t [s];x [mm]\n".to_owned();
    for i in 0..8000 {
        let t = f64::from(i) / 200.0;
        let decay = |f: f64, zeta: f64| {
            (-std::f64::consts::TAU * f * zeta * t).exp() * (std::f64::consts::TAU * f * t).cos()
        };
        let x = 0.4 * decay(4.5, 0.002) + 0.3 * decay(9.7, 0.002) + 0.01 * noise();
        text += &format!("{t:.3};{x:.6}\n");
    }
    text
}

#[test]
fn another_programs_file_is_looked_at_as_it_comes() {
    let cache = tempfile::tempdir().unwrap();
    let file = path(&cache, "laser.csv");
    fs::write(&file, table()).unwrap();
    let output = tirante(&cache, &["spectrum", &file, "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let looks = json(&output);
    assert_eq!(looks.len(), 1, "{looks:?}");
    let look = &looks[0];
    assert_eq!(
        (look["unit"].as_str(), look["fs_hz"].as_f64()),
        (Some("m"), Some(200.0)),
        "{look}"
    );
    let found = peaks(look);
    for wanted in [4.5, 9.7] {
        // A hundredth of a hertz: the noise is 26 dB below, the line 0.025 Hz.
        let is_there = |(f, nature): &(f64, String)| (f - wanted).abs() < 0.01 && nature == "candidate";
        assert!(found.iter().any(is_there), "{found:?}");
    }
    assert_eq!(look["excitation"]["kind"], "free-decay", "{look}");
    // A rate that contradicts the stamps is refused, with the file's name.
    let output = tirante(&cache, &["spectrum", &file, "--rate", "150"]);
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("laser.csv"), "{}", said(&output));
}

/// Rows with stamps of a busy computer: the rate between their longer intervals (here 0.3 % too high) is no rate of the file. The
/// record measures it, and what a person says of it is compared with that.
#[test]
fn uneven_rows_do_not_contradict_the_rate_they_have() {
    let cache = tempfile::tempdir().unwrap();
    let file = path(&cache, "busy.csv");
    let mut lines = vec!["t [s];x [mm]".to_owned()];
    for (i, line) in table().lines().skip(1).enumerate() {
        // Up to 40 % of the interval early or late.
        let off = ((i as f64 * 12.9898).sin() * 43_758.545_3).fract() * 0.4 / 200.0;
        let (_, value) = line.split_once(';').unwrap();
        lines.push(format!("{:.7};{value}", 1.0 + i as f64 / 200.0 + off));
    }
    fs::write(&file, lines.join("\n") + "\n").unwrap();
    for arguments in [
        vec!["spectrum", file.as_str(), "--json"],
        vec!["spectrum", file.as_str(), "--json", "--rate", "200"],
    ] {
        let output = tirante(&cache, &arguments);
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
        let look = &json(&output)[0];
        let fs_hz = look["fs_hz"].as_f64().unwrap();
        assert!((fs_hz - 200.0).abs() < 0.02, "{look}");
        assert!(look["flags"].to_string().contains("jitter"), "{look}");
        let found = peaks(look);
        assert!(found.iter().any(|(f, _)| (f - 4.5).abs() < 0.01), "{found:?}");
    }
    let output = tirante(&cache, &["spectrum", &file, "--rate", "150"]);
    assert_eq!(output.status.code(), Some(3), "{}", said(&output));
    let told = said(&output) + &text(&output.stdout);
    assert!(
        told.contains("declared 150 Hz") && told.contains("the stamps say 200."),
        "{told}"
    );
}

/// Four in ten rows lost one by one, and interpolation asked for: what is missing is told as missing, not as another rate.
#[test]
fn lost_rows_are_missing_and_no_other_rate() {
    let cache = tempfile::tempdir().unwrap();
    let file = path(&cache, "lost.csv");
    let mut kept = Vec::new();
    for (i, line) in table().lines().enumerate() {
        // Two of seven, and up to eight together.
        if i < 2 || (i % 7 > 1 && i % 35 > 5) {
            kept.push(line.to_owned());
        }
    }
    fs::write(&file, kept.join("\n") + "\n").unwrap();
    let output = tirante(&cache, &["spectrum", &file, "--json", "--resample", "200"]);
    let look = &json(&output)[0];
    assert_eq!(look["fs_hz"].as_f64(), Some(200.0), "{look}");
    assert_ne!(look["rejection"]["code"], "rate", "{look}");
    let output = tirante(&cache, &["spectrum", &file, "--json"]);
    let look = &json(&output)[0];
    assert_eq!(look["rejection"]["code"], "missing", "{look}");
}

/// A laser that loses its target writes an error code for some rows.
#[test]
fn an_error_code_in_a_file_is_missing_data() {
    let cache = tempfile::tempdir().unwrap();
    let file = path(&cache, "laser.csv");
    let look = |every: usize, rows: usize| {
        let lines = table()
            .lines()
            .enumerate()
            .fold(String::new(), |text, (i, line)| {
                let lost = i > 1000 && i % every < rows;
                let shown = match line.split_once(';') {
                    Some((time, _)) if lost => format!("{time};-9999"),
                    _ => line.to_owned(),
                };
                text + &shown + "\n"
            });
        fs::write(&file, lines).unwrap();
        tirante(&cache, &["spectrum", &file, "--json"])
    };
    let output = look(1900, 8);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let line = &json(&output)[0];
    let found = peaks(line);
    for wanted in [4.5, 9.7] {
        assert!(
            found.iter().any(|(f, _)| (f - wanted).abs() < 0.01),
            "{wanted}: {found:?}"
        );
    }
    let flags = serde_json::json!([
        { "flag": "filled", "samples": 32 },
        { "flag": "error-code", "value": -9.999, "runs": 4, "samples": 32 },
    ]);
    assert_eq!(line["flags"], flags, "{line}");
    let line = &json(&look(20, 8))[0];
    assert_eq!(line["rejection"]["code"], "error-code", "{line}");
    let message = line["rejection"]["message"].as_str().unwrap();
    for wanted in [
        "exactly -9.999e0",
        "350 runs",
        "5.00 s",
        "lost its target",
        "raise max_missing",
    ] {
        assert!(message.contains(wanted), "no {wanted} in {message}");
    }
}

#[test]
fn set_overrides_a_key_of_the_configuration() {
    let cache = tempfile::tempdir().unwrap();
    let look = |more: &[&str]| {
        let words = ["spectrum", PULL, "--json"];
        tirante(&cache, &[&words[..], more].concat())
    };
    let config = ["--config", "config/todi.toml"];
    let orders = |output: &Output| {
        let line = &json(output)[0];
        let peaks = line["peaks"].as_array().unwrap().iter();
        peaks.filter(|peak| peak["order"].is_u64()).count()
    };
    assert_eq!(orders(&look(&config)), 3);
    assert_eq!(
        orders(&look(&[&config[..], &["--set", "modes.count=2"]].concat())),
        2
    );
    for (more, wanted) in [
        ([&config[..], &["--set", "modes.cuont=2"]].concat(), "modes.cuont"),
        (vec!["--set", "modes.count=2"], "--config"),
    ] {
        let output = look(&more);
        assert_eq!(output.status.code(), Some(2), "{}", said(&output));
        assert!(said(&output).contains(wanted), "{}", said(&output));
    }
}

/// `--time` names a column; an array has none, and says so instead of asking for it again.
#[test]
fn a_format_without_columns_refuses_time() {
    let cache = tempfile::tempdir().unwrap();
    let file = path(&cache, "a.npy");
    let header = format!(
        "{:<117}\n",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (4000,), }"
    );
    let mut bytes = b"\x93NUMPY\x01\x00v\x00".to_vec();
    bytes.extend_from_slice(header.as_bytes());
    for i in 0..4000 {
        bytes.extend_from_slice(&(f64::from(i) * 0.2).sin().to_le_bytes());
    }
    fs::write(&file, bytes).unwrap();
    let output = tirante(&cache, &["spectrum", &file, "--time", "t"]);
    assert_ne!(output.status.code(), Some(0));
    assert!(
        said(&output).contains("no column or variable that --time could name"),
        "{}",
        said(&output)
    );
}

#[test]
fn a_force_in_doubt_bears_its_mark_and_its_figures() {
    let cache = tempfile::tempdir().unwrap();
    let words = ["spectrum", PULL, "--config", "config/todi.toml"];
    let output = tirante(&cache, &words);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let table = text(&output.stdout);
    assert!(
        table.contains("  axial force ! ") && table.contains("  ! model and data disagree"),
        "{table}"
    );
    let output = tirante(&cache, &[&words[..], &["--json"]].concat());
    let look = &json(&output)[0];
    assert!(
        look["conflict"].as_f64().unwrap() >= 3.0 && look["prior_tail"].is_number(),
        "{look}"
    );
    let page = path(&cache, "page.html");
    tirante(&cache, &[&words[..], &["--html", page.as_str()]].concat());
    let page = fs::read_to_string(page).unwrap();
    assert!(page.contains(">! ") && page.contains("model and data disagree"));
}

#[test]
fn a_band_beyond_the_record_says_what_the_record_shows() {
    let cache = tempfile::tempdir().unwrap();
    let file = path(&cache, "laser.csv");
    // 200 Hz, without a time of day.
    fs::write(&file, table()).unwrap();
    for band in ["250..300", "0.001..0.1"] {
        let output = tirante(&cache, &["spectrum", &file, "--band", band]);
        assert_eq!(output.status.code(), Some(3), "{}", said(&output));
        let told = text(&output.stdout)
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ");
        assert!(
            told.contains("refused (no-band)")
                && told.contains("this record shows 0.")
                && told.contains("to 96.00 Hz"),
            "{band}: {told}"
        );
        assert!(
            !told.contains("prior") && !told.contains("min_duration_s"),
            "{band}: {told}"
        );
        assert!(
            told.contains("its time not said") && !told.contains("1970"),
            "{told}"
        );
    }
    let output = tirante(&cache, &["spectrum", &file, "--json"]);
    assert!(json(&output)[0]["start"].is_null(), "{}", said(&output));
}
