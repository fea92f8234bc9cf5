//! Rods that lose force together: what moves the whole structure is no change of one rod, and no thermometer.

use crate::rods::Rods;
use tirante::analysis::track::{Alarm, Kind, Verdict, Witness};

/// The last verdict of each of `count` rods, the first `losing` of which lose a share of their force on day 80, in the middle of `days`.
fn last(seed: u64, count: usize, losing: usize, loss: f64, days: usize) -> Vec<(String, Verdict)> {
    let rods = Rods::alike(count, days, seed, losing, &[(80.5, loss)]);
    let mut last: Vec<(String, Verdict)> = Vec::new();
    for (_, rod, verdict) in rods.follow(|_, record| Some(record)) {
        last.retain(|(name, _)| *name != rod.0);
        last.push((rod.0, verdict));
    }
    last
}

/// Active alarms of a rod.
fn active(verdict: &Verdict) -> impl Iterator<Item = &Alarm> {
    verdict.alarms.iter().filter(|alarm| alarm.cleared.is_none())
}

fn shows(verdict: &Verdict, kind: Kind) -> bool {
    active(verdict).any(|alarm| alarm.kind == kind)
}

#[test]
fn a_loss_of_all_rods_is_a_notice_of_the_site_and_of_none_by_itself() {
    for seed in 601..607 {
        let rods = last(seed, 4, 4, -0.05, 110);
        let of = |rod: &(String, Verdict)| {
            let kinds = active(&rod.1).map(|alarm| (alarm.kind, alarm.witness));
            (rod.0.clone(), kinds.collect::<Vec<_>>())
        };
        let found: Vec<_> = rods.iter().map(of).collect();
        assert!(
            rods.iter().any(|(_, verdict)| shows(verdict, Kind::Common)),
            "{seed}: {found:?}"
        );
        let confirmed = found.iter().flat_map(|(_, kinds)| kinds);
        assert!(
            confirmed
                .clone()
                .all(|(_, witness)| *witness != Some(Witness::Confirmed)),
            "{seed}: {found:?}"
        );
    }
}

#[test]
fn a_large_loss_of_all_rods_stays_a_limit_of_each() {
    for seed in 601..604 {
        for (rod, verdict) in last(seed, 4, 4, -0.2, 110) {
            let found: Vec<_> = active(&verdict)
                .map(|alarm| (alarm.kind, alarm.message.clone()))
                .collect();
            assert!(shows(&verdict, Kind::Limit), "{seed} {rod}: {found:?}");
            // The notice alone would leave a fifth open, the loss itself.
            let sd = verdict.at_reference.as_ref().unwrap().ratio.sd;
            assert!(sd < 0.05, "{seed} {rod}: {sd}");
        }
    }
}

#[test]
fn a_loss_of_two_rods_of_three_is_a_limit_of_each() {
    for seed in 601..607 {
        for (rod, verdict) in last(seed, 3, 2, -0.1, 110) {
            let found: Vec<_> = active(&verdict)
                .map(|alarm| (alarm.kind, alarm.witness))
                .collect();
            assert_eq!(
                shows(&verdict, Kind::Limit),
                rod != "c",
                "{seed} {rod}: {found:?}"
            );
        }
    }
}
