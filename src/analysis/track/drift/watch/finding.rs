//! Joint finding of the detectors after a period: a drift and its witnesses, or rods that move together.

use super::{DriftWatch, RARER};
use crate::track::drift::companions;
use crate::track::drift::others::{MOVING, Movement, Others};
use crate::track::drift::{Change, Detector, Law};
use serde::{Deserialize, Serialize};

/// Number of periods since the last restart after which absence of evidence counts.
const SETTLED_PERIODS: usize = 30;

/// Largest share of the other rods that may move beside a drifting rod.
const MOVING_SHARE: f64 = 0.25;

/// Standard deviations from which a ratio lies far from what another rod expects, and the share of that distance within which it is near
/// what yet another one expects.
const FAR_SD: f64 = 5.0;
const NEARER_SHARE: f64 = 0.5;

/// Detectors behind a change of force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Witness {
    /// Temperature is compensated, and the other rods confirm the change.
    Confirmed,
    /// Temperature is compensated; the other rods do not confirm the change yet.
    Unconfirmed,
    /// Temperature is compensated; there are too few rods to distinguish force from thermometer.
    Alone,
    /// Compared with the other rods; there is no temperature.
    Peers,
    /// The rod's own data only: there is neither temperature nor other rods.
    Blind,
}

/// Joint finding of the detectors after a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Finding {
    /// No change.
    Quiet,
    /// The rod's force changed.
    Drift(Witness),
    /// It moved together with other rods: thermometer, weather, or the whole structure.
    Common,
    /// It seems to move together with other rods; a notice of the site needs more evidence.
    Waiting,
}

/// Detectors above their limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Above {
    pub(super) compensated: bool,
    /// The other rods confirm a change.
    pub(super) peers: bool,
    /// Those that stand in, by changes since a better-informed one last looked.
    pub(super) peers_alone: bool,
    pub(super) blind: bool,
}

impl Above {
    pub(super) fn any(self) -> bool {
        self.compensated || self.peers || self.peers_alone || self.blind
    }
}

impl DriftWatch {
    /// Finds the detectors above their limit. Periods since the onset of a change reported now do not count
    /// for commissioning.
    pub(super) fn look(&mut self, limit: f64) {
        let was_told = self.above.any();
        let is_above = |detector: &Detector, since, limit| detector.statistic_since(since) > limit;
        let peers = |since, limit| (self.peers.as_ref()).is_some_and(|peers| is_above(peers, since, limit));
        // Beside what stands in for the others, they still count as far as they have been measured.
        let with_others = (self.compensated.as_ref()).map_or(0.0, |one| one.detector.statistic());
        self.above = Above {
            compensated: self.watching_statistic() > limit || (self.are_others_late && with_others > limit),
            peers: peers(None, RARER * limit),
            peers_alone: peers(self.by_temperature_until.until, limit),
            blind: is_above(&self.blind, self.informed_until(), limit),
        };
        if !was_told
            && self.above.any()
            && let Some(change) = self.change()
        {
            for known in [&mut self.compensated, &mut self.by_temperature]
                .into_iter()
                .flatten()
            {
                known.withdraw(change.onset_interval[0]);
            }
        }
    }

    /// True unless too many of the other rods move, more than stand still: what moves them together is no change of one.
    pub(crate) fn is_calm(&self, others: &Others, index: i64) -> bool {
        let count = others.count();
        let Some(movement) = self.movement().filter(|_| count >= companions::FEWEST) else {
            return true;
        };
        let moving = others.moving(index, &movement);
        moving as f64 <= MOVING_SHARE * count as f64 || moving <= others.denying(index, &movement)
    }

    /// Number of other rods that share the change.
    pub(crate) fn moving(&self, others: &Others, index: i64) -> usize {
        self.movement()
            .map_or(0, |movement| others.moving(index, &movement))
    }

    /// The change as other rods may share it: theirs may be up to twice as old as its earliest credible onset.
    pub(crate) fn movement(&self) -> Option<Movement> {
        let ((onset, size), now) = (self.onset_and_size()?, self.blind.began()?);
        Some(Movement {
            since: 2.0 * onset - now,
            age_d: now - onset,
            size,
            slope_per_k: self.slope().map(|(slope, _)| slope),
        })
    }

    /// True if the change shows without the other rods: by what began with it, since R over all the past grows without a change.
    pub(crate) fn shows_alone(&self) -> bool {
        self.evidence_alone(self.movement().map(|movement| movement.since)) > MOVING
    }

