//! Sites without a computer: workers that are killed, that stand still for longer than their leases, whose post and database
//! are killed, and whose network is cut, end in the rows of a replay.

use super::commands::{command, wait_for};
use super::fleet::{Fleet, Storage, end, process, stop, template};
use super::servers::{Nats, free_port, program};
use super::wire::Wire;
use crate::site::{Part, Site, lines, messages};
use async_nats::jetstream;
use rand::RngExt;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;
use tirante::config::HubConfig;
use tirante::service::hub;

/// Lease of the workers \[s\].
const LEASE_S: u64 = 2;
/// Messages of a slice: ten seconds of both rods.
const SLICE: usize = 20;
/// Kills in the gate; `KILLS` sets another number for [`a_campaign_of_killed_workers`].
const KILLS: u32 = 12;

/// The hub with sites without a computer, and their workers.
struct Thin {
    fleet: Fleet,
    workers: Vec<Option<Child>>,
    /// The network of each worker to the post and to the database, if it can be cut.
    wires: Vec<[Wire; 2]>,
}

impl Thin {
    fn of(names: &[&str], workers: usize) -> Option<Self> {
        Some(Self::in_fleet(
            Fleet::of(names, Storage::Postgres)?,
            names,
            workers,
        ))
    }

    fn in_fleet(fleet: Fleet, names: &[&str], workers: usize) -> Self {
        for (place, name) in names.iter().enumerate() {
            let path = fleet.edges[place].site.path("thin.toml");
            fs::write(&path, plain()).unwrap();
            let listed = format!("[[site]]\nname = \"{name}\"\n");
            let thin = format!("{listed}config = \"{}\"\n", path.display());
            fleet.reconfigure_hub(|text| text.replace(&listed, &thin));
        }
        Self {
            fleet,
            workers: (0..workers).map(|_| None).collect(),
            wires: Vec::new(),
        }
    }

    /// Gives each worker a network of its own.
    fn wire(&mut self) {
        let ports = self.ports();
        let wires = self.workers.iter().map(|_| ports.map(Wire::to));
        self.wires = wires.collect();
    }

    /// Ports of post and database.
    fn ports(&self) -> [u16; 2] {
        [self.fleet.nats_port(), self.fleet.database_port()]
    }

    fn start(&mut self) {
        self.fleet.start_hub();
        let config = HubConfig::load(&self.fleet.config()).unwrap();
        self.fleet.wait("the hub has made its tables", |_| {
            hub::beside(&config.storage).is_ok()
        });
        let text = fs::read_to_string(self.fleet.config()).unwrap();
        for place in 0..self.workers.len() {
            // A worker has a login of its own.
            let mut text = text.replace("HUB.nk", "WORK.nk");
            if let Some(wires) = self.wires.get(place) {
                for (port, wire) in self.ports().iter().zip(wires) {
                    text = text
                        .replace(&format!(":{port}\""), &format!(":{}\"", wire.port))
                        .replace(&format!("port={port} "), &format!("port={} ", wire.port));
                }
            }
            fs::write(self.fleet.path(&format!("work-{place}.toml")), text).unwrap();
            self.start_worker(place);
        }
        let logs: Vec<_> = (0..self.workers.len())
            .map(|place| self.fleet.path(&format!("worker-{place}.log")))
            .collect();
        self.fleet.wait("the workers are ready", |_| {
            let is_ready = |log| fs::read_to_string(log).is_ok_and(|log| log.contains("ready: "));
            logs.iter().all(is_ready)
        });
    }

