//! A site whose first rod is measured before all others: most of them have not had their say on a period when its record is looked at.

use crate::rods::Rods;
use crate::scenario::DAY_S;
use tirante::analysis::track::{Kind, What, Witness};

/// How often the rods are measured, and when something happens.
#[derive(Clone, Copy)]
struct Visits {
    /// Days from one visit to the next, after the first fifty days, which have one each.
    every_d: usize,
    /// The day of the change \[d\], and all days.
    changed_d: f64,
    days: usize,
}

const DAILY: Visits = Visits {
    every_d: 1,
    changed_d: 59.5,
    days: 68,
};

/// A visit each fortnight, the last three after the change.
const FORTNIGHTLY: Visits = Visits {
    every_d: 14,
    changed_d: 219.5,
    days: 253,
};

/// Days of the records with which the first rod told a drift, with its witness: four rods under one weather, the first measured two
/// hours before the others. `loss`: of the first rod on the day of the change. `wrong_c`: what the thermometer reads too much from then on.
fn told(visits: Visits, seed: u64, loss: f64, wrong_c: f64) -> Vec<(usize, Option<Witness>)> {
    let steps = [(visits.changed_d, loss)];
    let rods = Rods::new(4, visits.days, seed, if loss == 0.0 { &[] } else { &steps }, 2.0);
    let first = rods.records[0].1.start;
    let verdicts = rods.follow(|day, mut record| {
        for reading in &mut record.readings {
            if reading.time.seconds_since(first) > visits.changed_d * DAY_S {
                reading.celsius += wrong_c;
            }
        }
        let day = day as usize;
        (day < 50 || day.is_multiple_of(visits.every_d)).then_some(record)
    });
    let of_first = verdicts.iter().filter(|(_, rod, _)| rod.0 == "a");
    let events =
        of_first.flat_map(|(day, _, verdict)| verdict.events.iter().map(|event| (*day as usize, event)));
    let drifts = events.filter(|(_, event)| event.what == What::Raised && event.alarm.kind == Kind::Drift);
    drifts.map(|(day, event)| (day, event.alarm.witness)).collect()
}

#[test]
fn a_loss_is_told_with_its_second_record_before_the_others_are_measured() {
    let expected = (61, Some(Witness::Unconfirmed));
    for seed in 501..511 {
        let told = told(DAILY, seed, -0.03, 0.0);
        assert_eq!(told.first(), Some(&expected), "{seed}: {told:?}");
    }
}

#[test]
fn a_thermometer_that_jumps_is_no_drift_of_the_rod_that_is_measured_first() {
    for seed in 501..504 {
        assert_eq!(told(DAILY, seed, 0.0, 3.0), [], "{seed}");
    }
}

/// Rounds far apart: the others are those of the round before until it is their turn.
#[test]
fn a_thermometer_that_jumps_between_rounds_is_no_drift_of_the_rod_that_is_measured_first() {
    for seed in 501..506 {
        assert_eq!(told(FORTNIGHTLY, seed, 0.0, 8.0), [], "{seed}");
    }
}

#[test]
fn a_loss_between_rounds_is_told_with_the_second_round() {
    let expected = (238, Some(Witness::Unconfirmed));
    for seed in 501..506 {
        let told = told(FORTNIGHTLY, seed, -0.1, 0.0);
        assert_eq!(told.first(), Some(&expected), "{seed}: {told:?}");
    }
}
