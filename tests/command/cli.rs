//! The program as users run it: exit codes, stdout and stderr.

use assert_cmd::Command;
use serde_json::Value;
use std::fs;

/// The program, in the project's folder, with a cache of its own.
fn tirante(cache: &tempfile::TempDir) -> Command {
    let mut command = Command::cargo_bin("tirante").expect("the program is built");
    command
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("TIRANTE_CACHE_DIR", cache.path())
        .env_remove("TIRANTE_LOG");
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

#[test]
fn a_replay_without_a_configuration_prints_the_papers_frequencies() {
    let cache = tempfile::tempdir().unwrap();
    let output = tirante(&cache)
        .args(["replay", "recordings/todi-pull.mcap"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let table = text(&output.stdout);
    for wanted in ["mode 1", "force", "4.49", "9.28", "13.25"] {
        assert!(table.contains(wanted), "no {wanted} in\n{table}");
    }
    assert!(text(&output.stderr).contains("1 record from 1 file: 1 identified"));
}

#[test]
fn json_lines_hold_every_promised_field_and_the_same_bytes_at_any_thread_count() {
    let cache = tempfile::tempdir().unwrap();
    let lines = |threads: &str| {
        let arguments = [
            "replay",
            "recordings/todi-pull.mcap",
            "--json",
            "--threads",
            threads,
        ];
        tirante(&cache).args(arguments).output().unwrap().stdout
    };
    let one = lines("1");
    assert_eq!(one, lines("3"));
    let line: Value = serde_json::from_slice(&one).unwrap();
    for field in [
        "rod",
        "start",
        "duration_s",
        "fs_hz",
        "modes",
        "axial_force_n",
        "parameters",
        "epsilon",
        "accepted",
        "conflict",
        "relative_force",
        "not_axial_p",
        "temperature_c",
        "state",
        "alarms",
        "rejection",
        "seed",
    ] {
        assert!(line.get(field).is_some(), "no {field} in {line}");
    }
    for (index, wanted) in [4.492, 9.288, 13.252].into_iter().enumerate() {
        let mode = &line["modes"][index];
        let (f, sd) = (
            mode["frequency_hz"].as_f64().unwrap(),
            mode["sd_hz"].as_f64().unwrap(),
        );
        // Five standard errors: the recording is fixed, so this either always holds or never.
        assert!(
            (f - wanted).abs() < 5.0 * sd && sd < 0.02,
            "mode {}: {f} +- {sd}",
            index + 1
        );
    }
    let force = &line["axial_force_n"];
    assert!(force["q025"].as_f64().unwrap() < force["mean"].as_f64().unwrap());
    assert!(
        line["conflict"].as_f64().unwrap() > 3.0,
        "the paper's own observation lies outside the model"
    );
}

#[test]
fn frequencies_measured_elsewhere_give_a_posterior() {
    let cache = tempfile::tempdir().unwrap();
    let arguments = [
        "identify",
        "--frequencies",
        "4.492,-,13.252",
        "--sd",
        "0.01",
        "--json",
    ];
    let output = tirante(&cache).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let line: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(line["modes"].as_array().unwrap().len(), 2);
    let mean = line["axial_force_n"]["mean"].as_f64().unwrap();
    assert!((3e5..9e5).contains(&mean), "{mean}");
}

#[test]
fn bad_arguments_exit_2_with_a_sentence() {
    let cache = tempfile::tempdir().unwrap();
    for (arguments, wanted) in [
        (vec!["replay"], "PATH"),
        (vec!["replay", "--no-such-flag", "x"], "--no-such-flag"),
        (vec!["identify", "--frequencies", "9.0,4.0"], "mode 2"),
        (
            vec!["identify", "--frequencies", "4.5", "--rod", "nobody"],
            "nobody",
        ),
        (vec!["identify", "--frequencies", "4.5", "--alpha", "7"], "7"),
        (
            vec!["replay", "recordings", "--config", "no/such.toml"],
            "no/such.toml",
        ),
    ] {
        let output = tirante(&cache).args(&arguments).output().unwrap();
        assert_eq!(
            output.status.code(),
            Some(2),
            "{arguments:?}: {}",
            text(&output.stderr)
        );
        assert!(
            text(&output.stderr).contains(wanted),
            "{arguments:?}: {}",
            text(&output.stderr)
        );
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn a_broken_file_is_named_and_the_good_one_beside_it_is_still_read() {
    let cache = tempfile::tempdir().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let good = fs::read(format!(
        "{}/recordings/todi-pull.mcap",
        env!("CARGO_MANIFEST_DIR")
    ))
    .unwrap();
    fs::write(folder.path().join("a-broken.mcap"), b"this is no recording").unwrap();
    fs::write(folder.path().join("b-good.mcap"), &good).unwrap();
    let output = tirante(&cache)
        .arg("replay")
        .arg(folder.path())
        .arg("--json")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    assert!(
        text(&output.stderr).contains("a-broken.mcap"),
        "{}",
        text(&output.stderr)
    );
    assert_eq!(text(&output.stdout).lines().count(), 1);
}

#[test]
fn nothing_readable_at_all_exits_1() {
    let cache = tempfile::tempdir().unwrap();
    let output = tirante(&cache)
        .args(["replay", "no/such/file.mcap"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stderr).contains("no/such/file.mcap"),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn every_command_has_long_help_with_examples_within_80_columns() {
    let cache = tempfile::tempdir().unwrap();
    let page = |args: &[&str]| text(&tirante(&cache).args(args).output().unwrap().stdout);
    let commands = |help: &str| -> Vec<String> {
        let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1);
        let rows = listed.map_while(|line| line.strip_prefix("  "));
        // A long sentence goes on in a second line, further in.
        rows.filter(|row| !row.starts_with(' '))
            .filter_map(|row| row.split_whitespace().next())
            .filter(|name| *name != "help")
            .map(str::to_owned)
            .collect()
    };
    let names = commands(&page(&["--help"]));
    assert!(names.len() >= 20, "{names:?}");
    for name in &names {
        let help = page(&[name, "--help"]);
        let first = help.lines().next().unwrap();
        let verb = first.split_whitespace().next().unwrap();
        assert!(!verb.ends_with('s') || verb.ends_with("ss"), "{name}: {first}");
        assert!(help.contains("Example"), "{name} --help has no example:\n{help}");
        for page in [&help, &page(&[name, "-h"])] {
            for line in page.lines() {
                assert!(line.chars().count() <= 80, "{name}: {line}");
            }
        }
    }
    // What stands behind the first sentence.
    let ack = page(&["ack", "--help"]);
    let words: Vec<&str> = ack.split_whitespace().collect();
    assert!(words.join(" ").contains("end when their condition ends"), "{ack}");
    assert_eq!(commands(&page(&["alarm", "--help"])), ["design", "prove", "test"]);
}

#[test]
fn json_has_one_spelling_and_an_older_one() {
    let cache = tempfile::tempdir().unwrap();
    let asked = |args: &[&str]| {
        let output = tirante(&cache)
            .args(["frequencies", "--order", "1"])
            .args(args)
            .output();
        let output = output.unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let json = asked(&["--format", "json"]);
    assert!(json.starts_with('{'), "{json}");
    assert_eq!(asked(&["--json"]), json);
    assert_eq!(asked(&["--format", "text"]), asked(&[]));
}

#[test]
fn one_bad_path_does_not_stop_the_others_and_copies_are_left_out() {
    let cache = tempfile::tempdir().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let good = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/todi-pull.mcap");
    let copy = folder.path().join("copy.mcap");
    fs::copy(good, &copy).unwrap();
    let output = tirante(&cache)
        .args(["replay", "--json", "no/such.mcap", good])
        .arg(&copy)
        .output()
        .unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert_eq!(text(&output.stdout).lines().count(), 1);
    assert!(
        said.contains("no/such.mcap") && said.contains("1 left out"),
        "{said}"
    );
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_stdout_is_exit_1_and_a_full_stderr_loses_nothing() {
    use std::process::{Command, Stdio};
    let cache = tempfile::tempdir().unwrap();
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").unwrap());
    let made = cache.path().join("made.mcap");
    let run = |arguments: &[&str], stdout: Stdio, stderr: Stdio| {
        Command::new(env!("CARGO_BIN_EXE_tirante"))
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .env("TIRANTE_CACHE_DIR", cache.path())
            .args(arguments)
            .stdout(stdout)
            .stderr(stderr)
            .spawn()
            .unwrap()
            .wait_with_output()
            .unwrap()
    };
    let replay = ["replay", "recordings/todi-pull.mcap"];
    let out = ["--out", made.to_str().unwrap()];
    let simulate = [&["simulate", "--config", "config/todi.toml"], &out[..]].concat();
    for arguments in [
        &replay[..],
        &simulate,
        &["check"],
        &["identify", "--frequencies", "4.5"],
    ] {
        let output = run(arguments, full(), Stdio::piped());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        assert!(!said.contains("panicked"), "{arguments:?}: {said}");
    }
    let output = run(&replay, Stdio::piped(), full());
    assert_eq!(output.status.code(), Some(0));
    assert!(text(&output.stdout).contains("kN"));
}

#[test]
fn a_growing_recording_gives_what_the_finished_one_gives() {
    use std::io::Write;
    let cache = tempfile::tempdir().unwrap();
    let whole = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/todi-pull.mcap")).unwrap();
    let path = cache.path().join("growing.mcap");
    let mut file = fs::File::create(&path).unwrap();
    file.write_all(&whole[..7]).unwrap();
    let follower = std::process::Command::new(env!("CARGO_BIN_EXE_tirante"))
        .env("TIRANTE_CACHE_DIR", cache.path())
        .args(["replay", "--follow", "--json"])
        .arg(&path)
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    for piece in whole[7..].chunks(whole.len() / 9) {
        std::thread::sleep(std::time::Duration::from_millis(50));
        file.write_all(piece).unwrap();
    }
    let followed = follower.wait_with_output().unwrap();
    let read = tirante(&cache)
        .args(["replay", "--json"])
        .arg(&path)
        .output()
        .unwrap();
    assert_eq!(text(&followed.stdout), text(&read.stdout));
    assert_eq!(text(&read.stdout).lines().count(), 1);
}

#[test]
fn plots_are_drawn_for_people_alone() {
    let cache = tempfile::tempdir().unwrap();
    let say = |words: &[&str]| {
        let output = tirante(&cache).args(words).output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let is_drawn = |text: &str| text.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c));
    let recording = "recordings/todi-pull.mcap";
    let piped = say(&["identify", recording]);
    assert!(!is_drawn(&piped));
    let drawn = say(&["identify", recording, "--plot", "always"]);
    assert!(drawn.starts_with(&piped) && is_drawn(&drawn), "{drawn}");
    assert!(
        drawn.contains("1: 4.49") && drawn.contains("frequency [Hz]"),
        "{drawn}"
    );
    // JSON stays JSON.
    let lines = say(&["replay", recording, "--json", "--plot", "always"]);
    assert_eq!(lines.lines().count(), 1);
}

#[test]
fn simulate_destroys_nothing_it_should_not() {
    let cache = tempfile::tempdir().unwrap();
    let target = cache.path().join("a.mcap");
    let target = target.to_str().unwrap();
    fs::write(target, "kept").unwrap();
    let device = if cfg!(unix) { "/dev/null" } else { "." };
    for (files, wanted) in [
        (vec!["--out", target], "exists"),
        (vec!["--out", target, "--truth", target, "--force"], "same file"),
        (vec!["--out", device, "--force"], "not a regular file"),
    ] {
        let output = tirante(&cache)
            .args(["simulate", "--config", "config/todi.toml"])
            .args(&files)
            .output()
            .unwrap();
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{files:?}: {said}");
        assert!(said.contains(wanted), "{files:?}: {said}");
    }
    assert_eq!(fs::read(target).unwrap(), b"kept");
}

#[test]
fn a_site_that_is_proved_keeps_its_promise_and_tells_a_loss_at_any_thread_count() {
    let cache = tempfile::tempdir().unwrap();
    let proved = |threads: &str| {
        let output = tirante(&cache)
            .env("RAYON_NUM_THREADS", threads)
            .args([
                "alarm",
                "prove",
                "--histories",
                "6",
                "--rods",
                "3",
                "--years",
                "0.15",
            ])
            .args(["--change", "step:-0.05@60", "--json"])
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let one = proved("1");
    assert_eq!(one, proved("2"));
    let proof: serde_json::Value = serde_json::from_str(&one).unwrap();
    assert_eq!(
        (&proof["world"], &proof["rods"], &proof["sites"]),
        (&"benign".into(), &6.into(), &2.into())
    );
    assert_eq!(proof["never_monitored"], 0);
    assert_eq!(proof["found"]["drift"], proof["found"]["followed"]);
    let median = proof["found"]["median_d"].as_f64().unwrap();
    // The period of the second record after the loss closes with the third; missing records take a day each.
    assert!((1.0..6.0).contains(&median), "{median}");
    let told = proof["coverage"]["all"].as_u64().unwrap();
    assert!(told > 20, "{told} records were told a change since the baseline");
}

#[test]
fn the_alarms_design_promises_delays_that_shorten_with_learning() {
    let cache = tempfile::tempdir().unwrap();
    let output = tirante(&cache)
        .args(["alarm", "design", "--json"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let promise: serde_json::Value = serde_json::from_str(&text(&output.stdout)).unwrap();
    let line = |relative: f64, learned: u64| {
        let lines = promise["delays"].as_array().unwrap();
        lines
            .iter()
            .find(|line| {
                line["relative"] == relative && line["change"] == "ramp" && line["learned_periods"] == learned
            })
            .unwrap()["median_d"]
            .as_f64()
            .unwrap()
    };
    assert!(line(-0.02, 365) < line(-0.02, 90) && line(-0.05, 365) < line(-0.02, 365));
    let least = |learned: u64, within: u64| {
        let lines = promise["least"].as_array().unwrap();
        let line = lines
            .iter()
            .find(|line| line["learned_periods"] == learned && line["within_d"] == within)
            .unwrap();
        line["ramp_per_year"].as_f64().unwrap()
    };
    assert!(least(365, 90) < least(30, 90) && least(30, 365) < least(30, 90));
    for (argument, value) in [("--world", "atlantis"), ("--noise", "2")] {
        let output = tirante(&cache)
            .args(["alarm", "design", argument, value])
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(2), "{argument} {value}");
    }
    let output = tirante(&cache)
        .args(["alarm", "prove", "--world", "benign,atlantis"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("masonry-30d"),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn draws_in_a_file_are_those_of_the_printed_force() {
    let cache = tempfile::tempdir().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let identify = |file: &str| {
        let path = folder.path().join(file);
        let words = [
            "identify",
            "--frequencies",
            "4.492,9.288,13.252",
            "--format",
            "json",
        ];
        let mut command = tirante(&cache);
        command.args(words).arg("--draws-out").arg(path);
        command.output().unwrap()
    };
    let printed = identify("draws.csv");
    assert!(printed.status.success(), "{}", text(&printed.stderr));
    let row: Value = serde_json::from_slice(&printed.stdout).unwrap();
    let csv = fs::read_to_string(folder.path().join("draws.csv")).unwrap();
    let mut lines = csv.split_terminator("\r\n");
    let names = "axial_force_n,youngs_modulus_pa,density_kg_m3,side_m,spring_left_n_m,spring_right_n_m,length_m,weight";
    assert_eq!(lines.next(), Some(names));
    let draws: Vec<Vec<f64>> = lines
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    assert_eq!(draws.len() as u64, row["accepted"].as_u64().unwrap());
    let mean: f64 = draws.iter().map(|draw| draw[0] * draw[7]).sum();
    let told = row["axial_force_n"]["mean"].as_f64().unwrap();
    // Two ways to add 2000 numbers: rounding alone.
    assert!((mean / told - 1.0).abs() < 1e-12, "{mean} {told}");

    // NumPy's file holds the same bits, behind a header of whole 64 bytes.
    assert!(identify("draws.npy").status.success());
    let npy = fs::read(folder.path().join("draws.npy")).unwrap();
    let numbers: Vec<f64> = draws.concat();
    let (header, body) = npy.split_at(npy.len() - 8 * numbers.len());
    assert!(
        header.starts_with(b"\x93NUMPY\x01\x00")
            && header.len().is_multiple_of(64)
            && header.ends_with(b"\n")
    );
    let read: Vec<f64> = body
        .chunks_exact(8)
        .map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap()))
        .collect();
    assert_eq!(read, numbers);

    let wrong = identify("draws.txt");
    assert_eq!(wrong.status.code(), Some(2));
    assert!(text(&wrong.stderr).contains("ends in .csv, .npy or .parquet"));
    let nowhere = identify("no/folder/draws.csv");
    assert_eq!(nowhere.status.code(), Some(1));
    assert!(text(&nowhere.stderr).contains("draws.csv") && nowhere.stdout.is_empty());
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().flatten().collect();
    assert_eq!(left.len(), 2, "{left:?}");
}
