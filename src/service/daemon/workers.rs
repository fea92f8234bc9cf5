//! Work of the pipeline's threads on a job: analyse events, with a mark of the present step.

use super::quarantine::{Quarantine, Slot};
use crate::analysis::signal::record::{Event, Record, Rejection};
use crate::recording::read::Place;
use crate::service::telemetry::Metrics;
use crate::site::analyse::{self, Analysed, Known};
use crate::site::driver::{self, Done, Job};
use crate::site::hex::hex;
use crate::site::prepared::Plans;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The pipeline's threads.
pub struct Workers {
    /// Records in the store when the daemon started; later ones are found by the core.
    known: Known,
    quarantine: Arc<Quarantine>,
    metrics: Arc<Metrics>,
    idle: Mutex<Vec<Slot>>,
}

impl Workers {
    /// Threads that skip the records in `known` and record their steps in `quarantine`.
    pub fn new(known: Known, quarantine: Arc<Quarantine>, metrics: Arc<Metrics>) -> Self {
        Self {
            known,
            quarantine,
            metrics,
            idle: Mutex::default(),
        }
    }

    /// Does the part of a job that can be done before its turn.
    pub fn work(&self, job: Job) -> Done {
        match job {
            Job::Event {
                event: event @ (Event::Record(_) | Event::Moment(_)),
                place,
                plans,
                load,
            } => {
                let done = self.record(event, place, &plans);
                drop(load);
                done
            }
            other => driver::work(other, &self.known),
        }
    }

    fn record(&self, event: Event, place: Place, plans: &Plans) -> Done {
        let is_known = analyse::known_by(&event, &self.known).is_some();
        let Some(record) = event.record().filter(|_| !is_known) else {
            return Done::Event(analyse::analyse(event, plans, &self.known), place);
        };
        let name = step_of(record, &record.identity());
        if self.quarantine.is_quarantined(&name)
            && let Event::Record(record) = event.clone().into_first()
        {
            let deaths = self.quarantine.deaths(&name);
            let identity = record.identity();
            let refused = analyse::refused(record, identity, Rejection::Quarantined { deaths }.into());
            return Done::Event(Analysed::Record(Box::new(refused)), place);
        }
        let mut slot = self.idle().pop().unwrap_or_else(|| self.quarantine.slot());
        slot.working_on(&name);
        let begun = Instant::now();
        let analysed = analyse::analyse(event, plans, &self.known);
        self.metrics.analysis(begun.elapsed());
        slot.idle();
        self.idle().push(slot);
        Done::Event(analysed, place)
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Slot>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Name of a record's analysis in the [`Quarantine`].
fn step_of(record: &Record, identity: &[u8; 32]) -> String {
    format!("record {} of rod {}", hex(identity), record.rod)
}
