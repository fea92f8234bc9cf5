//! A site of any number of rods, no two alike, the recordings its sensors send, and a daemon that waits for them.

use crate::site::rods::simulated_rod;
use crate::survival::process::Process;
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::thread;

/// Parameters of a measurement.
pub struct Plan {
    pub rods: usize,
    pub fs_hz: f64,
    /// Length of a record \[s\]; 0 where each ends with a gap.
    pub window_s: f64,
    pub modes: usize,
    /// Field of the samples in a message: `values` for arrays, `data` for one sample.
    pub field: &'static str,
    /// Further sections of the daemon's configuration.
    pub more: String,
}

impl Default for Plan {
    fn default() -> Self {
        Self {
            rods: 100,
            fs_hz: 200.0,
            window_s: 60.0,
            modes: 5,
            field: "values",
            more: String::new(),
        }
    }
}

/// One recording of some of the rods.
pub struct Take<'a> {
    pub name: &'a str,
    pub rods: std::ops::Range<usize>,
    /// Where the first record begins; later ones follow every `interval_s`.
    pub start: &'a str,
    pub records: usize,
    pub interval_s: f64,
    pub record_s: f64,
    pub samples_per_message: usize,
    pub encoding: &'a str,
    /// Further TOML of every rod.
    pub special: &'a str,
}

impl Default for Take<'_> {
    fn default() -> Self {
        Self {
            name: "all",
            rods: 0..1,
            start: "2026-01-01T00:00:00Z",
            records: 1,
            interval_s: 3600.0,
            record_s: 60.0,
            samples_per_message: 20,
            encoding: "ros2",
            special: "",
        }
    }
}

pub struct Plant {
    pub folder: tempfile::TempDir,
    plan: Plan,
}

impl Plant {
    pub fn new(plan: Plan) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("archive")).unwrap();
        let operation = format!(
            "[store]\npath = \"site.db\"\n[http]\nlisten = \"127.0.0.1:0\"\n[ingest]\nfolder = \"archive\"\nlisten = [\"unix://{}\"]\n{}",
            folder.path().join("in.sock").display(),
            plan.more,
        );
        let config = rods(&plan, 0..plan.rods) + &operation;
        fs::write(folder.path().join("site.toml"), config).unwrap();
        Self { folder, plan }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tirante"));
        command
            .current_dir(self.folder.path())
            .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
            .stdin(Stdio::null())
            .args(words);
        command
    }

    pub fn run(&self, words: &[&str]) {
        let output = self.command(words).output().unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }

    /// Simulates a recording `NAME.mcap`.
    pub fn simulate(&self, take: &Take<'_>) {
        let config = rods(&self.plan, take.rods.clone()) + &simulation(&self.plan, take);
        let file = format!("{}.toml", take.name);
        fs::write(self.path(&file), config).unwrap();
        let out = format!("{}.mcap", take.name);
        self.run(&["simulate", "--config", &file, "--out", &out]);
    }

    /// A daemon that is ready.
    pub fn start(&self) -> Process {
        let mut daemon = Process::start(self.folder.path(), &[]);
        daemon.wait_until("ready", |log| log.contains("ready"));
        daemon
    }

    /// Sends recordings into the daemon's socket.
    pub fn send(&self, sender: &str, files: &[&str], more: &[&str]) -> Sender {
        let to = format!("unix://{}", self.path("in.sock").display());
        let words = [&["send", "--to", &to, "--sender", sender], files, more].concat();
        let child = self
            .command(&words)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Sender(child)
    }

    /// The daemon's store, opened beside it.
    pub fn store(&self) -> rusqlite::Connection {
        let flags = rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY;
        let store = rusqlite::Connection::open_with_flags(self.path("site.db"), flags).unwrap();
        store.busy_timeout(std::time::Duration::from_secs(20)).unwrap();
        store
    }

    /// Number returned by a query of the store.
    pub fn count(&self, query: &str) -> i64 {
        self.store().query_row(query, (), |row| row.get(0)).unwrap()
    }
}

/// A sender that is stopped when it is dropped.
pub struct Sender(Child);

impl Sender {
    pub fn finish(mut self) {
        assert!(self.0.wait().unwrap().success());
    }
}

impl Drop for Sender {
    fn drop(&mut self) {
        if self.0.try_wait().is_ok_and(|ended| ended.is_none()) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }
}

/// Waits in small steps until a condition holds; the daemon must keep running.
pub fn wait(daemon: &mut Process, what: &str, limit: std::time::Duration, is_so: impl Fn() -> bool) {
    let until = std::time::Instant::now() + limit;
    while !is_so() {
        assert!(
            std::time::Instant::now() < until,
            "not so: {what}\n{}",
            daemon.log()
        );
        assert!(daemon.is_running(), "ended before {what}:\n{}", daemon.log());
        thread::sleep(std::time::Duration::from_millis(20));
    }
}

fn rods(plan: &Plan, which: std::ops::Range<usize>) -> String {
    let Plan {
        fs_hz,
        window_s,
        field,
        ..
    } = *plan;
    let mut text = "[site]\nname = \"Load\"\nseed = 11\n".to_owned();
    if window_s > 0.0 {
        text +=
            &format!("[record]\ncut = \"window\"\nwindow_s = {window_s:?}\nmin_duration_s = {window_s:?}\n");
    }
    for rod in which {
        let length_m = 8.0 + 0.02 * rod as f64;
        text += &crate::site::rods::rod(&format!("rod-{rod}"), length_m, field, fs_hz);
    }
    text
}

fn simulation(plan: &Plan, take: &Take<'_>) -> String {
    let Take {
        start,
        records,
        interval_s,
        record_s,
        samples_per_message,
        encoding,
        special,
        ..
    } = take;
    let mut text = format!(
        r#"
[simulation]
start = {start}
records = {records}
interval_s = {interval_s:?}
record_s = {record_s:?}
fs_hz = {fs_hz:?}
samples_per_message = {samples_per_message}
encoding = "{encoding}"
"#,
        fs_hz = plan.fs_hz,
    );
    for rod in take.rods.clone() {
        text += &simulated_rod(&format!("rod-{rod}"), 142e3, plan.modes, special);
    }
    text
}
