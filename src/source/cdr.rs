//! Reads one field of a ROS 2 message (CDR) by walking its layout.
//!
//! The `.msg` definition in the file is flattened once into the few operations that walk a message;
//! the field and its time are picked up on the way. The whole message is walked, so one that is cut
//! short gives an error even if the field itself is there.

use super::decode::{DecodeError, Decoded, SchemaRef, Time};
use super::path::{FieldPath, Found, Step, into_field, into_item};
use super::stamp;
use re_cdr::{BigEndian, ByteOrder, CdrReader, LittleEndian};
use re_ros_msg::MessageSchema;
use re_ros_msg::message_spec::{ArraySize, BuiltInType, ComplexType, MessageSpecification, Type};

/// How to walk a message.
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

/// What is done with a number or a text on the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Use {
    Value,
    /// Time in nanoseconds if an integer, in seconds if a float.
    Stamp,
    Seconds,
    Nanos,
}

#[derive(Debug, Clone)]
enum Op {
    Skip(Primitive),
    Take(Primitive, Use),
    /// An array of numbers; its length stands in the message if `None`.
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

/// Limits that no honest schema comes near.
const MAX_DEPTH: usize = 32;
const MAX_OPS: usize = 10_000;

struct Compiler<'a> {
    schema: &'a MessageSchema,
    name: &'a str,
    value: &'a FieldPath,
    time: Option<&'a FieldPath>,
    ops: usize,
    value_found: bool,
    time_found: bool,
}

impl CdrPlan {
    /// Compiles the paths against the message definition in the file.
    pub fn compile(
        schema: SchemaRef<'_>,
        value: &FieldPath,
        time: Option<&FieldPath>,
    ) -> Result<Self, DecodeError> {
        let broken = |what: String| DecodeError::Schema(format!("schema `{}`: {what}", schema.name));
        let text = std::str::from_utf8(schema.data).map_err(|_| broken("not UTF-8".to_owned()))?;
        let parsed = MessageSchema::parse(schema.name, text).map_err(|fault| broken(format!("{fault:#}")))?;
        let mut compiler = Compiler {
            schema: &parsed,
            name: schema.name,
            value,
            time,
            ops: 0,
            value_found: false,
            time_found: false,
        };
        let ops = compiler.message(&parsed.spec, Some(value.steps()), time.map(FieldPath::steps), 0)?;
        if !compiler.value_found || (time.is_some() && !compiler.time_found) {
            // The compiler reports what it cannot find; this is only for paths it never reached.
            let path = if compiler.value_found {
                time.unwrap_or(value)
            } else {
                value
            };
            return Err(DecodeError::missing(path, Vec::new()));
        }
        Ok(Self {
            ops,
            value: value.to_string(),
            time: time.map(FieldPath::to_string),
        })
    }

    /// Appends the samples in `message` to `out`.
    pub fn decode(&self, message: &[u8], out: &mut Vec<f64>) -> Result<Decoded, DecodeError> {
        let (header, body) = message
            .split_first_chunk::<4>()
            .ok_or_else(|| malformed("shorter than its header"))?;
        let mut taken = Taken {
            out,
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
        Ok(Decoded { array, time })
    }
}

impl<'a> Compiler<'a> {
    fn broken(&self, what: &str) -> DecodeError {
        DecodeError::Schema(format!("schema `{}`: {what}", self.name))
    }

