//! Small files that unpack to large ones, read by the program as a process: its real memory is measured.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::fs;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Memory that no file, socket or import may exceed \[MB\].
const PEAK_MB: f64 = 256.0;
/// Longest wait on a busy machine.
const PATIENCE: Duration = Duration::from_secs(240);
/// The same for a daemon that analyses a hundred records of a million samples.
const CAMPAIGN: Duration = Duration::from_secs(3600);
/// Growing files at once.
const GROWING: usize = 12;
const START_NS: u64 = 1_772_344_800_000_000_000;

fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

fn text(text: &[u8]) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text].concat()
}

fn channel(id: u16, schema: u16, topic: &str, encoding: &str) -> Vec<u8> {
    let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
    record(
        4,
        &[ids, text(topic.as_bytes()), text(encoding.as_bytes()), vec![0; 4]].concat(),
    )
}

fn schema(text_of: &[u8]) -> Vec<u8> {
    let name = [vec![1, 0], text(b"a/msg/B"), text(b"ros2msg"), text(text_of)];
    record(3, &name.concat())
}

fn message(id: u16, after_ns: u64, data: &[u8]) -> Vec<u8> {
    let time = (START_NS + after_ns).to_le_bytes();
    record(5, &[&id.to_le_bytes()[..], &[0; 4], &time, &time, data].concat())
}

fn chunk(records: &[u8]) -> Vec<u8> {
    let packed = zstd::bulk::compress(records, 9).unwrap();
    let head = [
        vec![0; 16],
        (records.len() as u64).to_le_bytes().to_vec(),
        crc32fast::hash(records).to_le_bytes().to_vec(),
        text(b"zstd"),
        (packed.len() as u64).to_le_bytes().to_vec(),
    ];
    record(6, &[head.concat(), packed].concat())
}

fn file(parts: &[Vec<u8>]) -> Vec<u8> {
    let magic = b"\x89MCAP0\r\n".to_vec();
    let header = record(1, &[text(b""), text(b"")].concat());
    let end = [record(15, &[0; 4]), record(2, &[0; 20]), magic.clone()].concat();
    [magic, header, parts.concat(), end].concat()
}

/// A ROS 2 message with `count` bytes as samples: a repeating motion that no check refuses.
fn bytes(count: u32) -> Vec<u8> {
    let mut data = vec![0, 1, 0, 0];
    data.extend(count.to_le_bytes());
    let of = |i: u32| {
        let t = f64::from(i) / 100.0;
        let slow = (18.1 * t).sin() + 0.5 * (61.3 * t).sin();
        (128.0 + 50.0 * slow + f64::from(i.wrapping_mul(2_654_435_761) >> 28)) as u8
    };
    let period: Vec<u8> = (0..count.min(1 << 16)).map(of).collect();
    data.extend(period.iter().cycle().take(count as usize));
    data
}

const BYTES: &[u8] = b"uint8[] values\n";

/// Arrays of bytes, one to a chunk: the first rods move, the others give one value, which no analysis spends time on.
fn arrays_where(moving: u16, rods: u16, count: u64, samples: u32) -> Vec<u8> {
    let mut definitions = schema(BYTES);
    for rod in 0..rods {
        definitions.extend(channel(rod + 1, 1, &format!("/rod-{rod}"), "cdr"));
    }
    let mut parts = vec![chunk(&definitions)];
    let motion = bytes(samples);
    let mut held = motion.clone();
    let first = held.len() - samples as usize;
    held[first..].fill(7);
    for number in 0..count {
        for rod in 0..rods {
            let after_ns = number * u64::from(samples) * 10_000_000;
            let data = if rod < moving { &motion } else { &held };
            parts.push(chunk(&message(rod + 1, after_ns, data)));
        }
    }
    file(&parts)
}

/// The same where all rods move.
fn arrays(rods: u16, count: u64, samples: u32) -> Vec<u8> {
    arrays_where(rods, rods, count, samples)
}

