//! Reads one field of a ROS 2 message (CDR) by walking its layout.
//!
//! The `.msg` definition in the file is flattened once into the few operations that walk a message;
//! the field and its time are picked up on the way. The whole message is walked, so one that is cut
//! short gives an error even if the field itself is there.

mod compile;
mod walk;

use super::decode::{DecodeError, Decoded, SchemaRef, Time};
use super::path::FieldPath;
use super::stamp;
use re_cdr::{BigEndian, CdrReader, LittleEndian};
use re_ros_msg::message_spec::BuiltInType;
use walk::{Taken, malformed, walk};

/// Operations to walk a message.
#[derive(Debug)]
pub struct CdrPlan {
    ops: Vec<Op>,
    value: String,
    time: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Primitive {
    Bool,
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// Use of a number or a text met on the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Use {
    Value,
    /// Time: nanoseconds if an integer, seconds if a float.
    Stamp,
    Seconds,
    Nanos,
}

#[derive(Debug, Clone)]
enum Op {
    Skip(Primitive),
    Take(Primitive, Use),
    /// An array of numbers; `None`: its length is in the message.
    SkipArray(Primitive, Option<usize>),
    TakeArray(Primitive, Option<usize>),
    TakeElement(Primitive, Option<usize>, usize, Use),
    Text,
    TakeText,
    /// An array of texts or messages, with other operations for the elements on a path.
    Repeat {
        count: Option<usize>,
        each: Vec<Op>,
        special: Vec<(usize, Vec<Op>)>,
    },
}

impl Primitive {
    fn size(self) -> usize {
        match self {
            Self::Bool | Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    fn of(kind: &BuiltInType) -> Option<Self> {
        Some(match kind {
            BuiltInType::Bool => Self::Bool,
            BuiltInType::Int8 => Self::I8,
            BuiltInType::Byte | BuiltInType::Char | BuiltInType::UInt8 => Self::U8,
            BuiltInType::Int16 => Self::I16,
            BuiltInType::UInt16 => Self::U16,
            BuiltInType::Int32 => Self::I32,
            BuiltInType::UInt32 => Self::U32,
            BuiltInType::Int64 => Self::I64,
            BuiltInType::UInt64 => Self::U64,
            BuiltInType::Float32 => Self::F32,
            BuiltInType::Float64 => Self::F64,
            BuiltInType::String(_) | BuiltInType::WString(_) => return None,
        })
    }
}

impl CdrPlan {
    /// Compiles the paths against the message definition in the file.
    pub fn compile(
        schema: SchemaRef<'_>,
        value: &FieldPath,
        time: Option<&FieldPath>,
    ) -> Result<Self, DecodeError> {
        Ok(Self {
            ops: compile::compile(schema, value, time)?,
            value: value.to_string(),
            time: time.map(FieldPath::to_string),
        })
    }

    /// Approximate size in memory \[bytes\].
    pub(super) fn bytes(&self) -> usize {
        fn of(ops: &[Op]) -> usize {
            let inner = |op: &Op| match op {
                Op::Repeat { each, special, .. } => {
                    of(each) + special.iter().map(|(_, ops)| of(ops)).sum::<usize>()
                }
                _ => 0,
            };
            size_of_val(ops) + ops.iter().map(inner).sum::<usize>()
        }
        of(&self.ops)
    }

    /// Appends a piece of the samples in `message` to `out`, which is empty.
    pub fn decode(&self, message: &[u8], from: usize, out: &mut Vec<f64>) -> Result<Decoded, DecodeError> {
        let (header, body) = message
            .split_first_chunk::<4>()
            .ok_or_else(|| malformed("shorter than its header"))?;
        let mut taken = Taken {
            from,
            out,
            samples: 0,
            array: None,
            stamp: None,
            seconds: None,
            nanos: None,
        };
        match header {
            [0, 0, ..] => walk(&self.ops, &mut CdrReader::<BigEndian>::new(body), &mut taken)?,
            [0, 1, ..] => walk(&self.ops, &mut CdrReader::<LittleEndian>::new(body), &mut taken)?,
            [high, low, ..] => {
                return Err(malformed(&format!(
                    "its header {high:02x} {low:02x} is not plain CDR (00 00 or 00 01); parameter lists and CDR 2 are not read"
                )));
            }
        }
        let Taken {
            samples,
            array,
            stamp,
            seconds,
            nanos,
            ..
        } = taken;
        let array = array.ok_or_else(|| DecodeError::Missing {
            path: self.value.clone(),
            has: "fewer items".to_owned(),
        })?;
        let time = match &self.time {
            None => Time::Outside,
            Some(path) => {
                let parts = || stamp::from_parts(seconds?, nanos?);
                let time = stamp.or_else(parts);
                Time::Nanos(time.ok_or_else(|| DecodeError::Time { path: path.clone() })?)
            }
        };
        Ok(Decoded { array, samples, time })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use re_cdr::{ByteOrder, CdrWriter};

    const DEFINITION: &str = "std_msgs/Header header\nSensor[] sensors\nfloat32[3] point\nuint8 last\n\
        ====\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
        ====\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n\
        ====\nMSG: my_msgs/Sensor\nstring name\nfloat64 value\nint16[] raw\n";

    fn compile(value: &str, time: Option<&str>) -> Result<CdrPlan, DecodeError> {
        let schema = SchemaRef {
            name: "my_msgs/msg/Reading",
            encoding: "ros2msg",
            data: DEFINITION.as_bytes(),
        };
        let time = time.map(|path| FieldPath::parse(path).unwrap());
        CdrPlan::compile(schema, &FieldPath::parse(value).unwrap(), time.as_ref())
    }

    fn message<B: ByteOrder>(kind: u8) -> Vec<u8> {
        let mut bytes = vec![0, kind, 0, 0];
        let mut body = Vec::new();
        let mut cdr = CdrWriter::<B>::new(&mut body);
        cdr.write_i32(12);
        cdr.write_u32(34);
        cdr.write_string("laser");
        cdr.write_sequence_length(2);
        for i in 0..2u8 {
            cdr.write_string(if i == 0 { "a" } else { "bcd" });
            cdr.write_f64(f64::from(i) + 0.5);
            cdr.write_sequence_length(usize::from(i));
            for _ in 0..i {
                cdr.write_i16(-7);
            }
        }
        for x in [1.0, 2.0, 3.0] {
            cdr.write_f32(x);
        }
        cdr.write_u8(9);
        bytes.extend(body);
        bytes
    }

    #[test]
    fn walks_to_every_field_in_both_byte_orders() {
        for bytes in [message::<LittleEndian>(1), message::<BigEndian>(0)] {
            for (path, expected) in [
                ("sensors[0].value", vec![0.5]),
                ("sensors[1].value", vec![1.5]),
                ("sensors[1].raw", vec![-7.0]),
                ("sensors[1].raw[0]", vec![-7.0]),
                ("sensors[0].raw", vec![]),
                ("point", vec![1.0, 2.0, 3.0]),
                ("point[2]", vec![3.0]),
                ("last", vec![9.0]),
            ] {
                let mut out = Vec::new();
                let plan =
                    compile(path, Some("header.stamp")).unwrap_or_else(|fault| panic!("{path}: {fault}"));
                let decoded = plan.decode(&bytes, 0, &mut out).unwrap();
                assert_eq!(out, expected, "{path}");
                assert_eq!(decoded.time, Time::Nanos(12_000_000_034));
            }
            assert!(
                compile("sensors[2].value", None)
                    .unwrap()
                    .decode(&bytes, 0, &mut Vec::new())
                    .is_err()
            );
            for cut in 0..bytes.len() {
                let plan = compile("header.stamp.sec", None).unwrap();
                assert!(plan.decode(&bytes[..cut], 0, &mut Vec::new()).is_err(), "{cut}");
            }
        }
        let mut parameter_list = message::<LittleEndian>(1);
        parameter_list[1] = 3;
        assert!(
            compile("last", None)
                .unwrap()
                .decode(&parameter_list, 0, &mut Vec::new())
                .is_err()
        );
    }

    #[test]
    fn says_what_is_there_instead() {
        let told = |path| compile(path, None).unwrap_err().to_string();
        assert_eq!(told("z"), "no field `z`; there is: header, sensors, point, last");
        assert_eq!(
            told("header.seq"),
            "no field `header.seq`; there is: stamp, frame_id"
        );
        assert!(told("sensors").contains("write an index"));
        assert!(told("header.frame_id").contains("is text"));
        assert!(told("point[3]").contains("fewer items"));
    }

    #[test]
    fn hostile_definitions_are_refused() {
        for text in [
            "A a\n====\nMSG: x/A\nA a\n",
            "wstring w\nfloat64 v\n",
            "Nowhere n\nfloat64 v\n",
        ] {
            let schema = SchemaRef {
                name: "x/msg/Top",
                encoding: "ros2msg",
                data: text.as_bytes(),
            };
            let plan = CdrPlan::compile(schema, &FieldPath::parse("v").unwrap(), None);
            assert!(plan.is_err(), "{text}");
        }
    }
}