    /// The operations for a message; `value` and `time` are what is left of the paths that lead here.
    fn message(
        &mut self,
        spec: &MessageSpecification,
        value: Found<'_>,
        time: Found<'_>,
        depth: usize,
    ) -> Result<Vec<Op>, DecodeError> {
        if depth > MAX_DEPTH {
            return Err(self.broken("nested too deep, or in itself"));
        }
        let stamp_here = time == Some(&[]);
        if value == Some(&[]) {
            return Err(self.type_error("a message"));
        }
        let has = |name: &str| spec.fields.iter().any(|field| field.name == name);
        for (path, steps) in [(Some(self.value), value), (self.time, time)] {
            match (path, steps) {
                (Some(path), Some([Step::Field(name), ..])) if !has(name) => {
                    let names = spec.fields.iter().map(|field| field.name.clone()).collect();
                    return Err(DecodeError::missing(path, names));
                }
                (Some(path), Some([Step::Index(_), ..])) => {
                    return Err(DecodeError::missing(path, vec!["a message, no list".to_owned()]));
                }
                _ => {}
            }
        }
        let mut ops = Vec::new();
        if spec.fields.is_empty() {
            // A message of constants only is one octet on the wire.
            ops.push(Op::Skip(Primitive::U8));
        }
        for field in &spec.fields {
            let value = into_field(value, &field.name);
            let time = into_field(time, &field.name);
            let role = match field.name.as_str() {
                "sec" | "secs" | "seconds" if stamp_here => Some(Use::Seconds),
                "nanosec" | "nsec" | "nanos" | "nanoseconds" if stamp_here => Some(Use::Nanos),
                _ => None,
            };
            self.field(&field.ty, spec, value, time, role, depth, &mut ops)?;
        }
        if stamp_here {
            let takes = |wanted: Use| {
                ops.iter()
                    .any(|op| matches!(op, Op::Take(_, used) if *used == wanted))
            };
            if !takes(Use::Seconds) || !takes(Use::Nanos) {
                return Err(self.time_error());
            }
            self.time_found = true;
        }
        self.ops += ops.len();
        if self.ops > MAX_OPS {
            return Err(self.broken("too large"));
        }
        Ok(ops)
    }

    #[expect(clippy::too_many_arguments, reason = "the state of one recursion step")]
    fn field(
        &mut self,
        kind: &Type,
        spec: &MessageSpecification,
        value: Found<'_>,
        time: Found<'_>,
        role: Option<Use>,
        depth: usize,
        ops: &mut Vec<Op>,
    ) -> Result<(), DecodeError> {
        match kind {
            Type::BuiltIn(kind) => {
                let op = self.built_in(kind, value, time, role)?;
                ops.push(op);
            }
            Type::Complex(name) => {
                let inner = self.resolve(name, spec)?;
                ops.extend(self.message(inner, value, time, depth + 1)?);
            }
            Type::Array { ty, size } => {
                let count = match size {
                    ArraySize::Fixed(count) => Some(*count),
                    ArraySize::Bounded(_) | ArraySize::Unbounded => None,
                };
                let op = match ty.as_ref() {
                    Type::BuiltIn(kind) => match Primitive::of(kind) {
                        Some(primitive) => self.numbers(primitive, count, value, time)?,
                        None => self.repeat(ty, spec, count, value, time, depth)?,
                    },
                    _ => self.repeat(ty, spec, count, value, time, depth)?,
                };
                ops.push(op);
            }
        }
        Ok(())
    }

    fn built_in(
        &mut self,
        kind: &BuiltInType,
        value: Found<'_>,
        time: Found<'_>,
        role: Option<Use>,
    ) -> Result<Op, DecodeError> {
        for (path, steps) in [(Some(self.value), value), (self.time, time)] {
            if let (Some(path), Some([_, ..])) = (path, steps) {
                return Err(DecodeError::missing(path, vec!["no fields".to_owned()]));
            }
        }
        match Primitive::of(kind) {
            None if matches!(kind, BuiltInType::WString(_)) => Err(self.broken("wstring is not read")),
            None if value.is_some() => Err(self.type_error("text")),
            None if time.is_some() => {
                self.time_found = true;
                Ok(Op::TakeText)
            }
            None => Ok(Op::Text),
            Some(Primitive::Bool) if value.is_some() => Err(self.type_error("true or false")),
            Some(Primitive::Bool) if time.is_some() => Err(self.time_error()),
            Some(primitive) if value.is_some() => {
                self.value_found = true;
                Ok(Op::Take(primitive, Use::Value))
            }
            Some(primitive) if time.is_some() => {
                self.time_found = true;
                Ok(Op::Take(primitive, Use::Stamp))
            }
            Some(primitive) => Ok(match role {
                Some(used) => Op::Take(primitive, used),
                None => Op::Skip(primitive),
            }),
        }
    }

