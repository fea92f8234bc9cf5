//! A site that is silent for weeks or months, in which a rod loses force: what its first records tell.

use crate::rods::Rods;
use crate::scenario::{Scenario, raised};
use tirante::analysis::signal::record::RodId;
use tirante::analysis::track::{Alarm, Kind, Observation, SetAside, Verdict, What};

/// Without a thermometer a season explains as much as the loss to a rod that is alone; the others tell it, and tell nothing of their own.
#[test]
fn a_loss_in_a_silence_without_a_thermometer_is_a_limit_beside_the_others() {
    // After more than 90 days the clock is doubted as well.
    for (seed, from) in [
        (601, 100.0),
        (602, 100.0),
        (603, 100.0),
        (601, 60.0),
        (602, 60.0),
        (603, 60.0),
    ] {
        let to = 170.0;
        let rods = Rods::new(3, 180, seed, &[(140.0, -0.4)], 0.0);
        let verdicts = rods.follow(|day, mut record| {
            record.readings.clear();
            (day < from || day >= to).then_some(record)
        });
        let events = verdicts
            .iter()
            .flat_map(|(day, rod, verdict)| verdict.events.iter().map(move |event| (*day, &rod.0, event)));
        let after = events.filter(|(day, _, event)| *day > to - 1.0 && event.what == What::Raised);
        let told: Vec<_> = after
            .map(|(day, rod, event)| (day as u32, rod.as_str(), event.alarm.kind))
            .collect();
        // The first record, or the second: the others have shown themselves by then.
        let limit = |day: u32| told.contains(&(day, "a", Kind::Limit));
        assert!(limit(170) || limit(171), "{seed}, {from}: {told:?}");
        let others = |kind: Kind| told.iter().any(|(_, rod, known)| *rod != "a" && *known == kind);
        assert!(
            !others(Kind::Limit) && !others(Kind::Drift),
            "{seed}, {from}: {told:?}"
        );
    }
}

/// A rod that was tightened makes the others seem to fall beside it.
#[test]
fn a_rise_of_one_rod_in_a_silence_is_no_loss_of_the_others() {
    for seed in 601..604 {
        let rods = Rods::new(3, 180, seed, &[(140.0, 0.4)], 0.0);
        let verdicts = rods.follow(|day, mut record| {
            record.readings.clear();
            (!(100.0..170.0).contains(&day)).then_some(record)
        });
        let events = verdicts.iter().flat_map(|(_, _, verdict)| &verdict.events);
        let limits = events.filter(|event| event.alarm.kind == Kind::Limit);
        assert_eq!(limits.count(), 0, "{seed}");
    }
}

/// Two of three rods were tightened: the third, which the season alone moved, has fallen beside both.
#[test]
fn rods_that_were_tightened_in_a_silence_make_no_loss_of_the_one_that_was_not() {
    for seed in 601..605 {
        for from in [60.0, 100.0] {
            for thermometer in [true, false] {
                let told = limits_beside_two_tightened(seed, from, thermometer);
                assert!(told.is_empty(), "{seed}, {from}, {thermometer}: {told:?}");
            }
        }
    }
}

fn limits_beside_two_tightened(seed: u64, from: f64, thermometer: bool) -> Vec<(u32, String)> {
    let mut rods = Rods::new(3, 230, seed, &[], 0.0);
    for place in 0..rods.records.len() {
        let day = rods.day(&rods.records[place].1);
        let (rod, record) = &mut rods.records[place];
        if rod.0 != "c" && day >= 170.0 {
            for mode in &mut record.modes {
                mode.log_frequency += 0.5 * 1.4_f64.ln();
            }
        }
    }
    let verdicts = rods.follow(|day, mut record| {
        if !thermometer {
            record.readings.clear();
        }
        (!(from..170.0).contains(&day)).then_some(record)
    });
    limits(&verdicts)
        .map(|(day, alarm)| (day as u32, alarm.message.clone()))
        .collect()
}

