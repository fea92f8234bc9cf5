//! Records that cannot be what they claim: another unit, another clock, another rod's channel.

use super::{LogMode, Observation};
use crate::record::{RodId, Timestamp};
use serde::{Deserialize, Serialize};

/// How far outside the amplitudes seen so far a record may lie, as a factor: weather and traffic stay within, a
/// change from metres to millimetres does not.
const AMPLITUDE: f64 = 50.0;

/// Records that tell the range of amplitudes.
const AMPLITUDES: usize = 5;

/// Silence after which a record's time is doubted until others agree \[s\].
pub(super) const JUMP_S: f64 = 90.0 * 86_400.0;

/// A swapped channel shows at once: the rod's last record must be this young \[s\].
const SWAP_WITHIN_S: f64 = 3.0 * 86_400.0;

/// Least shift of ln f (root mean square over the modes) worth asking whose modes these are: 1 % of force.
const SWAP_SHIFT: f64 = 0.004;

/// How much nearer another rod's modes must be; a day's weather moves both rods.
const SWAP_NEARER: f64 = 3.0;

/// Another rod of the site, as its latest record shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Peer {
    /// The rod.
    pub rod: RodId,
    /// The start of its latest record that was believed.
    pub latest: Option<Timestamp>,
    /// Its modes.
    pub modes: Vec<LogMode>,
}

/// Why a record is not believed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Doubt {
    /// Its amplitude is far from all seen before: a unit or a gain changed.
    Amplitude,
    /// Its time is far ahead of the last record's.
    Clock,
    /// Its frequencies jumped to those of another rod.
    Channel(RodId),
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
        }
    }
}

/// Whether a time lies so far after the `latest` believed that a wrong clock is likelier than a silence.
pub(super) fn is_far_ahead(time: Timestamp, latest: Timestamp) -> bool {
    time.seconds_since(latest) > JUMP_S
}

/// What is remembered to judge the next record.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Plausibility {
    /// Smallest and largest root mean square of the records believed, SI of their unit.
    rms: Option<(f64, f64)>,
    /// How many records that range is from.
    seen: usize,
    /// The last record that was ahead of time, and how many in a row.
    ahead: Option<(Timestamp, usize)>,
    /// The last record before a jump ahead that was believed at last.
    before_jump: Option<Timestamp>,
    /// Records in a row that were older than periods already closed.
    behind: usize,
    /// Records in a row that were another rod's.
    swap: Option<Swap>,
}

/// A channel that shows another rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Swap {
    /// The other rod.
    rod: RodId,
    /// Since this record.
    since: Timestamp,
    /// What the channel showed last.
    modes: Vec<LogMode>,
}

impl Swap {
    /// Whether a record goes on showing the other rod: it is nearer to what the channel showed last than to that less the
    /// difference of the two rods (`own` and the other's modes as last believed). From one record to the next weather
    /// moves less, whatever it did since the swap. A rod whose channel has shown its own modes since was not swapped with
    /// this one: then this one has come to look like it.
    fn goes_on(&self, modes: &[LogMode], own: &[LogMode], peers: &[Peer]) -> bool {
        let Some(peer) = peers.iter().find(|peer| peer.rod == self.rod) else {
            return false;
        };
        let of = |modes: &[LogMode], order: usize| {
            let mode = modes.iter().find(|mode| mode.order == order)?;
            Some(mode.log_frequency)
        };
        let back: Vec<LogMode> = self
            .modes
            .iter()
            .filter_map(|mode| {
                let apart = of(own, mode.order)? - of(&peer.modes, mode.order)?;
                Some(LogMode {
                    log_frequency: mode.log_frequency + apart,
                    ..*mode
                })
            })
            .collect();
        let is_swapped_too = peer.latest.is_none_or(|latest| latest < self.since);
        let (here, there) = (distance(modes, &self.modes), distance(modes, &back));
        is_swapped_too && here.zip(there).is_none_or(|(here, there)| here <= there)
    }
}

