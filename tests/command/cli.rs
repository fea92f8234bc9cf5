//! The program as users run it: exit codes, stdout and stderr.

use crate::program::{ROOT, Said, program, tirante, words};
use serde_json::Value;
use std::fs;

const PULL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/todi-pull.mcap");

#[test]
fn a_replay_without_a_configuration_prints_the_papers_frequencies() {
    let table = tirante(ROOT, "replay recordings/todi-pull.mcap")
        .says(&["1 record from 1 file: 1 identified"])
        .done();
    for wanted in ["mode 1", "force", "4.49", "9.28", "13.25"] {
        assert!(table.contains(wanted), "no {wanted} in\n{table}");
    }
}

/// The thermometer's topic is there, so no file is without everything, and nothing else would tell of the rod.
#[test]
fn a_mistyped_topic_is_named_at_the_end_of_a_replay() {
    let folder = tempfile::tempdir().unwrap();
    let good = fs::read_to_string(format!("{ROOT}/config/campaign.toml")).unwrap();
    let mistyped = good.replace("/nave-3/displacement", "/Nave-3/displacment");
    assert_ne!(mistyped, good);
    fs::write(folder.path().join("site.toml"), mistyped).unwrap();
    tirante(
        folder.path(),
        &format!("replay {ROOT}/recordings/campaign-2025.mcap --config site.toml"),
    )
    .says(&[
        "/nave-3/displacement is in the files and belongs to no rod",
        "the nearest is /Nave-3/displacment (rod nave-3): mend `topic` in its [rod.channel]",
        "nothing of rod nave-3",
    ])
    .ends(3);
}

/// The configuration's unit counts; the file may be right.
#[test]
fn another_unit_in_the_file_is_a_warning_with_both() {
    let folder = tempfile::tempdir().unwrap();
    let good = fs::read_to_string(format!("{ROOT}/config/todi.toml")).unwrap();
    let other = good.replace("unit = \"m\"", "unit = \"mm\"");
    assert_ne!(other, good);
    fs::write(folder.path().join("site.toml"), other).unwrap();
    tirante(folder.path(), &format!("replay {PULL} --config site.toml"))
        .says(&["the file says m, and the configuration reads mm: mend `unit`"]);
}

#[test]
fn json_lines_hold_every_promised_field_and_the_same_bytes_at_any_thread_count() {
    let replay = |threads| {
        tirante(
            ROOT,
            &format!("replay recordings/todi-pull.mcap --json --threads {threads}"),
        )
    };
    let one = replay(1);
    assert_eq!(one.out, replay(3).out);
    let line = one.only();
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
    let line = tirante(ROOT, "identify --frequencies 4.492,-,13.252 --sd 0.01 --json").only();
    assert_eq!(line["modes"].as_array().unwrap().len(), 2);
    let mean = line["axial_force_n"]["mean"].as_f64().unwrap();
    assert!((3e5..9e5).contains(&mean), "{mean}");
}

#[test]
fn bad_arguments_exit_2_with_a_sentence() {
    for (line, wanted) in [
        ("replay", "PATH"),
        ("replay --no-such-flag x", "--no-such-flag"),
        ("identify --frequencies 9.0,4.0", "mode 2"),
        ("identify --frequencies 4.5 --rod nobody", "nobody"),
        ("identify --frequencies 4.5 --alpha 7", "7"),
        ("replay recordings --config no/such.toml", "no/such.toml"),
    ] {
        let refused = tirante(ROOT, line).ends(2).says(&[wanted]);
        assert!(refused.out.is_empty());
    }
}

#[test]
fn a_broken_file_is_named_and_the_good_one_beside_it_is_still_read() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a-broken.mcap"), b"this is no recording").unwrap();
    fs::copy(PULL, folder.path().join("b-good.mcap")).unwrap();
    let said = tirante(&folder, "replay . --json")
        .ends(3)
        .says(&["a-broken.mcap"]);
    assert_eq!(said.out.lines().count(), 1);
}

#[test]
fn nothing_readable_at_all_exits_1() {
    tirante(ROOT, "replay no/such/file.mcap")
        .ends(1)
        .says(&["no/such/file.mcap"]);
}