fn json_arrays(field: &str, count: u64, samples: usize) -> Vec<u8> {
    let mut parts = vec![chunk(&channel(1, 0, "/rod-0", "json"))];
    let data = format!("{{\"{field}\":[{}0]}}", "0,".repeat(samples - 1));
    for number in 0..count {
        let after_ns = number * samples as u64 * 10_000_000;
        parts.push(chunk(&message(1, after_ns, data.as_bytes())));
    }
    file(&parts)
}

/// Messages of one sample each, `count` per chunk.
fn singles(chunks: u64, count: u64, step_ns: u64) -> Vec<u8> {
    let mut parts = vec![chunk(&channel(1, 0, "/rod-0", "json"))];
    for number in 0..chunks {
        let mut records = Vec::new();
        for i in number * count..(number + 1) * count {
            let data = format!("{{\"values\":[{}]}}", i % 7);
            records.extend(message(1, i * step_ns, data.as_bytes()));
        }
        parts.push(chunk(&records));
    }
    file(&parts)
}

/// Many channels of one topic, all of one large schema.
fn channels(count: u16) -> Vec<u8> {
    let large = [BYTES, b"# ", &vec![b'x'; 1 << 19], b"\n"].concat();
    let mut records = Vec::new();
    for id in 1..=count {
        records.extend(channel(id, 1, "/rod-0", "cdr"));
        records.extend(message(id, u64::from(id) * 10_000_000, &bytes(2)));
    }
    file(&[chunk(&schema(&large)), chunk(&records)])
}

/// A packed MATLAB variable of `count` bytes.
fn matlab(count: u32) -> Vec<u8> {
    let part = |kind: u32, content: &[u8]| {
        let mut part = [kind.to_le_bytes(), (content.len() as u32).to_le_bytes()].concat();
        part.extend(content);
        part.resize(part.len().next_multiple_of(8), 0);
        part
    };
    let parts = [
        part(6, &[9, 0, 0, 0, 0, 0, 0, 0]),
        part(5, &[count.to_le_bytes(), 1u32.to_le_bytes()].concat()),
        part(1, b"x"),
        part(2, &vec![0; count as usize]),
    ];
    let mut pack = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    pack.write_all(&part(14, &parts.concat())).unwrap();
    let packed = pack.finish().unwrap();
    let mut bytes = b"MATLAB 5.0 MAT-file".to_vec();
    bytes.resize(124, b' ');
    bytes.extend([0, 1]);
    bytes.extend(b"IM");
    bytes.extend(15u32.to_le_bytes());
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend(packed);
    bytes
}

fn site(rods: usize, more: &str) -> String {
    let mut text = format!(
        "[site]\nname = \"Weighed\"\nseed = 11\n[abc]\ndraws = 1000\naccept = {{ quantile = 0.1 }}\n{more}"
    );
    for rod in 0..rods {
        text += &crate::site::rods::rod(&format!("rod-{rod}"), 8.0, "values", 100.0);
    }
    text
}

fn start(folder: &Path, words: &[&str]) -> Child {
    let out = |name: &str| fs::File::create(folder.join(name)).unwrap();
    Command::new(env!("CARGO_BIN_EXE_tirante"))
        .args(words)
        .current_dir(folder)
        .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
        .env("TIRANTE_LOG", "info")
        .stdin(Stdio::null())
        .stdout(out("stdout"))
        .stderr(out("stderr"))
        .spawn()
        .unwrap()
}

/// Peak memory of a process so far \[MB\]; `None` if it has ended.
fn peak_mb(pid: u32) -> Option<f64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1024.0)
}

/// Processor time of a process so far \[1/100 s\].
fn cpu_ticks(pid: u32) -> u64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()
}

struct Ran {
    peak_mb: f64,
    took: Duration,
    code: Option<i32>,
    said: String,
}

