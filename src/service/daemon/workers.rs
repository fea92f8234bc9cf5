//! Work of the pipeline's threads on a job: analyse events, with a mark of the present step.

use super::quarantine::{Ends, Quarantine, Slot, record_step};
use crate::analysis::signal::record::{Event, Record, Rejection};
use crate::recording::read::Place;
use crate::service::telemetry::Metrics;
use crate::site::analyse::{self, Analysed, Known};
use crate::site::driver::{self, Done, Job};
use crate::site::prepared::Plans;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The pipeline's threads.
pub struct Workers {
    /// Records in the store when the daemon started; later ones are found by the core.
    known: Arc<Known>,
    quarantine: Arc<Quarantine>,
    metrics: Arc<Metrics>,
    idle: Mutex<Vec<Slot>>,
}

impl Workers {
    /// Threads that skip the records in `known` and record their steps in `quarantine`.
    pub fn new(known: Arc<Known>, quarantine: Arc<Quarantine>, metrics: Arc<Metrics>) -> Self {
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
        let step = record_step(record);
        if let Some(ends) = self.quarantine.ends(&step).filter(Ends::is_too_many) {
            let rejection = Rejection::Quarantined { deaths: ends.alone };
            return Done::Event(quarantined(&event, record.clone(), rejection, plans), place);
        }
        let mut slot = self.idle().pop().unwrap_or_else(|| self.quarantine.slot());
        slot.working_on(&step);
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

/// The outcome of an event that is set aside.
fn quarantined(event: &Event, record: Record, rejection: Rejection, plans: &Plans) -> Analysed {
    let sensors = match event {
        Event::Moment(moment) => plans
            .get(&moment.rod)
            .map(|plan| plan.sensors_unused(moment, &rejection.to_string())),
        _ => None,
    };
    let identity = record.identity();
    let refused = analyse::refused(record, identity, rejection.into()).with_sensors(sensors);
    Analysed::Record(Box::new(refused))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::outcome::Outcome;
    use crate::analysis::signal::record::{Moment, Timestamp};
    use crate::config::Config;
    use crate::service::daemon::quarantine::LAST;
    use crate::service::telemetry::Telemetry;
    use crate::site::prepared;

    #[test]
    fn a_quarantined_moment_names_its_sensors() {
        let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/todi.toml")).unwrap();
        let further = "[[rod.sensor]]\ntopic = \"/second\"\nat = 0.1\n[rod.channel]\nat = 0.4\n";
        let config = Config::parse(&text.replace("[rod.channel]\n", further), "several.toml").unwrap();
        let plans = Arc::new(prepared::plans(&config, |_| |_, _| {}).unwrap());
        let rod = config.rods[0].analysis.rod.clone();
        let record = Record {
            rod: rod.clone(),
            start: Timestamp::from_nanos(0),
            fs_hz: 100.0,
            samples: vec![0.0; 100],
            temperature_c: None,
            readings: Vec::new(),
            excitation: None,
            clock_sd: 0.0,
            flags: Vec::new(),
        };
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        for _ in 0..=LAST {
            let mut slot = Arc::new(Quarantine::open(&store).unwrap()).slot();
            slot.working_on(&record_step(&record));
            std::mem::forget(slot);
        }
        let quarantine = Arc::new(Quarantine::open(&store).unwrap());
        let workers = Workers::new(Arc::default(), quarantine, Telemetry::default().metrics);
        let job = Job::Event {
            event: Event::Moment(Moment {
                rod,
                seen: vec![(0, Event::Record(record))],
                absent: vec![1],
                is_early: false,
            }),
            place: Place {
                file: Arc::from("a.mcap"),
                origin: Arc::from("a.mcap"),
                bytes: 0,
                records: 1,
                at: Timestamp::from_nanos(0),
                reached: Arc::from([]),
            },
            plans,
            load: None,
        };
        let Done::Event(Analysed::Record(outcome), _) = workers.work(job) else {
            panic!("a record");
        };
        let sensors = outcome.sensors().unwrap();
        assert!(matches!(*outcome, Outcome::Rejected(_)) && sensors.used.is_empty());
        let why: Vec<&str> = sensors.left_out.iter().map(|out| out.why.as_str()).collect();
        assert_eq!(sensors.left_out[1].sensor, "/second");
        assert!(
            why[0].contains("ended the program") && why[1].contains("no record"),
            "{why:?}"
        );
    }
}