#[test]
fn every_command_has_long_help_with_examples_within_80_columns() {
    let page = |line: &str| tirante(ROOT, line).done();
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
    let names = commands(&page("--help"));
    assert!(names.len() >= 20, "{names:?}");
    for name in &names {
        let help = page(&format!("{name} --help"));
        let first = help.lines().next().unwrap();
        let verb = first.split_whitespace().next().unwrap();
        assert!(!verb.ends_with('s') || verb.ends_with("ss"), "{name}: {first}");
        assert!(help.contains("Example"), "{name} --help has no example:\n{help}");
        for page in [&help, &page(&format!("{name} -h"))] {
            for line in page.lines() {
                assert!(line.chars().count() <= 80, "{name}: {line}");
            }
        }
    }
    // What stands behind the first sentence.
    let ack = page("ack --help");
    let words: Vec<&str> = ack.split_whitespace().collect();
    assert!(words.join(" ").contains("end when their condition ends"), "{ack}");
    assert_eq!(commands(&page("alarm --help")), ["design", "prove", "test"]);
}

#[test]
fn json_has_one_spelling_and_an_older_one() {
    let asked = |flag: &str| tirante(ROOT, &format!("frequencies --order 1 {flag}")).done();
    let json = asked("--format json");
    assert!(json.starts_with('{'), "{json}");
    assert_eq!(asked("--json"), json);
    assert_eq!(asked("--format text"), asked(""));
}

#[test]
fn one_bad_path_does_not_stop_the_others_and_copies_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    fs::copy(PULL, folder.path().join("copy.mcap")).unwrap();
    let said = tirante(&folder, &format!("replay --json no/such.mcap {PULL} copy.mcap"));
    let said = said.ends(3).says(&["no/such.mcap", "1 left out"]);
    assert_eq!(said.out.lines().count(), 1);
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_stdout_is_exit_1_and_a_full_stderr_loses_nothing() {
    use std::process::Stdio;
    let folder = tempfile::tempdir().unwrap();
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").unwrap());
    let run = |line: &str, stdout: Stdio, stderr: Stdio| {
        let mut command = program(ROOT);
        command.args(words(line)).stdout(stdout).stderr(stderr);
        Said::of(line, &mut command)
    };
    let replay = "replay recordings/todi-pull.mcap";
    let made = folder.path().join("made.mcap");
    for line in [
        replay,
        &format!("simulate --config config/todi.toml --out {}", made.display()),
        "check",
        "identify --frequencies 4.5",
    ] {
        let said = run(line, full(), Stdio::piped()).ends(1);
        assert!(!said.err.contains("panicked"), "{line}: {}", said.err);
    }
    assert!(run(replay, Stdio::piped(), full()).done().contains("kN"));
}

#[test]
fn a_site_without_a_thermometer_is_told_so_beforehand() {
    let says = |arguments: &[&str]| {
        let mut command = program(ROOT);
        command.arg("check").args(arguments);
        Said::of("check", &mut command).ends(0).err
    };
    let said = says(&["config/campaign.toml"]);
    assert!(!said.contains("no thermometer"), "{said}");
    let said = says(&[]);
    assert!(said.contains("no thermometer ([rod.temperature])"), "{said}");
    assert!(!says(&["--set", "track.temperature=ignore"]).contains("no thermometer"));
    assert_eq!(says(&["--quiet"]), "");
}

#[test]
fn a_secret_that_others_can_read_is_refused_before_the_daemon_starts() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let token = folder.path().join("token");
    fs::write(&token, "0123456789abcdef0123\n").unwrap();
    let sink =
        "sink=[{ id = \"hook\", kind = \"webhook\", url = \"https://example.org\", token_file = FILE }]";
    for setting in ["http.token_file=FILE", sink] {
        let setting = setting.replace("FILE", &format!("{:?}", token.to_str().unwrap()));
        for (mode, code) in [(0o600, 0), (0o644, 2)] {
            fs::set_permissions(&token, fs::Permissions::from_mode(mode)).unwrap();
            let mut command = program(ROOT);
            command.args(["check", "config/todi.toml", "--quiet", "--set", &setting]);
            let said = Said::of("check", &mut command).ends(code);
            assert_eq!(
                said.err.contains("chmod 600"),
                code == 2,
                "{setting}: {}",
                said.err
            );
        }
    }
}

