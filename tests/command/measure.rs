//! `tirante measure` as users run it: one file to a force with its marks, a configuration and a report;
//! questions on a terminal; messages of common errors at first contact.
use crate::program::{ROOT, Said, tirante};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// The axial force simulated in `recordings/aisle.mcap` \[N\] (config/aisle.toml).
const TRUTH_N: f64 = 140e3;
const RECORDING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/aisle.mcap");
const AISLE: &str = "--length 9.5 --section d45 --material iron";

/// Measures the rod of the shipped recording, or another file as one of it.
fn measure(folder: &Path, file: &str, flags: &str) -> Said {
    tirante(folder, &format!("measure {file} {AISLE} {flags}"))
}

fn read(folder: &Path, name: &str) -> String {
    fs::read_to_string(folder.join(name)).unwrap()
}

#[test]
fn the_first_command_of_the_readme_measures_a_rod() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let Said { out, err, .. } = measure(at, RECORDING, "--plot always").ends(0);
    for wanted in [
        "9.5 m long, round, diameter 45 mm, wrought iron",
        "ambient vibration",
        "mode 1",
        "mode 3",
        "power spectral density [dB] over frequency [Hz]",
        "\n  axial force 14",
        "what the force hangs on",
    ] {
        assert!(out.contains(wanted), "no {wanted:?} in\n{out}");
    }
    assert!(
        err.contains("configuration: aisle.toml") && err.contains("report: aisle.html"),
        "{err}"
    );
    // The first line bears the path.
    assert!(
        out.lines().skip(1).all(|line| line.chars().count() <= 80),
        "{out}"
    );

    // The configuration is used unchanged, and contains the measurement's facts.
    tirante(at, "check --quiet aisle.toml").done();
    let line = tirante(at, &format!("identify {RECORDING} --config aisle.toml --json")).only();
    let force = &line["axial_force_n"];
    assert!(
        force["q025"].as_f64().unwrap() < TRUTH_N && TRUTH_N < force["q975"].as_f64().unwrap(),
        "{force}"
    );
    let kn = |key: &str| format!("{:.0}", 1e-3 * force[key].as_f64().unwrap());
    let told = format!("axial force {} kN ({} to {})", kn("mean"), kn("q025"), kn("q975"));
    assert!(out.contains(&told), "no {told} in\n{out}");

    let page = read(at, "aisle.html");
    let headline = format!("<strong>{} kN</strong>", kn("mean"));
    for wanted in [
        headline.as_str(),
        "45 mm \u{b1} 2 %",
        "9.5 m",
        "2026-03-01 06:00 UTC",
        "Damping [%]",
        "Vibration spectrum of rod aisle",
        "Waveform of rod aisle",
        "Signature",
        "What the force hangs on",
        "Measured once, so there is no change to tell: learning, baseline 1 of 30 records.",
    ] {
        assert!(page.contains(wanted), "no {wanted:?} in the report");
    }
    assert!(
        !page.contains("All rods") && !page.contains("class=\"note\""),
        "nothing to compare, nothing to doubt"
    );

    // A configuration is never overwritten, and the refusal comes before any question.
    tirante(at, &format!("measure {RECORDING}"))
        .ends(2)
        .says(&["aisle.toml: exists", "tirante identify"]);
}

/// The output in the README below its first command equals the command's output.
#[test]
fn the_readme_shows_what_its_first_command_prints() {
    let readme = fs::read_to_string(Path::new(ROOT).join("README.md")).unwrap();
    let (_, rest) = readme.split_once("cargo run -- ").unwrap();
    let (command, rest) = rest.split_once('\n').unwrap();
    let (_, rest) = rest.split_once("```text\n").unwrap();
    let (shown, _) = rest.split_once("```").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let line = format!("{command} --plot always --out {}", folder.path().display());
    let out = tirante(ROOT, &line).done();
    assert!(shown.lines().count() > 20, "{shown}");
    for line in shown.lines().filter(|line| *line != "...") {
        assert!(
            out.lines().any(|told| told.trim_end() == line.trim_end()),
            "{line:?} is not in\n{out}"
        );
    }
}

/// A bar of 228 mm over 19 m under 954 kN: its own stiffness carries its frequencies.
#[test]
fn a_force_that_is_hardly_told_has_its_mark() {
    let folder = tempfile::tempdir().unwrap();
    let rod = "--length 19.09 --section s227.7 --material iron";
    let place = "--fs-hz 100 --topic bar --field x --unit m";
    tirante(&folder, &format!("init --out bar.toml --id bar {place} {rod}")).done();
    let identify = |more: &str| {
        let line = "identify --config bar.toml --sd 0.001 --frequencies 2.438,7.544,15.540";
        tirante(&folder, &format!("{line} {more}"))
    };
    let said = identify("").done();
    assert!(
        said.contains("\n  ? the interval spans more than a factor of ten"),
        "{said}"
    );
    let line = identify("--json").only();
    let end = |key: &str| line["axial_force_n"][key].as_f64().unwrap();
    assert!(end("q975") > 10.0 * end("q025"), "{line}");
}

