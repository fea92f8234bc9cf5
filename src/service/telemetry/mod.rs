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

pub use beat::{Beat, Beats};
pub use credentials::{Credentials, Via};
pub use fault::Fault;
pub use health::Health;
pub use ledger::Condition;
pub use metrics::Metrics;
pub use report::{Phase, Report, State};
pub use strays::Strays;

use beat::LONGEST_STEP;
use std::sync::Arc;
use std::time::Instant;

/// Telemetry of all parts of a daemon, and of the servers that show it.
#[derive(Debug, Clone)]
pub struct Telemetry {
    /// Faults and conditions.
    pub health: Arc<Health>,
    /// Beat of the work loop.
    pub beat: Arc<Beat>,
    /// Beats of the threads before it.
    pub beats: Arc<Beats>,
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
            beats: Arc::default(),
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

    /// Takes a beat of the work loop. It counts only while the threads before it come round as well: a work loop to which
    /// nothing can come measures nothing. One that does not is a condition.
    pub fn beat(&self) {
        self.beat_at(Instant::now());
    }

    fn beat_at(&self, now: Instant) {
        let mut is_alive = true;
        for (name, age) in self.beats.ages_at(now) {
            if age < LONGEST_STEP {
                self.health.over(Fault::Stalled, name);
                continue;
            }
            let detail = format!(
                "the {name} does not come back from a step of {} s: a disk or a folder of another machine that does not answer, or \
                 a file that never ends; nothing is measured meanwhile",
                age.as_secs()
            );
            self.health.hold(Fault::Stalled, name, detail);
            is_alive = false;
        }
        if is_alive {
            self.beat.pass();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_thread_that_hangs_stops_the_beat_of_the_work_loop() {
        let (begun, telemetry) = (Instant::now(), Telemetry::default());
        let reader = telemetry.beats.of("reader");
        std::thread::sleep(Duration::from_millis(30));
        let later = Instant::now() + LONGEST_STEP;
        telemetry.beat_at(later);
        assert!(telemetry.health.lasts(Fault::Stalled, "reader"));
        assert!(telemetry.beat.age() >= Duration::from_millis(20));
        // It comes round again.
        reader.pass();
        telemetry.beat();
        assert!(!telemetry.health.lasts(Fault::Stalled, "reader"));
        assert!(telemetry.beat.age() + Duration::from_millis(20) < begun.elapsed());
    }
}
