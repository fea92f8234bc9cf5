//! Faults counted, conditions remembered, and at most one log line a minute of each kind.

use super::Fault;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The shortest time between two log lines of one kind of fault.
const LOG_EVERY: Duration = Duration::from_secs(60);

/// A fault that lasts.
#[derive(Debug, Clone, PartialEq)]
pub struct Condition {
    /// Its kind.
    pub fault: Fault,
    /// What it is about: a sink, a folder, a file.
    pub about: String,
    /// One sentence.
    pub detail: String,
    /// Since when.
    pub since: Instant,
}

/// The state of health of a daemon; shared by all its threads.
#[derive(Debug, Default)]
pub struct Health {
    inner: Mutex<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    kinds: BTreeMap<Fault, Kind>,
    conditions: BTreeMap<(Fault, String), Condition>,
}

#[derive(Debug, Default)]
struct Kind {
    count: u64,
    logged: Option<Instant>,
    unlogged: u64,
    last: String,
}

impl Health {
    /// Something went wrong: counts it, and logs it unless one of its kind was logged less than a minute ago.
    pub fn fault(&self, fault: Fault, detail: impl Display) {
        let detail = detail.to_string();
        let mut inner = self.lock();
        let kind = inner.kinds.entry(fault).or_default();
        kind.count += 1;
        let now = Instant::now();
        let is_due = kind.logged.is_none_or(|logged| now - logged >= LOG_EVERY);
        let unlogged = if is_due {
            kind.logged = Some(now);
            std::mem::take(&mut kind.unlogged)
        } else {
            kind.unlogged += 1;
            0
        };
        kind.last.clone_from(&detail);
        drop(inner);
        match (is_due, unlogged) {
            (false, _) => {}
            (true, 0) => tracing::warn!(fault = fault.code(), "{detail}"),
            (true, more) => tracing::warn!(
                fault = fault.code(),
                "{detail} (and {more} more since the last line)"
            ),
        }
    }

    /// A fault begins to last, or goes on; counted and logged as [`Health::fault`] when it is new.
    pub fn hold(&self, fault: Fault, about: &str, detail: impl Display) {
        let detail = detail.to_string();
        let key = (fault, about.to_owned());
        let mut inner = self.lock();
        if let Some(known) = inner.conditions.get_mut(&key) {
            known.detail = detail;
            return;
        }
        let condition = Condition {
            fault,
            about: about.to_owned(),
            detail: detail.clone(),
            since: Instant::now(),
        };
        inner.conditions.insert(key, condition);
        drop(inner);
        self.fault(fault, detail);
    }

    /// A lasting fault is over, if it was there.
    pub fn over(&self, fault: Fault, about: &str) {
        if self
            .lock()
            .conditions
            .remove(&(fault, about.to_owned()))
            .is_some()
        {
            tracing::info!(fault = fault.code(), "{about}: over");
        }
    }

    /// The faults that last.
    pub fn conditions(&self) -> Vec<Condition> {
        self.lock().conditions.values().cloned().collect()
    }

    /// How often a fault happened.
    pub fn count(&self, fault: Fault) -> u64 {
        self.lock().kinds.get(&fault).map_or(0, |kind| kind.count)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
