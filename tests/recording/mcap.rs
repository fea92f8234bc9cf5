//! Recordings written and read back: every encoding and layout, damage, growth, and files of others.

#![allow(
    clippy::unwrap_used,
    reason = "a recording that cannot be made fails the test"
)]

use crate::common::*;
use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tirante::analysis::signal::record::{
    Assembler, Flag, RecordSettings, Rejection, RodChannels, TimeSource, Timestamp, Unit,
};
use tirante::recording::read::{Event, Follow, Options, Recording};
use tirante::recording::write::{
    ChannelSpec, Compression, Encoding, Layout, Precision, RecordingWriter, WriterOptions,
};

const ENCODINGS: [Encoding; 3] = [Encoding::Json, Encoding::Protobuf, Encoding::Ros2];
const LAYOUTS: [Layout; 2] = [Layout::Sample, Layout::Batch(100)];

#[test]
fn what_is_written_is_read_in_every_form() {
    let expected: Vec<f64> = motion(4000).iter().map(|x| x * 1e-3).collect();
    let mut identities = Vec::new();
    for encoding in ENCODINGS {
        for layout in LAYOUTS {
            for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
                for chunk_bytes in [None, Some(20_000)] {
                    let options = WriterOptions {
                        compression,
                        chunk_bytes,
                        ..Default::default()
                    };
                    let bytes = recording(encoding, layout, options, 4000);
                    let rods = [rod("r", "/laser", field(encoding, layout))];
                    let (events, summary) = read(bytes, &rods, &RecordSettings::default());
                    let records = records(&events);
                    assert_eq!(
                        (events.len(), records.len()),
                        (1, 1),
                        "{encoding:?} {layout:?}: {:?}",
                        summary.sentences()
                    );
                    assert!(records[0].samples == expected);
                    assert_eq!((records[0].start, records[0].fs_hz), (START, FS));
                    assert!(records[0].flags.is_empty(), "{:?}", records[0].flags);
                    assert!(summary.sentences().is_empty(), "{:?}", summary.sentences());
                    identities.push(records[0].identity());
                }
            }
        }
    }
    identities.dedup();
    assert_eq!(
        identities.len(),
        1,
        "the same samples are the same record, however stored"
    );
}

#[test]
fn an_array_of_more_than_a_million_samples_is_taken_in_pieces() {
    // Short numbers, so that as many fit into a message of JSON: the second one has the last 100 000.
    const LARGE: usize = 1_300_000;
    let samples: Vec<f64> = motion(LARGE + 100_000)
        .iter()
        .map(|x| (x * 256.0).round() / 256.0)
        .collect();
    for encoding in ENCODINGS {
        let read_in = |batch: usize| {
            let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
            let spec = ChannelSpec {
                precision: Precision::Single,
                ..spec("/laser", encoding, Layout::Batch(batch))
            };
            let id = writer.add_channel(spec).unwrap();
            writer.write_samples(id, START, FS, &samples).unwrap();
            let bytes = writer.finish().unwrap().into_inner();
            read(bytes, &[rod("r", "/laser", "values")], &windows(1000.0))
        };
        let (pieces, summary) = read_in(LARGE);
        assert!(
            summary.sentences().is_empty(),
            "{encoding:?}: {:?}",
            summary.sentences()
        );
        let (many, _) = read_in(1000);
        assert_eq!(records(&pieces).len(), 7, "{encoding:?}");
        assert!(pieces == many, "{encoding:?}");
    }
}

#[test]
fn a_fault_of_a_message_read_in_pieces_counts_once() {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
    let spec = ChannelSpec {
        precision: Precision::Single,
        ..spec("/laser", Encoding::Ros2, Layout::Batch(2_300_000))
    };
    let id = writer.add_channel(spec).unwrap();
    writer.write_samples(id, START, FS, &[0.5; 2_310_000]).unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    // The second rod's field is in neither message, of which the first is read in three pieces for the other rod.
    let rods = [rod("r", "/laser", "values"), rod("s", "/laser", "other")];
    let (_, summary) = read(bytes, &rods, &windows(1000.0));
    let topic = &summary.topics["/laser"];
    assert_eq!((topic.undecodable, topic.messages), (2, 2));
}

