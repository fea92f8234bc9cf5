//! Fields of a message definition.

use super::decode::{DecodeError, Decoded, Decoder, SchemaRef, Time};
use tirante_analysis::signal::record::TimeSource;

/// Field of the time stamp of robots' messages (`std_msgs/Header`).
const STAMP: &str = "header.stamp";
/// Field name that no message has: the error for it lists the existing names.
const NOBODY: &str = "no_such_field_here";
/// Largest number of fields offered.
const MOST: usize = 24;
/// Number of levels of nested messages that are searched.
const DEPTH: usize = 3;
/// Greatest distance of a message's own time from its log time \[ns\]: a day.
const NEAR_NS: u64 = 86_400_000_000_000;

/// A channel's encoding and schema.
#[derive(Debug, Default)]
pub(super) struct Definition {
    encoding: String,
    schema: Option<(String, String, Vec<u8>)>,
}

impl Definition {
    /// Definition of a channel.
    pub(super) fn of(encoding: &str, schema: Option<SchemaRef<'_>>) -> Self {
        Self {
            encoding: encoding.to_owned(),
            schema: schema.map(|schema| schema.owned()),
        }
    }

    /// Reads one field of a message.
    fn read(&self, field: &str, time: &TimeSource, message: &[u8]) -> Result<Decoded, DecodeError> {
        let schema = self
            .schema
            .as_ref()
            .map(|(name, encoding, data)| SchemaRef { name, encoding, data });
        Decoder::compile(&self.encoding, schema, field, time)?.decode(message, 0, &mut Vec::new())
    }

    /// Paths of the fields of a message that are numbers or arrays of numbers, except those of its header.
    pub(super) fn numbers(&self, message: &[u8]) -> Vec<String> {
        let mut found = Vec::new();
        let mut prefixes = vec![(String::new(), 0)];
        while let Some((prefix, depth)) = prefixes.pop() {
            let nobody = self.read(&format!("{prefix}{NOBODY}"), &TimeSource::Log, message);
            let Err(DecodeError::Missing { has, .. }) = nobody else {
                continue;
            };
            for name in has
                .split(", ")
                .filter(|name| !matches!(*name, "header" | "stamp"))
            {
                let path = format!("{prefix}{name}");
                match self.read(&path, &TimeSource::Log, message) {
                    Ok(_) if found.len() < MOST => found.push(path),
                    Err(_) if depth + 1 < DEPTH => prefixes.push((format!("{path}."), depth + 1)),
                    _ => {}
                }
            }
        }
        found.sort();
        found
    }

    /// Field of a message's own time, if it has one and it is near the log time \[ns\]: a clock that counts from boot is none.
    pub(super) fn stamp(&self, field: &str, message: &[u8], log_time: u64) -> Option<String> {
        let source = TimeSource::Field(STAMP.to_owned());
        match self.read(field, &source, message) {
            Ok(Decoded {
                time: Time::Nanos(nanos),
                ..
            }) if nanos.abs_diff(i64::try_from(log_time).unwrap_or(i64::MAX)) < NEAR_NS => {
                Some(STAMP.to_owned())
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOGGED: u64 = 1_772_344_801_000_000_000;

    #[test]
    fn a_message_tells_its_numbers_and_its_stamp() {
        let point = br#"{"header":{"stamp":{"sec":1772344800,"nanosec":5},"frame_id":"laser"},"point":{"x":1.5,"y":0,"z":-2e-3},"ok":"yes"}"#;
        let json = Definition::of("json", None);
        assert_eq!(json.numbers(point), ["point.x", "point.y", "point.z"]);
        assert_eq!(json.stamp("point.z", point, LOGGED).as_deref(), Some(STAMP));
        // A stamp that nobody set, and none at all.
        let unset = br#"{"header":{"stamp":{"sec":0,"nanosec":0}},"value":1}"#;
        assert_eq!(json.stamp("value", unset, LOGGED), None);
        assert_eq!(json.stamp("value", br#"{"value":1}"#, LOGGED), None);
        // A clock that counts from boot.
        let booted = br#"{"header":{"stamp":{"sec":35,"nanosec":0}},"value":1}"#;
        assert_eq!(json.stamp("value", booted, LOGGED), None);
        let ros = Definition::of(
            "cdr",
            Some(SchemaRef {
                name: "geometry_msgs/msg/PointStamped",
                encoding: "ros2msg",
                data: b"std_msgs/Header header\ngeometry_msgs/Point point\n\
                    ================================================================================\n\
                    MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
                    ================================================================================\n\
                    MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n\
                    ================================================================================\n\
                    MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n",
            }),
        );
        let mut message = vec![0, 1, 0, 0];
        message.extend(1_772_344_800_i32.to_le_bytes());
        message.extend(5_u32.to_le_bytes());
        message.extend(4_u32.to_le_bytes());
        message.extend(b"rod\0");
        for value in [1.5_f64, 0.0, -2e-3] {
            message.extend(value.to_le_bytes());
        }
        assert_eq!(ros.numbers(&message), ["point.x", "point.y", "point.z"]);
        assert_eq!(ros.stamp("point.z", &message, LOGGED).as_deref(), Some(STAMP));
    }
}
