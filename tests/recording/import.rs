//! Measurements of other programs against those programs' own readers, to MCAP and back bit for bit, and damaged.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::common::rod;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::PathBuf;
use tirante::analysis::signal::record::{Event, TimeSource, Timestamp, Unit};
use tirante::recording::import::csv::{self, Table};
use tirante::recording::import::{
    Asked, ImportError, MOST_VALUES, Plan, Signal, TimeUnit, Timing, lvm, mat, npy, tdms, uff, wav, write,
};
use tirante::recording::read::{Decoder, SchemaRef};
use tirante::recording::write::{Encoding, Layout, RecordingWriter, WriterOptions};

fn fixture(name: &str) -> Vec<u8> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/import")
        .join(name);
    std::fs::read(path).unwrap()
}

/// Values by the oracle: the bits of every sample, by file and channel.
fn expected(name: &str) -> BTreeMap<String, Vec<String>> {
    let all: BTreeMap<String, BTreeMap<String, Vec<String>>> =
        serde_json::from_slice(&fixture("expected.json")).unwrap();
    all.get(name).unwrap().clone()
}

fn bits(values: &[f64]) -> Vec<String> {
    values
        .iter()
        .map(|value| format!("{:016x}", value.to_bits()))
        .collect()
}

fn as_the_oracle(name: &str, signals: &[Signal]) {
    let expected = expected(name);
    let found: BTreeMap<String, Vec<String>> = signals
        .iter()
        .map(|signal| (signal.name.clone(), bits(&signal.values)))
        .collect();
    assert!(!expected.is_empty());
    assert_eq!(found, expected, "{name}");
}

#[test]
fn universal_files_read_as_pyuff_reads_them() {
    for (name, skipped) in [
        ("text.uff", "a function of type 4"),
        ("binary.uff", "a function of type 2"),
    ] {
        let found = uff::read(fixture(name).as_slice(), 0).unwrap();
        as_the_oracle(name, &found.signals);
        assert_eq!(found.skipped.len(), 1);
        assert!(found.skipped[0].contains(skipped), "{:?}", found.skipped);
        assert!(
            found
                .signals
                .iter()
                .all(|signal| signal.unit.as_deref() == Some("mm"))
        );
        let plan = Plan::new(found.signals, &Asked::default(), Encoding::Protobuf).unwrap();
        for channel in &plan.channels {
            // The header has six digits of 1/1024; uneven spacing has stamps of six digits.
            assert!(
                (channel.fs_hz / 1024.0 - 1.0).abs() < 1e-5,
                "{}: {}",
                channel.name,
                channel.fs_hz
            );
            assert_eq!(channel.stretches[0].0.to_string(), "2026-08-16T14:03:12Z");
        }
        assert_eq!(plan.channels[0].fs_hz, 1024.0);
    }
}

#[test]
fn single_precision_and_big_endian_blocks_of_58b() {
    let header = |order: u32, bytes: usize| {
        format!(
            "    -1\n    58b{order:6}     2          11{bytes:12}     0     0           0           0\nwall\nNONE\nNONE\nNONE\nNONE\n    1         0    0         0       NONE         1   3       NONE         1   3\n         2         3         1  0.00000e+00  5.00000e-03  0.00000e+00\n        17    0    0    0 Time                 s                   \n        12    0    0    0 Acceleration         g                   \n         0    0    0    0 NONE                 NONE                \n         0    0    0    0 NONE                 NONE                \n"
        )
    };
    let values = [1.5_f32, -0.1, 3e-30];
    for order in [1, 2] {
        let mut file = header(order, 12).into_bytes();
        for value in values {
            file.extend(if order == 1 {
                value.to_le_bytes()
            } else {
                value.to_be_bytes()
            });
        }
        file.extend(b"\n    -1\n");
        let found = uff::read(file.as_slice(), 0).unwrap();
        assert_eq!(found.signals[0].values, values.map(f64::from));
        assert_eq!(found.signals[0].unit.as_deref(), Some("g"));
        assert!(
            uff::read(&file[..file.len() - 10], 0)
                .unwrap_err()
                .to_string()
                .contains("cut short")
        );
    }
    let lying = header(1, 1 << 30);
    let error = uff::read(lying.as_bytes(), 0).unwrap_err().to_string();
    assert!(error.contains("58b of 1073741824 bytes, but 3 points"), "{error}");
}

