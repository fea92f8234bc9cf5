//! Reads one field of a protobuf message by walking its wire format along a path.
//!
//! The descriptor in the file turns names into field numbers once; a message is then walked without
//! being built. Semantics are proto3's: the last value of a singular field counts, a field without
//! presence that is absent is its default, packed and unpacked lists are the same.

mod wire;

use super::decode::{DecodeError, Decoded, PIECE, SchemaRef, Time};
use super::path::{FieldPath, Step};
use super::stamp;
use prost_reflect::prost::Message as _;
use prost_reflect::prost::encoding::{DecodeContext, WireType, decode_key, skip_field};
use prost_reflect::prost_types::{FileDescriptorProto, FileDescriptorSet};
use prost_reflect::{DescriptorPool, FieldDescriptor, Kind, MessageDescriptor, Value};
use wire::{Number, broken, bytes, malformed, scalar};

/// Paths of the value and its time.
#[derive(Debug)]
pub struct ProtobufPlan {
    value: Target,
    time: Option<TimePlan>,
}

/// Path to one numeric or text field.
#[derive(Debug)]
struct Target {
    path: String,
    /// Field number of each message on the way down, with the index in lists.
    parents: Vec<(u32, Option<usize>)>,
    number: u32,
    kind: Kind,
    shape: Shape,
    /// Value of an absent field without presence.
    default: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shape {
    Single,
    List,
    Element(usize),
}

#[derive(Debug)]
enum TimePlan {
    Nanos(Target),
    Seconds(Target),
    Text(Target),
    Parts(Target, Target),
}

/// Callback for each occurrence of a field: its wire type and the buffer at its place.
type Visit<'a> = dyn FnMut(WireType, &mut &[u8]) -> Result<(), DecodeError> + 'a;

impl ProtobufPlan {
    /// Compiles the paths against the descriptor in the file.
    pub fn compile(
        schema: SchemaRef<'_>,
        value: &FieldPath,
        time: Option<&FieldPath>,
    ) -> Result<Self, DecodeError> {
        let broken = |what: String| DecodeError::Schema(format!("schema `{}`: {what}", schema.name));
        let set = FileDescriptorSet::decode(schema.data).map_err(|fault| broken(fault.to_string()))?;
        // The library panics on any other.
        let known = |file: &FileDescriptorProto| matches!(file.syntax(), "" | "proto2" | "proto3");
        if let Some(file) = set.file.iter().find(|file| !known(file)) {
            return Err(broken(format!(
                "syntax `{}` is not read; proto2 and proto3 are",
                file.syntax()
            )));
        }
        let pool =
            DescriptorPool::from_file_descriptor_set(set).map_err(|fault| broken(fault.to_string()))?;
        let root = pool
            .get_message_by_name(schema.name)
            .ok_or_else(|| broken("its descriptor does not describe it".to_owned()))?;
        let target = Target::compile(&root, value)?;
        if let Some(found) = not_a_number(&target.kind) {
            return Err(DecodeError::Type {
                path: value.to_string(),
                found,
            });
        }
        Ok(Self {
            value: target,
            time: time.map(|path| TimePlan::compile(&root, path)).transpose()?,
        })
    }

    /// Appends a piece of the samples in `message` to `out`, which is empty.
    pub fn decode(&self, message: &[u8], from: usize, out: &mut Vec<f64>) -> Result<Decoded, DecodeError> {
        let time = match &self.time {
            None => Time::Outside,
            Some(plan) => Time::Nanos(plan.decode(message)?),
        };
        let target = &self.value;
        let array = target.shape == Shape::List;
        let wanted = from..from.saturating_add(PIECE);
        let mut samples = 0;
        let mut take = |number: Number| {
            if wanted.contains(&samples) {
                out.push(number.float());
            }
            samples += 1;
        };
        if array {
            target.walk(message, &mut take)?;
        } else {
            take(target.single(message)?);
        }
        Ok(Decoded { array, samples, time })
    }
}

fn not_a_number(kind: &Kind) -> Option<&'static str> {
    match kind {
        Kind::Message(_) => Some("a message"),
        Kind::Enum(_) => Some("an enumeration"),
        Kind::String => Some("text"),
        Kind::Bytes => Some("bytes"),
        Kind::Bool => Some("true or false"),
        _ => None,
    }
}

