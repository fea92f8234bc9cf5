//! One site: the trackers of its rods, folded in the order records come.

use crate::outcome::Outcome;
use crate::record::RodId;
use crate::track::{Peer, TrackPlan, Tracker, Verdict};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The rods of a site as they stand.
pub struct Site {
    trackers: BTreeMap<RodId, Tracker>,
}

impl Site {
    /// A site of which nothing is known yet.
    pub fn new(plans: impl Iterator<Item = Arc<TrackPlan>>) -> Self {
        Self {
            trackers: plans
                .map(|plan| (plan.rod().clone(), Tracker::new(plan)))
                .collect(),
        }
    }

    /// Takes what came of one record; `None` for a rod the site does not have, or frequencies without a time.
    pub fn take(&mut self, outcome: &Outcome) -> Option<Verdict> {
        let input = outcome.input()?;
        let peers: Vec<Peer> = self
            .trackers
            .iter()
            .filter(|(rod, _)| *rod != outcome.rod())
            .map(|(_, tracker)| tracker.as_peer())
            .collect();
        Some(self.trackers.get_mut(outcome.rod())?.step(&input, &peers))
    }
}
