//! Analyses an event of a source: the same for a replay and for the daemon.

use crate::analysis::identify::{Identification, Plan, Refusal};
use crate::analysis::outcome::{Outcome, Rejected};
use crate::analysis::signal::record::{Envelope, Reading, Record, Rejection, RodId};
use crate::recording::read::Event;
use crate::site::ordered_map::message_of;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Identities of the records that need not be analysed again, by rod.
pub type Known = HashMap<RodId, HashSet<[u8; 32]>>;

/// Result of an event.
pub enum Analysed {
    /// Outcome of a record.
    Record(Box<Outcome>),
    /// A record that was known before its analysis.
    Known(RodId, [u8; 32]),
    /// Temperatures that belong to no record.
    Readings(RodId, Vec<Reading>),
}

impl Analysed {
    /// The rod of the result.
    pub fn rod(&self) -> &RodId {
        match self {
            Self::Record(outcome) => outcome.rod(),
            Self::Known(rod, _) | Self::Readings(rod, _) => rod,
        }
    }
}

/// Last record of each rod that passed, known before or not: it identifies the record that temperatures
/// follow.
#[derive(Debug, Clone, Default)]
pub struct LastSeen(HashMap<RodId, [u8; 32]>);

impl LastSeen {
    /// Notes the record of a rod that passes.
    pub fn note(&mut self, rod: &RodId, identity: [u8; 32]) {
        match self.0.get_mut(rod) {
            Some(last) => *last = identity,
            None => {
                self.0.insert(rod.clone(), identity);
            }
        }
    }

    /// Records that the result of an event passes, and returns the record of its rod that passed before.
    pub fn pass(&mut self, analysed: &Analysed) -> Option<[u8; 32]> {
        let (rod, identity) = match analysed {
            Analysed::Known(rod, identity) => (rod, Some(*identity)),
            Analysed::Record(outcome) => (outcome.rod(), outcome.identity()),
            Analysed::Readings(rod, _) => (rod, None),
        };
        let before = self.0.get(rod).copied();
        if let Some(identity) = identity {
            self.note(rod, identity);
        }
        before
    }
}

/// Outcome of a record that gives no force.
pub fn refused(record: Record, identity: [u8; 32], refusal: Refusal) -> Outcome {
    let waveform = match refusal.measurement {
        Some(_) => None,
        None => Some(Envelope::of(&record.samples, record.fs_hz)),
    };
    Outcome::Rejected(Box::new(Rejected {
        waveform,
        start: Some(record.start),
        duration_s: Some(record.duration_s()),
        fs_hz: Some(record.fs_hz),
        identity: Some(identity),
        readings: record.readings,
        measurement: refusal.measurement,
        labels: refusal.labels,
        ..Rejected::new(record.rod, refusal.rejection)
    }))
}

/// The record by which an event is known already.
pub fn known_by(event: &Event, known: &Known) -> Option<[u8; 32]> {
    let known = known.get(event.rod())?;
    let is_known = |record: &Record| Some(record.identity()).filter(|identity| known.contains(identity));
    match event {
        Event::Record(record) => is_known(record),
        // A moment is kept under the record that led.
        Event::Moment(moment) => moment.records().find_map(|(_, record)| is_known(record)),
        Event::Rejected { .. } | Event::Readings { .. } => None,
    }
}

/// Runs an event's record or moment through its rod's plan, unless it is one of `known`. A panic of the analysis is a
/// rejection like any other: every record ends as a force or as a reason.
pub fn analyse(event: Event, plans: &BTreeMap<RodId, Plan>, known: &Known) -> Analysed {
    analyse_by(event, plans, known, Plan::run)
}

/// [`analyse`] with a way of its own to run a record of one sensor through its plan, which gives the same.
pub fn analyse_by(
    event: Event,
    plans: &BTreeMap<RodId, Plan>,
    known: &Known,
    run: impl Fn(&Plan, &Record) -> Result<Identification, Refusal>,
) -> Analysed {
    if let Some(identity) = known_by(&event, known) {
        return Analysed::Known(event.rod().clone(), identity);
    }
    // The reader only cuts records of rods of the same configuration the plans were made from.
    let plan = |rod: &RodId| match plans.get(rod) {
        Some(plan) => plan,
        None => unreachable!("the rod {rod} has channels but no plan"),
    };
    let (found, sensors) = match &event {
        Event::Rejected { .. } | Event::Readings { .. } => (None, None),
        Event::Record(record) => (Some(caught(|| run(plan(&record.rod), record))), None),
        Event::Moment(moment) if event.record().is_none() => {
            (None, Some(plan(&moment.rod).sensors_unused(moment, "")))
        }
        Event::Moment(moment) => {
            let mut sensors = None;
            let found = caught(|| {
                let (found, named) = plan(&moment.rod).run_moment(moment);
                sensors = Some(named);
                found
            });
            let broken = || plan(&moment.rod).sensors_unused(moment, "the analysis of the moment broke");
            (Some(found), sensors.or_else(|| Some(broken())))
        }
    };
    let outcome = match (event.into_first(), found) {
        (_, Some(Ok(identification))) => Outcome::Identified(Box::new(identification)),
        (Event::Record(record), Some(Err(refusal))) => {
            let identity = record.identity();
            refused(record, identity, refusal)
        }
        (Event::Readings { rod, readings }, _) => return Analysed::Readings(rod, readings),
        (
            Event::Rejected {
                rod,
                start,
                duration_s,
                fs_hz,
                waveform,
                rejection,
            },
            _,
        ) => Outcome::Rejected(Box::new(Rejected {
            start,
            duration_s: Some(duration_s),
            fs_hz,
            waveform,
            ..Rejected::new(rod, rejection)
        })),
        (Event::Record(_) | Event::Moment(_), _) => unreachable!("every record is analysed"),
    };
    Analysed::Record(Box::new(outcome.with_sensors(sensors)))
}

/// A panic of the analysis as a refusal.
fn caught(run: impl FnOnce() -> Result<Identification, Refusal>) -> Result<Identification, Refusal> {
    // The plan is only borrowed: nothing shared is left half-changed.
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|panic| {
        let detail = message_of(&*panic);
        Err(Rejection::Broken { detail }.into())
    })
}
