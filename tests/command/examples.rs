//! Every example in the help, the README and the docs, run as printed: `tirante ...` through a shell, in a folder with the shipped
//! recordings and with stand-ins for a user's own files. Those that cannot run here are parsed, each with its reason.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::scenes;
use crate::site::{Site, campaign, text};
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{LazyLock, Mutex};
use std::thread;
use std::time::Instant;

/// Examples that are parsed but not run, by a part of their text and the end of its line, with the reason.
const NOT_RUN: [(&str, &str); 8] = [
    // Each costs a quarter of a minute of processor time; two others are run.
    ("tirante alarm design\n", "the same as JSON: tests/command/cli.rs"),
    ("--frequency-sd 0.0005", "another number of one that is run"),
    (
        "tirante alarm prove",
        "years of simulated sites, minutes to an hour each: tests/command/cli.rs runs a small one",
    ),
    (
        "tirante study",
        "minutes of processor time: tests/analysis/study.rs",
    ),
    (
        "tirante plan",
        "minutes of processor time: tests/analysis/rod_tests.rs plans",
    ),
    (
        "tirante hub command todi",
        "the key of one site and an alarm of its store: tests/process/hub/commands.rs",
    ),
    (
        "tirante work --config",
        "a post, PostgreSQL and a sensor: tests/process/hub/thin.rs",
    ),
    (
        "--current 6f0e2a91c4d7b358",
        "the id of one store of one centre: the unit tests of src/service/hub/fold.rs",
    ),
];

/// One rod as its owner describes it, with the names that examples use.
pub const FACTS: [&str; 6] = ["--length", "9.5", "--section", "d45", "--material", "iron"];

/// A site with alarms, for the examples that read a store.
pub static FOLLOWED: LazyLock<Site> = LazyLock::new(|| {
    let site = campaign();
    let config = fs::read_to_string(site.path("site.toml")).unwrap() + "\n[store]\npath = \"site.db\"\n";
    fs::write(site.path("site.toml"), config).unwrap();
    site.replay(&["archive"], "site.db");
    site
});

/// The example that is run with the whole campaign; others have its first month.
const WHOLE: &str = "--store campaign.db --report .";

/// The first month of the shipped campaign.
static MONTH: LazyLock<Site> = LazyLock::new(|| {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/campaign.toml");
    let config = fs::read_to_string(config).unwrap();
    let site = Site::new(&config);
    let month = config.replace("\nrecords = 360 ", "\nrecords = 60 ");
    assert_ne!(month, config);
    site.simulate_as("month.mcap", &month, 1);
    site
});

/// Puts a recording into the place of a shipped one, beside the others.
pub fn replace_recording(at: &Path, name: &str, by: &Path) {
    let own = at.join("recordings");
    let shipped = fs::read_link(&own).unwrap();
    fs::remove_file(&own).unwrap();
    fs::create_dir(&own).unwrap();
    for entry in fs::read_dir(shipped).unwrap().flatten() {
        if entry.file_name() != name {
            symlink(entry.path(), own.join(entry.file_name())).unwrap();
        }
    }
    fs::copy(by, own.join(name)).unwrap();
}

/// Examples run at once.
const AT_ONCE: usize = 3;