#[test]
fn single_precision_and_missing_samples() {
    for encoding in ENCODINGS {
        for layout in LAYOUTS {
            let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
            let spec = ChannelSpec {
                precision: Precision::Single,
                ..spec("/laser", encoding, layout)
            };
            let id = writer.add_channel(spec).unwrap();
            let mut samples = motion(4000);
            samples[1234] = f64::NAN;
            writer.write_samples(id, START, FS, &samples).unwrap();
            let bytes = writer.finish().unwrap().into_inner();
            let (events, _) = read(
                bytes,
                &[rod("r", "/laser", field(encoding, layout))],
                &RecordSettings::default(),
            );
            let records = records(&events);
            assert_eq!(records[0].flags, [Flag::Filled { samples: 1 }]);
            for (found, sample) in records[0].samples.iter().zip(&samples) {
                // Half a unit in the last place of a float, twice: rounded, then scaled.
                assert!(sample.is_nan() || (found - sample * 1e-3).abs() <= 1e-3 * sample.abs() * 1.2e-7);
            }
        }
    }
}

#[test]
fn several_rods_a_temperature_and_time_in_the_message() {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
    let a = writer
        .add_channel(spec("/a", Encoding::Json, Layout::Batch(50)))
        .unwrap();
    let b = writer
        .add_channel(spec("/b", Encoding::Ros2, Layout::Batch(50)))
        .unwrap();
    let t = writer
        .add_channel(ChannelSpec {
            unit: Unit::Kelvin,
            ..spec("/t", Encoding::Protobuf, Layout::Sample)
        })
        .unwrap();
    let samples = motion(12_000);
    for second in 0..60usize {
        let time = START.plus_seconds(second as f64);
        let part = &samples[second * 200..(second + 1) * 200];
        writer.write_samples(a, time, FS, part).unwrap();
        writer.write_samples(b, time, FS, part).unwrap();
        writer
            .write_message(t, time, 1.0, &[283.15 + (second / 20) as f64])
            .unwrap();
    }
    writer
        .metadata("tirante", BTreeMap::from([("simulated".into(), "yes".into())]))
        .unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    let temperature = || {
        Some(tirante::analysis::signal::record::Channel {
            unit: Unit::Kelvin,
            fs_hz: None,
            ..channel("/t", "value")
        })
    };
    let mut rods = [
        RodChannels {
            temperature: temperature(),
            ..rod("a", "/a", "values")
        },
        RodChannels {
            temperature: temperature(),
            ..rod("b", "/b", "values")
        },
    ];
    rods[0].displacement.time = TimeSource::Field("start_ns".into());
    rods[1].displacement.time = TimeSource::Field("start".into());
    let (events, summary) = read(bytes, &rods, &windows(20.0));
    assert_eq!(records(&events).len(), 6, "{events:?}");
    for record in records(&events) {
        let window = (record.start.seconds_since(START) / 20.0).round();
        // The reading at the very end of a window is the first of the next.
        let found = record.temperature_c.unwrap();
        assert!((found - 10.0 - window).abs() < 0.06, "{found}");
        assert_eq!(record.samples.len(), 4000);
    }
    assert_eq!(
        summary.samples.values().copied().collect::<Vec<_>>(),
        [12_000, 12_000]
    );
    assert!(summary.sentences().is_empty());
}

#[test]
fn readings_since_the_record_before_come_with_each_record() {
    // Half an hour of temperature; twenty seconds of displacement at its begin, stuck ones in the middle that are
    // rejected, and twenty more towards the end.
    let run = |piecemeal: bool| {
        let settings = windows(20.0);
        let mut assembler = Assembler::new(
            tirante::analysis::signal::record::RodId("r".into()),
            settings,
            Some(FS),
            true,
        );
        let mut events = Vec::new();
        let moving = motion(4000);
        for second in 0..1800usize {
            let time = START.plus_seconds(second as f64);
            assembler.push_temperature(time, second as f64);
            let part = match second {
                0..20 => moving[second * 200..(second + 1) * 200].to_vec(),
                700..720 => vec![1e-3; 200],
                1500..1520 => moving[(second - 1500) * 200..(second - 1499) * 200].to_vec(),
                _ => Vec::new(),
            };
            assembler.push(time, &part);
            if piecemeal {
                events.extend(assembler.events());
            }
        }
        assembler.finish(false);
        events.extend(assembler.events());
        (events, assembler.leftover(START.plus_seconds(1e6)))
    };
    let (events, leftover) = run(false);
    assert_eq!((events.clone(), leftover.clone()), run(true));
    let records = records(&events);
    assert_eq!((events.len(), records.len()), (3, 2), "one stretch is rejected");
    let all: Vec<_> = records
        .iter()
        .flat_map(|record| &record.readings)
        .chain(&leftover)
        .collect();
    // START is a multiple of five minutes: six bins, two of them cut at the end of a record.
    assert_eq!(all.len(), 8);
    assert_eq!(records[0].readings.len(), 1);
    for reading in &all {
        let mean = reading.time.seconds_since(START);
        assert!((reading.celsius - mean).abs() <= 0.5, "{reading:?}");
    }
    assert!(all.windows(2).all(|pair| pair[0].time < pair[1].time));
    let end = records[1].start.plus_seconds(20.0);
    assert!(records[1].readings.iter().all(|reading| reading.time <= end));
    assert!(leftover.iter().all(|reading| reading.time > end));
}

