//! A seeded sweep of damage over the recordings path: no panic, and nothing wrong is handed out where
//! checksums exist.

use crate::common::*;
use std::collections::HashSet;
use tirante::analysis::signal::record::{Rejection, TimeSource};
use tirante::recording::read::{Decoder, Event, SchemaRef};
use tirante::recording::write::{Compression, Encoding, Layout, WriterOptions};

fn next(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

fn forms() -> impl Iterator<Item = (Encoding, Layout, WriterOptions)> {
    let encodings = [Encoding::Json, Encoding::Protobuf, Encoding::Ros2];
    encodings.into_iter().flat_map(|encoding| {
        [Layout::Sample, Layout::Batch(50)]
            .into_iter()
            .flat_map(move |layout| {
                [Compression::Zstd, Compression::Lz4, Compression::None]
                    .into_iter()
                    .flat_map(move |compression| {
                        [None, Some(3000)].into_iter().map(move |chunk_bytes| {
                            (
                                encoding,
                                layout,
                                WriterOptions {
                                    compression,
                                    chunk_bytes,
                                    ..Default::default()
                                },
                            )
                        })
                    })
            })
    })
}

/// True if a record holds the values of [`motion`] at its time, to the bit; it may be cut short.
fn is_true(record: &tirante::analysis::signal::record::Record) -> bool {
    let first = (record.start.seconds_since(START) * FS).round() as usize;
    let all = motion(first + record.samples.len());
    record.fs_hz == FS
        && record
            .samples
            .iter()
            .zip(&all[first..])
            .all(|(found, x)| *found == x * 1e-3)
}

/// Records of a fifth of a second, so that damage has records before it.
fn short() -> tirante::analysis::signal::record::RecordSettings {
    windows(0.2)
}

#[test]
fn single_bits_never_change_what_is_handed_out() {
    let mut state = 7;
    let (mut flips, mut delivered, mut partial) = (0, 0, 0);
    for (encoding, layout, options) in forms() {
        let rods = [rod("r", "/laser", field(encoding, layout))];
        let bytes = recording(encoding, layout, options, 400);
        let (clean, _) = read(bytes.clone(), &rods, &short());
        let clean: Vec<_> = records(&clean).into_iter().cloned().collect();
        assert_eq!(clean.len(), 10);
        let step = (bytes.len() / 220).max(3);
        for at in (0..bytes.len()).step_by(step) {
            let mut damaged = bytes.clone();
            let at = (at + (next(&mut state) as usize) % step).min(bytes.len() - 1);
            damaged[at] ^= 1 << (next(&mut state) % 8);
            let (events, summary) = read(damaged, &rods, &short());
            flips += 1;
            let found = records(&events);
            delivered += found.len();
            partial += usize::from(found.len() < clean.len());
            for found in &found {
                assert!(is_true(found), "{encoding:?} {layout:?} {options:?} byte {at}");
            }
            let silent = summary.damage.is_none()
                && summary.holes.is_empty()
                && !summary.truncated
                && !summary.unverified;
            if silent {
                // Only bytes without a checksum that are not used.
                assert_eq!(
                    found.len(),
                    clean.len(),
                    "{encoding:?} {layout:?} {options:?} byte {at}"
                );
            }
        }
    }
    println!("{flips} flips, {delivered} records handed out, {partial} files stopped early");
    assert!(partial > flips / 4);
}

#[test]
fn cuts_and_scrambles_never_panic() {
    let mut state = 99;
    for (encoding, layout, options) in forms() {
        let rods = [rod("r", "/laser", field(encoding, layout))];
        let bytes = recording(encoding, layout, options, 400);
        let (clean, _) = read(bytes.clone(), &rods, &short());
        let clean: Vec<_> = records(&clean).into_iter().cloned().collect();
        for _ in 0..40 {
            let cut = (next(&mut state) as usize) % bytes.len();
            let (events, _) = read(bytes[..cut].to_vec(), &rods, &short());
            for (found, clean) in records(&events).iter().zip(&clean) {
                assert!(clean.samples.starts_with(&found.samples));
            }
            // Many bytes at once: overwritten, doubled, removed.
            let mut scrambled = bytes.clone();
            for _ in 0..1 + next(&mut state) % 8 {
                let at = (next(&mut state) as usize) % scrambled.len();
                let end = (at + (next(&mut state) as usize) % 64).min(scrambled.len());
                match next(&mut state) % 4 {
                    0 => scrambled[at..end].fill(next(&mut state) as u8),
                    1 => drop(scrambled.drain(at..end)),
                    2 => {
                        let part = scrambled[at..end].to_vec();
                        scrambled.splice(at..at, part);
                    }
                    _ => scrambled[at] = scrambled[at].wrapping_add(1),
                }
            }
            let (events, summary) = read(scrambled, &rods, &short());
            if !summary.unverified && !summary.truncated && summary.damage.is_some() {
                assert!(records(&events).into_iter().all(is_true));
            }
        }
    }
}

#[test]
fn files_without_checksums_never_panic() {
    let mut state = 5;
    let mut reasons = HashSet::new();
    for (encoding, layout, options) in forms() {
        let rods = [rod("r", "/laser", field(encoding, layout))];
        let options = WriterOptions {
            checksums: false,
            ..options
        };
        let bytes = recording(encoding, layout, options, 200);
        for _ in 0..100 {
            let mut damaged = bytes.clone();
            let at = (next(&mut state) as usize) % bytes.len();
            damaged[at] = next(&mut state) as u8;
            let (events, _) = read(damaged, &rods, &short());
            for event in events {
                if let Event::Rejected { rejection, .. } = event {
                    reasons.insert(rejection.code());
                    assert!(!matches!(rejection, Rejection::NoPeak { .. }));
                }
            }
        }
    }
    assert!(reasons.contains("damaged"), "{reasons:?}");
}

#[test]
fn damaged_messages_and_schemas_never_panic() {
    let mut state = 3;
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Ros2] {
        for layout in [Layout::Sample, Layout::Batch(4)] {
            let schema = tirante::recording::write::message::schema(
                encoding,
                layout,
                tirante::recording::write::Precision::Double,
            );
            let mut message = Vec::new();
            let head = (START, FS, tirante::analysis::signal::record::Unit::Millimetre);
            match layout {
                Layout::Sample => tirante::recording::write::message::encode_sample(
                    &mut message,
                    encoding,
                    tirante::recording::write::Precision::Double,
                    1.5,
                ),
                Layout::Batch(_) => tirante::recording::write::message::encode_batch(
                    &mut message,
                    encoding,
                    tirante::recording::write::Precision::Double,
                    head,
                    &[1.0, -2.0],
                ),
            }
            for round in 0..4000 {
                let mut data = schema.data.clone();
                let mut damaged = message.clone();
                let target = if round % 2 == 0 { &mut data } else { &mut damaged };
                for _ in 0..1 + next(&mut state) % 4 {
                    let at = (next(&mut state) as usize) % target.len();
                    target[at] = next(&mut state) as u8;
                }
                let schema = SchemaRef {
                    name: &schema.name,
                    encoding: schema.encoding,
                    data: &data,
                };
                let time = TimeSource::Field(if encoding == Encoding::Ros2 {
                    "start".into()
                } else {
                    "start_ns".into()
                });
                for time in [TimeSource::Log, time] {
                    if let Ok(decoder) =
                        Decoder::compile(encoding.key(), Some(schema), field(encoding, layout), &time)
                    {
                        let mut out = Vec::new();
                        let _ = decoder.decode(&damaged, 0, &mut out);
                        assert!(out.len() <= damaged.len() + 1);
                    }
                }
            }
        }
    }
}
