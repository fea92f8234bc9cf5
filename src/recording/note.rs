//! Notes of the journal about itself: one JSON message at the end of every chunk.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Topic of the notes.
pub const TOPIC: &str = "/tirante/journal";
/// Key in a channel's metadata that names the stream it belongs to.
pub const STREAM: &str = "stream";

/// Changes by one chunk. The first note of a part is complete: it names every stream.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Note {
    /// Journal and part, in the first note of a part.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begins: Option<Begins>,
    /// Streams whose state changed. A named sender's stream has the sender's name; others are called
    /// `#part.number`.
    #[serde(default)]
    pub streams: BTreeMap<String, Standing>,
}

/// Journal and number of a part that begins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Begins {
    /// Identity of the journal.
    pub journal: String,
    /// Number of the part, from 1.
    pub part: u32,
}

/// Progress of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Standing {
    /// Number of its messages in the journal so far, those of no rod's topic included.
    pub messages: u64,
    /// State of the stream.
    pub state: State,
    /// Arrival of its last data, by this machine's clock \[ns since 1970\].
    pub seen_ns: u64,
}

/// State of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Goes on, or may be resumed.
    Open,
    /// Ended by its sender.
    Complete,
    /// Broke off, and was not resumed.
    Broken,
}

impl Note {
    /// The note as a JSON message.
    pub fn to_json(&self) -> Vec<u8> {
        // Texts and whole numbers only: it cannot fail.
        serde_json::to_vec(self).unwrap_or_default()
    }
}
