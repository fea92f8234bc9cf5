//! Recent frequencies of the channels of a site, and two channels that are exchanged.

use super::exchange::{self, Channel, Pair};
use crate::signal::record::{RodId, Timestamp};
use crate::track::observation::LogMode;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Another rod of the site, by the records of its channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Peer {
    pub(super) rod: RodId,
    pub(super) shown: VecDeque<Shown>,
    /// Last record far ahead of time that was doubted, and number of such records in a row.
    pub(super) ahead: Option<(Timestamp, usize)>,
    pub(super) swap: Option<Swap>,
}

/// Frequencies of a channel at a time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Shown {
    pub time: Timestamp,
    pub modes: Vec<LogMode>,
    /// True if accepted as the rod's own.
    pub is_own: bool,
}

/// Two channels that are exchanged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Swap {
    /// The other rod.
    pub rod: RodId,
    /// Start of the first record with the exchange.
    pub since: Timestamp,
    /// Earlier modes of this channel and of the other one.
    pub own: Vec<LogMode>,
    pub other: Vec<LogMode>,
}

impl Swap {
    /// True if a record still shows the other rod: weighed as an exchange back from the latest records of
    /// both channels. A rod whose channel shows its own modes again is no longer exchanged with this one.
    pub fn goes_on(&self, time: Timestamp, modes: &[LogMode], last: &Shown, peers: &[Peer]) -> bool {
        let Some(peer) = peers.iter().find(|peer| peer.rod == self.rod) else {
            return false;
        };
        let shows_its_own = peer
            .shown
            .back()
            .is_some_and(|shown| shown.is_own && shown.time > self.since);
        if shows_its_own && peer.swap.is_none() {
            return false;
        }
        let middle = last.time.plus_seconds(0.5 * time.seconds_since(last.time));
        let later = peer.shown.back().filter(|shown| shown.time > middle);
        let before = peer.shown.iter().rev().find(|shown| shown.time <= middle);
        let first = Channel {
            before: &last.modes,
            now: Some(modes),
        };
        let second = Channel {
            before: before.map_or(&self.own, |shown| &shown.modes),
            now: later.map(|shown| &shown.modes[..]),
        };
        let hours = time.seconds_since(last.time) / 3600.0;
        let moves = moves(peers, last.time, time);
        let pair = Pair::new(first, second, &without(&moves, &peer.rod), hours);
        pair.is_none_or(|pair| pair.weigh().other < 0.5)
    }
}

impl Peer {
    /// Record of the channel at about the time `before`, and that at about the time `now` if there is one:
    /// each record counts for the nearer of the two.
    pub(super) fn around(&self, before: Timestamp, now: Timestamp) -> Option<(&Shown, Option<&Shown>)> {
        let middle = before.plus_seconds(0.5 * now.seconds_since(before));
        let now = self.shown.back().filter(|shown| shown.time > middle);
        Some((last_own(&self.shown, now.map(|_| middle))?, now))
    }
}

/// Latest record of a channel's own rod, before a time if given.
pub(super) fn last_own(shown: &VecDeque<Shown>, before: Option<Timestamp>) -> Option<&Shown> {
    let is_it = |shown: &&Shown| shown.is_own && before.is_none_or(|before| shown.time < before);
    shown.iter().rev().find(is_it)
}

/// Moves of ln N between two times by the channels of other rods.
pub(super) fn moves(peers: &[Peer], before: Timestamp, now: Timestamp) -> Vec<(&RodId, f64)> {
    peers
        .iter()
        .filter(|peer| peer.swap.is_none())
        .filter_map(|peer| {
            let (before, now) = peer.around(before, now)?;
            Some((&peer.rod, exchange::moved(&before.modes, &now?.modes)?))
        })
        .collect()
}

/// The moves of all rods but one.
pub(super) fn without(moves: &[(&RodId, f64)], rod: &RodId) -> Vec<f64> {
    let others = moves.iter().filter(|(other, _)| *other != rod);
    others.map(|(_, moved)| *moved).collect()
}
