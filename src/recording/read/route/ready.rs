//! Events that are ready to be taken, with the bytes of their samples.

use super::Timed;
use std::collections::{VecDeque, vec_deque};

/// Events that are ready to be taken, first come, first served.
#[derive(Debug, Default)]
pub(in crate::read) struct Ready {
    events: VecDeque<Timed>,
    /// Bytes of their samples, counted as they come and go: a chunk may hold very many small records.
    bytes: usize,
}

impl Ready {
    /// Takes the first event.
    pub fn pop(&mut self) -> Option<Timed> {
        let first = self.events.pop_front()?;
        self.bytes -= first.bytes();
        Some(first)
    }

    /// Moves all events of another to the end.
    pub fn append(&mut self, other: &mut Self) {
        self.events.append(&mut other.events);
        self.bytes += std::mem::take(&mut other.bytes);
    }

    /// Removes all events.
    pub fn clear(&mut self) {
        self.events.clear();
        self.bytes = 0;
    }

    /// Takes all events.
    pub fn take(&mut self) -> vec_deque::IntoIter<Timed> {
        std::mem::take(self).events.into_iter()
    }

    /// Bytes of the samples of all events.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Number of records in all events.
    pub fn records(&self) -> u64 {
        self.events.iter().map(Timed::records).sum()
    }

    /// True if there is no event.
    pub fn is_empty(&self) -> bool {
        self.events.is_empty()
    }
}

impl Extend<Timed> for Ready {
    fn extend<T: IntoIterator<Item = Timed>>(&mut self, events: T) {
        for event in events {
            self.bytes += event.bytes();
            self.events.push_back(event);
        }
    }
}
