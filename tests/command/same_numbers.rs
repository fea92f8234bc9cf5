//! The shipped recordings give the numbers they gave before, every field of every row.
//!
//! `UPDATE_OUTPUTS=1 cargo test --test command same_numbers::` writes the archive anew: a change of it belongs under "Results
//! change" of CHANGELOG.md.

use crate::program::{ROOT, tirante};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use tirante::site::record_row::RecordRow;

/// The archive holds what one machine wrote. Another system's `exp`, `ln` and `cos` may differ in the last bit, which
/// differences of close numbers (conflict, misfit) amplify by some orders; a change of method moves them by far more.
const RELATIVE: f64 = 1e-6;

fn rows(recording: &str, config: &str) -> Vec<u8> {
    let line = format!("replay {recording} --config {config} --format json --seed 1");
    tirante(ROOT, &line).done().into_bytes()
}

fn archive(name: &str) -> PathBuf {
    Path::new(ROOT).join(format!("tests/fixtures/outputs/{name}.jsonl.zst"))
}

fn lines(bytes: &[u8]) -> Vec<&str> {
    std::str::from_utf8(bytes).unwrap().lines().collect()
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
        // The rows include alarms, refusals and candidates: each reads back to the byte.
        for line in lines(&now) {
            assert_eq!(RecordRow::parse(line).unwrap().to_json().unwrap(), line);
        }
        if std::env::var_os("UPDATE_OUTPUTS").is_some() {
            fs::create_dir_all(archive(name).parent().unwrap()).unwrap();
            fs::write(archive(name), zstd::encode_all(&now[..], 19).unwrap()).unwrap();
            continue;
        }
        let before = zstd::decode_all(&fs::read(archive(name)).unwrap()[..]).unwrap();
        if now == before {
            continue;
        }
        let (now, before) = (lines(&now), lines(&before));
        assert_eq!(now.len(), before.len(), "{recording}: rows");
        let read = |line: &str| -> Value { serde_json::from_str(line).unwrap() };
        for (row, (now, before)) in now.iter().zip(&before).enumerate() {
            let found = difference("", &read(now), &read(before));
            assert!(
                found.is_none(),
                "{recording}, row {row}: {}",
                found.unwrap_or_default()
            );
        }
    }
}
