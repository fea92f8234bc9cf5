//! Counts of the sockets' traffic.

use std::sync::atomic::{AtomicU64, Ordering};

/// Counts of the sockets' traffic. Totals are from the start of the daemon.
#[derive(Debug, Default)]
pub struct Counts {
    /// Present clients that have sent valid data.
    pub clients: AtomicU64,
    /// Number of connections, those turned away included.
    pub connections: AtomicU64,
    /// Number of bytes received.
    pub bytes: AtomicU64,
    /// Number of messages received, those of no rod's topic included.
    pub messages: AtomicU64,
    /// Number of messages of no rod's topic, which are not kept.
    pub foreign: AtomicU64,
    /// Number of streams that ended properly.
    pub completed: AtomicU64,
    /// Number of streams cut off.
    pub cut: AtomicU64,
}

impl Counts {
    /// Adds to one of the counts.
    pub(super) fn add(&self, which: impl Fn(&Self) -> &AtomicU64, more: u64) {
        which(self).fetch_add(more, Ordering::Relaxed);
    }
}