    /// An array of numbers.
    fn numbers(
        &mut self,
        primitive: Primitive,
        count: Option<usize>,
        value: Found<'_>,
        time: Found<'_>,
    ) -> Result<Op, DecodeError> {
        match (value, time) {
            (Some(_), _) if primitive == Primitive::Bool => Err(self.type_error("true or false")),
            (Some([]), None) => {
                self.value_found = true;
                Ok(Op::TakeArray(primitive, count))
            }
            (Some([Step::Index(index)]), None) => {
                if count.is_some_and(|count| *index >= count) {
                    return Err(DecodeError::missing(self.value, vec!["fewer items".to_owned()]));
                }
                self.value_found = true;
                Ok(Op::TakeElement(primitive, count, *index, Use::Value))
            }
            (None, Some([Step::Index(index)])) => {
                self.time_found = true;
                Ok(Op::TakeElement(primitive, count, *index, Use::Stamp))
            }
            (None, None) => Ok(Op::SkipArray(primitive, count)),
            (Some(_), None) => Err(DecodeError::missing(self.value, vec!["numbers".to_owned()])),
            (_, Some(_)) => Err(self.time_error()),
        }
    }

    /// An array of texts or messages.
    fn repeat(
        &mut self,
        kind: &Type,
        spec: &MessageSpecification,
        count: Option<usize>,
        value: Found<'_>,
        time: Found<'_>,
        depth: usize,
    ) -> Result<Op, DecodeError> {
        let mut special = Vec::new();
        let mut indices = Vec::new();
        for (path, steps) in [(Some(self.value), value), (self.time, time)] {
            match (path, steps) {
                (Some(_), Some([Step::Index(index), ..])) => indices.push(*index),
                (Some(path), Some(_)) => {
                    return Err(DecodeError::missing(
                        path,
                        vec!["a list: write an index".to_owned()],
                    ));
                }
                _ => {}
            }
        }
        indices.dedup();
        for index in indices {
            let mut ops = Vec::new();
            let (value, time) = (into_item(value, index), into_item(time, index));
            self.field(kind, spec, value, time, None, depth + 1, &mut ops)?;
            special.push((index, ops));
        }
        let mut each = Vec::new();
        self.field(kind, spec, None, None, None, depth + 1, &mut each)?;
        if least_size(&each) == 0 {
            return Err(self.broken("an array of nothing"));
        }
        Ok(Op::Repeat { count, each, special })
    }

    /// The definition a name means, seen from within another: relative names stay in its package.
    fn resolve(
        &self,
        name: &ComplexType,
        within: &MessageSpecification,
    ) -> Result<&'a MessageSpecification, DecodeError> {
        let ends = |full: &str| full.rsplit('/').next().unwrap_or_default().to_owned();
        let starts = |full: &str| full.split('/').next().unwrap_or_default().to_owned();
        let (package, name) = match name {
            ComplexType::Absolute { package, name } => (starts(package), name),
            ComplexType::Relative { name } if name == "Header" => ("std_msgs".to_owned(), name),
            ComplexType::Relative { name } => (starts(&within.name), name),
        };
        let named = |spec: &&MessageSpecification| ends(&spec.name) == *name;
        let candidates = || self.schema.dependencies.iter().filter(named);
        candidates()
            .find(|spec| starts(&spec.name) == package)
            .or_else(|| candidates().next())
            .ok_or_else(|| self.broken(&format!("`{package}/{name}` is not defined")))
    }

    fn type_error(&self, found: &'static str) -> DecodeError {
        DecodeError::Type {
            path: self.value.to_string(),
            found,
        }
    }