#[test]
fn wrong_names_are_told_with_what_is_there() {
    let bytes = recording(Encoding::Json, Layout::Sample, WriterOptions::default(), 3000);
    let (events, summary) = read(
        bytes.clone(),
        &[rod("r", "/lasr", "value")],
        &RecordSettings::default(),
    );
    assert!(events.is_empty() && summary.has_nothing());
    assert_eq!(
        summary.sentences(),
        ["test.mcap: no topic /lasr (rod r); it has /laser"]
    );

    let (events, summary) = read(
        bytes.clone(),
        &[rod("r", "/laser", "point.z")],
        &RecordSettings::default(),
    );
    assert!(matches!(
        &events[..],
        [Event::Rejected {
            rejection: Rejection::Missing { .. },
            ..
        }]
    ));
    assert_eq!(
        summary.sentences(),
        [
            "test.mcap: topic /laser: 3000 of 3000 messages give no samples: no field `point.z`; there is: value"
        ]
    );
    assert!(
        Recording::new(
            "x",
            Cursor::new(bytes),
            &[rod("r", "/laser", "a..b")],
            &RecordSettings::default(),
            Options::default()
        )
        .is_err()
    );

    let bytes = recording(Encoding::Ros2, Layout::Sample, WriterOptions::default(), 3000);
    let (_, summary) = read(bytes, &[rod("r", "/laser", "value")], &RecordSettings::default());
    assert!(
        summary.sentences()[0].ends_with("no field `value`; there is: data"),
        "{:?}",
        summary.sentences()
    );

    let bytes = recording(Encoding::Json, Layout::Batch(10), WriterOptions::default(), 3000);
    let mut arrays = rod("r", "/laser", "values");
    arrays.displacement.fs_hz = None;
    let (_, summary) = read(bytes, &[arrays], &RecordSettings::default());
    assert!(
        summary.sentences()[0].contains("`fs_hz`"),
        "{:?}",
        summary.sentences()
    );
}

