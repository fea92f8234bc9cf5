//! Walks one CDR message by the operations of a plan and picks up samples and time on the way.

use super::super::decode::{DecodeError, PIECE};
use super::super::stamp;
use super::{Op, Primitive, Use};
use re_cdr::{ByteOrder, CdrReader};

/// Values picked up on the way.
pub(super) struct Taken<'a> {
    /// Number of the first sample that is wanted.
    pub from: usize,
    pub out: &'a mut Vec<f64>,
    /// Number of samples met.
    pub samples: usize,
    pub array: Option<bool>,
    pub stamp: Option<i64>,
    pub seconds: Option<i64>,
    pub nanos: Option<i64>,
}

enum Number {
    Integer(i64),
    Float(f64),
}

impl Taken<'_> {
    fn single(&mut self, value: f64) {
        self.array = Some(false);
        if self.from <= self.samples {
            self.out.push(value);
        }
        self.samples += 1;
    }

    #[inline]
    fn take(&mut self, number: Number, used: Use) {
        match (used, number) {
            (Use::Value, Number::Integer(value)) => self.single(value as f64),
            (Use::Value, Number::Float(value)) => self.single(value),
            (Use::Stamp, Number::Integer(nanos)) => self.stamp = Some(nanos),
            (Use::Stamp, Number::Float(seconds)) => self.stamp = stamp::from_seconds(seconds),
            (Use::Seconds, Number::Integer(seconds)) => self.seconds = Some(seconds),
            (Use::Nanos, Number::Integer(nanos)) => self.nanos = Some(nanos),
            // Seconds and nanoseconds as floats are not a time; the missing part is reported.
            (Use::Seconds | Use::Nanos, Number::Float(_)) => {}
        }
    }
}

pub(super) fn malformed(what: &str) -> DecodeError {
    DecodeError::Malformed(format!("not a CDR message: {what}"))
}

fn short(_: re_cdr::Error) -> DecodeError {
    malformed("it is cut short")
}

/// Walks one message.
pub(super) fn walk<B: ByteOrder>(
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
                let first = taken.from.saturating_sub(taken.samples).min(count);
                let last = (first + PIECE - taken.out.len().min(PIECE)).min(count);
                let size = primitive.size();
                floats::<B>(*primitive, &bytes[first * size..last * size], taken.out);
                taken.samples += count;
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

/// Bytes of `count` numbers.
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