#[test]
fn json_is_the_record_line_and_the_same_twice() {
    let folder = tempfile::tempdir().unwrap();
    let lines = |out: &str| {
        measure(
            folder.path(),
            RECORDING,
            &format!("--json --id aisle-1 --out {out}"),
        )
        .done()
    };
    let one = lines("a");
    assert_eq!(one, lines("b"));
    let line: Value = serde_json::from_str(&one).unwrap();
    assert_eq!(line["rod"], "aisle-1");
    assert!(line["label_probability"].as_f64().unwrap() > 0.99);
    assert_eq!(
        fs::read(folder.path().join("a/aisle.html")).unwrap(),
        fs::read(folder.path().join("b/aisle.html")).unwrap()
    );
}

/// The paper's record fits no beam: its force is marked wherever it is shown, and without an expected force
/// there is none.
#[test]
fn a_force_in_doubt_bears_its_mark_and_orders_in_doubt_give_none() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let pull =
        format!("measure {ROOT}/recordings/todi-pull.mcap --length 14 --section s71.5 --material iron");
    let out = tirante(at, &format!("{pull} --force '600 kN'")).done();
    assert!(
        out.contains("\n  ! axial force ") && out.contains("! model and data disagree"),
        "{out}"
    );
    assert!(read(at, "todi-pull.html").contains("<p class=\"note\" role=\"note\">Model and data disagree"));

    let out = tirante(at, &format!("{pull} --out unknown")).ends(3).out;
    assert!(!out.contains("axial force"), "{out}");
    assert!(
        out.contains("rejected (no-label)") && out.contains("probability"),
        "{out}"
    );
    // To be corrected and tried again, as the refusal advises.
    assert!(at.join("unknown/todi-pull.toml").exists() && at.join("unknown/todi-pull.html").exists());
    let again = || tirante(at, &format!("{pull} --out unknown --force '600 kN'"));
    let unknown = read(at, "unknown/todi-pull.toml");
    // Corrected by hand it is nobody's to replace, nor is another's report.
    fs::write(
        at.join("unknown/todi-pull.toml"),
        unknown.replacen("length_m = 14.0", "length_m = 14.1", 1),
    )
    .unwrap();
    again().ends(2).says(&["exists, and is not overwritten"]);
    fs::write(at.join("unknown/todi-pull.toml"), &unknown).unwrap();
    assert!(again().done().contains("! axial force "));
    assert!(read(at, "unknown/todi-pull.toml").contains("axial_force_n = { mean = 600000.0"));
    assert!(read(at, "unknown/todi-pull.html").contains("class=\"headline\""));
    // Now it gave a force.
    again().ends(2).says(&["tirante identify"]);
}

#[test]
fn another_file_of_the_reports_name_is_not_lost() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("aisle.html"), "precious").unwrap();
    measure(at, RECORDING, "").ends(2).says(&["aisle.html: exists"]);
    assert_eq!(read(at, "aisle.html"), "precious");
    assert!(!at.join("aisle.toml").exists());
}

/// A section that cannot be right: no force, and the report says why on its first page, with the facts and a line to sign.
#[test]
fn a_rod_without_a_force_says_what_to_check() {
    let folder = tempfile::tempdir().unwrap();
    let line = format!("measure {RECORDING} --length 9.5 --section d500 --material steel");
    let out = tirante(&folder, &line).ends(3).out;
    assert!(
        out.contains("no-label") && out.contains("Check length, section and material"),
        "{out}"
    );
    let page = read(folder.path(), "aisle.html");
    for wanted in [
        "No force",
        "diameter",
        "500 mm",
        "cannot number the modes",
        "Signature",
    ] {
        assert!(page.contains(wanted), "no {wanted}");
    }
    // Tables of a rod that is followed say nothing of one that was measured once.
    for unwanted in ["All rods", "Baselines", "None so far"] {
        assert!(!page.contains(unwanted), "{unwanted}");
    }
}