/// Writes messages with the crate alone, as others do.
fn foreign(encoding: &str, schema: Option<(&str, &str, &[u8])>, messages: &[&[u8]]) -> Vec<u8> {
    let mut writer = mcap::WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let schema = schema.map_or(0, |(name, kind, data)| {
        writer.add_schema(name, kind, data).unwrap()
    });
    let channel = writer
        .add_channel(schema, "/x", encoding, &BTreeMap::new())
        .unwrap();
    for (i, data) in messages.iter().enumerate() {
        let time = i as u64 * 5_000_000;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: i as u32,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn other_encodings_are_refused_by_name() {
    for (encoding, schema, told) in [
        ("cbor", None, "`cbor`"),
        ("ros1", Some(("a/B", "ros1msg", &b"float64 x"[..])), "`ros1`"),
        ("cdr", Some(("a/msg/B", "ros2idl", &b""[..])), "`ros2idl`"),
        ("cdr", None, "no schema"),
        (
            "protobuf",
            Some(("a.B", "protobuf", &b"\xff\xff"[..])),
            "schema `a.B`",
        ),
        ("cdr", Some(("a/msg/B", "ros2msg", &b"string x \""[..])), "schema"),
    ] {
        let bytes = foreign(encoding, schema, &[&b"{}"[..]; 10]);
        let (_, summary) = read(bytes, &[rod("r", "/x", "x")], &RecordSettings::default());
        let sentence = summary.sentences().join("\n");
        assert!(sentence.contains(told) && sentence.contains("/x"), "{sentence}");
    }
}

#[test]
fn one_bad_message_is_one_missing_sample() {
    let samples = motion(4000);
    let messages: Vec<String> = samples
        .iter()
        .enumerate()
        .map(|(i, x)| match i {
            100 => "{\"x\":\"text\"}".to_owned(),
            200 => "{\"x\":".to_owned(),
            300 => "{}".to_owned(),
            400 => "{\"x\":1e999}".to_owned(),
            _ => format!("{{\"x\":{x}}}"),
        })
        .collect();
    let messages: Vec<&[u8]> = messages.iter().map(String::as_bytes).collect();
    let (events, summary) = read(
        foreign("json", None, &messages),
        &[rod("r", "/x", "x")],
        &RecordSettings::default(),
    );
    assert_eq!(records(&events)[0].flags, [Flag::Filled { samples: 4 }]);
    assert_eq!(records(&events)[0].samples.len(), 4000);
    assert_eq!(summary.topics["/x"].undecodable, 3);
    assert!(summary.lost_data());
}

#[test]
fn a_cut_file_gives_its_prefix() {
    for chunk_bytes in [None, Some(4000)] {
        let options = WriterOptions {
            chunk_bytes,
            ..Default::default()
        };
        let bytes = recording(Encoding::Json, Layout::Sample, options, 6000);
        let rods = [rod("r", "/laser", "value")];
        let settings = RecordSettings {
            min_duration_s: 0.05,
            ..Default::default()
        };
        let (whole, _) = read(bytes.clone(), &rods, &settings);
        let whole = &records(&whole)[0].samples;
        let mut longest = 0;
        for cut in (0..bytes.len()).step_by(997) {
            let (events, summary) = read(bytes[..cut].to_vec(), &rods, &settings);
            assert!(
                summary.truncated && summary.damage.is_none(),
                "{cut}: {:?}",
                summary.damage
            );
            if let [Event::Record(record)] = &events[..] {
                assert!(whole.starts_with(&record.samples));
                assert!(record.flags.contains(&Flag::Truncated));
                assert_eq!(record.flags.contains(&Flag::Unverified), chunk_bytes.is_none());
                longest = longest.max(record.samples.len());
            }
        }
        assert!(longest > 5000);
    }
}

#[test]
fn without_checksums_is_unverified() {
    for chunk_bytes in [None, Some(4000)] {
        let options = WriterOptions {
            chunk_bytes,
            checksums: false,
            ..Default::default()
        };
        let bytes = recording(Encoding::Json, Layout::Sample, options, 3000);
        let (events, summary) = read(bytes, &[rod("r", "/laser", "value")], &RecordSettings::default());
        assert_eq!(records(&events)[0].flags, [Flag::Unverified]);
        assert!(summary.unverified);
    }
}

/// True if a record holds the values of [`motion`] at its time, to the bit.
fn is_true(record: &tirante::analysis::signal::record::Record) -> bool {
    static ALL: std::sync::OnceLock<Vec<f64>> = std::sync::OnceLock::new();
    let all = ALL.get_or_init(|| motion(360_000));
    let first = (record.start.seconds_since(START) * FS).round() as usize;
    record.fs_hz == FS
        && record
            .samples
            .iter()
            .zip(&all[first..])
            .all(|(found, x)| *found == x * 1e-3)
}

/// Half an hour in arrays of half a second, a chunk about every two seconds.
fn half_an_hour() -> Vec<u8> {
    let options = WriterOptions {
        chunk_bytes: Some(3200),
        ..Default::default()
    };
    recording(Encoding::Ros2, Layout::Batch(100), options, 360_000)
}

#[test]
fn one_flipped_bit_costs_the_records_beside_its_chunk_and_names_the_hole() {
    let mut bytes = half_an_hour();
    let rods = [rod("r", "/laser", "values")];
    let settings = windows(60.0);
    assert_eq!(records(&read(bytes.clone(), &rods, &settings).0).len(), 30);
    let near = bytes.len() / 20;
    let mut holes = 0;
    for at in (0..12).map(|i| near + i * 401) {
        bytes[at] ^= 1;
        let (events, summary) = read(bytes.clone(), &rods, &settings);
        bytes[at] ^= 1;
        if summary
            .holes
            .iter()
            .all(|hole| hole.contains("no message is lost"))
        {
            // An index, which is not needed.
            continue;
        }
        holes += 1;
        let found = records(&events);
        // The window with the hole, and the rest at the end of those that begin anew behind it.
        assert!(found.len() >= 28, "{}: {:?}", found.len(), summary.sentences());
        assert!(found.iter().all(|record| is_true(record)));
        let told = summary.sentences().join("\n");
        assert!(told.contains("a chunk"), "{told}");
        assert!(
            told.contains("from 2026-03-01T06:0") && told.contains(" on /laser is lost"),
            "{told}"
        );
        let refused: Vec<_> = events
            .iter()
            .filter_map(|event| match event {
                Event::Rejected {
                    rejection: Rejection::Damaged { .. },
                    start: Some(start),
                    duration_s,
                    ..
                } => Some((start.seconds_since(START), *duration_s)),
                _ => None,
            })
            .collect();
        let [(start_s, duration_s)] = refused[..] else {
            panic!("{refused:?}")
        };
        assert!(
            (80.0..130.0).contains(&start_s) && duration_s < 5.0,
            "{start_s} {duration_s}"
        );
        assert!(summary.lost_data() && summary.damage.is_none());
    }
    assert!(holes >= 8, "{holes}");
}

#[test]
fn what_cannot_be_believed_is_never_handed_out() {
    let mut bytes = half_an_hour();
    let rods = [rod("r", "/laser", "values")];
    let (clean, _) = read(bytes.clone(), &rods, &windows(10.0));
    let clean = records(&clean).len();
    let (middle, mut fewer) = (bytes.len() / 2, 0);
    for at in (0..8).map(|i| middle + i * 4001) {
        bytes[at] ^= 4;
        let (events, summary) = read(bytes.clone(), &rods, &windows(10.0));
        bytes[at] ^= 4;
        let found = records(&events);
        // Damage in an index, which is not needed, costs nothing.
        fewer += usize::from(found.len() < clean);
        assert!(found.len() >= clean / 3 && found.iter().all(|record| is_true(record)));
        let told = summary.sentences().join("\n");
        assert!(
            told.starts_with("test.mcap: at byte ") && told.contains("copy the file again"),
            "{told}"
        );
    }
    assert!(fewer >= 2, "{fewer}");
}

#[test]
fn a_file_of_nothing_but_spoilt_chunks_is_given_up() {
    let mut bytes = half_an_hour();
    let rods = [rod("r", "/laser", "values")];
    for at in (2000..bytes.len() - 4000).step_by(500) {
        bytes[at] ^= 1;
    }
    let (events, summary) = read(bytes, &rods, &windows(60.0));
    assert!(records(&events).is_empty());
    assert!(
        summary.damage.is_some() && summary.holes.len() <= 100,
        "{}",
        summary.holes.len()
    );
}

/// Opcode and content.
type RawRecord = (u8, Vec<u8>);

/// A file of raw records.
fn raw(records: &[RawRecord]) -> Vec<u8> {
    let mut bytes = b"\x89MCAP0\r\n".to_vec();
    for (opcode, content) in records {
        bytes.push(*opcode);
        bytes.extend((content.len() as u64).to_le_bytes());
        bytes.extend(content);
    }
    bytes
}

fn text(text: &[u8]) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text].concat()
}

