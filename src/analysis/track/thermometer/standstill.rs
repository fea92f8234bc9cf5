//! Standstills of a thermometer: decides if many equal readings in a row are weather, or a dead thermometer.
//!
//! A standstill is a run of equal readings. It is checked when it begins and every [`LOOK_S`] or, with
//! sparser readings, at every one. Given that it has lasted for j looks it goes on with probability p_j,
//! learned from the thermometer's own standstills, which covers resolution, noise, the weather's variation
//! and calm spells:
//!
//! ```text
//! p_1 ~ Beta about q f(0),   p_j ~ Beta about p_(j-1),   p_j = p_last beyond the last
//! ```
//!
//! with q the smallest step seen and f(0) the density of steps about none. A standstill of n looks comes (year / interval of the readings)
//! p_1 ... p_(n-1) times a year at most: one that should come less than [`DEAD_A_YEAR`] times is a dead thermometer, one that should come
//! less than [`HELD_A_YEAR`] times waits for later readings.

use crate::signal::record::time::YEAR_S;
use crate::signal::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};

/// Least time between looks \[s\].
const LOOK_S: f64 = 3000.0;
/// Number of looks whose standstills are counted separately.
const KNOWN: usize = 16;
/// Weight of the guess of a probability, in looks.
const GUESS: f64 = 4.0;
/// Number of steps remembered, and fewest steps for a judgement.
const STEPS: usize = 64;
const LEAST_STEPS: usize = 10;
/// Rates below which a standstill is not weather, and below which its readings wait \[1 / year\].
const DEAD_A_YEAR: f64 = 0.05;
const HELD_A_YEAR: f64 = 12.0;
/// Rate below which a standstill is not an everyday one \[1 / year\].
const EVERYDAY_A_YEAR: f64 = 365.0;
/// Looks of a dead thermometer, at least: 12, or 3 that span this time \[s\]. Now and then weather is calmer
/// than ever before.
const LEAST_LOOKS: usize = 12;
const LEAST_SPARSE_LOOKS: usize = 3;
const LEAST_S: f64 = 36.0 * 3600.0;
/// Share of a new interval in the usual one.
const FOLLOW: f64 = 0.1;

/// Judgement of a standstill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Still {
    /// Weather.
    No,
    /// Too rare to be trusted yet.
    Held,
    /// A dead thermometer.
    Dead,
}

