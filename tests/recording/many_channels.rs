//! Thousands of channels with one topic: named shortly. Where the time grew with the square of their number this took minutes.

#![allow(
    clippy::unwrap_used,
    reason = "a recording that cannot be made fails the test"
)]

use crate::common::*;
use std::collections::BTreeMap;
use std::io::Cursor;
use tirante::analysis::signal::record::{RecordSettings, Rejection};
use tirante::recording::read::Event;

/// Messages of so many channels in turn.
fn in_turn(channels: u16, rounds: u64) -> Vec<u8> {
    let mut writer = mcap::WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let ids: Vec<u16> = (0..channels)
        .map(|index| {
            let metadata = BTreeMap::from([("sensor".to_owned(), index.to_string())]);
            writer.add_channel(0, "/laser", "json", &metadata).unwrap()
        })
        .collect();
    for sequence in 0..rounds * u64::from(channels) {
        let header = mcap::records::MessageHeader {
            channel_id: ids[(sequence % u64::from(channels)) as usize],
            sequence: sequence as u32,
            log_time: 1_772_344_800_000_000_000 + sequence * 5_000_000,
            publish_time: 0,
        };
        writer.write_to_known_channel(&header, b"{\"value\":1}").unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn they_are_told_shortly() {
    let bytes = in_turn(4000, 25);
    let (events, summary) = read(bytes, &[rod("r", "/laser", "value")], &RecordSettings::default());
    let told = &summary.topics["/laser"];
    assert_eq!((told.messages, told.undecodable), (100_000, 96_000));
    assert!(
        told.fault
            .as_ref()
            .unwrap()
            .contains(", and 3992 more have this topic at once"),
        "{:?}",
        told.fault
    );
    let refused = events.iter().find_map(|event| match event {
        Event::Rejected {
            rejection: Rejection::SharedTopic { channels, .. },
            ..
        } => Some(channels.clone()),
        _ => None,
    });
    assert!(refused.unwrap().ends_with(", and 3992 more"));
}