#[test]
fn what_is_not_said_is_named_by_its_flags_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut array = b"\x93NUMPY\x01\x00\x46\x00".to_vec();
    array.extend(
        format!(
            "{:<69}\n",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }"
        )
        .bytes(),
    );
    array.extend([0; 16]);
    fs::write(at.join("bare.npy"), array).unwrap();
    fs::write(
        at.join("two.csv"),
        "Time [s],North [mm],South [mm]\n0,1,1\n0.01,2,0\n0.02,1,1\n",
    )
    .unwrap();
    for (file, flags, code, wanted) in [
        (RECORDING, "", 2, "--length, --section and --material are needed"),
        (RECORDING, "--length 9.5 --section d45", 2, "--material is needed"),
        (
            RECORDING,
            "--section '40 mm' --length 3 --material iron",
            2,
            "--section 'd 40 mm'",
        ),
        (RECORDING, "--length 9500", 2, "9500 mm, or 9500 m"),
        (RECORDING, "--section '40 kg'", 2, "is no unit of length"),
        (RECORDING, "--force 20", 2, "20 kN, or 20 N"),
        (
            "bare.npy",
            AISLE,
            2,
            "--rate, or --time with the column of the stamps, is needed",
        ),
        (
            "two.csv",
            AISLE,
            2,
            "--topic is needed (topic of the samples, one of North, South)",
        ),
        ("nothing.csv", AISLE, 1, "nothing.csv"),
    ] {
        let refused = tirante(at, &format!("measure {file} {flags}"));
        assert!(refused.ends(code).says(&[wanted]).out.is_empty());
    }
    let mut left: Vec<PathBuf> = fs::read_dir(at)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    left.sort();
    assert_eq!(left, [at.join("bare.npy"), at.join("two.csv")]);
}

/// A person at a terminal: wrong answers are asked again with the reason, and earlier answers are kept.
#[test]
fn questions_on_a_terminal_are_asked_until_they_are_understood() {
    let script = r#"
import os, pty, subprocess, sys, time
program, file, out = sys.argv[1:4]
parent, child = pty.openpty()
running = subprocess.Popen([program, "measure", file, "--out", out], stdin=child, stderr=child, stdout=subprocess.PIPE)
os.close(child)
seen = b""
for answer in sys.argv[4:]:
    asked = seen.count(b"): ") + seen.count(b"square: ")
    while seen.count(b"): ") + seen.count(b"square: ") == asked:
        seen += os.read(parent, 1024)
    os.write(parent, b"\x04" if answer == "END" else answer.encode() + b"\n")
    # Its echo is no question.
    time.sleep(0.05)
said = running.stdout.read()
while True:
    try:
        more = os.read(parent, 1024)
    except OSError:
        break
    if not more:
        break
    seen += more
sys.stdout.buffer.write(seen + b"\n---\n" + said)
sys.exit(running.wait())
"#;
    let has_python = std::process::Command::new("python3")
        .args(["-c", "import pty"])
        .output();
    if !has_python.is_ok_and(|output| output.status.success()) {
        eprintln!("left out: no python3");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let play = |out: &str, answers: &[&str]| {
        let output = std::process::Command::new("python3")
            .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
            .args(["-c", script, env!("CARGO_BIN_EXE_tirante"), RECORDING])
            .arg(folder.path().join(out))
            .args(answers)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        (
            output.status.code(),
            said + &String::from_utf8_lossy(&output.stderr),
        )
    };
    let (code, said) = play(
        "a",
        &["long", "9500", "9,5 m", "45 mm", "oval", "round", "wood", "iron"],
    );
    assert_eq!(code, Some(0), "{said}");
    for wanted in [
        "does not begin with a number",
        "9500 mm, or 9500 m",
        "= 9.5 m",
        "45 mm: round or square",
        "neither round nor square",
        "= round, diameter 45 mm",
        "neither iron nor steel",
        "axial force 14",
    ] {
        assert!(said.contains(wanted), "no {wanted:?} in\n{said}");
    }
    let (code, said) = play("b", &["9.5", "END"]);
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("no answer: --section is needed"), "{said}");
    assert!(!folder.path().join("b").exists());
}

#[test]
fn a_rod_measured_once_has_its_force_first_in_status_and_report() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    measure(at, RECORDING, "").done();
    tirante(
        at,
        &format!("replay {RECORDING} --config aisle.toml --store site.db --report site.html"),
    )
    .done();
    let table = tirante(at, "status --store site.db").out;
    let lines: Vec<&str> = table.lines().collect();
    assert!(
        lines[2].contains("learning") && lines[2].contains("14") && lines[2].contains(" to "),
        "{table}"
    );
    assert!(
        lines[3].contains("the force is that of the latest record alone"),
        "{table}"
    );
    assert!(
        lines[4].contains("learning: baseline 1 of 30 records, charts 0 of 30 periods"),
        "{table}"
    );
    let status = tirante(at, "status --store site.db --format json").only();
    assert!(status["force_n"].is_null());
    assert_eq!(status["doubts"], serde_json::json!([]));
    assert_eq!(status["learning_takes"]["records"], 30);
    assert!((status["axial_force_n"]["mean"].as_f64().unwrap() / TRUTH_N - 1.0).abs() < 0.2);
    assert!(read(at, "site.html").contains("class=\"headline\""));
}

