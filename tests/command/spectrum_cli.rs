//! `tirante spectrum` as users run it, and the output for records without a force.
use crate::program::{ROOT, tirante};
use serde_json::Value as Json;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// The frequencies of the shipped recording \[Hz\] (config/todi.toml).
const TODI_HZ: [f64; 3] = [4.492, 9.288, 13.252];

const PULL: &str = "spectrum recordings/todi-pull.mcap";
const TODI: &str = "--config config/todi.toml";

/// Configuration under which the shipped recording has only one mode, which is not enough for a force.
const ONE_MODE: &str = "--set modes.masks=[{low_hz=6,high_hz=1000}]";

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

/// The only JSON line of a look at a recording, with further flags.
fn look(more: &str) -> Json {
    tirante(ROOT, &format!("{PULL} --json {more}")).only()
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
    let table = tirante(ROOT, &format!("{PULL} --plot always")).done();
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
    assert!(!is_drawn(&tirante(ROOT, PULL).done()));
}

#[test]
fn json_says_the_same_and_a_band_narrows_it() {
    let look = look("");
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
    let found = peaks(&self::look("--band 6..11"));
    assert!(
        found.iter().any(|(f, _)| (f - TODI_HZ[1]).abs() < 0.05),
        "{found:?}"
    );
    assert!(found.iter().all(|(f, _)| (5.9..11.1).contains(f)), "{found:?}");
}

#[test]
fn a_configuration_gives_orders_and_force() {
    let table = tirante(ROOT, &format!("{PULL} {TODI}")).done();
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
    let look = look(TODI);
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
    let folder = tempfile::tempdir().unwrap();
    let page = path(&folder, "pull.html");
    tirante(ROOT, &format!("{PULL} --html {page}")).done();
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
    fs::copy(
        Path::new(ROOT).join("recordings/todi-pull.mcap"),
        folder.path().join("copy.mcap"),
    )
    .unwrap();
    tirante(&folder, "spectrum copy.mcap --html copy.mcap").ends(2);
}

#[test]
fn what_cannot_be_looked_at_is_named_with_the_next_step() {
    let folder = tempfile::tempdir().unwrap();
    let broken = path(&folder, "broken.mcap");
    fs::write(&broken, b"this is no recording").unwrap();
    for (line, code, wanted) in [
        ("spectrum", 2, "FILE"),
        (&format!("{PULL} --band 40..2"), 2, "lower end"),
        (&format!("{PULL} --band forty"), 2, "LOW..HIGH"),
        (&format!("{PULL} --unit furlong"), 2, "furlong"),
        (&format!("{PULL} --rate 0"), 2, "--rate"),
        (&format!("{PULL} --no-such-flag"), 2, "--no-such-flag"),
        ("spectrum no/such.mcap", 1, "no/such.mcap"),
        (&format!("spectrum {broken}"), 1, "broken.mcap"),
        (&format!("{PULL} {broken}"), 3, "broken.mcap"),
        (&format!("{PULL} --topic /nave"), 1, "it has /todi/displacement"),
        (&format!("{PULL} --field point.z"), 3, "there is: value"),
        (&format!("{PULL} --band 200..400"), 3, "refused"),
    ] {
        let said = tirante(ROOT, line).ends(code).all();
        assert!(said.contains(wanted), "{line}: {said}");
        assert!(!said.contains("panicked"), "{said}");
    }
}

#[test]
fn a_refused_record_is_shown_with_its_peaks() {
    let identify = |more: &str| tirante(ROOT, &format!("identify recordings/todi-pull.mcap {more}"));
    let shown = identify(&format!("{ONE_MODE} --plot always")).ends(3).out;
    for wanted in [
        "rejected (no-label): cannot number the modes",
        "taken for",
        "4.49",
        "record of",
    ] {
        assert!(shown.contains(wanted), "no {wanted} in\n{shown}");
    }
    assert!(is_drawn(&shown), "{shown}");
    let line = &identify(&format!("{ONE_MODE} --json")).lines()[0];
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
    let line = identify("--json").only();
    assert!(
        line["peaks"].is_null() && line["excitation"]["kind"].is_string(),
        "{line}"
    );
    assert!(line["label_probability"].as_f64().unwrap() > 0.5, "{line}");
    assert!(line["modes"][0]["misfit"].is_number(), "{line}");
}

#[test]
fn store_report_and_results_keep_the_picture_of_a_refused_record() {
    let folder = tempfile::tempdir().unwrap();
    let [store, page, results] = ["site.db", "page", "results.mcap"].map(|name| path(&folder, name));
    tirante(
        ROOT,
        &format!(
            "replay recordings/todi-pull.mcap --store {store} --report {page} --results {results} {ONE_MODE}"
        ),
    )
    .ends(3);
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
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("laser.csv"), table()).unwrap();
    let look = &tirante(&folder, "spectrum laser.csv --json").only();
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
    let refused = tirante(&folder, "spectrum laser.csv --rate 150").ends(1).all();
    assert!(refused.contains("laser.csv"), "{refused}");
}

