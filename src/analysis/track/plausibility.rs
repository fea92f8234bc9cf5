//! Records that cannot be what they claim: another unit, another clock, another rod's channel.

mod channels;
mod clock;
mod exchange;

use super::observation::{LogMode, Observation};
use super::plausibility::channels::{Shown, Swap, last_own, moves, without};
use super::plausibility::exchange::{Channel, Pair};
use crate::signal::record::{RodId, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

pub use channels::Peer;
pub use clock::JUMP_S;
pub(super) use clock::LONGEST_SILENCE_S;

/// Largest factor between a record's amplitude and those seen so far: weather and traffic stay within, a
/// change from metres to millimetres does not.
const AMPLITUDE: f64 = 50.0;

/// Number of records that determine the range of amplitudes.
const AMPLITUDES: usize = 5;

/// Largest age of a channel's records used for comparison \[s\].
const COMPARED_S: f64 = 3.0 * 86_400.0;

/// Silence after which weather may have moved a rod by much \[s\].
pub(super) const SILENCE_S: f64 = 10.0 * 86_400.0;

/// Probability from which two channels count as exchanged.
const EXCHANGED: f64 = 0.99;

/// Largest distance in time of two channels' records that are tested for showing one rod \[h\].
const ALIKE_H: f64 = 24.0;

/// Number of records in a row that are those of another rod before one is doubted, and fewest modes that are equal in each: rounded
/// frequencies of like rods may be equal once.
const COPIES: u32 = 3;
const COPIED_MODES: usize = 2;

/// Number of records of a channel remembered.
const REMEMBERED: usize = 4;

/// Reason why a record is not believed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Doubt {
    /// Its amplitude is far from all seen before: a unit or a gain changed.
    Amplitude,
    /// Its time is far ahead of the last record's.
    Clock,
    /// Its frequencies jumped to those of another rod.
    Channel(RodId),
    /// It is another rod's record: equal to the last digit, of the same time, several times in a row.
    Copy(RodId),
}

impl Doubt {
    /// One clause for people.
    pub fn message(&self) -> String {
        match self {
            Self::Amplitude => {
                "the amplitude is far from all seen before: check unit, gain and range of the sensor"
                    .to_owned()
            }
            Self::Clock => {
                "the time is far ahead of the last record: check the clock of the recorder".to_owned()
            }
            Self::Channel(rod) => {
                format!("the frequencies are those of rod {rod}: check which sensor is on which channel")
            }
            Self::Copy(rod) => format!(
                "the records of this rod and of rod {rod} are one signal, equal to the last digit: one channel is recorded under two \
                 topics, and neither rod is known to be its own; check the recorder"
            ),
        }
    }
}

/// True if a record has frequencies that another rod's channel showed of late, as far as weather moves them. What it showed before a silence
/// counts until it shows another record.
pub(super) fn shows_another(observation: &Observation, peers: &[Peer]) -> bool {
    let shows = |theirs: &Shown| {
        let hours = observation.start.seconds_since(theirs.time).abs() / 3600.0;
        exchange::unlikeness(&observation.modes, &theirs.modes, hours)
            .is_some_and(|unlikeness| unlikeness <= 1.0)
    };
    peers.iter().any(|peer| {
        let is_late = |theirs: &&Shown| {
            (peer.shown.back()).is_some_and(|last| last.time.seconds_since(theirs.time) < SILENCE_S)
        };
        peer.shown.iter().filter(is_late).any(shows)
    })
}

/// True if a record is one of another rod's, of the same time: no two rods move alike to the last digit.
fn is_copy(observation: &Observation, peer: &Peer) -> bool {
    let same_time = |theirs: &&Shown| theirs.time == observation.start;
    peer.shown.iter().find(same_time).is_some_and(|theirs| {
        let is_theirs = |own: &LogMode| {
            (theirs.modes.iter())
                .any(|mode| mode.log_frequency == own.log_frequency && mode.log_sd == own.log_sd)
        };
        observation.modes.len() >= COPIED_MODES && observation.modes.iter().all(is_theirs)
    })
}

