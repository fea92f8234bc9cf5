//! Recordings in: MCAP files, message decoding, samples to records.

pub mod cdr;
pub mod decode;
pub mod json;
pub mod path;
pub mod protobuf;
pub mod stamp;

pub use self::decode::{DecodeError, Decoder, SchemaRef};
pub use self::path::FieldPath;
