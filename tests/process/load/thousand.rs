//! A thousand hostile connections at the TLS port and over HTTP: health is answered at once, and a certified sender
//! loses nothing.

use super::plant::{Plan, Plant, Take};
use super::usage::{Usage, metric, metrics};
use crate::survival::process::Process;
use std::fs::{self, Permissions};
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Hostile connections, half at each port; a thread holds so many.
const CONNECTIONS: usize = 1000;
const OF_THREAD: usize = 20;
/// Longest time for an answer about health.
const HEALTH: Duration = Duration::from_millis(100);
const PEAK_MB: f64 = 256.0;

/// First words of hostile clients: nothing, half a TLS greeting, half a request, a request on a connection that is kept.
const WORDS: [&[u8]; 4] = [
    b"",
    &[0x16, 3, 1, 2, 0, 1, 0, 1],
    b"GET / HTTP/1.1\r\nHost: local",
    b"GET /api/v1/site HTTP/1.1\r\nHost: localhost\r\n\r\n",
];

/// Holds connections open, and opens each again when it is closed.
fn crowd(address: SocketAddr, first: usize, is_over: &AtomicBool, opened: &AtomicUsize) {
    let mut held: Vec<Option<TcpStream>> = (0..OF_THREAD).map(|_| None).collect();
    while !is_over.load(Ordering::Relaxed) {
        for (number, slot) in held.iter_mut().enumerate() {
            let is_closed = slot
                .as_mut()
                .is_none_or(|stream| match stream.read(&mut [0; 4096]) {
                    Ok(count) => count == 0,
                    Err(fault) => fault.kind() != ErrorKind::WouldBlock,
                });
            if !is_closed {
                continue;
            }
            *slot = TcpStream::connect_timeout(&address, Duration::from_secs(1)).ok();
            if let Some(stream) = slot {
                opened.fetch_add(1, Ordering::Relaxed);
                let _ = stream.set_nonblocking(true);
                let _ = stream.write_all(WORDS[(first + number) % WORDS.len()]);
            }
        }
        thread::sleep(Duration::from_millis(20));
    }
}

/// Ends the crowd, also when a check fails: the threads are waited for.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Time of an answer to `/healthz` over a new connection.
fn health(address: SocketAddr) -> Duration {
    let begun = Instant::now();
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    stream
        .write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        .unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    assert!(text.starts_with("HTTP/1.1 200"), "{text}");
    begun.elapsed()
}

/// An authority, and certificate and key of `daemon` and `sender`.
fn certify(plant: &Plant) {
    let mut params = rcgen::CertificateParams::new(Vec::<String>::new()).unwrap();
    params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let issuer = rcgen::CertifiedIssuer::self_signed(params, rcgen::KeyPair::generate().unwrap()).unwrap();
    fs::write(plant.path("ca.pem"), issuer.pem()).unwrap();
    for name in ["daemon", "sender"] {
        let key = rcgen::KeyPair::generate().unwrap();
        let params = rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap();
        let certificate = params.signed_by(&key, &issuer).unwrap();
        fs::write(plant.path(&format!("{name}.pem")), certificate.pem()).unwrap();
        let path = plant.path(&format!("{name}.key"));
        fs::write(&path, key.serialize_pem()).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
    }
}

#[test]
#[ignore = "a minute; wants 4000 descriptors (ulimit -n) and a quiet machine"]
fn a_thousand_hostile_connections() {
    let tls = "[ingest.tls]\ncertificate = \"daemon.pem\"\nkey = \"daemon.key\"\nclient_ca = \"ca.pem\"\n";
    let plant = Plant::new(Plan {
        rods: 2,
        window_s: 5.0,
        modes: 3,
        more: tls.to_owned(),
        ..Plan::default()
    });
    certify(&plant);
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let config = fs::read_to_string(plant.path("site.toml")).unwrap();
    let config = config.replace("listen = [\"unix", &format!("listen = [\"tcp://{port}\", \"unix"));
    fs::write(plant.path("site.toml"), config).unwrap();
    plant.simulate(&Take {
        name: "tls",
        record_s: 30.0,
        ..Take::default()
    });
    let daemon: Process = plant.start();
    let log = daemon.log();
    let http: SocketAddr = log
        .split("metrics at http://")
        .nth(1)
        .and_then(|rest| rest.split(|c: char| c.is_whitespace() || c == '/').next())
        .unwrap()
        .parse()
        .unwrap();
    let (is_over, opened) = (AtomicBool::new(false), AtomicUsize::new(0));
    let mut answers = thread::scope(|scope| {
        let crowd_ends = Over(&is_over);
        for number in 0..CONNECTIONS / OF_THREAD {
            let (is_over, opened) = (&is_over, &opened);
            let address = if number % 2 == 0 { port } else { http };
            scope.spawn(move || crowd(address, number, is_over, opened));
        }
        while opened.load(Ordering::Relaxed) < CONNECTIONS {
            thread::sleep(Duration::from_millis(10));
        }
        let to = format!("tcp://{port}");
        let words = [
            "send",
            "tls.mcap",
            "--to",
            &to,
            "--sender",
            "certified",
            "--stamp-now",
        ];
        let keys = [
            "--tls-ca",
            "ca.pem",
            "--tls-certificate",
            "sender.pem",
            "--tls-key",
            "sender.key",
        ];
        let mut sender = plant
            .command(&[&words[..], &keys[..]].concat())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut answers = Vec::new();
        while sender.try_wait().unwrap().is_none() {
            answers.push(health(http));
            thread::sleep(Duration::from_millis(50));
        }
        drop(crowd_ends);
        let output = sender.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success() && !said.contains("warning"), "{said}");
        answers
    });
    answers.sort();
    let (median, worst) = (answers[answers.len() / 2], *answers.last().unwrap());
    let usage = Usage::of(daemon.pid());
    println!(
        "{} hostile connections: {} answers about health, median {median:?}, worst {worst:?}; peak {:.0} MB, {} descriptors, {} refused",
        opened.load(Ordering::Relaxed),
        answers.len(),
        usage.peak_mb,
        usage.descriptors,
        metric(&metrics(&daemon), "tirante_faults_total{kind=\"refused\""),
    );
    assert!(
        worst < HEALTH && answers.len() > 100,
        "{worst:?} {}",
        answers.len()
    );
    assert!(usage.peak_mb < PEAK_MB);
    daemon.stop("-TERM");
    // The sender's word is not enough: every message is in the journal, once.
    let sent = times(&fs::read(plant.path("tls.mcap")).unwrap());
    let mut kept = Vec::new();
    for part in fs::read_dir(plant.path("journal")).unwrap() {
        let path = part.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "mcap") {
            kept.extend(times(&fs::read(path).unwrap()));
        }
    }
    kept.sort_unstable();
    let from_the_first = |times: &[u64]| times.iter().map(|time| time - times[0]).collect::<Vec<_>>();
    assert!(sent.len() >= 300, "{} messages sent", sent.len());
    assert_eq!(from_the_first(&kept), from_the_first(&sent));
}

/// Log times of the messages of the rod that is measured.
fn times(recording: &[u8]) -> Vec<u64> {
    let messages = mcap::MessageStream::new(recording).unwrap().map(Result::unwrap);
    messages
        .filter(|message| message.channel.topic == "/rod-0")
        .map(|message| message.log_time)
        .collect()
}
