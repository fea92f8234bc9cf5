//! The protocol of the sockets without sockets: any split of the bytes gives the same, and no bytes do
//! harm.

#![allow(clippy::unwrap_used, reason = "a stream that cannot be made fails the test")]

use crate::common::*;
use rand::{Rng, RngExt};
use std::sync::Arc;
use tirante::analysis::numerics::random;
use tirante::recording::write::{Compression, Encoding, Layout, WriterOptions};
use tirante::service::ingest::{Protocol, Step, TopicSet};
use tirante::service::journal::Entry;

fn topics() -> Arc<TopicSet> {
    Arc::new(["/laser", "/air"].map(str::to_owned).into())
}

/// Result of a client's bytes: batches joined, and the refusal, if any.
#[derive(Debug, Default, PartialEq)]
struct Heard {
    hellos: Vec<String>,
    entries: Vec<Entry>,
    through: Vec<u64>,
    ends: Vec<u64>,
    is_cut: bool,
    foreign: u64,
    refusal: Option<String>,
    held: usize,
}

/// Feeds `parts`, then closes; every named client continues with message 100.
fn hear<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> Heard {
    let mut protocol = Protocol::new(topics());
    let mut heard = Heard::default();
    let mut last = 0;
    let mut take = |protocol: &mut Protocol, heard: &mut Heard| loop {
        let step = protocol.next(7);
        heard.foreign += protocol.take_foreign();
        match step {
            Ok(None) => return true,
            Ok(Some(Step::Batch(batch))) => {
                assert!(batch.through > last, "a batch must lead on");
                last = batch.through;
                assert!(batch.entries.len() < 20_000, "a batch must stay small");
                heard.entries.extend(batch.entries);
            }
            Ok(Some(Step::Hello(name))) => {
                heard.hellos.push(name);
                last = 100;
                protocol.welcome(100);
            }
            Ok(Some(Step::End { messages, .. })) => {
                last = 0;
                heard.ends.push(messages);
            }
            Ok(Some(Step::Cut)) => heard.is_cut = true,
            Err(refusal) => {
                heard.refusal = Some(refusal.to_string());
                return false;
            }
        }
    };
    for part in parts {
        protocol.push(part);
        if !take(&mut protocol, &mut heard) {
            return heard;
        }
        heard.held = heard.held.max(protocol.held());
    }
    protocol.close();
    take(&mut protocol, &mut heard);
    heard
}

fn of(bytes: &[u8]) -> Heard {
    hear([bytes])
}

fn values(heard: &Heard) -> Vec<Vec<u8>> {
    let messages = heard.entries.iter().filter_map(|entry| match entry {
        Entry::Message { data, .. } => Some(data.clone()),
        Entry::Channel { .. } => None,
    });
    messages.collect()
}

fn mcap(options: WriterOptions, count: usize) -> Vec<u8> {
    recording(Encoding::Json, Layout::Sample, options, count)
}

const LINES: &str = "{\"topic\":\"/laser\",\"time\":5,\"value\":1e-5}\n\
    \n  {\"topic\":\"/none\",\"value\":1}\r\n\
    {\"topic\":\"/air\",\"value\":20.5,\"time\":\"1970-01-01T00:00:01Z\"}\n{\"topic\":\"/laser\",\"value\":2}";

#[test]
fn lines_become_messages() {
    let heard = of(LINES.as_bytes());
    let channel = |id, topic: &str| Entry::Channel {
        id,
        topic: topic.into(),
        encoding: "json".into(),
        schema: None,
    };
    let message = |channel, time, line: &str| Entry::Message {
        channel,
        log_time: time,
        publish_time: time,
        data: line.as_bytes().to_vec(),
    };
    let lines: Vec<&str> = LINES.lines().map(str::trim).collect();
    let expected = [
        channel(0, "/laser"),
        message(0, 5, lines[0]),
        channel(1, "/air"),
        message(1, 1_000_000_000, lines[3]),
        message(0, 7, lines[4]),
    ];
    assert_eq!(heard.entries, expected);
    assert_eq!(
        (heard.ends, heard.foreign, heard.is_cut, heard.refusal),
        (vec![4], 1, false, None)
    );
}

