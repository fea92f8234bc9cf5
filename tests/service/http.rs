//! The HTTP server over raw sockets: answers, refusals, limits, deadlines, its end.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use tirante::config::settings::http::HttpSettings;
use tirante::service::http::{listen, routes, serve};
use tirante::service::telemetry::{Fault, Phase, Telemetry};
use tokio::sync::watch;

/// Longest wait before the test fails.
const PATIENCE: Duration = Duration::from_secs(30);

/// A server on a port of its own; it ends when this is dropped.
struct Server {
    address: SocketAddr,
    telemetry: Telemetry,
    stop: watch::Sender<bool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Server {
    fn start() -> Self {
        let settings = HttpSettings {
            listen: Some("127.0.0.1:0".parse().unwrap()),
            ..HttpSettings::default()
        };
        let listener = listen(&settings).unwrap().expect("a listener");
        let address = listener.local_addr().unwrap();
        let telemetry = Telemetry::default();
        let (stop, stopped) = watch::channel(false);
        let (routes, health) = (
            routes(Some(telemetry.clone()), None),
            Arc::clone(&telemetry.health),
        );
        let thread = thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()
                .unwrap();
            runtime
                .block_on(serve(listener, routes, health, stopped))
                .unwrap();
        });
        Self {
            address,
            telemetry,
            stop,
            thread: Some(thread),
        }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.set_write_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    /// Sends bytes as they are and reads until the server closes.
    fn ask(&self, request: impl AsRef<[u8]>) -> String {
        let mut stream = self.connect();
        // A server that refuses early may close before it was sent everything.
        let _ = stream.write_all(request.as_ref());
        let mut answer = Vec::new();
        match stream.read_to_end(&mut answer) {
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::ConnectionReset => {}
            Err(error) => panic!("{error}"),
        }
        String::from_utf8(answer).unwrap()
    }

