//! A ROS 2 message definition flattened into the operations that walk a message.

use super::super::decode::{DecodeError, SchemaRef};
use super::super::path::{FieldPath, Found, Step, into_field, into_item};
use super::{Op, Primitive, Use};
use re_ros_msg::MessageSchema;
use re_ros_msg::message_spec::{ArraySize, BuiltInType, ComplexType, MessageSpecification, Type};

/// Limits far above any real schema.
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

/// Operations that walk a message of this schema and pick up the field and its time.
pub(super) fn compile(
    schema: SchemaRef<'_>,
    value: &FieldPath,
    time: Option<&FieldPath>,
) -> Result<Vec<Op>, DecodeError> {
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
        // The compiler reports fields that it cannot find; this covers only paths it never reached.
        let path = if compiler.value_found {
            time.unwrap_or(value)
        } else {
            value
        };
        return Err(DecodeError::missing(path, Vec::new()));
    }
    Ok(ops)
}

impl<'a> Compiler<'a> {
    fn broken(&self, what: &str) -> DecodeError {
        DecodeError::Schema(format!("schema `{}`: {what}", self.name))
    }

    /// Operations for a message; `value` and `time` are the remainders of the paths that lead here.
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

    /// Definition of a name as used within another: relative names stay in its package.
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

/// Fewest bytes that these operations walk over.
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