    /// True if most of the other rods changed in the same direction and this one lost or gained no share of force of its own. Beside the median
    /// a rod is expected to follow by its gain g, as weather and a wrong thermometer move it; what moves the whole structure changes all
    /// alike. With M the others' change and Y this one's, both by temperature alone, `peers` sees Y - g M: where Y - M is of the other sign or
    /// less than half of that, the gain alone makes what `peers` sees.
    fn is_like_others(&self, others: &Others, index: i64) -> bool {
        let apart_from_all = || {
            let since = self.movement()?.since;
            let own = self.size_alone(since)?;
            let theirs = others.moved_alone(index, since);
            let beside = self.peers.as_ref()?.size_since(None)?;
            (own * theirs > 0.0).then(|| (own - theirs) / beside)
        };
        apart_from_all().is_some_and(|share| share < NEARER_SHARE)
    }

    /// True if a larger change of a rod in the median, of about the same age, may be what shows relative to the median.
    fn may_be_another(&self, others: &Others, index: i64) -> bool {
        let movement = self.movement();
        movement.is_some_and(|movement| others.is_one_of_them(index, &movement))
    }

    /// True while other rods bear witness.
    pub(crate) fn has_witnesses(&self) -> bool {
        self.peers.is_some() && self.without_others <= companions::PATIENCE
    }

    /// Law of the last period by the other rods alone, where there was no temperature: of the two in the middle the one that expects less,
    /// since the other may have risen. `None` if a rod of the median may have moved, and in the first periods after a restart.
    pub(crate) fn law_without_temperature(&self, others: &Others, index: i64) -> Option<Law> {
        let [one, other] = self.beside_others?;
        let law = if other.mean < one.mean { other } else { one };
        // One period says little of the size to a detector: what it missed the law by counts.
        let movement = Movement {
            size: self.last_ratio - law.mean,
            ..self.movement()?
        };
        (!others.is_one_of_them(index, &movement)).then_some(law)
    }

    /// True if the last period lies far from what one of the two other rods in the middle expects, and not from the other: one of those
    /// has moved.
    fn is_between_others(&self) -> bool {
        let Some(laws) = self.beside_others else {
            return false;
        };
        let [one, other] = laws.map(|law| self.last_ratio - law.mean);
        let (nearer, farther) = if one.abs() < other.abs() {
            (one, other)
        } else {
            (other, one)
        };
        let is_far = laws.iter().all(|law| farther.abs() > FAR_SD * law.sd);
        is_far && (nearer / farther).abs() < NEARER_SHARE
    }

    /// Change that shows beside the other rods, where there was no temperature.
    pub(crate) fn change_without_temperature(&self) -> Option<Change> {
        let is_told = self.last.others && !self.last.temperature && self.above.peers_alone;
        self.change().filter(|_| is_told)
    }

    /// Joint finding of the detectors after the last period, `index`. What shows only relative to the median may be another rod;
    /// `is_new`: not for so long that it would have been reported.
    pub(crate) fn finding(&self, others: &Others, index: i64, is_new: bool) -> Finding {
        // The rod alone tells too little of what began beside the others without a temperature.
        let shows_alone = self.shows_alone() && (self.last.temperature || !self.last.others);
        if is_new && self.above.any() && !shows_alone && self.may_be_another(others, index) {
            return Finding::Quiet;
        }
        let has_witnesses = self.has_witnesses();
        if self.above.compensated {
            let is_like_others = self.is_like_others(others, index);
            if has_witnesses && self.above.peers && !is_like_others {
                Finding::Drift(Witness::Confirmed)
            } else if is_like_others || !self.is_calm(others, index) {
                let rods = (others.count() + 1) as f64;
                if !self.are_others_late && self.watching_statistic() > rods * self.limit {
                    Finding::Common
                } else {
                    Finding::Waiting
                }
            } else if has_witnesses {
                Finding::Drift(Witness::Unconfirmed)
            } else {
                Finding::Drift(Witness::Alone)
            }
        } else if self.last.temperature {
            Finding::Quiet
        } else if self.last.others {
            if self.above.peers_alone && !self.is_between_others() {
                Finding::Drift(Witness::Peers)
            } else {
                Finding::Quiet
            }
        } else if self.above.blind {
            Finding::Drift(Witness::Blind)
        } else {
            Finding::Quiet
        }
    }

    /// Notes if the rod moves with others of which one reported it; returns true if that is over now.
    pub(crate) fn joins(&mut self, others: &Others, index: i64, moves: bool) -> bool {
        let was_joined = self.has_joined;
        self.has_joined = others.has_told_common(index) && (was_joined || moves);
        was_joined && !self.has_joined
    }

    /// True while it moves with others of which one reported it.
    pub(crate) fn has_joined(&self) -> bool {
        self.has_joined
    }

    /// True while the detector with the rod's own data only sees a change.
    pub(crate) fn is_blind_above(&self) -> bool {
        self.blind.statistic() > self.limit
    }

    /// True once it has run long enough for absence of evidence to count.
    pub(crate) fn is_settled(&self) -> bool {
        self.blind.fresh() >= SETTLED_PERIODS
    }
}
