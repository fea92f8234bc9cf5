//! Views of single records that are kept for the report: of which records, and of none where nobody asks for them.

use super::Site;
use crate::analysis::outcome::Outcome;
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::Timestamp;
use crate::analysis::track::Tracker;
use crate::site::store::StoreError;

/// Interval between snapshots of records \[s\].
const PICTURE_S: i64 = 600;

impl Site {
    /// View of a record to keep, now that its rod's tracker has taken it; `before` is the latest record's start until then.
    pub(super) fn picture(
        &self,
        tracker: &Tracker,
        outcome: &Outcome,
        before: Option<Timestamp>,
    ) -> Result<Option<Snapshot>, StoreError> {
        if self.store.is_transient() {
            return Ok(None);
        }
        let (rod, state) = (outcome.rod(), tracker.state());
        let has_period = !state.periods.is_empty();
        let snapshot = match outcome {
            // Only of the latest record in use: a snapshot with a wrong clock would stay for years.
            Outcome::Identified(identification) => identification
                .measurement
                .as_ref()
                .map(|measurement| measurement.start)
                .filter(|start| state.latest == Some(*start) && before != Some(*start))
                .filter(|start| !has_period || keeps_snapshot(before, *start))
                .and_then(|_| Snapshot::of(tracker.plan().prior(), identification)),
            Outcome::Tabulated(_) => None,
            // The snapshot of a refused record shows the reason. It is kept as rarely, and never replaces that of a used record.
            Outcome::Rejected(rejected) => {
                let before = self.store.refused_picture(rod)?;
                rejected
                    .start
                    .filter(|start| !has_period || keeps_snapshot(before, *start))
                    .and_then(|_| Snapshot::of_rejected(rejected))
            }
        };
        Ok(match &self.pictures {
            None => snapshot,
            Some(pictures) => snapshot.and_then(|snapshot| pictures.complete(rod, snapshot)),
        })
    }
}

/// True if a record is the first of its stretch of [`PICTURE_S`], or the clock went back: by event time
/// alone, so that a replay keeps the same snapshots.
fn keeps_snapshot(before: Option<Timestamp>, start: Timestamp) -> bool {
    let stretch = |time: Timestamp| time.as_nanos().div_euclid(PICTURE_S * 1_000_000_000);
    before.is_none_or(|before| stretch(start) != stretch(before))
}
