//! Wakes the reader when there is new data.

use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Wakes one thread; a ring that comes before the wait is not lost.
#[derive(Debug, Default)]
pub struct Bell {
    has_rung: Mutex<bool>,
    changed: Condvar,
}

impl Bell {
    /// Wakes the waiting thread, or the next one to wait.
    pub fn ring(&self) {
        *self.has_rung.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.changed.notify_one();
    }

    /// Waits until it rings, at most for `limit`.
    pub fn wait(&self, limit: Duration) {
        let has_rung = self.has_rung.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut has_rung, _) = self
            .changed
            .wait_timeout_while(has_rung, limit, |has_rung| !*has_rung)
            .unwrap_or_else(PoisonError::into_inner);
        *has_rung = false;
    }
}
