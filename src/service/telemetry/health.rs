//! Counts faults, holds conditions, and logs at most one line a minute of each kind.

use super::ledger::Ledger;
use super::{Condition, Credentials, Fault, Phase, Report, State, Strays};
use std::fmt::Display;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The state of health of a daemon; shared by all its threads.
#[derive(Debug, Default)]
pub struct Health {
    ledger: Mutex<Ledger>,
    strays: Strays,
    credentials: Credentials,
}

impl Health {
    /// Makes room for so many conditions of a kind beside the 256 that there is room for.
    pub fn make_room(&self, room: usize) {
        self.ledger().make_room(room);
    }

    /// Counts a fault, and logs it unless one of its kind was logged less than a minute ago.
    pub fn fault(&self, fault: Fault, detail: impl Display) {
        let line = self.ledger().fault(fault, &detail.to_string(), Instant::now());
        log(fault, line);
    }

    /// Begins or continues a lasting fault; counted and logged as [`Health::fault`] when new.
    pub fn hold(&self, fault: Fault, about: &str, detail: impl Display) {
        let line = self
            .ledger()
            .hold(fault, about, &detail.to_string(), Instant::now());
        log(fault, line);
    }

    /// True if this condition holds now.
    pub fn lasts(&self, fault: Fault, about: &str) -> bool {
        self.ledger().lasts(fault, about)
    }

    /// Ends a lasting fault, if present.
    pub fn over(&self, fault: Fault, about: &str) {
        let line = self.ledger().over(fault, about, Instant::now());
        if let Some(line) = line {
            tracing::info!(fault = fault.code(), "{line}");
        }
    }

    /// Logs the lines held back whose minute is over; called every few seconds.
    pub fn tick(&self) {
        let lines = self.ledger().due(Instant::now());
        for (fault, line) in lines {
            log(fault, Some(line));
        }
    }

    /// Sets the phase of the daemon ([`Telemetry::enter`](super::Telemetry::enter)).
    pub(super) fn enter(&self, phase: Phase) {
        self.ledger().enter(phase);
    }

    /// Phase of the daemon.
    pub fn phase(&self) -> Phase {
        self.ledger().phase().clone()
    }

    /// State in one word.
    pub fn state(&self) -> State {
        self.ledger().state(Instant::now())
    }

    /// Report of the present state.
    pub fn report(&self) -> Report {
        self.ledger().report(Instant::now())
    }

    /// Lasting faults.
    pub fn conditions(&self) -> Vec<Condition> {
        self.ledger().conditions()
    }

    /// Received topics that belong to no rod.
    pub fn strays(&self) -> &Strays {
        &self.strays
    }

    /// Credentials of the daemon and its clients.
    pub fn credentials(&self) -> &Credentials {
        &self.credentials
    }

    /// Number of times a fault happened.
    pub fn count(&self, fault: Fault) -> u64 {
        self.ledger().count(fault)
    }

    fn ledger(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Logs the line of a fault, if one is due.
fn log(fault: Fault, line: Option<String>) {
    match line {
        None => {}
        Some(line) if fault.is_grave() => tracing::error!(fault = fault.code(), "{line}"),
        Some(line) => tracing::warn!(fault = fault.code(), "{line}"),
    }
}