    fn time_error(&self) -> DecodeError {
        DecodeError::Time {
            path: self.time.map(FieldPath::to_string).unwrap_or_default(),
        }
    }
}

/// The fewest bytes these operations walk over.
fn least_size(ops: &[Op]) -> usize {
    let one = |op: &Op| match op {
        Op::Skip(primitive) | Op::Take(primitive, _) => primitive.size(),
        Op::SkipArray(primitive, count)
        | Op::TakeArray(primitive, count)
        | Op::TakeElement(primitive, count, ..) => match count {
            Some(count) => primitive.size().saturating_mul(*count),
            None => 4,
        },
        Op::Text | Op::TakeText => 4,
        Op::Repeat { count: None, .. } => 4,
        Op::Repeat {
            count: Some(count),
            each,
            ..
        } => least_size(each).saturating_mul(*count),
    };
    ops.iter().fold(0usize, |sum, op| sum.saturating_add(one(op)))
}

/// What was picked up on the way.
struct Taken<'a> {
    out: &'a mut Vec<f64>,
    array: Option<bool>,
    stamp: Option<i64>,
    seconds: Option<i64>,
    nanos: Option<i64>,
}

enum Number {
    Integer(i64),
    Float(f64),
}

impl Taken<'_> {
    #[inline]
    fn take(&mut self, number: Number, used: Use) {
        match (used, number) {
            (Use::Value, Number::Integer(value)) => {
                self.array = Some(false);
                self.out.push(value as f64);
            }
            (Use::Value, Number::Float(value)) => {
                self.array = Some(false);
                self.out.push(value);
            }
            (Use::Stamp, Number::Integer(nanos)) => self.stamp = Some(nanos),
            (Use::Stamp, Number::Float(seconds)) => self.stamp = stamp::from_seconds(seconds),
            (Use::Seconds, Number::Integer(seconds)) => self.seconds = Some(seconds),
            (Use::Nanos, Number::Integer(nanos)) => self.nanos = Some(nanos),
            // Seconds and nanoseconds as floats are no time; what is missing is reported.
            (Use::Seconds | Use::Nanos, Number::Float(_)) => {}
        }
    }
}

fn malformed(what: &str) -> DecodeError {
    DecodeError::Malformed(format!("not a CDR message: {what}"))
}

fn short(_: re_cdr::Error) -> DecodeError {
    malformed("it is cut short")
}

fn walk<B: ByteOrder>(
    ops: &[Op],
    reader: &mut CdrReader<'_, B>,
    taken: &mut Taken<'_>,
) -> Result<(), DecodeError> {
    for op in ops {
        match op {
            Op::Skip(primitive) => {
                reader.align(primitive.size()).map_err(short)?;
                reader.read_bytes(primitive.size()).map_err(short)?;
            }
            Op::Take(primitive, used) => {
                let bytes = array(*primitive, 1, reader)?;
                taken.take(number::<B>(*primitive, bytes), *used);
            }
            Op::SkipArray(primitive, count) => {
                let count = length(*count, reader)?;
                array(*primitive, count, reader)?;
            }
            Op::TakeArray(primitive, count) => {
                let count = length(*count, reader)?;
                let bytes = array(*primitive, count, reader)?;
                taken.array = Some(true);
                floats::<B>(*primitive, bytes, taken.out);
            }
            Op::TakeElement(primitive, count, index, used) => {
                let count = length(*count, reader)?;
                let bytes = array(*primitive, count, reader)?;
                if let Some(bytes) = bytes.chunks_exact(primitive.size()).nth(*index) {
                    taken.take(number::<B>(*primitive, bytes), *used);
                }
            }
            Op::Text => {
                text(reader)?;
            }
            Op::TakeText => {
                let bytes = text(reader)?;
                let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
                taken.stamp = std::str::from_utf8(bytes).ok().and_then(stamp::from_text);
            }
            Op::Repeat { count, each, special } => {
                for i in 0..length(*count, reader)? {
                    let ops = special.iter().find(|(index, _)| *index == i);
                    walk(ops.map_or(each, |(_, ops)| ops), reader, taken)?;
                }
            }
        }
    }
    Ok(())
}

