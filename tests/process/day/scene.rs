//! A site's folder with its daemon, and all that is done to them.

use super::material::{Material, site};
use crate::load::server::{Mood, Server};
use crate::load::usage::{Usage, answer, metric, metrics};
use crate::survival::campaign::RODS;
use crate::survival::feed::Feed;
use crate::survival::process::{DEADLINE, Process};
use rand::rngs::ChaCha8Rng;
use rand::{Rng, RngExt};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Room for everything that the daemon keeps \[MB\].
const DISK_MB: usize = 768;
/// A client that says nothing is gone by then.
const FIRST_WORDS: Duration = Duration::from_secs(10);
/// Pause between looks at what is awaited.
const LOOK: Duration = Duration::from_millis(20);

/// What may happen to a daemon, besides what its data bring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Trouble {
    Kill,
    Terminate,
    /// SIGHUP with other settings, and with bad ones.
    Reload,
    BadReload,
    FullDisk,
    ReadOnlyDisk,
    StoreAway,
    JournalAway,
    FolderAway,
    /// A sink changes its mood.
    Sink,
    /// A file comes again under another name; one that is cut short.
    Copy,
    Stump,
    /// A file of no use.
    Junk,
    Garbage,
    HalfOpen,
    /// Clients are cut off within a frame.
    Cut,
}

impl Trouble {
    pub const ALL: [Self; 16] = [
        Self::Kill,
        Self::Terminate,
        Self::Reload,
        Self::BadReload,
        Self::FullDisk,
        Self::ReadOnlyDisk,
        Self::StoreAway,
        Self::JournalAway,
        Self::FolderAway,
        Self::Sink,
        Self::Copy,
        Self::Stump,
        Self::Junk,
        Self::Garbage,
        Self::HalfOpen,
        Self::Cut,
    ];

    pub fn ends_the_daemon(self) -> bool {
        matches!(self, Self::Kill | Self::Terminate)
    }
}

/// A file system of its own, gone when it is dropped.
struct Disk(PathBuf);

impl Disk {
    fn mount(path: PathBuf) -> Option<Self> {
        let size = format!("size={DISK_MB}m");
        mount(&["-t", "tmpfs", "-o", &size, "tmpfs"], &path).then(|| Self(path))
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        lift(&self.0);
    }
}

/// Takes the uppermost mount away.
fn lift(from: &Path) {
    let _ = Command::new("umount").arg("-l").arg(from).output();
}

fn mount(words: &[&str], at: &Path) -> bool {
    let done = Command::new("mount").args(words).arg(at).output();
    done.is_ok_and(|done| done.status.success())
}

/// What a daemon counted, showed and logged, over all its lives.
#[derive(Default)]
pub struct Seen {
    pub counted: BTreeMap<String, f64>,
    pub shown: BTreeSet<String>,
    pub logged: BTreeSet<String>,
}

/// Memory and descriptors at an hour of data, in one life of the daemon.
pub struct Sample {
    pub hour: f64,
    pub life: usize,
    pub usage: Usage,
}

/// A client that says nothing.
struct Silent {
    stream: UnixStream,
    since: Instant,
    life: usize,
    idle: f64,
}

pub struct Scene {
    pub material: Arc<Material>,
    pub sinks: [Server; 2],
    // Dropped in this order: senders and daemon are gone before their disk, and the disk before the folder.
    pub feed: Feed,
    daemon: Option<Process>,
    _disk: Disk,
    pub folder: TempDir,
    pub seen: Seen,
    pub samples: Vec<Sample>,
    pub done: BTreeMap<Trouble, usize>,
    begun: Instant,
    life: usize,
    /// Rejected records in the store when this life began.
    rejected: f64,
    config: String,
    silent: Vec<Silent>,
    made: usize,
    /// Copies that are cut short.
    pub stumps: Vec<String>,
    rng: ChaCha8Rng,
}