/// Memory for judging the next record.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Plausibility {
    /// Smallest and largest root mean square of the accepted records, SI of their unit.
    rms: Option<(f64, f64)>,
    /// Number of records behind that range.
    seen: usize,
    /// Last record that was ahead of time, and number of such records in a row.
    ahead: Option<(Timestamp, usize)>,
    /// Time without records that a jump ahead skipped which was finally accepted: from the last record before it to the first behind it.
    #[serde(default)]
    skipped: Option<(Timestamp, Timestamp)>,
    /// Number of records in a row older than periods already closed, and of those in a row in the time skipped.
    behind: usize,
    #[serde(default)]
    in_skipped: usize,
    /// Latest records of the channel, in order of time.
    #[serde(default)]
    shown: VecDeque<Shown>,
    /// The rod whose channel is exchanged with this one.
    #[serde(default)]
    exchange: Option<Swap>,
    /// A rod whose signal the channel may carry, by its frequencies.
    #[serde(default)]
    alike: Option<RodId>,
    /// Number of records in a row that were another rod's to the last digit.
    #[serde(default)]
    copies: u32,
    /// Time from which records were accepted as the rod's own before the exchange was found.
    #[serde(skip)]
    wrong_since: Option<Timestamp>,
}

impl Plausibility {
    /// Reason why an observation of `rod` is not credible; `latest` is the rod's last accepted record,
    /// `patience` the number of records in a row after which a new time is accepted all the same.
    pub fn doubt(
        &mut self,
        observation: &Observation,
        rod: &RodId,
        latest: Option<Timestamp>,
        peers: &[Peer],
        patience: usize,
    ) -> Option<Doubt> {
        if let Some(time) = latest
            && self.is_ahead(observation.start, time, patience, peers)
        {
            return Some(Doubt::Clock);
        }
        if let Some((low, high)) = self.rms
            && self.seen >= AMPLITUDES
            && observation.rms > 0.0
            && !(low / AMPLITUDE..=high * AMPLITUDE).contains(&observation.rms)
        {
            return Some(Doubt::Amplitude);
        }
        self.alike = self.alike_to(observation, peers);
        let copied = peers.iter().find(|peer| is_copy(observation, peer));
        self.copies = copied.map_or(0, |_| self.copies.saturating_add(1));
        let copied = copied.filter(|_| self.copies >= COPIES);
        let doubt = match copied {
            Some(peer) => Some(Doubt::Copy(peer.rod.clone())),
            None => self.channel(rod, observation, peers),
        };
        if self.shown.back().is_none_or(|last| last.time < observation.start) {
            if self.shown.len() == REMEMBERED {
                self.shown.pop_front();
            }
            self.shown.push_back(Shown {
                time: observation.start,
                modes: observation.modes.clone(),
                is_own: doubt.is_none(),
            });
        }
        doubt
    }

