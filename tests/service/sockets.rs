//! Live data through real sockets: JSON lines and MCAP, third-party peers, and hostile clients.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use crate::common::*;
use crate::listeners::*;
use std::io::{BufReader, Read, Write};
use std::net::{Shutdown, TcpListener};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tirante::config::settings::ingest::{IngestSettings, Listen};
use tirante::config::{Config, ConfigError};
use tirante::recording::write::{Compression, Encoding, Layout, WriterOptions};
use tirante::service::ingest::{ListenError, Listener};
use tirante::service::journal::End;
use tirante::service::telemetry::Fault;

fn settings() -> IngestSettings {
    IngestSettings::default()
}

fn small() -> WriterOptions {
    WriterOptions {
        chunk_bytes: Some(2000),
        ..Default::default()
    }
}

fn mcap(count: usize) -> Vec<u8> {
    recording(Encoding::Json, Layout::Sample, small(), count)
}

fn lines(range: std::ops::Range<u64>) -> String {
    range.map(|i| line("/laser", i)).collect()
}

const HELLO: &str = "{\"hello\":{\"sender\":\"north-laser\"}}\n";

/// True if a third-party tool is installed; where tests must not be skipped, it is required.
fn has(what: &str, script: &str) -> bool {
    let mut shell = Command::new("sh");
    shell
        .args(["-c", script])
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let is_here = shell.status().is_ok_and(|status| status.success());
    let must = std::env::var_os("TIRANTE_REAL_PEERS").is_some();
    assert!(is_here || !must, "{what} is wanted by TIRANTE_REAL_PEERS");
    if !is_here {
        eprintln!("left out: {what} is not here");
    }
    is_here
}

#[test]
fn json_lines_over_tcp_and_unix() {
    let daemon = Daemon::start(settings());
    let mut client = daemon.client();
    client.send(lines(0..1000));
    client.stream.shutdown(Shutdown::Write).unwrap();
    assert_eq!(client.answer(), "{\"done\":{\"messages\":1000}}");
    assert_eq!(client.answer(), "", "closed");

    let stream = UnixStream::connect(&daemon.path).unwrap();
    let mut client = Client {
        answers: BufReader::new(stream.try_clone().unwrap()),
        stream,
    };
    client.send(lines(0..1000) + "{\"topic\":\"/none\",\"value\":1}\n{\"end\":true}\n");
    let reason = "\"reason\":\"no rod reads the topic /none\"";
    let left_out = format!("{{\"messages\":1,{reason}}}");
    assert_eq!(client.answer(), format!("{{\"left_out\":{left_out}}}"));
    assert_eq!(
        client.answer(),
        format!("{{\"done\":{{\"left_out\":[{left_out}],\"messages\":1001}}}}")
    );

    let streams = daemon.ledger.streams();
    assert_eq!(streams.len(), 2);
    assert_eq!(streams[0].messages().len(), 1000);
    assert_eq!(streams[0].messages(), streams[1].messages());
    assert!(
        streams
            .iter()
            .all(|stream| stream.end == Some(End::Complete) && stream.sender.is_none())
    );
    assert_eq!(daemon.counts.messages.load(Ordering::Relaxed), 2001);
    assert_eq!(daemon.counts.foreign.load(Ordering::Relaxed), 1);
    // The second client is still there, and may begin another stream.
    wait_for("the first one is gone", || daemon.clients() == 1);
    client.send(mcap(10));
    assert_eq!(client.answer(), "{\"done\":{\"messages\":10}}");
    drop(client);
    wait_for("nobody is there", || daemon.clients() == 0);
}

