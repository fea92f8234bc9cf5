//! Certificates of daemon and senders: exchanged while the daemon runs, near their end, bound to names and topics.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use crate::listeners::*;
use crate::send::{Authority, mcap, settings, tirante_send};
use std::ffi::{OsStr, OsString};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tirante::config::settings::ingest::{BoundCertificate, IngestSettings, TlsSettings};
use tirante::service::telemetry::{Fault, Via};

/// Longest time for what must not be tried again and again.
const PATIENCE: Duration = Duration::from_secs(60);

/// A daemon with TLS, and what its senders need.
struct Port {
    folder: tempfile::TempDir,
    authority: Authority,
    daemon: Daemon,
}

impl Port {
    /// The daemon's certificate ends in so many days.
    fn open(days: i64, bound: Vec<BoundCertificate>) -> Self {
        Self::with(days, bound, settings().clients)
    }

    fn with(days: i64, bound: Vec<BoundCertificate>, clients: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::new();
        let [client_ca, certificate, key] = authority.write_until(folder.path(), "daemon", days);
        fs::set_permissions(&key, Permissions::from_mode(0o600)).unwrap();
        let tls = TlsSettings {
            certificate,
            key,
            client_ca,
            bound,
        };
        let daemon = Daemon::start(IngestSettings {
            tls: Some(tls),
            clients,
            ..settings()
        });
        fs::write(folder.path().join("a.mcap"), mcap(100)).unwrap();
        Self {
            folder,
            authority,
            daemon,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn words(&self, [ca, certificate, key]: &[PathBuf; 3], speed: &str) -> Vec<OsString> {
        let to = format!("tcp://{}", self.daemon.address);
        let mut words = vec![self.path("a.mcap").into_os_string()];
        words.extend(["--to", &to, "--speed", speed].map(OsString::from));
        for (flag, path) in [
            ("--tls-ca", ca),
            ("--tls-certificate", certificate),
            ("--tls-key", key),
        ] {
            words.extend([OsString::from(flag), path.clone().into_os_string()]);
        }
        words
    }

    fn send(&self, identity: &[PathBuf; 3], more: &[&str]) -> Output {
        let words = self.words(identity, "max");
        let mut words: Vec<&OsStr> = words.iter().map(OsString::as_os_str).collect();
        words.extend(more.iter().map(OsStr::new));
        tirante_send(&words)
    }

    /// Condition about a file or a client.
    fn warns(&self, about: &str) -> Option<String> {
        let conditions = self.daemon.health.conditions();
        let found = conditions
            .into_iter()
            .find(|lasting| lasting.fault == Fault::Certificate && lasting.about == about);
        found.map(|lasting| lasting.detail)
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[test]
fn a_near_end_is_told_and_a_new_certificate_taken_at_once() {
    let port = Port::open(12, Vec::new());
    let about = format!("certificate {}", shown(&port.path("daemon.pem")));
    wait_for("the near end is a condition", || {
        port.warns(&about)
            .is_some_and(|detail| detail.contains("in 11 days"))
    });
    let ends = || port.daemon.health.credentials().all_ends();
    let before = ends()["certificate"];
    let client = port.authority.write(port.folder.path(), "client");
    assert!(port.send(&client, &[]).status.success());

    // A certificate without its key is not taken, and the old one serves on.
    let new = port.authority.write_until(port.folder.path(), "new", 500);
    fs::copy(&new[1], port.path("daemon.pem")).unwrap();
    wait_for("the wrong pair is a condition", || {
        port.warns("new certificates").is_some()
    });
    assert!(port.send(&client, &[]).status.success());
    fs::copy(&new[2], port.path("daemon.key")).unwrap();
    wait_for("both are taken, and nothing is wrong", || {
        port.warns("new certificates").is_none() && port.warns(&about).is_none()
    });
    assert!(ends()["certificate"] > before + 400 * 86_400);

    // One that every sender would turn away is not taken either.
    let of_client = port.authority.write_of_client(port.folder.path(), "of-client");
    fs::copy(&of_client[1], port.path("daemon.pem")).unwrap();
    fs::copy(&of_client[2], port.path("daemon.key")).unwrap();
    wait_for("its use is a condition", || {
        port.warns("new certificates")
            .is_some_and(|detail| detail.contains("server authentication"))
    });
    assert!(port.send(&client, &[]).status.success());
    fs::copy(&new[1], port.path("daemon.pem")).unwrap();
    fs::copy(&new[2], port.path("daemon.key")).unwrap();
    wait_for("the one before is taken", || {
        port.warns("new certificates").is_none()
    });
    assert!(port.send(&client, &[]).status.success());
    assert_eq!(port.daemon.ledger.streams().len(), 4);

    // A key that everybody can read is told too.
    fs::set_permissions(port.path("daemon.key"), Permissions::from_mode(0o644)).unwrap();
    let about = format!("key {}", shown(&port.path("daemon.key")));
    wait_for("the open key is a condition", || {
        port.warns(&about)
            .is_some_and(|detail| detail.contains("chmod 600"))
    });
}

#[test]
fn an_ended_certificate_ends_a_sender_with_the_reason() {
    let port = Port::open(4000, Vec::new());
    let soon = port.authority.write_until(port.folder.path(), "soon", 3);
    let output = port.send(&soon, &[]);
    assert!(
        output.status.success() && said(&output).contains("in 2 days"),
        "{}",
        said(&output)
    );
    assert!(
        port.warns("client soon")
            .is_some_and(|detail| detail.contains("refused from then on"))
    );

    // With a name it would try again for ever.
    let begun = Instant::now();
    let ended = port.authority.write_until(port.folder.path(), "ended", -2);
    let output = port.send(&ended, &["--sender", "ended"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(said(&output).contains("ended on"), "{}", said(&output));
    // So would one whose certificate the daemon does not know.
    let mut foreign = Authority::new().write(port.folder.path(), "foreign");
    foreign[0] = soon[0].clone();
    let output = port.send(&foreign, &["--sender", "foreign"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said(&output).contains("does not accept our certificate"),
        "{}",
        said(&output)
    );
    wait_for("it is counted", || {
        port.daemon.health.credentials().denials(Via::Socket) > 0
    });
    assert!(begun.elapsed() < PATIENCE, "they end at once");
    assert_eq!(port.daemon.ledger.streams().len(), 1);
}

#[test]
fn a_certificate_that_is_not_valid_yet_is_told_on_both_sides() {
    let port = Port::open(4000, Vec::new());
    let early = port.authority.write_early(port.folder.path(), "early");
    let output = port.send(&early, &["--sender", "early"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said(&output).contains("is not valid before 2150-01-01"),
        "{}",
        said(&output)
    );
    // The daemon's own, in force with its key.
    fs::copy(&early[2], port.path("daemon.key")).unwrap();
    fs::copy(&early[1], port.path("daemon.pem")).unwrap();
    let about = format!("certificate {}", shown(&port.path("daemon.pem")));
    wait_for("it is a condition", || {
        port.warns(&about)
            .is_some_and(|detail| detail.contains("not valid before 2150-01-01"))
    });
}

#[test]
fn one_certificate_takes_three_quarters_of_the_places_at_most() {
    let port = Port::with(4000, Vec::new(), 8);
    let alice = port.authority.write(port.folder.path(), "alice");
    // At a thousandth of the recorded speed they stay.
    let mut crowd: Vec<_> = (0..8)
        .map(|_| {
            let mut command = Command::new(env!("CARGO_BIN_EXE_tirante"));
            command.arg("send").args(port.words(&alice, "0.001"));
            command.stderr(Stdio::null()).spawn().unwrap()
        })
        .collect();
    wait_for("the crowd has its share", || port.daemon.clients() == 6);
    wait_for("two of it are turned away", || {
        let ended = crowd.iter_mut().filter_map(|one| one.try_wait().unwrap());
        ended.filter(|status| !status.success()).count() == 2
    });
    let other = port.authority.write(port.folder.path(), "bob");
    let output = port.send(&other, &[]);
    assert!(output.status.success(), "{}", said(&output));
    let output = port.send(&alice, &[]);
    assert!(
        said(&output).contains("6 clients with this certificate are connected already"),
        "{}",
        said(&output)
    );
    for one in &mut crowd {
        let _ = one.kill();
        one.wait().unwrap();
    }
}

#[test]
fn a_bound_certificate_sends_under_its_names_and_on_its_topics_only() {
    let bound = |certificate: &str, senders: &[&str], topics: &[&str]| BoundCertificate {
        certificate: certificate.to_owned(),
        senders: senders.iter().map(|&name| name.to_owned()).collect(),
        topics: topics.iter().map(|&topic| topic.to_owned()).collect(),
    };
    let port = Port::open(
        4000,
        vec![
            bound("north", &["north-laser"], &["/las*"]),
            bound("air", &["air"], &["/air"]),
        ],
    );
    let write = |name: &str| port.authority.write(port.folder.path(), name);
    let (north, air, other) = (write("north"), write("air"), write("other"));
    let good = port.send(&north, &["--sender", "north-laser"]);
    assert!(good.status.success(), "{}", said(&good));
    let denied = |output: Output, why: &str| {
        assert_eq!(output.status.code(), Some(1), "{}", said(&output));
        assert!(said(&output).contains(why), "{}", said(&output));
    };
    denied(
        port.send(&north, &["--sender", "south-laser"]),
        "not bound to the sender name south-laser",
    );
    // The recording is of `/laser`.
    denied(
        port.send(&air, &["--sender", "air"]),
        "not bound to the topic /laser",
    );
    denied(port.send(&other, &["--sender", "other"]), "no entry");
    assert_eq!(port.daemon.health.credentials().denials(Via::Socket), 3);
    let streams = port.daemon.ledger.streams();
    assert_eq!(
        streams
            .iter()
            .map(|stream| stream.messages().len())
            .sum::<usize>(),
        100
    );
}
