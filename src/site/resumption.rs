//! A rod's tracker from its state in the store: goes on with the segment that belongs to its settings, or begins the next.

use crate::analysis::signal::record::RodId;
use crate::analysis::track::{AlarmEvent, State, TrackPlan, Tracker};
use crate::site::baselines;
use crate::site::store::{Store, StoreError};
use std::fmt;
use std::sync::Arc;

/// A tracker that goes on.
pub struct Resumed {
    /// The tracker.
    pub tracker: Tracker,
    /// Changes of its alarms.
    pub events: Vec<AlarmEvent>,
    /// Change of segment, if its settings changed.
    pub renewed: Option<Renewed>,
}

/// A rod whose settings changed, and with them its segment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Renewed {
    /// The rod.
    pub rod: RodId,
    /// Segment of its new records.
    pub segment: u32,
    /// True if the segment is an earlier one, whose settings are back.
    pub is_found: bool,
    /// Progress of that segment.
    pub goes_on: Progress,
    /// Segment that rests, with its progress; `None` if it had learned nothing.
    pub rests: Option<(u32, Progress)>,
}

/// Progress of a segment's baseline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// True if the baseline is learned.
    pub has_baseline: bool,
    /// Number of its records so far.
    pub records: usize,
}

impl Progress {
    fn of(state: &State) -> Self {
        Self {
            has_baseline: state.segment.baseline.is_some(),
            records: state.learned(),
        }
    }
}

/// Resumes a rod from its state. A state that learned anything is shelved when its settings give way, and is found again
/// with them.
///
/// # Errors
/// The store cannot be read or written.
pub fn resume(store: &mut Store, plan: Arc<TrackPlan>, mut state: State) -> Result<Resumed, StoreError> {
    let rod = plan.rod().clone();
    if baselines::has_same_settings(store, &state, plan.key())? {
        plan.key().clone_into(&mut state.segment.key);
    }
    let number = state.segment.number;
    let has_changed = state.segment.key != plan.key();
    let found = match has_changed {
        true => baselines::shelved(store, &rod, plan.key())?,
        false => None,
    };
    let shelved = match found {
        Some(found) => store.off_the_shelf(&rod, &found.key)?,
        None => None,
    };
    let shelved = shelved.map(|mut shelved: State| {
        plan.key().clone_into(&mut shelved.segment.key);
        shelved
    });
    let rests = (has_changed && state.learned() > 0).then(|| (number, Progress::of(&state)));
    if rests.is_some() {
        store.shelve(&state)?;
    }
    let is_found = shelved.is_some();
    let (tracker, events) = match shelved {
        Some(shelved) => Tracker::take_up(plan, shelved, state),
        None => Tracker::resume(plan, state),
    };
    let segment = tracker.state().segment.number;
    let renewed = (segment != number).then(|| Renewed {
        rod,
        segment,
        is_found,
        goes_on: Progress::of(tracker.state()),
        rests,
    });
    Ok(Resumed {
        tracker,
        events,
        renewed,
    })
}

impl fmt::Display for Renewed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rod, segment, .. } = self;
        let Progress {
            has_baseline,
            records,
        } = self.goes_on;
        match (self.is_found, has_baseline, records) {
            (false, ..) => write!(
                f,
                "the settings of {rod} changed: its new records begin a new baseline (segment {segment})"
            )?,
            (true, true, _) => write!(
                f,
                "the settings of {rod} are those of segment {segment} again: its baseline was found and goes on"
            )?,
            (true, false, 0) => write!(
                f,
                "the settings of {rod} are those of segment {segment} again, whose records lie too far back: its new records begin \
                 the baseline anew"
            )?,
            (true, false, _) => write!(
                f,
                "the settings of {rod} are those of segment {segment} again: the baseline that it was learning was found and goes \
                 on with {records} records"
            )?,
        }
        match self.rests {
            Some((before, rests)) if rests.has_baseline => {
                write!(
                    f,
                    "; the baseline of segment {before} rests until its settings are back"
                )?;
            }
            Some((before, rests)) => write!(
                f,
                "; the baseline that segment {before} was learning rests with {} records until its settings are back",
                rests.records
            )?,
            None => {}
        }
        if self.is_found {
            return Ok(());
        }
        f.write_str("; records kept before are not analysed again")
    }
}
