//! Recordings in: MCAP files, message decoding, samples to records.

mod carry;
pub mod cdr;
mod chunk;
pub mod contents;
pub mod decode;
mod definition;
pub mod folder;
pub mod hole;
pub mod json;
pub mod mcap;
pub mod path;
mod place;
mod plans;
pub mod protobuf;
pub mod recording;
pub mod recordings;
mod route;
pub mod series;
mod speakers;
pub mod stamp;
pub mod summary;
mod verify;
mod wire;

pub use self::decode::{DecodeError, Decoder, SchemaRef};
pub use self::folder::recordings;
pub use self::path::FieldPath;
pub use self::place::Place;
pub use self::recording::{Block, Follow, Options, Poll, Position, Recording};
pub use self::recordings::{Opener, Recordings, Step};
pub use self::series::{PartEnd, Parts, Series, SeriesPoll};
pub use self::summary::{Summary, TopicSummary};
pub use self::verify::Trust;
pub use crate::analysis::signal::record::Event;

use std::io;
use thiserror::Error;

/// Why a recording cannot be opened.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The file system said no.
    #[error("{path}: cannot be read: {source}")]
    Io {
        /// The file.
        path: String,
        /// What it said.
        source: io::Error,
    },
    /// A pipe, a device, a folder where a file is needed.
    #[error("{path}: not a regular file")]
    NotAFile {
        /// The path.
        path: String,
    },
    /// Another program's file that cannot be read, or not for these rods.
    #[error("{path}: {what}")]
    Foreign {
        /// The file.
        path: String,
        /// What is missing or wrong.
        what: String,
    },
    /// A folder without recordings.
    #[error("{path}: no recordings (*.mcap) in this folder")]
    Empty {
        /// The folder.
        path: String,
    },
    /// A field path that is none.
    #[error("rod {rod}: {source}")]
    Field {
        /// The rod.
        rod: String,
        /// What is wrong with it.
        source: path::PathError,
    },
}