    fn start_worker(&mut self, place: usize) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tirante"));
        command.current_dir(self.fleet.path("."));
        command.env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"));
        let config = format!("work-{place}.toml");
        command.args(["work", "--config", &config, "--lease", &LEASE_S.to_string()]);
        let log = self.fleet.path(&format!("worker-{place}.log"));
        self.workers[place] = Some(process(&mut command, &log));
    }

    fn kill_worker(&mut self, place: usize) {
        end(self.workers[place].take());
        self.start_worker(place);
    }

    /// Starts workers again that ended because they found no database or post at their start.
    fn keep_workers(&mut self) {
        for place in 0..self.workers.len() {
            let worker = self.workers[place].as_mut();
            if worker.is_none_or(|worker| worker.try_wait().unwrap().is_some()) {
                self.start_worker(place);
            }
        }
    }

    /// Kills the daemons of a worker's sites; it may have none.
    fn kill_daemons(&self, place: usize) {
        let worker = self.workers[place].as_ref().unwrap().id().to_string();
        let processes = fs::read_dir("/proc").unwrap().flatten();
        for process in processes {
            let stat = fs::read_to_string(process.path().join("stat")).unwrap_or_default();
            // Behind the name in parentheses: state, and the parent.
            let parent = stat
                .rsplit_once(") ")
                .and_then(|(_, rest)| rest.split(' ').nth(1));
            if parent == Some(worker.as_str()) {
                let pid = process.file_name().into_string().unwrap();
                // It may have ended meanwhile.
                Command::new("kill").args(["-KILL", &pid]).status().unwrap();
            }
        }
    }

    fn signal(&self, place: usize, name: &str) {
        let pid = self.workers[place].as_ref().unwrap().id().to_string();
        let sent = Command::new("kill").args([&format!("-{name}"), &pid]).status();
        assert!(sent.unwrap().success());
    }

    fn log(&self) -> String {
        let of = |place| fs::read_to_string(self.fleet.path(&format!("worker-{place}.log")));
        let logs: Vec<String> = (0..self.workers.len())
            .filter_map(|place| of(place).ok())
            .collect();
        logs.join("\n")
    }

    /// Waits until the centre's rows of a site are those of a store.
    fn wait_until_equal(&mut self, place: usize, store: &str) {
        let until = Instant::now() + Duration::from_secs(180);
        loop {
            self.keep_workers();
            self.fleet.keep_hub();
            let compared = self.fleet.compare(place, store, &[]);
            if compared.status.success() {
                return;
            }
            assert!(
                Instant::now() < until,
                "{}{}\n{}",
                super::fleet::text_of(&compared.stdout),
                super::fleet::text_of(&compared.stderr),
                self.log()
            );
            thread::sleep(Duration::from_millis(500));
        }
    }

    fn rows(&self) -> Vec<Value> {
        lines(&self.fleet.hub_command(&["sites", "--format", "json"]).stdout)
    }
}

impl Drop for Thin {
    fn drop(&mut self) {
        for worker in &mut self.workers {
            end(worker.take());
        }
    }
}

/// Publishes payloads in order, each once: by its number, whatever is killed meanwhile.
fn send(port: u16, name: &str, run: &str, payloads: &[Vec<u8>], pause: Duration) {
    for (number, payload) in payloads.iter().enumerate() {
        let until = Instant::now() + Duration::from_secs(60);
        loop {
            let sent = on_post_if_there(port, async |jetstream| {
                let mut headers = async_nats::HeaderMap::new();
                headers.insert("Nats-Msg-Id", format!("{name}-{run}-{number}").as_str());
                let subject = format!("tirante.v1.raw.{name}");
                let sent = jetstream.publish_with_headers(subject, headers, payload.clone().into());
                match sent.await {
                    Ok(ack) => ack.await.is_ok(),
                    Err(_) => false,
                }
            });
            if sent {
                break;
            }
            assert!(Instant::now() < until, "the post takes nothing");
            thread::sleep(Duration::from_millis(100));
        }
        thread::sleep(pause);
    }
}

fn on_post_if_there(port: u16, work: impl AsyncFnOnce(jetstream::Context) -> bool) -> bool {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        match async_nats::connect(format!("127.0.0.1:{port}")).await {
            Ok(client) => work(jetstream::new(client)).await,
            Err(_) => false,
        }
    })
}