/// Runs the program to its end and watches its memory.
fn run(folder: &Path, words: &[&str]) -> Ran {
    let begun = Instant::now();
    let mut child = start(folder, words);
    let mut peak: f64 = 0.0;
    let code = loop {
        peak = peak_mb(child.id()).map_or(peak, |now| now.max(peak));
        if let Some(status) = child.try_wait().unwrap() {
            break status.code();
        }
        if begun.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("{words:?} does not end");
        }
        thread::sleep(Duration::from_millis(5));
    };
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    Ran {
        peak_mb: peak,
        took: begun.elapsed(),
        code,
        said: read("stdout") + &read("stderr"),
    }
}

/// Checks one file: its memory, that it ends, and that the reason is reported.
fn weigh(what: &str, config: &str, name: &str, content: &[u8], words: &[&str], told: &str) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("site.toml"), config).unwrap();
    fs::write(folder.path().join(name), content).unwrap();
    let ran = run(folder.path(), words);
    println!(
        "{what}: {} bytes, peak {:.0} MB, {:.1} s, exit {:?}",
        content.len(),
        ran.peak_mb,
        ran.took.as_secs_f64(),
        ran.code
    );
    let short: String = ran.said.chars().take(2000).collect();
    assert!(
        ran.code.is_some_and(|code| code < 100),
        "{what}: {:?} {short}",
        ran.code
    );
    assert!(ran.peak_mb < PEAK_MB, "{what}: {:.0} MB: {short}", ran.peak_mb);
    assert!(ran.said.contains(told), "{what}: {short}");
}

const REPLAY: &[&str] = &["replay", "--config", "site.toml", "it.mcap"];

#[test]
fn arrays_that_unpack_to_gigabytes_are_read_in_pieces_or_left_out_by_name() {
    let one = site(1, "");
    let weigh = |what, content: Vec<u8>, told| weigh(what, &one, "it.mcap", &content, REPLAY, told);
    weigh(
        "JSON arrays of 15 million zeros",
        json_arrays("values", 16, 15_000_000),
        "a message of 30000012 bytes",
    );
    weigh(
        "JSON arrays of 5 million zeros",
        json_arrays("values", 16, 5_000_000),
        "constant signal",
    );
    weigh(
        "ROS 2 arrays of 16 million bytes",
        arrays_where(0, 1, 16, 16_000_000),
        "",
    );
    weigh(
        "JSON messages without the field",
        json_arrays("other", 3, 7_000_000),
        "no field `values`; there is: a message of",
    );
}

#[test]
fn arrays_of_a_million_samples_are_analysed() {
    let content = arrays(1, 8, 1_000_000);
    weigh(
        "ROS 2 arrays of 1 million bytes",
        &site(1, ""),
        "it.mcap",
        &content,
        REPLAY,
        "",
    );
}

#[test]
fn many_rods_share_one_bound() {
    weigh(
        "30 rods of a million samples",
        &site(30, ""),
        "it.mcap",
        &arrays_where(4, 30, 1, 1_000_000),
        REPLAY,
        "end early",
    );
}

#[test]
fn many_messages_and_many_channels_take_little() {
    let one = site(1, "");
    let singly = singles(1, 400_000, 10_000_000);
    weigh(
        "400 000 messages in a chunk",
        &one,
        "it.mcap",
        &singly,
        REPLAY,
        "",
    );
    weigh(
        "60 000 channels of one large schema",
        &one,
        "it.mcap",
        &channels(60_000),
        REPLAY,
        "",
    );
}

#[test]
fn years_at_a_high_rate_take_little_memory_and_little_time() {
    let decays = site(1, "[record]\ncut = \"free-decay\"\n");
    let fast = singles(6, 400_000, 1);
    weigh(
        "2.4 million stamps a nanosecond apart",
        &decays,
        "it.mcap",
        &fast,
        REPLAY,
        "",
    );
    let still = singles(6, 400_000, 0);
    weigh(
        "stamps that stand still",
        &site(1, ""),
        "it.mcap",
        &still,
        REPLAY,
        "",
    );
}

