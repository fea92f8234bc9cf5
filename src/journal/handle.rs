//! A connection's way into the journal.

use tokio::sync::watch;

/// The journal stopped, or another connection took over this sender's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Closed {
    /// The daemon stops.
    #[error("the daemon stops")]
    Stopping,
    /// Another connection has this sender's name now.
    #[error("another connection took over this sender's name")]
    TakenOver,
}

/// What goes into the journal.
#[derive(Debug, Clone, PartialEq)]
pub enum Entry {
    /// A channel, before its first message; ids are the connection's own.
    Channel {
        /// Its id.
        id: u16,
        /// Its topic.
        topic: String,
        /// How its messages are encoded.
        encoding: String,
        /// Name, encoding and content of its schema.
        schema: Option<(String, String, Vec<u8>)>,
    },
    /// A message.
    Message {
        /// Its channel.
        channel: u16,
        /// When it was recorded \[ns since 1970\].
        log_time: u64,
        /// When it was sent \[ns since 1970\].
        publish_time: u64,
        /// Its content.
        data: Vec<u8>,
    },
}

/// Some messages, and how far their sender's stream has come with them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Batch {
    /// In the order they came.
    pub entries: Vec<Entry>,
    /// Messages of this sender up to and including these, those of no rod's topic included.
    pub through: u64,
}

/// How a stream ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Its sender said so: what is open becomes a record.
    Complete,
    /// The connection broke: a named sender may come back, of others what is open becomes a record that is cut short.
    Broken,
}

/// The way to the journal's thread.
#[derive(Debug, Clone)]
pub struct Handle {}

/// One connection's way into the journal. Dropped without [`Line::end`], its stream counts as broken.
#[derive(Debug)]
pub struct Line {}

impl Handle {
    /// Begins or takes up a stream. A sender with a name resumes; an older connection of the same name is closed.
    ///
    /// # Errors
    /// The daemon stops.
    pub async fn connect(&self, _sender: Option<&str>) -> Result<Line, Closed> {
        Err(Closed::Stopping)
    }
}

impl Line {
    /// Messages of this sender that are durable already: it goes on with the one after them.
    pub fn begins_at(&self) -> u64 {
        0
    }

    /// Puts a batch in; waits while the journal's queue is full.
    ///
    /// # Errors
    /// The daemon stops, or another connection took over.
    pub async fn append(&mut self, _batch: Batch) -> Result<(), Closed> {
        Err(Closed::Stopping)
    }

    /// Messages of this sender that are durable: what may be acknowledged.
    pub fn durable(&self) -> watch::Receiver<u64> {
        watch::channel(0).1
    }

    /// Ends the stream; returns when the end is durable.
    ///
    /// # Errors
    /// The daemon stops, or another connection took over.
    pub async fn end(self, _how: End) -> Result<(), Closed> {
        Err(Closed::Stopping)
    }
}