#[test]
fn a_topic_that_is_to_be_named_is_seen_among_any_number_of_others() {
    let mut protocol = Protocol::new(Arc::new(["/air".to_owned()].into()));
    protocol.name(topics());
    for number in 0..100 {
        protocol.push(format!("{{\"topic\":\"/none-{number}\",\"value\":1}}\n").as_bytes());
    }
    protocol.push(b"{\"topic\":\"/laser\",\"value\":1}\n");
    while protocol.next(7).unwrap().is_some() {}
    assert!(protocol.strays().any(|topic| topic == "/laser"));
    assert!(protocol.strays().count() < 20);
}

#[test]
fn any_cut_of_the_bytes_means_the_same() {
    let small = WriterOptions {
        chunk_bytes: Some(300),
        ..Default::default()
    };
    let hello = b"{\"hello\":{\"sender\":\"north\"}}\n".to_vec();
    let streams = [
        LINES.as_bytes().to_vec(),
        mcap(small, 20),
        mcap(
            WriterOptions {
                chunk_bytes: None,
                compression: Compression::None,
                checksums: false,
                ..small
            },
            20,
        ),
        [
            mcap(small, 12),
            mcap(small, 5),
            b"\n".to_vec(),
            LINES.as_bytes().to_vec(),
        ]
        .concat(),
        [
            hello.clone(),
            mcap(small, 12),
            hello.clone(),
            b"{\"end\":true}\n".to_vec(),
            mcap(small, 3),
        ]
        .concat(),
        [hello, LINES.as_bytes().to_vec(), b"\n{\"end\":true}".to_vec()].concat(),
    ];
    for stream in streams {
        let whole = Heard {
            held: 0,
            ..of(&stream)
        };
        assert!(
            whole.refusal.is_none() && !whole.is_cut && !whole.ends.is_empty(),
            "{whole:?}"
        );
        for step in (1..40).chain([100, 1000]) {
            assert_eq!(
                Heard {
                    held: 0,
                    ..hear(stream.chunks(step))
                },
                whole,
                "in steps of {step}"
            );
        }
    }
}

#[test]
fn an_mcap_stream_gives_its_messages_and_the_next_one_its_own() {
    let one = mcap(WriterOptions::default(), 500);
    let heard = of(&[one.clone(), one.clone()].concat());
    assert_eq!(
        (heard.ends.clone(), heard.refusal.clone()),
        (vec![500, 500], None)
    );
    let values = values(&heard);
    assert_eq!(values.len(), 1000);
    assert_eq!(values[..500], values[500..]);
    // Every prefix of the stream gives a prefix of the messages, and is reported as cut.
    for length in (8..one.len()).step_by(97) {
        let heard = of(&one[..length]);
        let count = super_prefix(&values, &heard);
        assert!(
            heard.is_cut && heard.refusal.is_none() && heard.ends.is_empty(),
            "{length}: {count}"
        );
    }
}

fn super_prefix(values: &[Vec<u8>], heard: &Heard) -> usize {
    let found = self::values(heard);
    assert_eq!(found[..], values[..found.len()]);
    found.len()
}

#[test]
fn a_named_stream_goes_on_where_it_was_and_counts_every_message() {
    let hello = "{\"hello\":{\"sender\":\"north\"}}\n";
    let heard = of(format!("{hello}{LINES}\n{{\"end\":true}}\n").as_bytes());
    assert_eq!((heard.hellos, heard.ends), (vec!["north".to_owned()], vec![104]));
    // A named sender must announce its end.
    let heard = of(format!("{hello}{LINES}").as_bytes());
    assert!(heard.is_cut && heard.ends.is_empty() && heard.entries.len() == 5);
    // Messages of no rod's topic move it on too.
    let heard = of(format!("{hello}{{\"topic\":\"/none\"}}\n{{\"end\":true}}\n").as_bytes());
    assert_eq!((heard.ends, heard.entries.len()), (vec![101], 0));
}

