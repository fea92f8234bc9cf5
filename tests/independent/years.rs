//! Years of monitored rods of a generator that shares no code with `synthesis/` (`tests/years`, Python): the generator against closed
//! forms, and a few of its sites through `tirante track`.
//!
//! The campaign behind `docs/years.md`:
//! `python3 tests/years/judge.py --sites 60 --program target/release/tirante`
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::path::Path;
use std::process::Command;

/// True if Python and numpy are installed; with TIRANTE_REAL_PEERS they are required.
fn has_python() -> bool {
    let found = Command::new("python3").args(["-c", "import numpy"]).output();
    let found = found.is_ok_and(|output| output.status.success());
    assert!(
        found || std::env::var_os("TIRANTE_REAL_PEERS").is_none(),
        "TIRANTE_REAL_PEERS wants python3 with numpy"
    );
    if !found {
        eprintln!("left out: no python3 with numpy");
    }
    found
}

/// Output of a script of `tests/years`, and true if it succeeded.
fn run(script: &str, arguments: &[&str]) -> (String, bool) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/years");
    let output = Command::new("python3")
        .env("PYTHONDONTWRITEBYTECODE", "1")
        // One thread: the matrices are small.
        .env("OPENBLAS_NUM_THREADS", "1")
        .arg(folder.join(script))
        .args(arguments)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(
        matches!(output.status.code(), Some(0 | 1)) && complained.is_empty(),
        "{script}:\n{said}\n{complained}"
    );
    (said, output.status.success())
}

#[test]
fn the_generator_agrees_with_closed_forms() {
    if has_python() {
        let (said, is_good) = run("check.py", &[]);
        assert!(is_good && said.lines().count() >= 15, "{said}");
    }
}

/// Fixed seeds: this either always holds or never. A share fails if its exact 95 % interval excludes what is required: three of six
/// rods with a false drift would (a chance of 1.2 % at the 8.8 % stated), and a loss that is not found.
#[test]
fn a_few_sites_are_followed_as_required() {
    if has_python() {
        let program = env!("CARGO_BIN_EXE_tirante");
        let worlds = [
            "--worlds",
            "benign,full+loss3",
            "--rods",
            "3",
            "--sites",
            "2",
            "--seed",
            "1",
        ];
        let (said, _) = run("judge.py", &[&worlds[..], &["--program", program]].concat());
        for (world, required) in [
            ("benign", "of 6 rods with a false drift"),
            ("full+loss3", "2 of 2 found"),
        ] {
            let passes =
                |line: &str| line.starts_with(&format!("- pass: {world}: ")) && line.contains(required);
            assert!(said.lines().any(passes), "{world}: {required}\n{said}");
        }
    }
}