/// A recording of some messages.
fn recording(messages: &[mcap::Message<'_>]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut writer = mcap::Writer::new(&mut bytes).unwrap();
    for message in messages {
        writer.write(message).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

/// The campaign as small recordings, whose records go on from one into the next; the last is of a day behind it, so that no
/// record of the campaign stays open.
fn slices(site: &Site) -> Vec<Vec<u8>> {
    let mut files: Vec<_> = fs::read_dir(template().path("archive"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let all: Vec<_> = files.iter().flat_map(|file| messages(file)).collect();
    let after = site.simulate_as("after.mcap", &Part::new(56, 1).config(&plain()), 7);
    let slices = all.chunks(SLICE).map(recording);
    slices.chain([recording(&messages(&after)[..SLICE])]).collect()
}

/// Configuration of the campaign, whose records go on from one message into the next.
fn plain() -> String {
    fs::read_to_string(template().path("site.toml")).unwrap() + "[ingest]\njoin_s = 3600.0\n"
}

/// Replays into `thin.db`.
fn replay(site: &Site, path: &str) {
    let words = [
        "replay",
        "--config",
        "thin.toml",
        "--json",
        "--store",
        "thin.db",
        path,
    ];
    let done = site.run(&words);
    assert!(done.status.success() || done.status.code() == Some(3));
}

/// Records of some days as JSON lines, and as the recording that a replay reads.
fn days_as_lines(site: &Site, name: &str, part: &Part) -> Vec<Vec<u8>> {
    let config = part.config(&plain()).replace("\"protobuf\"", "\"json\"");
    let file = site.simulate_as(&format!("{name}.mcap"), &config, part.first_day);
    let line = |message: &mcap::Message<'_>| {
        let mut line: Value = serde_json::from_slice(&message.data).unwrap();
        line["topic"] = Value::from(message.channel.topic.as_str());
        line["time"] = Value::from(message.log_time);
        line.to_string() + "\n"
    };
    let lines: Vec<String> = messages(&file).iter().map(line).collect();
    lines
        .chunks(SLICE)
        .map(|some| some.concat().into_bytes())
        .collect()
}

fn kill_at_random(kills: u32) {
    let Some(mut thin) = Thin::of(&["todi", "gubbio"], 2) else {
        return;
    };
    thin.wire();
    thin.start();
    let port = thin.fleet.nats_port();
    let payloads = slices(&thin.fleet.edges[0].site);
    for edge in &thin.fleet.edges {
        replay(&edge.site, "archive");
    }
    let pause = Duration::from_millis(u64::from(kills) * 1000 / payloads.len() as u64);
    thread::scope(|scope| {
        for name in ["todi", "gubbio"] {
            let payloads = &payloads;
            scope.spawn(move || send(port, name, "campaign", payloads, pause));
        }
        let mut generator = random::stream(random::seed(&[b"worker kill"]), 0);
        let mut counts = BTreeMap::new();
        for kill in 0..kills {
            thread::sleep(Duration::from_millis(generator.random_range(200..1500)));
            thin.keep_workers();
            // In the gate each kind comes twice.
            let (kind, place) = (kill % 6, usize::from(generator.random::<bool>()));
            *counts.entry(kind).or_insert(0) += 1;
            match kind {
                0 => thin.kill_worker(place),
                1 => {
                    // Longer than the lease: the other one has its sites when it wakes.
                    thin.signal(place, "STOP");
                    thread::sleep(Duration::from_millis(1500 * LEASE_S));
                    thin.signal(place, "CONT");
                }
                2 => thin.fleet.kill_nats(),
                3 => thin.kill_daemons(place),
                4 => {
                    // A worker without a site connects to the database for a moment now and then: another network is cut then.
                    let until = Instant::now() + Duration::from_secs(30);
                    let used = loop {
                        thin.keep_workers();
                        let wires = thin.wires.iter().flatten();
                        let used: Vec<&Wire> = wires.filter(|wire| wire.is_used()).collect();
                        if !used.is_empty() || Instant::now() > until {
                            break used;
                        }
                        thread::sleep(Duration::from_millis(20));
                    };
                    assert!(!used.is_empty(), "no worker has a connection");
                    used[generator.random_range(0..used.len())].cut(&mut generator);
                }
                _ => thin.fleet.kill_postgres(),
            }
        }
        eprintln!(
            "{kills} kills (0 worker, 1 standstill, 2 post, 3 daemons, 4 network, 5 database): {counts:?}"
        );
    });
    thin.wires.iter().flatten().for_each(Wire::wait);
    let met: u32 = thin.wires.iter().flatten().map(Wire::met).sum();
    eprintln!("{met} cuts met by a connection");
    assert!(met > 0, "no network was cut");
    for place in 0..2 {
        thin.wait_until_equal(place, "thin.db");
    }
    for row in thin.rows() {
        assert_eq!(
            (&row["parked"], &row["stores"]),
            (&Value::from(0), &Value::from(1)),
            "{row}"
        );
    }
}

#[test]
fn whatever_is_killed_sites_without_a_computer_end_as_replayed() {
    kill_at_random(KILLS);
}

/// `KILLS=200 cargo test --test process hub::thin::a_campaign -- --ignored --nocapture`
#[test]
#[ignore = "minutes to hours"]
fn a_campaign_of_killed_workers() {
    kill_at_random(std::env::var("KILLS").map_or(100, |text| text.parse().unwrap()));
}

/// Publishes payloads in order as a sensor does that speaks MQTT.
fn send_by_mqtt(program: &Path, port: u16, name: &str, payloads: &[Vec<u8>]) {
    let (port, topic) = (port.to_string(), format!("tirante/v1/raw/{name}"));
    for payload in payloads {
        let mut sensor = Command::new(program)
            .args(["-h", "127.0.0.1", "-p", &port, "-q", "1", "-t", &topic, "-s"])
            .stdin(Stdio::piped())
            .spawn()
            .unwrap();
        sensor.stdin.take().unwrap().write_all(payload).unwrap();
        assert!(sensor.wait().unwrap().success());
    }
}

/// JSON lines; a message that is nothing; a command; a worker that gives its site back, and another that goes on, with a sensor that
/// speaks MQTT.
#[test]
fn a_site_goes_from_one_worker_to_another() {
    let (folder, mqtt) = (tempfile::tempdir().unwrap(), free_port());
    let more = format!("server_name: n0\nmqtt {{ listen: \"127.0.0.1:{mqtt}\" }}");
    let (Some(nats), Some(mosquitto)) = (
        Nats::start(folder.path(), &more),
        program("mosquitto_pub", "apt-get install mosquitto-clients", &[]),
    ) else {
        return;
    };
    let names = ["todi"];
    let Some(fleet) = Fleet::at(&names, vec![nats], Storage::Postgres) else {
        return;
    };
    let mut thin = Thin::in_fleet(fleet, &names, 1);
    thin.fleet.give_keys();
    thin.start();
    let port = thin.fleet.nats_port();
    let mut first = days_as_lines(&thin.fleet.edges[0].site, "first", &Part::new(0, 4));
    first.insert(2, b"nothing that a sensor says".to_vec());
    first.insert(5, b"\x89MCAP0\r\nand nothing that follows".to_vec());
    let then = days_as_lines(&thin.fleet.edges[0].site, "then", &Part::new(4, 3));
    replay(&thin.fleet.edges[0].site, "first.mcap");
    send(port, "todi", "first", &first, Duration::ZERO);
    // The beginning of the next day ends the record before it.
    send(port, "todi", "begun", &then[..1], Duration::ZERO);
    thin.wait_until_equal(0, "thin.db");
    let row = |thin: &Thin| thin.rows().remove(0);
    let before = row(&thin);
    assert_eq!(
        (&before["parked"], &before["is_idle"]),
        (&Value::from(2), &Value::from(false))
    );
    assert!(
        before["worker"].is_string() && before["worst"] == "parked",
        "{before}"
    );
    assert!(
        before["detail"]
            .as_str()
            .unwrap()
            .contains("line 1 cannot be read"),
        "{before}"
    );
    let number = command(&thin.fleet, &["rebaseline", "north"]);
    let dropped = thin.fleet.hub_command(&["parked", "todi", "--discard"]);
    assert_eq!(super::fleet::text_of(&dropped.stdout), "2 messages dropped\n");
    // It gives the site back, and nothing is monitored until another takes it.
    stop(thin.workers[0].take());
    let idle = row(&thin);
    assert_eq!(
        (&idle["worker"], &idle["is_idle"]),
        (&Value::Null, &Value::from(true))
    );
    assert_eq!(idle["worst"], "not-monitoring");
    thin.start_worker(0);
    send_by_mqtt(&mosquitto, mqtt, "todi", &then[1..]);
    wait_for(&thin.fleet, number, "carried-out");
    let until = Instant::now() + Duration::from_secs(60);
    while row(&thin)["latest_record"].as_str().unwrap_or_default() < "2026-01-06" {
        assert!(Instant::now() < until, "{}\n{}", row(&thin), thin.log());
        thread::sleep(Duration::from_millis(100));
    }
    let after = row(&thin);
    assert_eq!(
        (&after["parked"], &after["stores"]),
        (&Value::from(0), &Value::from(1)),
        "{after}"
    );
}

/// Over TLS, with the shipped rights of hub, worker and sensor; a sensor's login publishes samples of its own site alone.
#[test]
fn worker_and_sensor_need_no_more_than_their_rights() {
    let names = ["todi", "gubbio"];
    let Some(fleet) = Fleet::secure(&names, Storage::Postgres) else {
        return;
    };
    let mut thin = Thin::in_fleet(fleet, &names, 1);
    thin.start();
    let site = &thin.fleet.edges[0].site;
    let first = days_as_lines(site, "first", &Part::new(0, 2));
    let then = days_as_lines(site, "then", &Part::new(2, 1));
    replay(site, "first.mcap");
    let (seed, ca) = (thin.fleet.seed("todi-sensor"), thin.fleet.path("ca.pem"));
    let address = format!("tls://localhost:{}", thin.fleet.nats_port());
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let options = async_nats::ConnectOptions::with_nkey(seed)
            .require_tls(true)
            .add_root_certificates(ca)
            .custom_inbox_prefix("_INBOX_todi");
        let mut jetstream = jetstream::new(options.connect(address).await.unwrap());
        jetstream.set_timeout(Duration::from_millis(600));
        for payload in first.into_iter().chain(then.into_iter().take(1)) {
            let sent = jetstream.publish("tirante.v1.raw.todi", payload.into()).await;
            sent.unwrap().await.unwrap();
        }
        for forbidden in [
            "tirante.v1.raw.gubbio",
            "tirante.v1.out.todi",
            "tirante.v1.beat.todi",
        ] {
            let sent = jetstream.publish(forbidden, "{}".into()).await;
            assert!(sent.unwrap().await.is_err(), "{forbidden}");
        }
    });
    thin.wait_until_equal(0, "thin.db");
    // The worker's heartbeats are heard as well.
    thin.fleet.wait_until_beating();
}