#[test]
fn a_sender_with_a_name_is_told_what_is_durable_and_resumes() {
    let daemon = Daemon::start(settings());
    let mut client = daemon.client();
    client.send(HELLO);
    assert_eq!(
        client.answer(),
        "{\"welcome\":{\"messages\":0,\"sender\":\"north-laser\"}}"
    );
    client.send(lines(0..100));
    let mut ack = String::new();
    while !ack.contains("100") {
        ack.clear();
        std::io::BufRead::read_line(&mut client.answers, &mut ack).unwrap();
        assert!(ack.starts_with("{\"ack\":{\"messages\":"), "{ack}");
    }
    drop(client);
    let written = daemon.until("the cut", |stream| stream.through == 100);
    // Otherwise the name would be taken over from a connection still open, which is another test.
    wait_for("the client is gone", || daemon.clients() == 0);
    assert_eq!(written.end, None, "a sender with a name may come back");

    let mut client = daemon.client();
    client.send(HELLO);
    assert_eq!(
        client.answer(),
        "{\"welcome\":{\"messages\":100,\"sender\":\"north-laser\"}}"
    );
    client.send(lines(100..150) + "{\"end\":true}\n");
    assert_eq!(client.answer(), "{\"done\":{\"messages\":150}}");
    let all: Vec<_> = daemon
        .ledger
        .streams()
        .iter()
        .flat_map(Written::messages)
        .collect();
    assert_eq!(all.len(), 150);
    assert!(all.windows(2).all(|pair| pair[0].1 < pair[1].1));
    assert_eq!(
        daemon.count(Fault::Client) + daemon.count(Fault::Recording),
        0,
        "a cut that may be mended is no fault"
    );
}

#[test]
fn a_newer_connection_of_the_same_name_takes_over() {
    let daemon = Daemon::start(settings());
    let mut old = daemon.client();
    old.send(HELLO.to_owned() + &lines(0..10));
    old.answer();
    daemon.until("ten messages", |stream| stream.through == 10);
    // The old connection is half open: it is never closed.
    let mut new = daemon.client();
    new.send(HELLO);
    assert!(new.answer().contains("\"messages\":10"));
    assert!(old.answer().contains("another connection took over"));
    assert_eq!(old.answer(), "");
    new.send(lines(10..20) + "{\"end\":true}\n");
    assert_eq!(new.answer(), "{\"done\":{\"messages\":20}}");
    assert_eq!(daemon.count(Fault::Client), 1);
}

#[test]
fn without_an_end_a_stream_is_cut() {
    let daemon = Daemon::start(settings());
    let bytes = mcap(1000);
    for length in [bytes.len() / 2, bytes.len() - 1] {
        let mut client = daemon.client();
        client.send(&bytes[..length]);
        client.stream.shutdown(Shutdown::Write).unwrap();
        assert_eq!(client.answer(), "");
        let written = daemon.until("messages", |stream| stream.through > 0);
        assert_eq!(written.end, None);
    }
    assert_eq!(
        (
            daemon.count(Fault::Recording),
            daemon.counts.cut.load(Ordering::Relaxed)
        ),
        (2, 2)
    );
}

