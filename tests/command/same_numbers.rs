//! The shipped recordings give the numbers they gave before, every field of every row.
//!
//! `UPDATE_OUTPUTS=1 cargo test --test command same_numbers::` writes the archive anew: a change of it belongs under "Results
//! change" of CHANGELOG.md.

use assert_cmd::Command;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// The archive holds what one machine wrote. Another system's `exp`, `ln` and `cos` may differ in the last bit, which
/// differences of close numbers (conflict, misfit) amplify by some orders; a change of method moves them by far more.
const RELATIVE: f64 = 1e-6;

fn project() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn rows(recording: &str, config: &str) -> Vec<u8> {
    let cache = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_tirante"))
        .current_dir(project())
        .args([
            "replay", recording, "--config", config, "--format", "json", "--seed", "1",
        ])
        .env("TIRANTE_CACHE_DIR", cache.path())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{recording}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    output.stdout
}

fn archive(name: &str) -> PathBuf {
    project().join(format!("tests/fixtures/outputs/{name}.jsonl.zst"))
}

/// The first place where two values differ by more than another system's last bits.
fn difference(path: &str, now: &Value, before: &Value) -> Option<String> {
    match (now, before) {
        (Value::Object(a), Value::Object(b)) => {
            let lost = b.keys().find(|key| !a.contains_key(*key));
            let new = a.keys().find(|key| !b.contains_key(*key));
            if let Some(key) = lost.or(new) {
                return Some(format!("{path}.{key} is in one of them only"));
            }
            a.iter()
                .find_map(|(key, value)| difference(&format!("{path}.{key}"), value, &b[key]))
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => a
            .iter()
            .zip(b)
            .enumerate()
            .find_map(|(at, (a, b))| difference(&format!("{path}[{at}]"), a, b)),
        (Value::Number(a), Value::Number(b)) => {
            let (x, y) = (a.as_f64()?, b.as_f64()?);
            let is_near = (x - y).abs() <= RELATIVE * x.abs().max(y.abs()).max(1e-9);
            (!is_near).then(|| format!("{path}: {a}, before {b}"))
        }
        _ => (now != before).then(|| format!("{path}: {now}, before {before}")),
    }
}

#[test]
fn a_difference_is_seen() {
    let before: Value = serde_json::from_str(r#"{"a":[1.0,{"b":2.0}],"c":"x"}"#).unwrap();
    for (text, is_same) in [
        (r#"{"a":[1.0,{"b":2.0000001}],"c":"x"}"#, true),
        (r#"{"a":[1.0,{"b":2.00001}],"c":"x"}"#, false),
        (r#"{"a":[1.0,{"b":2.0}],"c":"y"}"#, false),
        (r#"{"a":[1.0],"c":"x"}"#, false),
        (r#"{"a":[1.0,{"b":2.0}],"c":"x","d":1}"#, false),
    ] {
        let now: Value = serde_json::from_str(text).unwrap();
        assert_eq!(difference("", &now, &before).is_none(), is_same, "{text}");
    }
}

#[test]
fn shipped_recordings_give_the_archived_rows() {
    for (name, recording, config) in [
        ("aisle", "recordings/aisle.mcap", "config/aisle.toml"),
        ("todi-pull", "recordings/todi-pull.mcap", "config/todi.toml"),
        (
            "campaign-2025",
            "recordings/campaign-2025.mcap",
            "config/campaign.toml",
        ),
    ] {
        let now = rows(recording, config);
        if std::env::var_os("UPDATE_OUTPUTS").is_some() {
            fs::create_dir_all(archive(name).parent().unwrap()).unwrap();
            fs::write(archive(name), zstd::encode_all(&now[..], 19).unwrap()).unwrap();
            continue;
        }
        let before = zstd::decode_all(&fs::read(archive(name)).unwrap()[..]).unwrap();
        if now == before {
            continue;
        }
        let lines = |bytes: &[u8]| -> Vec<Value> {
            let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
            lines.map(|line| serde_json::from_slice(line).unwrap()).collect()
        };
        let (now, before) = (lines(&now), lines(&before));
        assert_eq!(now.len(), before.len(), "{recording}: rows");
        for (row, (now, before)) in now.iter().zip(&before).enumerate() {
            let found = difference("", now, before);
            assert!(
                found.is_none(),
                "{recording}, row {row}: {}",
                found.unwrap_or_default()
            );
        }
    }
}
