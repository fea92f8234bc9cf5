//! Settings that change while a baseline is being learned, and come back: what was learned rests meanwhile, and goes on.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::archive;
use crate::site::*;
use std::fs;
use tirante::analysis::signal::record::RodId;
use tirante::analysis::track::State;
use tirante::site::store::{Reader, Store};

#[test]
fn a_baseline_that_is_being_learned_rests_while_its_settings_are_away() {
    let site = Site::new(SITE);
    for (name, first_day, days) in [("one", 0, 6), ("two", 6, 2), ("three", 8, 7)] {
        site.simulate(name, &Part::new(first_day, days));
    }
    let other = SITE.replacen("mean = 150e3", "mean = 151e3", 1);
    let put = |config: &str| fs::write(site.path("site.toml"), config).unwrap();
    let replay = |name: &str| {
        let (output, code) = site.replay(&[&format!("archive/{name}.mcap")], "site.db");
        assert_eq!(code, 0, "{}", text(&output.stderr));
        text(&output.stderr)
    };
    let check = |code: i32| {
        let output = site.run(&["check", "site.toml", "--against", "site.db"]);
        assert_eq!(output.status.code(), Some(code), "{}", text(&output.stdout));
        text(&output.stdout)
    };
    let north = || -> State {
        let states = Reader::open(&site.path("site.db")).unwrap().states().unwrap();
        states[&RodId("north".into())].clone()
    };
    replay("one");
    let before = north();
    assert_eq!((before.segment.number, before.learned()), (1, 6));

    put(&other);
    let said = check(0);
    assert!(
        said.contains(
            "rod north: the baseline that is being learned rests (6 of 10 records, segment 1) and begins anew with these settings; it \
             comes back with the old ones: rod.priors.axial_force_n: "
        ),
        "{said}"
    );
    let said = replay("two");
    assert!(
        said.contains(
            "warning: the settings of north changed: its new records begin a new baseline (segment 2); the baseline that segment 1 was \
             learning rests with 6 records until its settings are back; records kept before are not analysed again"
        ),
        "{said}"
    );
    assert_eq!((north().segment.number, north().learned()), (2, 2));

    put(SITE);
    let said = check(0);
    assert!(
        said.contains("the baseline that segment 1 was learning goes on (6 of 10 records)"),
        "{said}"
    );
    let said = replay("three");
    assert!(
        said.contains(
            "the settings of north are those of segment 1 again: the baseline that it was learning was found and goes on with 6 records; \
             the baseline that segment 2 was learning rests with 2 records until its settings are back"
        ) && !said.contains("begin a new baseline"),
        "{said}"
    );
    let after = north();
    let baseline = after.segment.baseline.as_ref().expect("ten records were there");
    assert_eq!(
        (after.segment.number, baseline.first, baseline.records),
        (1, noon(0), 10)
    );
    // The six records are those of before, with their temperatures.
    assert!(after.segment.reference_c.is_some());
    let reader = Reader::open(&site.path("site.db")).unwrap();
    assert_eq!(reader.segments(&RodId("north".into())).unwrap().len(), 2);

    // A baseline does not give way unasked to one that is being learned.
    put(&other);
    let said = check(3);
    assert!(said.contains("rod north: the baseline would be lost"), "{said}");
}

#[test]
fn baselines_that_rest_outlast_those_that_are_being_learned() {
    let mut store = Store::in_memory().unwrap();
    let rod = RodId("north".into());
    let with = |number: u32, has_baseline: bool| {
        let mut state = archive::state(&rod, 1);
        state.segment.number = number;
        state.segment.key = format!("1-{number}");
        if !has_baseline {
            state.segment.baseline = None;
        }
        state
    };
    for number in 1..=10 {
        store.shelve(&with(number, true)).unwrap();
    }
    for number in 11..=20 {
        store.shelve(&with(number, false)).unwrap();
    }
    let kept: Vec<(u32, bool)> = store
        .shelved(&rod)
        .unwrap()
        .into_iter()
        .map(|shelved| (shelved.segment, shelved.has_baseline))
        .collect();
    let wanted: Vec<(u32, bool)> = (3..=10)
        .map(|number| (number, true))
        .chain((13..=20).map(|number| (number, false)))
        .collect();
    assert_eq!(kept, wanted);
}