#[test]
fn touching_columns_of_text_are_told_apart() {
    let file = "    -1\n    58\nwall\nNONE\nNONE\nNONE\nNONE\n    1         0\n         2         4         1  0.00000e+00  5.00000e-03  0.00000e+00\n        17\n         8    0    0    0 Displacement         mm\n         0\n         0\n-1.00000E+100-2.00000E+100 3.00000D+000\n-4.00000E+00\n    -1\n";
    let found = uff::read(file.as_bytes(), 0).unwrap();
    assert_eq!(found.signals[0].values, [-1e100, -2e100, 3.0, -4.0]);
    let less = file.replace("-4.00000E+00\n", "");
    let error = uff::read(less.as_bytes(), 0).unwrap_err().to_string();
    assert_eq!(error, "line 15: the dataset ends after 3 of 4 numbers");
    let axis = |label: &str| format!("        17    0    0    0 Time                 {label}\n         8 ");
    let slow = file.replace("        17\n         8 ", &axis("ms"));
    assert!(
        uff::read(slow.as_bytes(), 0)
            .unwrap_err()
            .to_string()
            .contains("over a time in \"ms\"")
    );
    assert!(uff::read(file.replace("        17\n         8 ", &axis("s")).as_bytes(), 0).is_ok());
    let odd = file.replace("-4.00000E+00", "-4.00x00E+00");
    assert!(
        uff::read(odd.as_bytes(), 0)
            .unwrap_err()
            .to_string()
            .starts_with("line 15: ")
    );
}

#[test]
fn matlab_files_read_as_scipy_reads_them() {
    for name in ["plain.mat", "packed.mat"] {
        let found = mat::read(fixture(name).as_slice(), None, true, Some(TimeUnit::S)).unwrap();
        as_the_oracle(name, &found.signals);
        let left_out = found.skipped.join("; ");
        for what in [
            "fs (the number 200)",
            "name (text)",
            "z (complex)",
            "s (a structure)",
        ] {
            assert!(left_out.contains(what), "{left_out}");
        }
        let Timing::Stamps(stamps) = &found.signals[0].timing else {
            panic!("no stamps")
        };
        assert_eq!(stamps.nanos[..3], [0, 5_000_000, 10_000_000]);
        let named = mat::read(fixture(name).as_slice(), Some("nobody"), true, Some(TimeUnit::S));
        assert!(named.unwrap_err().to_string().contains("there is: t, laser"));
    }
}

#[test]
fn other_versions_of_matlab_files_are_refused_by_name() {
    let refused = |bytes: &[u8]| {
        mat::read(bytes, None, true, Some(TimeUnit::S))
            .unwrap_err()
            .to_string()
    };
    let mut hdf = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".to_vec();
    hdf.resize(512, b' ');
    assert!(refused(&hdf).contains("7.3 (HDF5)") && refused(&hdf).contains("'-v7'"));
    assert!(refused(b"\x89HDF\r\n\x1a\n").contains("HDF5"));
    assert!(refused(&[0; 200]).contains("version 4?"));
    assert!(refused(b"").contains("no MATLAB file"));
}

#[test]
fn a_matlab_file_that_unpacks_without_end_is_refused() {
    use std::io::Write as _;
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    let zeros = vec![0_u8; 1 << 20];
    for _ in 0..((8 * MOST_VALUES) >> 20) + 1 {
        packed.write_all(&zeros).unwrap();
    }
    let packed = packed.finish().unwrap();
    let mut file = fixture("plain.mat")[..128].to_vec();
    file.extend(15_u32.to_le_bytes());
    file.extend((packed.len() as u32).to_le_bytes());
    file.extend(packed);
    let error = mat::read(file.as_slice(), None, true, Some(TimeUnit::S))
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("variable 1: unpacks to more than"), "{error}");
}