    fn get(&self, path: &str) -> String {
        self.ask(format!(
            "GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
        ))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.send_replace(true);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

fn status(answer: &str) -> u16 {
    let code = answer.split(' ').nth(1).unwrap_or_default();
    code.parse().unwrap_or_else(|_| panic!("no status in {answer:?}"))
}

fn body(answer: &str) -> &str {
    answer.split_once("\r\n\r\n").expect("an end of the headers").1
}

#[test]
fn health_and_readiness_say_how_the_daemon_stands() {
    let server = Server::start();
    let starting = server.get("/healthz");
    assert_eq!(status(&starting), 200);
    let json: serde_json::Value = serde_json::from_str(body(&starting)).unwrap();
    assert_eq!(json["state"], "starting");
    assert_eq!(json["version"], env!("CARGO_PKG_VERSION"));
    server.telemetry.enter(Phase::Starting("fitting emulators"));
    let answer = server.get("/readyz");
    assert_eq!((status(&answer), body(&answer)), (503, "fitting emulators\n"));

    server.telemetry.enter(Phase::Serving);
    let answer = server.get("/readyz");
    assert_eq!((status(&answer), body(&answer)), (200, "ready\n"));
    server
        .telemetry
        .health
        .hold(Fault::Sink, "mail", "550 no such user");
    let answer = server.get("/healthz");
    let json: serde_json::Value = serde_json::from_str(body(&answer)).unwrap();
    assert_eq!(
        (json["state"].as_str(), json["phase"].as_str()),
        (Some("degraded"), Some("serving"))
    );
    assert_eq!(json["conditions"][0]["about"], "mail");
    assert_eq!(json["faults"][0]["fault"], "sink");
    assert_eq!(json["faults"][0]["count"], 1);
    assert!(json["uptime_s"].is_u64() && json["beat_age_s"].as_f64().unwrap() < 30.0);

    server.telemetry.enter(Phase::Stopping);
    let answer = server.get("/readyz");
    assert_eq!((status(&answer), body(&answer)), (503, "the daemon stops\n"));
}

#[test]
fn metrics_are_open_metrics() {
    let server = Server::start();
    let answer = server.get("/metrics");
    assert_eq!(status(&answer), 200);
    assert!(answer.contains("content-type: application/openmetrics-text; version=1.0.0; charset=utf-8\r\n"));
    assert!(body(&answer).contains("tirante_faults_total{kind=\"disk-full\"} 0.0\n"));
    assert!(body(&answer).ends_with("# EOF\n"));
}

#[test]
fn every_answer_has_strict_headers_and_none_names_the_server() {
    let server = Server::start();
    for path in ["/", "/healthz", "/readyz", "/metrics", "/nothing"] {
        let answer = server.get(path).to_ascii_lowercase();
        for header in [
            "x-content-type-options: nosniff",
            "cache-control: no-store",
            "content-security-policy: default-src 'none'",
        ] {
            assert!(answer.contains(header), "{path}: no {header} in {answer}");
        }
        assert!(
            !answer.contains("\r\nserver:") && !answer.contains("access-control"),
            "{answer}"
        );
    }
    let head = server.ask("HEAD /metrics HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
    assert_eq!((status(&head), body(&head)), (200, ""));
}

#[test]
fn what_is_not_asked_for_here_is_refused() {
    let server = Server::start();
    for method in ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "BREW"] {
        let answer = server.ask(format!(
            "{method} /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
        ));
        assert_eq!(status(&answer), 405, "{method}");
    }
    for path in [
        "/../../etc/passwd",
        "/..%2f..%2fetc%2fpasswd",
        "/healthz/../../../etc/passwd",
        "//etc/passwd",
        "/%00",
        "/metrics/",
        "/.git/config",
        "/healthz%0d%0aX: y",
    ] {
        let answer = server.get(path);
        assert!([400, 404].contains(&status(&answer)), "{path}: {answer}");
        assert!(!answer.contains("root:") && !answer.contains("X: y"), "{answer}");
    }
    assert_eq!(
        status(&server.get(&format!("/healthz?{}", "a".repeat(5000)))),
        414
    );
    let body = "POST /metrics HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000000\r\n\r\n";
    assert_eq!(status(&server.ask(body)), 413);
    let chunked = "GET /metrics HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n";
    assert_eq!(status(&server.ask(chunked)), 413);
    let smuggled =
        "GET / HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n";
    assert!([400, 413].contains(&status(&server.ask(smuggled))));
}

#[test]
fn oversized_and_broken_requests_end_and_the_next_is_answered() {
    let server = Server::start();
    let requests: [Vec<u8>; 6] = [
        format!("GET / HTTP/1.1\r\nHost: x\r\nA: {}\r\n\r\n", "a".repeat(100_000)).into_bytes(),
        format!("GET /{} HTTP/1.1\r\nHost: x\r\n\r\n", "a".repeat(100_000)).into_bytes(),
        format!("GET / HTTP/1.1\r\n{}\r\n", "A: b\r\n".repeat(1000)).into_bytes(),
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03".repeat(100),
        vec![0; 100_000],
        b"GET / HTTP/9.9\r\n\r\n".to_vec(),
    ];
    for request in requests {
        let answer = server.ask(&request);
        let shown = String::from_utf8_lossy(&request[..request.len().min(20)]).into_owned();
        assert!(
            answer.is_empty() || [400, 414, 431].contains(&status(&answer)),
            "{shown}: {answer}"
        );
        assert_eq!(status(&server.get("/metrics")), 200);
    }
}

#[test]
fn a_client_that_dribbles_is_cut_off_and_others_are_served_meanwhile() {
    let server = Server::start();
    let begun = Instant::now();
    let mut slow = server.connect();
    slow.write_all(b"GET / HTTP/1.1\r\n").unwrap();
    slow.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let mut idle = server.connect();
    let mut kept = server.connect();
    kept.write_all(b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n")
        .unwrap();
    let is_cut = loop {
        assert!(begun.elapsed() < PATIENCE, "it was never cut off");
        let _ = slow.write_all(b"A: b\r\n");
        match slow.read(&mut [0; 1000]) {
            Ok(0) => break true,
            Ok(_) => {}
            Err(error) if [ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&error.kind()) => {}
            Err(_) => break true,
        }
        assert_eq!(status(&server.get("/metrics")), 200);
    };
    assert!(
        is_cut && begun.elapsed() < Duration::from_secs(15),
        "{:?}",
        begun.elapsed()
    );
    assert_eq!(
        idle.read(&mut [0; 10]).unwrap_or(0),
        0,
        "one that says nothing is closed too"
    );
    let mut answer = String::new();
    kept.read_to_string(&mut answer).unwrap();
    assert_eq!(
        status(&answer),
        200,
        "a kept connection was answered, and then closed"
    );
    assert!(begun.elapsed() < PATIENCE, "{:?}", begun.elapsed());
}

#[test]
fn a_crowd_of_kept_connections_does_not_keep_health_from_being_asked() {
    let server = Server::start();
    let keep = || {
        let mut stream = server.connect();
        stream
            .write_all(b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n")
            .unwrap();
        assert!(stream.read(&mut [0; 1 << 16]).unwrap() > 0);
        stream
    };
    let mut held: Vec<TcpStream> = (0..64).map(|_| keep()).collect();
    for round in 0..30 {
        let begun = Instant::now();
        let answer = server.get("/healthz");
        assert!(answer.starts_with("HTTP/1.1 200"), "{round}: {answer}");
        assert!(begun.elapsed() < Duration::from_secs(1), "{:?}", begun.elapsed());
        // Who was let go comes again.
        held.push(keep());
    }
    assert!(server.telemetry.health.count(Fault::Refused) > 30);
    // A thousand silent connections.
    for _ in 0..1000 {
        held.push(server.connect());
        if held.len() > 200 {
            held.remove(0);
        }
    }
    assert_eq!(status(&server.get("/healthz")), 200);
}

#[test]
fn a_client_that_takes_no_answer_is_cut_off_and_the_end_comes_at_once() {
    let server = Server::start();
    let mut stream = server.connect();
    stream
        .set_write_timeout(Some(Duration::from_millis(200)))
        .unwrap();
    let request = b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n";
    let begun = Instant::now();
    // Asks until neither side's buffers take any more, then goes on until the server has had enough.
    let error = loop {
        assert!(begun.elapsed() < 2 * PATIENCE, "it was never cut off");
        match stream.write(request) {
            Ok(_) => {}
            Err(error) if [ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&error.kind()) => {}
            Err(error) => break error,
        }
    };
    assert!(
        [ErrorKind::ConnectionReset, ErrorKind::BrokenPipe].contains(&error.kind()),
        "{error}"
    );

    let _open = server.connect();
    let begun = Instant::now();
    drop(server);
    assert!(begun.elapsed() < Duration::from_secs(3), "{:?}", begun.elapsed());
}

#[test]
fn no_address_no_server_and_a_taken_one_is_named() {
    assert!(
        listen(&HttpSettings {
            listen: None,
            ..HttpSettings::default()
        })
        .unwrap()
        .is_none()
    );
    let server = Server::start();
    let taken = HttpSettings {
        listen: Some(server.address),
        ..HttpSettings::default()
    };
    let error = listen(&taken).unwrap_err().to_string();
    assert!(error.contains("http.listen 127.0.0.1:"), "{error}");
}