#[test]
fn what_came_before_a_fault_is_kept_and_the_fault_has_one_sentence() {
    let nested = format!("{{\"topic\":\"/laser\",\"x\":{}}}\n", "[".repeat(1000));
    for (bad, what) in [
        ("nonsense\n", "cannot be read"),
        ("{\"value\":1}\n", "no \"topic\""),
        ("{\"hello\":{\"sender\":\"x\"}}\n", "in the middle"),
        ("{\"topic\":\"/laser\",\"time\":1.5}\n", "\"time\""),
        (&nested, "cannot be read: expected value at column"),
    ] {
        let heard = of(format!("{LINES}\n{bad}{LINES}").as_bytes());
        let refusal = heard.refusal.clone().unwrap();
        assert!(refusal.contains("line 6") && refusal.contains(what), "{refusal}");
        assert_eq!((heard.entries.len(), heard.ends.len()), (5, 0), "{bad}");
    }
    for (bad, what) in [
        (&b"\x16\x03\x01\x02\x00"[..], "TLS"),
        (b"GET / HTTP/1.1\r\n", "neither"),
        (b"\x89MCAQ", "neither"),
        (b"\0\0\0\0", "neither"),
    ] {
        assert!(of(bad).refusal.unwrap().contains(what));
    }
    let long = format!("{{\"topic\":\"/laser\",\"x\":\"{}\"}}", "x".repeat(1 << 20));
    assert!(
        of(long.as_bytes())
            .refusal
            .unwrap()
            .contains("more than 1048576 bytes")
    );
    assert!(
        of(format!("{long}\n").as_bytes())
            .refusal
            .unwrap()
            .contains("more than 1048576 bytes")
    );
}

#[test]
fn a_large_chunk_comes_in_small_batches() {
    let options = WriterOptions {
        chunk_bytes: Some(6 << 20),
        ..Default::default()
    };
    let heard = of(&mcap(options, 100_000));
    assert_eq!(
        (heard.ends.clone(), values(&heard).len()),
        (vec![100_000], 100_000)
    );
}

#[test]
fn a_torn_last_line_is_a_cut_and_not_a_value() {
    let heard = of(b"{\"topic\":\"/laser\",\"value\":1}\n{\"topic\":\"/laser\",\"value\":12");
    assert!(
        heard.is_cut && heard.ends.is_empty() && heard.entries.len() == 2,
        "{heard:?}"
    );
}

#[test]
fn topics_of_a_reload_count_from_then_on() {
    for stream in [
        mcap(
            WriterOptions {
                chunk_bytes: Some(200),
                ..Default::default()
            },
            40,
        ),
        {
            let lines: Vec<u8> = (0..40)
                .flat_map(|i| format!("{{\"topic\":\"/laser\",\"value\":{i}}}\n").into_bytes())
                .collect();
            lines
        },
    ] {
        let mut protocol = Protocol::new(Arc::default());
        let mut messages = 0;
        for (i, part) in stream.chunks(stream.len() / 4).enumerate() {
            if i == 2 {
                protocol.retarget(topics());
            }
            protocol.push(part);
            while let Some(step) = protocol.next(7).unwrap() {
                if let Step::Batch(batch) = step {
                    if messages == 0 {
                        assert!(
                            matches!(batch.entries[0], Entry::Channel { .. }),
                            "the channel comes first"
                        );
                    }
                    messages += batch
                        .entries
                        .iter()
                        .filter(|entry| matches!(entry, Entry::Message { .. }))
                        .count();
                }
            }
        }
        assert!(
            (5..35).contains(&messages) && messages + protocol.take_foreign() as usize == 40,
            "{messages}"
        );
    }
}

