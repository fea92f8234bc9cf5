//! The message types recordings are written in: one sample or an even batch, as JSON, protobuf or CDR.
//!
//! | encoding | one sample | batch |
//! |---|---|---|
//! | JSON | `{"value": x}` | `{"start_ns": n, "fs_hz": f, "unit": u, "values": [...]}` |
//! | protobuf | `tirante.Sample` | `tirante.Batch`, the same fields |
//! | ROS 2 CDR | `std_msgs/msg/Float64` (`Float32`), field `data` | `tirante_msgs/msg/Batch`: `start`, `fs_hz`, `unit`, `values` |
//!
//! A sample that is not finite is a missing one: `null` in JSON, NaN in the others.

use prost_reflect::prost::Message as _;
use prost_reflect::prost::encoding;
use prost_reflect::prost_types::field_descriptor_proto::{Label, Type};
use prost_reflect::prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
};
use re_cdr::{CdrWriter, LittleEndian};
use std::io::Write as _;
use tirante_analysis::signal::record::{Timestamp, Unit};

/// Encoding of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// JSON with a JSON Schema.
    Json,
    /// Protobuf with its descriptor in the file.
    Protobuf,
    /// ROS 2 CDR, little endian, with its `.msg` definition in the file.
    Ros2,
}

impl Encoding {
    /// Field of a message that holds its sample or samples.
    pub fn samples_field(self, is_batch: bool) -> &'static str {
        match (self, is_batch) {
            (_, true) => "values",
            (Self::Ros2, false) => "data",
            (Self::Json | Self::Protobuf, false) => "value",
        }
    }

    /// Field of a message that holds its time; `None` for a single sample.
    pub fn time_field(self, is_batch: bool) -> Option<&'static str> {
        match (self, is_batch) {
            (_, false) => None,
            (Self::Ros2, true) => Some("start"),
            (Self::Json | Self::Protobuf, true) => Some("start_ns"),
        }
    }
}

/// Content of one message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// One sample.
    Sample,
    /// Up to this many evenly spaced samples.
    Batch(usize),
}

/// Floating-point precision of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit floating point.
    Single,
    /// 64-bit floating point.
    Double,
}

/// A schema as MCAP stores it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schema {
    /// Name of the schema.
    pub name: String,
    /// Encoding of the schema, by the MCAP registry.
    pub encoding: &'static str,
    /// Text or bytes of the schema.
    pub data: Vec<u8>,
}

impl Encoding {
    /// Message encoding, by the MCAP registry.
    pub fn key(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Protobuf => "protobuf",
            Self::Ros2 => "cdr",
        }
    }
}

const JSON_SAMPLE: &str =
    r#"{"type":"object","properties":{"value":{"type":["number","null"]}},"required":["value"]}"#;
const JSON_BATCH: &str = r#"{"type":"object","properties":{"start_ns":{"type":"integer","description":"time of the first sample [ns since 1970]"},"fs_hz":{"type":"number","description":"sample rate [Hz]"},"unit":{"type":"string"},"values":{"type":"array","items":{"type":["number","null"]}}},"required":["start_ns","fs_hz","unit","values"]}"#;

/// Schema of a message type.
pub fn schema(encoding: Encoding, layout: Layout, precision: Precision) -> Schema {
    let batch = matches!(layout, Layout::Batch(_));
    let (name, schema_encoding, data) = match encoding {
        Encoding::Json if batch => ("tirante.Batch", "jsonschema", JSON_BATCH.as_bytes().to_vec()),
        Encoding::Json => ("tirante.Sample", "jsonschema", JSON_SAMPLE.as_bytes().to_vec()),
        Encoding::Protobuf => {
            let name = if batch { "tirante.Batch" } else { "tirante.Sample" };
            (name, "protobuf", descriptor_set(batch, precision))
        }
        Encoding::Ros2 => {
            let float = match precision {
                Precision::Single => "float32",
                Precision::Double => "float64",
            };
            let (name, text) = match (batch, precision) {
                (true, _) => ("tirante_msgs/msg/Batch", ros2_batch(float)),
                (false, Precision::Single) => ("std_msgs/msg/Float32", format!("{float} data\n")),
                (false, Precision::Double) => ("std_msgs/msg/Float64", format!("{float} data\n")),
            };
            (name, "ros2msg", text.into_bytes())
        }
    };
    Schema {
        name: name.to_owned(),
        encoding: schema_encoding,
        data,
    }
}

fn ros2_batch(float: &str) -> String {
    format!(
        "# Evenly spaced samples of one quantity.\n\
         builtin_interfaces/Time start  # time of the first sample\n\
         float64 fs_hz                  # sample rate [Hz]\n\
         string unit\n\
         {float}[] values\n\
         ================================================================================\n\
         MSG: builtin_interfaces/Time\n\
         int32 sec\n\
         uint32 nanosec\n"
    )
}

