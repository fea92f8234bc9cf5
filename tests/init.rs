//! `tirante init`: what it writes of a recording, what it refuses, and that it can be used as it is.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use assert_cmd::Command;
use std::fs;
use std::path::Path;
use tirante::config::Config;
use tirante::record::Unit;
use tirante::sink::{Encoding, Layout, WriterOptions};
use tirante::source::contents::contents;

const RECORDING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/campaign-2025.mcap");

/// The program in `folder`; nobody answers questions.
fn tirante(folder: &Path, words: &[&str]) -> (Option<i32>, String) {
    let output = Command::cargo_bin("tirante")
        .unwrap()
        .current_dir(folder)
        .env("TIRANTE_CACHE_DIR", folder)
        .env_remove("TIRANTE_LOG")
        .args(words)
        .output()
        .unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

const ROD: [&str; 8] = [
    "--length-m",
    "14",
    "--side-m",
    "0.0715",
    "--material",
    "iron",
    "--out",
    "site.toml",
];

fn init(folder: &Path, more: &[&str]) -> (Option<i32>, String) {
    let words: Vec<&str> = ["init"].iter().chain(&ROD).chain(more).copied().collect();
    tirante(folder, &words)
}

#[test]
fn a_recording_says_where_its_samples_are() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(init(folder.path(), &[RECORDING]).0, Some(0));
    let text = fs::read_to_string(folder.path().join("site.toml")).unwrap();
    let config = Config::parse(&text, "site.toml").unwrap();
    let shipped = Config::load(Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/config/campaign.toml"
    )))
    .unwrap();
    let (written, shipped) = (&config.rods[0].channels, &shipped.rods[0].channels);
    assert_eq!(written.displacement, shipped.displacement);
    assert_eq!(written.temperature, shipped.temperature);
    assert_eq!(
        tirante(folder.path(), &["check", "--quiet", "site.toml"]),
        (Some(0), String::new())
    );

    let (code, said) = init(folder.path(), &[RECORDING]);
    assert_eq!(code, Some(2));
    assert!(said.contains("site.toml: exists"), "{said}");
    assert_eq!(fs::read_to_string(folder.path().join("site.toml")).unwrap(), text);
}

#[test]
fn what_is_written_analyses_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let recording = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/todi-pull.mcap");
    assert_eq!(init(folder.path(), &[recording]).0, Some(0));
    let (code, said) = tirante(
        folder.path(),
        &["identify", recording, "--config", "site.toml", "--draws", "20000"],
    );
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("1 identified"), "{said}");
}

#[test]
fn every_encoding_and_layout_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Ros2] {
        for layout in [Layout::Sample, Layout::Batch(50)] {
            fs::write(
                &path,
                common::recording(encoding, layout, WriterOptions::default(), 400),
            )
            .unwrap();
            let found = contents(&path).unwrap();
            assert_eq!(found.len(), 1);
            assert_eq!(
                (found[0].topic.as_str(), found[0].unit),
                ("/laser", Some(Unit::Millimetre))
            );
            assert_eq!(found[0].field.as_deref(), Ok(common::field(encoding, layout)));
            let is_array = matches!(layout, Layout::Batch(_));
            assert_eq!(
                found[0].array_fs_hz,
                is_array.then_some(common::FS),
                "{encoding:?} {layout:?}"
            );
        }
    }
}

#[test]
fn damaged_recordings_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let options = WriterOptions {
        checksums: false,
        chunk_bytes: None,
        ..WriterOptions::default()
    };
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Ros2] {
        let bytes = common::recording(encoding, Layout::Batch(5), options, 40);
        for at in (0..bytes.len()).step_by(5) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << (at % 8);
            fs::write(&path, damaged).unwrap();
            if let Ok(found) = contents(&path) {
                assert!(found.len() <= 2);
            }
        }
    }
}

#[test]
fn what_is_missing_or_impossible_is_named_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    for (more, wanted) in [
        (&["--unit", "mm"][..], "--topic or a recording is needed"),
        (&["--topic", "/a"], "--unit is needed"),
        (&["--topic", "/a", "--unit", "V"], "is no unit"),
        (
            &[RECORDING, "--topic", "/a"],
            "the recording has /nave-3/displacement",
        ),
        (&[RECORDING, "--unit", "mm"], "the recording says m"),
        (&[RECORDING, "--id", "no good"], "is no id"),
        (&[RECORDING, "--force-n=-1"], "a positive number"),
        (&["nothing.mcap"], "nothing.mcap"),
    ] {
        let (code, said) = init(folder.path(), more);
        assert!(matches!(code, Some(1 | 2)), "{more:?}: {code:?}");
        assert!(said.contains(wanted), "{more:?}: {said}");
        assert!(!folder.path().join("site.toml").exists(), "{more:?}");
    }
    let (code, said) = tirante(folder.path(), &["init", "--out", "site.toml"]);
    assert_eq!(code, Some(2));
    assert!(said.contains("--length-m is needed"), "{said}");
}
