//! Garbage, crowds and hostile files, while a well-behaved client goes on: no panic, bounded memory, its latency as before.

use super::plant::{Plan, Plant, Sender, Take, wait};
use super::usage::{Usage, metric, metrics};
use super::witness::{Witness, spread};
use crate::survival::process::Process;
use rand::{Rng, RngExt};
use std::fs;
use std::io::{Cursor, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;
use tirante::analysis::signal::record::{Timestamp, Unit};
use tirante::recording::write::{
    ChannelSpec, Compression, Encoding, Layout, Precision, RecordingWriter, WriterOptions,
};

const PEAK_MB: f64 = 256.0;
/// Longest latency of the well-behaved client \[s\].
const LATENCY_S: f64 = 1.0;
/// Hostile clients at once; the daemon takes 64.
const CROWD: usize = 40;

/// A daemon with one client that sends a rod in real time, a record every five seconds.
struct Scene {
    plant: Plant,
    daemon: Process,
    _client: Sender,
}

impl Scene {
    fn new() -> Self {
        let plant = Plant::new(Plan {
            rods: 2,
            window_s: 5.0,
            modes: 3,
            more: "settle_s = 1\n".to_owned(),
            ..Plan::default()
        });
        plant.simulate(&Take {
            name: "live",
            record_s: 3600.0,
            ..Take::default()
        });
        let mut daemon = plant.start();
        let client = plant.send("good", &["live.mcap"], &["--stamp-now"]);
        wait(
            &mut daemon,
            "the client's first record",
            Duration::from_secs(30),
            || plant.count("SELECT count(*) FROM record WHERE rod = 'rod-0'") > 0,
        );
        Self {
            plant,
            daemon,
            _client: client,
        }
    }

    /// Does something hostile, then checks client and memory. Takes at least half a minute.
    fn survive(mut self, what: &str, hostile: impl FnOnce(&Plant, &mut Process)) {
        let witness = Witness::start(&self.plant);
        let begun = Instant::now();
        hostile(&self.plant, &mut self.daemon);
        let took = begun.elapsed();
        thread::sleep(Duration::from_secs(30).saturating_sub(took));
        let mut seen = witness.finish();
        seen.retain(|seen| seen.rod == "rod-0");
        let usage = Usage::of(self.daemon.pid());
        let [_, median, most, worst] = spread(&seen);
        println!(
            "{what}: {:.1} s, peak {:.0} MB, {} descriptors; the client's {} records: median {median:.3} s, 95 % {most:.3} s, largest \
             {worst:.3} s",
            took.as_secs_f64(),
            usage.peak_mb,
            usage.descriptors,
            seen.len()
        );
        let log = self.daemon.log();
        assert!(
            self.daemon.is_running() && !log.contains("panicked") && !log.contains("the program broke"),
            "{log}"
        );
        assert!(usage.peak_mb < PEAK_MB);
        // A record every five seconds, none left out.
        assert!(
            seen.len() as f64 > took.as_secs_f64().max(30.0) / 5.0 - 2.0,
            "{}",
            seen.len()
        );
        assert!(worst < LATENCY_S, "{worst}");
        self.daemon.stop("-TERM");
    }
}

/// A small recording of the rod that is not measured.
fn recording(options: WriterOptions, topic: &str, samples: usize) -> Vec<u8> {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), options).unwrap();
    let spec = ChannelSpec {
        topic: topic.to_owned(),
        encoding: Encoding::Json,
        layout: Layout::Batch(5),
        precision: Precision::Double,
        unit: Unit::Metre,
    };
    let id = writer.add_channel(spec).unwrap();
    let start = Timestamp::from_nanos(1_772_344_800_000_000_000);
    let values: Vec<f64> = (0..samples).map(|i| (i as f64 * 0.37).sin() * 1e-4).collect();
    writer.write_samples(id, start, 200.0, &values).unwrap();
    writer.finish().unwrap().into_inner()
}

