//! A site opened: the tracker of each rod resumed from the store, what is no longer configured retired.

use super::{Site, row};
use crate::analysis::track::alarm::Board;
use crate::analysis::track::{RodState, State, TrackPlan, Tracker};
use crate::site::prepared::Provenance;
use crate::site::resumption::{self, Resumed};
use crate::site::store::{Commit, RodRow, Store, StoreError};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

impl Site {
    /// Resumes from the store. A rod whose numbers have another meaning now begins a new segment, or goes on with one of before.
    ///
    /// # Errors
    /// The store cannot be read or written.
    pub fn open(
        plans: impl IntoIterator<Item = Arc<TrackPlan>>,
        mut store: Store,
        provenance: Provenance<'_>,
    ) -> Result<Self, StoreError> {
        store.keep_config(provenance.hash, provenance.site, provenance.effective)?;
        let mut states = store.states()?;
        let unfollowed_before = store.unfollowed()?;
        let (mut trackers, mut emulators) = (BTreeMap::new(), BTreeMap::new());
        let (mut renewed, mut fresh) = (Vec::new(), Vec::new());
        for plan in plans {
            let rod = plan.rod().clone();
            emulators.insert(rod.clone(), plan.emulator());
            let tracker = match states.remove(&rod) {
                None => {
                    fresh.push(rod.clone());
                    Tracker::new(plan)
                }
                Some(state) => {
                    let resumed = resumption::resume(&mut store, plan, state)?;
                    let Resumed { tracker, events, .. } = resumed;
                    let is_renewed = resumed.renewed.is_some();
                    renewed.extend(resumed.renewed);
                    if is_renewed || unfollowed_before.contains(&rod) {
                        store.commit(&Commit {
                            rod: Some(row(&tracker, &tracker.rod_state(), &events)),
                            ..Commit::default()
                        })?;
                    }
                    tracker
                }
            };
            trackers.insert(rod, tracker);
        }
        if !fresh.is_empty() {
            // A rod has a row before anything has come of it.
            store.begin_group()?;
            for tracker in fresh.iter().filter_map(|rod| trackers.get(rod)) {
                store.commit(&Commit {
                    rod: Some(row(tracker, &tracker.rod_state(), &[])),
                    ..Commit::default()
                })?;
            }
            store.end_group()?;
        }
        let (untouched, mut retired): (BTreeMap<_, _>, BTreeMap<_, _>) =
            states.into_iter().partition(|(_, state)| state.is_untouched());
        for state in untouched.into_values() {
            forget(&mut store, state)?;
        }
        // A rod of another site with the same store is not gone.
        let mut unfollowed = Vec::new();
        if sites_in(&store)?.len() == 1 {
            for state in retired.values_mut() {
                if !unfollowed_before.contains(&state.rod) {
                    unfollowed.push(state.rod.clone());
                    store.retire(state)?;
                }
            }
        }
        retired.retain(|_, state| !state.alarms.is_empty());
        Ok(Self {
            trackers,
            emulators,
            retired,
            store,
            config_hash: provenance.hash.to_owned(),
            renewed,
            unfollowed,
            expected: BTreeMap::new(),
            pictures: None,
        })
    }

    /// Continues with another configuration and the same store.
    ///
    /// # Errors
    /// The store cannot be read or written; the site is given up.
    pub fn reload(
        self,
        plans: impl IntoIterator<Item = Arc<TrackPlan>>,
        provenance: Provenance<'_>,
    ) -> Result<Self, StoreError> {
        Self::open(plans, self.store, provenance)
    }
}

/// Removes a rod from the store that is no longer configured and never had data; its alarm of missing data
/// ends.
fn forget(store: &mut Store, mut state: State) -> Result<(), StoreError> {
    let rod = state.rod.clone();
    if let Some(told) = state.alarms.iter().map(|alarm| alarm.told).max() {
        let mut board = Board::new(&rod, state.segment.number, &mut state.alarms);
        board.clear_all(told);
        let events = board.into_events();
        store.commit(&Commit {
            rod: Some(RodRow {
                stands: &RodState::Learning {
                    records: 0,
                    periods: 0,
                },
                state: &state,
                closed: &[],
                events: &events,
            }),
            ..Commit::default()
        })?;
    }
    store.forget_rod(&rod)
}

fn sites_in(store: &Store) -> Result<BTreeSet<String>, StoreError> {
    Ok(store.configs()?.into_iter().map(|[_, site, _]| site).collect())
}

/// Other sites with records in a store.
///
/// # Errors
/// The store cannot be read.
pub fn others_in(store: &Store, site: &str) -> Result<Vec<String>, StoreError> {
    let sites = sites_in(store)?;
    if sites.contains(site) {
        return Ok(Vec::new());
    }
    Ok(sites.into_iter().collect())
}