/// Rows with stamps of a busy computer: the rate between their longer intervals (here 0.3 % too high) is no rate of the file. The
/// record measures it, and what a person says of it is compared with that.
#[test]
fn uneven_rows_do_not_contradict_the_rate_they_have() {
    let folder = tempfile::tempdir().unwrap();
    let mut lines = vec!["t [s];x [mm]".to_owned()];
    for (i, line) in table().lines().skip(1).enumerate() {
        // Up to 40 % of the interval early or late.
        let off = ((i as f64 * 12.9898).sin() * 43_758.545_3).fract() * 0.4 / 200.0;
        let (_, value) = line.split_once(';').unwrap();
        lines.push(format!("{:.7};{value}", 1.0 + i as f64 / 200.0 + off));
    }
    fs::write(folder.path().join("busy.csv"), lines.join("\n") + "\n").unwrap();
    for flags in ["", "--rate 200"] {
        let look = &tirante(&folder, &format!("spectrum busy.csv --json {flags}")).only();
        let fs_hz = look["fs_hz"].as_f64().unwrap();
        assert!((fs_hz - 200.0).abs() < 0.02, "{look}");
        assert!(look["flags"].to_string().contains("jitter"), "{look}");
        let found = peaks(look);
        assert!(found.iter().any(|(f, _)| (f - 4.5).abs() < 0.01), "{found:?}");
    }
    let told = tirante(&folder, "spectrum busy.csv --rate 150").ends(3).all();
    assert!(
        told.contains("declared 150 Hz") && told.contains("the stamps say 200."),
        "{told}"
    );
}

/// Four in ten rows lost one by one, and interpolation asked for: what is missing is told as missing, not as another rate.
#[test]
fn lost_rows_are_missing_and_no_other_rate() {
    let folder = tempfile::tempdir().unwrap();
    let mut kept = Vec::new();
    for (i, line) in table().lines().enumerate() {
        // Two of seven, and up to eight together.
        if i < 2 || (i % 7 > 1 && i % 35 > 5) {
            kept.push(line.to_owned());
        }
    }
    fs::write(folder.path().join("lost.csv"), kept.join("\n") + "\n").unwrap();
    let look = |more: &str| tirante(&folder, &format!("spectrum lost.csv --json {more}")).lines()[0].clone();
    let interpolated = look("--resample 200");
    assert_eq!(interpolated["fs_hz"].as_f64(), Some(200.0), "{interpolated}");
    assert_ne!(interpolated["rejection"]["code"], "rate", "{interpolated}");
    assert_eq!(look("")["rejection"]["code"], "missing");
}

/// A laser that loses its target writes an error code for some rows.
#[test]
fn an_error_code_in_a_file_is_missing_data() {
    let folder = tempfile::tempdir().unwrap();
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
        fs::write(folder.path().join("laser.csv"), lines).unwrap();
        tirante(&folder, "spectrum laser.csv --json")
    };
    let line = look(1900, 8).only();
    let found = peaks(&line);
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
    let line = &look(20, 8).lines()[0];
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
    let look = |more: &str| tirante(ROOT, &format!("{PULL} --json {more}"));
    let orders = |more: &str| {
        let line = look(more).only();
        let peaks = line["peaks"].as_array().unwrap().iter();
        peaks.filter(|peak| peak["order"].is_u64()).count()
    };
    assert_eq!(orders(TODI), 3);
    assert_eq!(orders(&format!("{TODI} --set modes.count=2")), 2);
    for (more, wanted) in [
        (format!("{TODI} --set modes.cuont=2"), "modes.cuont"),
        ("--set modes.count=2".to_owned(), "--config"),
    ] {
        let said = look(&more).ends(2).all();
        assert!(said.contains(wanted), "{said}");
    }
}

/// `--time` names a column; an array has none, and says so instead of asking for it again.
#[test]
fn a_format_without_columns_refuses_time() {
    let folder = tempfile::tempdir().unwrap();
    let header = format!(
        "{:<117}\n",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (4000,), }"
    );
    let mut bytes = b"\x93NUMPY\x01\x00v\x00".to_vec();
    bytes.extend_from_slice(header.as_bytes());
    for i in 0..4000 {
        bytes.extend_from_slice(&(f64::from(i) * 0.2).sin().to_le_bytes());
    }
    fs::write(folder.path().join("a.npy"), bytes).unwrap();
    let refused = tirante(&folder, "spectrum a.npy --time t");
    assert_ne!(refused.code, Some(0));
    let said = refused.all();
    assert!(
        said.contains("no column or variable that --time could name"),
        "{said}"
    );
}

#[test]
fn a_force_in_doubt_bears_its_mark_and_its_figures() {
    let table = tirante(ROOT, &format!("{PULL} {TODI}")).done();
    assert!(
        table.contains("  axial force ! ") && table.contains("  ! model and data disagree"),
        "{table}"
    );
    let look = look(TODI);
    assert!(
        look["conflict"].as_f64().unwrap() >= 3.0 && look["prior_tail"].is_number(),
        "{look}"
    );
    let folder = tempfile::tempdir().unwrap();
    let page = path(&folder, "page.html");
    tirante(ROOT, &format!("{PULL} {TODI} --html {page}")).done();
    let page = fs::read_to_string(page).unwrap();
    assert!(page.contains(">! ") && page.contains("model and data disagree"));
}

#[test]
fn a_band_beyond_the_record_says_what_the_record_shows() {
    let folder = tempfile::tempdir().unwrap();
    // 200 Hz, without a time of day.
    fs::write(folder.path().join("laser.csv"), table()).unwrap();
    for band in ["250..300", "0.001..0.1"] {
        let told = tirante(&folder, &format!("spectrum laser.csv --band {band}"))
            .ends(3)
            .out;
        let told = told.split_whitespace().collect::<Vec<_>>().join(" ");
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
    let look = tirante(&folder, "spectrum laser.csv --json").only();
    assert!(look["start"].is_null(), "{look}");
}
