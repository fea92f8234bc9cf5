//! Years of a site at the level of forces: the thermometer's readings, and the force of every rod at each
//! record.
//!
//! ```text
//! N / N_c = 1 + b (L - T_c) + m (M - T_c) + cycle + fluctuation + outlier + spell + change
//! ```
//!
//! with the air T followed by the rod, L, within hours and by the masonry, M, within weeks. T is a mean of 13 degC, a season,
//! days of 3 K with a lognormal amplitude, and weather of 2.5 K with three days of memory and 1.2 K with 25 days.

use super::Change;
use super::oscillator::normal;
use super::world::{FAULT_D, Thermometer, World};
use crate::numerics::random;
use crate::signal::record::time::{DAY_S, YEAR_D};
use crate::signal::record::{Reading, Timestamp};
use rand::{Rng, RngExt};
use std::f64::consts::TAU;

/// Mean of the air \[degC\], at which forces are one.
const MEAN_C: f64 = 13.0;
/// Coldest day of the year, warmest hour of the day.
const COLDEST_DAY: f64 = 20.0;
const WARMEST_HOUR: f64 = 15.0;
/// Days before the first record from which rods and masonry follow the air.
const BEFORE_D: f64 = 150.0;
/// Hour of the records, and their largest distance from it \[h\].
const RECORD_HOUR: f64 = 11.0;
const RECORD_JITTER_H: f64 = 1.0;
/// Hour of the reading where there is one a day.
const READING_HOUR: f64 = 10.0;
/// Noise of the thermometer \[K\], its drift \[K/d\] and its step \[K\].
const READING_SD_K: f64 = 0.1;
const DRIFT_K_PER_DAY: f64 = 0.03;
const OFFSET_K: f64 = 2.0;
/// Standard deviation of an outlier, and of the curvature \[1/K^2\].
const OUTLIER: f64 = 0.03;
const CURVATURE_PER_K2: f64 = 1e-5;
/// Probability that a spell of larger noise begins on a day, and that one goes on.
const SPELL: [f64; 2] = [0.05, 2.0 / 3.0];
/// Shift of ln f of the second mode by a line beside it.
const LINE_SHIFT: f64 = 0.001;
/// First day of records in winter: the middle of November.
const NOVEMBER: f64 = 320.0;

/// Fate of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// The record gives frequencies.
    Measured,
    /// The record gives no frequencies.
    Rejected,
    /// There is no record.
    Missing,
}

/// One record of one rod.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Time of its first sample.
    pub start: Timestamp,
    /// Effect of the rod's own temperature on the force, as a share of that at the mean temperature.
    pub thermal: f64,
    /// Sum of all other effects, the change among them.
    pub other: f64,
    /// The change.
    pub change: f64,
    /// Shift of ln f of the second mode.
    pub line: f64,
    /// Fate of the record.
    pub fate: Fate,
}

impl Moment {
    /// Force over that at the mean temperature \[-\].
    pub fn force(&self) -> f64 {
        1.0 + self.thermal + self.other
    }
}

/// A site's thermometer and rods.
#[derive(Debug, Clone, PartialEq)]
pub struct SiteYears {
    /// Readings, ascending in time.
    pub readings: Vec<Reading>,
    /// Records of each rod, one a day.
    pub rods: Vec<Vec<Moment>>,
}

/// Temperature of the air every hour from [`BEFORE_D`] days before the first record.
struct Air {
    celsius: Vec<f64>,
}

impl Air {
    fn new<R: Rng>(world: &World, days: usize, first_day: f64, generator: &mut R) -> Self {
        let hours = ((BEFORE_D + days as f64 + 2.0) * 24.0) as usize;
        let (quick, slow) = (Memory::new(72.0), Memory::new(600.0));
        let (mut week, mut month, mut swing) = (normal(generator), normal(generator), 3.0);
        let celsius = (0..hours).map(|hour| {
            let day = hour as f64 / 24.0 - BEFORE_D;
            let of_day = (hour % 24) as f64;
            if of_day == 0.0 {
                swing = 3.0 * libm::exp(0.4 * normal(generator) - 0.08);
            }
            week = quick.next(week, generator);
            month = slow.next(month, generator);
            let season = -0.5 * world.season_k * libm::cos(TAU * (first_day + day - COLDEST_DAY) / YEAR_D);
            let daily = swing * libm::cos(TAU * (of_day - WARMEST_HOUR) / 24.0);
            MEAN_C + season + daily + 2.5 * week + 1.2 * month
        });
        Self {
            celsius: celsius.collect(),
        }
    }

    /// Temperature that follows the air with a lag, exactly for a straight line from hour to hour.
    fn followed(&self, lag_h: f64) -> Self {
        let decay = libm::exp(-1.0 / lag_h);
        let mut value = self.celsius[0];
        let mut before = value;
        let celsius = self.celsius.iter().map(|&now| {
            value = now + (value - before) * decay - (now - before) * (1.0 - decay) * lag_h;
            before = now;
            value
        });
        Self {
            celsius: celsius.collect(),
        }
    }

