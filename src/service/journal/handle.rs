//! A connection's input of the journal.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::Sender;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot, watch};

/// Most data of batches that wait for the journal's thread \[KiB\].
pub(super) const QUEUE_KIB: u32 = 32 << 10;

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

/// Largest message kept \[bytes\]: with a batch before it, it fits the records and chunks that readers
/// accept.
pub const MAX_MESSAGE: usize = 8 << 20;

/// Name, encoding and content of a schema; the channels of one connection share it.
pub type Definition = Arc<(String, String, Vec<u8>)>;

/// Entry of a batch.
#[derive(Debug, Clone, PartialEq)]
pub enum Entry {
    /// A channel, before its first message; ids are the connection's own.
    Channel {
        /// Id of the channel.
        id: u16,
        /// Topic of the channel.
        topic: String,
        /// Encoding of its messages.
        encoding: String,
        /// Schema of its messages.
        schema: Option<Definition>,
    },
    /// A message, of [`MAX_MESSAGE`] bytes at most.
    Message {
        /// Id of its channel.
        channel: u16,
        /// Time of recording \[ns since 1970\].
        log_time: u64,
        /// Time of sending \[ns since 1970\].
        publish_time: u64,
        /// Content of the message.
        data: Vec<u8>,
    },
}

impl Entry {
    /// Approximate size in memory \[bytes\].
    pub(super) fn bytes(&self) -> usize {
        64 + match self {
            Self::Channel { topic, schema, .. } => {
                topic.len() + schema.as_ref().map_or(0, |schema| schema.2.len())
            }
            Self::Message { data, .. } => data.len(),
        }
    }
}

/// Some messages, with the position of their sender's stream after them. A batch is kept whole: best below 1
/// MiB.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Batch {
    /// Entries in the order of arrival.
    pub entries: Vec<Entry>,
    /// Number of messages of this sender up to and including these, those of no rod's topic included.
    pub through: u64,
}

/// End of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Ended by its sender: the open samples become a record. The next stream of a named sender counts from 0
    /// again.
    Complete,
    /// The connection broke: a named sender may resume; of others the open samples become a record that is
    /// cut short.
    Broken,
}

/// Command to the journal's thread.
#[derive(Debug)]
pub(super) enum Command {
    Connect {
        line: u64,
        sender: Option<String>,
        durable: watch::Sender<u64>,
        closed: watch::Sender<Option<Closed>>,
        begins_at: oneshot::Sender<u64>,
    },
    Batch {
        line: u64,
        batch: Batch,
        /// Room in the queue, released when the batch is on disk.
        room: OwnedSemaphorePermit,
    },
    End {
        line: u64,
        how: End,
        done: Option<oneshot::Sender<()>>,
    },
    Rotate,
    Stop,
}

/// Handle of the journal's thread.
#[derive(Debug, Clone)]
pub struct Handle {
    commands: Sender<Command>,
    room: Arc<Semaphore>,
    lines: Arc<AtomicU64>,
}

/// One connection's input of the journal. Dropped without [`Line::end`], its stream counts as broken.
#[derive(Debug)]
pub struct Line {
    number: u64,
    commands: Sender<Command>,
    room: Arc<Semaphore>,
    begins_at: u64,
    durable: watch::Receiver<u64>,
    closed: watch::Receiver<Option<Closed>>,
    is_ended: bool,
}

impl Handle {
    pub(super) fn new(commands: Sender<Command>, room: Arc<Semaphore>) -> Self {
        Self {
            commands,
            room,
            lines: Arc::default(),
        }
    }

    /// Begins or resumes a stream. A sender with a name resumes; an older connection of the same name is
    /// closed.
    ///
    /// # Errors
    /// The daemon stops.
    pub async fn connect(&self, sender: Option<&str>) -> Result<Line, Closed> {
        let number = self.lines.fetch_add(1, Ordering::Relaxed);
        let (durable_sender, durable) = watch::channel(0);
        let (closed_sender, closed) = watch::channel(None);
        let (begins_sender, begins_at) = oneshot::channel();
        let command = Command::Connect {
            line: number,
            sender: sender.map(str::to_owned),
            durable: durable_sender,
            closed: closed_sender,
            begins_at: begins_sender,
        };
        self.commands.send(command).map_err(|_| Closed::Stopping)?;
        // From here on a connection that is given up ends its line.
        let mut line = Line {
            number,
            commands: self.commands.clone(),
            room: Arc::clone(&self.room),
            begins_at: 0,
            durable,
            closed,
            is_ended: false,
        };
        line.begins_at = begins_at.await.map_err(|_| Closed::Stopping)?;
        Ok(line)
    }

    /// Closes the current part and begins another one.
    pub fn rotate(&self) {
        // A journal that stopped needs no new part.
        let _ = self.commands.send(Command::Rotate);
    }

    pub(super) fn stop(&self) {
        let _ = self.commands.send(Command::Stop);
    }
}

impl Line {
    /// Number of messages of this sender that are durable already: it continues with the one after them.
    pub fn begins_at(&self) -> u64 {
        self.begins_at
    }

    /// Appends a batch; waits while the journal's queue is full.
    ///
    /// # Errors
    /// The daemon stops, or another connection took over.
    pub async fn append(&mut self, batch: Batch) -> Result<(), Closed> {
        let bytes: usize = batch.entries.iter().map(Entry::bytes).sum();
        let kib = u32::try_from(bytes / 1024 + 1).map_or(QUEUE_KIB, |kib| kib.min(QUEUE_KIB));
        let room = tokio::select! {
            biased;
            closed = reason(&mut self.closed) => return Err(closed),
            room = Arc::clone(&self.room).acquire_many_owned(kib) => room.map_err(|_| Closed::Stopping)?,
        };
        let command = Command::Batch {
            line: self.number,
            batch,
            room,
        };
        self.commands.send(command).map_err(|_| Closed::Stopping)
    }

    /// Number of messages of this sender that are durable and may be acknowledged.
    pub fn durable(&self) -> watch::Receiver<u64> {
        self.durable.clone()
    }

    /// Ends the stream; returns when the end is durable.
    ///
    /// # Errors
    /// The daemon stops, or another connection took over.
    pub async fn end(mut self, how: End) -> Result<(), Closed> {
        let (done, ended) = oneshot::channel();
        let command = Command::End {
            line: self.number,
            how,
            done: Some(done),
        };
        self.commands.send(command).map_err(|_| Closed::Stopping)?;
        self.is_ended = true;
        ended
            .await
            .map_err(|_| self.closed.borrow().unwrap_or(Closed::Stopping))
    }
}

/// Waits until the line is closed; returns the reason.
async fn reason(closed: &mut watch::Receiver<Option<Closed>>) -> Closed {
    match closed.wait_for(Option::is_some).await {
        Ok(reason) => reason.unwrap_or(Closed::Stopping),
        Err(_) => Closed::Stopping,
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        if !self.is_ended {
            // A stopped journal needs no notice.
            let _ = self.commands.send(Command::End {
                line: self.number,
                how: End::Broken,
                done: None,
            });
        }
    }
}
