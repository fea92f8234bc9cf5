//! Analyses an event of a source: the same for a replay and for the daemon.

use crate::analysis::identify::{Plan, Refusal};
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
        rod: record.rod,
        rejection: refusal.rejection,
        measurement: refusal.measurement,
        labels: refusal.labels,
    }))
}

/// Runs an event's record through its rod's plan, unless it is one of `known`. A panic of the analysis is a
/// rejection like any other: every record ends as a force or as a reason.
pub fn analyse(event: Event, plans: &BTreeMap<RodId, Plan>, known: &Known) -> Analysed {
    let record = match event {
        Event::Rejected {
            rod,
            start,
            duration_s,
            fs_hz,
            waveform,
            rejection,
        } => {
            let rejected = Rejected {
                rod,
                start,
                duration_s: Some(duration_s),
                fs_hz,
                identity: None,
                readings: Vec::new(),
                rejection,
                measurement: None,
                labels: None,
                waveform,
            };
            return Analysed::Record(Box::new(Outcome::Rejected(Box::new(rejected))));
        }
        Event::Readings { rod, readings } => return Analysed::Readings(rod, readings),
        Event::Record(record) => record,
    };
    let identity = record.identity();
    if known
        .get(&record.rod)
        .is_some_and(|known| known.contains(&identity))
    {
        return Analysed::Known(record.rod, identity);
    }
    // The reader only cuts records of rods of the same configuration the plans were made from.
    let Some(plan) = plans.get(&record.rod) else {
        unreachable!("the rod {} has channels but no plan", record.rod)
    };
    // The plan is only borrowed: nothing shared is left half-changed.
    let outcome = match catch_unwind(AssertUnwindSafe(|| plan.run(&record))) {
        Ok(Ok(identification)) => Outcome::Identified(Box::new(identification)),
        Ok(Err(refusal)) => refused(record, identity, refusal),
        Err(panic) => {
            let detail = message_of(&*panic);
            refused(record, identity, Rejection::Broken { detail }.into())
        }
    };
    Analysed::Record(Box::new(outcome))
}
