//! Work of the pipeline's threads on a job: analyse events, with a mark of the present step.

use super::Job;
use super::core::Done;
use super::suspects::{Slot, Suspects};
use crate::analysis::signal::record::{Event, Record, Rejection};
use crate::recording::read::Place;
use crate::service::telemetry::Metrics;
use crate::site::analyse::{self, Analysed, Known};
use crate::site::prepared::Generation;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The pipeline's threads.
pub struct Workers {
    /// Records in the store when the daemon started; later ones are found by the core.
    known: Known,
    suspects: Arc<Suspects>,
    metrics: Arc<Metrics>,
    idle: Mutex<Vec<Slot>>,
}

impl Workers {
    /// Workers that skip `known` records and mark their steps in `suspects`.
    pub fn new(known: Known, suspects: Arc<Suspects>, metrics: Arc<Metrics>) -> Self {
        Self {
            known,
            suspects,
            metrics,
            idle: Mutex::default(),
        }
    }

    /// Does the part of a job that can be done before its turn.
    pub fn work(&self, job: Job) -> Done {
        match job {
            Job::Event {
                event: Event::Record(record),
                place,
                generation,
                load,
            } => {
                let done = self.record(record, place, &generation);
                drop(load);
                done
            }
            Job::Event {
                event,
                place,
                generation,
                ..
            } => Done::Event(analyse::analyse(event, &generation.plans, &self.known), place),
            other => Done::Job(other),
        }
    }

    fn record(&self, record: Record, place: Place, generation: &Generation) -> Done {
        let identity = record.identity();
        let is_known = |known: &Known| {
            known
                .get(&record.rod)
                .is_some_and(|known| known.contains(&identity))
        };
        if is_known(&self.known) {
            return Done::Event(Analysed::Known(record.rod, identity), place);
        }
        let name = step_of(&record, &identity);
        if self.suspects.is_condemned(&name) {
            let deaths = self.suspects.deaths(&name);
            let refused = analyse::refused(record, identity, Rejection::Quarantined { deaths }.into());
            return Done::Event(Analysed::Record(Box::new(refused)), place);
        }
        let mut slot = self.idle().pop().unwrap_or_else(|| self.suspects.slot());
        slot.working_on(&name);
        let begun = Instant::now();
        let analysed = analyse::analyse(Event::Record(record), &generation.plans, &self.known);
        self.metrics.analysis(begun.elapsed());
        slot.idle();
        self.idle().push(slot);
        Done::Event(analysed, place)
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Slot>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Name of a record's analysis among the [`Suspects`].
fn step_of(record: &Record, identity: &[u8; 32]) -> String {
    let digits: String = identity.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("record {digits} of rod {}", record.rod)
}
