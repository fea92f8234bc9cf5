//! Topics for robotics viewers (Foxglove, Lichtblick): messages with a schema each, in a file as JSON, CDR or protobuf, live as JSON.
//!
//! * `message`   the topics: records, their views and alarms as messages
//! * `schema`    their types, with descriptions and units
//! * `encode`    messages as bytes
//! * `file`      an MCAP file of them, to open next to the recordings
//! * `feed`      changes in a store
//! * `signal`    samples as the daemon reads them, for viewers that ask for them
//! * `protocol`  the WebSocket protocol `foxglove.sdk.v1` that carries them live; `src/service/http/viewer.rs` speaks it

mod encode;
mod feed;
mod file;
mod message;
pub mod protocol;
mod schema;
mod signal;

use encode::encode;
pub use feed::{Feed, standing};
pub use file::ResultsWriter;
pub use message::{Message, Topic};
pub use signal::{Ear, Heard, Signals};
