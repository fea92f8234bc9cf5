//! Some sites, a NATS server and a hub with its database, each killed and started again.

use super::servers::{DEADLINE, Nats, OWNER, Postgres};
use super::wire::Wire;
use crate::site::{Part, Site, campaign, copy};
use rand::{Rng, RngExt};
use std::fs::{self, File};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::thread;
use std::time::{Duration, Instant};
use tirante::config::HubConfig;
use tirante::service::forward::message::STREAM;
use tirante::service::hub;
use tirante::site::store::{ChangedRow, Reader};

/// Storage of the hub.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Storage {
    Sqlite,
    Postgres,
}

/// Ways from one process to another.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Network {
    Plain,
    /// TLS, and a login of each process's own.
    Secure,
    /// A [`Wire`] for each.
    Wired,
}

/// A site's daemon with its folder.
pub struct Edge {
    pub site: Site,
    name: String,
    child: Option<Child>,
}

/// All processes.
pub struct Fleet {
    pub edges: Vec<Edge>,
    hub: Option<Child>,
    postgres: Option<Postgres>,
    /// The servers of one post.
    nats: Vec<Nats>,
    /// The networks between them, if they can be cut.
    wires: Vec<Wire>,
    folder: tempfile::TempDir,
}

/// The campaign, simulated once.
pub fn template() -> &'static Site {
    static TEMPLATE: OnceLock<Site> = OnceLock::new();
    TEMPLATE.get_or_init(campaign)
}

pub fn process(command: &mut Command, log: &Path) -> Child {
    let log = File::options().create(true).append(true).open(log).unwrap();
    command
        .env("TIRANTE_LOG", "info")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(log)
        .spawn()
        .unwrap()
}

pub fn end(child: Option<Child>) {
    if let Some(mut child) = child {
        let _ = child.kill();
        let _ = child.wait();
    }
}

pub fn stop(child: Option<Child>) {
    let mut child = child.unwrap();
    let pid = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-TERM", &pid])
            .status()
            .unwrap()
            .success()
    );
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(0));
}

pub fn text_of(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Draws a key into a file of the program's own; returns its public part.
fn key(folder: &Path, name: &str) -> String {
    drawn(&folder.join(format!("{name}.nk")), &[])
}

fn drawn(file: &Path, more: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_tirante"))
        .args(["hub", "key"])
        .args(more)
        .arg(file)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", text_of(&output.stderr));
    text_of(&output.stdout).trim().to_owned()
}

/// The users of the shipped rights, with keys of their own.
fn users(folder: &Path, names: &[&str]) -> String {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/fleet/rights.conf");
    let shipped = fs::read_to_string(shipped).unwrap();
    let of = |user: &str| {
        let (_, text) = shipped.split_once(&format!("\n# {user}:")).unwrap();
        let text = text.split("\n\n").next().unwrap();
        text[text.find("{ nkey").unwrap()..].trim().to_owned()
    };
    let mut users = vec![
        of("hub").replace("KEY", &key(folder, "HUB")),
        of("worker").replace("KEY", &key(folder, "WORK")),
    ];
    for name in names {
        for (user, login) in [("site", (*name).to_owned()), ("sensor", format!("{name}-sensor"))] {
            let user = of(user).replace("SITE", name);
            users.push(user.replace("KEY", &key(folder, &login)));
        }
    }
    format!("authorization {{ users: [\n{}\n] }}\n", users.join("\n"))
}

/// An authority of its own, whose certificate becomes a file.
pub fn authority(file: &Path) -> rcgen::CertifiedIssuer<'static, rcgen::KeyPair> {
    let mut params = rcgen::CertificateParams::new(Vec::<String>::new()).unwrap();
    params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let issuer = rcgen::CertifiedIssuer::self_signed(params, rcgen::KeyPair::generate().unwrap()).unwrap();
    fs::write(file, issuer.pem()).unwrap();
    issuer
}

