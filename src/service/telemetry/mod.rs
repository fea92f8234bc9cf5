//! Telemetry of a running daemon: faults, lasting conditions, counts, logs.

pub mod beat;
mod collect;
pub mod credentials;
pub mod fault;
pub mod health;
mod ledger;
pub mod log;
pub mod metrics;
pub mod owned;
pub mod process;
pub mod report;
mod rods;
pub mod strays;

pub use beat::Beat;
pub use credentials::{Credentials, Via};
pub use fault::Fault;
pub use health::Health;
pub use ledger::Condition;
pub use metrics::Metrics;
pub use report::{Phase, Report, State};
pub use strays::Strays;

use std::sync::Arc;

/// Telemetry of all parts of a daemon, and of the servers that show it.
#[derive(Debug, Clone)]
pub struct Telemetry {
    /// Faults and conditions.
    pub health: Arc<Health>,
    /// Beat of the work loop.
    pub beat: Arc<Beat>,
    /// Counts and gauges.
    pub metrics: Arc<Metrics>,
}

impl Default for Telemetry {
    fn default() -> Self {
        let (health, beat) = (Arc::<Health>::default(), Arc::<Beat>::default());
        let metrics = Arc::new(Metrics::new(Arc::clone(&health), Arc::clone(&beat)));
        Self {
            health,
            beat,
            metrics,
        }
    }
}

impl Telemetry {
    /// Enters a phase. From serving on, the work loop must beat.
    pub fn enter(&self, phase: Phase) {
        self.beat.pass();
        self.health.enter(phase);
    }
}
