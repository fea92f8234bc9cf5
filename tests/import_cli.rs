//! `tirante import` as users run it: exit codes, the lines it prints, and what `check` and `replay` make of them.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use assert_cmd::Command;
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

fn tirante(folder: &Path) -> Command {
    let mut command = Command::cargo_bin("tirante").expect("the program is built");
    command
        .current_dir(folder)
        .env("TIRANTE_CACHE_DIR", folder)
        .env_remove("TIRANTE_LOG");
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

fn root(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The shipped recording of the paper's rod as a table with decimal commas.
fn as_table(to: &Path) {
    let bytes = fs::read(root("recordings/todi-pull.mcap")).unwrap();
    let mut table = "Zeit [ns];Weg [m]\n".to_owned();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let body: Value = serde_json::from_slice(&message.data).unwrap();
        let value = format!("{:?}", body["value"].as_f64().unwrap()).replace('.', ",");
        writeln!(table, "{};{value}", message.log_time).unwrap();
    }
    fs::write(to, table).unwrap();
}

const TABLE: [&str; 5] = [
    "import",
    "todi.csv",
    "--decimal-comma",
    "--channel",
    "Weg=/todi/displacement",
];

#[test]
fn an_imported_table_gives_the_same_force_as_the_recording_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    as_table(&at.join("todi.csv"));
    let output = tirante(at)
        .args(TABLE)
        .args(["--out", "todi.mcap"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let snippet = text(&output.stdout);
    assert!(
        snippet.contains("6500 samples at 100 Hz from") && snippet.contains("stamps exactly even"),
        "{snippet}"
    );

    // The printed lines take the place of the configuration's own.
    let config = fs::read_to_string(root("config/todi.toml")).unwrap();
    let (before, rest) = config.split_once("[rod.channel]").unwrap();
    let (_, after) = rest.split_once("[record]").unwrap();
    let (after, _) = after.split_once("[simulation]").unwrap();
    let after = after
        .trim_end()
        .rsplit_once("\n# What `tirante simulate")
        .map_or(after, |(head, _)| head);
    fs::write(
        at.join("todi.toml"),
        format!("{before}{snippet}\n[record]{after}\n"),
    )
    .unwrap();
    let check = tirante(at)
        .args(["check", "--quiet", "todi.toml"])
        .output()
        .unwrap();
    assert!(check.status.success(), "{}", text(&check.stderr));

    let line = |arguments: [&str; 2]| {
        let output = tirante(at)
            .args(["replay", "--json"])
            .args(arguments)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        let line: Value = serde_json::from_slice(&output.stdout).unwrap();
        line
    };
    let imported = line(["todi.mcap", "--config=todi.toml"]);
    let shipped = root("recordings/todi-pull.mcap");
    let shipped = line([shipped.to_str().unwrap(), "--threads=1"]);
    for field in [
        "rod",
        "start",
        "duration_s",
        "fs_hz",
        "modes",
        "axial_force_n",
        "seed",
        "accepted",
    ] {
        assert_eq!(imported[field], shipped[field], "{field}");
    }

    // The configuration that reads it is content with it, and one in another unit is not.
    let again = tirante(at)
        .args(TABLE)
        .args(["--config", "todi.toml", "--out", "again.mcap"])
        .output()
        .unwrap();
    assert!(again.status.success(), "{}", text(&again.stderr));
    assert_eq!(
        fs::read(at.join("again.mcap")).unwrap(),
        fs::read(at.join("todi.mcap")).unwrap()
    );
    let metres = fs::read_to_string(at.join("todi.toml")).unwrap();
    fs::write(
        at.join("mm.toml"),
        metres.replace("unit = \"m\"", "unit = \"mm\""),
    )
    .unwrap();
    let refused = tirante(at)
        .args(TABLE)
        .args(["--config", "mm.toml", "--out", "mm.mcap"])
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        text(&refused.stderr).contains("is in m, but the configuration reads"),
        "{}",
        text(&refused.stderr)
    );
    assert!(!at.join("mm.mcap").exists());
}

#[test]
fn what_is_there_is_not_overwritten_and_what_is_no_file_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("a.csv"), "t,d [mm]\n0,1.5\n0.5,2.5\n").unwrap();
    fs::write(at.join("a.mcap"), "mine").unwrap();
    let import = [
        "import",
        "a.csv",
        "--start",
        "2026-03-01T06:00:00Z",
        "--out",
        "a.mcap",
    ];
    let output = tirante(at).args(import).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("--force"));
    assert_eq!(fs::read(at.join("a.mcap")).unwrap(), b"mine");
    assert!(
        tirante(at)
            .args(import)
            .arg("--force")
            .output()
            .unwrap()
            .status
            .success()
    );
    assert!(fs::read(at.join("a.mcap")).unwrap().starts_with(b"\x89MCAP"));

    let folder = tirante(at)
        .args(["import", ".", "--format", "csv"])
        .output()
        .unwrap();
    assert_eq!(folder.status.code(), Some(1));
    assert!(text(&folder.stderr).contains("not a regular file"));
    let unknown = tirante(at).args(["import", "a.tdms"]).output().unwrap();
    assert_eq!(unknown.status.code(), Some(2));
    assert!(text(&unknown.stderr).contains("--format"));
}

#[test]
fn damage_is_named_with_file_line_and_column_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("a.csv"), "t,d [mm]\n0,1.5\n0.5,2.5\n1.0,broken\n").unwrap();
    let output = tirante(at)
        .args([
            "import",
            "a.csv",
            "--start",
            "2026-03-01T06:00:00Z",
            "--out",
            "a.mcap",
        ])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(
        text(&output.stderr),
        "error: a.csv: line 4, column 2 (d): \"broken\" is no number; --channel chooses columns\n"
    );
    assert_eq!(fs::read_dir(at).unwrap().count(), 1);
}

#[test]
fn without_out_it_shows_what_is_there_and_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = root("tests/fixtures/import/whole.wav");
    let output = tirante(folder.path()).arg("import").arg(path).output().unwrap();
    assert!(output.status.success());
    let shown = text(&output.stdout);
    assert!(
        shown.contains("32 samples, unit not said (--unit), 2000 Hz, start not said (--start)"),
        "{shown}"
    );
}