fn but_for(observations: &[Observation], silent: std::ops::Range<usize>) -> Vec<Observation> {
    let kept = observations
        .iter()
        .enumerate()
        .filter(|(day, _)| !silent.contains(day));
    kept.map(|(_, observation)| observation.clone()).collect()
}

/// After more than 90 days the clock is doubted, and five records are set aside: a loss shows in them.
#[test]
fn a_loss_shows_in_records_whose_clock_is_doubted() {
    let scenario = Scenario::new(230).step(150.5, -0.4);
    let observations = but_for(&scenario.observations(611), 100..220);
    let (_, verdicts) = scenario.follow(&observations);
    assert_eq!(verdicts[101].set_aside, Some(SetAside::Clock));
    assert!(
        raised(&verdicts).contains(&(100, Kind::Limit)),
        "{:?}",
        raised(&verdicts)
    );
    // Nothing happened.
    let scenario = Scenario::new(230);
    let observations = but_for(&scenario.observations(611), 100..220);
    let (_, verdicts) = scenario.follow(&observations);
    let told = raised(&verdicts);
    assert!(
        told.iter()
            .all(|(_, kind)| !matches!(kind, Kind::Suspected | Kind::Limit | Kind::Drift)),
        "{told:?}"
    );
}

/// Twenty of thirty records of a baseline, four months without any, and a loss in them: the twenty are the baseline.
#[test]
fn a_silence_ends_the_baseline_with_the_records_before_it() {
    let scenario = Scenario::new(170).step(80.5, -0.4);
    let observations = but_for(&scenario.observations(612), 20..140);
    let (tracker, verdicts) = scenario.follow(&observations);
    let baseline = tracker.state().segment.baseline.as_ref().unwrap();
    assert_eq!(baseline.records, 20);
    let told = raised(&verdicts);
    // Five are set aside, and the second after them decides.
    assert!(told.contains(&(26, Kind::Drift)), "{told:?}");
    assert!(told.iter().any(|(_, kind)| *kind == Kind::Limit), "{told:?}");
}

/// Twenty records say how temperature moves a rod. The others show nothing like the loss by theirs: no thermometer made it.
#[test]
fn a_loss_in_a_silence_while_learning_is_a_limit_though_the_clock_is_doubted() {
    for seed in 613..617 {
        for learned in [20.0, 25.0] {
            let rods = Rods::new(3, 170, seed, &[(80.0, -0.4)], 0.0);
            let verdicts = rods.follow(|day, record| (!(learned..150.0).contains(&day)).then_some(record));
            let told: Vec<_> = limits(&verdicts)
                .map(|(day, alarm)| (day as u32, alarm.rod.0.as_str()))
                .collect();
            assert!(
                told.contains(&(150, "a")) || told.contains(&(151, "a")),
                "{seed}, {learned}: {told:?}"
            );
            assert!(
                told.iter().all(|(_, rod)| *rod == "a"),
                "{seed}, {learned}: {told:?}"
            );
        }
    }
}

/// Another thermometer makes a loss of every rod.
#[test]
fn another_thermometer_after_a_silence_while_learning_makes_no_limit() {
    for seed in 613..617 {
        for by_k in [-15.0, 15.0] {
            let rods = Rods::new(3, 155, seed, &[], 0.0);
            let verdicts = rods.follow(|day, mut record| {
                if day >= 150.0 {
                    for reading in &mut record.readings {
                        reading.celsius += by_k;
                    }
                }
                (!(20.0..150.0).contains(&day)).then_some(record)
            });
            let told: Vec<_> = limits(&verdicts).collect();
            assert!(told.is_empty(), "{seed}, {by_k}: {told:?}");
        }
    }
}

fn limits(verdicts: &[(f64, RodId, Verdict)]) -> impl Iterator<Item = (f64, &Alarm)> {
    verdicts
        .iter()
        .flat_map(|(day, _, verdict)| verdict.events.iter().map(move |event| (*day, event)))
        .filter(|(_, event)| event.what == What::Raised && event.alarm.kind == Kind::Limit)
        .map(|(day, event)| (day, &event.alarm))
}