/// Certificates of an authority and of a server called localhost.
fn certificates(folder: &Path) -> String {
    let issuer = authority(&folder.join("ca.pem"));
    let server_key = rcgen::KeyPair::generate().unwrap();
    let server = rcgen::CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
    let server = server.signed_by(&server_key, &issuer).unwrap();
    fs::write(folder.join("server.pem"), server.pem()).unwrap();
    fs::write(folder.join("server.key"), server_key.serialize_pem()).unwrap();
    let of = |name: &str| folder.join(name).display().to_string();
    format!(
        "tls {{ cert_file: \"{}\", key_file: \"{}\" }}\n",
        of("server.pem"),
        of("server.key")
    )
}

impl Fleet {
    /// Servers and folders for some sites; `None` if a server is not installed.
    pub fn of(names: &[&str], storage: Storage) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let nats = Nats::start(folder.path(), "")?;
        Self::in_folder(names, vec![nats], storage, folder, Network::Plain)
    }

    /// The same with a network of each process's own, which can be cut.
    pub fn wired(names: &[&str], storage: Storage) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let nats = Nats::start(folder.path(), "")?;
        Self::in_folder(names, vec![nats], storage, folder, Network::Wired)
    }

    /// The same with three servers of one cluster.
    pub fn clustered(names: &[&str], storage: Storage) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let nats = Nats::cluster(folder.path())?;
        Self::in_folder(names, nats, storage, folder, Network::Plain)
    }

    /// The same with TLS and a login of each site's own.
    pub fn secure(names: &[&str], storage: Storage) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let more = users(folder.path(), names) + &certificates(folder.path());
        let nats = Nats::start(folder.path(), &more)?;
        Self::in_folder(names, vec![nats], storage, folder, Network::Secure)
    }

    /// Folders for some sites of servers that run elsewhere.
    pub fn at(names: &[&str], nats: Vec<Nats>, storage: Storage) -> Option<Self> {
        Self::in_folder(names, nats, storage, tempfile::tempdir().unwrap(), Network::Plain)
    }

    fn in_folder(
        names: &[&str],
        nats: Vec<Nats>,
        storage: Storage,
        folder: tempfile::TempDir,
        network: Network,
    ) -> Option<Self> {
        let mut wires = Vec::new();
        let mut way = |port: u16| match network {
            Network::Wired => {
                wires.push(Wire::to(port));
                wires[wires.len() - 1].port
            }
            Network::Plain | Network::Secure => port,
        };
        let mut to = |user: &str| {
            if network == Network::Secure {
                let of = |name: &str| folder.path().join(name).display().to_string();
                format!(
                    "to = \"nats+tls://localhost:{}\"\ncredentials = \"{}\"\nca = \"{}\"\n",
                    nats[0].port,
                    of(&format!("{user}.nk")),
                    of("ca.pem")
                )
            } else {
                let servers = nats
                    .iter()
                    .map(|one| format!("nats://127.0.0.1:{}", way(one.port)));
                format!("to = \"{}\"\n", servers.collect::<Vec<_>>().join(", "))
            }
        };
        let postgres = match (storage, network) {
            (Storage::Postgres, Network::Secure) => {
                Some(Postgres::guarded(folder.path(), "server.pem", "server.key")?)
            }
            (Storage::Postgres, _) => Some(Postgres::start(folder.path())?),
            (Storage::Sqlite, _) => None,
        };
        let to_hub = to("HUB");
        let edges = names.iter().map(|name| edge(name, &to(name))).collect();
        let place = match &postgres {
            None => format!(
                "[sqlite]\npath = \"{}\"\n",
                folder.path().join("centre.db").display()
            ),
            Some(server) if network == Network::Secure => {
                let (owner, password) = OWNER;
                let file = folder.path().join("password");
                fs::write(&file, format!("{password}\n")).unwrap();
                fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
                format!(
                    "[postgres]\nconnection = \"host=localhost port={} user={owner} dbname=tirante\"\npassword_file = \"{}\"\nca = \"{}\"\n",
                    server.port,
                    file.display(),
                    folder.path().join("ca.pem").display()
                )
            }
            Some(server) => format!(
                "[postgres]\nconnection = \"host=127.0.0.1 port={} user=tirante dbname=tirante\"\n",
                way(server.port)
            ),
        };
        let monitors = nats.iter().map(|one| format!("http://127.0.0.1:{}", one.monitor));
        let monitors = monitors.collect::<Vec<_>>().join(", ");
        let mut text =
            format!("[nats]\n{to_hub}monitor = \"{monitors}\"\n{place}[http]\nlisten = \"127.0.0.1:0\"\n");
        for name in names {
            text += &format!("[[site]]\nname = \"{name}\"\n");
        }
        fs::write(folder.path().join("hub.toml"), text).unwrap();
        Some(Self {
            edges,
            hub: None,
            postgres,
            nats,
            wires,
            folder,
        })
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn nats_port(&self) -> u16 {
        self.nats[0].port
    }

    /// Port of the PostgreSQL server.
    pub fn database_port(&self) -> u16 {
        self.postgres.as_ref().unwrap().port
    }

    /// True if the database is a server, which can be killed.
    pub fn has_server(&self) -> bool {
        self.postgres.is_some()
    }

    /// Number of rows of a query of the PostgreSQL server.
    pub fn rows(&self, sql: &str) -> usize {
        let port = self.database_port();
        let connection = format!("host=127.0.0.1 port={port} user=tirante dbname=tirante");
        let mut client = postgres::Client::connect(&connection, postgres::NoTls).unwrap();
        client.query(sql, &[]).unwrap().len()
    }

    pub fn signal_nats(&self, name: &str) {
        self.nats[0].signal(name);
    }

    /// Seed of a site's login.
    pub fn seed(&self, name: &str) -> String {
        let seed = fs::read_to_string(self.path(&format!("{name}.nk"))).unwrap();
        seed.trim().to_owned()
    }

    /// Takes a site's login from the server's list.
    pub fn revoke(&self, name: &str) {
        let key = nkeys::KeyPair::from_seed(&self.seed(name)).unwrap().public_key();
        let other = nkeys::KeyPair::new_user().public_key();
        self.nats[0].reconfigure(|text| {
            assert!(text.contains(&key));
            text.replace(&key, &other)
        });
    }

    /// Gives hub and sites the rights of a program that knew no pauses.
    pub fn take_pauses(&self) {
        self.nats[0].reconfigure(|text| {
            assert!(text.contains("tirante.v1.pause"));
            let text = text.replace(", \"tirante.v1.pause\"", "");
            text.replace(",\n    \"tirante.v1.pause\"", "")
        });
    }

    /// Two more records of a site.
    pub fn more_records(&self, place: usize) {
        self.edges[place].site.simulate("more", &Part::new(60, 2));
    }

    /// Processor time of a site's process so far \[s\], and its largest memory \[MB\].
    pub fn usage(&self, place: usize) -> (f64, f64) {
        usage(self.edges[place].child.as_ref().unwrap())
    }

    /// The same of the hub.
    pub fn hub_usage(&self) -> (f64, f64) {
        usage(self.hub.as_ref().unwrap())
    }

    /// Puts further sites on the hub's list.
    pub fn list_more(&self, names: &[String]) {
        let mut text = fs::read_to_string(self.config()).unwrap();
        for name in names {
            text += &format!("[[site]]\nname = \"{name}\"\n");
        }
        fs::write(self.config(), text).unwrap();
    }

    /// Number of records at the centre, and of rows in all tables of results.
    pub fn counted(&self) -> (usize, usize) {
        let config = HubConfig::load(&self.config()).unwrap();
        let mut centre = hub::beside(&config.storage).unwrap();
        let mut counts = (0, 0);
        for copied in centre.copied().to_vec() {
            let table = copied.shape.table;
            let found = centre
                .sql()
                .query(&format!("SELECT count(*) FROM \"{table}\""), &[])
                .unwrap();
            let count = usize::try_from(hub::sql::integer(found[0].first())).unwrap();
            counts.1 += count;
            if table == "record" {
                counts.0 = count;
            }
        }
        counts
    }

    /// Simulates a day's records, and returns for each commit the time from the site's store to the centre \[s\].
    pub fn delay_of_a_day(&mut self, place: usize, day: i64) -> Vec<f64> {
        let config = HubConfig::load(&self.config()).unwrap();
        let mut centre = hub::beside(&config.storage).unwrap();
        let edge = &self.edges[place];
        let reader = Reader::open(&edge.site.path("site.db")).unwrap();
        let before = reader.latest_change().unwrap();
        edge.site.simulate(&format!("day-{day}"), &Part::new(day, 1));
        let (mut committed, mut delays) = (Vec::new(), Vec::new());
        let until = Instant::now() + DEADLINE;
        // Two rods: a record of each, and what may follow them within a second.
        while delays.len() < committed.len() || committed.len() < 2 {
            assert!(Instant::now() < until, "no commit\n{}", self.log());
            let now = Instant::now();
            let own = usize::try_from(reader.latest_change().unwrap() - before).unwrap();
            committed.resize(own, now);
            let through = centre.sites().unwrap()[&edge.name]
                .histories
                .last()
                .unwrap()
                .through;
            let arrived = usize::try_from(through - before).unwrap();
            let now = Instant::now();
            for commit in committed.iter().take(arrived).skip(delays.len()) {
                delays.push(now.duration_since(*commit).as_secs_f64());
            }
            thread::sleep(Duration::from_millis(2));
        }
        delays
    }

    /// Present length of a site's log.
    pub fn logged(&self, place: usize) -> usize {
        fs::read(self.edges[place].site.path("daemon.log")).map_or(0, |log| log.len())
    }

    /// Waits for a word in a site's log after a place.
    pub fn wait_for_log(&mut self, place: usize, after: usize, word: &str) {
        let log = self.edges[place].site.path("daemon.log");
        let is_there = |log: Vec<u8>| log.get(after..).is_some_and(|log| text_of(log).contains(word));
        self.wait(word, |_| fs::read(&log).is_ok_and(is_there));
    }

    /// Changes the hub's configuration.
    pub fn reconfigure_hub(&self, change: impl Fn(String) -> String) {
        let text = fs::read_to_string(self.config()).unwrap();
        fs::write(self.config(), change(text)).unwrap();
    }

    /// Waits until the centre has heard a heartbeat of every site.
    pub fn wait_until_beating(&mut self) {
        let config = HubConfig::load(&self.config()).unwrap();
        self.wait("every site beats", |fleet| {
            let beats = hub::beside(&config.storage).and_then(|mut centre| centre.beats());
            beats.is_ok_and(|beats| fleet.edges.iter().all(|edge| beats.contains_key(&edge.name)))
        });
    }

    /// Draws a key of commands for each site, into `NAME.ck`, and names it to both ends.
    pub fn give_keys(&self) {
        for edge in &self.edges {
            let name = &edge.name;
            let file = self.path(&format!("{name}.ck"));
            let key = drawn(&file, &["--commands"]);
            let path = edge.site.path("site.toml");
            let text = fs::read_to_string(&path).unwrap();
            let own = format!("[forward]\ncommand_key = \"{key}\"\n");
            fs::write(path, text.replace("[forward]\n", &own)).unwrap();
            let listed = format!("[[site]]\nname = \"{name}\"\n");
            let with_key = format!("{listed}command_key = \"{}\"\n", file.display());
            self.reconfigure_hub(|text| text.replace(&listed, &with_key));
        }
    }

    /// Number of messages in a stream, by the server's monitoring.
    pub fn messages_of(&self, stream: &str) -> u64 {
        self.stream(stream)["state"]["messages"].as_u64().unwrap()
    }

    /// A stream, by the monitoring of the first server.
    fn stream(&self, name: &str) -> serde_json::Value {
        let address = format!("http://127.0.0.1:{}/jsz?streams=true", self.nats[0].monitor);
        let text = ureq::get(&address).call().unwrap().body_mut().read_to_string();
        let body: serde_json::Value = serde_json::from_str(&text.unwrap()).unwrap();
        let streams = body["account_details"][0]["stream_detail"].as_array().unwrap();
        streams.iter().find(|one| one["name"] == name).unwrap().clone()
    }

    /// Present length of the hub's log.
    pub fn hub_logged(&self) -> usize {
        fs::read(self.path("hub.log")).map_or(0, |log| log.len())
    }

    /// The hub's log after a place.
    pub fn hub_log_after(&self, after: usize) -> String {
        let log = fs::read(self.path("hub.log")).unwrap_or_default();
        text_of(log.get(after..).unwrap_or_default())
    }

    /// Waits for a word in the hub's log after a place.
    pub fn wait_for_hub_log(&mut self, after: usize, word: &str) {
        self.wait(word, |fleet| fleet.hub_log_after(after).contains(word));
    }

    /// Waits until the hub has everything, and has read nothing more of the stream for a while.
    pub fn wait_until_still(&mut self) {
        self.wait_until_sent();
        let config = HubConfig::load(&self.config()).unwrap();
        let mut before = (0, Instant::now());
        self.wait("the stream stands still", |_| {
            let centre = hub::beside(&config.storage);
            let now = centre.and_then(|mut centre| centre.position()).unwrap().sequence;
            if now != before.0 {
                before = (now, Instant::now());
            }
            before.1.elapsed() > Duration::from_secs(1)
        });
    }

    /// Id of a site's store and number of its last commit.
    pub fn end_of(&self, place: usize) -> (String, i64) {
        let reader = Reader::open(&self.edges[place].site.path("site.db")).unwrap();
        (reader.epoch().unwrap().unwrap(), reader.latest_change().unwrap())
    }

    /// Latest of the first hundred changes of a site's records, as it is sent.
    pub fn latest_record(&self, place: usize) -> ChangedRow {
        let reader = Reader::open(&self.edges[place].site.path("site.db")).unwrap();
        let changes = reader.changes_after(0, 100).unwrap();
        let mut rows = changes.into_iter().flat_map(|change| change.rows);
        rows.rfind(|row| row.table == "record").unwrap()
    }

    /// Sends a signal to every process of the database.
    pub fn freeze_postgres(&self, signal: &str) {
        self.postgres.as_ref().unwrap().signal(signal);
    }

    /// Waits until a site is marked with a fault.
    pub fn wait_until_marked(&mut self, name: &str, fault: &str) {
        let config = HubConfig::load(&self.config()).unwrap();
        self.wait(fault, |_| {
            let sites = hub::beside(&config.storage).and_then(|mut centre| centre.sites());
            let site = sites.ok().and_then(|mut sites| sites.remove(name));
            site.and_then(|site| site.fault)
                .is_some_and(|(found, _)| found == fault)
        });
    }

    pub fn start(&mut self) {
        self.start_hub();
        for place in 0..self.edges.len() {
            self.start_edge(place);
        }
    }

    pub fn config(&self) -> PathBuf {
        self.folder.path().join("hub.toml")
    }

    pub fn start_hub(&mut self) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tirante"));
        command.current_dir(self.folder.path());
        command.arg("hub").arg("--config").arg(self.config());
        self.hub = Some(process(&mut command, &self.folder.path().join("hub.log")));
    }

    pub fn stop_hub(&mut self) {
        self.keep_hub();
        stop(self.hub.take());
    }

    pub fn kill_hub(&mut self) {
        end(self.hub.take());
        self.start_hub();
    }

    /// Starts a hub that ended again, as its unit does: at its start it may find a server dead.
    pub fn keep_hub(&mut self) {
        let ended = self
            .hub
            .as_mut()
            .is_none_or(|hub| hub.try_wait().unwrap().is_some());
        if ended {
            self.start_hub();
        }
    }

    pub fn start_edge(&mut self, place: usize) {
        let edge = &mut self.edges[place];
        let log = edge.site.path("daemon.log");
        edge.child = Some(process(
            &mut edge.site.command(&["run", "--config", "site.toml"]),
            &log,
        ));
    }

    pub fn stop_edge(&mut self, place: usize) {
        stop(self.edges[place].child.take());
    }

    pub fn kill_edge(&mut self, place: usize) {
        end(self.edges[place].child.take());
        self.start_edge(place);
    }

    /// Kills a site's daemon, which begins anew with another store.
    pub fn renew_edge(&mut self, place: usize) {
        end(self.edges[place].child.take());
        self.remove_store(place);
        self.start_edge(place);
    }

    /// Ends the server of a cluster that leads the stream of results; returns its place.
    pub fn end_leader(&mut self) -> usize {
        let mut place = None;
        // A server that has just begun again does not know it yet.
        self.wait("the stream has a leader", |fleet| {
            let leader = fleet.stream(STREAM)["cluster"]["leader"]
                .as_str()
                .map(str::to_owned);
            place = leader.and_then(|name| name.trim_start_matches('n').parse().ok());
            place.is_some()
        });
        let place: usize = place.unwrap();
        self.nats[place].kill();
        place
    }

    /// Starts a server again, and waits until it has what it missed.
    pub fn server_again(&mut self, place: usize) {
        self.nats[place].again();
        self.nats[place].wait_until_healthy();
    }

    /// Ends some of the servers when `lose` says so, which is given what signals and what ends them, and begins them again.
    pub fn lose_power(&mut self, servers: &[usize], lose: impl FnOnce(&dyn Fn(), &mut dyn FnMut())) {
        let nats = std::cell::RefCell::new(&mut self.nats);
        let kill = || {
            servers
                .iter()
                .for_each(|&place| nats.borrow()[place].signal("-KILL"))
        };
        let mut end = || servers.iter().for_each(|&place| nats.borrow_mut()[place].kill());
        lose(&kill, &mut end);
        for &place in servers {
            self.nats[place].again();
        }
    }

    pub fn kill_nats(&mut self) {
        self.kill_nats_for(|text| text);
    }

    /// Ends the post, and begins it with another configuration.
    pub fn kill_nats_for(&mut self, change: impl FnOnce(String) -> String) {
        self.nats[0].kill();
        self.nats[0].rewrite(change);
        self.nats[0].again();
    }

    pub fn kill_postgres(&mut self) {
        if let Some(postgres) = &mut self.postgres {
            postgres.kill();
            postgres.again();
        }
    }

    /// Cuts one of the networks, once it is in use, in a random way for a random time.
    pub fn cut(&mut self, generator: &mut impl Rng) {
        let place = generator.random_range(0..self.wires.len());
        self.wait("the network is in use", |fleet| fleet.wires[place].is_used());
        self.wires[place].cut(generator);
    }

    /// Number of cuts that a connection met.
    pub fn cuts_met(&self) -> u32 {
        self.wires.iter().map(Wire::met).sum()
    }

    /// Waits until every network is whole.
    pub fn wait_until_whole(&self) {
        self.wires.iter().for_each(Wire::wait);
    }

    pub fn remove_store(&self, place: usize) {
        for suffix in ["", "-wal", "-shm", ".lock", ".working", ".suspects"] {
            let _ = fs::remove_file(self.edges[place].site.path(&format!("site.db{suffix}")));
        }
    }

    /// Takes the last four of a site's seven files away.
    pub fn hide_later_weeks(&self, place: usize) {
        fs::create_dir(self.edges[place].site.path("later")).unwrap();
        self.move_later_weeks(place, "archive", "later");
    }

    /// Puts them back.
    pub fn show_later_weeks(&self, place: usize) {
        self.move_later_weeks(place, "later", "archive");
    }

    fn move_later_weeks(&self, place: usize, from: &str, to: &str) {
        let site = &self.edges[place].site;
        for index in 3..7 {
            let name = format!("week-{index}.mcap");
            fs::rename(site.path(from).join(&name), site.path(to).join(&name)).unwrap();
        }
    }

    /// A copy of the servers' files, taken while they stand still.
    pub fn copy_stream(&mut self) -> PathBuf {
        let copy = self.folder.path().join("copy");
        self.nats.iter_mut().for_each(Nats::kill);
        for (place, server) in self.nats.iter().enumerate() {
            files(&server.files(), &copy.join(place.to_string()));
        }
        self.nats.iter_mut().for_each(Nats::again);
        copy
    }

    /// Takes all streams from the post and the file from the centre.
    pub fn forget_stream_and_centre(&mut self) {
        self.nats[0].kill();
        fs::remove_dir_all(self.folder.path().join("jetstream")).unwrap();
        self.nats[0].again();
        for suffix in ["", "-wal", "-shm"] {
            let _ = fs::remove_file(self.folder.path().join(format!("centre.db{suffix}")));
        }
    }

    /// Puts the copy in the place of some servers' files, as if all they wrote since had been lost with the power.
    pub fn set_stream_back(&mut self, copy: &Path, servers: &[usize]) {
        for &place in servers {
            self.nats[place].kill();
            fs::remove_dir_all(self.nats[place].files()).unwrap();
            files(&copy.join(place.to_string()), &self.nats[place].files());
        }
        for &place in servers {
            self.nats[place].again();
        }
    }

    /// Waits until every server has a leader for all it keeps.
    pub fn wait_until_healthy(&self) {
        self.nats.iter().for_each(Nats::wait_until_healthy);
    }

    pub fn hub_command(&self, words: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_tirante"))
            .current_dir(self.folder.path())
            .arg("hub")
            .args(words)
            .arg("--config")
            .arg(self.config())
            .stdin(Stdio::null())
            .output()
            .unwrap()
    }

    pub fn compare(&self, place: usize, store: &str, more: &[&str]) -> Output {
        let edge = &self.edges[place];
        let store = edge.site.path(store);
        let words = ["compare", edge.name.as_str(), "--store", store.to_str().unwrap()];
        self.hub_command(&[&words[..], more].concat())
    }

    /// The centre's rows of a site are those of its replay.
    pub fn assert_equal(&self, place: usize, more: &[&str]) {
        let compared = self.compare(place, "replayed.db", more);
        assert_eq!(
            compared.status.code(),
            Some(0),
            "{}{}",
            String::from_utf8_lossy(&compared.stdout),
            String::from_utf8_lossy(&compared.stderr)
        );
    }

    pub fn log(&self) -> String {
        let mut logs = fs::read_to_string(self.folder.path().join("hub.log")).unwrap_or_default();
        for edge in &self.edges {
            logs += &fs::read_to_string(edge.site.path("daemon.log")).unwrap_or_default();
        }
        let lines: Vec<&str> = logs.lines().rev().take(60).collect();
        lines.into_iter().rev().collect::<Vec<_>>().join("\n")
    }

    pub fn wait(&mut self, what: &str, mut is_so: impl FnMut(&mut Self) -> bool) {
        let until = Instant::now() + DEADLINE;
        while !is_so(self) {
            assert!(Instant::now() < until, "not so: {what}\n{}", self.log());
            self.keep_hub();
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until a site has read some files.
    pub fn wait_until_read(&mut self, place: usize, count: usize) {
        let store = self.edges[place].site.path("site.db");
        self.wait("all files are read", |_| {
            Reader::open(&store).is_ok_and(|reader| {
                let is_read = reader.files().is_ok_and(|files| files.len() == count);
                is_read && reader.carries("folder/").is_ok_and(|open| open.is_empty())
            })
        });
    }

    /// Waits until the centre has every commit of every site.
    pub fn wait_until_sent(&mut self) {
        for place in 0..self.edges.len() {
            self.wait_until_sent_of(place);
        }
    }

    /// Waits until the centre has every commit of a site.
    pub fn wait_until_sent_of(&mut self, place: usize) {
        let config = HubConfig::load(&self.config()).unwrap();
        self.wait("the centre has all commits", |fleet| {
            let Ok(sites) = hub::beside(&config.storage).and_then(|mut centre| centre.sites()) else {
                return false;
            };
            let edge = &fleet.edges[place];
            let Ok(reader) = Reader::open(&edge.site.path("site.db")) else {
                return false;
            };
            let own = (reader.epoch().unwrap(), reader.latest_change().unwrap());
            let last = sites.get(&edge.name).and_then(|state| state.histories.last());
            last.is_some_and(|last| own == (Some(last.epoch.clone()), last.through))
        });
    }

    /// Waits until all sites have read all files, and the centre has everything.
    pub fn wait_until_complete(&mut self) {
        for place in 0..self.edges.len() {
            self.wait_until_read(place, 7);
        }
        self.wait_until_sent();
    }

    /// Waits until the centre has everything, and compares it with the replays.
    pub fn wait_until_equal(&mut self) {
        self.wait_until_complete();
        for place in 0..self.edges.len() {
            self.assert_equal(place, &[]);
        }
    }

    /// Rebuilds the centre until it equals a site's replay; the hub is stopped.
    pub fn wait_until_rebuilt(&mut self, place: usize) {
        let until = Instant::now() + DEADLINE;
        loop {
            let rebuilt = self.hub_command(&["rebuild"]);
            if rebuilt.status.success() && self.compare(place, "replayed.db", &[]).status.success() {
                return;
            }
            assert!(
                Instant::now() < until,
                "the stream lacks something: {}\n{}",
                text_of(&rebuilt.stderr),
                self.log()
            );
            thread::sleep(Duration::from_millis(200));
        }
    }

    /// Answer of the hub's page.
    pub fn get(&self, path: &str) -> String {
        get(&self.address(), path)
    }

    /// Address and port of the hub's page.
    pub fn address(&self) -> String {
        let log = fs::read_to_string(self.folder.path().join("hub.log")).unwrap();
        let address = log.rsplit("all sites at http://").next().unwrap();
        address.split_whitespace().next().unwrap().to_owned()
    }
}

/// Processor time of a process so far \[s\], and its largest memory \[MB\].
fn usage(process: &Child) -> (f64, f64) {
    let pid = process.id();
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    let ticks = [11, 12].map(|place| fields[place].parse::<f64>().unwrap());
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let peak = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .unwrap();
    let peak_kb: f64 = peak.trim().trim_end_matches(" kB").parse().unwrap();
    // Linux counts in hundredths of a second.
    (ticks.iter().sum::<f64>() / 100.0, peak_kb / 1e3)
}

/// Answer of a server, head and body.
pub fn get(address: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(DEADLINE)).unwrap();
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n"
    )
    .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