/// Memory of standstills.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Standstill {
    /// First and last look of the present run, and its number of looks.
    run: Option<(Reading, Timestamp, usize)>,
    /// Per length of a run in looks, number of looks at which it could end and did not; the last for all
    /// longer ones.
    stayed: Vec<u32>,
    /// Per length of a run in looks, number of looks at which it ended.
    ended: Vec<u32>,
    /// Sizes of the last non-zero steps \[K\].
    steps: Vec<f64>,
    /// Index of the next step.
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

    /// True in a standstill that does not come every day: the thermometer may have died with its first reading.
    pub fn is_unusual(&self) -> bool {
        let looks = self.run.map_or(0, |(_, _, looks)| looks);
        looks >= 2 && self.steps.len() >= LEAST_STEPS && self.a_year(looks) < EVERYDAY_A_YEAR
    }

    /// Takes a reading, later than all before.
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

    /// Learns from a run that ended. One judged dead counts only as far as it was like others: its end is no
    /// example.
    fn end(&mut self, first: Reading, last: Timestamp, looks: usize) {
        self.stayed.resize(KNOWN, 0);
        self.ended.resize(KNOWN, 0);
        let is_dead = self.judge(first, last, looks) == Still::Dead;
        let like_others = (1..looks).take_while(|n| !is_dead || self.a_year(n + 1) >= HELD_A_YEAR);
        let slots: Vec<usize> = like_others.map(|j| j.min(KNOWN) - 1).collect();
        for slot in slots {
            self.stayed[slot] = self.stayed[slot].saturating_add(1);
        }
        if !is_dead {
            let slot = &mut self.ended[looks.min(KNOWN) - 1];
            *slot = slot.saturating_add(1);
        }
    }

    fn step(&mut self, step: f64) {
        if self.steps.len() < STEPS {
            self.steps.push(step);
        } else {
            self.steps[self.next % STEPS] = step;
        }
        self.next = (self.next + 1) % STEPS;
    }

    /// Judgement of a run of `looks` looks.
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

    /// Upper bound of the expected number of standstills of `looks` looks a year.
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

    /// q f(0): the chance of a zero step, from the steps about zero.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::signal::record::time::YEAR_D;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    /// A thermometer and its place.
    struct World {
        name: &'static str,
        interval_h: f64,
        resolution_k: f64,
        noise_k: f64,
        season_k: f64,
        day_k: f64,
        weather_k: f64,
        slow_k: f64,
        /// Median of the days from death after 200 days to detection, at most; 0: not within 60 days.
        found_d: f64,
    }

    const fn world(
        name: &'static str,
        interval_h: f64,
        resolution_k: f64,
        noise_k: f64,
        [season_k, day_k, weather_k, slow_k]: [f64; 4],
        found_d: f64,
    ) -> World {
        World {
            name,
            interval_h,
            resolution_k,
            noise_k,
            season_k,
            day_k,
            weather_k,
            slow_k,
            found_d,
        }
    }

    const AIR: [f64; 4] = [7.5, 3.0, 2.5, 1.2];
    const CALM: [f64; 4] = [7.5, 1.0, 0.3, 1.2];
    const CRYPT: [f64; 4] = [3.0, 0.1, 0.1, 0.3];
    const HEATED: [f64; 4] = [0.0, 0.02, 0.1, 0.05];

    /// Places from free air to a heated church, with analogue and with digital thermometers that repeat at night.
    const WORLDS: [World; 14] = [
        world("hourly, 0.1 K, noise 0.1 K", 1.0, 0.1, 0.1, AIR, 0.6),
        world("hourly, 0.1 K, no noise", 1.0, 0.1, 0.0, AIR, 0.6),
        world("hourly, 0.1 K, calm weather", 1.0, 0.1, 0.0, CALM, 0.7),
        world("hourly, 0.5 K", 1.0, 0.5, 0.0, AIR, 0.7),
        world("hourly, 1 K", 1.0, 1.0, 0.0, AIR, 1.5),
        world("hourly, 1 K, calm weather", 1.0, 1.0, 0.0, CALM, 5.0),
        world("hourly, 0.1 K, crypt", 1.0, 0.1, 0.0, CRYPT, 4.0),
        world("hourly, 0.5 K, heated", 1.0, 0.5, 0.0, HEATED, 0.0),
        world("5 minutes, 0.1 K, no noise", 1.0 / 12.0, 0.1, 0.0, AIR, 0.6),
        world("6 hours, 0.1 K", 6.0, 0.1, 0.0, AIR, 2.0),
        world("12 hours, 0.1 K", 12.0, 0.1, 0.0, AIR, 2.1),
        world("daily, 0.1 K, noise 0.1 K", 24.0, 0.1, 0.1, AIR, 4.1),
        world("daily, 1 K", 24.0, 1.0, 0.0, AIR, 8.1),
        world("daily, 1 K, crypt", 24.0, 1.0, 0.0, CRYPT, 0.0),
    ];

    impl World {
        fn readings(&self, days: f64, seed: u64) -> Vec<Reading> {
            let mut generator = random::stream(seed, 0);
            let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
            let (mut weather, mut slow) = (normal(), normal());
            let (mut amplitude, mut today) = (1.0, -1.0);
            let gap = self.interval_h / 24.0;
            let (f, g) = ((-gap / 3.0).exp(), (-gap / 25.0).exp());
            let mut day = 11.0 / 24.0;
            let mut readings = Vec::new();
            while day < days {
                if day.floor() != today {
                    today = day.floor();
                    amplitude = (0.6 * normal()).exp();
                }
                weather = f * weather + (1.0 - f * f).sqrt() * normal();
                slow = g * slow + (1.0 - g * g).sqrt() * normal();
                let celsius = 13.0
                    + self.season_k * (TAU * (day / YEAR_D + 0.618 * seed as f64)).cos()
                    + self.day_k * amplitude * (TAU * (day - 0.625)).cos()
                    + self.weather_k * weather
                    + self.slow_k * slow
                    + self.noise_k * normal();
                readings.push(Reading {
                    time: Timestamp::from_nanos(0).plus_seconds(86_400.0 * day),
                    celsius: (celsius / self.resolution_k).round() * self.resolution_k,
                });
                day += gap;
            }
            readings
        }

        /// Number of false findings, and share of readings that waited.
        fn false_findings(&self, years: f64, seed: u64) -> (usize, f64) {
            let mut standstill = Standstill::default();
            let (mut count, mut held, mut was_dead) = (0, 0, false);
            let readings = self.readings(YEAR_D * years, seed);
            for reading in &readings {
                let still = standstill.take(reading);
                let is_dead = still == Still::Dead;
                count += usize::from(is_dead && !was_dead);
                held += usize::from(still == Still::Held);
                was_dead = is_dead;
            }
            (count, held as f64 / readings.len() as f64)
        }

        /// Days from the death of the thermometer to its detection.
        fn found_after(&self, death_d: f64, seed: u64) -> Option<f64> {
            let mut standstill = Standstill::default();
            let mut stuck = None;
            for reading in self.readings(death_d + 60.0, seed) {
                let day = reading.time.seconds_since(Timestamp::from_nanos(0)) / 86_400.0;
                let celsius = if day < death_d {
                    reading.celsius
                } else {
                    *stuck.get_or_insert(reading.celsius)
                };
                let still = standstill.take(&Reading { celsius, ..reading });
                if day >= death_d && still == Still::Dead {
                    return Some(day - death_d);
                }
            }
            None
        }
    }

    /// Days to detection over several seeds: median and 90 % quantile.
    fn delays(world: &World, death_d: f64, seeds: u64) -> [f64; 2] {
        let mut delays: Vec<f64> = (0..seeds)
            .map(|seed| {
                let death_d = death_d + seed as f64 / seeds as f64;
                world.found_after(death_d, 1000 + seed).unwrap_or(f64::INFINITY)
            })
            .collect();
        delays.sort_by(f64::total_cmp);
        [delays[delays.len() / 2], delays[delays.len() * 9 / 10]]
    }

    #[test]
    fn dead_thermometers_are_found_and_calm_weather_is_not_one() {
        let mut all = 0;
        for world in &WORLDS {
            // Stated: 0.05 a year each; four in twelve years have a chance of 1 in 300.
            let count: usize = (0..6).map(|seed| world.false_findings(2.0, seed).0).sum();
            assert!(count < 4, "{}: {count}", world.name);
            all += count;
            let [half, late] = delays(world, 200.0, 10);
            if world.found_d > 0.0 {
                assert!(half <= world.found_d, "{}: {half}", world.name);
            }
            // An ordinary thermometer: twelve equal readings, always.
            if world.name.starts_with("hourly, 0.1 K, no") {
                assert!(late <= 0.6, "{}: {late}", world.name);
            }
        }
        // 8.4 are stated in 168 years; 18 have a chance of 1 in 500.
        assert!(all < 18, "{all}");
    }

    /// The table of docs/tracking.md.
    #[test]
    #[ignore = "a campaign of a minute"]
    fn campaign() {
        println!(
            "| readings | false findings a year | readings that wait | found after 30 days learned | after 200 |"
        );
        for world in &WORLDS {
            let (mut count, mut held) = (0, 0.0);
            for seed in 0..40 {
                let one = world.false_findings(3.0, seed);
                count += one.0;
                held += one.1 / 40.0;
            }
            let [early, late] = [30.0, 200.0].map(|death_d| delays(world, death_d, 40));
            println!(
                "| {} | {:.3} ({count} in 120) | {:.2} % | {:.1} / {:.1} d | {:.1} / {:.1} d |",
                world.name,
                count as f64 / 120.0,
                100.0 * held,
                early[0],
                early[1],
                late[0],
                late[1]
            );
        }
    }

    /// A dead thermometer is not learned from: its next death is found as soon.
    #[test]
    fn a_death_is_no_example_of_calm_weather() {
        let world = &WORLDS[0];
        let mut standstill = Standstill::default();
        let mut found = Vec::new();
        let (mut stuck, mut since) = (None, 0.0);
        for reading in world.readings(400.0, 5) {
            let day = reading.time.seconds_since(Timestamp::from_nanos(0)) / 86_400.0;
            // Dead for forty days of every hundred.
            let celsius = if day % 100.0 < 60.0 {
                (stuck, since) = (None, day);
                reading.celsius
            } else {
                *stuck.get_or_insert(reading.celsius)
            };
            let is_dead = standstill.take(&Reading { celsius, ..reading }) == Still::Dead;
            if is_dead && found.len() < (day / 100.0) as usize + 1 {
                found.push(day - since);
            }
        }
        assert_eq!(found.len(), 4);
        assert!(found.iter().all(|after| *after < 0.6), "{found:?}");
    }
}
