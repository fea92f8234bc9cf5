//! Finished recordings whose messages are out of order: the rows of the sorted one, to the byte.

use super::packaging::{assert_same, events, in_blocks, made, recorded, replayed, simulated, write};
use crate::site::*;
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use tirante::analysis::numerics::random;
use tirante::config::Config;

type Message = mcap::Message<'static>;

const SECOND: u64 = 1_000_000_000;

/// A site of four rods whose data have no gap, cut every 20 s, for two minutes.
fn without_gap() -> (Site, Vec<Message>) {
    let (plain, with_simulation) = simulated(6, 20.0);
    let end_to_end = with_simulation.replace("interval_s = 3600.0", "interval_s = 20.0");
    let cut = "\n[record]\ncut = \"window\"\nwindow_s = 20.0\n";
    made(
        &format!("{plain}{cut}"),
        &(end_to_end.replace("between_s = 97", "between_s = 7") + cut),
    )
}

/// Messages in the order in which a writer is done with them, each up to `window_s` late.
fn shuffled(messages: &[Message], window_s: f64, rng: &mut ChaCha8Rng) -> Vec<Message> {
    let mut late: Vec<(u64, &Message)> = messages
        .iter()
        .map(|message| {
            let late = (rng.random::<f64>() * window_s * 1e9) as u64;
            (message.log_time + late, message)
        })
        .collect();
    late.sort_by_key(|(done, _)| *done);
    late.into_iter().map(|(_, message)| message.clone()).collect()
}

/// The messages of one topic, late by so many seconds.
fn late_topic(messages: &[Message], topic: &str, late_s: u64) -> Vec<Message> {
    let mut late: Vec<&Message> = messages.iter().collect();
    late.sort_by_key(|message| {
        let late = if message.channel.topic == topic { late_s } else { 0 };
        message.log_time + late * SECOND
    });
    late.into_iter().cloned().collect()
}

/// Blocks that threads fill in turn, each a chunk when it is full.
fn by_threads<'m>(messages: &'m [Message], threads: usize, rng: &mut ChaCha8Rng) -> Vec<Vec<&'m Message>> {
    let mut open: Vec<(usize, Vec<&Message>)> = Vec::new();
    open.resize_with(threads, || (rng.random_range(50..400), Vec::new()));
    let mut blocks = Vec::new();
    for message in messages {
        let (size, block) = &mut open[rng.random_range(0..threads)];
        block.push(message);
        if block.len() >= *size {
            blocks.push(std::mem::take(block));
        }
    }
    blocks.extend(open.into_iter().map(|(_, block)| block));
    blocks
}

/// A recording whose messages stand as given must give the events of the sorted one.
fn assert_sorted(site: &Site, messages: &[Message], chunk: u64, what: &str) {
    let config = Config::load(&site.path("site.toml")).unwrap();
    let expected = events(&[site.path("whole.mcap")], &config);
    assert!(expected.len() >= 16, "{}", expected.len());
    assert!(!messages.is_sorted_by_key(|message| message.log_time), "{what}");
    let path = site.path("shuffled.mcap");
    write(&path, messages.iter(), Some(chunk));
    assert_same(&expected, &events(&[path], &config), what);
}

#[test]
fn messages_shuffled_within_a_window_give_the_events_of_the_sorted_recording() {
    for (site, messages) in [recorded(8, 12.0), without_gap()] {
        assert!(messages.is_sorted_by_key(|message| message.log_time));
        for (seed, window_s) in [0.1, 0.3, 1.0, 5.0, 20.0, 60.0]
            .into_iter()
            .cycle()
            .take(24)
            .enumerate()
        {
            let mut rng = random::stream(seed as u64, 2);
            let shuffled = shuffled(&messages, window_s, &mut rng);
            let chunk = [300, 4000, 64 << 10, 8 << 20][rng.random_range(0..4)];
            let what = format!("seed {seed}, {window_s} s, chunks of {chunk}");
            if window_s >= 0.3 {
                assert_sorted(&site, &shuffled, chunk, &what);
            }
        }
    }
}

#[test]
fn chunks_of_several_threads_give_the_events_of_the_sorted_recording() {
    for (site, messages) in [recorded(8, 12.0), without_gap()] {
        let config = Config::load(&site.path("site.toml")).unwrap();
        let expected = events(&[site.path("whole.mcap")], &config);
        for seed in 0..8 {
            let mut rng = random::stream(seed, 3);
            let blocks = by_threads(&messages, 2 + seed as usize % 4, &mut rng);
            let blocks: Vec<Vec<Message>> = blocks
                .into_iter()
                .map(|block| block.into_iter().cloned().collect())
                .collect();
            let blocks: Vec<&[Message]> = blocks.iter().map(Vec::as_slice).collect();
            let path = site.path("threads.mcap");
            in_blocks(&path, &blocks, seed % 2 == 0);
            assert_same(&expected, &events(&[path], &config), &format!("seed {seed}"));
        }
    }
}