    /// Temperature at a time in days from the first record's midnight.
    fn at(&self, day: f64) -> f64 {
        let place = ((day + BEFORE_D) * 24.0).clamp(0.0, (self.celsius.len() - 2) as f64);
        let (hour, share) = (place as usize, place.fract());
        self.celsius[hour] * (1.0 - share) + self.celsius[hour + 1] * share
    }
}

/// An Ornstein-Uhlenbeck process of variance one, step by step.
struct Memory {
    keeps: f64,
}

impl Memory {
    /// A process with a memory of `steps` steps.
    fn new(steps: f64) -> Self {
        Self {
            keeps: libm::exp(-1.0 / steps),
        }
    }

    fn next<R: Rng>(&self, value: f64, generator: &mut R) -> f64 {
        self.keeps * value + (1.0 - self.keeps * self.keeps).sqrt() * normal(generator)
    }
}

impl SiteYears {
    /// Draws a site: `rods` of them, one record a day for `days` from `midnight` on; `change` applies to the
    /// first rod, its time in days from the first midnight. The same seed gives the same site.
    pub fn new(
        world: &World,
        rods: usize,
        days: usize,
        midnight: Timestamp,
        change: Option<&Change>,
        seed: u64,
    ) -> Self {
        let mut generator = random::stream(random::seed(&[b"site years", &seed.to_le_bytes()]), 0);
        let generator = &mut generator;
        let first_day = if world.is_winter {
            NOVEMBER + even(generator, -5.0, 5.0)
        } else {
            even(generator, 0.0, YEAR_D)
        };
        let air = Air::new(world, days, first_day, generator);
        let masonry = air.followed(24.0 * world.masonry_d);
        let memory = Memory::new(world.memory_d);
        let mut common = normal(generator);
        let commons: Vec<f64> = (0..days)
            .map(|_| {
                common = memory.next(common, generator);
                common
            })
            .collect();
        let readings = readings(world, &air, days, midnight, generator);
        let rods = (0..rods).map(|rod| {
            let slope = even(generator, world.slope_per_k[0], world.slope_per_k[1]);
            let lagged = air.followed(even(generator, world.lag_h[0], world.lag_h[1]).max(0.1));
            let of_masonry = even(generator, world.masonry_per_k[0], world.masonry_per_k[1]);
            let curvature = CURVATURE_PER_K2 * normal(generator);
            let phase = even(generator, 0.0, TAU);
            let mut own = normal(generator);
            let mut in_spell = false;
            (0..days)
                .map(|index| {
                    let jitter = even(generator, -RECORD_JITTER_H, RECORD_JITTER_H);
                    let day = index as f64 + (RECORD_HOUR + jitter) / 24.0;
                    own = memory.next(own, generator);
                    let warmer = lagged.at(day) - MEAN_C;
                    let fluctuation = world.fluctuation * 0.5_f64.sqrt() * (own + commons[index]);
                    let outlier = if happens(generator, world.outliers) {
                        OUTLIER * normal(generator)
                    } else {
                        0.0
                    };
                    // Worlds without spells draw nothing for them.
                    let mut spell = 0.0;
                    if world.spells > 0.0 {
                        in_spell = happens(generator, SPELL[usize::from(in_spell)]);
                        spell = f64::from(u8::from(in_spell)) * world.spells * normal(generator);
                    }
                    let line = if happens(generator, world.interference) {
                        LINE_SHIFT
                    } else {
                        0.0
                    };
                    let fate = match generator.random::<f64>() {
                        share if share < world.missing => Fate::Missing,
                        share if share < world.missing + world.rejected => Fate::Rejected,
                        _ => Fate::Measured,
                    };
                    let change = change
                        .filter(|_| rod == 0)
                        .map_or(0.0, |change| change.after(day));
                    Moment {
                        start: midnight.plus_seconds(day * DAY_S),
                        thermal: (slope + curvature * warmer) * warmer,
                        other: of_masonry * (masonry.at(day) - MEAN_C)
                            + world.cycle * libm::sin(TAU * day / YEAR_D + phase)
                            + fluctuation
                            + outlier
                            + spell
                            + change,
                        change,
                        line,
                        fate,
                    }
                })
                .collect()
        });
        Self {
            rods: rods.collect(),
            readings,
        }
    }
}

/// Readings of the thermometer.
fn readings<R: Rng>(
    world: &World,
    air: &Air,
    days: usize,
    midnight: Timestamp,
    generator: &mut R,
) -> Vec<Reading> {
    let per_day = world.readings_per_day.max(1);
    let mut held = None;
    let mut readings = Vec::new();
    for index in 0..(days + 1) * per_day as usize {
        let hour = if per_day == 1 { READING_HOUR } else { 0.0 };
        let jitter = even(generator, -world.reading_jitter_h, world.reading_jitter_h);
        let day = index as f64 / f64::from(per_day) - 1.0 + (hour + jitter) / 24.0;
        let celsius = air.at(day) + READING_SD_K * normal(generator);
        let has_failed = day >= FAULT_D;
        let celsius = match world.thermometer {
            Thermometer::Missing => continue,
            Thermometer::Dead if has_failed => continue,
            Thermometer::Stuck if has_failed => *held.get_or_insert(celsius),
            Thermometer::Drifting if has_failed => celsius + DRIFT_K_PER_DAY * (day - FAULT_D),
            Thermometer::Offset if has_failed => celsius + OFFSET_K,
            _ => celsius,
        };
        readings.push(Reading {
            time: midnight.plus_seconds(day * DAY_S),
            celsius,
        });
    }
    readings
}