#[test]
fn sound_files_read_as_scipy_reads_them() {
    for name in ["whole.wav", "float.wav", "double.wav", "long.wav"] {
        let found = wav::read(fixture(name).as_slice(), 1.0).unwrap();
        as_the_oracle(name, &found);
        let scaled = wav::read(fixture(name).as_slice(), 2.5).unwrap();
        for (value, scaled) in found[0].values.iter().zip(&scaled[0].values) {
            assert_eq!(*scaled, value * 2.5);
        }
        let bytes = fixture(name);
        let cut = wav::read(&bytes[..bytes.len() - 3], 1.0).unwrap_err().to_string();
        assert!(cut.contains("cut short"), "{cut}");
    }
    assert!(wav::read(&b"RIFF"[..], 1.0).is_err());
}

#[test]
fn sound_of_24_bits_and_two_channels() {
    let spec = hound::WavSpec {
        channels: 2,
        sample_rate: 1000,
        bits_per_sample: 24,
        sample_format: hound::SampleFormat::Int,
    };
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = hound::WavWriter::new(&mut bytes, spec).unwrap();
    for sample in [1 << 22, -1, 0, -(1 << 23)] {
        writer.write_sample(sample).unwrap();
    }
    writer.finalize().unwrap();
    let found = wav::read(bytes.into_inner().as_slice(), 4.0).unwrap();
    assert_eq!(found[0].values, [2.0, 0.0]);
    assert_eq!(found[1].values, [-4.0 / 8_388_608.0, -4.0]);
}

#[test]
fn sound_of_the_extensible_format() {
    // 24 bits of which 20 count, as sound cards write them: in the upper end of their container.
    let mut bytes = b"RIFF\0\0\0\0WAVEfmt \x28\0\0\0\xfe\xff\x01\0".to_vec();
    bytes.extend(1000_u32.to_le_bytes());
    bytes.extend(3000_u32.to_le_bytes());
    bytes.extend([3, 0, 24, 0, 22, 0, 20, 0, 4, 0, 0, 0]);
    bytes.extend(b"\x01\0\0\0\0\0\x10\0\x80\0\0\xaa\0\x38\x9b\x71");
    bytes.extend(b"data\x06\0\0\0\0\0\x40\0\0\x80");
    let found = wav::read(bytes.as_slice(), 2.0).unwrap();
    assert_eq!(found[0].values, [1.0, -2.0]);
}

#[test]
fn sound_in_wider_containers_is_refused() {
    let mut bytes = fixture("float.wav");
    let at = bytes.windows(4).position(|name| name == b"fmt ").unwrap() + 8;
    // 24 bits of whole numbers in four bytes.
    bytes[at..at + 2].copy_from_slice(&1_u16.to_le_bytes());
    bytes[at + 14..at + 16].copy_from_slice(&24_u16.to_le_bytes());
    let refused = wav::read(bytes.as_slice(), 1.0).unwrap_err().to_string();
    assert!(
        refused.contains("wider containers") || refused.contains("kind of WAV"),
        "{refused}"
    );
}

#[test]
fn arrays_read_as_numpy_reads_them() {
    for name in [
        "row.npy",
        "swapped.npy",
        "half.npy",
        "table.npy",
        "columns.npy",
        "cube.npy",
    ] {
        let found = npy::read(fixture(name).as_slice()).unwrap();
        as_the_oracle(name, &found);
        assert!(found.iter().all(|signal| signal.timing == Timing::Unknown));
    }
}

#[test]
fn binary_labview_files_read_as_nptdms_reads_them() {
    for (name, fs_hz, left_out) in [
        ("plain.tdms", 1024.0, "run/notes (no real numbers)"),
        ("odd.tdms", 512.0, ""),
        ("unfinished.tdms", 512.0, "9 bytes at the end"),
    ] {
        let found = tdms::read(fixture(name).as_slice(), None, true, Some(TimeUnit::S)).unwrap();
        as_the_oracle(name, &found.signals);
        assert!(found.skipped.join("; ").contains(left_out), "{:?}", found.skipped);
        assert_eq!(
            found.skipped.is_empty(),
            left_out.is_empty(),
            "{:?}",
            found.skipped
        );
        let laser = &found.signals[0];
        let plan = Plan::new(vec![laser.clone()], &asked_from(name), Encoding::Protobuf).unwrap();
        assert_eq!(plan.channels[0].fs_hz, fs_hz);
        let written = laser.unit.as_deref();
        assert_eq!(written, Some(if name == "plain.tdms" { "mm" } else { "um" }));
        if name == "plain.tdms" {
            assert_eq!(
                plan.channels[0].stretches[0].0.to_string(),
                "2026-08-16T14:03:12.25Z"
            );
        }
    }
}

