//! Work of the pipeline's threads on a job: analyse events, with a mark of the present step.

use super::quarantine::{LAST, Quarantine, Slot};
use super::trial::{self, Trials, Verdict};
use crate::analysis::signal::record::{Event, Record, Rejection};
use crate::recording::read::Place;
use crate::service::telemetry::Metrics;
use crate::site::analyse::{self, Analysed, Known};
use crate::site::driver::{self, Done, Job};
use crate::site::hex::hex;
use crate::site::prepared::Plans;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Instant;

/// The pipeline's threads.
pub struct Workers {
    /// Records in the store when the daemon started; later ones are found by the core.
    known: Known,
    quarantine: Arc<Quarantine>,
    trials: Arc<Trials>,
    metrics: Arc<Metrics>,
    idle: Mutex<Vec<Slot>>,
}

impl Workers {
    /// Threads that skip the records in `known` and record their steps in `quarantine`.
    pub fn new(
        known: Known,
        quarantine: Arc<Quarantine>,
        trials: Arc<Trials>,
        metrics: Arc<Metrics>,
    ) -> Self {
        Self {
            known,
            quarantine,
            trials,
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
        let deaths = self.quarantine.deaths(&name);
        let set_aside = |deaths| {
            let rejection = Rejection::Quarantined { deaths };
            Done::Event(
                quarantined(&event, record.clone(), rejection, plans),
                place.clone(),
            )
        };
        if deaths >= LAST {
            return set_aside(deaths);
        }
        let mut slot = self.idle().pop().unwrap_or_else(|| self.quarantine.slot());
        slot.working_on(&name);
        if deaths > 0 {
            match self.trials.of_analysis(&name, &event) {
                Verdict::Cleared => {}
                // The daemon ends. The mark of its file is not written, so the record is taken at the next start.
                Verdict::Stopped => loop {
                    thread::park();
                },
                Verdict::Died { .. } => {
                    slot.leave();
                    self.idle().push(slot);
                    return set_aside(deaths + trial::DEATHS);
                }
            }
        }
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

/// Name of a record's analysis in the [`Quarantine`].
fn step_of(record: &Record, identity: &[u8; 32]) -> String {
    format!("record {} of rod {}", hex(identity), record.rod)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::outcome::Outcome;
    use crate::analysis::signal::record::{Moment, Timestamp};
    use crate::config::Config;
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
            slot.working_on(&step_of(&record, &record.identity()));
            std::mem::forget(slot);
        }
        let quarantine = Arc::new(Quarantine::open(&store).unwrap());
        let trials = Trials::new(None, store, String::new(), Arc::default());
        let workers = Workers::new(
            Known::new(),
            quarantine,
            Arc::new(trials),
            Telemetry::default().metrics,
        );
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
