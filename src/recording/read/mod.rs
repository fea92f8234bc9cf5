//! Recordings in: MCAP files, message decoding, samples to records.

mod carry;
pub mod cdr;
mod chunk;
pub mod contents;
pub mod decode;
mod definition;
mod file;
mod finished;
pub mod folder;
pub mod hole;
mod in_order;
pub mod json;
mod known;
mod lanes;
mod layout;
pub mod mcap;
pub mod path;
mod place;
mod plans;
pub mod protobuf;
pub mod recording;
pub mod recordings;
mod route;
pub mod series;
pub mod source;
mod speakers;
pub mod stamp;
pub mod stream;
pub mod summary;
mod tail;
mod verify;
mod wire;

pub use self::decode::{DecodeError, Decoder, SchemaRef};
pub use self::finished::Finished;
pub use self::folder::recordings;
pub use self::path::FieldPath;
pub use self::place::Place;
pub use self::recording::{Block, Follow, Options, Position, Recording};
pub use self::recordings::{Opener, Recordings};
pub use self::route::{HELD, Listener, MOST_READY};
pub use self::series::{PartEnd, Parts, Series};
pub use self::source::{Source, Step};
pub use self::stream::{Member, Stream};
pub use self::summary::{Summary, TopicSummary};
pub use self::tail::{Tail, TailEnd, Tails};
pub use self::verify::Trust;
pub use tirante_analysis::signal::record::Event;

use std::io;
use thiserror::Error;

/// Reason why a recording cannot be opened.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The file system returned an error.
    #[error("{path}: cannot be read: {source}")]
    Io {
        /// Path of the file.
        path: String,
        /// Error of the file system.
        source: io::Error,
    },
    /// A pipe, a device, a folder where a file is needed.
    #[error("{path}: not a regular file")]
    NotAFile {
        /// Path that is no file.
        path: String,
    },
    /// Another program's file that cannot be read, or not for these rods.
    #[error("{path}: {what}")]
    Foreign {
        /// Path of the file.
        path: String,
        /// Description of the fault.
        what: String,
    },
    /// A folder without recordings.
    #[error("{path}: no recordings (*.mcap) in this folder")]
    Empty {
        /// Path of the folder.
        path: String,
    },
    /// The path of a field is malformed.
    #[error("rod {rod}: {source}")]
    Field {
        /// Id of the rod.
        rod: String,
        /// Fault of the path.
        source: path::PathError,
    },
}