#[test]
fn a_growing_recording_gives_what_the_finished_one_gives() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    let whole = fs::read(PULL).unwrap();
    let mut file = fs::File::create(folder.path().join("growing.mcap")).unwrap();
    file.write_all(&whole[..7]).unwrap();
    let follower = program(&folder)
        .args(["replay", "--follow", "--json", "growing.mcap"])
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    for piece in whole[7..].chunks(whole.len() / 9) {
        std::thread::sleep(std::time::Duration::from_millis(50));
        file.write_all(piece).unwrap();
    }
    let followed = follower.wait_with_output().unwrap();
    let read = tirante(&folder, "replay --json growing.mcap").out;
    assert_eq!(String::from_utf8(followed.stdout).unwrap(), read);
    assert_eq!(read.lines().count(), 1);
}

#[test]
fn plots_are_drawn_for_people_alone() {
    let say = |line: &str| tirante(ROOT, &format!("{line} --plot always")).done();
    let is_drawn = |text: &str| text.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c));
    let piped = tirante(ROOT, "identify recordings/todi-pull.mcap").done();
    assert!(!is_drawn(&piped));
    let drawn = say("identify recordings/todi-pull.mcap");
    assert!(drawn.starts_with(&piped) && is_drawn(&drawn), "{drawn}");
    assert!(
        drawn.contains("1: 4.49") && drawn.contains("frequency [Hz]"),
        "{drawn}"
    );
    // JSON stays JSON.
    let lines = say("replay recordings/todi-pull.mcap --json");
    assert_eq!(lines.lines().count(), 1);
}

#[test]
fn simulate_destroys_nothing_it_should_not() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.mcap");
    fs::write(&target, "kept").unwrap();
    let at = target.display();
    let device = if cfg!(unix) { "/dev/null" } else { "." };
    for (files, wanted) in [
        (format!("--out {at}"), "exists"),
        (format!("--out {at} --truth {at} --force"), "same file"),
        (format!("--out {device} --force"), "not a regular file"),
    ] {
        tirante(ROOT, &format!("simulate --config config/todi.toml {files}"))
            .ends(2)
            .says(&[wanted]);
    }
    assert_eq!(fs::read(target).unwrap(), b"kept");
}

#[test]
fn a_site_that_is_proved_keeps_its_promise_and_tells_a_loss_at_any_thread_count() {
    let line = "alarm prove --histories 6 --rods 3 --years 0.15 --change step:-0.05@60 --json";
    let proved = |threads: &str| {
        let mut command = program(ROOT);
        command.env("RAYON_NUM_THREADS", threads).args(words(line));
        Said::of(line, &mut command).done()
    };
    let one = proved("1");
    assert_eq!(one, proved("2"));
    let proof: Value = serde_json::from_str(&one).unwrap();
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
    let promise = tirante(ROOT, "alarm design --json").only();
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
    for flag in ["--world atlantis", "--noise 2"] {
        tirante(ROOT, &format!("alarm design {flag}")).ends(2);
    }
    tirante(ROOT, "alarm prove --world benign,atlantis")
        .ends(2)
        .says(&["masonry-30d"]);
}

#[test]
fn draws_in_a_file_are_those_of_the_printed_force() {
    let folder = tempfile::tempdir().unwrap();
    let identify = |file: &str| {
        let words = "identify --frequencies 4.492,9.288,13.252 --format json --draws-out";
        tirante(&folder, &format!("{words} {file}"))
    };
    let row = identify("draws.csv").only();
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
    identify("draws.npy").done();
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

    identify("draws.txt")
        .ends(2)
        .says(&["ends in .csv, .npy or .parquet"]);
    let nowhere = identify("no/folder/draws.csv").ends(1).says(&["draws.csv"]);
    assert!(nowhere.out.is_empty());
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().flatten().collect();
    assert_eq!(left.len(), 2, "{left:?}");
}