fn asked_from(name: &str) -> Asked<'static> {
    Asked {
        start: Some(START).filter(|_| name != "plain.tdms"),
        ..Asked::default()
    }
}

#[test]
fn binary_labview_files_that_are_not_read_are_refused_by_name() {
    let refused = |bytes: &[u8]| {
        tdms::read(bytes, None, true, Some(TimeUnit::S))
            .unwrap_err()
            .to_string()
    };
    let whole = fixture("odd.tdms");
    // The table of contents declares raw data of DAQmx; so does the index of an object.
    let mut of_daqmx = whole.clone();
    of_daqmx[4] |= 0x80;
    assert!(refused(&of_daqmx).contains("DAQmx"), "{}", refused(&of_daqmx));
    let plain = fixture("plain.tdms");
    let at = plain.windows(4).position(|word| word == [0x14, 0, 0, 0]).unwrap();
    let mut of_daqmx = plain.clone();
    of_daqmx[at..at + 4].copy_from_slice(&0x1269_u32.to_le_bytes());
    assert!(refused(&of_daqmx).contains("DAQmx"), "{}", refused(&of_daqmx));
    let mut index = whole.clone();
    index[..4].copy_from_slice(b"TDSh");
    assert!(refused(&index).contains("index of a TDMS file"));
    let mut version = whole.clone();
    version[8..12].copy_from_slice(&9_u32.to_be_bytes());
    assert!(refused(&version).contains("version 9"), "{}", refused(&version));
    assert!(refused(&whole[..whole.len() - 1]).contains("cut short"));
    assert!(refused(b"TDSm").contains("damaged"));
    let named = tdms::read(plain.as_slice(), Some("nobody"), true, Some(TimeUnit::S));
    assert!(named.unwrap_err().to_string().contains("there is: run/laser's"));
}

#[test]
fn labview_texts_read_as_lvm_read_reads_them() {
    for (name, stretches) in [("commas.lvm", 1), ("segments.lvm", 2), ("multi.lvm", 1)] {
        let found = lvm::read(fixture(name).as_slice(), 7200).unwrap();
        as_the_oracle(name, &found.signals);
        let units: Vec<_> = found
            .signals
            .iter()
            .map(|signal| signal.unit.as_deref())
            .collect();
        assert_eq!(units, [Some("mm"), Some("m/s^2")]);
        let plan = Plan::new(found.signals, &Asked::default(), Encoding::Protobuf).unwrap();
        let channel = &plan.channels[1];
        // Stamps have a microsecond of 16 samples, whose rate is as good.
        assert!(
            (channel.fs_hz / 1024.0 - 1.0).abs() < 1e-4,
            "{name}: {}",
            channel.fs_hz
        );
        assert_eq!(channel.unit, Unit::MetrePerSecondSquared);
        assert_eq!(channel.stretches.len(), stretches);
        assert_eq!(channel.stretches[0].0.to_string(), "2026-08-16T12:03:12.25Z");
        if stretches == 2 {
            assert_eq!(channel.stretches[1].0.to_string(), "2026-08-16T12:05:00.25Z");
        }
    }
}

const START: Timestamp = Timestamp::from_nanos(1_772_344_800_000_000_000);

fn asked() -> Asked<'static> {
    Asked {
        unit: Some(Unit::Millimetre),
        start: Some(START),
        ..Asked::default()
    }
}

fn mcap_of(plan: &Plan) -> Vec<u8> {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
    write(&mut writer, plan).unwrap();
    writer.finish().unwrap().into_inner()
}

