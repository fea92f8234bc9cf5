//! `tirante send` as a process: a recording into a socket, with TLS, and through a connection that is cut again and again.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use crate::common::*;
use crate::listeners::*;
use std::io::Read;
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::Command;
use std::time::{Duration, Instant};
use tirante::config::settings::ingest::IngestSettings;
use tirante::recording::write::{Encoding, Layout, WriterOptions};
use tirante::service::journal::End;
use tirante::service::telemetry::Fault;

pub(crate) fn settings() -> IngestSettings {
    IngestSettings::default()
}

fn small() -> WriterOptions {
    WriterOptions {
        chunk_bytes: Some(2000),
        ..Default::default()
    }
}

pub(crate) fn mcap(count: usize) -> Vec<u8> {
    recording(Encoding::Json, Layout::Sample, small(), count)
}

fn lines(range: std::ops::Range<u64>) -> String {
    range.map(|i| line("/laser", i)).collect()
}

const HELLO: &str = "{\"hello\":{\"sender\":\"north-laser\"}}\n";

/// A certificate authority and the certificates it signed, as PEM files.
pub(crate) struct Authority {
    issuer: rcgen::CertifiedIssuer<'static, rcgen::KeyPair>,
}

impl Authority {
    pub fn new() -> Self {
        let mut params = rcgen::CertificateParams::new(Vec::<String>::new()).unwrap();
        params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
        let key = rcgen::KeyPair::generate().unwrap();
        Self {
            issuer: rcgen::CertifiedIssuer::self_signed(params, key).unwrap(),
        }
    }

    /// Writes authority, certificate and key of one party.
    pub fn write(&self, folder: &std::path::Path, name: &str) -> [std::path::PathBuf; 3] {
        self.write_until(folder, name, 4000)
    }

    /// The same for a certificate that ends in so many days, or ended before.
    pub fn write_until(&self, folder: &std::path::Path, name: &str, days: i64) -> [std::path::PathBuf; 3] {
        let key = rcgen::KeyPair::generate().unwrap();
        let mut params =
            rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned(), "localhost".to_owned()]).unwrap();
        params.distinguished_name.push(rcgen::DnType::CommonName, name);
        let end =
            jiff::Timestamp::now().to_zoned(jiff::tz::TimeZone::UTC).date() + jiff::Span::new().days(days);
        let (year, month, day) = (end.year(), end.month(), end.day());
        params.not_after =
            rcgen::date_time_ymd(year.into(), month.try_into().unwrap(), day.try_into().unwrap());
        self.signed(params, &key, folder, name)
    }

    /// The same for a certificate that is not valid before the year 2150.
    pub fn write_early(&self, folder: &std::path::Path, name: &str) -> [std::path::PathBuf; 3] {
        let key = rcgen::KeyPair::generate().unwrap();
        let mut params =
            rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned(), "localhost".to_owned()]).unwrap();
        params.distinguished_name.push(rcgen::DnType::CommonName, name);
        params.not_before = rcgen::date_time_ymd(2150, 1, 1);
        self.signed(params, &key, folder, name)
    }

    /// The same for a certificate of clients alone.
    pub fn write_of_client(&self, folder: &std::path::Path, name: &str) -> [std::path::PathBuf; 3] {
        let key = rcgen::KeyPair::generate().unwrap();
        let mut params = rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap();
        params.extended_key_usages = vec![rcgen::ExtendedKeyUsagePurpose::ClientAuth];
        self.signed(params, &key, folder, name)
    }

    fn signed(
        &self,
        params: rcgen::CertificateParams,
        key: &rcgen::KeyPair,
        folder: &std::path::Path,
        name: &str,
    ) -> [std::path::PathBuf; 3] {
        let certificate = params.signed_by(key, &self.issuer).unwrap();
        let paths = ["ca", "pem", "key"].map(|end| folder.join(format!("{name}.{end}")));
        std::fs::write(&paths[0], self.issuer.pem()).unwrap();
        std::fs::write(&paths[1], certificate.pem()).unwrap();
        std::fs::write(&paths[2], key.serialize_pem()).unwrap();
        paths
    }
}

