//! Messages of the chunks that overlap in time, put in the order of their log times.

/// Where a message stands. Of equal times the one that stands first in the file comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry {
    /// Log time \[ns\].
    pub time: u64,
    /// Number of its chunk in the file.
    pub chunk: u32,
    /// Begin of its record in the chunk \[bytes\].
    pub offset: u32,
    pub channel: u16,
}

/// Bytes of an entry, and of room to sort it.
pub(super) const WEIGHT: usize = 2 * size_of::<Entry>();

/// Messages that may still come after others.
#[derive(Default)]
pub(super) struct Window {
    /// Ascending.
    pending: Vec<Entry>,
}

impl Window {
    /// Adds the messages of a chunk.
    pub fn add(&mut self, entries: impl IntoIterator<Item = Entry>) {
        self.pending.extend(entries);
        // Runs that are in order cost a merge.
        self.pending.sort();
    }

    /// Takes those before a time \[ns\], or all of them.
    pub fn settled(&mut self, until: Option<u64>) -> impl Iterator<Item = Entry> {
        let count = until.map_or(self.pending.len(), |until| {
            self.pending.partition_point(|entry| entry.time < until)
        });
        self.pending.drain(..count)
    }

    /// The earliest message.
    pub fn first(&self) -> Option<&Entry> {
        self.pending.first()
    }

    /// Number of messages.
    pub fn len(&self) -> usize {
        self.pending.len()
    }
}