fn header() -> (u8, Vec<u8>) {
    (1, [text(b""), text(b"")].concat())
}

fn channel_record(id: u16, topic: &[u8]) -> (u8, Vec<u8>) {
    (
        4,
        [
            id.to_le_bytes().to_vec(),
            vec![0, 0],
            text(topic),
            text(b"json"),
            vec![0; 4],
        ]
        .concat(),
    )
}

fn message(channel: u16) -> (u8, Vec<u8>) {
    (
        5,
        [channel.to_le_bytes().to_vec(), vec![0; 20], b"{\"x\":1}".to_vec()].concat(),
    )
}

fn chunk(size: u64, crc: u32, compression: &[u8], data: &[u8]) -> (u8, Vec<u8>) {
    let head = [
        vec![0; 16],
        size.to_le_bytes().to_vec(),
        crc.to_le_bytes().to_vec(),
        text(compression),
    ]
    .concat();
    (
        6,
        [head, (data.len() as u64).to_le_bytes().to_vec(), data.to_vec()].concat(),
    )
}

#[test]
fn contradictions_and_lies_are_refused_with_a_reason() {
    let inner = raw(&[channel_record(1, b"/x"), message(1)])[8..].to_vec();
    let inner_chunk = raw(&[chunk(inner.len() as u64, 0, b"", &inner)])[8..].to_vec();
    let schema = |data: &[u8]| (3u8, [vec![1, 0], text(b"s"), text(b"e"), text(data)].concat());
    let bomb = zstd_zeros();
    let cases: [(&str, Vec<RawRecord>); 16] = [
        ("a message before its channel", vec![header(), message(3)]),
        (
            "a channel changes under its id",
            vec![header(), channel_record(1, b"/x"), channel_record(1, b"/y")],
        ),
        (
            "a schema changes under its id",
            vec![header(), schema(b"a"), schema(b"b")],
        ),
        ("not UTF-8", vec![header(), channel_record(1, b"/\xff")]),
        (
            "a chunk in a chunk",
            vec![header(), chunk(inner_chunk.len() as u64, 0, b"", &inner_chunk)],
        ),
        ("first record is not a header", vec![message(1)]),
        ("a second header", vec![header(), header()]),
        ("at most", vec![header(), chunk(1 << 40, 0, b"zstd", &bomb)]),
        ("decompress", vec![header(), chunk(1000, 0, b"zstd", &bomb)]),
        ("decompress", vec![header(), chunk(1000, 0, b"lz4", b"garbage")]),
        ("decompresses to", vec![header(), chunk(1000, 0, b"", b"short")]),
        ("`brotli`", vec![header(), chunk(0, 0, b"brotli", b"")]),
        (
            "checksum of a chunk",
            vec![header(), chunk(inner.len() as u64, 1, b"", &inner)],
        ),
        (
            "a record ends too early",
            vec![
                header(),
                chunk(9, 0, b"", &[5, 255, 255, 255, 255, 255, 255, 255, 127]),
            ],
        ),
        ("a record ends too early", vec![header(), (4, vec![1])]),
        ("unknown kind", vec![header(), (0x7f, vec![])]),
    ];
    for (told, records) in cases {
        let mut rods = [rod("r", "/x", "x")];
        rods[0].displacement.fs_hz = None;
        let (events, summary) = read(raw(&records), &rods, &RecordSettings::default());
        let damage: String = summary.damage.into_iter().chain(summary.holes).collect();
        assert!(damage.contains(told), "{told}: {damage:?}");
        assert_eq!(crate::common::records(&events).len(), 0);
    }
    // A length of nearly everything, and a file that is none.
    let mut lie = raw(&[header()]);
    lie.extend([5, 255, 255, 255, 255, 255, 255, 255, 255]);
    assert!(
        read(lie, &[], &RecordSettings::default())
            .1
            .damage
            .unwrap()
            .contains("at most")
    );
    // The second is shorter than the first bytes of a recording.
    for none in [&b"GIF89a, not a recording at all"[..], b"hello\n"] {
        let (_, summary) = read(none.to_vec(), &[], &RecordSettings::default());
        assert!(summary.damage.unwrap().contains("not an MCAP file"));
    }
    assert!(read(Vec::new(), &[], &RecordSettings::default()).1.truncated);
}