impl Scene {
    /// `None` where no file system may be mounted.
    pub fn new(material: Material, rng: ChaCha8Rng) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        for name in ["archive", "state"] {
            fs::create_dir(folder.path().join(name)).unwrap();
        }
        let disk = Disk::mount(folder.path().join("state"))?;
        let sinks = [Mood::Well; 2].map(Server::new);
        let mut config = site(&RODS)
            + &format!(
                "[store]\npath = \"state/site.db\"\n[http]\nlisten = \"127.0.0.1:0\"\n[alert]\nsettle_s = 0.5\n[journal]\npart_mb = 8\n\
                 [ingest]\nfolder = \"archive\"\nlisten = [\"unix://{}\"]\nsettle_s = 3600\n",
                folder.path().join("state/in.sock").display()
            );
        for (number, sink) in sinks.iter().enumerate() {
            write!(
                config,
                "[[sink]]\nid = \"s{number}\"\nkind = \"webhook\"\nurl = \"http://{}/\"\n",
                sink.address
            )
            .unwrap();
        }
        fs::write(folder.path().join("site.toml"), &config).unwrap();
        let material = Arc::new(material);
        let feed = Feed::start(Arc::clone(&material.data), folder.path());
        Some(Self {
            material,
            sinks,
            feed,
            daemon: None,
            _disk: disk,
            folder,
            seen: Seen::default(),
            samples: Vec::new(),
            done: BTreeMap::new(),
            begun: Instant::now(),
            life: 0,
            rejected: 0.0,
            config,
            silent: Vec::new(),
            made: 0,
            stumps: Vec::new(),
            rng,
        })
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn config(&self) -> &str {
        &self.config
    }

    pub fn daemon(&mut self) -> &mut Process {
        self.daemon.as_mut().unwrap()
    }

    pub fn log(&self) -> String {
        self.daemon.as_ref().map_or_else(String::new, Process::log)
    }

    pub fn start(&mut self) {
        self.rejected = self.rejections();
        self.daemon = Some(Process::start(self.folder.path(), &[]));
        self.begun = Instant::now();
        self.life += 1;
        self.daemon()
            .wait_until("it is ready", |log| log.contains("ready"));
    }

    /// The daemon's store, opened beside it; `None` while there is none.
    pub fn store(&self) -> Option<rusqlite::Connection> {
        let flags = rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY;
        let store = rusqlite::Connection::open_with_flags(self.path("state/site.db"), flags).ok()?;
        store.busy_timeout(Duration::from_secs(20)).ok()?;
        Some(store)
    }

    pub fn records(&self) -> usize {
        let count = |store: rusqlite::Connection| {
            store
                .query_row("SELECT count(*) FROM record", (), |row| row.get::<_, i64>(0))
                .ok()
        };
        self.store().and_then(count).unwrap_or(0) as usize
    }

    fn rejections(&self) -> f64 {
        let sql = "SELECT count(*) FROM record WHERE rejection IS NOT NULL";
        let count = |store: rusqlite::Connection| store.query_row(sql, (), |row| row.get::<_, i64>(0)).ok();
        self.store().and_then(count).unwrap_or(0) as f64
    }

    /// Waits until the daemon has most of what was offered, and looks at it meanwhile.
    pub fn keep_up(&mut self, share: f64) {
        // Half an hour may be on its way: so long is a file.
        let slack = RODS.len() * 30;
        let wanted = ((self.material.records as f64 * share) as usize).saturating_sub(slack);
        let until = Instant::now() + DEADLINE;
        while self.records() < wanted {
            assert!(
                Instant::now() < until,
                "{} records of {wanted}\n{}",
                self.records(),
                self.log()
            );
            thread::sleep(LOOK);
        }
        self.look();
    }

