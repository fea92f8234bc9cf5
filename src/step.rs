//! From an event of a source to what came of it: the same for a replay and for the daemon.

use crate::analysis::Plan;
use crate::outcome::{Outcome, Rejected};
use crate::record::{Reading, RodId};
use crate::source::Event;
use crate::store::Position;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;

/// Records that need not be analysed again.
pub type Known = HashMap<RodId, HashSet<[u8; 32]>>;

/// Where in its recording a record ended.
#[derive(Debug, Clone)]
pub struct Place {
    /// The recording's name.
    pub file: Arc<str>,
    /// Bytes read.
    pub bytes: u64,
    /// Records found.
    pub records: u64,
}

impl Place {
    /// As the store keeps it.
    pub fn position(&self) -> Position<'_> {
        Position {
            name: &self.file,
            bytes: self.bytes,
            records: self.records,
        }
    }
}

/// What came of an event.
pub enum Analysed {
    /// A record's outcome.
    Record(Box<Outcome>),
    /// A record that was known before it was analysed.
    Known(RodId, [u8; 32]),
    /// Temperatures that no record left with.
    Readings(RodId, Vec<Reading>),
}

/// Runs an event's record through its rod's plan, unless it is one of `known`.
pub fn analyse(event: Event, plans: &BTreeMap<RodId, Plan>, known: &Known) -> Analysed {
    let record = match event {
        Event::Rejected {
            rod,
            start,
            duration_s,
            rejection,
        } => {
            let rejected = Rejected {
                rod,
                start,
                duration_s: Some(duration_s),
                fs_hz: None,
                identity: None,
                readings: Vec::new(),
                rejection,
            };
            return Analysed::Record(Box::new(Outcome::Rejected(Box::new(rejected))));
        }
        Event::Readings { rod, readings } => return Analysed::Readings(rod, readings),
        Event::Record(record) => record,
    };
    if let Some(known) = known.get(&record.rod) {
        let identity = record.identity();
        if known.contains(&identity) {
            return Analysed::Known(record.rod, identity);
        }
    }
    let outcome = match plans.get(&record.rod).map(|plan| plan.run(&record)) {
        Some(Ok(identification)) => Outcome::Identified(Box::new(identification)),
        Some(Err(rejection)) => Outcome::Rejected(Box::new(Rejected {
            start: Some(record.start),
            duration_s: Some(record.duration_s()),
            fs_hz: Some(record.fs_hz),
            identity: Some(record.identity()),
            readings: record.readings,
            rod: record.rod,
            rejection,
        })),
        // The reader only cuts records of rods of the same configuration the plans were made from.
        None => unreachable!("the rod {} has channels but no plan", record.rod),
    };
    Analysed::Record(Box::new(outcome))
}
