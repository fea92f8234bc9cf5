//! Every kind of fault, made to happen to a real daemon: each changes its counter and the state of health, and writes one
//! line into the log, however often it happens within a minute.
//!
//! Two kinds are not here: no input is known that makes the analysis panic (`broken`), and a stalled work
//! loop (`stalled`) takes half a minute to be detected; `tests/notify.rs` has it.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod site;

use serde_json::Value;
use site::*;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Sections of the daemon's configuration besides the site: no fixed port, so that daemons run side by side.
const OPERATION: &str = r#"
[abc]
draws = 1000
accept = { quantile = 0.1 }
[store]
path = "site.db"
[ingest]
folder = "archive"
listen = ["unix://SOCKET"]
clients = 2
idle_s = 1
[http]
listen = "127.0.0.1:0"
"#;
/// Longest wait on a busy machine.
const DEADLINE: Duration = Duration::from_secs(120);
/// Least time between two log lines of one kind.
const MINUTE: Duration = Duration::from_secs(60);

/// A site with a daemon's configuration and an empty folder.
fn daemon_site() -> Site {
    let site = Site::new(SITE);
    let socket = site.path("socket");
    let operation = OPERATION.replace("SOCKET", socket.to_str().unwrap());
    fs::write(site.path("site.toml"), SITE.to_owned() + &operation).unwrap();
    fs::create_dir(site.path("archive")).unwrap();
    site
}

/// Five useless records of the rod `north`: its sensor holds a value.
fn held(site: &Site) {
    let held = "[[simulation.rod.fault]]\nkind = \"held\"\nat_s = 3.0\nlength_s = 20.0\n";
    site.simulate("held", &Part::new(0, 5).north(held));
}

/// A daemon, ended when it is dropped.
struct Daemon {
    child: Child,
    log: PathBuf,
    begun: Instant,
}

impl Daemon {
    fn spawn(site: &Site, command: &mut Command) -> Self {
        let log = site.path("daemon.log");
        let child = command
            .current_dir(site.folder.path())
            .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
            .env("TIRANTE_LOG", "info")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(&log).unwrap())
            .process_group(0)
            .spawn()
            .unwrap();
        let begun = Instant::now();
        Self { child, log, begun }
    }

    fn start(site: &Site) -> Self {
        Self::spawn(site, &mut site.command(&["run", "--config", "site.toml"]))
    }

    fn ready(site: &Site) -> Self {
        let mut daemon = Self::start(site);
        daemon.wait("it is ready", |daemon| daemon.log().contains(" ready"));
        daemon
    }

    fn log(&self) -> String {
        fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Number of log lines about a kind of fault, without those that it is over.
    fn lines(&self, kind: &str) -> usize {
        self.log()
            .lines()
            .filter(|line| line.contains(&format!("fault=\"{kind}\"")) && !line.contains(" INFO "))
            .count()
    }

    fn wait(&mut self, what: &str, is_so: impl Fn(&Self) -> bool) {
        let until = Instant::now() + DEADLINE;
        while !is_so(self) {
            assert!(Instant::now() < until, "not so: {what}\n{}", self.log());
            let ended = self.child.try_wait().unwrap();
            assert!(ended.is_none(), "ended before {what}:\n{}", self.log());
            thread::sleep(Duration::from_millis(20));
        }
    }

    fn get(&self, path: &str) -> String {
        let log = self.log();
        let address = log
            .split("health and metrics at http://")
            .nth(1)
            .and_then(|rest| rest.split_whitespace().next())
            .unwrap();
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(DEADLINE)).unwrap();
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n"
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (_, body) = answer.split_once("\r\n\r\n").unwrap();
        body.to_owned()
    }

    fn health(&self) -> Value {
        serde_json::from_str(&self.get("/healthz")).unwrap()
    }

    fn state(&self) -> String {
        self.health()["state"].as_str().unwrap().to_owned()
    }

    /// Conditions of a kind of fault.
    fn conditions(&self, kind: &str) -> usize {
        let health = self.health();
        let conditions = health["conditions"].as_array().unwrap();
        conditions.iter().filter(|one| one["fault"] == kind).count()
    }

    fn count(&self, kind: &str) -> f64 {
        let name = format!("tirante_faults_total{{kind=\"{kind}\"}} ");
        let metrics = self.get("/metrics");
        let line = metrics.lines().find_map(|line| line.strip_prefix(&name));
        line.unwrap().parse().unwrap()
    }

    /// Waits until the fault has been counted so often and health shows it; the log must have at most one
    /// line of it a minute.
    fn expect(&mut self, kind: &str, count: f64, state: &str) {
        self.wait(&format!("{kind} is counted"), |daemon| {
            daemon.count(kind) >= count
        });
        assert_eq!(self.state(), state, "{kind}");
        let health = self.health();
        let faults = health["faults"].as_array().unwrap();
        assert!(faults.iter().any(|fault| fault["fault"] == kind), "{health}");
        let lines = self.lines(kind);
        let most = 1 + (self.begun.elapsed().as_secs() / MINUTE.as_secs()) as usize;
        assert!((1..=most).contains(&lines), "{lines} lines:\n{}", self.log());
    }

    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        let kill = Command::new("kill").args([name, &pid]).status().unwrap();
        assert!(kill.success());
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            // The whole group: what strace runs would outlive it.
            let group = format!("-{}", self.child.id());
            let _ = Command::new("kill").args(["-KILL", "--", &group]).status();
            let _ = self.child.wait();
        }
    }
}

