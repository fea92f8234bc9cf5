//! What the journal says of itself between the data: one JSON message at the end of every chunk.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The topic of the notes.
pub const TOPIC: &str = "/tirante/journal";
/// The key in a channel's metadata that names the stream it belongs to.
pub const STREAM: &str = "stream";

/// What one chunk changed. The first note of a part is complete: it names every stream there is.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Note {
    /// In the first note of a part.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begins: Option<Begins>,
    /// Streams whose standing changed. A named sender's is called as the sender; others are called `#part.number`.
    #[serde(default)]
    pub streams: BTreeMap<String, Standing>,
}

/// Which part of which journal begins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Begins {
    /// The journal.
    pub journal: String,
    /// The part's number, from 1 on.
    pub part: u32,
}

/// How far a stream has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Standing {
    /// Its messages that are in the journal up to here, those of no rod's topic included.
    pub messages: u64,
    /// Whether it goes on.
    pub state: State,
    /// When its last data came, by this machine's clock \[ns since 1970\].
    pub seen_ns: u64,
}

/// Whether a stream goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// It goes on, or may be taken up again.
    Open,
    /// Its sender ended it.
    Complete,
    /// It broke off, and was not taken up again.
    Broken,
}

impl Note {
    /// As a message.
    pub fn to_json(&self) -> Vec<u8> {
        // Texts and whole numbers only: it cannot fail.
        serde_json::to_vec(self).unwrap_or_default()
    }
}