/// A compressed chunk of 256 MiB of zeros would be tiny; this one says it is small.
fn zstd_zeros() -> Vec<u8> {
    zstd::bulk::compress(&vec![0u8; 32 << 20], 3).unwrap()
}

#[test]
fn a_growing_file_is_followed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.mcap");
    let options = WriterOptions {
        chunk_bytes: Some(8000),
        ..Default::default()
    };
    let bytes = recording(Encoding::Json, Layout::Sample, options, 12_000);
    let (whole, _) = read(bytes.clone(), &[rod("r", "/laser", "value")], &windows(10.0));
    for finished in [true, false] {
        let mut file = std::fs::File::create(&path).unwrap();
        file.write_all(&bytes[..100]).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let follow = Follow {
            stop: stop.clone(),
            poll: Duration::from_millis(1),
        };
        let mut reader = Recording::open(
            &path,
            &[rod("r", "/laser", "value")],
            &windows(10.0),
            Options { follow: Some(follow) },
        )
        .unwrap();
        let end = if finished { bytes.len() } else { bytes.len() - 5000 };
        let rest = bytes[100..end].to_vec();
        let writer = std::thread::spawn(move || {
            for part in rest.chunks(7001) {
                file.write_all(part).unwrap();
                std::thread::sleep(Duration::from_millis(2));
            }
            std::thread::sleep(Duration::from_millis(100));
            stop.store(true, Ordering::Relaxed);
        });
        let events: Vec<Event> = reader.by_ref().collect();
        writer.join().unwrap();
        assert_eq!(reader.summary().truncated, !finished);
        let (found, whole) = (records(&events), records(&whole));
        assert!(if finished {
            found.len() == whole.len()
        } else {
            found.len() >= 4
        });
        for (found, whole) in found.iter().zip(&whole) {
            assert!(found.samples.iter().zip(&whole.samples).all(|(a, b)| a == b));
        }
    }
}