    /// Takes down memory and faults, and checks on clients that say nothing.
    pub fn look(&mut self) {
        let usage = Usage::of(self.daemon().pid());
        let hour = self.records() as f64 / self.material.records as f64 * self.material.hours as f64;
        let life = self.life;
        self.samples.push(Sample { hour, life, usage });
        for fault in self.health()["faults"].as_array().unwrap() {
            self.seen
                .shown
                .insert(fault["fault"].as_str().unwrap().to_owned());
        }
        let over: Vec<Silent> = self
            .silent
            .extract_if(.., |silent| {
                silent.since.elapsed() > FIRST_WORDS || silent.life != life
            })
            .collect();
        for mut silent in over.into_iter().filter(|silent| silent.life == life) {
            silent.stream.set_read_timeout(Some(LOOK)).unwrap();
            let mut told = Vec::new();
            let end = silent.stream.read_to_end(&mut told);
            assert!(
                end.is_ok()
                    || end
                        .as_ref()
                        .is_err_and(|fault| fault.kind() == ErrorKind::ConnectionReset),
                "a client that says nothing is still there after {:?}: {end:?}",
                silent.since.elapsed()
            );
            self.expect("idle", silent.idle);
        }
    }

    fn health(&mut self) -> Value {
        let answer = answer(self.daemon(), "/healthz");
        serde_json::from_str(answer.split_once("\r\n\r\n").unwrap().1).unwrap()
    }

    fn count(&mut self, kind: &str) -> f64 {
        let series = format!("tirante_faults_total{{kind=\"{kind}\"}}");
        metric(&metrics(self.daemon()), &series)
    }

    /// A fault is never silent (I6): counted beyond `before`, shown by the health, told in the log.
    fn expect(&mut self, kind: &str, before: f64) {
        let until = Instant::now() + DEADLINE;
        while self.count(kind) <= before {
            assert!(Instant::now() < until, "{kind} is not counted:\n{}", self.log());
            thread::sleep(LOOK);
        }
        let health = self.health();
        let is_shown = |fault: &Value| fault["fault"] == kind;
        assert!(
            health["faults"].as_array().unwrap().iter().any(is_shown),
            "{kind} is not shown: {health}"
        );
        let line = format!("fault=\"{kind}\"");
        self.daemon()
            .wait_until(&format!("{kind} is told"), |log| log.contains(&line));
    }

    /// Waits until nothing of a kind lasts.
    fn is_over(&mut self, kind: &str) {
        let until = Instant::now() + DEADLINE;
        let lasts = |health: &Value| {
            let conditions = health["conditions"].as_array().unwrap();
            conditions.iter().any(|one| one["fault"] == kind)
        };
        while lasts(&self.health()) {
            assert!(Instant::now() < until, "{kind} lasts:\n{}", self.log());
            thread::sleep(LOOK);
        }
    }

