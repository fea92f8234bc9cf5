//! Two sources under one topic: records of one rod that overlap in time.

use crate::archive::{identified, identity};
use tirante::analysis::outcome::Outcome;
use tirante::analysis::signal::record::RodId;
use tirante::site::overlap::{Change, Overlaps};

/// A record of a minute that begins after `minutes`.
fn record(rod: &str, number: i64, minutes: f64) -> Outcome {
    let mut outcome = identified(&RodId(rod.into()), 0);
    if let Outcome::Identified(found) = &mut outcome {
        let measurement = found.measurement.as_mut().unwrap();
        measurement.start = measurement.start.plus_seconds(60.0 * minutes);
        measurement.identity = identity(number);
    }
    outcome
}

#[test]
fn two_recorders_of_one_topic_are_told_with_both_files_until_one_is_gone() {
    let mut overlaps = Overlaps::default();
    let mut told = Vec::new();
    for hour in 0..6 {
        let minutes = 60.0 * hour as f64;
        told.extend(overlaps.take(&record("north", 2 * hour, minutes), "a.mcap"));
        told.extend(overlaps.take(&record("north", 2 * hour + 1, minutes + 0.1), "b.mcap"));
        // Records of another rod of the same time are none of this one's.
        assert_eq!(overlaps.take(&record("south", hour, minutes), "a.mcap"), None);
    }
    let [Change::Begins(sentence)] = &told[..] else {
        panic!("{told:?}");
    };
    for word in ["rod north", "a.mcap and b.mcap", "a topic of its own"] {
        assert!(sentence.contains(word), "{sentence}");
    }
    let later: Vec<_> = (6..20)
        .filter_map(|hour| overlaps.take(&record("north", 100 + hour, 60.0 * hour as f64), "a.mcap"))
        .collect();
    assert_eq!(later, [Change::Ends]);
}

/// The first record after a restart has no other to overlap with, which shows nothing.
#[test]
fn overlaps_that_were_told_before_a_restart_end_like_others() {
    let mut overlaps = Overlaps::default();
    overlaps.resume(&RodId("north".to_owned()));
    let told: Vec<_> = (0..4)
        .flat_map(|hour| {
            [
                (2 * hour, 60.0 * hour as f64),
                (2 * hour + 1, 60.0 * hour as f64 + 0.1),
            ]
        })
        .filter_map(|(number, minutes)| overlaps.take(&record("north", number, minutes), "a.mcap"))
        .collect();
    assert_eq!(told, [], "they go on");
    let later = |overlaps: &mut Overlaps, hour: i64| {
        overlaps.take(&record("north", 100 + hour, 60.0 * hour as f64), "a.mcap")
    };
    let at: Vec<i64> = (4..30)
        .filter(|hour| later(&mut overlaps, *hour).is_some())
        .collect();
    assert_eq!(at.len(), 1, "{at:?}");
}

#[test]
fn records_that_follow_each_other_or_share_an_edge_do_not_overlap() {
    let mut overlaps = Overlaps::default();
    for number in 0..50 {
        let start = 0.9 * number as f64;
        assert_eq!(
            overlaps.take(&record("north", number, start), "a.mcap"),
            None,
            "{number}"
        );
    }
    // What was cut anew once, after a restart.
    assert_eq!(overlaps.take(&record("north", 60, 44.5), "a.mcap"), None);
    assert_eq!(overlaps.take(&record("north", 61, 46.0), "a.mcap"), None);
}