#[test]
fn a_packed_variable_of_bytes_is_refused() {
    let words = [
        "import", "it.mat", "--out", "out.mcap", "--rate", "100", "--unit", "m",
    ];
    let told = "more than";
    weigh(
        "a MATLAB variable of 60 million bytes",
        &site(1, ""),
        "it.mat",
        &matlab(60_000_000),
        &words,
        told,
    );
}

#[test]
#[ignore = "campaign: a hundred records of a million samples, 10 to 15 minutes"]
fn over_a_socket_and_in_the_watched_folder() {
    let folder = tempfile::tempdir().unwrap();
    let more = "[store]\npath = \"site.db\"\n[http]\nlisten = \"127.0.0.1:0\"\n[ingest]\nfolder = \"archive\"\nsettle_s = 1\n\
                listen = [\"unix://SOCKET\"]\n";
    let socket = folder.path().join("in.sock");
    let more = more.replace("SOCKET", socket.to_str().unwrap());
    fs::write(folder.path().join("site.toml"), site(8, &more)).unwrap();
    fs::create_dir(folder.path().join("archive")).unwrap();
    let mut daemon = start(folder.path(), &["run", "--config", "site.toml"]);
    let log = || fs::read_to_string(folder.path().join("stderr")).unwrap();
    let begun = Instant::now();
    let wait = |what: &str, daemon: &mut Child, is_so: &dyn Fn() -> bool| {
        while !is_so() {
            assert!(daemon.try_wait().unwrap().is_none(), "{what}: {}", log());
            assert!(begun.elapsed() < CAMPAIGN, "{what}: {}", log());
            thread::sleep(Duration::from_millis(20));
        }
    };
    wait("it listens", &mut daemon, &|| socket.exists());
    for content in [arrays(8, 1, 4_000_000), arrays(8, 2, 1_000_000), channels(1000)] {
        let mut client = UnixStream::connect(&socket).unwrap();
        client.write_all(&content).unwrap();
        client.shutdown(Shutdown::Write).unwrap();
        let mut answer = String::new();
        client.read_to_string(&mut answer).unwrap();
        assert!(answer.contains("\"done\""), "{answer}");
    }
    println!(
        "sockets: peak {:.0} MB, {:.0} s",
        peak_mb(daemon.id()).unwrap(),
        begun.elapsed().as_secs_f64()
    );
    // Growing files, each with as much as it may have.
    let mut growing = arrays(8, 1, 1_000_000);
    growing.truncate(growing.len() - 8);
    for number in 0..GROWING {
        fs::write(folder.path().join(format!("archive/{number}.mcap")), &growing).unwrap();
    }
    wait("all files are read", &mut daemon, &|| {
        (0..GROWING).all(|number| log().contains(&format!("{number}.mcap is read")))
    });
    let peak = peak_mb(daemon.id()).unwrap();
    println!(
        "daemon: peak {peak:.0} MB, {:.0} s",
        begun.elapsed().as_secs_f64()
    );
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    assert!(peak < PEAK_MB, "{peak:.0} MB");
    // A restart reads again what has no mark yet.
    let mut daemon = start(folder.path(), &["run", "--config", "site.toml"]);
    wait("it is ready again", &mut daemon, &|| log().contains("ready"));
    let mut before = cpu_ticks(daemon.id());
    loop {
        thread::sleep(Duration::from_secs(2));
        let now = cpu_ticks(daemon.id());
        // A tenth of a second within two: it has nothing left to do.
        if now - before < 10 {
            break;
        }
        before = now;
        assert!(
            daemon.try_wait().unwrap().is_none() && begun.elapsed() < CAMPAIGN,
            "{}",
            log()
        );
    }
    let peak = peak_mb(daemon.id()).unwrap();
    println!("started again: peak {peak:.0} MB");
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    assert!(peak < PEAK_MB, "{peak:.0} MB after a restart");
}
