//! Numbers and bytes on the wire of a protobuf message.

use crate::read::decode::DecodeError;
use prost_reflect::Kind;
use prost_reflect::prost::encoding::{WireType, decode_varint};

/// A number of a field.
#[derive(Debug, Clone, Copy)]
pub(super) enum Number {
    Integer(i64),
    Float(f64),
}

impl Number {
    pub(super) fn float(self) -> f64 {
        match self {
            Self::Integer(value) => value as f64,
            Self::Float(value) => value,
        }
    }

    pub(super) fn integer(self) -> Option<i64> {
        match self {
            Self::Integer(value) => Some(value),
            Self::Float(_) => None,
        }
    }
}

pub(super) fn malformed(what: &str) -> DecodeError {
    DecodeError::Malformed(format!("not a protobuf message: {what}"))
}

pub(super) fn broken(fault: prost_reflect::prost::DecodeError) -> DecodeError {
    malformed(&fault.to_string())
}

/// Reads a length-delimited field from the buffer.
pub(super) fn bytes<'a>(wire: WireType, buffer: &mut &'a [u8]) -> Result<&'a [u8], DecodeError> {
    if wire != WireType::LengthDelimited {
        return Err(malformed("a field has the wrong wire type"));
    }
    let length = decode_varint(buffer).map_err(broken)?;
    let cut = || malformed("it is cut short");
    let length = usize::try_from(length).map_err(|_| cut())?;
    let (inner, rest) = buffer.split_at_checked(length).ok_or_else(cut)?;
    *buffer = rest;
    Ok(inner)
}

/// Reads a number from the buffer.
#[inline]
pub(super) fn scalar(kind: &Kind, buffer: &mut &[u8]) -> Result<Number, DecodeError> {
    let four = |buffer: &mut &[u8]| take::<4>(buffer);
    let eight = |buffer: &mut &[u8]| take::<8>(buffer);
    let unsigned = |value: u64| i64::try_from(value).map_or(Number::Float(value as f64), Number::Integer);
    Ok(match kind {
        Kind::Double => Number::Float(f64::from_le_bytes(eight(buffer)?)),
        Kind::Float => Number::Float(f64::from(f32::from_le_bytes(four(buffer)?))),
        Kind::Fixed64 => unsigned(u64::from_le_bytes(eight(buffer)?)),
        Kind::Sfixed64 => Number::Integer(i64::from_le_bytes(eight(buffer)?)),
        Kind::Fixed32 => Number::Integer(i64::from(u32::from_le_bytes(four(buffer)?))),
        Kind::Sfixed32 => Number::Integer(i64::from(i32::from_le_bytes(four(buffer)?))),
        kind => {
            let raw = decode_varint(buffer).map_err(broken)?;
            match kind {
                Kind::Int32 => Number::Integer(i64::from(raw as i32)),
                Kind::Int64 => Number::Integer(raw as i64),
                Kind::Uint32 => Number::Integer(i64::from(raw as u32)),
                Kind::Sint32 | Kind::Sint64 => Number::Integer((raw >> 1) as i64 ^ -((raw & 1) as i64)),
                _ => unsigned(raw),
            }
        }
    })
}

fn take<const N: usize>(buffer: &mut &[u8]) -> Result<[u8; N], DecodeError> {
    let (head, rest) = buffer
        .split_first_chunk::<N>()
        .ok_or_else(|| malformed("it is cut short"))?;
    *buffer = rest;
    Ok(*head)
}
