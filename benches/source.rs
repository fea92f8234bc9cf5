//! Reading recordings: MCAP to checked records, one core.
//!
//! `cargo bench --bench source`. Each measurement opens a file from memory, decompresses, checks, decodes,
//! cuts and checks quality; the file holds one million samples unless its name says otherwise.

#![allow(clippy::unwrap_used, reason = "a measurement that cannot be set up must stop")]

use divan::Bencher;
use divan::counter::ItemsCount;
use std::io::Cursor;
use tirante::analysis::signal::record::{
    Channel, Cut, RecordSettings, RodChannels, RodId, TimeSource, Timestamp, Unit,
};
use tirante::recording::read::{Options, Recording};
use tirante::recording::write::{
    ChannelSpec, Compression, Encoding, Layout, Precision, RecordingWriter, WriterOptions,
};

fn main() {
    divan::main();
}

const FS: f64 = 200.0;

/// A laser's record: micrometres on some millimetres, as its digits allow.
fn motion(count: usize, precision: Precision) -> Vec<f64> {
    (0..count)
        .map(|i| {
            let t = i as f64 / FS;
            let x = (28.2 * t).sin() + 0.4 * (58.4 * t + 1.0).sin() + 1e-2 * (i as f64 * 0.37).cos();
            match precision {
                Precision::Single => (x * 1e4).round() / 1e4,
                Precision::Double => x,
            }
        })
        .collect()
}

fn file(
    encoding: Encoding,
    layout: Layout,
    precision: Precision,
    compression: Compression,
    count: usize,
) -> Vec<u8> {
    let options = WriterOptions {
        compression,
        ..Default::default()
    };
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), options).unwrap();
    let spec = ChannelSpec {
        topic: "/laser".into(),
        encoding,
        layout,
        precision,
        unit: Unit::Millimetre,
    };
    let id = writer.add_channel(spec).unwrap();
    let start = Timestamp::from_nanos(1_772_344_800_000_000_000);
    writer
        .write_samples(id, start, FS, &motion(count, precision))
        .unwrap();
    writer.finish().unwrap().into_inner()
}

/// Reads everything; the samples that became records.
fn read(bytes: &[u8], field: &str) -> usize {
    let rods = [RodChannels {
        rod: RodId("r".into()),
        displacement: Channel {
            topic: "/laser".into(),
            field: field.into(),
            unit: Unit::Millimetre,
            time: TimeSource::Log,
            fs_hz: Some(FS),
        },
        temperature: None,
        beside: None,
    }];
    let settings = RecordSettings {
        cut: Cut::Window { length_s: 60.0 },
        ..Default::default()
    };
    let input = Cursor::new(bytes.to_vec());
    let recording = Recording::new("bench", input, &rods, &settings, Options::default()).unwrap();
    recording.map(|event| event.samples()).sum()
}

fn measure(bencher: Bencher<'_, '_>, bytes: &[u8], field: &str, count: usize) {
    assert_eq!(read(bytes, field), count);
    bencher
        .counter(ItemsCount::new(count))
        .bench_local(|| read(bytes, field));
}

/// One million JSON messages of one sample, four digits behind the point.
#[divan::bench(args = [Compression::Zstd, Compression::Lz4, Compression::None], sample_count = 7, sample_size = 1)]
fn json_scalar_1e6(bencher: Bencher<'_, '_>, compression: Compression) {
    let bytes = file(
        Encoding::Json,
        Layout::Sample,
        Precision::Single,
        compression,
        1_000_000,
    );
    measure(bencher, &bytes, "value", 1_000_000);
}

/// The same with all seventeen digits.
#[divan::bench(sample_count = 7, sample_size = 1)]
fn json_scalar_1e6_17_digits(bencher: Bencher<'_, '_>) {
    let bytes = file(
        Encoding::Json,
        Layout::Sample,
        Precision::Double,
        Compression::Zstd,
        1_000_000,
    );
    measure(bencher, &bytes, "value", 1_000_000);
}

/// Ten thousand JSON arrays of a hundred samples, four digits behind the point and all seventeen.
#[divan::bench(args = [4, 17], sample_count = 15, sample_size = 1)]
fn json_arrays_1e6(bencher: Bencher<'_, '_>, digits: usize) {
    let precision = if digits == 4 {
        Precision::Single
    } else {
        Precision::Double
    };
    let bytes = file(
        Encoding::Json,
        Layout::Batch(100),
        precision,
        Compression::Zstd,
        1_000_000,
    );
    measure(bencher, &bytes, "values", 1_000_000);
}

/// One hundred thousand messages of one sample.
#[divan::bench(args = [Encoding::Ros2, Encoding::Protobuf, Encoding::Json], sample_count = 15, sample_size = 1)]
fn messages_1e5(bencher: Bencher<'_, '_>, encoding: Encoding) {
    let bytes = file(
        encoding,
        Layout::Sample,
        Precision::Double,
        Compression::Zstd,
        100_000,
    );
    let field = if encoding == Encoding::Ros2 {
        "data"
    } else {
        "value"
    };
    measure(bencher, &bytes, field, 100_000);
}

/// Ten thousand arrays of a hundred samples.
#[divan::bench(args = [Encoding::Ros2, Encoding::Protobuf], sample_count = 15, sample_size = 1)]
fn arrays_1e6(bencher: Bencher<'_, '_>, encoding: Encoding) {
    let bytes = file(
        encoding,
        Layout::Batch(100),
        Precision::Double,
        Compression::Zstd,
        1_000_000,
    );
    measure(bencher, &bytes, "values", 1_000_000);
}

/// Time against size, JSON messages of one sample.
#[divan::bench(args = [10_000, 100_000, 1_000_000, 4_000_000], sample_count = 5, sample_size = 1)]
fn json_scalar_size(bencher: Bencher<'_, '_>, count: usize) {
    // Whole windows only, so that nothing is left over.
    let count = count / 12_000 * 12_000 + 6000;
    let bytes = file(
        Encoding::Json,
        Layout::Sample,
        Precision::Single,
        Compression::Zstd,
        count,
    );
    measure(bencher, &bytes, "value", count);
}

/// The paper's campaign: 100 records of 60 s at 200 Hz, one sample a message and in arrays.
#[divan::bench(args = [1, 200], sample_count = 5, sample_size = 1)]
fn campaign_100_records(bencher: Bencher<'_, '_>, batch: usize) {
    let layout = if batch == 1 {
        Layout::Sample
    } else {
        Layout::Batch(batch)
    };
    let bytes = file(
        Encoding::Json,
        layout,
        Precision::Single,
        Compression::Zstd,
        1_200_000,
    );
    measure(
        bencher,
        &bytes,
        if batch == 1 { "value" } else { "values" },
        1_200_000,
    );
}
