//! Topics for robotics viewers (Foxglove, Lichtblick): JSON messages with a schema each, the same in a file
//! and live.
//!
//! * `message`   the topics: records, their views and alarms as messages
//! * `file`      an MCAP file of them, to open next to the recordings
//! * `feed`      changes in a store
//! * `protocol`  the WebSocket protocol `foxglove.sdk.v1` that carries them live; `src/service/http/viewer.rs` speaks it

mod feed;
mod file;
mod message;
pub mod protocol;

pub use feed::{Feed, standing};
pub use file::ResultsWriter;
pub use message::{Message, Topic};