fn descriptor_set(batch: bool, precision: Precision) -> Vec<u8> {
    let float = match precision {
        Precision::Single => Type::Float,
        Precision::Double => Type::Double,
    };
    let field = |name: &str, number: i32, kind: Type, label: Label| FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        label: Some(label as i32),
        r#type: Some(kind as i32),
        json_name: Some(name.to_owned()),
        ..Default::default()
    };
    let (name, fields) = if batch {
        let fields = vec![
            field("start_ns", 1, Type::Int64, Label::Optional),
            field("fs_hz", 2, Type::Double, Label::Optional),
            field("unit", 3, Type::String, Label::Optional),
            field("values", 4, float, Label::Repeated),
        ];
        ("Batch", fields)
    } else {
        ("Sample", vec![field("value", 1, float, Label::Optional)])
    };
    let set = FileDescriptorSet {
        file: vec![FileDescriptorProto {
            name: Some(format!("tirante/{}.proto", name.to_lowercase())),
            package: Some("tirante".to_owned()),
            syntax: Some("proto3".to_owned()),
            message_type: vec![DescriptorProto {
                name: Some(name.to_owned()),
                field: fields,
                ..Default::default()
            }],
            ..Default::default()
        }],
    };
    set.encode_to_vec()
}

/// Appends one JSON number, or `null` for a value that is not finite.
fn json_number(out: &mut Vec<u8>, value: f64, precision: Precision) {
    let text = match precision {
        Precision::Single => serde_json::to_vec(&(value as f32)),
        Precision::Double => serde_json::to_vec(&value),
    };
    // A float always serialises; serde_json writes null for what is not finite.
    out.extend_from_slice(&text.unwrap_or_else(|_| b"null".to_vec()));
}

/// Appends a message with one sample to `out`.
pub fn encode_sample(out: &mut Vec<u8>, encoding: Encoding, precision: Precision, value: f64) {
    match encoding {
        Encoding::Json => {
            out.extend_from_slice(b"{\"value\":");
            json_number(out, value, precision);
            out.push(b'}');
        }
        // A proto3 zero is written too: a reader need not know the default.
        Encoding::Protobuf => match precision {
            Precision::Single => encoding::float::encode(1, &(value as f32), out),
            Precision::Double => encoding::double::encode(1, &value, out),
        },
        Encoding::Ros2 => {
            out.extend_from_slice(&CDR_LITTLE_ENDIAN);
            let mut cdr = CdrWriter::<LittleEndian>::new(out);
            match precision {
                Precision::Single => cdr.write_f32(value as f32),
                Precision::Double => cdr.write_f64(value),
            }
        }
    }
}

const CDR_LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// Appends a message with evenly spaced samples to `out`.
pub fn encode_batch(
    out: &mut Vec<u8>,
    encoding: Encoding,
    precision: Precision,
    (start, fs_hz, unit): (Timestamp, f64, Unit),
    values: &[f64],
) {
    match encoding {
        Encoding::Json => {
            // Writing to a Vec cannot fail.
            let _ = write!(out, "{{\"start_ns\":{},\"fs_hz\":", start.as_nanos());
            json_number(out, fs_hz, Precision::Double);
            let _ = write!(out, ",\"unit\":\"{}\",\"values\":[", unit.key());
            for (i, &value) in values.iter().enumerate() {
                if i > 0 {
                    out.push(b',');
                }
                json_number(out, value, precision);
            }
            out.extend_from_slice(b"]}");
        }
        Encoding::Protobuf => {
            encoding::int64::encode(1, &start.as_nanos(), out);
            encoding::double::encode(2, &fs_hz, out);
            encoding::string::encode(3, &unit.key().to_owned(), out);
            match precision {
                Precision::Single => {
                    let values: Vec<f32> = values.iter().map(|&v| v as f32).collect();
                    encoding::float::encode_packed(4, &values, out);
                }
                Precision::Double => encoding::double::encode_packed(4, values, out),
            }
        }
        Encoding::Ros2 => {
            out.extend_from_slice(&CDR_LITTLE_ENDIAN);
            let mut cdr = CdrWriter::<LittleEndian>::new(out);
            let nanos = start.as_nanos();
            cdr.write_i32(nanos.div_euclid(1_000_000_000) as i32);
            cdr.write_u32(nanos.rem_euclid(1_000_000_000) as u32);
            cdr.write_f64(fs_hz);
            cdr.write_string(unit.key());
            cdr.write_sequence_length(values.len());
            for &value in values {
                match precision {
                    Precision::Single => cdr.write_f32(value as f32),
                    Precision::Double => cdr.write_f64(value),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost_reflect::{DescriptorPool, DynamicMessage, Value};

    #[test]
    fn protobuf_descriptors_read_their_own_messages() {
        let schema = schema(Encoding::Protobuf, Layout::Batch(4), Precision::Single);
        let pool = DescriptorPool::decode(schema.data.as_slice()).unwrap();
        let descriptor = pool.get_message_by_name(&schema.name).unwrap();
        let mut bytes = Vec::new();
        let head = (Timestamp::from_nanos(-5), 200.0, Unit::Millimetre);
        encode_batch(
            &mut bytes,
            Encoding::Protobuf,
            Precision::Single,
            head,
            &[1.5, 0.0],
        );
        let message = DynamicMessage::decode(descriptor, bytes.as_slice()).unwrap();
        assert_eq!(*message.get_field_by_name("start_ns").unwrap(), Value::I64(-5));
        assert_eq!(
            *message.get_field_by_name("values").unwrap(),
            Value::List(vec![Value::F32(1.5), Value::F32(0.0)])
        );
    }

    #[test]
    fn json_is_json_and_missing_samples_are_null() {
        let mut bytes = Vec::new();
        let head = (Timestamp::from_nanos(7), 200.0, Unit::Millimetre);
        encode_batch(
            &mut bytes,
            Encoding::Json,
            Precision::Double,
            head,
            &[0.1, f64::NAN],
        );
        let value: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
        assert_eq!(value["values"][0], 0.1);
        assert!(value["values"][1].is_null());
    }
}