pub(crate) fn tirante_send(arguments: &[&std::ffi::OsStr]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_tirante"))
        .arg("send")
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn with_tls_only_the_right_certificate_comes_in() {
    let folder = tempfile::tempdir().unwrap();
    let (ours, theirs) = (Authority::new(), Authority::new());
    let [ca, certificate, key] = ours.write(folder.path(), "daemon");
    let good = ours.write(folder.path(), "client");
    let foreign = theirs.write(folder.path(), "foreign");
    let tls = tirante::config::settings::ingest::TlsSettings {
        certificate,
        key,
        client_ca: ca.clone(),
        bound: Vec::new(),
    };
    let daemon = Daemon::start(IngestSettings {
        tls: Some(tls),
        ..settings()
    });
    let file = folder.path().join("a.mcap");
    std::fs::write(&file, mcap(500)).unwrap();
    let to = format!("tcp://{}", daemon.address);
    let send = |authority: &std::path::Path, certificate: &std::path::Path, key: &std::path::Path| {
        let flags = ["--to", &to, "--speed", "max", "--tls-ca"].map(std::ffi::OsStr::new);
        let mut all = vec![file.as_os_str()];
        all.extend(flags);
        all.extend([
            authority.as_os_str(),
            "--tls-certificate".as_ref(),
            certificate.as_os_str(),
        ]);
        all.extend(["--tls-key".as_ref(), key.as_os_str()]);
        tirante_send(&all)
    };
    let output = send(&ca, &good[1], &good[2]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert_eq!(daemon.ledger.streams()[0].messages().len(), 500);
    assert_eq!(daemon.count(Fault::Refused), 0);

    let output = send(&ca, &foreign[1], &foreign[2]);
    assert_eq!(output.status.code(), Some(1));
    wait_for("the foreign one is counted", || daemon.count(Fault::Refused) == 1);
    // The client looks at the daemon's certificate too.
    let output = send(&foreign[0], &good[1], &good[2]);
    assert_eq!(output.status.code(), Some(1));
    wait_for("it is counted", || daemon.count(Fault::Refused) == 2);
    // Nor does anybody come in without TLS.
    let mut plain = daemon.client();
    plain.send(lines(0..10) + "{\"end\":true}\n");
    plain.stream.shutdown(Shutdown::Write).unwrap();
    let mut said = Vec::new();
    let _ = plain.answers.read_to_end(&mut said);
    assert!(!String::from_utf8_lossy(&said).contains("done"));
    wait_for("it is counted", || daemon.count(Fault::Refused) == 3);
    assert_eq!(daemon.ledger.streams().len(), 1);
}

#[test]
fn send_replays_a_recording_and_says_that_it_is_durable() {
    let daemon = Daemon::start(settings());
    let folder = tempfile::tempdir().unwrap();
    let files = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
    std::fs::write(
        &files[0],
        recording(Encoding::Ros2, Layout::Sample, small(), 1000),
    )
    .unwrap();
    std::fs::write(&files[1], mcap(300)).unwrap();
    let to = format!("unix://{}", daemon.path.display());
    let mut arguments: Vec<&std::ffi::OsStr> = files.iter().map(|file| file.as_os_str()).collect();
    arguments.extend(["--to", &to, "--speed", "10"].map(std::ffi::OsStr::new));
    let since = Instant::now();
    let output = tirante_send(&arguments);
    assert_eq!(
        String::from_utf8_lossy(&output.stdout),
        "1300 messages are durable\n",
        "{output:?}"
    );
    assert!(output.status.success());
    // Five seconds at ten times their speed.
    assert!(
        since.elapsed() >= Duration::from_millis(490),
        "{:?}",
        since.elapsed()
    );
    let stream = daemon.ledger.streams().pop().unwrap();
    assert_eq!((stream.messages().len(), stream.end), (1300, Some(End::Complete)));

    // Shifted to now, and a recording that is cut short.
    std::fs::write(&files[0], &mcap(300)[..3000]).unwrap();
    let mut arguments = vec![files[0].as_os_str()];
    arguments.extend(["--to", &to, "--speed", "max", "--stamp-now"].map(std::ffi::OsStr::new));
    let output = tirante_send(&arguments);
    assert_eq!(output.status.code(), Some(1), "not everything there is was sent");
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("a.mcap: is cut short"),
        "{output:?}"
    );
    let messages = daemon.ledger.streams().pop().unwrap().messages();
    let age = jiff_now() - messages[0].1 as i128;
    assert!(messages.len() > 50 && (0..60_000_000_000).contains(&age), "{age}");

    // No listener.
    let gone = format!(
        "tcp://{}",
        TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
    );
    let output = tirante_send(&[files[1].as_os_str(), "--to".as_ref(), gone.as_ref()]);
    assert_eq!(output.status.code(), Some(1));
    let output = tirante_send(&[files[1].as_os_str(), "--to".as_ref(), "udp://x".as_ref()]);
    assert_eq!(output.status.code(), Some(2));
}

fn jiff_now() -> i128 {
    std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap()
        .as_nanos() as i128
}

/// Proxy between sender and daemon that passes some bytes, then cuts the connection.
fn saw(to: std::net::SocketAddr, lengths: Vec<usize>) -> std::net::SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        let lengths = lengths.into_iter().chain(std::iter::repeat(usize::MAX));
        for (client, length) in listener.incoming().zip(lengths) {
            let client = client.unwrap();
            let daemon = TcpStream::connect(to).unwrap();
            let (mut back, mut answers) = (client.try_clone().unwrap(), daemon.try_clone().unwrap());
            std::thread::spawn(move || {
                let _ = std::io::copy(&mut answers, &mut back);
                let _ = back.shutdown(Shutdown::Both);
            });
            std::thread::spawn(move || {
                let _ = std::io::copy(&mut (&client).take(length as u64), &mut &daemon);
                let _ = daemon.shutdown(Shutdown::Both);
                let _ = client.shutdown(Shutdown::Both);
            });
        }
    });
    address
}

