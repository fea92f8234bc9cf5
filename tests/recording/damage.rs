//! Damage of one bit anywhere in a file with a summary: it costs the chunk that it hits at most, and is always told.

#![allow(
    clippy::unwrap_used,
    reason = "a recording that cannot be made fails the test"
)]

use crate::common::*;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::OnceLock;
use tirante::analysis::signal::record::{Record, RodChannels};
use tirante::recording::read::{Event, Parts, Series, Source, Step, Summary, contents};
use tirante::recording::write::{Encoding, Layout, WriterOptions};

const CHUNK: u8 = 6;
const INDEX: u8 = 7;
const DATA_END: u8 = 15;

/// Begin, kind and length of the records of a file, heads included.
fn outer(bytes: &[u8]) -> Vec<(usize, u8, usize)> {
    let (mut at, mut found) = (8, Vec::new());
    while at + 9 <= bytes.len() - 8 {
        let length = 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        found.push((at, bytes[at], length));
        at += length;
    }
    found
}

/// Begins of the records of a kind.
fn begins(bytes: &[u8], kind: u8) -> Vec<usize> {
    let of_kind = outer(bytes).into_iter().filter(|(_, found, _)| *found == kind);
    of_kind.map(|(at, ..)| at).collect()
}

/// The file as writers leave it that add no checksum of all data.
fn without_checksum_of_all(mut bytes: Vec<u8>) -> Vec<u8> {
    let at = begins(&bytes, DATA_END)[0];
    bytes[at + 9..at + 13].fill(0);
    bytes
}

/// Ten minutes in arrays of half a second, a chunk about every two seconds.
fn ten_minutes() -> Vec<u8> {
    let options = WriterOptions {
        chunk_bytes: Some(3200),
        ..Default::default()
    };
    recording(Encoding::Ros2, Layout::Batch(100), options, 120_000)
}

fn laser() -> [RodChannels; 1] {
    [rod("r", "/laser", "values")]
}

fn is_true(record: &Record) -> bool {
    static ALL: OnceLock<Vec<f64>> = OnceLock::new();
    let all = ALL.get_or_init(|| motion(120_000));
    let first = (record.start.seconds_since(START) * FS).round() as usize;
    let mut pairs = record.samples.iter().zip(&all[first..]);
    record.fs_hz == FS && pairs.all(|(found, x)| *found == x * 1e-3)
}

/// Number of records of a damaged file, which are true all of them, and what is told.
fn found(bytes: &[u8], at: usize, bit: u8, window_s: f64) -> (usize, Summary) {
    let mut damaged = bytes.to_vec();
    damaged[at] ^= 1 << bit;
    let (events, summary) = read(damaged, &laser(), &windows(window_s));
    let found = records(&events);
    assert!(found.iter().all(|record| is_true(record)), "byte {at} bit {bit}");
    (found.len(), summary)
}

#[test]
fn behind_a_lost_first_chunk_the_definitions_are_those_of_the_summary() {
    let checked = ten_minutes();
    for bytes in [without_checksum_of_all(checked.clone()), checked] {
        let first = begins(&bytes, CHUNK)[0];
        let (found, summary) = found(&bytes, first + 200, 0, 10.0);
        let told = summary.sentences().join("\n");
        assert!(found >= 59 && summary.damage.is_none(), "{found}: {told}");
        assert!(
            told.contains("from 2026-03-01T06:00:00") && told.contains("on /laser is lost"),
            "{told}"
        );
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut damaged = bytes.clone();
        damaged[first + 200] ^= 1;
        std::fs::write(&path, damaged).unwrap();
        let contents = contents::contents(&path).unwrap();
        assert_eq!(contents[0].topic, "/laser");
    }
    // Without a summary nothing tells them.
    let bytes = ten_minutes();
    let cut = &bytes[..begins(&bytes, DATA_END)[0]];
    let (found, summary) = found(cut, begins(&bytes, CHUNK)[0] + 200, 0, 10.0);
    assert!(found == 0 && summary.damage.unwrap().contains("before its channel"));
}

#[test]
fn a_bit_of_the_framing_costs_its_chunk_at_most() {
    let checked = ten_minutes();
    for bytes in [without_checksum_of_all(checked.clone()), checked] {
        let (clean, _) = read(bytes.clone(), &laser(), &windows(10.0));
        assert_eq!(records(&clean).len(), 60);
        let chunk = begins(&bytes, CHUNK)[40];
        let index = begins(&bytes, INDEX)[40];
        // Name, then length of the compressed records behind times, size and checksum.
        let (name, length) = (chunk + 9 + 32, chunk + 9 + 36);
        assert_eq!(&bytes[name..name + 4], b"zstd");
        // Kind and length of a record that is read all the same.
        let heads = (chunk..chunk + 9).map(|at| (at, true));
        let indices = (index..index + 9).map(|at| (at, true));
        let content = (chunk + 9 + 16..chunk + 9 + 24).chain(chunk + 9 + 28..length + 8);
        let content = content.map(|at| (at, false));
        for (at, is_whole) in heads.chain(indices).chain(content) {
            // Every bit of a kind, one of every other byte.
            let bits = match at == chunk || at == index {
                true => 0..8,
                false => (at % 8) as u8..(at % 8) as u8 + 1,
            };
            for bit in bits {
                let (found, summary) = found(&bytes, at, bit, 10.0);
                let told = format!("byte {at} bit {bit}: {found}: {:?}", summary.sentences());
                assert!(summary.damage.is_none() && !summary.truncated, "{told}");
                assert_eq!(summary.holes.len(), 1, "{told}");
                let hole = &summary.holes[0];
                if is_whole {
                    assert!(found == 60 && hole.contains("no message is lost"), "{told}");
                } else {
                    assert!(found >= 58 && hole.contains("on /laser is lost"), "{told}");
                    assert!(hole.contains("from 2026-03-01T06:01:"), "{told}");
                }
                let begin = if (index..index + 9).contains(&at) {
                    index
                } else {
                    chunk
                };
                assert!(hole.starts_with(&format!("at byte {begin}: ")), "{told}");
            }
        }
    }
}