/// Answers to a client that sends `words`, to the end of its connection.
fn told(site: &Site, words: &str) -> String {
    let mut client = UnixStream::connect(site.path("socket")).unwrap();
    client.set_read_timeout(Some(DEADLINE)).unwrap();
    // One that is turned away may be gone already.
    let _ = client.write_all(words.as_bytes());
    let mut answer = String::new();
    let _ = client.read_to_string(&mut answer);
    answer
}

#[test]
fn rejected() {
    let site = daemon_site();
    let mut daemon = Daemon::ready(&site);
    assert_eq!(daemon.state(), "ok");
    assert!(daemon.count("rejected") < 1.0);
    held(&site);
    daemon.expect("rejected", 5.0, "degraded");
}

#[test]
fn recording() {
    let site = daemon_site();
    let mut daemon = Daemon::ready(&site);
    held(&site);
    let whole = fs::read(site.path("archive/held.mcap")).unwrap();
    for index in 1..=3 {
        let mut damaged = whole.clone();
        let middle = damaged.len() * index / 4;
        for byte in &mut damaged[middle..middle + 64] {
            *byte ^= 0x55;
        }
        fs::write(site.path(&format!("archive/damaged-{index}.mcap")), damaged).unwrap();
    }
    daemon.expect("recording", 3.0, "degraded");
}

#[test]
fn client() {
    let site = daemon_site();
    let mut daemon = Daemon::ready(&site);
    for _ in 0..3 {
        assert!(told(&site, "GET / HTTP/1.1\r\n\r\n").contains("error"));
    }
    daemon.expect("client", 3.0, "degraded");
}

#[test]
fn refused_and_idle() {
    let site = daemon_site();
    let mut daemon = Daemon::ready(&site);
    let hello = |name: &str| {
        let mut client = UnixStream::connect(site.path("socket")).unwrap();
        client.set_read_timeout(Some(DEADLINE)).unwrap();
        writeln!(client, "{{\"hello\":{{\"sender\":\"{name}\"}}}}").unwrap();
        client
    };
    let mut full = [hello("a"), hello("b")];
    // Both are in before the third comes.
    for client in &mut full {
        assert_eq!(client.read(&mut [0; 8]).unwrap(), 8);
    }
    assert!(told(&site, "{}\n").contains("again"));
    daemon.expect("refused", 1.0, "degraded");
    // Both say nothing more and are closed.
    for client in &mut full {
        let mut rest = String::new();
        client.read_to_string(&mut rest).unwrap();
        assert!(rest.contains("error"), "{rest}");
    }
    daemon.expect("idle", 2.0, "degraded");
}

#[test]
fn quarantined() {
    let site = daemon_site();
    site.simulate("good", &Part::new(0, 3));
    site.replay(&["archive"], "replayed.db");
    let store = rusqlite::Connection::open(site.path("replayed.db")).unwrap();
    let mut statement = store
        .prepare("SELECT rod, lower(hex(identity)) FROM record WHERE rod = 'north'")
        .unwrap();
    let deaths: BTreeMap<String, u32> = statement
        .query_map((), |row| {
            let (rod, identity) = (row.get::<_, String>(0)?, row.get::<_, String>(1)?);
            Ok((format!("record {identity} of rod {rod}"), 2))
        })
        .unwrap()
        .map(Result::unwrap)
        .collect();
    fs::write(
        site.path("site.db.suspects"),
        serde_json::to_vec(&deaths).unwrap(),
    )
    .unwrap();
    Daemon::ready(&site).expect("quarantined", 3.0, "degraded");
}

#[test]
fn store_damaged() {
    let site = daemon_site();
    drop(Daemon::ready(&site));
    let length = fs::metadata(site.path("site.db")).unwrap().len();
    fs::write(site.path("site.db"), vec![0; usize::try_from(length).unwrap()]).unwrap();
    let mut daemon = Daemon::ready(&site);
    daemon.expect("store-damaged", 1.0, "degraded");
    assert_eq!(
        daemon.conditions("store-damaged"),
        1,
        "somebody has to look at it"
    );
}

#[test]
fn sink() {
    let site = daemon_site();
    // A port nobody listens at.
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    let sink = format!("[[sink]]\nid = \"office\"\nkind = \"webhook\"\nurl = \"http://{port}/\"\n");
    fs::write(site.path("site.toml"), config + &sink).unwrap();
    let mut daemon = Daemon::ready(&site);
    assert!(daemon.count("sink") < 1.0);
    held(&site);
    daemon.expect("sink", 1.0, "degraded");
    assert_eq!(daemon.conditions("sink"), 1);
    daemon.wait("the log is told all the same", |daemon| {
        daemon.log().contains("sensor")
    });
}