#[test]
fn mcap_by_netcat() {
    if !has("netcat (nc)", "command -v nc") {
        return;
    }
    let daemon = Daemon::start(settings());
    let folder = tempfile::tempdir().unwrap();
    let files = [
        folder.path().join("a.mcap"),
        folder.path().join("b.mcap"),
        folder.path().join("c.jsonl"),
    ];
    std::fs::write(
        &files[0],
        recording(Encoding::Ros2, Layout::Batch(50), WriterOptions::default(), 5000),
    )
    .unwrap();
    let options = WriterOptions {
        compression: Compression::None,
        chunk_bytes: None,
        ..small()
    };
    std::fs::write(&files[1], recording(Encoding::Json, Layout::Sample, options, 500)).unwrap();
    std::fs::write(&files[2], lines(0..700)).unwrap();
    let (host, port) = (daemon.address.ip().to_string(), daemon.address.port().to_string());
    let script = "cat \"$1\" \"$2\" | nc -N \"$4\" \"$5\"; cat \"$3\" | nc -N -U \"$6\"";
    let output = Command::new("sh")
        .args(["-c", script, "sh"])
        .args(&files)
        .args([&host, &port])
        .arg(&daemon.path)
        .output()
        .unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    let done: Vec<&str> = said.lines().collect();
    assert_eq!(
        done,
        [
            "{\"done\":{\"messages\":100}}",
            "{\"done\":{\"messages\":500}}",
            "{\"done\":{\"messages\":700}}"
        ],
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(
        daemon
            .ledger
            .streams()
            .iter()
            .all(|stream| stream.end == Some(End::Complete))
    );
}

#[test]
fn mcap_by_the_python_library() {
    if !has("Python's mcap", "python3 -c 'import mcap'") {
        return;
    }
    let daemon = Daemon::start(settings());
    let script = r#"
import json, socket, sys
from mcap.writer import Writer, CompressionType

class Socket:
    """What the writer needs of a file: a socket that counts."""
    def __init__(self, connection):
        self.connection, self.sent = connection, 0
    def write(self, data):
        self.connection.sendall(data)
        self.sent += len(data)
    def tell(self):
        return self.sent
    def flush(self):
        pass

connection = socket.create_connection((sys.argv[1], int(sys.argv[2])))
out = Socket(connection)
for compression in (CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE):
    writer = Writer(out, chunk_size=1024, compression=compression)
    writer.start()
    schema = writer.register_schema("Sample", "jsonschema", b'{"type":"object"}')
    laser = writer.register_channel("/laser", "json", schema)
    other = writer.register_channel("/none", "json", schema)
    for i in range(1000):
        stamp = 1772344800000000000 + i * 5000000
        for channel in (laser, other):
            writer.add_message(channel, stamp, json.dumps({"value": i}).encode(), stamp)
    writer.finish()
connection.shutdown(socket.SHUT_WR)
sys.stdout.write(connection.makefile("r").read())
"#;
    let output = Command::new("python3")
        .args([
            "-c",
            script,
            &daemon.address.ip().to_string(),
            &daemon.address.port().to_string(),
        ])
        .output()
        .unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    // Told with the first message of the connection, and counted at the end of each stream.
    let left_out =
        |messages: u32| format!("{{\"messages\":{messages},\"reason\":\"no rod reads the topic /none\"}}");
    let done = format!(
        "{{\"done\":{{\"left_out\":[{}],\"messages\":2000}}}}\n",
        left_out(1000)
    );
    assert_eq!(
        said,
        format!("{{\"left_out\":{}}}\n{}", left_out(1), done.repeat(3)),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let streams = daemon.ledger.streams();
    assert_eq!(streams.len(), 3);
    for stream in streams {
        let messages = stream.messages();
        assert_eq!(
            (messages.len(), stream.through, stream.end),
            (1000, 2000, Some(End::Complete))
        );
        assert_eq!(
            messages[999],
            (
                "/laser".into(),
                1_772_344_804_995_000_000,
                b"{\"value\": 999}".to_vec()
            )
        );
    }
}

#[test]
fn who_says_nothing_that_makes_sense_is_closed_within_ten_seconds() {
    let daemon = Daemon::start(settings());
    let since = Instant::now();
    let silent: Vec<_> = (0..10).map(|_| daemon.client()).collect();
    let drips: Vec<_> = [
        &b"{\"topic\":\"/las"[..],
        b"\n\n\n\n\n\n\n\n\n\n\n\n\n",
        b"\x89MCAP0\r",
    ]
    .map(|bytes| (daemon.client(), bytes))
    .into();
    let mut drips: Vec<_> = drips.into_iter().collect();
    // A byte a second is no sign of life, nor are empty lines; others are served meanwhile.
    for second in 0..6 {
        for (client, bytes) in &mut drips {
            let _ = client.stream.write_all(
                &bytes[second.min(bytes.len() - 1)..][..1.min(bytes.len() - second.min(bytes.len()))],
            );
        }
        let mut other = daemon.client();
        other.send(lines(0..10) + "{\"end\":true}\n");
        assert_eq!(other.answer(), "{\"done\":{\"messages\":10}}");
        let next = since + Duration::from_secs(second as u64 + 1);
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    for mut client in silent
        .into_iter()
        .chain(drips.into_iter().map(|(client, _)| client))
    {
        let answer = client.answer();
        assert!(answer.contains("nothing whole came for 7 s"), "{answer}");
        assert_eq!(client.answer(), "");
    }
    assert!(since.elapsed() < Duration::from_secs(10), "{:?}", since.elapsed());
    assert_eq!(daemon.count(Fault::Idle), 13);
}

#[test]
fn a_huge_record_byte_by_byte_is_no_sign_of_life() {
    let daemon = Daemon::start(IngestSettings {
        idle_s: 1.0,
        ..settings()
    });
    let mut client = daemon.client();
    let whole = mcap(10);
    let header = 8 + 9 + u64::from_le_bytes(whole[9..17].try_into().unwrap()) as usize;
    client.send(&whole[..header]);
    client.send([6]);
    client.send((10u64 << 20).to_le_bytes());
    let since = Instant::now();
    let closed = loop {
        if client.stream.write_all(b"x").is_err() || daemon.count(Fault::Idle) == 1 {
            break since.elapsed();
        }
        assert!(since.elapsed() < Duration::from_secs(10), "still open");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert!(closed >= Duration::from_millis(900), "{closed:?}");
    assert!(client.answer().contains("nothing whole came for 1 s"));
}

#[test]
fn lengths_that_lie_are_refused_at_once() {
    let daemon = Daemon::start(settings());
    let whole = mcap(10);
    let header = 8 + 9 + u64::from_le_bytes(whole[9..17].try_into().unwrap()) as usize;
    for length in [u64::MAX, 1 << 40, (16 << 20) + 1] {
        let mut client = daemon.client();
        client.send(&whole[..header]);
        client.send([6]);
        client.send(length.to_le_bytes());
        let answer = client.answer();
        assert!(
            answer.contains(&format!("a record of {length} bytes")),
            "{answer}"
        );
    }
    assert_eq!(daemon.count(Fault::Client), 3);
}

#[test]
fn all_clients_together_hold_a_bounded_memory() {
    let daemon = Daemon::start(settings());
    let whole = mcap(10);
    let header = 8 + 9 + u64::from_le_bytes(whole[9..17].try_into().unwrap()) as usize;
    let mut start = whole[..header].to_vec();
    start.push(6);
    start.extend((15u64 << 20).to_le_bytes());
    let part = vec![7u8; 6 << 20];
    let mut clients = Vec::new();
    for _ in 0..12 {
        let mut client = daemon.client();
        client.send(&start);
        let _ = client.stream.write_all(&part);
        clients.push(client);
    }
    wait_for("somebody is turned out", || daemon.count(Fault::Refused) > 0);
    let refused = daemon.count(Fault::Refused);
    assert!(refused < 12, "{refused}");
    // Everybody else is served.
    let mut other = daemon.client();
    other.send(lines(0..10) + "{\"end\":true}\n");
    assert_eq!(other.answer(), "{\"done\":{\"messages\":10}}");
}

#[test]
fn too_many_clients_are_told_so() {
    let daemon = Daemon::start(IngestSettings {
        clients: 2,
        ..settings()
    });
    let mut clients = [daemon.client(), daemon.client()];
    for client in &mut clients {
        client.send(lines(0..1));
    }
    wait_for("both are in", || daemon.clients() == 2);
    for _ in 0..100 {
        let mut third = daemon.client();
        let _ = third.stream.write_all(b"{}");
        let answer = third.answer();
        assert_eq!(
            answer,
            "{\"again\":true,\"error\":\"2 clients are connected already\"}"
        );
    }
    assert_eq!(daemon.count(Fault::Refused), 100);
    drop(clients);
    wait_for("both are gone", || daemon.clients() == 0);
    let mut third = daemon.client();
    third.send(lines(0..1) + "{\"end\":true}\n");
    assert_eq!(third.answer(), "{\"done\":{\"messages\":1}}");
}

#[test]
fn a_full_journal_stops_reading_and_nothing_is_lost() {
    let daemon = Daemon::start(IngestSettings {
        idle_s: 1.0,
        ..settings()
    });
    daemon.ledger.open(false);
    let mut client = daemon.client();
    let mut writer = client.stream.try_clone().unwrap();
    // More than the buffers of the system hold, so that the client feels it.
    let writing = std::thread::spawn(move || {
        for i in 0..200 {
            writer
                .write_all(lines(i * 1000..(i + 1) * 1000).as_bytes())
                .unwrap();
        }
        writer.write_all(b"{\"end\":true}\n").unwrap();
    });
    // Longer than a silent client may be.
    std::thread::sleep(Duration::from_millis(2500));
    assert!(!writing.is_finished(), "the client is not held up");
    assert_eq!((daemon.count(Fault::Idle), daemon.clients()), (0, 1));
    daemon.ledger.open(true);
    assert_eq!(client.answer(), "{\"done\":{\"messages\":200000}}");
    writing.join().unwrap();
    assert_eq!(daemon.ledger.streams()[0].messages().len(), 200_000);
}

#[test]
fn a_client_that_never_reads_is_served_all_the_same() {
    let daemon = Daemon::start(settings());
    let mut client = daemon.client();
    for _ in 0..20_000 {
        client.send("{\"topic\":\"/laser\",\"time\":1,\"value\":1}\n{\"end\":true}\n");
    }
    wait_for("every stream", || {
        daemon.counts.completed.load(Ordering::Relaxed) == 20_000
    });
}

#[test]
fn garbage_is_closed_at_once_with_one_reason() {
    use rand::{Rng, RngExt};
    let daemon = Daemon::start(settings());
    let mut rng = tirante::analysis::numerics::random::stream(3, 0);
    let mut faults = 0;
    for i in 0..300 {
        let mut bytes = vec![0u8; rng.random_range(1..4000)];
        rng.fill_bytes(&mut bytes);
        match i % 3 {
            0 => bytes[0] |= 0x80,
            1 => bytes.splice(0..0, *b"{").for_each(drop),
            _ => bytes.splice(0..0, *b"\x89MCAP0\r\n").for_each(drop),
        }
        let mut client = daemon.client();
        let _ = client.stream.write_all(&bytes);
        let _ = client.stream.shutdown(Shutdown::Write);
        let mut said = String::new();
        client.answers.read_to_string(&mut said).unwrap();
        assert!(said.lines().count() <= 1, "{said}");
        faults += said
            .lines()
            .filter(|line| line.starts_with("{\"error\":"))
            .count() as u64;
    }
    assert!(faults > 100, "{faults}");
    assert_eq!(daemon.count(Fault::Client), faults);
    assert!(daemon.ledger.streams().is_empty());
}

#[test]
fn a_stop_says_goodbye_and_takes_two_seconds_at_most() {
    let mut daemon = Daemon::start(settings());
    let mut clients: Vec<_> = (0..20).map(|_| daemon.client()).collect();
    for client in &mut clients {
        client.send(lines(0..5));
    }
    wait_for("all are in", || daemon.ledger.streams().len() == 20);
    let took = daemon.stop();
    assert!(took < Duration::from_secs(2), "{took:?}");
    for client in &mut clients {
        assert_eq!(client.answer(), "{\"again\":true,\"error\":\"the daemon stops\"}");
    }
    assert!(daemon.ledger.streams().iter().all(|stream| stream.end.is_none()));
}

#[test]
fn the_socket_of_a_dead_daemon_is_replaced_and_that_of_a_live_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ingest.sock");
    let listen = Listen::Unix(path.clone());
    let first = Listener::bind(&listen).unwrap();
    assert_eq!(
        std::fs::metadata(&path).unwrap().permissions().mode() & 0o777,
        0o660
    );
    let error = Listener::bind(&listen).unwrap_err();
    assert!(
        matches!(error, ListenError::Taken(_)) && error.to_string().contains("another daemon listens there")
    );
    drop(first);
    assert!(path.exists(), "as a killed daemon leaves it");
    drop(Listener::bind(&listen).unwrap());
    std::fs::remove_file(&path).unwrap();
    std::fs::write(&path, "precious").unwrap();
    assert!(matches!(Listener::bind(&listen), Err(ListenError::NoSocket(_))));
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
}

/// The part of the next test that must be a process of its own.
#[test]
#[ignore = "run by the next one"]
fn tell_what_was_inherited() {
    let inherited = Listener::inherited().unwrap();
    let listen = [Listen::Unix(std::env::var_os("SOCKET").unwrap().into())];
    for listener in Listener::all(inherited, &listen).unwrap() {
        println!("listening {}", listener.address());
    }
}

#[test]
fn sockets_of_systemd_are_taken_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ingest.sock");
    let tcp = TcpListener::bind("[::1]:0")
        .or_else(|_| TcpListener::bind("127.0.0.1:0"))
        .unwrap();
    let address = tcp.local_addr().unwrap();
    let unix = std::os::unix::net::UnixListener::bind(&path).unwrap();
    let output = Command::new("sh")
        .args(["-c", "exec \"$0\" \"$@\" 3<&0 4<&2 2<&1"])
        .arg(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "sockets::tell_what_was_inherited",
            "--ignored",
            "--nocapture",
        ])
        .env("LISTEN_FDS", "2")
        .env("SOCKET", &path)
        .stdin(std::os::fd::OwnedFd::from(tcp))
        .stderr(std::os::fd::OwnedFd::from(unix))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let listening: Vec<&str> = said
        .lines()
        .filter_map(|line| line.strip_prefix("listening "))
        .collect();
    assert_eq!(
        listening,
        [format!("tcp://{address}"), format!("unix://{}", path.display())],
        "{said}"
    );
}

#[test]
fn an_open_socket_without_tls_is_a_fault_of_the_configuration_and_of_the_server() {
    let rod = "[[rod]]\nid = \"a\"\nlength_m = 10\nsection = \"direct\"\n[rod.priors]\naxial_force_n = 1e5\n\
        flexural_rigidity_n_m2 = 3e5\nmass_per_length_kg_m = 20\nspring_left_n_m = 0\nspring_right_n_m = 0\n\
        [rod.channel]\ntopic = \"/a\"\n";
    let faults = |text: &str| match Config::parse(&format!("{text}\n{rod}"), "test") {
        Err(ConfigError::Faults { faults, .. }) => faults.iter().map(ToString::to_string).collect::<Vec<_>>(),
        Err(other) => panic!("{other}"),
        Ok(_) => Vec::new(),
    };
    let open = faults("[ingest]\nlisten = [\"tcp://127.0.0.1:7415\", \"tcp://0.0.0.0:7415\"]");
    assert_eq!(
        open,
        [
            "2:10: ingest.listen: tcp://0.0.0.0:7415 is not on loopback: [ingest.tls] is needed, with certificate, key and client_ca"
        ]
    );
    let bad = faults("[ingest]\nlisten = [\"tcp://localhost:7415\"]\nclients = 0\n[ingest.tls]\nkey = \"a\"");
    assert!(
        bad[0].starts_with("2:11: ingest.listen[0]: tcp://localhost:7415 is no IP address"),
        "{bad:?}"
    );
    assert!(
        bad[1].starts_with("3:11: ingest.clients: 0 is out of range"),
        "{bad:?}"
    );
    assert!(
        bad.iter()
            .any(|fault| fault.contains("ingest.tls.client_ca: is missing")),
        "{bad:?}"
    );
    let tls = "[ingest.tls]\ncertificate = \"a\"\nkey = \"b\"\nclient_ca = \"c\"";
    assert!(faults(&format!("[ingest]\nlisten = [\"tcp://0.0.0.0:7415\"]\n{tls}")).is_empty());

    let listener = Listener::Tcp(TcpListener::bind("0.0.0.0:0").unwrap());
    let (topics, stop) = (
        tokio::sync::watch::channel(Default::default()).1,
        tokio::sync::watch::channel(false).1,
    );
    let server = tirante::service::ingest::Server::new(
        settings(),
        topics,
        Ledger::new(),
        Default::default(),
        Default::default(),
    )
    .unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let outcome = runtime.block_on(tirante::service::ingest::serve(vec![listener], server, stop));
    assert!(matches!(outcome, Err(ListenError::Open(_))));
}

/// Peak memory of this process \[MiB\].
fn peak_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
}