/// One bit of each byte: at most four records of ten are lost, the two that its chunk belongs to and one on either side, and never silently.
#[test]
fn a_bit_of_any_byte_costs_four_records_at_most_and_is_told() {
    let options = WriterOptions {
        chunk_bytes: Some(400),
        ..Default::default()
    };
    let checked = recording(Encoding::Ros2, Layout::Batch(20), options, 400);
    for bytes in [without_checksum_of_all(checked.clone()), checked] {
        let (clean, _) = read(bytes.clone(), &laser(), &windows(0.2));
        assert_eq!(records(&clean).len(), 10);
        let end = begins(&bytes, DATA_END)[0];
        let mut least = 10;
        for at in 0..bytes.len() {
            let (found, summary) = found(&bytes, at, (at % 8) as u8, 0.2);
            let told = format!(
                "byte {at} of {end}, {}: {found}: {:?}",
                bytes.len(),
                summary.sentences()
            );
            assert!(found >= 6, "{told}");
            assert!(found == 10 || !summary.sentences().is_empty(), "{told}");
            // What is behind the data costs none of them.
            assert!(at < end || found == 10, "{told}");
            least = least.min(found);
        }
        assert!(least < 10);
    }
}

/// Messages of half a second each in blocks out of order, without a checksum of all data.
fn out_of_order() -> Vec<u8> {
    let options = mcap::WriteOptions::new()
        .chunk_size(Some(4000))
        .calculate_data_section_crc(false);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let channel = writer.add_channel(0, "/laser", "json", &BTreeMap::new()).unwrap();
    let samples = motion(12_000);
    let blocks: Vec<&[f64]> = samples.chunks(100).collect();
    // The second seven of every fourteen come before the first.
    let order = blocks
        .chunks(14)
        .zip((0..).step_by(14))
        .flat_map(|(group, from)| {
            let half = from + group.len().min(7);
            (half..from + group.len()).chain(from..half)
        });
    for (sequence, index) in (0..).zip(order) {
        let time = 1_772_344_800_000_000_000 + index as u64 * 500_000_000;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence,
            log_time: time,
            publish_time: time,
        };
        let data = format!("{{\"values\":{:?}}}", blocks[index]);
        writer.write_to_known_channel(&header, data.as_bytes()).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn a_bit_of_a_file_out_of_order_costs_its_chunk_at_most() {
    let bytes = out_of_order();
    let (clean, summary) = read(bytes.clone(), &laser(), &windows(5.0));
    assert!(
        records(&clean).len() == 12 && summary.sentences().is_empty(),
        "{:?}",
        summary.sentences()
    );
    let chunk = begins(&bytes, CHUNK)[10];
    for at in (chunk..chunk + 9).chain(chunk + 9 + 28..chunk + 9 + 44) {
        let (found, summary) = found(&bytes, at, 2, 5.0);
        let told = format!("byte {at}: {found}: {:?}", summary.sentences());
        assert!(summary.damage.is_none() && summary.holes.len() == 1, "{told}");
        if at < chunk + 9 {
            assert!(
                found == 12 && summary.holes[0].contains("no message is lost"),
                "{told}"
            );
        } else {
            assert!(found >= 9 && summary.holes[0].contains("is lost"), "{told}");
        }
    }
}

#[test]
fn the_name_of_a_compression_is_no_length() {
    // Cut short: no summary tells where the next chunk begins, but the lengths do.
    let whole = ten_minutes();
    let cut = &whole[..begins(&whole, DATA_END)[0]];
    let chunk = begins(&whole, CHUNK)[40];
    let (found, summary) = found(cut, chunk + 9 + 32, 0, 10.0);
    assert!(
        found >= 58 && summary.damage.is_none(),
        "{found}: {:?}",
        summary.sentences()
    );
    assert!(
        summary.holes[0].contains("compression `{std` cannot be read"),
        "{:?}",
        summary.holes
    );
}

#[test]
fn damage_of_the_last_part_of_a_journal_is_told() {
    let bytes = ten_minutes();
    let chunks = begins(&bytes, CHUNK);
    let folder = tempfile::tempdir().unwrap();
    for (at, lost) in [(chunks[0] + 200, 1), (chunks[40], 0)] {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1;
        std::fs::write(folder.path().join("journal.000001.mcap"), damaged).unwrap();
        let mut series = Series::new(folder.path(), Parts::Given(vec![1]), &laser(), &windows(10.0));
        let (mut records, mut told) = (0, Vec::new());
        loop {
            match series.poll() {
                Step::Event(Event::Record(record), _) => {
                    assert!(is_true(&record));
                    records += 1;
                }
                Step::File(end) => told = end.result.unwrap().sentences(),
                Step::End => break,
                Step::Event(..) | Step::More | Step::Wait => {}
            }
        }
        assert_eq!(records, 60 - lost, "{told:?}");
        assert!(told.len() == 1 && told[0].contains("at byte"), "{told:?}");
        assert_eq!(told[0].contains("on /laser is lost"), lost > 0, "{told:?}");
    }
}
