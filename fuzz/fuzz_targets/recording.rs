//! Any bytes as a recording: no panic, bounded memory, and every record is finite and even.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::io::Cursor;
use tirante::analysis::signal::record::{Channel, Cut, Event, RecordSettings, RodChannels, RodId, TimeSource, Unit};
use tirante::recording::read::{Options, Recording};

fn rod(field: &str, time: TimeSource) -> RodChannels {
    let channel = |field: &str, fs_hz| Channel {
        topic: "/laser".into(),
        field: field.into(),
        unit: Unit::Millimetre,
        time: time.clone(),
        fs_hz,
    };
    RodChannels {
        rod: RodId(field.into()),
        displacement: channel(field, Some(200.0)),
        temperature: Some(Channel { unit: Unit::Celsius, ..channel("value", None) }),
        beside: None,
    }
}

fuzz_target!(init: {
    // Schema parsers of others may panic on hostile schemas; the decoder catches that. Nothing else may.
    std::panic::set_hook(Box::new(|panic| {
        let caught = |at: &std::panic::Location<'_>| ["prost-reflect", "re_ros_msg"].iter().any(|name| at.file().contains(name));
        if !panic.location().is_some_and(caught) {
            eprintln!("{panic}");
            std::process::abort();
        }
    }));
}, |bytes: &[u8]| {
    let rods = [
        rod("value", TimeSource::Log),
        rod("data", TimeSource::Publish),
        rod("values", TimeSource::Field("start_ns".into())),
        rod("values", TimeSource::Field("start".into())),
    ];
    let cut = match bytes.last().copied().unwrap_or(0) % 3 {
        0 => Cut::File,
        1 => Cut::Window { length_s: 0.5 },
        _ => Cut::FreeDecay { ratio: 4.0, length_s: 0.5 },
    };
    let settings = RecordSettings { cut, min_duration_s: 0.1, ..Default::default() };
    let input = Cursor::new(bytes.to_vec());
    let Ok(mut recording) = Recording::new("fuzz", input, &rods, &settings, Options::default()) else {
        return;
    };
    for event in recording.by_ref() {
        match event {
            Event::Record(record) => {
                assert!(record.samples.iter().all(|x| x.is_finite()));
                assert!(record.fs_hz.is_finite() && record.fs_hz > 0.0);
                assert!(record.duration_s() >= 0.099);
            }
            Event::Rejected { rejection, .. } => assert!(!rejection.to_string().is_empty()),
            Event::Readings { readings, .. } => {
                assert!(readings.iter().all(|reading| reading.celsius.is_finite()));
            }
            Event::Moment(_) => unreachable!("every rod has one sensor"),
        }
    }
    let summary = recording.summary();
    // The reader's own net must not be what catches a panic.
    assert!(!summary.sentences().iter().any(|sentence| sentence.contains("gave up")));
});