/// With `EXAMPLE` set to a part of their text, only those examples.
#[test]
fn every_example_runs_as_printed() {
    let examples = all();
    assert!(examples.len() > 60, "{}", examples.len());
    let is_of = |example: &str, part: &str| format!("{example}\n").contains(part);
    let left_out = |example: &str| NOT_RUN.iter().find(|(part, _)| is_of(example, part));
    let used = |part: &str| examples.keys().any(|example| is_of(example, part));
    let unused: Vec<&str> = NOT_RUN
        .iter()
        .map(|(part, _)| *part)
        .filter(|part| !used(part))
        .collect();
    let has_peers = scenes::has_peers();
    let only = std::env::var("EXAMPLE").unwrap_or_default();
    let (next, failures) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let mut all: Vec<(&String, &String)> = examples
        .iter()
        .filter(|(example, _)| example.contains(&only))
        .collect();
    // Some wait for a recording to be played, or for a daemon: they come first, beside others that compute.
    all.sort_by_key(|(example, _)| !example.contains("tirante send"));
    thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some((example, source)) = all.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let begun = Instant::now();
                    let outcome = match left_out(example) {
                        Some(_) => parsed(example),
                        None => run(example, has_peers),
                    };
                    eprintln!("{:6.1} s  {example}", begun.elapsed().as_secs_f64());
                    if let Err(why) = outcome {
                        failures
                            .lock()
                            .unwrap()
                            .push(format!("{source}: {example}\n{why}"));
                    }
                }
            });
        }
    });
    let failures = failures.into_inner().unwrap();
    assert!(
        failures.is_empty(),
        "{} fail:\n{}",
        failures.len(),
        failures.join("\n\n")
    );
    assert!(unused.is_empty(), "no example is like {unused:?}");
}

