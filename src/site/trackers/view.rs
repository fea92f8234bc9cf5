//! The rods of a site as others ask about them: since when each is silent, unread, unheard, and their status.

use super::Site;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Kind, State};
use crate::site::resumption::Renewed;
use crate::site::store::{Standing, StoreError};

impl Site {
    /// Rods whose numbers have another meaning since the site was opened.
    pub fn renewed(&self) -> &[Renewed] {
        &self.renewed
    }

    /// Rods of the store that the configuration had until the site was opened.
    pub fn unfollowed(&self) -> &[RodId] {
        &self.unfollowed
    }

    /// Rods with the start of their latest accepted record.
    pub fn latest(&self) -> impl Iterator<Item = (&RodId, Option<Timestamp>)> {
        self.trackers
            .iter()
            .map(|(rod, tracker)| (rod, tracker.state().latest))
    }

    /// Rods with the time since which each is silent: since its latest record, or since it is expected.
    pub fn silent_since(&self) -> impl Iterator<Item = (&RodId, Option<Timestamp>)> {
        self.latest()
            .map(|(rod, latest)| (rod, latest.or_else(|| self.expected.get(rod).copied())))
    }

    /// Rods without any accepted record, or without one for too long.
    pub fn unheard(&self) -> impl Iterator<Item = &RodId> {
        let is_unheard = |state: &State| {
            let is_silent = |kind: Kind| kind == Kind::NoData;
            let mut standing = state.alarms.iter().filter(|alarm| alarm.cleared.is_none());
            state.latest.is_none() || standing.any(|alarm| is_silent(alarm.kind))
        };
        self.trackers
            .iter()
            .filter(move |(_, tracker)| is_unheard(tracker.state()))
            .map(|(rod, _)| rod)
    }

    /// Rods of which no temperature reading was ever believed, with the time since which they are expected, if records of them came.
    pub fn unread(&self) -> impl Iterator<Item = (&RodId, Option<Timestamp>)> {
        let of_unread = self
            .trackers
            .iter()
            .filter(|(_, tracker)| tracker.state().thermometer.trusted_until().is_none());
        of_unread.map(|(rod, tracker)| {
            let since = tracker.state().latest.and_then(|_| self.expected.get(rod));
            (rod, since.copied())
        })
    }

    /// Status of its rods; the store may have others, which are no longer configured.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn standings(&self) -> Result<Vec<Standing>, StoreError> {
        let mut standings = self.store.standings()?;
        standings.retain(|standing| self.trackers.contains_key(&standing.rod));
        Ok(standings)
    }
}
