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

#[cfg(test)]
mod tests {
    use super::super::{Doubt, Plausibility};
    use super::*;
    use crate::track::observation::Observation;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};

    /// Rods of a site under one weather: frequencies of tensioned beams, errors as stated.
    struct Site {
        rng: ChaCha8Rng,
        force: Vec<f64>,
        restraint: Vec<f64>,
        /// Change of ln N besides the weather.
        change: Vec<f64>,
        /// Rod whose signal each channel carries.
        carries: Vec<usize>,
        plausibility: Vec<Plausibility>,
        latest: Vec<Option<Timestamp>>,
        /// Deviation of the weather from its diurnal course \[K\].
        drift_k: f64,
        hour: f64,
    }

    impl Site {
        /// `spread`: differences of ln N between neighbours; `per_kelvin`: d ln N / dT of a restrained rod.
        fn new(rods: usize, spread: f64, per_kelvin: f64, seed: u64) -> Self {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let restraint = (0..rods)
                .map(|_| per_kelvin * rng.random_range(0.8..1.2))
                .collect();
            Self {
                force: (0..rods).map(|rod| spread * rod as f64).collect(),
                restraint,
                change: vec![0.0; rods],
                carries: (0..rods).collect(),
                plausibility: vec![Plausibility::default(); rods],
                latest: vec![None; rods],
                drift_k: 0.0,
                hour: 0.0,
                rng,
            }
        }

        fn name(rod: usize) -> RodId {
            RodId(format!("rod-{rod}"))
        }

        /// A round of records, each rod's a minute after the one before; returns each doubt, and true if a
        /// channel is named as an alternative to a change.
        fn round(&mut self, hours: f64) -> Vec<(Option<Doubt>, bool)> {
            self.hour += hours;
            let keep = (-hours / 72.0).exp();
            let kick: f64 = StandardNormal.sample(&mut self.rng);
            self.drift_k = keep * self.drift_k + 2.0 * (1.0 - keep * keep).sqrt() * kick;
            let day = 3.0 * (2.0 * std::f64::consts::PI * self.hour / 24.0).sin();
            let season = 8.0 * (2.0 * std::f64::consts::PI * self.hour / 8766.0).sin();
            let warmer = self.drift_k + day + season;
            let mut found = Vec::new();
            for channel in 0..self.carries.len() {
                let rod = self.carries[channel];
                let log_force = self.force[rod] + self.change[rod] + self.restraint[rod] * warmer;
                let modes = [1usize, 2, 3].map(|order| {
                    let square = (order * order) as f64;
                    let noise: f64 = StandardNormal.sample(&mut self.rng);
                    let log_sd = 1e-3;
                    LogMode {
                        order,
                        log_frequency: 0.5 * (square * (60.0 * log_force.exp() + 8.0 * square)).ln()
                            + log_sd * noise,
                        log_sd,
                    }
                });
                let seen = Observation::of_modes(
                    Timestamp::from_nanos(0).plus_seconds(3600.0 * self.hour + 60.0 * channel as f64),
                    modes.to_vec(),
                );
                let peers: Vec<Peer> = (0..self.carries.len())
                    .filter(|other| *other != channel)
                    .map(|other| self.plausibility[other].as_peer(&Self::name(other)))
                    .collect();
                let mine = &mut self.plausibility[channel];
                let doubt = mine.doubt(&seen, &Self::name(channel), self.latest[channel], &peers, 5);
                if doubt.is_none() {
                    mine.believe(&seen);
                    self.latest[channel] = Some(seen.start);
                }
                found.push((doubt, mine.alike().is_some()));
            }
            found
        }
    }

    #[test]
    fn no_good_record_of_similar_rods_is_set_aside() {
        for (case, (hours, per_kelvin)) in [
            (1.0, -0.02),
            (24.0, -0.02),
            (1.0, -0.005),
            (24.0, -0.005),
            (7.0, -0.02),
        ]
        .into_iter()
        .enumerate()
        {
            for (rods, spread) in [(2, 0.03), (4, 0.03), (4, 0.01), (4, 0.003), (4, 0.1)] {
                let mut aside = 0;
                let mut told = 0;
                for seed in 0..1 {
                    let mut site = Site::new(rods, spread, per_kelvin, seed + 100 * case as u64);
                    for _ in 0..1000 / rods {
                        for (doubt, alike) in site.round(hours) {
                            aside += usize::from(doubt.is_some());
                            told += usize::from(alike);
                        }
                    }
                }
                println!(
                    "every {hours} h, {per_kelvin} /K, {rods} rods {spread} apart: {aside} of 1000 aside, {told} told"
                );
                assert_eq!(aside, 0);
            }
        }
    }

    #[test]
    fn a_sudden_loss_is_never_taken_for_another_rod() {
        let mut aside = 0;
        let mut told = 0;
        let mut losses = 0;
        for seed in 0..50u64 {
            for (hours, per_kelvin, rods) in [
                (1.0, -0.02, 4),
                (24.0, -0.02, 4),
                (24.0, -0.005, 2),
                (1.0, -0.02, 2),
            ] {
                let spread = [0.03, 0.05, 0.1, 0.2][seed as usize % 4];
                let mut site = Site::new(rods, spread, per_kelvin, 1000 + seed);
                for _ in 0..20 {
                    site.round(hours);
                }
                // To the frequencies of a neighbour, twice as far, or anywhere.
                let loss = match seed % 5 {
                    0 => -spread,
                    1 => -2.0 * spread,
                    2 => (rods - 1) as f64 * -spread,
                    _ => -site.rng.random_range(0.05..0.5),
                };
                let rod = rods - 1;
                site.change[rod] = loss;
                losses += 1;
                let mut is_told = false;
                for _ in 0..5 {
                    let round = site.round(hours);
                    let here = round.iter().filter(|(doubt, _)| doubt.is_some()).count();
                    if here > 0 {
                        println!(
                            "{seed} every {hours} h {per_kelvin} {rods} rods {spread} loss {loss}: {here}"
                        );
                    }
                    aside += here;
                    is_told |= round[rod].1;
                }
                told += usize::from(is_told && seed % 5 == 0);
            }
        }
        println!(
            "{losses} losses: {aside} records aside; {told} of {} that end at a neighbour's told as both",
            losses / 5
        );
        assert_eq!(aside, 0);
        assert!(told * 5 > losses * 9 / 10, "{told}");
    }

    #[test]
    fn exchanged_channels_are_found_and_found_mended() {
        let (mut found, mut mended, mut swaps, mut lost) = (0, 0, 0, 0);
        for seed in 0..25 {
            for (hours, per_kelvin, rods, spread) in [
                (1.0, -0.02, 4, 0.05),
                (24.0, -0.02, 4, 0.15),
                (24.0, -0.005, 4, 0.05),
                (1.0, -0.005, 3, 0.1),
            ] {
                let mut site = Site::new(rods, spread, per_kelvin, 5000 + seed);
                for _ in 0..20 {
                    site.round(hours);
                }
                site.carries.swap(0, 2);
                swaps += 1;
                // The first record of the first channel is believed, and taken back with the second.
                site.round(hours);
                let second = site.round(hours);
                let both = second.iter().enumerate().all(|(rod, (doubt, _))| match rod {
                    0 => *doubt == Some(Doubt::Channel(Site::name(2))),
                    2 => *doubt == Some(Doubt::Channel(Site::name(0))),
                    _ => doubt.is_none(),
                });
                let taken_back = site.plausibility[0].take_wrong_since().is_some();
                found += usize::from(both && taken_back);
                if !both {
                    println!(
                        "{seed} every {hours} h {per_kelvin}: {:?} {:?}",
                        second[0], second[2]
                    );
                    continue;
                }
                for _ in 0..50 {
                    let round = site.round(hours);
                    lost += usize::from(round[0].0.is_none())
                        + usize::from(round[2].0.is_none())
                        + usize::from(round[1].0.is_some());
                }
                site.carries.swap(0, 2);
                // The first channel's may need the second's, as above.
                site.round(hours);
                let round = site.round(hours);
                mended += usize::from(round.iter().all(|(doubt, _)| doubt.is_none()));
            }
        }
        println!(
            "{found} of {swaps} exchanges found, {mended} found mended, {lost} of {} records wrong meanwhile",
            150 * found
        );
        assert!(found * 100 >= swaps * 95, "{found}");
        assert!(mended * 100 >= found * 95, "{mended}");
    }
}