/// A recording of [`motion`] in messages of a tenth of a second, the second half of every twenty before the first.
fn out_of_order(count: usize) -> Vec<u8> {
    let options = mcap::WriteOptions::new().chunk_size(Some(2000));
    let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
    let channel = writer
        .add_channel(0, "/laser", "json", &Default::default())
        .unwrap();
    let samples = motion(20 * count);
    for at in 0..count {
        let index = at / 20 * 20 + (at + 10) % 20;
        let time = 1_772_344_800_000_000_000 + index as u64 * 100_000_000;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: at as u32,
            log_time: time,
            publish_time: time,
        };
        let data = format!("{{\"values\":{:?}}}", &samples[20 * index..20 * (index + 1)]);
        writer.write_to_known_channel(&header, data.as_bytes()).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// As `replay` reads it, also where it goes on behind a cut by the number of messages.
#[test]
fn send_puts_the_messages_of_a_recording_in_order() {
    let daemon = Daemon::start(settings());
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    std::fs::write(&file, out_of_order(600)).unwrap();
    let through = saw(daemon.address, vec![5000, 30_000]);
    let to = format!("tcp://{through}");
    let flags = ["--to", &to, "--speed", "100", "--sender", "north-laser"];
    let mut arguments = vec![file.as_os_str()];
    arguments.extend(flags.map(std::ffi::OsStr::new));
    let output = tirante_send(&arguments);
    assert!(output.status.success(), "{output:?}");
    let streams = daemon.ledger.streams();
    let times: Vec<u64> = streams
        .iter()
        .flat_map(|stream| stream.messages())
        .map(|message| message.1)
        .collect();
    let expected = (0..600u64).map(|index| 1_772_344_800_000_000_000 + index * 100_000_000);
    assert!(expected.eq(times.iter().copied()), "{} of 600", times.len());
    assert!(streams.len() >= 2, "{}", streams.len());
}

#[test]
fn send_goes_on_after_every_cut() {
    let daemon = Daemon::start(settings());
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    // Batches that do not shrink: 100 kB.
    std::fs::write(
        &file,
        recording(Encoding::Ros2, Layout::Batch(20), small(), 12_000),
    )
    .unwrap();
    let through = saw(daemon.address, vec![20, 5000, 30_000]);
    let to = format!("tcp://{through}");
    let output = tirante_send(&[
        file.as_os_str(),
        "--to".as_ref(),
        to.as_ref(),
        "--speed".as_ref(),
        "100".as_ref(),
        "--sender".as_ref(),
        "north-laser".as_ref(),
    ]);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(
        String::from_utf8_lossy(&output.stdout),
        "600 messages are durable\n"
    );
    let streams = daemon.ledger.streams();
    assert!(streams.len() >= 3, "{}", streams.len());
    let all: Vec<_> = streams.iter().flat_map(Written::messages).collect();
    assert_eq!(all.len(), 600, "nothing lost, nothing twice");
    assert!(all.windows(2).all(|pair| pair[0].1 < pair[1].1));

    // A stream of an earlier run is not taken up unless asked for.
    let mut client = daemon.client();
    client.send(HELLO.to_owned() + &lines(0..10));
    daemon.until("ten messages", |stream| stream.through == 10);
    drop(client);
    let arguments = |more: &'static [&'static str]| {
        let mut all = vec![file.as_os_str(), "--to".as_ref(), to.as_ref()];
        all.extend(
            ["--speed", "max", "--sender", "north-laser"]
                .iter()
                .chain(more)
                .map(std::ffi::OsStr::new),
        );
        tirante_send(&all)
    };
    let output = arguments(&[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("--resume"),
        "{output:?}"
    );
    let output = arguments(&["--resume"]);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(daemon.ledger.streams().pop().unwrap().messages().len(), 590);
}

/// Output of `tirante send` for a file, and its exit code.
fn sent(daemon: &Daemon, folder: &std::path::Path, bytes: &[u8]) -> (String, i32) {
    let file = folder.join("sent.mcap");
    std::fs::write(&file, bytes).unwrap();
    let to = format!("unix://{}", daemon.path.display());
    let output = tirante_send(&[
        file.as_os_str(),
        "--to".as_ref(),
        to.as_ref(),
        "--speed".as_ref(),
        "max".as_ref(),
    ]);
    let told = [&output.stdout[..], &output.stderr[..]].concat();
    (
        String::from_utf8_lossy(&told).into_owned(),
        output.status.code().unwrap(),
    )
}

#[test]
fn a_large_message_is_kept_and_what_is_not_kept_is_told() {
    let daemon = Daemon::start(settings());
    let folder = tempfile::tempdir().unwrap();
    let arrays = |samples| {
        recording(
            Encoding::Ros2,
            Layout::Batch(samples),
            WriterOptions::default(),
            2_400_000,
        )
    };
    // 4.8 MB each: over the socket they were acknowledged and left out.
    let (told, code) = sent(&daemon, folder.path(), &arrays(600_000));
    assert_eq!((told.as_str(), code), ("4 messages are durable\n", 0));
    let kept = daemon.ledger.streams().pop().unwrap().messages();
    assert!(kept.len() == 4 && kept.iter().all(|(_, _, data)| data.len() > 4_800_000));
    // Beyond 8 MiB the sender itself reports it.
    let (told, code) = sent(&daemon, folder.path(), &arrays(1_200_000));
    assert!(
        told.contains("larger than 8388608 bytes") && code == 3,
        "{code}: {told}"
    );
    // Two that no attempt sends are none of those that the daemon has.
    let (told, code) = sent(&daemon, folder.path(), &arrays(1_100_000));
    assert!(
        told.contains("1 message is durable, 2 were left out\n") && code == 3,
        "{code}: {told}"
    );
}

/// A recording of each of these topics, 300 messages each, one after the other.
fn of_topics(topics: &[&str]) -> Vec<u8> {
    let mut writer =
        tirante::recording::write::RecordingWriter::new(std::io::Cursor::new(Vec::new()), small()).unwrap();
    for topic in topics {
        let id = writer
            .add_channel(spec(topic, Encoding::Json, Layout::Sample))
            .unwrap();
        writer.write_samples(id, START, FS, &motion(300)).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn messages_that_no_rod_reads_are_told_beside_those_that_are_kept() {
    let daemon = Daemon::start(settings());
    let folder = tempfile::tempdir().unwrap();
    let (told, code) = sent(&daemon, folder.path(), &of_topics(&["/lasr"]));
    assert!(
        told.contains("0 messages are durable, 300 were left out") && code == 3,
        "{code}: {told}"
    );
    let (told, code) = sent(&daemon, folder.path(), &of_topics(&["/laser", "/lasr", "/imu"]));
    assert!(
        told.contains("300 messages are durable, 600 were left out") && code == 3,
        "{code}: {told}"
    );
    assert!(
        told.contains("no rod reads the topic /lasr; the nearest that one reads is /laser"),
        "{told}"
    );
    assert!(told.contains("no rod reads the topic /imu"), "{told}");
    // It is not the daemon's fault.
    assert_eq!(daemon.count(Fault::Client), 0);
    // A client without a name that only writes hears of it, too, with the first message.
    let mut client = daemon.client();
    client.send("{\"topic\":\"/lasr\",\"value\":1}\n{\"topic\":\"/laser\",\"value\":1}\n");
    let answer = client.answer();
    assert!(
        answer.contains("left_out") && answer.contains("/lasr"),
        "{answer}"
    );
    // Who knows that a recording has more asks for the topics.
    let file = folder.path().join("topics.mcap");
    std::fs::write(&file, of_topics(&["/laser", "/lasr", "/imu"])).unwrap();
    let to = format!("tcp://{}", daemon.address);
    let words = [
        "--to", &to, "--speed", "max", "--topic", "/las*", "--topic", "/lasr",
    ];
    let mut all = vec![file.as_os_str()];
    all.extend(words[..4].iter().map(std::ffi::OsStr::new));
    let only = [&all[..], &["--topic", "/laser"].map(std::ffi::OsStr::new)].concat();
    let output = tirante_send(&only);
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(output.stdout, b"300 messages are durable\n");
    all.extend(words[4..].iter().map(std::ffi::OsStr::new));
    let output = tirante_send(&all);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(output.stdout, b"300 messages are durable, 300 were left out\n");
}

#[test]
fn two_channels_of_a_recording_on_one_topic_stay_two() {
    let daemon = Daemon::start(settings());
    let folder = tempfile::tempdir().unwrap();
    let mut writer = mcap::WriteOptions::new()
        .create(std::io::Cursor::new(Vec::new()))
        .unwrap();
    for sensor in ["left", "right"] {
        let own = [("sensor".to_owned(), sensor.to_owned())].into();
        let id = writer.add_channel(0, "/laser", "json", &own).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: id,
            sequence: 0,
            log_time: 1,
            publish_time: 1,
        };
        writer.write_to_known_channel(&header, b"{\"value\":1}").unwrap();
    }
    writer.finish().unwrap();
    let (told, code) = sent(&daemon, folder.path(), &writer.into_inner().into_inner());
    assert_eq!((told.as_str(), code), ("2 messages are durable\n", 0));
    let stream = daemon.ledger.streams().pop().unwrap();
    assert_eq!(stream.channels(), ["/laser", "/laser"]);
}

#[test]
fn a_message_too_large_for_the_daemon_is_answered_with_the_reason() {
    let daemon = Daemon::start(settings());
    let mut writer = mcap::WriteOptions::new()
        .chunk_size(None)
        .use_chunks(false)
        .create(std::io::Cursor::new(Vec::new()))
        .unwrap();
    let channel = writer
        .add_channel(0, "/laser", "json", &Default::default())
        .unwrap();
    for (sequence, data) in [vec![b' '; 9 << 20], b"{\"value\":1}".to_vec()]
        .iter()
        .enumerate()
    {
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: sequence as u32,
            log_time: 1 + sequence as u64,
            publish_time: 1,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    let mut client = daemon.client();
    client.send(HELLO);
    assert!(client.answer().contains("welcome"));
    client.send(writer.into_inner().into_inner());
    let told = client.answer();
    assert!(
        told.contains("\"left_out\":{\"messages\":1") && told.contains("8388608"),
        "{told}"
    );
    let done = client.answer();
    assert!(
        done.starts_with("{\"done\":{\"left_out\":[{\"messages\":1") && done.ends_with("\"messages\":2}}"),
        "{done}"
    );
    assert_eq!(daemon.ledger.streams().pop().unwrap().messages().len(), 1);
    assert_eq!(daemon.count(Fault::Client), 1);
}

#[test]
fn a_crowd_at_the_tls_port_does_not_keep_a_certified_sender_out() {
    let folder = tempfile::tempdir().unwrap();
    let ours = Authority::new();
    let [ca, certificate, key] = ours.write(folder.path(), "daemon");
    let [_, mine, my_key] = ours.write(folder.path(), "client");
    let daemon = Daemon::start(IngestSettings {
        tls: Some(tirante::config::settings::ingest::TlsSettings {
            certificate,
            key,
            client_ca: ca.clone(),
            bound: Vec::new(),
        }),
        ..settings()
    });
    // Silent connections, each opened again as soon as it is closed.
    let address = daemon.address;
    let is_over = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
    let crowd: Vec<_> = (0..90)
        .map(|_| {
            let is_over = std::sync::Arc::clone(&is_over);
            std::thread::spawn(move || {
                while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                    let Ok(mut stream) = TcpStream::connect(address) else {
                        continue;
                    };
                    let _ = stream.set_read_timeout(Some(Duration::from_millis(500)));
                    let _ = stream.read(&mut [0; 1]);
                }
            })
        })
        .collect();
    wait_for("the crowd is there", || {
        daemon
            .counts
            .connections
            .load(std::sync::atomic::Ordering::Relaxed)
            >= 90
    });
    let file = folder.path().join("a.mcap");
    std::fs::write(&file, mcap(100)).unwrap();
    let to = format!("tcp://{address}");
    for round in 0..20 {
        let output = tirante_send(&[
            file.as_os_str(),
            "--to".as_ref(),
            to.as_ref(),
            "--speed".as_ref(),
            "max".as_ref(),
            "--tls-ca".as_ref(),
            ca.as_os_str(),
            "--tls-certificate".as_ref(),
            mine.as_os_str(),
            "--tls-key".as_ref(),
            my_key.as_os_str(),
        ]);
        assert!(
            output.status.success(),
            "{round}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    is_over.store(true, std::sync::atomic::Ordering::Relaxed);
    for client in crowd {
        client.join().unwrap();
    }
    assert_eq!(daemon.ledger.streams().len(), 20);
}
