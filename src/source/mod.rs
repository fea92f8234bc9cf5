//! Recordings in: MCAP files, message decoding, samples to records.

pub mod cdr;
mod chunk;
pub mod decode;
pub mod json;
pub mod mcap;
pub mod path;
pub mod protobuf;
pub mod stamp;
mod verify;
mod wire;

pub use self::decode::{DecodeError, Decoder, SchemaRef};
pub use self::path::FieldPath;