    /// Makes something happen, and checks at once what can be seen at once.
    pub fn suffer(&mut self, trouble: Trouble, share: f64) {
        *self.done.entry(trouble).or_default() += 1;
        match trouble {
            Trouble::Kill => {
                self.take_down();
                let daemon = self.daemon();
                daemon.child.kill().unwrap();
                daemon.wait();
                self.start();
            }
            Trouble::Terminate => {
                self.terminate();
                self.start();
            }
            Trouble::Reload => {
                let settle_s = self.rng.random_range(0.2..0.8);
                let config = self.config.replace(
                    "[alert]\nsettle_s = 0.5",
                    &format!("[alert]\nsettle_s = {settle_s}"),
                );
                self.reload(&config);
            }
            Trouble::BadReload => self.bad_reload(),
            Trouble::FullDisk => self.full_disk(share),
            Trouble::ReadOnlyDisk => {
                let state = self.path("state");
                let before = self.count("files");
                // Not while the daemon writes a file that it opened there.
                let until = Instant::now() + DEADLINE;
                loop {
                    assert!(mount(&["--bind", state.to_str().unwrap()], &state));
                    if mount(&["-o", "remount,ro,bind"], &state) {
                        break;
                    }
                    assert!(Instant::now() < until, "cannot be made read-only");
                    lift(&state);
                    thread::sleep(LOOK);
                }
                self.expect("files", before);
                lift(&state);
                self.is_over("files");
            }
            Trouble::StoreAway => self.away("files", "state/site.db"),
            Trouble::JournalAway => {
                let parts = fs::read_dir(self.path("state/journal")).unwrap();
                let names = parts.map(|part| part.unwrap().file_name().into_string().unwrap());
                let last = names.filter(|name| name.ends_with(".mcap")).max().unwrap();
                self.away("files", &format!("state/journal/{last}"));
            }
            Trouble::FolderAway => self.away("folder", "archive"),
            Trouble::Sink => {
                let moods = [
                    Mood::Well,
                    Mood::Down,
                    Mood::Hanging,
                    Mood::Refusing("500 Broken\r\n"),
                    Mood::Refusing("429 Too Many\r\nRetry-After: 1\r\n"),
                ];
                let mood = moods[self.rng.random_range(0..moods.len())];
                self.sinks[self.rng.random_range(0..self.sinks.len())].set(mood);
            }
            Trouble::Copy => self.copy(false),
            Trouble::Stump => self.copy(true),
            Trouble::Junk => self.junk(),
            Trouble::Garbage => {
                let before = self.count("client");
                let mut bytes = vec![0; self.rng.random_range(1..5000)];
                self.rng.fill_bytes(&mut bytes);
                bytes[0] = b'x';
                let answer = self.tell(&bytes);
                assert!(answer.contains("error"), "{answer}");
                self.expect("client", before);
            }
            Trouble::HalfOpen => {
                let idle = self.count("idle");
                let stream = UnixStream::connect(self.path("state/in.sock")).unwrap();
                self.silent.push(Silent {
                    stream,
                    since: Instant::now(),
                    life: self.life,
                    idle,
                });
            }
            Trouble::Cut => {
                self.feed.cut();
                self.feed.kill_sender();
                // Half a stream on a topic of no rod.
                let whole = &self.material.data.files[0];
                let half = whole[..self.rng.random_range(9..whole.len().min(4000))].to_vec();
                let mut stream = UnixStream::connect(self.path("state/in.sock")).unwrap();
                let _ = stream.write_all(&half);
            }
        }
    }

    /// Answers to a client that sends `bytes`, to the end of its connection.
    fn tell(&self, bytes: &[u8]) -> String {
        let mut client = UnixStream::connect(self.path("state/in.sock")).unwrap();
        client.set_read_timeout(Some(DEADLINE)).unwrap();
        // One that is turned away may be gone already.
        let _ = client.write_all(bytes);
        let _ = client.shutdown(Shutdown::Write);
        let mut answer = String::new();
        let _ = client.read_to_string(&mut answer);
        answer
    }

    /// Another configuration that is taken.
    pub fn reload(&mut self, config: &str) {
        fs::write(self.path("site.toml"), config).unwrap();
        let is_taken = |line: &&str| line.contains(" holds") && !line.contains("old one");
        let taken = |log: &str| log.lines().filter(is_taken).count();
        let before = taken(&self.log());
        self.daemon().signal("-HUP");
        self.daemon()
            .wait_until("the new configuration is taken", |log| taken(log) > before);
        config.clone_into(&mut self.config);
    }

    fn bad_reload(&mut self) {
        let before = self.count("reload");
        let bad = self.config.replace("length_m", "lenght_m");
        fs::write(self.path("site.toml"), bad).unwrap();
        self.daemon().signal("-HUP");
        self.expect("reload", before);
        let good = self.config.clone();
        self.reload(&good);
        self.is_over("reload");
    }

    fn full_disk(&mut self, mut share: f64) {
        let before = self.count("disk-full");
        let mut ballast = File::create(self.path("state/ballast")).unwrap();
        // As much as there is, again until the daemon notices: it may make room itself. It notices when it has something to keep.
        let until = Instant::now() + DEADLINE;
        while self.count("disk-full") <= before {
            while ballast.write_all(&[1; 4096]).is_ok() {}
            share = (share + 1e-3).min(1.0);
            self.feed.offer(share);
            assert!(Instant::now() < until, "not full:\n{}", self.log());
            thread::sleep(LOOK);
        }
        drop(ballast);
        self.expect("disk-full", before);
        fs::remove_file(self.path("state/ballast")).unwrap();
        self.is_over("disk-full");
    }

