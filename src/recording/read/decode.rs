//! Decodes messages to samples: one plan per channel, compiled from the encoding, its schema and the paths.

use super::cdr::CdrPlan;
use super::json::JsonPlan;
use super::path::{FieldPath, PathError};
use super::protobuf::ProtobufPlan;
use thiserror::Error;
use tirante_analysis::signal::record::TimeSource;

/// Reason why a message, or a whole channel, gives no samples.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// The message does not follow its encoding.
    #[error("{0}")]
    Malformed(String),
    /// The path leads nowhere.
    #[error("no field `{path}`; there is: {has}")]
    Missing {
        /// Path as configured.
        path: String,
        /// Content where the path ends.
        has: String,
    },
    /// The path leads to something that is not a number.
    #[error("field `{path}` is {found}, not a number or an array of numbers")]
    Type {
        /// Path as configured.
        path: String,
        /// Type found.
        found: &'static str,
    },
    /// The time cannot be read.
    #[error(
        "field `{path}` is not a time (nanoseconds, seconds, RFC 3339 text, or seconds with nanoseconds, \
         between 1677 and 2262)"
    )]
    Time {
        /// Path as configured.
        path: String,
    },
    /// The stamp beside the message is no possible time.
    #[error("time {nanos} ns since 1970 is beyond the year 2262")]
    Stamp {
        /// Stamp as given \[ns\].
        nanos: u64,
    },
    /// An array of samples without their rate.
    #[error("field `{path}` is an array: its sample rate is needed (`fs_hz`)")]
    Rate {
        /// Path as configured.
        path: String,
    },
    /// The message has more bytes than allowed.
    #[error("a message of {bytes} bytes, at most {MAX_MESSAGE} are read: send its samples in several")]
    TooLarge {
        /// Length of the message \[bytes\].
        bytes: usize,
    },
    /// Several channels share the topic at once, so that the rod's channel is ambiguous.
    #[error(
        "channels {channels} have this topic at once, and nothing says which is the rod's; give each sensor a topic of its own"
    )]
    SharedTopic {
        /// Ids of the channels, for people.
        channels: String,
    },
    /// The schema cannot be used.
    #[error("{0}")]
    Schema(String),
    /// The encoding is not supported.
    #[error("message encoding `{0}` cannot be read; json, protobuf and cdr (ROS 2) can")]
    Encoding(String),
    /// The path is malformed.
    #[error(transparent)]
    Path(#[from] PathError),
}

impl DecodeError {
    /// Error for a path that leads nowhere, with the value found there (shortened).
    pub(super) fn missing(path: &FieldPath, mut has: Vec<String>) -> Self {
        const SHOWN: usize = 12;
        if has.len() > SHOWN {
            let more = has.len() - SHOWN;
            has.truncate(SHOWN);
            has.push(format!("and {more} more"));
        }
        Self::Missing {
            path: path.to_string(),
            has: if has.is_empty() {
                "nothing".to_owned()
            } else {
                has.join(", ")
            },
        }
    }
}

/// Largest message that is decoded \[bytes\], as large as the largest record.
pub const MAX_MESSAGE: usize = 16 << 20;

/// Most samples of a message that are decoded at once: a larger array is taken in pieces.
pub const PIECE: usize = 1 << 20;

/// Time of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Time {
    /// Not in the message: the stamps beside it count.
    Outside,
    /// Nanoseconds since 1970.
    Nanos(i64),
}

/// Properties of a message besides its samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decoded {
    /// True if the field is an array.
    pub array: bool,
    /// Number of its samples, those before and after the piece included.
    pub samples: usize,
    /// Time of the message.
    pub time: Time,
}

/// A schema as in the file.
#[derive(Debug, Clone, Copy)]
pub struct SchemaRef<'a> {
    /// Name of the schema.
    pub name: &'a str,
    /// Encoding of the schema.
    pub encoding: &'a str,
    /// Text or bytes of the schema.
    pub data: &'a [u8],
}

impl SchemaRef<'_> {
    /// Name, encoding and content, owned.
    pub fn owned(&self) -> (String, String, Vec<u8>) {
        (self.name.to_owned(), self.encoding.to_owned(), self.data.to_vec())
    }
}

/// Decoder of one field of one channel's messages.
#[derive(Debug)]
pub enum Decoder {
    /// JSON.
    Json(JsonPlan),
    /// Protobuf.
    Protobuf(Box<ProtobufPlan>),
    /// ROS 2 CDR.
    Cdr(CdrPlan),
}

/// Largest schema accepted \[bytes\].
const MAX_SCHEMA: usize = 1 << 20;

impl Decoder {
    /// Compiles the plan for a channel.
    pub fn compile(
        encoding: &str,
        schema: Option<SchemaRef<'_>>,
        field: &str,
        time: &TimeSource,
    ) -> Result<Self, DecodeError> {
        let value = FieldPath::parse(field)?;
        let time = match time {
            TimeSource::Field(path) => Some(FieldPath::parse(path)?),
            TimeSource::Log | TimeSource::Publish => None,
        };
        let schema_in = |wanted: &str| match schema {
            Some(schema) if schema.encoding != wanted => Err(DecodeError::Schema(format!(
                "schema encoding `{}` cannot be read; {encoding} messages need `{wanted}`",
                schema.encoding
            ))),
            Some(schema) if schema.data.len() > MAX_SCHEMA => Err(DecodeError::Schema(format!(
                "schema `{}` is larger than {MAX_SCHEMA} bytes",
                schema.name
            ))),
            Some(schema) => Ok(schema),
            None => Err(DecodeError::Schema(format!(
                "the channel has no schema; {encoding} messages need one"
            ))),
        };
        // The schema parsers are not ours and the schema is not either: a panic in one refuses the channel.
        let guarded = |compile: &dyn Fn() -> Result<Self, DecodeError>| {
            std::panic::catch_unwind(std::panic::AssertUnwindSafe(compile))
                .unwrap_or_else(|_| Err(DecodeError::Schema("the schema cannot be parsed".to_owned())))
        };
        match encoding {
            "json" => Ok(Self::Json(JsonPlan::new(value, time))),
            "protobuf" => {
                let schema = schema_in("protobuf")?;
                guarded(&|| {
                    ProtobufPlan::compile(schema, &value, time.as_ref())
                        .map(|plan| Self::Protobuf(Box::new(plan)))
                })
            }
            "cdr" => {
                let schema = schema_in("ros2msg")?;
                guarded(&|| CdrPlan::compile(schema, &value, time.as_ref()).map(Self::Cdr))
            }
            other => Err(DecodeError::Encoding(other.chars().take(40).collect())),
        }
    }

    /// Writes the samples in `message` from number `from` on to `out`, [`PIECE`] of them at most. On an error, those written are
    /// meaningless.
    pub fn decode(&self, message: &[u8], from: usize, out: &mut Vec<f64>) -> Result<Decoded, DecodeError> {
        out.clear();
        if message.len() > MAX_MESSAGE {
            return Err(DecodeError::TooLarge { bytes: message.len() });
        }
        match self {
            Self::Json(plan) => plan.decode(message, from, out),
            Self::Protobuf(plan) => plan.decode(message, from, out),
            Self::Cdr(plan) => plan.decode(message, from, out),
        }
    }

    /// Approximate size of the plan in memory \[bytes\].
    pub(super) fn bytes(&self) -> usize {
        match self {
            Self::Json(_) => size_of::<JsonPlan>(),
            Self::Protobuf(_) => size_of::<ProtobufPlan>(),
            Self::Cdr(plan) => plan.bytes(),
        }
    }
}
