//! A stalled work loop: systemd's watchdog is not fed, health reports it, and the other threads go on.

use super::campaign::{Campaign, Material};
use super::process::Process;
use super::steps::{Files, Found, has_strace, injecting, prepare};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

/// Full answer of `/healthz`.
pub fn status(port: u16) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    stream
        .write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// A free port.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

#[test]
#[ignore = "45 s of waiting"]
fn a_work_loop_that_hangs_does_not_feed_the_watchdog() {
    if !has_strace() {
        return;
    }
    let port = free_port();
    let campaign = Campaign::new(
        Material::long(),
        &format!("[http]\nlisten = \"127.0.0.1:{port}\"\n"),
    );
    let socket = UnixDatagram::bind(campaign.path("notify")).unwrap();
    socket.set_nonblocking(true).unwrap();
    let mut feed = campaign.feed();
    // Making the store takes more than ten flushes.
    prepare(&campaign, &mut feed, Found::Begun);
    // The tenth flush of the store hangs for an hour; the journal's do not.
    let injection = "delay_enter=3600000000:when=10+";
    let words = injecting(&campaign, Files::Store, "fsync,fdatasync", injection);
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let notify = campaign.path("notify");
    let variables = [
        ("NOTIFY_SOCKET", notify.to_str().unwrap()),
        ("WATCHDOG_USEC", "8000000"),
    ];
    let mut daemon = Process::with(campaign.folder.path(), &words, &variables);
    let hear = || {
        let mut buffer = [0; 4096];
        let mut told = Vec::new();
        while let Ok(length) = socket.recv(&mut buffer) {
            told.push(String::from_utf8_lossy(&buffer[..length]).into_owned());
        }
        told
    };
    daemon.wait_until("it is ready", |log| log.contains("ready"));
    feed.offer(0.2);
    daemon.wait_until("it hangs", |log| log.contains("nothing passed through"));
    let told = hear();
    assert!(told.iter().any(|said| said.contains("READY=1")), "{told:?}");
    assert!(told.iter().any(|said| said.contains("WATCHDOG=1")), "{told:?}");
    let (acks, begun, mut share) = (feed.acks(), Instant::now(), 0.2);
    while begun.elapsed() < Duration::from_secs(5) {
        share += 0.01;
        feed.offer(share);
        std::thread::sleep(Duration::from_millis(100));
    }
    let told = hear();
    assert!(!told.iter().any(|said| said.contains("WATCHDOG=1")), "{told:?}");
    assert!(feed.acks() > acks, "the journal goes on");
    // A monitor hears of it at once, and that the daemon does not live after half a minute.
    assert!(status(port).contains("\"failing\""), "{}", status(port));
    daemon.wait_until("it does not count as alive", |_| {
        status(port).starts_with("HTTP/1.1 503")
    });
    let told = hear();
    assert!(!told.iter().any(|said| said.contains("WATCHDOG=1")), "{told:?}");
    drop(daemon);
    campaign.finish(&mut feed);
    campaign.check("hung", false);
}
