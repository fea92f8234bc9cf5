//! Results' messages as bytes: the JSON body itself, or its fields as CDR or protobuf by the type's table. Fields that a table does not
//! name are in JSON alone.

use super::schema::{Kind, Type};
use crate::recording::write::Encoding;
use prost_reflect::prost::encoding::{self, WireType};
use re_cdr::{CdrWriter, LittleEndian};
use serde_json::Value as Json;

const CDR_LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// A message of a type as bytes.
pub fn encode(of: &Type, body: &Json, encoding: Encoding) -> Vec<u8> {
    match encoding {
        Encoding::Json => body.to_string().into_bytes(),
        Encoding::Protobuf => protobuf(of, body),
        Encoding::Ros2 => {
            let mut out = CDR_LITTLE_ENDIAN.to_vec();
            cdr(&mut CdrWriter::<LittleEndian>::new(&mut out), of, body);
            out
        }
    }
}

fn number(value: &Json) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn whole(value: &Json) -> u32 {
    value
        .as_u64()
        .and_then(|value| value.try_into().ok())
        .unwrap_or(0)
}

/// Elements of a list; none of a value that is no list.
fn elements(value: &Json) -> &[Json] {
    value.as_array().map_or(&[][..], Vec::as_slice)
}

/// Seconds and nanoseconds of a stamp.
fn stamp(value: &Json) -> (i64, u32) {
    (value["sec"].as_i64().unwrap_or(0), whole(&value["nsec"]))
}

fn cdr(out: &mut CdrWriter<'_, LittleEndian>, of: &Type, body: &Json) {
    for field in of.fields {
        let value = &body[field.name];
        match field.kind {
            Kind::Time => {
                let (sec, nsec) = stamp(value);
                out.write_i32(sec.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32);
                out.write_u32(nsec);
            }
            Kind::Number => out.write_f64(number(value)),
            Kind::Integer => out.write_u32(whole(value)),
            Kind::Flag => out.write_u8(u8::from(value.as_bool().unwrap_or(false))),
            Kind::Text => out.write_string(value.as_str().unwrap_or_default()),
            Kind::Numbers => {
                out.write_sequence_length(elements(value).len());
                elements(value).iter().for_each(|one| out.write_f64(number(one)));
            }
            Kind::One(inner) => cdr(out, inner, value),
            Kind::Many(inner) => {
                out.write_sequence_length(elements(value).len());
                elements(value).iter().for_each(|one| cdr(out, inner, one));
            }
        }
    }
}

fn protobuf(of: &Type, body: &Json) -> Vec<u8> {
    let mut out = Vec::new();
    let message = |tag: u32, inner: Vec<u8>, out: &mut Vec<u8>| {
        encoding::encode_key(tag, WireType::LengthDelimited, out);
        encoding::encode_varint(inner.len() as u64, out);
        out.extend(inner);
    };
    for (tag, field) in (1..).zip(of.fields) {
        let value = &body[field.name];
        match field.kind {
            Kind::Time => {
                let (sec, nsec) = stamp(value);
                let mut inner = Vec::new();
                encoding::int64::encode(1, &sec, &mut inner);
                encoding::int32::encode(2, &nsec.try_into().unwrap_or(0), &mut inner);
                message(tag, inner, &mut out);
            }
            // Numbers are written when they are missing, too: absent would read as zero.
            Kind::Number => encoding::double::encode(tag, &number(value), &mut out),
            Kind::Integer => encoding::uint32::encode(tag, &whole(value), &mut out),
            Kind::Flag => encoding::bool::encode(tag, &value.as_bool().unwrap_or(false), &mut out),
            Kind::Text => {
                encoding::string::encode(tag, &value.as_str().unwrap_or_default().to_owned(), &mut out);
            }
            Kind::Numbers => {
                let numbers: Vec<f64> = elements(value).iter().map(number).collect();
                encoding::double::encode_packed(tag, &numbers, &mut out);
            }
            // A message that is missing is absent.
            Kind::One(_) if value.is_null() => {}
            Kind::One(inner) => message(tag, protobuf(inner, value), &mut out),
            Kind::Many(inner) => {
                for one in elements(value) {
                    message(tag, protobuf(inner, one), &mut out);
                }
            }
        }
    }
    out
}
