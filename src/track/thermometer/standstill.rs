//! Standstills of a thermometer: whether so many equal readings in a row are weather, or a dead thermometer.
//!
//! A standstill is a run of equal readings. It is looked at when it begins and every [`LOOK_S`] or, with sparser readings, at
//! every one. Given that it has lasted for j looks it goes on with probability p_j, learned from the thermometer's own
//! standstills, so that resolution, noise, the weather's variation and calm spells are in it:
//!
//! ```text
//! p_1 ~ Beta about q f(0),   p_j ~ Beta about p_(j-1),   p_j = p_last beyond the last
//! ```
//!
//! with q the smallest step seen and f(0) the density of steps about none. A standstill of n looks comes (year / interval of the readings)
//! p_1 ... p_(n-1) times a year at most: one that should come less than [`DEAD_A_YEAR`] times is a dead thermometer, one that should come
//! less than [`HELD_A_YEAR`] times waits for what follows.

use crate::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};

/// Least time between looks \[s\].
const LOOK_S: f64 = 3000.0;
/// Looks whose standstills are counted apart.
const KNOWN: usize = 16;
/// Looks as which the guess of a probability counts.
const GUESS: f64 = 4.0;
/// Steps that are remembered, and from how many on anything is said.
const STEPS: usize = 64;
const LEAST_STEPS: usize = 10;
/// Standstills so rare that they are none of the weather, and so rare that their readings wait \[1 / year\].
const DEAD_A_YEAR: f64 = 0.05;
const HELD_A_YEAR: f64 = 12.0;
/// Looks of a dead thermometer, at least: 12, or 3 that span this time \[s\]. Weather is stiller than it was so far now and then.
const LEAST_LOOKS: usize = 12;
const LEAST_SPARSE_LOOKS: usize = 3;
const LEAST_S: f64 = 36.0 * 3600.0;
/// Share of a new interval in the usual one.
const FOLLOW: f64 = 0.1;
const YEAR_S: f64 = 365.25 * 86_400.0;

/// What a standstill is taken for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Still {
    /// Weather.
    No,
    /// So rare that it is not yet believed.
    Held,
    /// A dead thermometer.
    Dead,
}

/// What is remembered of standstills.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Standstill {
    /// First and last look of the present run, and how many looks it has.
    run: Option<(Reading, Timestamp, usize)>,
    /// Looks at which a run of so many could end, and did not; the last for all longer ones.
    stayed: Vec<u32>,
    /// Looks at which it ended.
    ended: Vec<u32>,
    /// Sizes of the last steps that were not none \[K\].
    steps: Vec<f64>,
    /// Where the next step goes.
    next: usize,
    /// Time of the last reading, and the usual time between readings \[s\].
    latest: Option<Timestamp>,
    interval_s: f64,
}

impl Standstill {
    /// The first reading of the present run.
    pub fn since(&self) -> Option<Timestamp> {
        self.run.map(|(first, _, _)| first.time)
    }

    /// Takes a reading later than all before.
    pub fn take(&mut self, reading: &Reading) -> Still {
        let Some((first, last, looks)) = self.run else {
            self.run = Some((*reading, reading.time, 1));
            self.latest = Some(reading.time);
            return Still::No;
        };
        self.follow(reading.time);
        if reading.celsius != first.celsius {
            self.end(first, last, looks);
            self.step((reading.celsius - first.celsius).abs());
            self.run = Some((*reading, reading.time, 1));
            return Still::No;
        }
        if reading.time.seconds_since(last) < LOOK_S {
            return self.judge(first, last, looks);
        }
        self.run = Some((first, reading.time, looks + 1));
        self.judge(first, reading.time, looks + 1)
    }

    fn follow(&mut self, time: Timestamp) {
        if let Some(latest) = self.latest.replace(time) {
            let passed_s = time.seconds_since(latest);
            self.interval_s = if self.interval_s > 0.0 {
                // A hole counts as no more than a few intervals.
                self.interval_s + FOLLOW * (passed_s.min(4.0 * self.interval_s) - self.interval_s)
            } else {
                passed_s
            };
        }
    }

    /// Learns from a run that ended; one that was judged dead teaches as though it had ended there.
    fn end(&mut self, first: Reading, last: Timestamp, looks: usize) {
        self.stayed.resize(KNOWN, 0);
        self.ended.resize(KNOWN, 0);
        let mut length = looks;
        if self.judge(first, last, looks) == Still::Dead {
            let share = |n: usize| n as f64 / looks as f64;
            let at = |n: usize| first.time.plus_seconds(share(n) * last.seconds_since(first.time));
            while length > 1 && self.judge(first, at(length - 1), length - 1) == Still::Dead {
                length -= 1;
            }
        }
        for j in 1..length {
            let slot = &mut self.stayed[j.min(KNOWN) - 1];
            *slot = slot.saturating_add(1);
        }
        let slot = &mut self.ended[length.min(KNOWN) - 1];
        *slot = slot.saturating_add(1);
    }

    fn step(&mut self, step: f64) {
        if self.steps.len() < STEPS {
            self.steps.push(step);
        } else {
            self.steps[self.next % STEPS] = step;
        }
        self.next = (self.next + 1) % STEPS;
    }

    /// Whether a run of so many looks is weather.
    fn judge(&self, first: Reading, last: Timestamp, looks: usize) -> Still {
        if looks < 2 || self.steps.len() < LEAST_STEPS {
            return Still::No;
        }
        let a_year = self.a_year(looks);
        let lasted_s = last.seconds_since(first.time);
        let is_long = looks >= LEAST_LOOKS || looks >= LEAST_SPARSE_LOOKS && lasted_s >= LEAST_S;
        if a_year < DEAD_A_YEAR && is_long {
            Still::Dead
        } else if a_year < HELD_A_YEAR {
            Still::Held
        } else {
            Still::No
        }
    }

    /// How often a year a standstill of so many looks should come, at most.
    fn a_year(&self, looks: usize) -> f64 {
        let mut log = libm::log(YEAR_S / self.interval_s.max(1.0));
        let mut p = self.chance_of_none();
        for j in 1..looks {
            if j <= KNOWN {
                let count = |counts: &[u32]| f64::from(counts.get(j - 1).copied().unwrap_or(0));
                let (stayed, ended) = (count(&self.stayed), count(&self.ended));
                let learned = (GUESS * p + stayed) / (GUESS + stayed + ended);
                // A calm spell does not become less calm by lasting.
                p = if j == 1 { learned } else { learned.max(p) };
            }
            log += libm::log(p);
        }
        libm::exp(log)
    }

    /// q f(0): the chance of a step of none from those about it.
    fn chance_of_none(&self) -> f64 {
        let mut steps = self.steps.clone();
        steps.sort_by(f64::total_cmp);
        let Some(&resolution) = steps.first() else {
            return 0.5;
        };
        let near = (steps.len() / 4).max(1);
        let reach = steps[near - 1];
        // Steps from -reach to reach, on a grid of the resolution without none itself.
        let chance = near as f64 / steps.len() as f64 * resolution / (2.0 * reach);
        chance / (1.0 + chance)
    }
}
