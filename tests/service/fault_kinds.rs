//! Every kind of fault, made to happen to a real daemon: each changes its counter and the state of health, and writes one
//! line into the log, however often it happens within a minute.
//!
//! Three kinds are not here: no input is known that makes the analysis panic (`broken`), a stalled work
//! loop (`stalled`) takes half a minute to be detected; `tests/service/notify.rs` has it; the post to a centre
//! (`forward`) is in `tests/process/hub`.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[allow(dead_code)] // not every test uses all of them
use crate::alerts::fake::Fake;
use crate::site::*;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{Client, Event, MqttOptions};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::signal::record::{RodId, Timestamp};
use tirante::site::store::{Durability, Reader, Store, Stretch};

/// Sections of the daemon's configuration besides the site: no fixed port, so that daemons run side by side.
const OPERATION: &str = r#"
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
pub(crate) fn daemon_site() -> Site {
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
pub(crate) struct Daemon {
    pub(crate) child: Child,
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

    pub(crate) fn ready(site: &Site) -> Self {
        let mut daemon = Self::start(site);
        daemon.wait("it is ready", |daemon| daemon.log().contains(" ready"));
        daemon
    }

    pub(crate) fn log(&self) -> String {
        fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Number of log lines about a kind of fault, without those that it is over.
    fn lines(&self, kind: &str) -> usize {
        self.log()
            .lines()
            .filter(|line| line.contains(&format!("fault=\"{kind}\"")) && !line.contains(" INFO "))
            .count()
    }

    pub(crate) fn wait(&mut self, what: &str, is_so: impl Fn(&Self) -> bool) {
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

    pub(crate) fn health(&self) -> Value {
        serde_json::from_str(&self.get("/healthz")).unwrap()
    }

    fn state(&self) -> String {
        self.health()["state"].as_str().unwrap().to_owned()
    }

    /// Conditions of a kind of fault.
    pub(crate) fn conditions(&self, kind: &str) -> usize {
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
    pub(crate) fn expect(&mut self, kind: &str, count: f64, state: &str) {
        self.wait(&format!("{kind} is counted"), |daemon| {
            daemon.count(kind) >= count
        });
        assert_eq!(self.state(), state, "{kind}");
        let health = self.health();
        let faults = health["faults"].as_array().unwrap();
        assert!(faults.iter().any(|fault| fault["fault"] == kind), "{health}");
        // The line follows the count.
        self.wait(&format!("{kind} is logged"), |daemon| daemon.lines(kind) > 0);
        let lines = self.lines(kind);
        let most = 1 + (self.begun.elapsed().as_secs() / MINUTE.as_secs()) as usize;
        assert!(lines <= most, "{lines} lines:\n{}", self.log());
    }

    pub(crate) fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        let kill = Command::new("kill").args([name, &pid]).status().unwrap();
        assert!(kill.success());
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            // The whole group: otherwise the program under strace would outlive it.
            let group = format!("-{}", self.child.id());
            let _ = Command::new("kill").args(["-KILL", "--", &group]).status();
            let _ = self.child.wait();
        }
    }
}

/// Answers to a client that sends `words`, to the end of its connection.
pub(crate) fn told(site: &Site, words: &str) -> String {
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
    // Both send nothing more and are closed.
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
            Ok((format!("record {identity} of rod {rod}"), 4))
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
    // The new store has it from the first moment on: after a kill nothing else would show it.
    let told = Reader::open(&site.path("site.db"))
        .unwrap()
        .notices_after(0, 1)
        .unwrap();
    assert_eq!(told[0].fault, "store-damaged");
    daemon.expect("store-damaged", 1.0, "degraded");
    assert_eq!(
        daemon.conditions("store-damaged"),
        1,
        "somebody has to look at it"
    );
}

/// A store that was lost comes back by itself, and so does one under a mistyped name; the receivers are told once, over a restart.
#[test]
fn a_new_store_beside_an_old_journal() {
    let (site, fake) = (daemon_site(), Fake::new(&[]));
    with_sink(&site, &fake);
    let mut daemon = Daemon::ready(&site);
    let line = "{\"topic\":\"/north\",\"time\":1767268800000000000,\"values\":[1e-5]}\n{\"end\":true}\n";
    assert!(told(&site, line).contains("done"));
    assert!(daemon.count("store-new") < 1.0);
    daemon.signal("-TERM");
    assert_eq!(daemon.child.wait().unwrap().code(), Some(0));
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(site.path("site.toml"), config.replace("site.db", "stie.db")).unwrap();
    let mut daemon = Daemon::ready(&site);
    daemon.expect("store-new", 1.0, "degraded");
    daemon.wait("begin and end are told", |_| {
        told_of(&fake, "store-new").len() == 2
    });
    let events: Vec<String> = told_of(&fake, "store-new")
        .into_iter()
        .map(|(what, _)| what)
        .collect();
    assert_eq!(events, ["standing", "cleared"]);
    let messages = came(&fake, "/sink");
    let message = messages.iter().find(|one| one["kind"] == "store-new").unwrap();
    let said = message["message"].as_str().unwrap();
    assert!(
        said.contains("stie.db is new") && said.contains("acknowledgements"),
        "{said}"
    );
    daemon.signal("-TERM");
    assert_eq!(daemon.child.wait().unwrap().code(), Some(0));
    let daemon = Daemon::ready(&site);
    assert!(daemon.count("store-new") < 1.0);
    assert_eq!(told_of(&fake, "store-new").len(), 2);
}

#[test]
fn sink() {
    let site = daemon_site();
    // A port without a listener.
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
    // It lasts until a good one is taken.
    assert_eq!(daemon.conditions("reload"), 1);
    fs::write(site.path("site.toml"), config).unwrap();
    daemon.signal("-HUP");
    daemon.wait("it is mended", |daemon| daemon.conditions("reload") == 0);
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

/// A rod without data has its row from the first second on, in every answer; its silence is reported, and the
/// topic that came in place of its own is named.
#[test]
fn a_rod_that_is_never_seen_is_missed() {
    let site = daemon_site();
    held(&site);
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    let mistyped = config.replace("topic = \"/north\"", "topic = \"/nrth\"");
    // Six minutes are the shortest silence there is; that they went by before is what the store says.
    fs::write(site.path("site.toml"), mistyped + "[alarm]\nsilence_h = 0.1\n").unwrap();
    let mut daemon = Daemon::ready(&site);
    let status = || {
        lines(
            &site
                .run(&["status", "--store", "site.db", "--format", "json"])
                .stdout,
        )
    };
    let rods = status();
    assert_eq!(rods.len(), 2, "both rods have a row: {rods:?}");
    let metrics = daemon.get("/metrics");
    for rod in ["north", "south"] {
        assert!(
            metrics.contains(&format!("tirante_rod_state{{rod=\"{rod}\"")),
            "{metrics}"
        );
    }
    assert!(
        metrics.contains("tirante_rod_awaited_timestamp_seconds{rod=\"north\"}"),
        "{metrics}"
    );
    let shown: Value = serde_json::from_str(&daemon.get("/api/v1/site")).unwrap();
    assert_eq!(shown["rods"].as_array().unwrap().len(), 2, "{shown}");
    daemon.expect("topic", 1.0, "degraded");
    assert_eq!(daemon.conditions("topic"), 1);
    let log = daemon.log();
    assert!(
        log.contains("/north comes") && log.contains("is /nrth (rod north)"),
        "{log}"
    );
    let north = || status().into_iter().find(|rod| rod["rod"] == "north").unwrap();
    let since = north()["never_seen_since"].as_str().unwrap().to_owned();
    assert!(daemon.get("/api/v1/rods/north/history").contains("\"time\":[]"));
    drop(daemon);

    // An hour later, as the daemon counts.
    let earlier = Timestamp::as_written(&since).unwrap().plus_seconds(-3600.0);
    let mut store = Store::open(&site.path("site.db"), Durability::Full).unwrap();
    store.expect_rods(&[], earlier).unwrap();
    store.expect_rods(&[&RodId("north".to_owned())], earlier).unwrap();
    drop(store);
    let mut daemon = Daemon::ready(&site);
    daemon.wait("its absence is told", |_| {
        !north()["alarms"].as_array().unwrap().is_empty()
    });
    let (rod, alarm) = (north(), north()["alarms"][0].clone());
    assert_eq!(
        (&rod["state"], &alarm["kind"]),
        (&"not-monitoring".into(), &"no-data".into())
    );
    assert_eq!(alarm["raised"], earlier.plus_seconds(360.0).to_string());
    assert_eq!(rod["never_seen_since"], earlier.to_string());
    // No record of it moves the gauges.
    daemon.wait("its gauges tell it", |daemon| {
        let text = daemon.get("/metrics");
        text.contains("tirante_alarms_standing{rod=\"north\",kind=\"no-data\"} 1")
            && text.contains("tirante_rod_state{rod=\"north\",state=\"not-monitoring\"} 1")
    });
    let asked = site.run(&["ack", "--config", "site.toml", "--all"]);
    assert!(asked.status.success());
    assert!(
        alarm["message"].as_str().unwrap().starts_with("never seen"),
        "{alarm}"
    );

    // The topic is mended: the condition and the alarm are over.
    fs::write(site.path("site.toml"), config).unwrap();
    daemon.signal("-HUP");
    site.simulate("later", &Part::new(5, 2));
    daemon.wait("the rod is heard", |daemon| {
        north()["alarms"].as_array().unwrap().is_empty() && daemon.conditions("topic") == 0
    });
    assert!(north()["never_seen_since"].is_null());
    assert!(
        !daemon
            .get("/metrics")
            .contains("rod_awaited_timestamp_seconds{rod=\"north\"}")
    );
}

/// A further sensor that never comes is a condition by name, from the fifth record on, until it is no more configured.
#[test]
fn a_sensor_that_never_comes_is_told() {
    let site = daemon_site();
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    let second =
        "[[rod.sensor]]\ntopic = \"/north/2\"\nfield = \"values\"\nunit = \"m\"\nfs_hz = 100.0\nat = 0.15\n";
    let two = config
        .replacen("\n[rod.temperature]", "\nat = 0.4\n[rod.temperature]", 1)
        .replacen(
            "\n[[rod]]\nid = \"south\"",
            &format!("\n{second}\n[[rod]]\nid = \"south\""),
            1,
        );
    fs::write(site.path("site.toml"), &two).unwrap();
    site.simulate("alone", &Part::new(0, 6));
    let mut daemon = Daemon::ready(&site);
    daemon.expect("left-out", 1.0, "degraded");
    assert_eq!(daemon.conditions("left-out"), 1);
    let health = daemon.health();
    assert_eq!(
        health["conditions"][0]["about"], "rod north, sensor /north/2",
        "{health}"
    );
    let status = text(&site.run(&["status", "--store", "site.db"]).stdout);
    assert!(status.contains("sensor /north/2 left out"), "{status}");
    fs::write(site.path("site.toml"), config).unwrap();
    daemon.signal("-HUP");
    daemon.wait("it is no more expected", |daemon| {
        daemon.conditions("left-out") == 0
    });
}

/// A rod that was configured by mistake and never had data leaves nothing behind.
#[test]
fn a_rod_that_never_was_is_forgotten() {
    let site = daemon_site();
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(
        site.path("site.toml"),
        config.replace("id = \"north\"", "id = \"nroth\""),
    )
    .unwrap();
    drop(Daemon::ready(&site));
    fs::write(site.path("site.toml"), config).unwrap();
    drop(Daemon::ready(&site));
    let status = lines(
        &site
            .run(&["status", "--store", "site.db", "--format", "json"])
            .stdout,
    );
    let rods: Vec<&Value> = status.iter().map(|rod| &rod["rod"]).collect();
    assert_eq!(rods, ["north", "south"]);
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

/// Adds a webhook and a heartbeat to the configuration; conditions are reported after half a second.
fn with_sink(site: &Site, fake: &Fake) {
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    let url = fake.url();
    let sink = format!(
        "[[sink]]\nid = \"office\"\nkind = \"webhook\"\nurl = \"{url}/sink\"\nkinds = [\"drift\"]\n\
         [alert]\nsettle_s = 0.5\n[alert.heartbeat]\nurl = \"{url}/alive\"\nevery_min = 0.01\n"
    );
    fs::write(site.path("site.toml"), config + &sink).unwrap();
}

/// Bodies received at a path.
fn came(fake: &Fake, path: &str) -> Vec<Value> {
    let requests = fake.requests().into_iter();
    requests
        .filter(|one| one.path == path)
        .map(|one| one.body)
        .collect()
}

/// Messages to a sink about a kind of condition: event, and id of the condition.
fn told_of(fake: &Fake, kind: &str) -> Vec<(String, String)> {
    let messages = came(fake, "/sink").into_iter().filter(|one| one["kind"] == kind);
    let word = |one: &Value, key: &str| one[key].as_str().unwrap().to_owned();
    messages
        .map(|one| (word(&one, "what"), word(&one, "alarm")))
        .collect()
}

/// The daemon's conditions are sent to every sink, whatever alarms it wants: begin and end, once each, across
/// kills. Each kill comes after the delivery is kept: before that a sink is told again, with the same id.
#[test]
fn a_condition_is_a_message_through_every_sink() {
    let (site, fake) = (daemon_site(), Fake::new(&[]));
    with_sink(&site, &fake);
    let mut daemon = Daemon::ready(&site);
    daemon.wait("it gives a sign of life", |_| !came(&fake, "/alive").is_empty());
    assert_eq!(came(&fake, "/alive")[0]["state"], "ok");
    fs::rename(site.path("archive"), site.path("elsewhere")).unwrap();
    daemon.wait("its begin is told", |_| !told_of(&fake, "folder").is_empty());
    let begun = &came(&fake, "/sink")[0];
    assert_eq!(
        (&begun["rod"], &begun["stands"]),
        (&"".into(), &true.into()),
        "{begun}"
    );
    daemon.wait("the delivery is kept", |_| {
        let reader = Reader::open(&site.path("site.db")).unwrap();
        reader.delivered("office/conditions").unwrap() == Some(reader.latest_notice().unwrap())
    });
    for _ in 0..3 {
        drop(daemon);
        daemon = Daemon::ready(&site);
        daemon.wait("it lasts", |daemon| daemon.conditions("folder") == 1);
    }
    let status = site.run(&["status", "--store", "site.db"]);
    assert!(
        text(&status.stderr).contains("folder since"),
        "{}",
        text(&status.stderr)
    );
    fs::rename(site.path("elsewhere"), site.path("archive")).unwrap();
    daemon.wait("its end is told", |_| told_of(&fake, "folder").len() > 1);
    let told = told_of(&fake, "folder");
    let what: Vec<&str> = told.iter().map(|(what, _)| what.as_str()).collect();
    assert_eq!(what, ["raised", "cleared"]);
    assert_eq!(told[0].1, told[1].1, "one id");
    drop(daemon);
    let status = site.run(&["status", "--store", "site.db"]);
    assert!(
        text(&status.stderr).contains("monitoring stopped since"),
        "{}",
        text(&status.stderr)
    );
}

/// The broker itself reports that the daemon is gone when it dies, and keeps its state for later subscribers.
#[test]
fn a_broker_knows_that_the_daemon_died() {
    let Some(program) = crate::alerts::peers::program("mosquitto", "mosquitto") else {
        return;
    };
    let site = daemon_site();
    let broker = crate::alerts::peers::Server::start_anywhere(&program, |address| {
        let text = format!("listener {} 127.0.0.1\nallow_anonymous true\n", address.port());
        fs::write(site.path("mosquitto.conf"), text).unwrap();
        vec!["-c".to_owned(), site.path("mosquitto.conf").display().to_string()]
    });
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    let sink = format!(
        "[[sink]]\nid = \"broker\"\nkind = \"mqtt\"\nurl = \"mqtt://{}\"\nstatus_topic = \"tirante/{{site}}/status\"\n",
        broker.address
    );
    fs::write(site.path("site.toml"), config + &sink).unwrap();
    // Somebody who comes later, each time: what is heard is what the broker kept.
    let state = || {
        let (host, port) = (broker.address.ip().to_string(), broker.address.port());
        let (client, mut connection) = Client::new(MqttOptions::new("later", host, port), 10);
        client
            .subscribe("tirante/Two rods/status", QoS::AtLeastOnce)
            .unwrap();
        let until = Instant::now() + Duration::from_secs(2);
        while Instant::now() < until {
            if let Ok(Ok(Event::Incoming(Packet::Publish(publish)))) =
                connection.recv_timeout(Duration::from_millis(200))
            {
                let said: Value = serde_json::from_slice(&publish.payload).unwrap();
                return said["state"].as_str().unwrap().to_owned();
            }
        }
        String::new()
    };
    let mut daemon = Daemon::ready(&site);
    daemon.wait("its state is kept", |_| state() == "ok");
    drop(daemon);
    let until = Instant::now() + DEADLINE;
    while state() != "gone" {
        assert!(Instant::now() < until, "the broker still says {}", state());
    }
    let mut daemon = Daemon::ready(&site);
    daemon.wait("it is back", |_| state() == "ok");
    daemon.signal("-TERM");
    daemon.child.wait().unwrap();
    assert_eq!(state(), "stopped");
}

/// Puts the store of a site onto its small disk.
fn store_on_small_disk(site: &Site) {
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(
        site.path("site.toml"),
        config.replace("\"site.db\"", "\"small/site.db\""),
    )
    .unwrap();
}

#[test]
fn disk_full() {
    let site = daemon_site();
    let disk = SmallDisk::mount(site.path("small"));
    let Some(_disk) = disk else {
        eprintln!("skipped: no file system can be mounted here");
        return;
    };
    store_on_small_disk(&site);
    let fake = Fake::new(&[]);
    with_sink(&site, &fake);
    let mut daemon = Daemon::ready(&site);
    assert_eq!(daemon.state(), "ok");
    // As much as there is room for.
    let mut ballast = File::create(site.path("small/ballast")).unwrap();
    while ballast.write_all(&[1; 4096]).is_ok() {}
    // A file that is open keeps its room after it is removed.
    drop(ballast);
    held(&site);
    daemon.expect("disk-full", 1.0, "failing");
    // The sinks are told though the store cannot keep it, and there is no sign of life while nothing is kept.
    daemon.wait("its begin is told", |_| !told_of(&fake, "disk-full").is_empty());
    let shown: Value = serde_json::from_str(&daemon.get("/api/v1/site")).unwrap();
    assert!(shown["monitoring"]["stopped_since"].is_string(), "{shown}");
    // The store cannot tell it to those who read it.
    let output = site
        .command(&["status", "--store", "small/site.db"])
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        words.contains("monitoring stopped since") && words.contains("no room on the disk"),
        "{words}"
    );
    let signs = came(&fake, "/alive").len();
    thread::sleep(Duration::from_secs(2));
    assert!(
        came(&fake, "/alive").len() <= signs + 1,
        "one may have been on its way"
    );
    fs::remove_file(site.path("small/ballast")).unwrap();
    daemon.wait("it goes on", |daemon| daemon.state() == "degraded");
    daemon.expect("rejected", 5.0, "degraded");
    daemon.wait("its end is told", |_| told_of(&fake, "disk-full").len() > 1);
    let told = told_of(&fake, "disk-full");
    let what: Vec<&str> = told.iter().map(|(what, _)| what.as_str()).collect();
    assert_eq!(
        what,
        ["raised", "cleared"],
        "once, though it was told past the store"
    );
    assert_eq!(told[0].1, told[1].1, "one id");
    daemon.wait("signs of life again", |_| came(&fake, "/alive").len() > signs + 1);
}

/// A disk that is full when the daemon starts is told, not again by the next start, and its end by the one that finds room.
#[test]
fn a_disk_that_is_full_at_the_start() {
    let site = daemon_site();
    let Some(_disk) = SmallDisk::mount(site.path("small")) else {
        eprintln!("skipped: no file system can be mounted here");
        return;
    };
    store_on_small_disk(&site);
    let fake = Fake::new(&[]);
    with_sink(&site, &fake);
    let stop = |mut daemon: Daemon| {
        daemon.signal("-TERM");
        assert_eq!(daemon.child.wait().unwrap().code(), Some(0));
    };
    let fill = || {
        let mut ballast = File::create(site.path("small/ballast")).unwrap();
        while ballast.write_all(&[1; 4096]).is_ok() {}
    };
    let ends = |daemon: &mut Daemon, told_before: usize| {
        fs::remove_file(site.path("small/ballast")).unwrap();
        daemon.wait("the end of each is told", |_| {
            let told = told_of(&fake, "disk-full").split_off(told_before);
            let has_ended = |id: &String| told.contains(&("cleared".to_owned(), id.clone()));
            told.iter().all(|(_, id)| has_ended(id))
        });
    };

    // There is no store, and none can be made.
    fill();
    let mut daemon = Daemon::start(&site);
    daemon.wait("its begin is told", |_| !told_of(&fake, "disk-full").is_empty());
    assert!(!daemon.log().contains(" ready"));
    ends(&mut daemon, 0);
    stop(daemon);

    // There is one, and nothing can be written into it.
    let before = told_of(&fake, "disk-full").len();
    fill();
    let mut daemon = Daemon::start(&site);
    daemon.wait("store and journal are told", |_| {
        told_of(&fake, "disk-full").len() == before + 2
    });
    stop(daemon);
    let mut daemon = Daemon::start(&site);
    let full = "fault=\"disk-full\"";
    daemon.wait("it is full again", |daemon| daemon.log().contains(full));
    thread::sleep(Duration::from_secs(3));
    assert_eq!(told_of(&fake, "disk-full").len(), before + 2, "not told again");
    ends(&mut daemon, before);
    stop(daemon);
}

/// The sinks are told why a start failed, but not that another daemon is at work.
#[test]
fn a_start_that_fails() {
    let (site, fake) = (daemon_site(), Fake::new(&[]));
    with_sink(&site, &fake);
    let ended = || {
        let messages = came(&fake, "/sink").into_iter();
        let ended = messages.filter(|one| one["what"] == "ended");
        ended
            .map(|one| one["message"].as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    let daemon = Daemon::ready(&site);
    let second = site.run(&["run", "--config", "site.toml"]);
    assert!(!second.status.success() && ended().is_empty());
    drop(daemon);
    // What stands beside the store cannot be read.
    let _ = fs::remove_file(site.path("site.db.suspects"));
    fs::create_dir(site.path("site.db.suspects")).unwrap();
    let failed = site.run(&["run", "--config", "site.toml"]);
    assert!(!failed.status.success());
    let told = ended();
    assert!(
        told.len() == 1 && told[0].contains("what stands beside it cannot be read"),
        "{told:?}"
    );
}

/// Store and journal are watched by their identity: while their names belong to other files nothing is
/// acknowledged, and the sinks are notified; when the same files are back, work continues and nothing is
/// lost.
#[test]
fn files_that_are_taken_away_are_missed() {
    let (site, fake) = (daemon_site(), Fake::new(&[]));
    with_sink(&site, &fake);
    let mut daemon = Daemon::ready(&site);
    let line = |s: i64| {
        let time = 1_767_268_800_000_000_000 + 1_000_000_000 * s;
        format!("{{\"topic\":\"/north\",\"time\":{time},\"values\":[1e-5]}}\n{{\"end\":true}}\n")
    };
    assert!(told(&site, &line(0)).contains("done"));
    for (number, name) in ["site.db", "journal/journal.000001.mcap"].into_iter().enumerate() {
        let aside = site.path("aside");
        fs::rename(site.path(name), &aside).unwrap();
        daemon.expect("files", 1.0 + number as f64, "failing");
        let mut client = UnixStream::connect(site.path("socket")).unwrap();
        client.set_read_timeout(Some(Duration::from_secs(3))).unwrap();
        client.write_all(line(10 + number as i64).as_bytes()).unwrap();
        let mut answer = String::new();
        assert!(
            client.read_to_string(&mut answer).is_err(),
            "{name}: it is not answered: {answer}"
        );
        daemon.wait("it is told past the store", |_| {
            told_of(&fake, "files").len() == 1 + 2 * number
        });
        // Another file of that name is not it.
        fs::write(site.path(name), b"another").unwrap();
        thread::sleep(Duration::from_secs(2));
        assert_eq!(daemon.state(), "failing");
        fs::rename(&aside, site.path(name)).unwrap();
        daemon.wait("it goes on", |daemon| daemon.conditions("files") == 0);
        client.set_read_timeout(Some(DEADLINE)).unwrap();
        client.read_to_string(&mut answer).unwrap();
        assert!(answer.contains("done"), "{name}: {answer}");
        daemon.wait("its end is told", |_| {
            told_of(&fake, "files").len() == 2 + 2 * number
        });
    }
    // The lock is taken anew, so that there is one writer.
    fs::remove_file(site.path("site.db.lock")).unwrap();
    daemon.wait("the lock is there again", |_| site.path("site.db.lock").exists());
    daemon.expect("files", 3.0, "degraded");
    assert_eq!(daemon.conditions("files"), 0);
    // Where it cannot be taken the daemon goes on.
    fs::remove_file(site.path("site.db.lock")).unwrap();
    fs::create_dir(site.path("site.db.lock")).unwrap();
    daemon.expect("files", 4.0, "degraded");
    fs::remove_dir(site.path("site.db.lock")).unwrap();
    daemon.wait("the lock is there again", |_| site.path("site.db.lock").is_file());
    // Each try counted. The last one, that succeeded, may be counted only now.
    thread::sleep(Duration::from_secs(2));
    let before = daemon.count("files");
    // Without the index of the log, requests of people would not be seen.
    let aside = site.path("aside");
    fs::rename(site.path("site.db-shm"), &aside).unwrap();
    daemon.expect("files", before + 1.0, "failing");
    fs::rename(&aside, site.path("site.db-shm")).unwrap();
    daemon.wait("it goes on", |daemon| daemon.conditions("files") == 0);
    // A file that another program wrote into, and that has its bytes again.
    let store = File::options()
        .read(true)
        .write(true)
        .open(site.path("site.db"))
        .unwrap();
    let mut size = [0; 4];
    store.read_exact_at(&mut size, 28).unwrap();
    store.write_all_at(&[0x7f; 4], 28).unwrap();
    daemon.expect("files", before + 2.0, "failing");
    let output = site.command(&["status", "--store", "site.db"]).output().unwrap();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(words.contains("written by another program"), "{words}");
    store.write_all_at(&size, 28).unwrap();
    daemon.wait("it goes on", |daemon| daemon.conditions("files") == 0);
    // One that is cut short does not come back.
    File::options()
        .write(true)
        .open(site.path("site.db"))
        .unwrap()
        .set_len(0)
        .unwrap();
    daemon.expect("files", before + 3.0, "failing");
    // In the log it is one of several lines within a minute.
    assert!(
        daemon.health().to_string().contains("was cut short"),
        "{}",
        daemon.health()
    );
    daemon.signal("-TERM");
    assert_eq!(daemon.child.wait().unwrap().code(), Some(0));
    let daemon = Daemon::ready(&site);
    assert!(daemon.log().contains("damaged"), "{}", daemon.log());
}

/// A part of the journal is removed only if it was read according to the store on disk, and by its age in
/// working time: here the clock jumps ahead by a month since the last daemon's work, minutes after the part
/// was written.
#[test]
fn a_part_goes_by_what_the_store_on_disk_says_and_not_by_a_clock_that_jumped() {
    let site = daemon_site();
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    fs::write(site.path("site.toml"), config + "[journal]\nkeep_d = 30\n").unwrap();
    let part = site.path("journal/journal.000001.mcap");
    let line = "{\"topic\":\"/north\",\"time\":1767268800000000000,\"values\":[1e-5]}\n{\"end\":true}\n";
    let mut daemon = Daemon::ready(&site);
    assert!(told(&site, line).contains("done"));
    daemon.signal("-TERM");
    daemon.child.wait().unwrap();
    let open = || Store::open(&site.path("site.db"), Durability::Full).unwrap();
    let now = tirante::site::clock::now();
    let ago = |days: f64| now.plus_seconds(-86_400.0 * days);
    let written = |days: f64| {
        let time = std::time::UNIX_EPOCH + Duration::from_nanos(ago(days).as_nanos().unsigned_abs());
        File::options()
            .write(true)
            .open(&part)
            .unwrap()
            .set_modified(time)
            .unwrap();
    };
    let is_read = |daemon: &mut Daemon| {
        daemon.wait("the part is read", |_| {
            let files = Reader::open(&site.path("site.db")).unwrap().files().unwrap();
            let data = fs::metadata(&part).unwrap();
            files
                .values()
                .any(|mark| mark.size == data.len() && mark.name.contains("000001"))
        });
    };
    let lived = |stretches: &[(f64, f64)]| {
        let store = rusqlite::Connection::open(site.path("site.db")).unwrap();
        store.execute("DELETE FROM alive", ()).unwrap();
        drop(store);
        let mut store = open();
        for (from, to) in stretches {
            let stretch = Stretch {
                from: ago(*from),
                to: ago(*to),
            };
            store.watch(&[], Some(stretch)).unwrap();
        }
    };
    // Written 31 days ago by the clock, minutes before the last daemon ended.
    written(31.0);
    lived(&[(40.0, 30.999)]);
    let mut daemon = Daemon::ready(&site);
    is_read(&mut daemon);
    assert_eq!(daemon.conditions("clock"), 1, "{}", daemon.log());
    thread::sleep(Duration::from_secs(3));
    assert!(part.exists(), "{}", daemon.log());
    daemon.signal("-TERM");
    daemon.child.wait().unwrap();
    // A daemon was at work all the time, but the store on disk is a copy that knows nothing of the part.
    lived(&[(40.0, 0.0)]);
    let store = rusqlite::Connection::open(site.path("site.db")).unwrap();
    store.execute("DELETE FROM file", ()).unwrap();
    drop(store);
    let vouched = tirante::service::daemon::vouch(&site.path("site.db"));
    let data = fs::metadata(&part).unwrap();
    let kept = tirante::service::journal::retention::Kept {
        part: 1,
        bytes: data.len(),
        modified_ns: ago(31.0).as_nanos(),
    };
    assert!(vouched(&[kept]).is_empty(), "nothing is known of it");
    // Read again, and old by the clock and by what was lived: it goes.
    let mut daemon = Daemon::ready(&site);
    daemon.wait("the part is gone", |_| !part.exists());
}

/// A file system of 32 MB, gone when it is dropped.
pub(crate) struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts one; `None` where that is not allowed.
    pub(crate) fn mount(path: PathBuf) -> Option<Self> {
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
        // The first flush is of the empty journal at the start of the daemon: only those of the client's data fail.
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