    /// Doubt that these modes are another rod's, if both channels show it.
    fn channel(&mut self, rod: &RodId, observation: &Observation, peers: &[Peer]) -> Option<Doubt> {
        let (time, modes) = (observation.start, &observation.modes[..]);
        if let (Some(swap), Some(last)) = (&self.exchange, self.shown.back()) {
            if swap.goes_on(time, modes, last, peers) {
                return Some(Doubt::Channel(swap.rod.clone()));
            }
            self.exchange = None;
            return None;
        }
        // The other one's channel found it first.
        let found = peers.iter().find_map(|peer| {
            let swap = peer.swap.as_ref().filter(|swap| swap.rod == *rod)?;
            let own = last_own(&self.shown, Some(swap.since))?;
            let first = Channel {
                before: &own.modes,
                now: Some(modes),
            };
            let second = Channel {
                before: &swap.own,
                now: peer.shown.back().map(|shown| &shown.modes[..]),
            };
            let hours = time.seconds_since(own.time) / 3600.0;
            let moves = moves(peers, own.time, time);
            let pair = Pair::new(first, second, &without(&moves, &peer.rod), hours)?;
            (pair.weigh().exchanged > 0.5).then(|| Swap {
                rod: peer.rod.clone(),
                since: swap.since,
                own: own.modes.clone(),
                other: swap.own.clone(),
            })
        });
        if let Some(swap) = found {
            return Some(self.exchanged(swap));
        }
        let own = last_own(&self.shown, None)?;
        if time.seconds_since(own.time).abs() > COMPARED_S {
            return None;
        }
        let moves = moves(peers, own.time, time);
        let mut swap: Option<(f64, Swap)> = None;
        for peer in peers {
            let Some((before, now)) = peer.around(own.time, time) else {
                continue;
            };
            let first = Channel {
                before: &own.modes,
                now: Some(modes),
            };
            let second = Channel {
                before: &before.modes,
                now: now.map(|shown| &shown.modes[..]),
            };
            let earliest = own.time.min(before.time);
            let hours = time.seconds_since(earliest) / 3600.0;
            let moves = without(&moves, &peer.rod);
            let pair = Pair::new(first, second, &moves, hours).filter(Pair::both_changed);
            let Some(odds) = pair.map(|pair| pair.weigh()) else {
                continue;
            };
            if odds.exchanged >= EXCHANGED && swap.as_ref().is_none_or(|(best, _)| odds.exchanged > *best) {
                let since = now.map_or(time, |now| now.time.min(time));
                let found = Swap {
                    rod: peer.rod.clone(),
                    since,
                    own: own.modes.clone(),
                    other: before.modes.clone(),
                };
                swap = Some((odds.exchanged, found));
            }
        }
        if let Some((_, swap)) = swap {
            return Some(self.exchanged(swap));
        }
        None
    }

    /// Rod that the channel may show by its frequencies; compares the records nearest in time of each other
    /// channel.
    fn alike_to(&self, observation: &Observation, peers: &[Peer]) -> Option<RodId> {
        let own = [
            Some((observation.start, &observation.modes)),
            self.shown.back().map(|last| (last.time, &last.modes)),
        ];
        let unlikeness = |peer: &Peer| {
            let theirs = peer.shown.back()?;
            let hours = |time: Timestamp| time.seconds_since(theirs.time).abs() / 3600.0;
            let nearest = own.iter().flatten().map(|(time, modes)| (hours(*time), modes));
            let (hours, modes) = nearest.min_by(|one, other| one.0.total_cmp(&other.0))?;
            let unlikeness = exchange::unlikeness(modes, &theirs.modes, hours)?;
            (hours <= ALIKE_H && unlikeness <= 1.0).then(|| (unlikeness, peer.rod.clone()))
        };
        let alike = peers.iter().filter_map(unlikeness);
        let (_, rod) = alike.min_by(|one, other| one.0.total_cmp(&other.0))?;
        Some(rod)
    }

    fn exchanged(&mut self, swap: Swap) -> Doubt {
        let doubt = Doubt::Channel(swap.rod.clone());
        for shown in &mut self.shown {
            if shown.time >= swap.since && shown.is_own {
                shown.is_own = false;
                self.wrong_since = Some(swap.since);
            }
        }
        self.exchange = Some(swap);
        doubt
    }

    /// Time since which accepted records were another rod's; returned once.
    pub fn take_wrong_since(&mut self) -> Option<Timestamp> {
        self.wrong_since.take()
    }

    /// A rod whose signal explains the frequencies as well as a force does.
    pub fn alike(&self) -> Option<&RodId> {
        self.alike.as_ref()
    }

    /// This rod as a peer for others.
    pub fn as_peer(&self, rod: &RodId) -> Peer {
        Peer {
            rod: rod.clone(),
            shown: self.shown.clone(),
            ahead: self.ahead,
            swap: self.exchange.clone(),
        }
    }

    /// Notes an accepted record.
    pub fn believe(&mut self, observation: &Observation) {
        (self.behind, self.in_skipped) = (0, 0);
        self.forget_silence(observation.start);
        let (low, high) = self.rms.unwrap_or((f64::INFINITY, 0.0));
        // A silent record gives no amplitude.
        if observation.rms > 0.0 {
            self.rms = Some((low.min(observation.rms), high.max(observation.rms)));
            self.seen += 1;
        }
    }