/// Random bytes, and valid streams with bytes changed, left out and put in.
fn garbage(rng: &mut impl Rng, seeds: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = seeds[rng.random_range(0..seeds.len())].clone();
    match rng.random_range(0..4u8) {
        0 => {
            bytes = vec![0; rng.random_range(1..300)];
            rng.fill_bytes(&mut bytes);
            if rng.random_bool(0.5) {
                bytes.splice(0..0, b"\x89MCAP0\r\n".iter().copied());
            }
        }
        1 => {
            let from = rng.random_range(0..bytes.len() - 1);
            bytes.drain(from..rng.random_range(from..bytes.len() - 1));
        }
        2 => {
            let from = rng.random_range(0..bytes.len());
            let piece = bytes[from..rng.random_range(from..bytes.len())].to_vec();
            let at = rng.random_range(0..bytes.len());
            bytes.splice(at..at, piece);
        }
        _ => {}
    }
    for _ in 0..rng.random_range(1..6) {
        let at = rng.random_range(0..bytes.len());
        bytes[at] = rng.random();
    }
    bytes
}

/// Number of frames: `FRAMES=1000` for fewer.
#[test]
#[ignore = "minutes"]
fn a_million_frames_of_garbage() {
    let frames: usize = std::env::var("FRAMES").map_or(1_000_000, |text| text.parse().unwrap());
    let small = WriterOptions {
        chunk_bytes: Some(200),
        ..WriterOptions::default()
    };
    let lz4 = WriterOptions {
        compression: Compression::Lz4,
        ..small
    };
    let lines =
        "{\"topic\":\"/rod-1\",\"time\":\"2026-03-01T06:00:00.005Z\",\"values\":[1.2e-5,1.3e-5]}\n".repeat(5);
    let seeds = [
        lines.clone().into_bytes(),
        recording(small, "/rod-1", 10),
        recording(lz4, "/rod-1", 10),
        ["{\"hello\":{\"sender\":\"n\"}}\n", &lines].concat().into_bytes(),
    ];
    Scene::new().survive("a million frames of garbage", |plant, _| {
        let (socket, left) = (plant.path("in.sock"), AtomicUsize::new(frames));
        let refused = AtomicUsize::new(0);
        thread::scope(|scope| {
            for stream in 0..CROWD {
                let (socket, left, refused, seeds) = (&socket, &left, &refused, &seeds);
                scope.spawn(move || {
                    let mut rng = random::stream(17, stream as u64);
                    while left
                        .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1))
                        .is_ok()
                    {
                        let mut client = UnixStream::connect(socket).unwrap();
                        client.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
                        // The daemon may close before it has everything.
                        let _ = client.write_all(&garbage(&mut rng, seeds));
                        let _ = client.shutdown(std::net::Shutdown::Write);
                        let mut answer = String::new();
                        let _ = client.read_to_string(&mut answer);
                        refused.fetch_add(usize::from(answer.contains("\"error\"")), Ordering::Relaxed);
                    }
                });
            }
        });
        let refused = refused.into_inner();
        println!("  {refused} of {frames} refused with a reason");
        assert!(refused > frames / 4);
    });
}

#[test]
#[ignore = "half a minute; wants 12 000 descriptors (ulimit -n)"]
fn ten_thousand_connections() {
    Scene::new().survive(
        "10 000 connections, none of which says anything",
        |plant, daemon| {
            let clients: Vec<_> = (0..10_000)
                .map(|_| UnixStream::connect(plant.path("in.sock")).unwrap())
                .collect();
            let refused =
                |daemon: &Process| metric(&metrics(daemon), "tirante_faults_total{kind=\"refused\"");
            let until = Instant::now() + Duration::from_secs(60);
            while refused(daemon) < 9_900.0 {
                assert!(Instant::now() < until, "{} refused", refused(daemon));
                thread::sleep(Duration::from_millis(100));
            }
            assert!(Usage::of(daemon.pid()).descriptors < 200);
            drop(clients);
        },
    );
}

