//! A site whose first rod is measured before all others: most of them have not had their say on a period when its record is looked at.

use crate::scenario::{DAY_S, Scenario};
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap;
use tirante::analysis::lab::synthesis::Truth;
use tirante::analysis::numerics::random;
use tirante::analysis::signal::record::RodId;
use tirante::analysis::track::{Input, Kind, Observation, Tracker, What, Witness};

const RODS: [&str; 4] = ["a", "b", "c", "d"];

/// Days of the records with which the first rod told a drift, with its witness: four rods under one weather, the first measured two
/// hours before the others. `loss`: of the first rod on day 60. `wrong_c`: what the thermometer reads too much from then on.
fn told(seed: u64, loss: f64, wrong_c: f64) -> Vec<(usize, Option<Witness>)> {
    let days = 68;
    let mut trackers = BTreeMap::new();
    let mut records: Vec<(RodId, Observation)> = Vec::new();
    for (place, name) in RODS.into_iter().enumerate() {
        let mut scenario = Scenario::new(days);
        if let Truth::Beam { theta, .. } = &mut scenario.rod.truth {
            theta[0] *= 1.0 - 0.08 * place as f64;
        }
        scenario.rod.thermal.restraint = 0.3 + 0.1 * place as f64;
        if place == 0 && loss != 0.0 {
            scenario = scenario.step(59.5, loss);
        }
        scenario.analysis.rod = RodId(name.to_owned());
        // One seed is one weather, and the same errors of all rods: they have more of their own.
        let mut generator = random::stream(seed, place as u64);
        for mut record in scenario.observations(seed) {
            for mode in &mut record.modes {
                let error: f64 = StandardNormal.sample(&mut generator);
                mode.log_frequency += 5e-4 * error;
            }
            if place > 0 {
                record.start = record.start.plus_seconds(DAY_S / 12.0);
                for reading in &mut record.readings {
                    reading.time = reading.time.plus_seconds(DAY_S / 12.0);
                }
            }
            records.push((RodId(name.to_owned()), record));
        }
        trackers.insert(RodId(name.to_owned()), Tracker::new(scenario.plan("key")));
    }
    records.sort_by_key(|(rod, record)| (record.start, rod.0.clone()));
    let first = records[0].1.start;
    let mut found = Vec::new();
    for (rod, mut record) in records {
        let day = (record.start.seconds_since(first) / DAY_S) as usize;
        for reading in &mut record.readings {
            if reading.time.seconds_since(first) > 59.5 * DAY_S {
                reading.celsius += wrong_c;
            }
        }
        let verdict = Tracker::step_among(&mut trackers, &rod, &Input::Identified(record)).unwrap();
        let drifts = verdict
            .events
            .iter()
            .filter(|event| event.what == What::Raised && event.alarm.kind == Kind::Drift);
        if rod.0 == RODS[0] {
            found.extend(drifts.map(|event| (day, event.alarm.witness)));
        }
    }
    found
}

#[test]
fn a_loss_is_told_with_its_second_record_before_the_others_are_measured() {
    // The third record tells one of 40 seeds, and it is among these.
    for seed in 501..511 {
        let expected = match seed {
            503 => (62, Some(Witness::Confirmed)),
            _ => (61, Some(Witness::Unconfirmed)),
        };
        let told = told(seed, -0.03, 0.0);
        assert_eq!(told.first(), Some(&expected), "{seed}: {told:?}");
    }
}

#[test]
fn a_thermometer_that_jumps_is_no_drift_of_the_rod_that_is_measured_first() {
    for seed in 501..504 {
        assert_eq!(told(seed, 0.0, 3.0), [], "{seed}");
    }
}