impl TimePlan {
    fn compile(root: &MessageDescriptor, path: &FieldPath) -> Result<Self, DecodeError> {
        let target = Target::compile(root, path)?;
        let wrong = || DecodeError::Time {
            path: path.to_string(),
        };
        if target.shape == Shape::List {
            return Err(wrong());
        }
        match &target.kind {
            Kind::Float | Kind::Double => Ok(Self::Seconds(target)),
            Kind::String => Ok(Self::Text(target)),
            Kind::Message(message) => {
                let part = |names: &[&str]| {
                    let field = names.iter().find_map(|name| message.get_field_by_name(name));
                    field.map(|field| target.child(&field)).ok_or_else(wrong)
                };
                let seconds = part(&["seconds", "sec", "secs"])?;
                let nanos = part(&["nanos", "nanosec", "nsec"])?;
                Ok(Self::Parts(seconds, nanos))
            }
            kind if not_a_number(kind).is_none() => Ok(Self::Nanos(target)),
            _ => Err(wrong()),
        }
    }

    fn decode(&self, message: &[u8]) -> Result<i64, DecodeError> {
        let (time, path) = match self {
            Self::Nanos(target) => (target.single(message)?.integer(), &target.path),
            Self::Seconds(target) => (stamp::from_seconds(target.single(message)?.float()), &target.path),
            Self::Text(target) => {
                let mut time = None;
                target.find(message, 0, &mut |wire, buffer| {
                    let text = bytes(wire, buffer)?;
                    time = std::str::from_utf8(text).ok().and_then(stamp::from_text);
                    Ok(())
                })?;
                (time, &target.path)
            }
            Self::Parts(seconds, nanos) => {
                let seconds_found = seconds.single(message)?.integer();
                let nanos = nanos.single(message)?.integer();
                let time = seconds_found
                    .zip(nanos)
                    .and_then(|(seconds, nanos)| stamp::from_parts(seconds, nanos));
                (time, &seconds.path)
            }
        };
        time.ok_or_else(|| DecodeError::Time { path: path.clone() })
    }
}

impl Target {
    fn compile(root: &MessageDescriptor, path: &FieldPath) -> Result<Self, DecodeError> {
        let mut message = root.clone();
        let mut parents = Vec::new();
        let mut steps = path.steps();
        loop {
            let missing = || {
                let has = message.fields().map(|field| field.name().to_owned()).collect();
                DecodeError::missing(path, has)
            };
            let [Step::Field(name), rest @ ..] = steps else {
                return Err(missing());
            };
            let field = message.get_field_by_name(name).ok_or_else(missing)?;
            if field.is_map() || field.is_group() {
                return Err(DecodeError::Type {
                    path: path.to_string(),
                    found: "a map or a group",
                });
            }
            let (index, rest) = match rest {
                [Step::Index(index), rest @ ..] if field.is_list() => (Some(*index), rest),
                _ => (None, rest),
            };
            if rest.is_empty() {
                let shape = match index {
                    Some(index) => Shape::Element(index),
                    None if field.is_list() => Shape::List,
                    None => Shape::Single,
                };
                return Ok(Self::leaf(path.to_string(), parents, &field, shape));
            }
            match field.kind() {
                Kind::Message(next) if field.is_list() == index.is_some() => {
                    parents.push((field.number(), index));
                    message = next;
                    steps = rest;
                }
                Kind::Message(_) => {
                    return Err(DecodeError::missing(
                        path,
                        vec!["a list: write an index".to_owned()],
                    ));
                }
                _ => return Err(DecodeError::missing(path, vec!["no fields".to_owned()])),
            }
        }
    }

    fn leaf(path: String, parents: Vec<(u32, Option<usize>)>, field: &FieldDescriptor, shape: Shape) -> Self {
        let default = match field.default_value() {
            _ if field.supports_presence() || shape != Shape::Single => None,
            Value::F64(value) => Some(value),
            Value::F32(value) => Some(f64::from(value)),
            _ => Some(0.0),
        };
        Self {
            path,
            parents,
            number: field.number(),
            kind: field.kind(),
            shape,
            default,
        }
    }

    /// Target of a field within this one's message.
    fn child(&self, field: &FieldDescriptor) -> Self {
        let mut parents = self.parents.clone();
        let index = match self.shape {
            Shape::Element(index) => Some(index),
            _ => None,
        };
        parents.push((self.number, index));
        Self::leaf(self.path.clone(), parents, field, Shape::Single)
    }

