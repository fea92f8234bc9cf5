//! The log: forms, and its destination when the journal cannot be reached.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::process::Command;

/// Output of `identify` on stderr in a form of the log; it always reports the configuration it uses.
fn stderr_of(arguments: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_tirante"))
        .args([
            "-v",
            "identify",
            "--frequencies",
            "4.492,9.288,13.252",
            "--sd",
            "0.01",
            "--draws",
            "10000",
        ])
        .args(arguments)
        .env("TIRANTE_CACHE_DIR", folder.path())
        .env_remove("TIRANTE_LOG")
        .env_remove("JOURNAL_STREAM")
        .output()
        .unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn plain_lines_are_for_people_and_json_lines_for_machines() {
    let plain = stderr_of(&[]);
    let line = plain.lines().find(|line| line.contains("no --config")).unwrap();
    assert!(
        line.trim_start().starts_with("INFO"),
        "no time where somebody looks on: {line}"
    );
    let json = stderr_of(&["--log", "json"]);
    let lines: Vec<serde_json::Value> = json
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    let line = lines
        .iter()
        .find(|line| {
            line["message"]
                .as_str()
                .is_some_and(|text| text.contains("no --config"))
        })
        .expect("the same line");
    assert_eq!(line["level"], "INFO");
    assert!(line["timestamp"].is_string());
}

#[test]
fn a_journal_that_cannot_be_reached_loses_no_line() {
    if std::path::Path::new("/run/systemd/journal/socket").exists() {
        eprintln!("skipped: there is a journal here");
        return;
    }
    let said = stderr_of(&["--log", "journal"]);
    assert!(said.contains("the journal cannot be reached"), "{said}");
    assert!(said.contains("no --config"), "{said}");
}
