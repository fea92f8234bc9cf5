//! Recordings out: MCAP files that appear whole or not at all.

pub mod mcap;
pub mod message;

pub use self::mcap::{ChannelId, ChannelSpec, Compression, RecordingWriter, SinkError, WriterOptions};
pub use self::message::{Encoding, Layout, Precision};