impl Plausibility {
    /// Why an observation cannot be believed; `latest` is the rod's last believed record with its modes, `patience`
    /// the number of records in a row after which a new time is believed all the same.
    pub fn doubt(
        &mut self,
        observation: &Observation,
        latest: Option<(Timestamp, &[LogMode])>,
        peers: &[Peer],
        patience: usize,
    ) -> Option<Doubt> {
        if let Some((time, _)) = latest
            && self.is_ahead(observation.start, time, patience)
        {
            return Some(Doubt::Clock);
        }
        if let Some((low, high)) = self.rms
            && self.seen >= AMPLITUDES
            && !(low / AMPLITUDE..=high * AMPLITUDE).contains(&observation.rms)
        {
            return Some(Doubt::Amplitude);
        }
        let (time, modes) = latest?;
        if let Some(swap) = &mut self.swap
            && swap.goes_on(&observation.modes, modes, peers)
        {
            swap.modes.clone_from(&observation.modes);
            return Some(Doubt::Channel(swap.rod.clone()));
        }
        self.swap = None;
        if observation.start.seconds_since(time).abs() > SWAP_WITHIN_S {
            return None;
        }
        let own = distance(&observation.modes, modes)?;
        let (rod, nearest) = peers
            .iter()
            .filter_map(|peer| Some((&peer.rod, distance(&observation.modes, &peer.modes)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        if own <= SWAP_SHIFT || nearest * SWAP_NEARER >= own {
            return None;
        }
        self.swap = Some(Swap {
            rod: rod.clone(),
            since: observation.start,
            modes: observation.modes.clone(),
        });
        Some(Doubt::Channel(rod.clone()))
    }

    /// Takes note of a record older than periods already closed. Whether the clock was right before it jumped
    /// ahead, and is right again: `patience` records in a row say so that lie in the time the jump left out.
    pub fn is_back(&mut self, start: Timestamp, patience: usize) -> bool {
        self.behind += 1;
        self.behind > patience && self.before_jump.is_some_and(|before| start > before)
    }

    /// Whether records have been older than periods already closed at least so many times in a row.
    pub fn is_behind(&self, patience: usize) -> bool {
        self.behind >= patience
    }

    /// Takes note of a record that was believed.
    pub fn believe(&mut self, observation: &Observation) {
        self.behind = 0;
        let (low, high) = self.rms.unwrap_or((f64::INFINITY, 0.0));
        // A silent record says nothing about amplitudes.
        if observation.rms > 0.0 {
            self.rms = Some((low.min(observation.rms), high.max(observation.rms)));
            self.seen += 1;
        }
    }

    fn is_ahead(&mut self, start: Timestamp, latest: Timestamp, patience: usize) -> bool {
        if !is_far_ahead(start, latest) {
            self.ahead = None;
            return false;
        }
        let count = match self.ahead {
            Some((last, count)) if (0.0..=JUMP_S).contains(&start.seconds_since(last)) => count + 1,
            _ => 1,
        };
        let doubted = count <= patience;
        self.ahead = doubted.then_some((start, count));
        if !doubted {
            self.before_jump = Some(latest);
        }
        doubted
    }
}

/// Root mean square difference of ln f over the modes both have; `None` with fewer than two.
fn distance(a: &[LogMode], b: &[LogMode]) -> Option<f64> {
    let squares: Vec<f64> = a
        .iter()
        .filter_map(|mode| {
            let other = b.iter().find(|other| other.order == mode.order)?;
            Some((mode.log_frequency - other.log_frequency).powi(2))
        })
        .collect();
    (squares.len() >= 2).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(day: f64, frequencies: [f64; 3], rms: f64) -> Observation {
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

    const OWN: [f64; 3] = [4.49, 9.29, 14.2];

    fn learned() -> (Plausibility, Observation) {
        let mut plausibility = Plausibility::default();
        for day in 0..10 {
            let seen = at(f64::from(day), OWN, 1e-5 * f64::from(day + 1));
            assert_eq!(plausibility.doubt(&seen, None, &[], 5), None);
            plausibility.believe(&seen);
        }
        (plausibility, at(9.0, OWN, 1e-4))
    }

    #[test]
    fn a_change_of_unit_is_no_weather() {
        let (mut plausibility, last) = learned();
        let latest = Some((last.start, &last.modes[..]));
        for (rms, doubt) in [
            (1e-3, None),
            (2e-6, None),
            (5e-2, Some(Doubt::Amplitude)),
            (5e-8, Some(Doubt::Amplitude)),
        ] {
            assert_eq!(
                plausibility.doubt(&at(10.0, OWN, rms), latest, &[], 5),
                doubt,
                "{rms}"
            );
        }
    }

    #[test]
    fn a_jump_of_the_clock_is_believed_only_when_it_lasts() {
        let (mut plausibility, last) = learned();
        let latest = Some((last.start, &last.modes[..]));
        let far = |day: f64| at(27_000.0 + day, OWN, 1e-4);
        assert_eq!(plausibility.doubt(&far(0.0), latest, &[], 3), Some(Doubt::Clock));
        assert_eq!(plausibility.doubt(&at(10.0, OWN, 1e-4), latest, &[], 3), None);
        for day in 1..=3 {
            assert_eq!(
                plausibility.doubt(&far(f64::from(day)), latest, &[], 3),
                Some(Doubt::Clock)
            );
        }
        assert_eq!(plausibility.doubt(&far(4.0), latest, &[], 3), None);
        // Weeks of silence are no jump.
        assert_eq!(plausibility.doubt(&at(60.0, OWN, 1e-4), latest, &[], 3), None);
    }

    #[test]
    fn a_swapped_channel_is_told_by_the_other_rods_modes() {
        let (mut plausibility, last) = learned();
        let latest = Some((last.start, &last.modes[..]));
        let other = [4.71, 9.72, 14.9];
        let mut peers = [
            Peer {
                rod: RodId("b".into()),
                latest: Some(last.start),
                modes: at(9.0, other, 1e-4).modes,
            },
            Peer {
                rod: RodId("c".into()),
                latest: Some(last.start),
                modes: at(9.0, [5.2, 10.6, 16.4], 1e-4).modes,
            },
        ];
        let swapped = at(10.0, other.map(|f| f * 1.0005), 1e-4);
        assert_eq!(
            plausibility.doubt(&swapped, latest, &peers, 5),
            Some(Doubt::Channel(RodId("b".into())))
        );
        // It stays one while weather moves both rods past where this one was.
        for day in 11..60 {
            let weather = 1.0 - 0.002 * f64::from(day - 10);
            let shown = at(f64::from(day), other.map(|f| f * weather), 1e-4);
            assert!(plausibility.doubt(&shown, latest, &peers, 5).is_some(), "{day}");
        }
        let kept = plausibility.clone();
        // Mended: the channel jumps by the difference of the two.
        let mended = at(60.0, OWN.map(|f| f * 0.9), 1e-4);
        assert_eq!(plausibility.doubt(&mended, latest, &peers, 5), None);
        // The other rod is itself on its own channel: this one was never swapped with it.
        plausibility = kept;
        peers[0].latest = Some(at(12.0, other, 1e-4).start);
        let like = at(60.0, other.map(|f| f * 0.9), 1e-4);
        assert_eq!(plausibility.doubt(&like, latest, &peers, 5), None);
        // A loss of force that ends at no other rod's modes is none.
        let fallen = at(10.0, OWN.map(|f| f * 0.97), 1e-4);
        assert_eq!(plausibility.doubt(&fallen, latest, &peers, 5), None);
    }
}
