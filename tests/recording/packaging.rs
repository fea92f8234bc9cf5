//! The same messages in any packaging: the same events in the same order, the same lines, rows and alarms.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::site::rods::{RESTRAINED, rod_with_air, simulated_rod};
use crate::site::*;
use rand::RngExt;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;
use tirante::analysis::signal::record::{Event, RodChannels};
use tirante::analysis::track::ordered::Ordered;
use tirante::config::Config;
use tirante::recording::read::{self, Recordings, Step};
use tirante::site::store::Reader;

/// Longest wait for a daemon on a busy machine.
pub(super) const DEADLINE: Duration = Duration::from_secs(120);

/// Four similar rods and one thermometer.
const RODS: [&str; 4] = ["a", "b", "c", "d"];

/// Configuration of the site, and with its simulation.
pub(super) fn simulated(records: usize, record_s: f64) -> (String, String) {
    let mut site = "[site]\nname = \"Four rods\"\nseed = 5\n".to_owned();
    let mut simulation = format!(
        r#"
[simulation]
start = 2026-03-01T00:00:00Z
records = {records}
interval_s = 3600.0
record_s = {record_s:?}
fs_hz = 100.0
samples_per_message = 20
encoding = "protobuf"
[simulation.climate]
mean_c = 12.0
season_k = 6.0
day_k = 3.0
weather_k = 2.0
between_s = 97
"#
    );
    for (index, id) in RODS.iter().enumerate() {
        site += &rod_with_air(id, 8.0, "/air");
        // A loss that ends at its neighbour's frequencies, and a record that is none.
        let change = match index {
            2 => "[[simulation.rod.change]]\nstart_d = 0.6\nrelative = -0.027\n",
            3 => {
                "[[simulation.rod.fault]]\nkind = \"held\"\nat_s = 3.0\nlength_s = 8.0\nfirst_record = 5\nlast_record = 6\n"
            }
            _ => "",
        };
        let force_n = 140e3 + 4e3 * index as f64;
        simulation += &simulated_rod(id, force_n, 3, &format!("{RESTRAINED}{change}"));
    }
    site += "\n[track]\nbaseline_records = 8\nlearning_periods = 10\nparticles = 64\nperiod_h = 1.0\n";
    (site.clone(), site + &simulation)
}

/// The site's recording, as one file.
pub(super) fn recorded(records: usize, record_s: f64) -> (Site, Vec<mcap::Message<'static>>) {
    let (plain, with_simulation) = simulated(records, record_s);
    made(&plain, &with_simulation)
}

/// A site, and the messages of its simulated recording, `whole.mcap`.
pub(super) fn made(plain: &str, with_simulation: &str) -> (Site, Vec<mcap::Message<'static>>) {
    let site = Site::new(plain);
    let messages = messages(&site.simulate_as("whole.mcap", with_simulation, 3));
    (site, messages)
}

pub(super) fn write<'m>(
    path: &Path,
    messages: impl Iterator<Item = &'m mcap::Message<'static>>,
    chunk_bytes: Option<u64>,
) {
    write_as(path, messages, chunk_bytes, true);
}

fn write_as<'m>(
    path: &Path,
    messages: impl Iterator<Item = &'m mcap::Message<'static>>,
    chunk_bytes: Option<u64>,
    has_summary: bool,
) {
    let mut writer = mcap::WriteOptions::new()
        .use_chunks(chunk_bytes.is_some())
        .chunk_size(chunk_bytes)
        .compression(None)
        .emit_statistics(has_summary)
        .emit_summary_offsets(has_summary)
        .emit_message_indexes(has_summary)
        .emit_chunk_indexes(has_summary)
        .repeat_channels(has_summary)
        .repeat_schemas(has_summary)
        .create(BufWriter::new(File::create(path).unwrap()))
        .unwrap();
    messages.for_each(|message| writer.write(message).unwrap());
    writer.finish().unwrap();
}