#[test]
fn folders_are_read_in_the_order_of_their_data() {
    let folder = tempfile::tempdir().unwrap();
    for (name, start) in [("b.mcap", 10.0), ("a.mcap", 20.0), ("c.MCAP", 0.0)] {
        let mut writer =
            RecordingWriter::create(&folder.path().join(name), WriterOptions::default()).unwrap();
        let id = writer
            .add_channel(spec("/x", Encoding::Json, Layout::Sample))
            .unwrap();
        writer
            .write_samples(id, Timestamp::from_nanos(0).plus_seconds(start), FS, &[1.0])
            .unwrap();
        writer.save().unwrap();
    }
    std::fs::write(folder.path().join("z.mcap"), b"not one").unwrap();
    std::fs::write(folder.path().join("note.txt"), b"").unwrap();
    std::fs::create_dir(folder.path().join("deep.mcap")).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink("/etc/hostname", folder.path().join("link.mcap")).unwrap();
    let found = tirante::recording::read::recordings(&[folder.path().to_owned()])
        .into_iter()
        .collect::<Result<Vec<_>, _>>()
        .unwrap();
    let names: Vec<_> = found
        .iter()
        .map(|path| path.file_name().unwrap().to_str().unwrap())
        .collect();
    assert_eq!(names, ["c.MCAP", "b.mcap", "a.mcap", "z.mcap"]);
    let empty = tempfile::tempdir().unwrap();
    assert!(
        tirante::recording::read::recordings(&[empty.path().to_owned()])
            .remove(0)
            .unwrap_err()
            .to_string()
            .contains("no recordings")
    );
    assert!(tirante::recording::read::recordings(&[empty.path().join("absent")])[0].is_err());
    let told = Recording::open(empty.path(), &[], &RecordSettings::default(), Options::default())
        .map(|_| ())
        .unwrap_err();
    assert!(told.to_string().contains("not a regular file"));
}

/// Peak memory of this process so far \[MB\].
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
}

#[test]
#[ignore = "campaign: peak memory on a large and on hostile files, half a minute; run alone with --ignored --nocapture memory"]
fn memory_is_bounded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.mcap");
    let samples = motion(200_000);
    for (layout, hours) in [(Layout::Sample, 6), (Layout::Batch(200), 60)] {
        let mut writer = RecordingWriter::create(&path, WriterOptions::default()).unwrap();
        let id = writer
            .add_channel(spec("/laser", Encoding::Json, layout))
            .unwrap();
        for part in 0..hours * 3600 / 1000 {
            writer
                .write_samples(id, START.plus_seconds(f64::from(part) * 1000.0), FS, &samples)
                .unwrap();
        }
        writer.save().unwrap();
        let size = std::fs::metadata(&path).unwrap().len() >> 20;
        for (cut, settings) in [
            ("windows of 60 s", windows(60.0)),
            ("hours", RecordSettings::default()),
        ] {
            let rods = [rod("r", "/laser", field(Encoding::Json, layout))];
            let count = Recording::open(&path, &rods, &settings, Options::default())
                .unwrap()
                .count();
            println!(
                "{hours} h in {size} MB, {layout:?}, cut in {cut}: {count} records, peak {:.0} MB",
                peak_mb()
            );
            assert!(peak_mb() < 200.0);
        }
    }
    // A chunk that is as large as it may be, and lengths that lie.
    for size in [64u64 << 20, (64 << 20) + 1, 1 << 40] {
        let zeros = zstd::bulk::compress(&vec![0u8; 60 << 20], 1).unwrap();
        let (_, summary) = read(
            raw(&[header(), chunk(size, 0, b"zstd", &zeros)]),
            &[],
            &RecordSettings::default(),
        );
        assert!(summary.damage.is_some());
    }
    println!("after bombs: peak {:.0} MB", peak_mb());
    assert!(peak_mb() < 256.0);
}

#[test]
fn reading_can_move_to_another_thread() {
    fn sendable<T: Send>() {}
    sendable::<Recording>();
}