    /// True while its channel counts as exchanged with that of another rod.
    pub(super) fn is_exchanged(&self) -> bool {
        self.exchange.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn at(day: f64, frequencies: [f64; 3], rms: f64) -> Observation {
        Observation {
            start: Timestamp::from_nanos(0).plus_seconds(day * 86_400.0),
            duration_s: 60.0,
            modes: frequencies
                .iter()
                .enumerate()
                .map(|(index, f)| LogMode {
                    order: index + 1,
                    log_frequency: f.ln(),
                    log_sd: 1e-3,
                })
                .collect(),
            readings: Vec::new(),
            rms,
            conflict: 0.0,
        }
    }

    pub(super) const OWN: [f64; 3] = [4.49, 9.29, 14.2];

    pub(super) fn learned() -> (Plausibility, Observation) {
        let mut plausibility = Plausibility::default();
        for day in 0..10 {
            let seen = at(f64::from(day), OWN, 1e-5 * f64::from(day + 1));
            assert_eq!(plausibility.doubt(&seen, &RodId("a".into()), None, &[], 5), None);
            plausibility.believe(&seen);
        }
        (plausibility, at(9.0, OWN, 1e-4))
    }

    #[test]
    fn a_change_of_unit_is_no_weather() {
        let (mut plausibility, last) = learned();
        let (rod, latest) = (RodId("a".into()), Some(last.start));
        for (rms, doubt) in [
            (1e-3, None),
            (2e-6, None),
            (5e-2, Some(Doubt::Amplitude)),
            (5e-8, Some(Doubt::Amplitude)),
        ] {
            assert_eq!(
                plausibility.doubt(&at(10.0, OWN, rms), &rod, latest, &[], 5),
                doubt,
                "{rms}"
            );
        }
    }

    #[test]
    fn the_frequencies_of_another_rod_are_known_again() {
        let (other, _) = learned();
        let peers = [other.as_peer(&RodId("b".into()))];
        assert!(shows_another(&at(10.0, OWN, 1e-4), &peers));
        assert!(!shows_another(&at(10.0, OWN.map(|f| 0.7 * f), 1e-4), &peers));
        assert!(!shows_another(&at(10.0, OWN, 1e-4), &[]));
        // Months later its own frequencies count, once it has shown any.
        let after = at(100.0, OWN.map(|f| 0.92 * f), 1e-4);
        assert!(shows_another(&after, &peers));
        let (mut back, _) = learned();
        back.shown.push_back(Shown {
            time: at(99.9, OWN, 1e-4).start,
            modes: at(99.9, OWN, 1e-4).modes,
            is_own: true,
        });
        assert!(!shows_another(&after, &[back.as_peer(&RodId("b".into()))]));
    }

    #[test]
    fn one_signal_under_two_topics_is_no_rod_of_its_own() {
        let (mut first, mut second) = (Plausibility::default(), Plausibility::default());
        let [a, b] = ["a", "b"].map(|name| RodId(name.into()));
        let mut doubts = Vec::new();
        for day in 0..6 {
            let seen = at(
                f64::from(day),
                OWN.map(|f| f * (1.0 + 1e-4 * f64::from(day))),
                1e-5,
            );
            assert_eq!(first.doubt(&seen, &a, None, &[second.as_peer(&b)], 5), None);
            doubts.push(second.doubt(&seen, &b, None, &[first.as_peer(&a)], 5));
        }
        let copy = Some(Doubt::Copy(a.clone()));
        assert_eq!(
            doubts,
            [None, None, copy.clone(), copy.clone(), copy.clone(), copy]
        );
        // Like rods whose frequencies differ in the last digit only.
        let mut like = Plausibility::default();
        for day in 6..12 {
            let seen = at(f64::from(day), OWN, 1e-5);
            first.doubt(&seen, &a, None, &[], 5);
            let near = at(f64::from(day), OWN.map(|f| f * (1.0 + 1e-12)), 1e-5);
            assert_eq!(like.doubt(&near, &b, None, &[first.as_peer(&a)], 5), None);
        }
    }
}
