//! Delivery positions of the sinks on their way to the core thread.
//!
//! A thread of its own waits for a place in the queue of jobs, which may be full for hours while an archive is read: a
//! courier must not wait with its next alarm for that. Marks that wait are joined: only the latest of a sink counts.

use std::collections::BTreeMap;
use std::io;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

/// Callback for the number of the latest event delivered to a sink, by the sink's id; waits for its turn, and
/// returns false when nothing receives it any more.
pub type Delivered = Box<dyn FnMut(String, i64) -> bool + Send>;

/// Marks that wait to be reported.
#[derive(Debug, Default)]
pub(super) struct Marks {
    inner: Mutex<Inner>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Inner {
    waiting: BTreeMap<String, i64>,
    is_over: bool,
}

impl Marks {
    /// Starts the thread that reports marks to `delivered`; when the receiver is disconnected, it has ended
    /// and `delivered` is dropped.
    pub(super) fn start(self: &Arc<Self>, delivered: Delivered) -> io::Result<Receiver<()>> {
        let marks = Arc::clone(self);
        let (ending, ended) = sync_channel(0);
        thread::Builder::new()
            .name("sink marks".to_owned())
            .spawn(move || {
                marks.report(delivered);
                drop(ending);
            })?;
        Ok(ended)
    }

    /// Sets the latest event delivered to a sink.
    pub(super) fn put(&self, mark: &str, through: i64) {
        self.lock().waiting.insert(mark.to_owned(), through);
        self.changed.notify_all();
    }

    /// Ends the input; waiting marks are still reported.
    pub(super) fn end(&self) {
        self.lock().is_over = true;
        self.changed.notify_all();
    }

    fn report(&self, mut delivered: Delivered) {
        loop {
            let mut inner = self.lock();
            while inner.waiting.is_empty() {
                if inner.is_over {
                    return;
                }
                inner = self.changed.wait(inner).unwrap_or_else(PoisonError::into_inner);
            }
            let waiting = std::mem::take(&mut inner.waiting);
            drop(inner);
            for (sink, through) in waiting {
                if !delivered(sink, through) {
                    return;
                }
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
