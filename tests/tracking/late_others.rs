//! A site whose first rod is measured before all others: most of them have not had their say on a period when its record is looked at.

use crate::rods::Rods;
use crate::scenario::DAY_S;
use tirante::analysis::track::{Kind, What, Witness};

/// Days of the records with which the first rod told a drift, with its witness: four rods under one weather, the first measured two
/// hours before the others. `loss`: of the first rod on day 60. `wrong_c`: what the thermometer reads too much from then on.
fn told(seed: u64, loss: f64, wrong_c: f64) -> Vec<(usize, Option<Witness>)> {
    let steps = [(59.5, loss)];
    let rods = Rods::new(4, 68, seed, if loss == 0.0 { &[] } else { &steps }, 2.0);
    let first = rods.records[0].1.start;
    let verdicts = rods.follow(|_, mut record| {
        for reading in &mut record.readings {
            if reading.time.seconds_since(first) > 59.5 * DAY_S {
                reading.celsius += wrong_c;
            }
        }
        Some(record)
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
