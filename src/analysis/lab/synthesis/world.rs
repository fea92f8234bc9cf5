//! Simulated surroundings of a site: temperature, thermometer, masonry, memory, missing records,
//! interference.
//!
//! Slopes and fluctuations are shares of the force at the mean temperature.

use rand::{Rng, RngExt};
use serde::Serialize;

/// Kinds of thermometer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Thermometer {
    /// Reads the air.
    Right,
    /// Stays at one value from day [`FAULT_D`] on.
    Stuck,
    /// Drifts by 0.03 K more every day from that day on.
    Drifting,
    /// Reads 2 K too much from that day on.
    Offset,
    /// Gives nothing from that day on.
    Dead,
    /// No thermometer.
    Missing,
}

/// Day on which a thermometer fails, from the first record.
pub const FAULT_D: f64 = 100.0;

/// Distributions from which a site's rods and instruments are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct World {
    /// Temperature from winter to summer \[K\].
    pub season_k: f64,
    /// Number of readings of the thermometer a day.
    pub readings_per_day: u32,
    /// Largest time by which a reading comes earlier or later \[h\].
    pub reading_jitter_h: f64,
    /// The thermometer.
    pub thermometer: Thermometer,
    /// Share of records that are missing.
    pub missing: f64,
    /// Share of records that give no frequencies.
    pub rejected: f64,
    /// Range of the slope of the force with the rod's temperature \[1/K\].
    pub slope_per_k: [f64; 2],
    /// Range of the rod's thermal lag \[h\].
    pub lag_h: [f64; 2],
    /// Range of the slope of the force with the masonry's temperature \[1/K\].
    pub masonry_per_k: [f64; 2],
    /// Thermal lag of the masonry \[d\].
    pub masonry_d: f64,
    /// Standard deviation of a fluctuation of the force, half of its variance common to the site.
    pub fluctuation: f64,
    /// Its memory \[d\].
    pub memory_d: f64,
    /// Amplitude of a yearly cycle that temperature does not explain.
    pub cycle: f64,
    /// Share of records with an outlying force, of a standard deviation of 3 %.
    pub outliers: f64,
    /// Standard deviation of what spells of a few days add to each record of a rod, twice a month or so.
    pub spells: f64,
    /// Share of records whose second mode is pulled towards a line.
    pub interference: f64,
    /// True if records begin in the middle of November; else on any day of the year.
    pub is_winter: bool,
}

/// World without difficulties.
const BENIGN: World = World {
    season_k: 15.0,
    readings_per_day: 24,
    reading_jitter_h: 0.0,
    thermometer: Thermometer::Right,
    missing: 0.03,
    rejected: 0.0,
    slope_per_k: [-0.01, -0.002],
    lag_h: [2.0, 6.0],
    masonry_per_k: [0.0, 0.0],
    masonry_d: 10.0,
    fluctuation: 0.0,
    memory_d: 5.0,
    cycle: 0.0,
    outliers: 0.0,
    spells: 0.0,
    interference: 0.0,
    is_winter: false,
};

impl World {
    /// Names of the worlds.
    pub const NAMES: [&'static str; 18] = [
        "benign",
        "restrained",
        "sparse",
        "masonry-8d",
        "masonry-30d",
        "memory-5d",
        "memory-20d",
        "harsh",
        "winter",
        "cycle",
        "outliers",
        "spells",
        "interference",
        "stuck-thermometer",
        "drifting-thermometer",
        "offset-thermometer",
        "dead-thermometer",
        "mixed",
    ];

