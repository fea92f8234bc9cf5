//! Recordings made for tests.
#![allow(dead_code, reason = "each test file uses its part")]
#![allow(
    clippy::unwrap_used,
    reason = "a recording that cannot be made fails the test"
)]

use std::io::Cursor;
use tirante::analysis::signal::record::{
    Channel, Cut, Record, RecordSettings, RodChannels, RodId, TimeSource, Timestamp, Unit,
};
use tirante::recording::read::{Event, Options, Recording, Summary};
use tirante::recording::write::{ChannelSpec, Encoding, Layout, Precision, RecordingWriter, WriterOptions};

pub const FS: f64 = 200.0;
pub const START: Timestamp = Timestamp::from_nanos(1_772_344_800_000_000_000);

/// A motion that repeats no value [mm].
pub fn motion(count: usize) -> Vec<f64> {
    (0..count)
        .map(|i| {
            let t = i as f64 / FS;
            (28.2 * t).sin()
                + 0.4 * (58.4 * t + 1.0).sin()
                + 0.1 * (611.0 * t).sin()
                + 1e-3 * (i as f64 * 0.37).cos()
        })
        .collect()
}

pub fn channel(topic: &str, field: &str) -> Channel {
    Channel {
        topic: topic.into(),
        field: field.into(),
        unit: Unit::Millimetre,
        time: TimeSource::Log,
        fs_hz: Some(FS),
    }
}

pub fn rod(id: &str, topic: &str, field: &str) -> RodChannels {
    RodChannels {
        rod: RodId(id.into()),
        displacement: channel(topic, field),
        temperature: None,
        beside: None,
    }
}

pub fn field(encoding: Encoding, layout: Layout) -> &'static str {
    match (encoding, layout) {
        (_, Layout::Batch(_)) => "values",
        (Encoding::Ros2, Layout::Sample) => "data",
        (_, Layout::Sample) => "value",
    }
}

pub fn spec(topic: &str, encoding: Encoding, layout: Layout) -> ChannelSpec {
    ChannelSpec {
        topic: topic.into(),
        encoding,
        layout,
        precision: Precision::Double,
        unit: Unit::Millimetre,
    }
}

/// A recording of [`motion`] on `/laser`.
pub fn recording(encoding: Encoding, layout: Layout, options: WriterOptions, count: usize) -> Vec<u8> {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), options).unwrap();
    let id = writer.add_channel(spec("/laser", encoding, layout)).unwrap();
    writer.write_samples(id, START, FS, &motion(count)).unwrap();
    writer.finish().unwrap().into_inner()
}

pub fn windows(length_s: f64) -> RecordSettings {
    RecordSettings {
        cut: Cut::Window { length_s },
        min_duration_s: length_s,
        ..Default::default()
    }
}

pub fn read(bytes: Vec<u8>, rods: &[RodChannels], settings: &RecordSettings) -> (Vec<Event>, Summary) {
    let mut recording = Recording::new(
        "test.mcap",
        Cursor::new(bytes),
        rods,
        settings,
        Options::default(),
    )
    .unwrap();
    let events: Vec<Event> = recording.by_ref().collect();
    (events, recording.summary().clone())
}

pub fn records(events: &[Event]) -> Vec<&Record> {
    events
        .iter()
        .filter_map(|event| match event {
            Event::Record(record) => Some(record),
            _ => None,
        })
        .collect()
}