fn even<R: Rng>(generator: &mut R, low: f64, high: f64) -> f64 {
    low + (high - low) * generator.random::<f64>()
}

fn happens<R: Rng>(generator: &mut R, probability: f64) -> bool {
    generator.random::<f64>() < probability
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world(name: &str) -> World {
        World::named(name, &mut random::stream(0, 0)).unwrap()
    }

    fn midnight() -> Timestamp {
        Timestamp::from_nanos(1_740_787_200_000_000_000)
    }

    #[test]
    fn a_lag_delays_and_damps_a_daily_cosine() {
        let air = Air {
            celsius: (0..24 * 60)
                .map(|hour| libm::cos(TAU * f64::from(hour) / 24.0))
                .collect(),
        };
        let lag_h = 6.0;
        let rod = air.followed(lag_h);
        let x = TAU * lag_h / 24.0;
        for hour in 24 * 50..24 * 58 {
            let day = f64::from(hour) / 24.0 - BEFORE_D;
            let steady = libm::cos(TAU * f64::from(hour) / 24.0 - libm::atan(x)) / (1.0 + x * x).sqrt();
            // Chords of an hour are off by (2 pi / 24)^2 / 8 of the amplitude.
            assert!(
                (rod.at(day) - steady).abs() < 9e-3,
                "{hour}: {} {steady}",
                rod.at(day)
            );
        }
    }

    #[test]
    fn the_change_happens_to_the_first_rod_alone_and_nothing_else_moves() {
        let change = Change {
            start_d: 20.0,
            over_d: 0.0,
            relative: -0.03,
        };
        let of = |change| SiteYears::new(&world("harsh"), 3, 40, midnight(), change, 5);
        let (with, without) = (of(Some(&change)), of(None));
        assert_eq!(with.readings, without.readings);
        assert_eq!(with.rods[1..], without.rods[1..]);
        for (index, (changed, own)) in with.rods[0].iter().zip(&without.rods[0]).enumerate() {
            let expected = if index < 20 { 0.0 } else { -0.03 };
            assert!(
                (changed.force() - own.force() - expected).abs() < 1e-12,
                "{index}"
            );
            assert_eq!(
                (changed.change, changed.fate, changed.start),
                (expected, own.fate, own.start)
            );
        }
    }

    #[test]
    fn records_are_missing_and_rejected_as_often_as_asked() {
        let world = World {
            missing: 0.15,
            rejected: 0.05,
            ..world("benign")
        };
        let site = SiteYears::new(&world, 5, 400, midnight(), None, 1);
        let share = |fate| {
            site.rods
                .iter()
                .flatten()
                .filter(|moment| moment.fate == fate)
                .count() as f64
                / 2000.0
        };
        // Four binomial standard errors of 2000.
        assert!(
            (share(Fate::Missing) - 0.15).abs() < 0.032,
            "{}",
            share(Fate::Missing)
        );
        assert!(
            (share(Fate::Rejected) - 0.05).abs() < 0.02,
            "{}",
            share(Fate::Rejected)
        );
    }

    #[test]
    fn thermometers_fail_on_their_day() {
        let of = |name| SiteYears::new(&world(name), 1, 150, midnight(), None, 3).readings;
        let fails = midnight().plus_seconds(FAULT_D * DAY_S);
        let right = of("benign");
        for name in [
            "stuck-thermometer",
            "drifting-thermometer",
            "offset-thermometer",
            "dead-thermometer",
        ] {
            let own = of(name);
            let before = right.partition_point(|reading| reading.time < fails);
            assert_eq!(own[..before], right[..before], "{name}");
            let last = right.len() - 1;
            match name {
                "stuck-thermometer" => assert_eq!(own[before].celsius, own[last].celsius),
                "dead-thermometer" => assert_eq!(own.len(), before),
                "offset-thermometer" => {
                    assert!((own[last].celsius - right[last].celsius - 2.0).abs() < 1e-12)
                }
                _ => {
                    let days = right[last].time.seconds_since(fails) / DAY_S;
                    assert!((own[last].celsius - right[last].celsius - 0.03 * days).abs() < 1e-9);
                }
            }
        }
        assert!(
            SiteYears::new(
                &World {
                    thermometer: Thermometer::Missing,
                    ..world("benign")
                },
                1,
                9,
                midnight(),
                None,
                3
            )
            .readings
            .is_empty()
        );
    }
}