    /// Something the daemon needs is elsewhere for a while, and comes back.
    fn away(&mut self, kind: &str, name: &str) {
        let before = self.count(kind);
        let aside = self.path(&format!("{name}.aside"));
        fs::rename(self.path(name), &aside).unwrap();
        self.expect(kind, before);
        fs::rename(&aside, self.path(name)).unwrap();
        self.is_over(kind);
    }

    /// A file that was read comes again, whole or cut short: nothing of it is new.
    fn copy(&mut self, is_cut: bool) {
        let Some(store) = self.store() else { return };
        let read = "SELECT name FROM file WHERE name GLOB 'north-*' ORDER BY name";
        let mut names: Vec<String> = store
            .prepare(read)
            .and_then(|mut read| read.query_map((), |row| row.get(0))?.collect())
            .unwrap();
        names.retain(|name| !self.material.broken.contains(name));
        if names.is_empty() {
            return;
        }
        let name = &names[self.rng.random_range(0..names.len())];
        let mut bytes = fs::read(self.path(&format!("archive/{name}"))).unwrap();
        self.made += 1;
        let copy = format!("copy-{}-of-{name}", self.made);
        if is_cut {
            bytes.truncate(self.rng.random_range(1000..bytes.len() - 1000));
            self.stumps.push(copy.clone());
        }
        fs::write(self.path("coming"), bytes).unwrap();
        let to = self.path(&format!("archive/{copy}"));
        fs::rename(self.path("coming"), to).unwrap();
    }

    fn junk(&mut self) {
        let before = self.count("recording");
        let mut bytes = vec![0; self.rng.random_range(1000..100_000)];
        self.rng.fill_bytes(&mut bytes);
        if self.rng.random_bool(0.5) {
            bytes[..8].copy_from_slice(b"\x89MCAP0\r\n");
        }
        // It has its end, so that nobody waits for more.
        let end = bytes.len() - 8;
        bytes[end..].copy_from_slice(b"\x89MCAP0\r\n");
        self.made += 1;
        fs::write(self.path("coming"), bytes).unwrap();
        let to = format!("archive/junk-{}.mcap", self.made);
        fs::rename(self.path("coming"), self.path(&to)).unwrap();
        self.expect("recording", before);
    }

    /// Adds what the daemon counted and logged in this life.
    pub fn take_down(&mut self) {
        // What the store has was counted, a moment later at most.
        let rejected = self.rejections() - self.rejected;
        let until = Instant::now() + DEADLINE;
        while self.count("rejected") < rejected {
            assert!(Instant::now() < until, "{rejected} rejected records, not counted");
            thread::sleep(LOOK);
        }
        let text = metrics(self.daemon());
        for line in text.lines() {
            let Some((kind, value)) = line
                .strip_prefix("tirante_faults_total{kind=\"")
                .and_then(|rest| rest.split_once("\"} "))
            else {
                continue;
            };
            *self.seen.counted.entry(kind.to_owned()).or_default() += value.parse::<f64>().unwrap();
        }
        let log = self.log();
        let most = 1 + (self.begun.elapsed().as_secs() / 60) as usize;
        let mut lines: BTreeMap<&str, usize> = BTreeMap::new();
        for line in log.lines().filter(|line| !line.contains(" INFO ")) {
            if let Some(kind) = line
                .split("fault=\"")
                .nth(1)
                .and_then(|rest| rest.split('"').next())
            {
                *lines.entry(kind).or_default() += 1;
            }
        }
        for (kind, count) in lines {
            assert!(
                count <= most,
                "{count} lines of {kind} in {:?}:\n{log}",
                self.begun.elapsed()
            );
            self.seen.logged.insert(kind.to_owned());
        }
        assert!(!log.contains("panicked"), "{log}");
    }

    /// Ends the daemon as a system does: 0 within five seconds.
    pub fn terminate(&mut self) {
        self.take_down();
        self.daemon.take().unwrap().stop("-TERM");
    }
}
