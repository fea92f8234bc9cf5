//! Signals to a courier: new events, and its end.

use super::Message;
use super::place::Place;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The courier was asked to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stopped;

/// Shared state between a courier's thread and its owner.
#[derive(Debug, Default)]
pub(super) struct Signal {
    inner: Mutex<Inner>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Inner {
    is_stopped: bool,
    is_woken: bool,
    place: Option<Place>,
    /// Messages sent past the store, the oldest first.
    direct: VecDeque<Message>,
}

/// Largest number of waiting messages that go past the store.
const MOST_DIRECT: usize = 256;

impl Signal {
    /// Notifies the courier that there may be events.
    pub(super) fn wake(&self) {
        self.lock().is_woken = true;
        self.changed.notify_all();
    }

    /// Queues a message that does not come through the store, because the store cannot be written or does not
    /// hold such messages.
    pub(super) fn tell(&self, message: Message) {
        let mut inner = self.lock();
        if inner.direct.len() == MOST_DIRECT {
            inner.direct.pop_front();
        }
        inner.direct.push_back(message);
        inner.is_woken = true;
        drop(inner);
        self.changed.notify_all();
    }

    /// First of the messages that do not come through the store.
    pub(super) fn direct(&self) -> Option<Message> {
        self.lock().direct.front().cloned()
    }

    /// True if every such message was delivered.
    pub(super) fn has_told(&self) -> bool {
        self.lock().direct.is_empty()
    }

    /// Removes a delivered message.
    pub(super) fn delivered(&self, id: &str) {
        self.lock().direct.retain(|message| message.id != id);
    }

    /// Asks the courier to end.
    pub(super) fn stop(&self) {
        self.lock().is_stopped = true;
        self.changed.notify_all();
    }

    /// Position reached; `None` if unknown.
    pub(super) fn place(&self) -> Option<Place> {
        self.lock().place
    }

    /// Notes the position reached.
    pub(super) fn arrive(&self, place: Place) {
        self.lock().place = Some(place);
    }

    /// Runs `act` unless the courier was asked to stop.
    pub(super) fn unless_stopped(&self, act: impl FnOnce()) -> Result<(), Stopped> {
        let inner = self.lock();
        if inner.is_stopped {
            return Err(Stopped);
        }
        act();
        Ok(())
    }

    /// Waits until there may be events, at most `longest`.
    pub(super) fn wait_for_news(&self, longest: Duration) -> Result<(), Stopped> {
        self.wait(longest, |inner| std::mem::take(&mut inner.is_woken))
    }

    /// Waits for `time`, regardless of events.
    pub(super) fn pause(&self, time: Duration) -> Result<(), Stopped> {
        self.wait(time, |_| false)
    }

    fn wait(&self, longest: Duration, mut is_enough: impl FnMut(&mut Inner) -> bool) -> Result<(), Stopped> {
        let begun = Instant::now();
        let mut inner = self.lock();
        loop {
            if inner.is_stopped {
                return Err(Stopped);
            }
            if is_enough(&mut inner) {
                return Ok(());
            }
            let left = longest.saturating_sub(begun.elapsed());
            if left.is_zero() {
                return Ok(());
            }
            let waited = self.changed.wait_timeout(inner, left);
            inner = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