/// The samples of every channel of a recording, decoded as `replay` decodes them, and the times of its messages.
fn decoded(bytes: &[u8], plan: &Plan) -> BTreeMap<String, (Vec<f64>, Vec<u64>)> {
    let mut found: BTreeMap<String, (Vec<f64>, Vec<u64>)> = BTreeMap::new();
    for message in mcap::MessageStream::new(bytes).unwrap() {
        let message = message.unwrap();
        let planned = plan
            .channels
            .iter()
            .find(|channel| channel.topic == message.channel.topic)
            .unwrap();
        assert_eq!(message.channel.metadata["unit"], planned.unit.key());
        let schema = message.channel.schema.as_ref().unwrap();
        let schema = SchemaRef {
            name: &schema.name,
            encoding: &schema.encoding,
            data: &schema.data,
        };
        let decoder = Decoder::compile(
            &message.channel.message_encoding,
            Some(schema),
            planned.field(plan.encoding),
            &TimeSource::Log,
        )
        .unwrap();
        let (samples, times) = found.entry(planned.topic.clone()).or_default();
        let mut piece = Vec::new();
        decoder.decode(&message.data, 0, &mut piece).unwrap();
        samples.extend(piece);
        times.push(message.log_time);
    }
    found
}

/// Any double that is a number.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => any::<f64>().prop_filter("a number", |value| value.is_finite()),
        1 => Just(-0.0),
        1 => Just(f64::MIN_POSITIVE / 3.0),
    ]
}

proptest! {
    #![proptest_config(Config::with_cases(128))]

    /// A table of any doubles is read from the recording with the same bits, in every encoding, and the same
    /// table gives the same bytes.
    #[test]
    fn tables_keep_every_bit(
        rows in prop::collection::vec((number(), number()), 2..700),
        decimal_comma in any::<bool>(),
        which in 0..3_usize,
    ) {
        let comma = |value: f64| {
            let text = format!("{value:?}");
            if decimal_comma { text.replace('.', ",") } else { text }
        };
        let mut text = "Zeit;a [mm];b [°C]\n".to_owned();
        for (index, (a, b)) in rows.iter().enumerate() {
            text += &format!("{};{};{}\n", comma(index as f64 / 200.0), comma(*a), comma(*b));
        }
        let table = Table { decimal_comma, ..Table::default() };
        let signals = csv::read(text.as_bytes(), &table).unwrap().signals;
        let encoding = [Encoding::Json, Encoding::Protobuf, Encoding::Ros2][which];
        let plan = Plan::new(signals, &asked(), encoding).unwrap();
        prop_assert_eq!(plan.channels[0].fs_hz, 200.0);
        let bytes = mcap_of(&plan);
        prop_assert_eq!(&bytes, &mcap_of(&plan));
        let found = decoded(&bytes, &plan);
        let column = |pick: fn(&(f64, f64)) -> f64| bits(&rows.iter().map(pick).collect::<Vec<_>>());
        prop_assert_eq!(bits(&found["a"].0), column(|row| row.0));
        prop_assert_eq!(bits(&found["b"].0), column(|row| row.1));
        prop_assert_eq!(found["b"].1.len(), rows.len());
        prop_assert_eq!(found["b"].1[1], START.as_nanos() as u64 + 5_000_000);
    }
}

#[test]
fn gaps_keep_their_times_and_missing_cells_stay_missing() {
    let mut text = "timestamp,d [mm]\n".to_owned();
    for index in 0..2000 {
        let second = index as f64 / 200.0 + if index < 500 { 0.0 } else { 7.25 };
        let value = if index == 3 {
            String::new()
        } else {
            format!("{}", (second * 28.2).sin())
        };
        text += &format!("2026-03-01 06:00:{second:06.3},{value}\n");
    }
    let signals = csv::read(text.as_bytes(), &Table::default()).unwrap().signals;
    let plan = Plan::new(signals, &Asked::default(), Encoding::Json).unwrap();
    assert_eq!(plan.channels[0].missing(), 1);
    assert_eq!(plan.channels[0].stretches.len(), 2);
    let found = decoded(&mcap_of(&plan), &plan);
    let (samples, times) = &found["d"];
    assert_eq!(samples.len(), 2000);
    assert!(samples[3].is_nan());
    assert!(
        times.contains(&(START.as_nanos() as u64 + 9_750_000_000)),
        "the second stretch begins at its own time"
    );
}