#[test]
fn reload() {
    let site = daemon_site();
    let mut daemon = Daemon::ready(&site);
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(site.path("site.toml"), config.replace("length_m", "lenght_m")).unwrap();
    for count in [1.0, 2.0, 3.0] {
        daemon.signal("-HUP");
        daemon.expect("reload", count, "degraded");
    }
    assert!(daemon.log().contains("lenght_m"), "{}", daemon.log());
}

/// Not a fault, but operators' alarms depend on it: a rod that is no longer configured has no gauges.
#[test]
fn a_rod_that_is_no_longer_configured_has_no_gauges() {
    let site = daemon_site();
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    held(&site);
    let mut daemon = Daemon::ready(&site);
    let has = |daemon: &Daemon, rod: &str| {
        let text = daemon.get("/metrics");
        [
            "rod_state{",
            "rod_last_record_timestamp_seconds{",
            "alarms_standing{",
        ]
        .map(|gauge| {
            text.lines()
                .any(|line| line.starts_with(&format!("tirante_{gauge}rod=\"{rod}\"")))
        })
    };
    daemon.wait("both rods have gauges", |daemon| {
        has(daemon, "north") == [true; 3] && has(daemon, "south") == [true; 3]
    });
    let first = config.find("[[rod]]").unwrap();
    let second = config.rfind("[[rod]]").unwrap();
    fs::write(
        site.path("site.toml"),
        [&config[..first], &config[second..]].concat(),
    )
    .unwrap();
    daemon.signal("-HUP");
    daemon.wait("north is gone", |daemon| has(daemon, "north") == [false; 3]);
    assert_eq!(has(&daemon, "south"), [true; 3]);
}

#[test]
fn folder() {
    let site = daemon_site();
    let mut daemon = Daemon::ready(&site);
    fs::rename(site.path("archive"), site.path("elsewhere")).unwrap();
    daemon.expect("folder", 1.0, "degraded");
    assert_eq!(daemon.conditions("folder"), 1);
    fs::rename(site.path("elsewhere"), site.path("archive")).unwrap();
    daemon.wait("the folder is back", |daemon| daemon.conditions("folder") == 0);
    daemon.expect("folder", 1.0, "degraded");
}

#[test]
fn disk_full() {
    let site = daemon_site();
    let disk = SmallDisk::mount(site.path("small"));
    let Some(_disk) = disk else {
        eprintln!("skipped: no file system can be mounted here");
        return;
    };
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(
        site.path("site.toml"),
        config.replace("\"site.db\"", "\"small/site.db\""),
    )
    .unwrap();
    let mut daemon = Daemon::ready(&site);
    assert_eq!(daemon.state(), "ok");
    // As much as there is room for.
    let mut ballast = File::create(site.path("small/ballast")).unwrap();
    while ballast.write_all(&[1; 4096]).is_ok() {}
    // A file that is open keeps its room after it is removed.
    drop(ballast);
    held(&site);
    daemon.expect("disk-full", 1.0, "failing");
    fs::remove_file(site.path("small/ballast")).unwrap();
    daemon.wait("it goes on", |daemon| daemon.state() == "degraded");
    daemon.expect("rejected", 5.0, "degraded");
}

/// A file system of 32 MB, gone when it is dropped.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts one; `None` where that is not allowed.
    fn mount(path: PathBuf) -> Option<Self> {
        fs::create_dir(&path).unwrap();
        let mount = Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=32m", "tmpfs"])
            .arg(&path)
            .output();
        mount
            .is_ok_and(|output| output.status.success())
            .then(|| Self(path))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

#[test]
fn write() {
    if Command::new("strace").arg("-V").output().is_err() {
        eprintln!("skipped: no strace");
        return;
    }
    let site = daemon_site();
    let mut strace = Command::new("strace");
    strace
        .args(["-f", "-o", "/dev/null", "-e", "trace=fdatasync", "-P"])
        .arg(site.path("journal/journal.000001.mcap"))
        // The first flush is of the empty journal, when the daemon begins: only those of what the client sends fail.
        .args(["-e", "inject=fdatasync:error=EIO:when=2+"])
        .args([env!("CARGO_BIN_EXE_tirante"), "run", "--config", "site.toml"]);
    let mut daemon = Daemon::spawn(&site, &mut strace);
    daemon.wait("it is ready", |daemon| daemon.log().contains(" ready"));
    let line = "{\"topic\":\"/north\",\"time\":1767268800000000000,\"values\":[1e-5]}\n{\"end\":true}\n";
    let answer = told(&site, line);
    assert!(!answer.contains("done"), "acknowledged in spite of it: {answer}");
    let until = Instant::now() + DEADLINE;
    let status = loop {
        if let Some(status) = daemon.child.try_wait().unwrap() {
            break status;
        }
        assert!(Instant::now() < until, "does not end:\n{}", daemon.log());
        thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(1), "{}", daemon.log());
    assert_eq!(daemon.lines("write"), 1, "{}", daemon.log());
}
