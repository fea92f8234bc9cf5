//! A site that is silent for weeks or months, in which a rod loses force: what its first records tell.

use crate::rods::Rods;
use crate::scenario::{Scenario, raised};
use tirante::analysis::track::{Kind, Observation, SetAside, What};

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