/// Every example once, with the first place it stands at.
fn all() -> BTreeMap<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pages: Vec<PathBuf> = fs::read_dir(root.join("docs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "md"))
        .collect();
    pages.sort();
    pages.extend([root.join("README.md"), root.join("recordings/README.md")]);
    let mut found = BTreeMap::new();
    for page in pages {
        let name = page.strip_prefix(root).unwrap().display().to_string();
        for example in examples(&fs::read_to_string(&page).unwrap()) {
            found.entry(example).or_insert_with(|| name.clone());
        }
    }
    for words in commands() {
        let help = help(&words);
        for example in examples(&help) {
            found.entry(example).or_insert_with(|| format!("help of {words}"));
        }
    }
    found
}

/// The commands, and those of `alarm` and `emulator`.
fn commands() -> Vec<String> {
    let named = |help: &str| -> Vec<String> {
        let list = help
            .lines()
            .skip_while(|line| !line.starts_with("Commands:"))
            .skip(1);
        list.take_while(|line| line.starts_with("  "))
            // Continued descriptions are indented further.
            .filter_map(|line| line.strip_prefix("  ").filter(|line| !line.starts_with(' ')))
            .filter_map(|line| line.split_whitespace().next())
            .filter(|name| *name != "help")
            .map(str::to_owned)
            .collect()
    };
    let top = named(&help(""));
    assert!(top.len() > 20, "{top:?}");
    let below = top.iter().flat_map(|one| {
        named(&help(one))
            .into_iter()
            .map(move |two| format!("{one} {two}"))
    });
    top.iter().cloned().chain(below).collect()
}

fn help(words: &str) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_tirante"))
        .args(words.split_whitespace())
        .arg("--help")
        .output()
        .unwrap();
    assert!(output.status.success(), "{words}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// Lines that are commands, continued lines joined, without the prompt.
fn examples(page: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut lines = page.lines();
    while let Some(line) = lines.next() {
        let line = line.trim_start().trim_start_matches("$ ");
        let Some(rest) = line
            .strip_prefix("tirante ")
            .or_else(|| line.strip_prefix("cargo run -- "))
        else {
            continue;
        };
        // Prose and the synopsis of the help are no commands.
        if !rest.starts_with(|c: char| c.is_ascii_lowercase()) || rest.contains("<COMMAND>") {
            continue;
        }
        let mut command = format!("tirante {}", rest.trim_end());
        while command.ends_with('\\') {
            command.pop();
            command = command.trim_end().to_owned() + " " + lines.next().unwrap_or_default().trim();
        }
        found.push(command.trim_end_matches('&').trim_end().to_owned());
    }
    found
}

/// Checks the words of an example without doing it: its help, asked for behind them.
fn parsed(example: &str) -> Result<(), String> {
    if example.contains("[--") || example.contains("ALARM") {
        return Ok(());
    }
    for part in example
        .split("&&")
        .map(str::trim)
        .filter(|part| part.starts_with("tirante "))
    {
        let words = part.split(" #").next().unwrap_or_default();
        let words = words.split(" | ").next().unwrap_or_default();
        let words = words.split(" > ").next().unwrap_or_default();
        let words = words.replace("$i", "0");
        shell(&format!("{words} --help"), &std::env::temp_dir(), &[0])?;
    }
    Ok(())
}

/// Runs an example in a folder of its own. Stand-in files may hold a record that is refused.
fn run(example: &str, has_peers: bool) -> Result<(), String> {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for name in ["recordings", "config"] {
        symlink(root.join(name), at.join(name)).unwrap();
    }
    if example.contains("campaign-2025.mcap") && !example.contains(WHOLE) {
        replace_recording(at, "campaign-2025.mcap", &MONTH.path("month.mcap"));
    }
    let command = example.split_whitespace().nth(1).unwrap();
    let is_about_a_store = [
        "status",
        "history",
        "report",
        "ack",
        "rebaseline",
        "backup",
        "files",
    ]
    .contains(&command)
        || example.contains("--against");
    let mut example = example.to_owned();
    stand_ins(at, &example);
    if let Some(line) = scenes::staged(at, &example) {
        if !has_peers {
            eprintln!("left out, for want of bwrap, script, nats-server or jq: {example}");
            return parsed(&example);
        }
        return finished(scenes::sandboxed(at), &line, &[0, 3]);
    }
    if is_about_a_store {
        for name in ["site.db", "todi.db", "campaign.db"] {
            fs::copy(FOLLOWED.path("site.db"), at.join(name)).unwrap();
        }
        fs::copy(FOLLOWED.path("site.toml"), at.join("site.toml")).unwrap();
        // The id of an alarm that this store has.
        let alarms = FOLLOWED.history("site.db", "alarms");
        example = example.replace("5f1d0c7a9e3b2468", alarms[0]["id"].as_str().unwrap());
    }
    let uses_stand_in =
        (!example.contains("recordings/") || example.contains("todi.toml")) && !is_about_a_store;
    let good: &[i32] = if uses_stand_in { &[0, 3] } else { &[0] };
    shell(&example, at, good)
}

/// Files of a user that an example names.
fn stand_ins(at: &Path, example: &str) {
    let samples = samples();
    let rows = |line: fn(usize, f64) -> String| -> String {
        samples
            .iter()
            .enumerate()
            .map(|(i, value)| line(i, *value))
            .collect()
    };
    // Of a file with another rate the configuration says that rate.
    let fs_hz = match (example.contains("--rate 250"), example.contains("laser.uff")) {
        (true, _) => 250.0,
        (_, true) => 1024.0,
        _ => 100.0,
    };
    let table = |day: u32| -> String {
        if example.contains("Datum,Uhrzeit") {
            let lines = rows(|i, value| {
                let second = format!("{:05.2}", i as f64 / 100.0).replace('.', ",");
                format!(
                    "01.03.2026;06:00:{second};{}\n",
                    format!("{:.6}", 1e3 * value).replace('.', ",")
                )
            });
            // A record of a minute.
            return format!("Datum;Uhrzeit;Weg 1 [mm]\n{lines}");
        }
        let lines = samples.iter().enumerate().map(|(i, value)| {
            let (second, hundredth) = (i / 100, i % 100);
            format!(
                "2026-03-{day:02}T06:00:{second:02}.{hundredth:02}Z,{:.6}\n",
                1e3 * value
            )
        });
        format!("Time,Laser [mm]\n{}", lines.collect::<String>())
    };
    for (name, day) in [("laser.csv", 1), ("monday.csv", 2), ("tuesday.csv", 3)] {
        fs::write(at.join(name), table(day)).unwrap();
    }
    fs::write(at.join("hammer.wav"), sound(&samples)).unwrap();
    fs::write(at.join("laser.wav"), sound(&samples)).unwrap();
    fs::write(
        at.join("camera.npy"),
        array(&samples, example.contains("[7,:,1]")),
    )
    .unwrap();
    let lvm: String = samples
        .iter()
        .map(|value| format!("\t{:?}\r\n", 1e3 * value))
        .collect();
    let head = "LabVIEW Measurement\t\r\nSeparator\tTab\r\nDecimal_Separator\t.\r\nX_Columns\tNo\r\n***End_of_Header***\t\r\n\t\r\n\
                Channels\t1\t\r\nY_Unit_Label\tmm\t\r\nX0\t0.0\t\r\nDelta_X\t0.010000\t\r\n***End_of_Header***\t\t\r\nX_Value\tlaser\tComment\r\n";
    fs::write(at.join("pull.lvm"), format!("{head}{lvm}")).unwrap();
    fs::copy(
        concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/import/text.uff"),
        at.join("laser.uff"),
    )
    .unwrap();
    let frequencies = "time,rod,f1_hz,sd1_hz,f2_hz,sd2_hz,f3_hz,sd3_hz\n".to_owned()
        + &(1..=20)
            .map(|day| format!("2026-03-{day:02}T06:00:00Z,nave-3,5.998,0.005,12.472,0.01,19.828,0.01\n"))
            .collect::<String>();
    for name in ["frequencies.csv", "2024.csv"] {
        fs::write(at.join(name), &frequencies).unwrap();
    }
    fs::write(at.join("2025.csv"), frequencies.replace("2026-03", "2026-04")).unwrap();
    let weather: String = (1..=20)
        .map(|day| format!("2026-03-{day:02}T05:00:00Z,1{}.5\n", day % 3))
        .collect();
    fs::write(at.join("weather.csv"), format!("time,temperature_c\n{weather}")).unwrap();

    scenes::foreign_files(at, &samples);

    // The recordings and the configuration are made by the program itself.
    let quiet = |words: &[&str]| quiet(at, words);
    let laser = at.join("own.csv");
    let lines: String = samples
        .iter()
        .enumerate()
        .map(|(i, value)| format!("{:.10},{:.6}\n", i as f64 / fs_hz, 1e3 * value))
        .collect();
    fs::write(&laser, format!("Time [s],Laser [mm]\n{lines}")).unwrap();
    let start = "2026-03-01T06:00:00Z";
    quiet(&[
        "import",
        "own.csv",
        "--start",
        start,
        "--channel",
        "Laser=/nave-3/displacement",
        "--out",
        "own.mcap",
    ]);
    if example.contains("heavy.mcap") {
        // One rod with a mass on it and without: where the mass contradicts the record, a search of a minute begins.
        let aisle = concat!(env!("CARGO_MANIFEST_DIR"), "/config/aisle.toml");
        let bare = fs::read_to_string(aisle).unwrap().replace("aisle-1", "nave-3");
        let heavy = format!("{bare}\n[simulation.rod.added_mass]\nmass_kg = 5.0\nat = 0.3\n");
        for (out, config) in [("own.mcap", bare), ("heavy.mcap", heavy)] {
            fs::write(at.join("own.toml"), config).unwrap();
            quiet(&["simulate", "--config", "own.toml", "--out", out, "--force"]);
        }
        fs::remove_file(at.join("own.toml")).unwrap();
    }
    for name in [
        "laser.mcap",
        "bare.mcap",
        "heavy.mcap",
        "pull.mcap",
        "day.mcap",
        "recording.mcap",
    ] {
        let writes = [format!("--out {name}"), format!("--out {name} ")];
        // Scenes begin with one, too.
        let is_wanted = (example.contains(name) || name == "laser.mcap") && !at.join(name).exists();
        if is_wanted && !writes.iter().any(|words| example.contains(words.as_str())) {
            // Without a configuration the built-in rod is looked for.
            let own = at.join("own.mcap");
            let pull = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/todi-pull.mcap");
            let is_own = example.contains("--config") || name == "laser.mcap";
            fs::copy(if is_own { own } else { pull }, at.join(name)).unwrap();
        }
    }
    if ["--config site.toml", "check site.toml", "check rods.toml"]
        .iter()
        .any(|part| example.contains(part))
    {
        let id = example
            .split("--rod ")
            .nth(1)
            .and_then(|rest| rest.split_whitespace().next())
            .unwrap_or("nave-3");
        let words = ["init", "own.mcap", "--id", id, "--out", "site.toml"];
        quiet(&[&words[..], &FACTS].concat());
        fs::copy(at.join("site.toml"), at.join("rods.toml")).unwrap();
    }
    if example.contains("todi.toml") {
        // The recordings of one site.
        fs::remove_file(at.join("recordings")).unwrap();
        fs::create_dir(at.join("recordings")).unwrap();
        let pull = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/todi-pull.mcap");
        fs::copy(pull, at.join("recordings/todi-pull.mcap")).unwrap();
        let words = [
            "init",
            "recordings/todi-pull.mcap",
            "--out",
            "todi.toml",
            "--length",
            "14",
        ];
        quiet(&[&words[..], &["--section", "s70", "--material", "iron"]].concat());
    }
    for name in ["own.csv", "own.mcap"] {
        fs::remove_file(at.join(name)).unwrap();
    }
}

/// Samples of a shipped record \[m\], at 100 Hz.
fn samples() -> Vec<f64> {
    use tirante::analysis::signal::record::{Event, RecordSettings};
    let how = tirante::recording::import::How::default();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/aisle.mcap");
    let opened = tirante::recording::import::open_any(&path, &how, &RecordSettings::default(), &|file, _| {
        Box::new(file)
    });
    let records = opened.unwrap().recording.filter_map(|event| match event {
        Event::Record(record) => Some(record.samples.clone()),
        _ => None,
    });
    records.flatten().collect()
}

/// A sound of doubles at 100 Hz.
fn sound(values: &[f64]) -> Vec<u8> {
    let mut bytes =
        b"RIFF\0\0\0\0WAVEfmt \x10\0\0\0\x03\0\x01\0\x64\0\0\0\x20\x03\0\0\x08\0\x40\0data".to_vec();
    bytes.extend((8 * values.len() as u32).to_le_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// A NumPy array: one column, or eight markers over time in two coordinates.
fn array(values: &[f64], has_markers: bool) -> Vec<u8> {
    let (shape, times) = match has_markers {
        true => (format!("(8, {}, 2)", values.len()), 8),
        false => (format!("({},)", values.len()), 1),
    };
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = b"\x93NUMPY\x01\0".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    for _ in 0..times {
        for value in values {
            let columns = if has_markers { 2 } else { 1 };
            (0..columns).for_each(|_| bytes.extend(value.to_le_bytes()));
        }
    }
    bytes
}

fn program(at: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tirante"));
    surroundings(&mut command, at);
    command
}

/// Runs the program for what an example finds there.
pub fn quiet(at: &Path, words: &[&str]) {
    let output = program(at).args(words).output().unwrap();
    assert!(output.status.success(), "{words:?}: {}", text(&output.stderr));
}

pub fn surroundings(command: &mut Command, at: &Path) {
    command
        .current_dir(at)
        .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
        .env("HOME", at)
        .env_remove("TIRANTE_LOG")
        .stdin(Stdio::null());
}

/// Runs a line in a shell that finds the program by its name.
fn shell(line: &str, at: &Path, good: &[i32]) -> Result<(), String> {
    for folder in [
        ".local/share/bash-completion/completions",
        ".config/fish/completions",
    ] {
        if line.contains(folder) {
            fs::create_dir_all(at.join(folder)).unwrap();
        }
    }
    let mut command = Command::new("sh");
    surroundings(&mut command, at);
    finished(command, line, good)
}

/// Runs a line in this shell to its end.
pub fn finished(mut command: Command, line: &str, good: &[i32]) -> Result<(), String> {
    let here = Path::new(env!("CARGO_BIN_EXE_tirante")).parent().unwrap();
    let paths = format!("{}:{}", here.display(), std::env::var("PATH").unwrap_or_default());
    let output = command.args(["-c", line]).env("PATH", paths).output().unwrap();
    match output.status.code() {
        Some(code) if good.contains(&code) => Ok(()),
        code => Err(format!(
            "exit {code:?}\n{}{}",
            text(&output.stdout),
            text(&output.stderr)
        )),
    }
}