/// Writes the messages as files in a folder of their own: chunks of any size, cut at any messages, by topics or not, with a summary or not,
/// and named in any order.
pub(super) fn packaged(folder: &Path, messages: &[mcap::Message<'static>], seed: u64) -> Vec<PathBuf> {
    fs::create_dir(folder).unwrap();
    let mut rng = random::stream(seed, 0);
    let chunk = |rng: &mut rand::rngs::ChaCha8Rng| match rng.random_range(0..5) {
        0 => None,
        1 => Some(8 << 20),
        2 => Some(1 << 20),
        3 => Some(64 << 10),
        _ => Some(rng.random_range(100..20_000)),
    };
    // Which topics lie together.
    let groups = rng.random_range(1..=5usize);
    let mut group_of = BTreeMap::new();
    for message in messages {
        let topic = message.channel.topic.clone();
        group_of
            .entry(topic)
            .or_insert_with(|| rng.random_range(0..groups));
    }
    let mut paths = Vec::new();
    for group in 0..groups {
        let mine: Vec<_> = messages
            .iter()
            .filter(|message| group_of[&message.channel.topic] == group)
            .collect();
        let mut cuts: Vec<usize> = (0..rng.random_range(0..4))
            .map(|_| rng.random_range(0..=mine.len()))
            .collect();
        cuts.extend([0, mine.len()]);
        cuts.sort_unstable();
        for pair in cuts.windows(2).filter(|pair| pair[0] < pair[1]) {
            let path = folder.join(format!("{:08x}.mcap", rng.random::<u32>()));
            let messages = mine[pair[0]..pair[1]].iter().copied();
            write_as(&path, messages, chunk(&mut rng), rng.random_bool(0.7));
            paths.push(path);
        }
    }
    // Given in any order.
    for last in (1..paths.len()).rev() {
        paths.swap(last, rng.random_range(0..=last));
    }
    paths
}

/// The events of recordings in the order a site takes them, samples to the bit.
pub(super) fn events(paths: &[PathBuf], config: &Config) -> Vec<String> {
    let channels: Vec<RodChannels> = config.rods.iter().map(|rod| rod.channels.clone()).collect();
    let files = read::recordings(paths);
    let mut ordered = Ordered::new(config.track.reorder_window_s);
    let mut found = Vec::new();
    for step in Recordings::new(files, channels, config.record, false, Arc::default()) {
        match step {
            Step::More | Step::Wait | Step::End => {}
            Step::File(summary) => {
                let faults = summary.unwrap().faults();
                assert!(faults.is_empty(), "{faults:?}");
            }
            Step::Event(event, place) => {
                ordered.note(&place.reached);
                let rod = event.rod().clone();
                ordered.push(&rod, place.at, event);
                found.extend(std::iter::from_fn(|| ordered.next_settled()));
            }
        }
    }
    found.extend(std::iter::from_fn(|| ordered.next_of_all()));
    found.iter().map(told).collect()
}

/// An event as a text that distinguishes any two.
fn told(event: &Event) -> String {
    match event {
        Event::Record(record) => format!(
            "{} {} {:?} {:?} {:?} {:?} {:?}",
            record.rod,
            record.start,
            record.identity(),
            record.temperature_c,
            record.readings,
            record.flags,
            record.clock_sd,
        ),
        other => format!("{other:?}"),
    }
}

pub(super) fn assert_same(expected: &[String], found: &[String], what: &str) {
    for (index, (one, other)) in expected.iter().zip(found).enumerate() {
        assert_eq!(one, other, "{what}: event {index}");
    }
    assert_eq!(expected.len(), found.len(), "{what}");
}

/// Output of `--json`, and records, states and alarms of the store.
pub(super) fn replayed(site: &Site, paths: &[PathBuf], store: &str) -> (String, String) {
    let paths: Vec<&str> = paths.iter().map(|path| path.to_str().unwrap()).collect();
    let (output, code) = site.replay(&paths, store);
    assert_eq!(code, 3, "{}", text(&output.stderr));
    let dump = Reader::open(&site.path(store)).unwrap().dump().unwrap();
    // A record's row names its file and the position of reading.
    (text(&output.stdout), dump)
}

#[test]
fn chunks_of_any_size_give_the_same_rows() {
    let (site, messages) = recorded(16, 12.0);
    let mut first = None;
    for (name, chunk) in [
        ("small", Some(4000)),
        ("usual", Some(64 << 10)),
        ("one", Some(8 << 20)),
        ("none", None),
    ] {
        let path = site.path("chunked.mcap");
        write(&path, messages.iter(), chunk);
        let found = replayed(&site, &[path], &format!("{name}.db"));
        let expected = first.get_or_insert_with(|| found.clone());
        assert!(found.0.lines().count() >= 60);
        assert_eq!(*expected, found, "{name}");
    }
}

#[test]
fn any_packaging_gives_the_same_events() {
    let (site, messages) = recorded(8, 12.0);
    let config = Config::load(&site.path("site.toml")).unwrap();
    let expected = events(&[site.path("whole.mcap")], &config);
    assert!(expected.len() >= 32, "{}", expected.len());
    for seed in 0..100 {
        let folder = site.path(&format!("packaged-{seed}"));
        let paths = packaged(&folder, &messages, seed);
        let found = events(&paths, &config);
        assert_same(&expected, &found, &format!("seed {seed}, {} files", paths.len()));
        fs::remove_dir_all(folder).unwrap();
    }
}

/// Blocks of a file, a chunk each, in another order.
pub(super) fn in_blocks(path: &Path, blocks: &[&[mcap::Message<'static>]], has_data_checksum: bool) {
    let mut writer = mcap::WriteOptions::new()
        .chunk_size(None)
        .calculate_data_section_crc(has_data_checksum)
        .create(BufWriter::new(File::create(path).unwrap()))
        .unwrap();
    for block in blocks {
        block.iter().for_each(|message| writer.write(message).unwrap());
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
}

/// A recorder that writes blocks late: a finished file is read by time, with a checksum over its data and without.
#[test]
fn blocks_written_out_of_order_cost_nothing() {
    let (site, messages) = recorded(8, 12.0);
    let config = Config::load(&site.path("site.toml")).unwrap();
    let expected = events(&[site.path("whole.mcap")], &config);
    for seed in 0..8 {
        let mut rng = random::stream(seed, 1);
        let mut blocks: Vec<_> = messages.chunks(rng.random_range(20..400)).collect();
        for last in (1..blocks.len()).rev() {
            blocks.swap(last, rng.random_range(0..=last));
        }
        let path = site.path("blocks.mcap");
        in_blocks(&path, &blocks, seed % 2 == 0);
        assert_same(
            &expected,
            &events(std::slice::from_ref(&path), &config),
            &format!("seed {seed}"),
        );
        // A bit in the middle is found in either kind of file.
        let mut bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 4;
        fs::write(&path, bytes).unwrap();
        let (output, code) = site.replay(&[path.to_str().unwrap()], "damaged.db");
        assert_eq!(code, 3);
        assert!(
            text(&output.stderr).contains("blocks.mcap: "),
            "{}",
            text(&output.stderr)
        );
    }
}

/// Two blocks of one channel that overlap in time (a clock set back) stay where they are.
#[test]
fn blocks_that_overlap_in_time_stay_in_their_order() {
    let (site, messages) = recorded(8, 12.0);
    let config = Config::load(&site.path("site.toml")).unwrap();
    let set_back = |message: &mcap::Message<'static>| mcap::Message {
        log_time: message.log_time - 3_597_000_000_000,
        publish_time: message.publish_time - 3_597_000_000_000,
        ..message.clone()
    };
    let half = messages.len() / 2;
    let later: Vec<_> = messages[half..].iter().map(set_back).collect();
    let blocks: Vec<_> = messages[..half].chunks(100).chain(later.chunks(100)).collect();
    let [whole, loose] = ["blocks.mcap", "loose.mcap"].map(|name| site.path(name));
    in_blocks(&whole, &blocks, true);
    // Messages without chunks are read as they stand.
    write(&loose, blocks.iter().copied().flatten(), None);
    let expected = events(&[loose], &config);
    assert_same(&expected, &events(&[whole], &config), "set back");
}

#[test]
fn any_packaging_gives_the_same_rows() {
    let (site, messages) = recorded(24, 12.0);
    same_rows(&site, &messages, 0..3);
}

#[test]
#[ignore = "some ten minutes"]
fn a_hundred_packagings_give_the_same_rows() {
    let (site, messages) = recorded(72, 12.0);
    same_rows(&site, &messages, 100..200);
}

fn same_rows(site: &Site, messages: &[mcap::Message<'static>], seeds: std::ops::Range<u64>) {
    let expected = replayed(site, &[site.path("whole.mcap")], "whole.db");
    for seed in seeds {
        let folder = site.path(&format!("packaged-{seed}"));
        let paths = packaged(&folder, messages, seed);
        let store = format!("{seed}.db");
        let found = replayed(site, &paths, &store);
        assert_eq!(expected.0, found.0, "seed {seed}, {} files", paths.len());
        assert_equal_dumps(&expected.1, &found.1);
        fs::remove_dir_all(folder).unwrap();
        fs::remove_file(site.path(&store)).unwrap();
    }
}

/// A daemon, ended when it is dropped.
pub(super) struct Daemon(pub(super) Child);

impl Daemon {
    /// Starts it with the site's configuration; its log goes on.
    pub(super) fn start(site: &Site) -> Self {
        let log = File::options()
            .create(true)
            .append(true)
            .open(site.path("daemon.log"))
            .unwrap();
        let run = site
            .command(&["run", "--config", "site.toml"])
            .stderr(log)
            .spawn();
        Self(run.unwrap())
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn what_is_sent_live_gives_the_rows_of_its_replay() {
    let (site, _) = recorded(24, 12.0);
    let socket = format!("unix://{}", site.path("in.sock").display());
    let operation = format!(
        "\n[store]\npath = \"live.db\"\n[ingest]\nlisten = [\"{socket}\"]\n[http]\nlisten = \"off\"\n"
    );
    let plain = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(site.path("site.toml"), plain + &operation).unwrap();
    let expected = replayed(&site, &[site.path("whole.mcap")], "whole.db");
    let mut daemon = Daemon::start(&site);
    let until = Instant::now() + DEADLINE;
    while !site.path("in.sock").exists() {
        assert!(Instant::now() < until && daemon.0.try_wait().unwrap().is_none());
        thread::sleep(Duration::from_millis(20));
    }
    let sent = site.run(&["send", "--to", &socket, "--speed", "max", "whole.mcap"]);
    assert!(sent.status.success(), "{}", text(&sent.stderr));
    // Temperatures behind the last records come last, by themselves.
    let mut live = String::new();
    while live != expected.1 {
        if Instant::now() > until {
            assert_equal_dumps(&expected.1, &live);
        }
        thread::sleep(Duration::from_millis(100));
        live = Reader::open(&site.path("live.db"))
            .map_or_else(|_| String::new(), |reader| reader.dump().unwrap());
    }
}

#[test]
fn two_channels_with_one_topic_are_a_fault_that_is_named() {
    let (site, messages) = recorded(8, 12.0);
    // The second rod's sensor under the first one's topic.
    let renamed: Vec<mcap::Message<'static>> = messages
        .into_iter()
        .map(|message| {
            let mut channel = (*message.channel).clone();
            if channel.topic == "/b" {
                channel.topic = "/a".to_owned();
            }
            mcap::Message {
                channel: Arc::new(channel),
                ..message
            }
        })
        .collect();
    let path = site.path("shared.mcap");
    let file = BufWriter::new(File::create(&path).unwrap());
    let mut writer = mcap::WriteOptions::new().create(file).unwrap();
    let mut ids = BTreeMap::new();
    for message in &renamed {
        let channel = &message.channel;
        let id = *ids.entry(channel.id).or_insert_with(|| {
            let schema = channel.schema.as_ref().unwrap();
            let schema = writer
                .add_schema(&schema.name, &schema.encoding, &schema.data)
                .unwrap();
            writer
                .add_channel_with_id(
                    channel.id,
                    schema,
                    &channel.topic,
                    &channel.message_encoding,
                    &channel.metadata,
                )
                .unwrap();
            channel.id
        });
        let header = mcap::records::MessageHeader {
            channel_id: id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        writer.write_to_known_channel(&header, &message.data).unwrap();
    }
    writer.finish().unwrap();
    let (output, code) = site.replay(&["shared.mcap"], "site.db");
    assert_eq!(code, 3);
    let said = text(&output.stderr);
    assert!(
        said.contains("topic /a") && said.contains("have this topic at once"),
        "{said}"
    );
    let said: Vec<String> = lines(&output.stdout)
        .iter()
        .map(|line| format!("{} {}", line["rod"].as_str().unwrap(), line["rejection"]["code"]))
        .collect();
    let of = |start: &str| said.iter().filter(|said| said.starts_with(start)).count();
    // Data that may belong to either rod are not used; the other rods are not affected.
    assert_eq!(
        (of("a"), of("a \"shared-topic\""), of("b")),
        (1, 1, 0),
        "{said:?}"
    );
    assert_eq!(
        (of("c"), of("d"), of("c \"shared") + of("d \"shared")),
        (8, 8, 0),
        "{said:?}"
    );
}