#[test]
#[ignore = "minutes"]
fn a_hundred_thousand_files() {
    Scene::new().survive("100 000 files in the folder", |plant, daemon| {
        let small = recording(WriterOptions::default(), "/elsewhere", 20);
        for number in 0..100_000 {
            fs::write(plant.path(&format!("archive/{number}.mcap")), &small).unwrap();
        }
        wait(daemon, "all files are read", Duration::from_secs(1800), || {
            thread::sleep(Duration::from_millis(500));
            plant.count("SELECT count(*) FROM file WHERE name LIKE '%.mcap' AND name NOT LIKE 'journal/%'")
                == 100_000
        });
    });
}

/// Opcode and content of each record of a file.
fn raw(records: &[(u8, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = b"\x89MCAP0\r\n".to_vec();
    for (opcode, content) in records {
        bytes.push(*opcode);
        bytes.extend((content.len() as u64).to_le_bytes());
        bytes.extend(content);
    }
    bytes
}

/// A chunk that declares `size` bytes and unpacks to a gigabyte of zeros.
fn bomb(size: u64) -> Vec<u8> {
    let mut packed = zstd::Encoder::new(Vec::new(), 3).unwrap();
    for _ in 0..1024 {
        packed.write_all(&[0; 1 << 20]).unwrap();
    }
    let packed = packed.finish().unwrap();
    let head = [
        vec![0; 16],
        size.to_le_bytes().to_vec(),
        vec![0; 4],
        4u32.to_le_bytes().to_vec(),
        b"zstd".to_vec(),
        (packed.len() as u64).to_le_bytes().to_vec(),
        packed,
    ];
    raw(&[(1, vec![0; 8]), (6, head.concat())])
}

#[test]
#[ignore = "half a minute"]
fn a_folder_of_hostile_files() {
    Scene::new().survive("hostile files", |plant, daemon| {
        let folder = plant.path("archive");
        let good = recording(WriterOptions::default(), "/rod-1", 2000);
        let lie = |length: u64| [raw(&[(1, vec![0; 8])]), vec![5], length.to_le_bytes().to_vec()].concat();
        let mut files: Vec<(String, Vec<u8>)> = vec![
            ("empty".to_owned(), Vec::new()),
            ("picture".to_owned(), b"GIF89a".repeat(1000)),
            ("zeros".to_owned(), vec![0; 64 << 20]),
        ];
        for size in [0, 1000, 4 << 20, 1 << 30, 1 << 40, u64::MAX] {
            files.push((format!("bomb-{size}"), bomb(size)));
        }
        for length in [1 << 24, 1 << 30, 1 << 40, u64::MAX / 2, u64::MAX] {
            files.push((format!("lie-{length}"), lie(length)));
        }
        for cut in (0..good.len()).step_by(good.len() / 50) {
            files.push((format!("cut-{cut}"), good[..cut].to_vec()));
        }
        let mut rng = random::stream(23, 0);
        for flip in 0..100 {
            let mut bytes = good.clone();
            let at = rng.random_range(0..bytes.len());
            bytes[at] ^= 1 << rng.random_range(0..8);
            files.push((format!("flip-{flip}"), bytes));
        }
        for (name, bytes) in &files {
            fs::write(folder.join(format!("{name}.mcap")), bytes).unwrap();
        }
        let outside = plant.path("outside.mcap");
        fs::write(&outside, &good).unwrap();
        std::os::unix::fs::symlink(&outside, folder.join("link.mcap")).unwrap();
        std::os::unix::fs::symlink("link-2.mcap", folder.join("link-1.mcap")).unwrap();
        std::os::unix::fs::symlink("link-1.mcap", folder.join("link-2.mcap")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", folder.join("device.mcap")).unwrap();
        fs::create_dir(folder.join("folder.mcap")).unwrap();
        let pipe = folder.join("pipe.mcap");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());

        wait(daemon, "all files are read", Duration::from_secs(120), || {
            plant.count("SELECT count(*) FROM file WHERE name NOT LIKE 'journal/%'") == files.len() as i64
        });
        let links = "SELECT count(*) FROM file WHERE name LIKE '%link%' OR name LIKE '%pipe%' OR name LIKE '%device%'";
        assert_eq!(plant.count(links), 0);
    });
}
