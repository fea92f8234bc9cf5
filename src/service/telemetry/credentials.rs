//! Credentials of the daemon and its clients: ends of certificates, attempts that were refused.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Place of an attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Via {
    /// The sockets that take data.
    Socket,
    /// The page and its API.
    Http,
}

/// Credentials of the daemon and its clients.
#[derive(Debug, Default)]
pub struct Credentials {
    /// End of each certificate \[s since 1970\], by the key that names its file.
    ends_s: Mutex<BTreeMap<&'static str, i64>>,
    socket: AtomicU64,
    http: AtomicU64,
}

impl Credentials {
    /// Sets the end of the certificate in the file that `key` names \[s since 1970\].
    pub fn ends(&self, key: &'static str, end_s: i64) {
        self.lock().insert(key, end_s);
    }

    /// Ends of the certificates \[s since 1970\], by key.
    pub fn all_ends(&self) -> BTreeMap<&'static str, i64> {
        self.lock().clone()
    }

    /// Counts an attempt without valid credentials, or beyond what they allow.
    pub fn denied(&self, at: Via) {
        self.count_of(at).fetch_add(1, Ordering::Relaxed);
    }

    /// Number of such attempts.
    pub fn denials(&self, at: Via) -> u64 {
        self.count_of(at).load(Ordering::Relaxed)
    }

    fn count_of(&self, at: Via) -> &AtomicU64 {
        match at {
            Via::Socket => &self.socket,
            Via::Http => &self.http,
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<&'static str, i64>> {
        self.ends_s.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