/// The samples do not say their unit, which a force does not need; a hammer's channel beside them is not taken for motion.
#[test]
fn other_programs_files_are_measured_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    assert!(
        !tirante(at, &format!("spectrum {RECORDING} --json"))
            .done()
            .is_empty()
    );
    let samples = samples(RECORDING);
    let table = |unit: &str, decimal: char| {
        let rows = samples.iter().enumerate().map(|(i, value)| {
            let row = format!("{:.2};{:.6};{}", i as f64 / 100.0, 1e3 * value, i % 7);
            row.replace('.', &decimal.to_string())
        });
        format!(
            "Zeit;Laser;Hammer\ns;{unit};V\n{}\n",
            rows.collect::<Vec<_>>().join("\n")
        )
    };
    fs::write(at.join("comma.csv"), table("mm", ',')).unwrap();
    let out = measure(at, "comma.csv", "").done();
    assert!(out.contains("axial force 14"), "{out}");
    assert!(read(at, "comma.toml").contains("topic = \"Laser\""));
    assert!(
        out.contains("its time not said")
            && read(at, "comma.html").contains("at a time the file does not say")
    );

    let single = samples
        .iter()
        .map(|value| format!("{value:e}\n"))
        .collect::<String>();
    fs::write(at.join("bare.txt"), single).unwrap();
    let out = measure(at, "bare.txt", "--rate 100")
        .says(&["does not say its unit"])
        .done();
    assert!(out.contains("axial force 14"), "{out}");
}

/// The samples of the shipped record \[m\].
fn samples(path: &str) -> Vec<f64> {
    use tirante::analysis::signal::record::{Event, RecordSettings};
    let how = tirante::recording::import::How::default();
    let opened = tirante::recording::import::open_any(
        Path::new(path),
        &how,
        &RecordSettings::default(),
        &|file, _| Box::new(file),
    );
    let records = opened.unwrap().recording.filter_map(|event| match event {
        Event::Record(record) => Some(record.samples.clone()),
        _ => None,
    });
    records.flatten().collect()
}

/// Errors at first contact: each message names cause and remedy.
#[test]
fn messages_name_cause_and_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("laser.csv"), "Time [s],Laser [mm]\n0,1\n0.01,2\n0.02,1\n").unwrap();
    fs::copy(at.join("laser.csv"), at.join("laser.mcap")).unwrap();
    let commas = "Weg\nmm\n".to_owned() + &"0,125\n0,250\n".repeat(100);
    fs::write(at.join("commas.csv"), commas).unwrap();
    let todi = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/todi.toml")).unwrap();
    let field = todi.replace("field = \"value\"", "field = \"nothing\"");
    let field = field.split("[simulation]").next().unwrap();
    assert!(field.contains("\"nothing\""));
    fs::write(at.join("field.toml"), field).unwrap();
    for (line, wanted, unwanted) in [
        (
            "replay laser.csv".to_owned(),
            &["tirante measure", "tirante import", "--config"][..],
            "recorder",
        ),
        (
            "replay laser.mcap".to_owned(),
            &["is no recording, but a text table", "tirante import"],
            "recorder",
        ),
        (
            format!("replay {RECORDING}"),
            &[
                "no topic /todi/displacement",
                "built-in rod of the paper",
                "tirante measure",
            ],
            "100 %",
        ),
        (
            format!("replay {ROOT}/recordings/todi-pull.mcap --config field.toml"),
            &["no field `nothing`; there is: value"],
            "at most 0.0 %",
        ),
        (
            "measure commas.csv".to_owned(),
            &["--decimal-comma", "--delimiter"],
            "panic",
        ),
    ] {
        let said = tirante(at, &line).says(wanted);
        assert_ne!(said.code, Some(0), "{line}");
        assert!(!said.all().contains(unwanted), "{line}: {}", said.all());
    }
}

/// 200 Hz counted in milliseconds, without a unit in the head: asked for, and never taken for 0.2 Hz.
#[test]
fn a_time_column_without_a_unit_is_asked_for_its_unit() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let motion = |i: i32| (f64::from(i) * 0.188).sin() + 0.3 * (f64::from(i) * 0.392).sin();
    let rows: String = (0..6000)
        .map(|i| format!("{},{:.6}\n", 5 * i, motion(i)))
        .collect();
    fs::write(at.join("laser.csv"), format!("time,disp [mm]\n{rows}")).unwrap();
    measure(at, "laser.csv", "")
        .ends(2)
        .says(&["--time-unit is needed", "ms: 200 Hz"]);
    tirante(at, "spectrum laser.csv").ends(1).says(&["--time-unit"]);
    let said = measure(at, "laser.csv", "--time-unit ms").all();
    assert!(said.contains("at 200.00 Hz"), "{said}");
}