    /// Single number of this target.
    fn single(&self, message: &[u8]) -> Result<Number, DecodeError> {
        let mut last = None;
        let mut count = 0usize;
        let wanted = match self.shape {
            Shape::Element(index) => Some(index),
            _ => None,
        };
        let found = self.walk(message, &mut |number| {
            if wanted.is_none_or(|index| index == count) {
                last = Some(number);
            }
            count += 1;
        })?;
        match (last, self.default) {
            (Some(number), _) => Ok(number),
            (None, Some(default)) if found => Ok(match self.kind {
                Kind::Float | Kind::Double => Number::Float(default),
                _ => Number::Integer(0),
            }),
            _ => Err(DecodeError::Missing {
                path: self.path.clone(),
                has: match wanted {
                    Some(_) => format!("{count} items"),
                    None => "nothing: it is not set in the message".to_owned(),
                },
            }),
        }
    }

    /// Calls `each` with every number at this target, in order; returns true if its parent message
    /// is present.
    fn walk(&self, message: &[u8], each: &mut impl FnMut(Number)) -> Result<bool, DecodeError> {
        let list = self.shape != Shape::Single;
        self.find(message, 0, &mut |wire, buffer| {
            if wire == WireType::LengthDelimited && list {
                let mut packed = bytes(wire, buffer)?;
                while !packed.is_empty() {
                    each(scalar(&self.kind, &mut packed)?);
                }
                return Ok(());
            }
            if wire != self.kind.wire_type() {
                return Err(malformed("a field has the wrong wire type"));
            }
            each(scalar(&self.kind, buffer)?);
            Ok(())
        })
    }