/// Through the program: a channel that is flushed late, two loggers merged, a shuffle.
#[test]
fn late_channels_and_merged_loggers_give_the_rows_of_the_sorted_recording() {
    let (site, messages) = without_gap();
    let expected = replayed(&site, &[site.path("whole.mcap")], "whole.db");
    assert!(expected.0.lines().count() >= 20);
    let is_first = |message: &&Message| ["/a", "/air"].contains(&message.channel.topic.as_str());
    let (one, other): (Vec<&Message>, Vec<&Message>) = messages.iter().partition(is_first);
    assert!(!one.is_empty() && !other.is_empty());
    let topics: Vec<&str> = messages
        .iter()
        .map(|message| message.channel.topic.as_str())
        .collect();
    let of_a_rod = topics.iter().find(|topic| **topic != "/air").unwrap();
    let merged: Vec<Message> = one.into_iter().chain(other).cloned().collect();
    let variants = [
        ("a sensor late", late_topic(&messages, of_a_rod, 30)),
        ("the thermometer late", late_topic(&messages, "/air", 30)),
        ("one logger behind the other", merged),
        ("shuffled", shuffled(&messages, 10.0, &mut random::stream(9, 4))),
    ];
    for (index, (what, late)) in variants.iter().enumerate() {
        let path = site.path("late.mcap");
        write(&path, late.iter(), Some(8000));
        let found = replayed(&site, &[path], &format!("late-{index}.db"));
        assert_eq!(expected.0, found.0, "{what}");
        assert_equal_dumps(&expected.1, &found.1);
    }
}

/// Stamps that scatter, are late or wild: the order in which the messages stand is the true one.
#[test]
fn stamps_that_are_off_do_not_move_messages() {
    let (site, messages) = without_gap();
    let config = Config::load(&site.path("site.toml")).unwrap();
    let stamped = |off: &dyn Fn(usize, u64) -> u64| -> Vec<Message> {
        let stamp = |(index, message): (usize, &Message)| mcap::Message {
            log_time: off(index, message.log_time),
            ..message.clone()
        };
        messages.iter().enumerate().map(stamp).collect()
    };
    let one = messages.len() / 2;
    let variants = [
        (
            "late",
            stamped(&|index, time| time + if index == one { SECOND * 7 / 3 } else { 0 }),
        ),
        (
            "wild",
            stamped(&|index, time| time + if index == one { 86_400 * SECOND } else { 0 }),
        ),
        (
            "scattered",
            stamped(&|index, time| time + (index as u64 * 7919 % 1000) * SECOND / 4000),
        ),
        (
            "set back",
            stamped(&|index, time| time - if index > one { 2 * SECOND + SECOND / 30 } else { 0 }),
        ),
    ];
    for (what, messages) in variants {
        let [chunked, loose] = ["chunked.mcap", "loose.mcap"].map(|name| site.path(name));
        write(&chunked, messages.iter(), Some(8000));
        write(&loose, messages.iter(), None);
        assert_same(&events(&[loose], &config), &events(&[chunked], &config), what);
    }
}

/// The recording beside so many other messages of 100 kB, all of them anywhere in the file.
fn amid_others(path: &Path, messages: &[Message], count: usize) {
    let channel = std::sync::Arc::new(mcap::Channel {
        id: 99,
        topic: "/pictures".to_owned(),
        schema: None,
        message_encoding: "json".to_owned(),
        metadata: Default::default(),
    });
    let mut rng = random::stream(1, 5);
    let others = (0..count).map(|index| Message {
        channel: channel.clone(),
        sequence: 0,
        log_time: messages[index * messages.len() / count].log_time,
        publish_time: 0,
        data: vec![b' '; 100_000].into(),
    });
    let mut all: Vec<(u32, Message)> = messages
        .iter()
        .cloned()
        .chain(others)
        .map(|message| (rng.random(), message))
        .collect();
    all.sort_by_key(|(place, _)| *place);
    let options = mcap::WriteOptions::new().chunk_size(Some(1 << 20));
    let mut writer = options
        .create(BufWriter::new(File::create(path).unwrap()))
        .unwrap();
    all.iter().for_each(|(_, message)| writer.write(message).unwrap());
    writer.finish().unwrap();
}

#[test]
fn what_is_out_of_order_beyond_the_window_is_named() {
    let (site, messages) = without_gap();
    let config = Config::load(&site.path("site.toml")).unwrap();
    let expected = events(&[site.path("whole.mcap")], &config);
    let path = site.path("pictures.mcap");
    amid_others(&path, &messages, 200);
    assert_same(&expected, &events(&[path], &config), "within the window");
    let path = site.path("pictures.mcap");
    amid_others(&path, &messages, 500);
    let (output, code) = site.replay(&[path.to_str().unwrap()], "beyond.db");
    let told = text(&output.stderr);
    assert_eq!(code, 3, "{told}");
    for part in ["pictures.mcap: /", " at 2026-03-01T00:0", "32 MB", "mcap sort"] {
        assert!(told.contains(part), "{part}: {told}");
    }
}