#[test]
fn what_is_imported_is_read_as_a_record() {
    let mut text = "t,laser [mm]\n".to_owned();
    let motion = crate::common::motion(12_000);
    for (index, value) in motion.iter().enumerate() {
        text += &format!("{},{value:?}\n", index as f64 / 200.0);
    }
    let signals = csv::read(text.as_bytes(), &Table::default()).unwrap().signals;
    let mut channels = rod("nave", "laser", "values");
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Ros2] {
        let rods = [channels.clone()];
        let asked = Asked {
            rods: &rods,
            ..asked()
        };
        let plan = Plan::new(signals.clone(), &asked, encoding).unwrap();
        assert!(matches!(plan.channels[0].layout, Layout::Batch(200)));
        let (events, summary) = crate::common::read(mcap_of(&plan), &rods, &crate::common::windows(60.0));
        assert!(summary.damage.is_none());
        let records = crate::common::records(&events);
        assert_eq!(records.len(), 1, "{events:?}");
        assert_eq!((records[0].start, records[0].fs_hz), (START, 200.0));
        let metres: Vec<f64> = motion.iter().map(|value| value * 1e-3).collect();
        assert_eq!(bits(&records[0].samples), bits(&metres));
        assert!(
            events
                .iter()
                .all(|event| !matches!(event, Event::Rejected { .. }))
        );
    }
    channels.displacement.unit = Unit::Metre;
    let rods = [channels];
    let refused = Plan::new(
        signals,
        &Asked {
            rods: &rods,
            ..asked()
        },
        Encoding::Json,
    )
    .unwrap_err();
    assert!(
        refused.to_string().contains("is in mm") && refused.to_string().contains("in m:"),
        "{refused}"
    );
}

