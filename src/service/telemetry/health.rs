//! Faults counted, conditions remembered, and at most one log line a minute of each kind.

use super::ledger::Ledger;
use super::{Condition, Fault, Phase, Report, State, Strays};
use std::fmt::Display;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The state of health of a daemon; shared by all its threads.
#[derive(Debug, Default)]
pub struct Health {
    ledger: Mutex<Ledger>,
    strays: Strays,
}

impl Health {
    /// Something went wrong: counts it, and logs it unless one of its kind was logged less than a minute ago.
    pub fn fault(&self, fault: Fault, detail: impl Display) {
        let line = self.ledger().fault(fault, &detail.to_string(), Instant::now());
        log(fault, line);
    }

    /// A fault begins to last, or goes on; counted and logged as [`Health::fault`] when it is new.
    pub fn hold(&self, fault: Fault, about: &str, detail: impl Display) {
        let line = self
            .ledger()
            .hold(fault, about, &detail.to_string(), Instant::now());
        log(fault, line);
    }

    /// Whether this lasts now.
    pub fn lasts(&self, fault: Fault, about: &str) -> bool {
        let conditions = self.conditions();
        conditions
            .iter()
            .any(|lasting| lasting.fault == fault && lasting.about == about)
    }

    /// A lasting fault is over, if it was there.
    pub fn over(&self, fault: Fault, about: &str) {
        let line = self.ledger().over(fault, about, Instant::now());
        if let Some(line) = line {
            tracing::info!(fault = fault.code(), "{line}");
        }
    }

    /// Logs what was held back and whose minute is over; called every few seconds.
    pub fn tick(&self) {
        let lines = self.ledger().due(Instant::now());
        for (fault, line) in lines {
            log(fault, Some(line));
        }
    }

    /// The daemon has come this far ([`Telemetry::enter`](super::Telemetry::enter)).
    pub(super) fn enter(&self, phase: Phase) {
        self.ledger().enter(phase);
    }

    /// How far the daemon has come.
    pub fn phase(&self) -> Phase {
        self.ledger().phase().clone()
    }

    /// Everything in one word.
    pub fn state(&self) -> State {
        self.ledger().state(Instant::now())
    }

    /// Everything, as it is now.
    pub fn report(&self) -> Report {
        self.ledger().report(Instant::now())
    }

    /// The faults that last.
    pub fn conditions(&self) -> Vec<Condition> {
        self.ledger().conditions()
    }

    /// Topics that came and belong to no rod.
    pub fn strays(&self) -> &Strays {
        &self.strays
    }

    /// How often a fault happened.
    pub fn count(&self, fault: Fault) -> u64 {
        self.ledger().count(fault)
    }

    fn ledger(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The line of a fault, if one is due.
fn log(fault: Fault, line: Option<String>) {
    match line {
        None => {}
        Some(line) if fault.is_grave() => tracing::error!(fault = fault.code(), "{line}"),
        Some(line) => tracing::warn!(fault = fault.code(), "{line}"),
    }
}
