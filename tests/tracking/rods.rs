//! Several rods of a site under one weather, at the level of frequencies.

use crate::scenario::{DAY_S, Scenario};
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap;
use tirante::analysis::lab::synthesis::Truth;
use tirante::analysis::numerics::random;
use tirante::analysis::signal::record::RodId;
use tirante::analysis::track::{Input, Observation, Tracker, Verdict};

const RODS: [&str; 4] = ["a", "b", "c", "d"];

/// Rods of unlike length and restraint, and their records in the order of time.
pub struct Rods {
    trackers: BTreeMap<RodId, Tracker>,
    pub records: Vec<(RodId, Observation)>,
}

impl Rods {
    /// Some rods; the force of the first changes on these days by these shares, and it is measured `earlier_h` before the others.
    pub fn new(count: usize, days: usize, seed: u64, steps: &[(f64, f64)], earlier_h: f64) -> Self {
        Self::of(count, days, seed, (steps, 1), earlier_h)
    }

    /// Some rods measured together; the force of the first `changed` changes on these days by these shares.
    pub fn alike(count: usize, days: usize, seed: u64, changed: usize, steps: &[(f64, f64)]) -> Self {
        Self::of(count, days, seed, (steps, changed), 0.0)
    }

    fn of(
        count: usize,
        days: usize,
        seed: u64,
        (steps, changed): (&[(f64, f64)], usize),
        earlier_h: f64,
    ) -> Self {
        let mut trackers = BTreeMap::new();
        let mut records: Vec<(RodId, Observation)> = Vec::new();
        for (place, name) in RODS[..count].iter().enumerate() {
            let mut scenario = Scenario::new(days);
            if let Truth::Beam { theta, .. } = &mut scenario.rod.truth {
                theta[0] *= 1.0 - 0.08 * place as f64;
            }
            scenario.rod.thermal.restraint = 0.3 + 0.1 * place as f64;
            for (day, share) in steps.iter().filter(|_| place < changed) {
                scenario = scenario.step(*day, *share);
            }
            let rod = RodId((*name).to_owned());
            scenario.analysis.rod = rod.clone();
            // One seed is one weather, and the same errors of all rods: they have more of their own.
            let mut generator = random::stream(seed, place as u64);
            for mut record in scenario.observations(seed) {
                for mode in &mut record.modes {
                    let error: f64 = StandardNormal.sample(&mut generator);
                    mode.log_frequency += 5e-4 * error;
                }
                if place > 0 {
                    record.start = record.start.plus_seconds(3600.0 * earlier_h);
                    for reading in &mut record.readings {
                        reading.time = reading.time.plus_seconds(3600.0 * earlier_h);
                    }
                }
                records.push((rod.clone(), record));
            }
            trackers.insert(rod, Tracker::new(scenario.plan("key")));
        }
        records.sort_by_key(|(rod, record)| (record.start, rod.0.clone()));
        Self { trackers, records }
    }

    /// Days since the first record.
    pub fn day(&self, record: &Observation) -> f64 {
        record.start.seconds_since(self.records[0].1.start) / DAY_S
    }

    /// Takes the records that `of` leaves, by their days: day, rod and verdict of each.
    pub fn follow(
        mut self,
        of: impl Fn(f64, Observation) -> Option<Observation>,
    ) -> Vec<(f64, RodId, Verdict)> {
        let mut found = Vec::new();
        for (rod, record) in self.records.clone() {
            let day = self.day(&record);
            let Some(record) = of(day, record) else { continue };
            let verdict = Tracker::step_among(&mut self.trackers, &rod, &Input::Identified(record));
            found.extend(verdict.map(|verdict| (day, rod, verdict)));
        }
        found
    }
}