/// Takes a reader's result of damaged bytes through to the recording.
fn survive(read: Result<Vec<Signal>, ImportError>) {
    let signals = match read {
        Ok(signals) => signals,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    assert!(signals.iter().map(|signal| signal.values.len()).sum::<usize>() <= MOST_VALUES);
    for resample_hz in [None, Some(64.0)] {
        let asked = Asked {
            rate_hz: Some(200.0).filter(|_| resample_hz.is_none()),
            resample_hz,
            ..asked()
        };
        if let Ok(plan) = Plan::new(signals.clone(), &asked, Encoding::Protobuf) {
            let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
            // A time before 1970 is refused here.
            let _ = write(&mut writer, &plan);
        }
    }
}

/// Damages bytes: changed, removed, doubled, or replaced by numbers.
fn damage(bytes: &[u8], changes: &[(u8, prop::sample::Index, u8)]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for (kind, at, value) in changes {
        if bytes.is_empty() {
            break;
        }
        let at = at.index(bytes.len());
        let end = (at + usize::from(*value) % 40 + 1).min(bytes.len());
        match kind % 6 {
            0 => bytes[at] ^= 1 << (value % 8),
            1 => bytes[at] = *value,
            2 => drop(bytes.drain(at..end)),
            3 => {
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            4 => bytes.truncate(at),
            _ => {
                let words: [&[u8]; 8] = [
                    b"-1",
                    b"99999999999",
                    b"nan",
                    b"1e308",
                    b"\xff\xff\xff\x7f",
                    b"\0\0\0\x80",
                    b";",
                    b"\n",
                ];
                bytes.splice(at..end, words[usize::from(*value) % 8].iter().copied());
            }
        }
    }
    bytes
}

/// Damages a file many times and reads it.
fn sweep(bytes: Vec<u8>, read: impl Fn(&[u8])) {
    let changes = prop::collection::vec((any::<u8>(), any::<prop::sample::Index>(), any::<u8>()), 1..6);
    let mut runner = TestRunner::new(Config {
        cases: 2000,
        failure_persistence: None,
        ..Config::default()
    });
    let sweep = runner.run(&changes, |changes| {
        read(&damage(&bytes, &changes));
        Ok(())
    });
    sweep.unwrap();
    for end in 0..bytes.len() {
        read(&bytes[..end]);
    }
}

#[test]
fn damaged_tables_never_panic() {
    let mut text = "Logger;3\nZeit;Weg [µm];Luft (°C)\n".to_owned();
    for index in 0..40 {
        text += &format!("01.03.2026 06:00:00,{:03};{},25;1{index}\n", index * 5, index % 7);
    }
    let table = Table {
        decimal_comma: true,
        ..Table::default()
    };
    assert!(csv::read(text.as_bytes(), &table).is_ok());
    sweep(text.into_bytes(), |bytes| {
        survive(csv::read(bytes, &table).map(|found| found.signals))
    });
    let plain = "t,d\n0,1.5\n0.005,2\n0.01,-3e-4\n0.015,\"4\"\n".to_owned();
    assert!(csv::read(plain.as_bytes(), &Table::default()).is_ok());
    sweep(plain.into_bytes(), |bytes| {
        survive(csv::read(bytes, &Table::default()).map(|found| found.signals))
    });
}

#[test]
fn damaged_universal_files_never_panic() {
    for name in ["text.uff", "binary.uff"] {
        sweep(fixture(name), |bytes| {
            survive(uff::read(bytes, 3600).map(|found| found.signals))
        });
    }
}

#[test]
fn damaged_sound_files_never_panic() {
    for name in ["whole.wav", "float.wav", "double.wav"] {
        sweep(fixture(name), |bytes| survive(wav::read(bytes, 2.5)));
    }
}

#[test]
fn damaged_arrays_never_panic() {
    for name in ["half.npy", "columns.npy", "cube.npy"] {
        sweep(fixture(name), |bytes| survive(npy::read(bytes)));
    }
}

#[test]
fn damaged_labview_files_never_panic() {
    for name in ["plain.tdms", "odd.tdms", "unfinished.tdms"] {
        sweep(fixture(name), |bytes| {
            survive(tdms::read(bytes, None, true, Some(TimeUnit::S)).map(|found| found.signals))
        });
    }
    for name in ["commas.lvm", "segments.lvm", "multi.lvm"] {
        sweep(fixture(name), |bytes| {
            survive(lvm::read(bytes, 0).map(|found| found.signals))
        });
    }
}

/// A bit turned at every place of every fixture: never a panic, and never more than a file may hold.
#[test]
fn every_bit_turned_never_panics() {
    for name in ["odd.tdms", "unfinished.tdms", "half.npy", "double.wav"] {
        let whole = fixture(name);
        for bit in 0..8 * whole.len() {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            survive(match name {
                "half.npy" => npy::read(bytes.as_slice()),
                "double.wav" => wav::read(bytes.as_slice(), 1.0),
                _ => tdms::read(bytes.as_slice(), None, true, Some(TimeUnit::S)).map(|found| found.signals),
            });
        }
    }
}

#[test]
fn a_header_that_promises_more_than_there_is_costs_nothing() {
    // Each declares about 2^60 bytes; the memory taken stays as small as the data.
    let mut lead = fixture("odd.tdms")[..28].to_vec();
    lead[12..20].copy_from_slice(&(1_u64 << 60).to_be_bytes());
    lead[20..28].copy_from_slice(&(1_u64 << 59).to_be_bytes());
    let error = tdms::read(lead.as_slice(), None, true, Some(TimeUnit::S)).unwrap_err();
    assert!(error.to_string().contains("metadata: damaged"), "{error}");
    let shape = "{'descr': '<f8', 'fortran_order': False, 'shape': (1152921504606846976,), }";
    let mut array = b"\x93NUMPY\x01\0".to_vec();
    array.extend((shape.len() as u16).to_le_bytes());
    array.extend(shape.as_bytes());
    assert!(
        npy::read(array.as_slice())
            .unwrap_err()
            .to_string()
            .contains("more than")
    );
}

#[test]
fn damaged_matlab_files_never_panic() {
    for name in ["plain.mat", "packed.mat"] {
        sweep(fixture(name), |bytes| {
            survive(mat::read(bytes, None, true, Some(TimeUnit::S)).map(|found| found.signals))
        });
    }
}