/// `cargo test --test service -- --ignored --nocapture --test-threads 1 what_the`
#[test]
#[ignore = "a measurement"]
fn what_the_sockets_take() {
    let daemon = Daemon::start(settings());
    let text = lines(0..200_000);
    let sampled = recording(Encoding::Json, Layout::Sample, WriterOptions::default(), 200_000);
    let batched = recording(
        Encoding::Ros2,
        Layout::Batch(200),
        WriterOptions::default(),
        2_000_000,
    );
    for (what, bytes, samples) in [
        ("JSON lines", text.as_bytes(), 200_000.0),
        ("MCAP, a JSON message a sample", &sampled, 200_000.0),
        ("MCAP, ROS 2 arrays of 200", &batched, 2_000_000.0),
    ] {
        let since = Instant::now();
        let mut client = daemon.client();
        client.send(bytes);
        client.stream.shutdown(Shutdown::Write).unwrap();
        assert!(client.answer().starts_with("{\"done\""));
        let took_s = since.elapsed().as_secs_f64();
        let megabytes = bytes.len() as f64 * 1e-6 / took_s;
        println!("{what}: {:.0} samples/s, {megabytes:.0} MB/s", samples / took_s);
    }
}

/// Run alone, for the memory is that of the whole process.
#[test]
#[ignore = "a measurement"]
fn what_hostile_clients_can_hold() {
    let daemon = Daemon::start(settings());
    let before = peak_mib();
    // Chunks that unpack to all they may, of messages as small as they may be, and a journal that takes nothing.
    let options = WriterOptions {
        chunk_bytes: Some(7 << 20),
        ..Default::default()
    };
    let mut bomb = mcap::WriteOptions::new();
    bomb = bomb.chunk_size(options.chunk_bytes);
    let mut writer = bomb.create(std::io::Cursor::new(Vec::new())).unwrap();
    let channel = writer
        .add_channel(0, "/laser", "json", &Default::default())
        .unwrap();
    for i in 0..250_000 {
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: i,
            log_time: 1,
            publish_time: 1,
        };
        writer.write_to_known_channel(&header, b"1").unwrap();
    }
    writer.finish().unwrap();
    let bomb = writer.into_inner().into_inner();
    // And records that are never whole.
    let mut greedy = bomb[..8 + 9 + u64::from_le_bytes(bomb[9..17].try_into().unwrap()) as usize].to_vec();
    greedy.push(6);
    greedy.extend((15u64 << 20).to_le_bytes());
    greedy.resize(1 << 20, 7);
    let send = |bytes: &[u8]| {
        let mut client = daemon.client();
        // Once nothing is read any more it is enough.
        client
            .stream
            .set_write_timeout(Some(Duration::from_millis(200)))
            .unwrap();
        let _ = client.stream.write_all(bytes);
        client
    };
    let mut clients: Vec<_> = (0..32).map(|_| send(&greedy)).collect();
    daemon.ledger.open(false);
    clients.extend((0..32).map(|_| send(&bomb)));
    wait_for("all are in", || daemon.clients() >= 60);
    println!(
        "{} clients, peak {} MiB over {before} MiB",
        daemon.clients(),
        peak_mib() - before
    );
    assert!(peak_mib() - before < 256);
}
