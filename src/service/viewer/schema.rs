//! Types of the results' messages, each field with its description and unit, and their schemas: JSON Schema, `.msg` of ROS 2, and
//! protobuf descriptors. One table for all, so that the encodings cannot differ.

use crate::recording::write::Encoding;
use prost_reflect::prost::Message as _;
use prost_reflect::prost_types::field_descriptor_proto::{Label, Type as Proto};
use prost_reflect::prost_types::source_code_info::Location;
use prost_reflect::prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, SourceCodeInfo,
};
use serde_json::{Map, Value as Json, json};
use std::fmt::Write;

/// A message type.
#[derive(Debug, PartialEq, Eq)]
pub struct Type {
    /// Name without its package.
    pub name: &'static str,
    /// Fields in order; a field's number in protobuf is its place, from 1.
    pub fields: &'static [Field],
}

/// One field. A missing number is NaN, a missing order 0 and a missing text empty where there is no null.
#[derive(Debug, PartialEq, Eq)]
pub struct Field {
    /// Name, with its unit as a suffix.
    pub name: &'static str,
    /// Type of its values.
    pub kind: Kind,
    /// Description with the unit.
    pub about: &'static str,
}

/// Type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Seconds and nanoseconds since 1970, UTC.
    Time,
    /// Floating-point number.
    Number,
    /// Small whole number from 0 on.
    Integer,
    /// Truth value.
    Flag,
    /// Text.
    Text,
    /// Floating-point numbers.
    Numbers,
    /// Message within the message.
    One(&'static Type),
    /// Any number of messages.
    Many(&'static Type),
}

/// File of protobuf's own type of a time.
const STAMP: &str = "google/protobuf/timestamp.proto";

const fn field(name: &'static str, kind: Kind, about: &'static str) -> Field {
    Field { name, kind, about }
}

use Kind::{Flag, Integer, Many, Number, Numbers, One, Text, Time};

const TIMESTAMP: Field = field("timestamp", Time, "time of the record's first sample, UTC");
const REJECTED: Field = field(
    "rejection",
    Text,
    "reason why the record was refused; empty if it was not",
);

static INTERVAL: Type = Type {
    name: "Interval",
    fields: &[
        field("mean", Number, "mean, in the unit of the field"),
        field("sd", Number, "standard deviation, in the unit of the field"),
        field("q025", Number, "2.5 % quantile, in the unit of the field"),
        field("q975", Number, "97.5 % quantile, in the unit of the field"),
    ],
};

static REJECTION: Type = Type {
    name: "Rejection",
    fields: &[
        field(
            "code",
            Text,
            "short name of the reason; empty if the record was not refused",
        ),
        field("message", Text, "reason in one sentence"),
    ],
};

static EXCITATION: Type = Type {
    name: "Excitation",
    fields: &[
        field(
            "kind",
            Text,
            "recognised motion: ambient, free-decay, free-decays, blow",
        ),
        field(
            "onsets_s",
            Numbers,
            "onsets of decays and blows, from the record's first sample [s]",
        ),
    ],
};

static QUANTILES: Type = Type {
    name: "Quantiles",
    fields: &[
        field("q025", Number, "2.5 % quantile [N]"),
        field("q50", Number, "median [N]"),
        field("q975", Number, "97.5 % quantile [N]"),
    ],
};

static ASSIGNED: Type = Type {
    name: "Assigned",
    fields: &[
        field("order", Integer, "mode order, from 1"),
        field("frequency_hz", Number, "frequency of the peak [Hz]"),
    ],
};

static CANDIDATE: Type = Type {
    name: "Candidate",
    fields: &[
        field("modes", Many(&ASSIGNED), "peaks taken for modes"),
        field(
            "probability",
            Number,
            "probability of this assignment, 0 to 1 [-]",
        ),
        field("axial_force_n", One(&QUANTILES), "force it gives [N]"),
    ],
};

static MODE: Type = Type {
    name: "Mode",
    fields: &[
        field("order", Integer, "mode order, from 1"),
        field("frequency_hz", Number, "natural frequency [Hz]"),
        field("sd_hz", Number, "standard error of the frequency [Hz]"),
        field("damping", Number, "damping ratio [-]"),
        field(
            "misfit",
            Number,
            "standard normal score of the fit of its peak [-]",
        ),
    ],
};

static PEAK: Type = Type {
    name: "Peak",
    fields: &[
        field("frequency_hz", Number, "frequency [Hz]"),
        field(
            "order",
            Integer,
            "mode order, from 1; missing if it is no mode of the rod",
        ),
        field("line", Flag, "true for a pure sine: interference"),
        field("sd_hz", Number, "standard error of the frequency [Hz]"),
        field("damping", Number, "damping ratio [-]"),
        field("damping_sd", Number, "standard error of the damping ratio [-]"),
        field("level_db", Number, "height over the noise floor [dB]"),
        field(
            "taken_for",
            Text,
            "nature of the peak: mode, candidate, tone, ...",
        ),
    ],
};

/// `tirante.Force`.
pub static FORCE: Type = Type {
    name: "Force",
    fields: &[
        TIMESTAMP,
        field(
            "axial_force_n",
            One(&INTERVAL),
            "axial force of this record alone, at its own temperature [N]",
        ),
        field(
            "tracked_force_n",
            One(&INTERVAL),
            "axial force given the baseline, at the record's temperature [N]",
        ),
        field(
            "force_at_reference_n",
            One(&INTERVAL),
            "axial force given the baseline, at the reference temperature [N]",
        ),
        field(
            "relative_force",
            One(&INTERVAL),
            "force over that of the baseline, at the record's temperature [-]",
        ),
        field(
            "relative_force_at_reference",
            One(&INTERVAL),
            "force over that of the baseline, at the reference temperature [-]",
        ),
        field("temperature_c", Number, "temperature [degC]"),
        field(
            "state",
            Text,
            "state of the rod: learning, monitoring, alarm, not-monitoring",
        ),
        field(
            "set_aside",
            Text,
            "reason why the record does not count; empty if it does",
        ),
        field(
            "rejection",
            One(&REJECTION),
            "reason why the record was refused, if it was",
        ),
        field("excitation", One(&EXCITATION), "recognised motion"),
        field(
            "label_probability",
            Number,
            "probability that all mode orders are right, 0 to 1 [-]",
        ),
        field(
            "candidates",
            Many(&CANDIDATE),
            "other assignments of the peaks, if the orders are not certain",
        ),
        field(
            "conflict",
            Number,
            "disagreement of model and data, in standard deviations; from 3 on the force may be wrong [-]",
        ),
        field(
            "prior_tail",
            Number,
            "share of the prior's own records at least as far out; up to 0.01 the prior may be wrong [-]",
        ),
    ],
};

/// `tirante.Modes`.
pub static MODES: Type = Type {
    name: "Modes",
    fields: &[
        TIMESTAMP,
        field("modes", Many(&MODE), "measured modes, ascending in order"),
    ],
};

/// `tirante.Waveform`.
pub static WAVEFORM: Type = Type {
    name: "Waveform",
    fields: &[
        TIMESTAMP,
        field("duration_s", Number, "length of the record [s]"),
        field("fs_hz", Number, "sample rate of the record [Hz]"),
        field("unit", Text, "SI unit of low and high"),
        REJECTED,
        field(
            "time_s",
            Numbers,
            "middle of each stretch, from the record's first sample [s]",
        ),
        field(
            "low",
            Numbers,
            "lowest sample of each stretch about the mean, in `unit`",
        ),
        field(
            "high",
            Numbers,
            "highest sample of each stretch about the mean, in `unit`",
        ),
    ],
};

/// `tirante.Spectrum`.
pub static SPECTRUM: Type = Type {
    name: "Spectrum",
    fields: &[
        TIMESTAMP,
        field("unit", Text, "unit of level_db"),
        REJECTED,
        field("frequency_hz", Numbers, "frequency of each value [Hz]"),
        field(
            "level_db",
            Numbers,
            "power spectral density at each frequency, in `unit` [dB]",
        ),
        field("peaks", Many(&PEAK), "peaks, with what each was taken for"),
    ],
};

static HEADER: Type = Type {
    name: "Header",
    fields: &[
        field("stamp", Time, "time of the sample, UTC"),
        field("frame_id", Text, "id of the rod"),
    ],
};

/// `tirante.Signal`: one sample.
pub static SIGNAL: Type = Type {
    name: "Signal",
    fields: &[
        field("timestamp", Time, "time of the sample, UTC"),
        field("header", One(&HEADER), "the same time, where plots look for it"),
        field(
            "value",
            Number,
            "displacement, velocity or acceleration, in `unit`",
        ),
        field("unit", Text, "SI unit of value"),
    ],
};

/// `foxglove.Log`, which viewers know.
pub static LOG: Type = Type {
    name: "Log",
    fields: &[
        field("timestamp", Time, "time at which the alarm was raised, UTC"),
        field("level", Integer, "3 while the alarm needs attention, else 2"),
        field(
            "message",
            Text,
            "kind of the alarm, what it says, and who acknowledged it",
        ),
        field("name", Text, "id of the rod"),
        field("file", Text, "id of the alarm"),
        field("line", Integer, "always 0"),
    ],
};

/// Schema of a type in a package, by the names and encodings of the MCAP registry: name, encoding, content.
pub fn schema(of: &'static Type, package: &str, encoding: Encoding) -> (String, &'static str, Vec<u8>) {
    let name = format!("{package}.{}", of.name);
    match encoding {
        Encoding::Json => {
            let mut schema = json_schema(of);
            schema["title"] = name.clone().into();
            (name, "jsonschema", schema.to_string().into_bytes())
        }
        Encoding::Ros2 => {
            let package = format!("{package}_msgs");
            (
                format!("{package}/msg/{}", of.name),
                "ros2msg",
                definitions(of, &package).into_bytes(),
            )
        }
        Encoding::Protobuf => (name, "protobuf", descriptors(of, package)),
    }
}

/// The type and all types within it, each once, the type first.
fn all(of: &'static Type) -> Vec<&'static Type> {
    let mut found = vec![of];
    let mut next = 0;
    while let Some(one) = found.get(next).copied() {
        for field in one.fields {
            if let One(inner) | Many(inner) = field.kind
                && !found.contains(&inner)
            {
                found.push(inner);
            }
        }
        next += 1;
    }
    found
}

fn json_schema(of: &Type) -> Json {
    let mut properties = Map::new();
    for field in of.fields {
        let mut schema = match field.kind {
            Time => {
                json!({"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}})
            }
            Number => json!({"type": ["number", "null"]}),
            Integer => json!({"type": ["integer", "null"]}),
            Flag => json!({"type": "boolean"}),
            Text => json!({"type": ["string", "null"]}),
            Numbers => json!({"type": "array", "items": {"type": "number"}}),
            One(inner) => {
                let mut schema = json_schema(inner);
                schema["type"] = json!(["object", "null"]);
                schema
            }
            Many(inner) => json!({"type": ["array", "null"], "items": json_schema(inner)}),
        };
        schema["description"] = field.about.into();
        properties.insert(field.name.to_owned(), schema);
    }
    json!({"type": "object", "properties": properties})
}

/// Definition of a type in the form of `.msg`, with those of the types in it.
fn definitions(of: &'static Type, package: &str) -> String {
    let mut text = String::new();
    for (number, one) in all(of).into_iter().enumerate() {
        if number > 0 {
            // Writing to a string cannot fail.
            let _ = write!(text, "{:=<80}\nMSG: {package}/{}\n", "", one.name);
        }
        for field in one.fields {
            let kind = match field.kind {
                Time => "builtin_interfaces/Time".to_owned(),
                Number => "float64".to_owned(),
                Integer => "uint32".to_owned(),
                Flag => "bool".to_owned(),
                Text => "string".to_owned(),
                Numbers => "float64[]".to_owned(),
                One(inner) => format!("{package}/{}", inner.name),
                Many(inner) => format!("{package}/{}[]", inner.name),
            };
            let _ = writeln!(text, "{kind} {}  # {}", field.name, field.about);
        }
    }
    text + &format!(
        "{:=<80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
        ""
    )
}

/// Descriptors of a type and of those in it, with the descriptions as comments.
fn descriptors(of: &'static Type, package: &str) -> Vec<u8> {
    let proto = |name: &str, number: i32, kind: Proto| FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        label: Some(Label::Optional as i32),
        r#type: Some(kind as i32),
        json_name: Some(name.to_owned()),
        ..Default::default()
    };
    let (mut messages, mut comments) = (Vec::new(), Vec::new());
    for (place, one) in (0..).zip(all(of)) {
        let mut fields = Vec::new();
        for (number, field) in (0..).zip(one.fields) {
            let (kind, inner, is_many) = match field.kind {
                Time => (
                    Proto::Message,
                    Some(".google.protobuf.Timestamp".to_owned()),
                    false,
                ),
                Number => (Proto::Double, None, false),
                Integer => (Proto::Uint32, None, false),
                Flag => (Proto::Bool, None, false),
                Text => (Proto::String, None, false),
                Numbers => (Proto::Double, None, true),
                One(inner) => (Proto::Message, Some(format!(".{package}.{}", inner.name)), false),
                Many(inner) => (Proto::Message, Some(format!(".{package}.{}", inner.name)), true),
            };
            let mut descriptor = proto(field.name, number + 1, kind);
            descriptor.type_name = inner;
            if is_many {
                descriptor.label = Some(Label::Repeated as i32);
            }
            fields.push(descriptor);
            // Message `place` (4) of the file, field `number` (2) of it.
            comments.push(Location {
                path: vec![4, place, 2, number],
                span: vec![0, 0, 0],
                leading_comments: Some(format!(" {}\n", field.about)),
                ..Default::default()
            });
        }
        messages.push(DescriptorProto {
            name: Some(one.name.to_owned()),
            field: fields,
            ..Default::default()
        });
    }
    let file = |name: &str, package: &str, messages: Vec<DescriptorProto>| FileDescriptorProto {
        name: Some(name.to_owned()),
        package: Some(package.to_owned()),
        syntax: Some("proto3".to_owned()),
        message_type: messages,
        ..Default::default()
    };
    let stamp = DescriptorProto {
        name: Some("Timestamp".to_owned()),
        field: vec![proto("seconds", 1, Proto::Int64), proto("nanos", 2, Proto::Int32)],
        ..Default::default()
    };
    let own = FileDescriptorProto {
        dependency: vec![STAMP.to_owned()],
        source_code_info: Some(SourceCodeInfo { location: comments }),
        ..file(&format!("{package}/{}.proto", of.name), package, messages)
    };
    let set = FileDescriptorSet {
        file: vec![file(STAMP, "google.protobuf", vec![stamp]), own],
    };
    set.encode_to_vec()
}