    /// World of a name; `mixed` is drawn.
    pub fn named<R: Rng>(name: &str, generator: &mut R) -> Option<Self> {
        let remembers = |memory_d| World {
            fluctuation: 0.002,
            memory_d,
            ..BENIGN
        };
        let faulty = |thermometer| World {
            thermometer,
            ..BENIGN
        };
        Some(match name {
            "benign" => BENIGN,
            "restrained" => Self {
                slope_per_k: [-0.02, -0.015],
                ..BENIGN
            },
            "sparse" => Self {
                readings_per_day: 1,
                lag_h: [15.0, 15.0],
                ..BENIGN
            },
            "masonry-8d" => Self {
                masonry_per_k: [-0.003, -0.001],
                masonry_d: 8.0,
                ..BENIGN
            },
            "masonry-30d" => Self {
                masonry_per_k: [-0.003, 0.003],
                masonry_d: 30.0,
                ..BENIGN
            },
            "memory-5d" => remembers(5.0),
            "memory-20d" => remembers(20.0),
            "harsh" => Self {
                readings_per_day: 1,
                lag_h: [6.0, 24.0],
                masonry_per_k: [-0.003, 0.003],
                masonry_d: 15.0,
                rejected: 0.05,
                ..remembers(5.0)
            },
            "winter" => Self {
                is_winter: true,
                slope_per_k: [-0.015, -0.005],
                masonry_per_k: [-0.003, 0.003],
                masonry_d: 20.0,
                ..BENIGN
            },
            "cycle" => Self {
                cycle: 0.003,
                ..BENIGN
            },
            "outliers" => Self {
                outliers: 0.02,
                ..BENIGN
            },
            "spells" => Self {
                spells: 0.008,
                ..BENIGN
            },
            "interference" => Self {
                interference: 1.0 / 3.0,
                ..BENIGN
            },
            "stuck-thermometer" => faulty(Thermometer::Stuck),
            "drifting-thermometer" => faulty(Thermometer::Drifting),
            "offset-thermometer" => faulty(Thermometer::Offset),
            "dead-thermometer" => faulty(Thermometer::Dead),
            "mixed" => Self::drawn(generator),
            _ => return None,
        })
    }

    /// A mixture of difficulties.
    fn drawn<R: Rng>(generator: &mut R) -> Self {
        let even = |generator: &mut R, low: f64, high: f64| low + (high - low) * generator.random::<f64>();
        let happens = |generator: &mut R, probability: f64| generator.random::<f64>() < probability;
        let mut world = BENIGN;
        world.season_k = even(generator, 8.0, 22.0);
        world.readings_per_day = [24, 24, 8, 1][generator.random_range(0..4)];
        if world.readings_per_day == 1 {
            world.reading_jitter_h = even(generator, 0.0, 3.0);
        }
        let slope = even(generator, -0.018, -0.001);
        world.slope_per_k = [slope - 0.002, slope + 0.001];
        let lag_h = even(generator, 1.0, 16.0);
        world.lag_h = [0.7 * lag_h, 1.4 * lag_h];
        if happens(generator, 0.6) {
            world.masonry_d = even(generator, 5.0, 40.0);
            let slope = even(generator, 5e-4, 3e-3);
            world.masonry_per_k = [-slope, slope];
        }
        if happens(generator, 0.6) {
            world.fluctuation = even(generator, 5e-4, 2.5e-3);
            world.memory_d = libm::exp(even(generator, -0.7, 3.0));
        }
        if happens(generator, 0.4) {
            world.cycle = even(generator, 5e-4, 3e-3);
        }
        if happens(generator, 0.3) {
            world.outliers = even(generator, 0.002, 0.02);
        }
        world.missing = even(generator, 0.0, 0.25);
        world.rejected = even(generator, 0.0, 0.1);
        world.is_winter = happens(generator, 0.3);
        if happens(generator, 0.2) {
            world.spells = even(generator, 0.003, 0.012);
        }
        world
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    #[test]
    fn every_name_is_a_world_and_a_mixture_is_drawn() {
        let mut generator = random::stream(1, 0);
        for name in World::NAMES {
            assert!(World::named(name, &mut generator).is_some(), "{name}");
        }
        assert_eq!(World::named("atlantis", &mut generator), None);
        let two = [0, 1].map(|_| World::named("mixed", &mut generator).unwrap());
        assert_ne!(two[0], two[1]);
        let again = World::named("mixed", &mut random::stream(1, 0));
        assert_eq!(again, World::named("mixed", &mut random::stream(1, 0)));
    }
}
