//! What came through the sockets, in numbers; read by whoever shows them.

use std::sync::atomic::{AtomicU64, Ordering};

/// What came through the sockets. Totals count from the start of the daemon.
#[derive(Debug, Default)]
pub struct Counts {
    /// Clients that have a place now: they have said something that makes sense.
    pub clients: AtomicU64,
    /// Clients that ever connected, those turned away included.
    pub connections: AtomicU64,
    /// Bytes received.
    pub bytes: AtomicU64,
    /// Messages received, those of no rod's topic included.
    pub messages: AtomicU64,
    /// Messages of no rod's topic; they are not kept.
    pub foreign: AtomicU64,
    /// Streams that ended as they should.
    pub completed: AtomicU64,
    /// Streams cut off.
    pub cut: AtomicU64,
}

impl Counts {
    /// Counts so many more.
    pub(super) fn add(&self, which: impl Fn(&Self) -> &AtomicU64, more: u64) {
        which(self).fetch_add(more, Ordering::Relaxed);
    }
}