#[test]
fn lengths_that_lie_are_refused_at_once_and_nothing_is_set_aside_for_them() {
    let whole = mcap(WriterOptions::default(), 10);
    let header = 8 + 9 + u64::from_le_bytes(whole[9..17].try_into().unwrap()) as usize;
    for opcode in [3u8, 5, 6, 9, 0x80] {
        for length in [u64::MAX, 1 << 60, 1 << 40, (16 << 20) + 1] {
            let mut bytes = whole[..header].to_vec();
            bytes.push(opcode);
            bytes.extend(length.to_le_bytes());
            assert!(
                of(&bytes).refusal.unwrap().contains("at most"),
                "{opcode} {length}"
            );
        }
    }
    // A record within the limit is waited for: only the bytes received are held.
    let mut bytes = whole[..header].to_vec();
    bytes.push(6);
    bytes.extend((16u64 << 20).to_le_bytes());
    let heard = of(&bytes);
    assert!(heard.is_cut && heard.held < 1000, "{heard:?}");
    // A chunk that unpacks to more than a live stream may is refused before it is unpacked.
    let options = WriterOptions {
        chunk_bytes: Some(32 << 20),
        ..Default::default()
    };
    let bomb = recording(Encoding::Ros2, Layout::Batch(2_000_000), options, 2_000_000);
    assert!(of(&bomb).refusal.unwrap().contains("at most 12582912"));
}

#[test]
fn damage_of_a_checked_chunk_never_gives_a_wrong_value() {
    let whole = mcap(
        WriterOptions {
            chunk_bytes: Some(500),
            ..Default::default()
        },
        40,
    );
    let good = values(&of(&whole));
    for at in (0..whole.len()).step_by(3) {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        let found = values(&of(&bytes));
        // Channels and topics are outside chunks too: all or a prefix, or nothing.
        assert_eq!(found[..], good[..found.len()], "byte {at}");
    }
}

/// Garbage of several kinds: random bytes, valid streams with bytes changed, left out and put in.
fn garbage(rng: &mut impl Rng, seeds: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = seeds[rng.random_range(0..seeds.len())].clone();
    match rng.random_range(0..4u8) {
        0 => {
            bytes = vec![0; rng.random_range(0..300)];
            rng.fill_bytes(&mut bytes);
            if rng.random_bool(0.5) {
                bytes.splice(
                    0..0,
                    [b"\x89MCAP0\r\n".to_vec(), b"{".to_vec()][rng.random_range(0..2usize)]
                        .iter()
                        .copied(),
                );
            }
        }
        1 => {
            let from = rng.random_range(0..bytes.len());
            let to = rng.random_range(from..bytes.len());
            bytes.drain(from..to);
        }
        2 => {
            let from = rng.random_range(0..bytes.len());
            let piece = bytes[from..rng.random_range(from..bytes.len())].to_vec();
            let at = rng.random_range(0..bytes.len());
            bytes.splice(at..at, piece);
        }
        _ => {}
    }
    for _ in 0..rng.random_range(0..6) {
        if !bytes.is_empty() {
            let at = rng.random_range(0..bytes.len());
            bytes[at] = rng.random();
        }
    }
    bytes
}

fn storm(frames: u64) {
    let mut rng = random::stream(17, 0);
    let small = WriterOptions {
        chunk_bytes: Some(200),
        ..Default::default()
    };
    let seeds = [
        LINES.as_bytes().to_vec(),
        mcap(small, 10),
        mcap(
            WriterOptions {
                compression: Compression::Lz4,
                ..small
            },
            10,
        ),
        mcap(
            WriterOptions {
                compression: Compression::None,
                chunk_bytes: None,
                ..small
            },
            10,
        ),
        [b"{\"hello\":{\"sender\":\"n\"}}\n".to_vec(), mcap(small, 5)].concat(),
    ];
    let mut refused = 0;
    for _ in 0..frames {
        let bytes = garbage(&mut rng, &seeds);
        let step = rng.random_range(1..200);
        let heard = hear(bytes.chunks(step));
        assert!(
            heard.held <= 2 * bytes.len() + 64_000,
            "{} bytes held of {}",
            heard.held,
            bytes.len()
        );
        if let Some(refusal) = heard.refusal {
            assert!(
                !refusal.is_empty() && !refusal.contains("gave up") && refusal.len() < 400,
                "{refusal}"
            );
            refused += 1;
        }
    }
    assert!(refused > frames / 4, "{refused} of {frames} refused");
}

#[test]
fn ten_thousand_frames_of_garbage() {
    storm(10_000);
}

#[test]
#[ignore = "a campaign: minutes"]
fn a_million_frames_of_garbage() {
    storm(1_000_000);
}