    /// Walks down to the field and calls back with each of its occurrences; returns true if the
    /// parent is present.
    fn find(&self, mut buffer: &[u8], depth: usize, each: &mut Visit<'_>) -> Result<bool, DecodeError> {
        let (number, index) = match self.parents.get(depth) {
            Some(&(number, index)) => (number, index),
            None => (self.number, None),
        };
        let leaf = depth == self.parents.len();
        let mut reached = leaf;
        let mut count = 0usize;
        while !buffer.is_empty() {
            let (tag, wire) = decode_key(&mut buffer).map_err(broken)?;
            if tag != number {
                skip_field(wire, tag, &mut buffer, DecodeContext::default()).map_err(broken)?;
            } else if leaf {
                each(wire, &mut buffer)?;
            } else {
                let inner = bytes(wire, &mut buffer)?;
                if index.is_none_or(|index| index == count) {
                    reached |= self.find(inner, depth + 1, each)?;
                }
                count += 1;
            }
        }
        Ok(reached)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write::{Encoding, Layout, Precision, message};
    use prost_reflect::DynamicMessage;

    const PROTO: &str = r#"
        syntax = "proto3";
        package t;
        message Stamp { int64 seconds = 1; int32 nanos = 2; }
        message Point { double x = 1; optional float y = 2; sint32 z = 3; }
        message Top {
            Stamp stamp = 1;
            repeated Point points = 2;
            repeated int32 packed = 3;
            repeated fixed32 loose = 4 [packed = false];
            string text = 5;
            Point point = 6;
            map<string, double> map = 7;
            uint64 big = 8;
        }"#;

    fn schema() -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("t.proto"), PROTO).unwrap();
        protox::compile(["t.proto"], [folder.path()])
            .unwrap()
            .encode_to_vec()
    }

    fn plan(data: &[u8], value: &str, time: Option<&str>) -> Result<ProtobufPlan, DecodeError> {
        let schema = SchemaRef {
            name: "t.Top",
            encoding: "protobuf",
            data,
        };
        let time = time.map(|path| FieldPath::parse(path).unwrap());
        ProtobufPlan::compile(schema, &FieldPath::parse(value).unwrap(), time.as_ref())
    }

    #[test]
    fn reads_what_the_library_writes() {
        let data = schema();
        let descriptor = DescriptorPool::decode(data.as_slice())
            .unwrap()
            .get_message_by_name("t.Top")
            .unwrap();
        let json = r#"{"stamp":{"seconds":"3","nanos":5},"points":[{"x":1.5},{"y":2.5,"z":-7}],"packed":[1,-2,3],
                       "loose":[4,5],"text":"2026-03-01T06:00:00Z","map":{"a":1},"big":"18446744073709551615"}"#;
        let value: serde_json::Value = serde_json::from_str(json).unwrap();
        let mut message = DynamicMessage::new(descriptor.clone());
        let point = descriptor.get_field_by_name("points").unwrap().kind();
        let Kind::Message(point) = point else {
            unreachable!()
        };
        let mut points = vec![DynamicMessage::new(point.clone()), DynamicMessage::new(point)];
        points[0].set_field_by_name("x", Value::F64(1.5));
        points[1].set_field_by_name("y", Value::F32(2.5));
        points[1].set_field_by_name("z", Value::I32(-7));
        message.set_field_by_name(
            "points",
            Value::List(points.into_iter().map(Value::Message).collect()),
        );
        let Kind::Message(stamp) = descriptor.get_field_by_name("stamp").unwrap().kind() else {
            unreachable!()
        };
        let mut stamp = DynamicMessage::new(stamp);
        stamp.set_field_by_name("seconds", Value::I64(3));
        stamp.set_field_by_name("nanos", Value::I32(5));
        message.set_field_by_name("stamp", Value::Message(stamp));
        message.set_field_by_name("packed", Value::List([1, -2, 3].map(Value::I32).into()));
        message.set_field_by_name("loose", Value::List([4, 5].map(Value::U32).into()));
        message.set_field_by_name("text", Value::String(value["text"].as_str().unwrap().into()));
        message.set_field_by_name("big", Value::U64(u64::MAX));
        let bytes = message.encode_to_vec();
        for (path, expected) in [
            ("points[0].x", vec![1.5]),
            // Absent without presence is the default.
            ("points[1].x", vec![0.0]),
            ("points[1].y", vec![2.5]),
            ("points[1].z", vec![-7.0]),
            ("packed", vec![1.0, -2.0, 3.0]),
            ("packed[1]", vec![-2.0]),
            ("loose", vec![4.0, 5.0]),
            ("big", vec![u64::MAX as f64]),
        ] {
            for (time, expected_time) in [("stamp", 3_000_000_005), ("text", 1_772_344_800_000_000_000)] {
                let mut out = Vec::new();
                let decoded = plan(&data, path, Some(time))
                    .unwrap()
                    .decode(&bytes, 0, &mut out)
                    .unwrap();
                assert_eq!(
                    (out, decoded.time),
                    (expected.clone(), Time::Nanos(expected_time)),
                    "{path}"
                );
            }
        }
        // Absent with presence, out of range, in an absent message.
        for path in ["points[0].y", "points[2].x", "point.x", "packed[3]"] {
            let told = plan(&data, path, None)
                .unwrap()
                .decode(&bytes, 0, &mut Vec::new())
                .unwrap_err();
            assert!(matches!(told, DecodeError::Missing { .. }), "{path}: {told}");
        }
        for cut in 1..bytes.len() {
            // Either at a field boundary or an error; never a panic.
            let _ = plan(&data, "packed", Some("stamp"))
                .unwrap()
                .decode(&bytes[..cut], 0, &mut Vec::new());
        }
    }

    #[test]
    fn paths_are_checked_against_the_descriptor() {
        let data = schema();
        let told = |path| plan(&data, path, None).unwrap_err().to_string();
        assert!(told("z").starts_with("no field `z`; there is: stamp, points, packed"));
        assert!(told("points.x").contains("write an index"));
        assert!(told("text").contains("is text"));
        assert!(told("map.a").contains("a map"));
        assert!(told("point").contains("a message"));
        assert!(plan(&data, "big", Some("points")).is_err());
        assert!(plan(b"junk", "z", None).is_err());
    }

    #[test]
    fn an_unknown_syntax_is_refused() {
        let mut schema = message::schema(Encoding::Protobuf, Layout::Sample, Precision::Double);
        let at = schema.data.windows(6).position(|w| w == b"proto3").unwrap();
        schema.data[at + 5] = b'6';
        let schema = SchemaRef {
            name: &schema.name,
            encoding: schema.encoding,
            data: &schema.data,
        };
        let told = ProtobufPlan::compile(schema, &FieldPath::parse("value").unwrap(), None).unwrap_err();
        assert!(told.to_string().contains("`proto6`"), "{told}");
    }
}