impl Drop for Fleet {
    fn drop(&mut self) {
        for edge in &mut self.edges {
            end(edge.child.take());
        }
        end(self.hub.take());
    }
}

/// A copy of the campaign with a daemon's configuration.
fn edge(name: &str, to: &str) -> Edge {
    let from = template();
    let config = fs::read_to_string(from.path("site.toml")).unwrap();
    let site = Site::new(
        &(config
            + &format!(
                "\n[store]\npath = \"site.db\"\n[ingest]\nfolder = \"archive\"\n[http]\nlisten = \"off\"\n\
                 [forward]\n{to}site = \"{name}\"\nheartbeat_s = 1.0\n"
            )),
    );
    files(&from.path("archive"), &site.path("archive"));
    // The configuration is part of the results, and so is the place of the store: it is replayed with this one.
    let (output, code) = site.replay(&["archive"], "replayed.db");
    assert_eq!(code, 3, "{}", String::from_utf8_lossy(&output.stderr));
    Edge {
        site,
        name: name.to_owned(),
        child: None,
    }
}

/// Copies a folder.
fn files(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().flatten() {
        let place = to.join(entry.file_name());
        if entry.path().is_dir() {
            files(&entry.path(), &place);
        } else {
            copy(&entry.path(), &place);
        }
    }
}