#[inline]
fn length<B: ByteOrder>(fixed: Option<usize>, reader: &mut CdrReader<'_, B>) -> Result<usize, DecodeError> {
    match fixed {
        Some(count) => Ok(count),
        None => Ok(reader.read_u32().map_err(short)? as usize),
    }
}

/// The bytes of `count` numbers.
#[inline]
fn array<'a, B: ByteOrder>(
    primitive: Primitive,
    count: usize,
    reader: &mut CdrReader<'a, B>,
) -> Result<&'a [u8], DecodeError> {
    if count == 0 {
        return Ok(&[]);
    }
    let size = primitive.size();
    reader.align(size).map_err(short)?;
    let bytes = count
        .checked_mul(size)
        .ok_or_else(|| malformed("it is cut short"))?;
    reader.read_bytes(bytes).map_err(short)
}

fn text<'a, B: ByteOrder>(reader: &mut CdrReader<'a, B>) -> Result<&'a [u8], DecodeError> {
    let count = reader.read_u32().map_err(short)? as usize;
    reader.read_bytes(count).map_err(short)
}

/// One number; `bytes` has its size.
#[inline]
fn number<B: ByteOrder>(primitive: Primitive, bytes: &[u8]) -> Number {
    match primitive {
        Primitive::Bool | Primitive::U8 => Number::Integer(i64::from(bytes[0])),
        Primitive::I8 => Number::Integer(i64::from(bytes[0].cast_signed())),
        Primitive::I16 => Number::Integer(i64::from(B::read_i16(bytes))),
        Primitive::U16 => Number::Integer(i64::from(B::read_u16(bytes))),
        Primitive::I32 => Number::Integer(i64::from(B::read_i32(bytes))),
        Primitive::U32 => Number::Integer(i64::from(B::read_u32(bytes))),
        Primitive::I64 => Number::Integer(B::read_i64(bytes)),
        Primitive::U64 => {
            let value = B::read_u64(bytes);
            i64::try_from(value).map_or(Number::Float(value as f64), Number::Integer)
        }
        Primitive::F32 => Number::Float(f64::from(B::read_f32(bytes))),
        Primitive::F64 => Number::Float(B::read_f64(bytes)),
    }
}

/// Numbers as floats.
fn floats<B: ByteOrder>(primitive: Primitive, bytes: &[u8], out: &mut Vec<f64>) {
    match primitive {
        Primitive::F64 => out.extend(bytes.chunks_exact(8).map(B::read_f64)),
        Primitive::F32 => out.extend(bytes.chunks_exact(4).map(|b| f64::from(B::read_f32(b)))),
        other => out.extend(
            bytes
                .chunks_exact(other.size())
                .map(|b| match number::<B>(other, b) {
                    Number::Integer(value) => value as f64,
                    Number::Float(value) => value,
                }),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use re_cdr::CdrWriter;

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
                let decoded = plan.decode(&bytes, &mut out).unwrap();
                assert_eq!(out, expected, "{path}");
                assert_eq!(decoded.time, Time::Nanos(12_000_000_034));
            }
            assert!(
                compile("sensors[2].value", None)
                    .unwrap()
                    .decode(&bytes, &mut Vec::new())
                    .is_err()
            );
            for cut in 0..bytes.len() {
                let plan = compile("header.stamp.sec", None).unwrap();
                assert!(plan.decode(&bytes[..cut], &mut Vec::new()).is_err(), "{cut}");
            }
        }
        let mut parameter_list = message::<LittleEndian>(1);
        parameter_list[1] = 3;
        assert!(
            compile("last", None)
                .unwrap()
                .decode(&parameter_list, &mut Vec::new())
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
