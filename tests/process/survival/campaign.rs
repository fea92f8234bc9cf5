//! Four rods whose data come by every possible way, one way each so that its order is fixed, with the results
//! required.

use super::feed::Feed;
use super::hook::Hook;
use super::process::{DEADLINE, Process};
use crate::site::rods::{RESTRAINED, rod_with_air, simulated_rod};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Files that appear, one that grows, `tirante send`, JSON lines.
pub const RODS: [&str; 4] = ["north", "west", "south", "east"];

/// All data fed, by the way they come.
pub struct Data {
    /// Files that appear.
    pub files: Vec<Vec<u8>>,
    /// A file that grows.
    pub growing: Vec<u8>,
    pub sent: Vec<PathBuf>,
    pub lines: Vec<String>,
}

/// Days of all rods, and the results of an undisturbed daemon.
pub struct Material {
    folder: TempDir,
    pub days: usize,
    pub data: Arc<Data>,
    undisturbed: OnceLock<BTreeMap<String, String>>,
}

fn site(rods: &[&str]) -> String {
    let mut text = String::from(
        "[site]\nname = \"Four rods\"\nseed = 11\n[abc]\ndraws = 1000\naccept = { quantile = 0.1 }\n\
         [track]\nbaseline_records = 10\nlearning_periods = 14\nparticles = 256\n\
         [alarm]\ncompare_rods = false\n",
    );
    for id in rods {
        // Different enough that no rod is mistaken for another, and none is used as a witness: the results of one rod must not
        // depend on the timing of another.
        let length_m = match *id {
            "north" => 8.0,
            "west" => 9.5,
            "south" => 11.0,
            _ => 6.5,
        };
        text += &rod_with_air(id, length_m, &format!("/air/{id}"));
    }
    text
}

fn simulation(id: &str, first_day: usize, days: usize, has_lost: bool, encoding: &str) -> String {
    let start = 1_767_268_800_000_000_000 + first_day as i64 * 86_400_000_000_000;
    let start = tirante::analysis::signal::record::Timestamp::from_nanos(start);
    let change = if has_lost {
        "[[simulation.rod.change]]\nstart_d = 0.0\nrelative = -0.10\n"
    } else {
        ""
    };
    site(&[id])
        + &format!(
            r#"
[simulation]
start = {start}
records = {days}
interval_s = 86_400.0
record_s = 30.0
fs_hz = 100.0
samples_per_message = 100
encoding = "{encoding}"
[simulation.climate]
mean_c = 12.0
season_k = 6.0
day_k = 3.0
weather_k = 2.0
between_s = 1800
"#
        )
        + &simulated_rod(id, 142e3, 3, &format!("{RESTRAINED}{change}"))
}

pub fn tirante(folder: &Path, words: &[&str]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_tirante"))
        .current_dir(folder)
        .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
        .args(words)
        .output()
        .unwrap()
}

/// Simulates a recording into a folder; returns its path.
pub fn simulate(folder: &Path, name: &str, config: &str, seed: usize) -> PathBuf {
    fs::write(folder.join("simulated.toml"), config).unwrap();
    let seed = seed.to_string();
    let words = [
        "simulate",
        "--config",
        "simulated.toml",
        "--out",
        name,
        "--seed",
        &seed,
    ];
    let output = tirante(folder, &words);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    folder.join(name)
}

/// A recording of one record of the rod `east`, as many samples as a record may have: 8 MB, and many times that under analysis.
pub fn huge() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let config =
        simulation("east", 5, 1, false, "protobuf").replace("record_s = 30.0", "record_s = 10_400.0");
    fs::read(simulate(folder.path(), "huge.mcap", &config, 5)).unwrap()
}

impl Material {
    /// Long enough for baselines, charts and an alarm.
    pub fn long() -> &'static Self {
        static LONG: OnceLock<Material> = OnceLock::new();
        LONG.get_or_init(|| Self::new(40, 26))
    }

    /// A few records, for many repetitions.
    pub fn short() -> &'static Self {
        static SHORT: OnceLock<Material> = OnceLock::new();
        SHORT.get_or_init(|| Self::new(2, 2))
    }

    fn new(days: usize, good_days: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let simulate = |name: &str, id: &str, first: usize, days: usize, encoding: &str| {
            let config = simulation(id, first, days, first >= good_days, encoding);
            let seed = first + 1000 * id.len() + usize::from(id.as_bytes()[0]);
            simulate(folder.path(), name, &config, seed)
        };
        let half = days / 2;
        let files = (0..days)
            .step_by(2)
            .map(|day| simulate(&format!("north-{day}.mcap"), "north", day, 2, "protobuf"))
            .map(|path| fs::read(path).unwrap())
            .collect();
        let growing = fs::read(simulate("west.mcap", "west", 0, days, "protobuf")).unwrap();
        let sent = [0, half]
            .map(|first| simulate(&format!("south-{first}.mcap"), "south", first, half, "protobuf"))
            .to_vec();
        let lines = lines_of(&fs::read(simulate("east.mcap", "east", 0, days, "json")).unwrap());
        Self {
            folder,
            days,
            data: Arc::new(Data {
                files,
                growing,
                sent,
                lines,
            }),
            undisturbed: OnceLock::new(),
        }
    }

    /// Results of an undisturbed daemon for every rod; a replay of the same data gives the same.
    pub fn undisturbed(&'static self) -> &'static BTreeMap<String, String> {
        self.undisturbed.get_or_init(|| {
            let campaign = Campaign::new(self, "");
            let mut feed = campaign.feed();
            feed.offer(1.0);
            campaign.finish(&mut feed);
            let made = campaign.results("state/site.db");
            let sent: Vec<_> = self.data.sent.iter().map(|path| path.to_str().unwrap()).collect();
            let east = self.folder.path().join("east.mcap");
            let replayed = campaign.replay(&[&["archive", east.to_str().unwrap()], &sent[..]].concat());
            compare("undisturbed", &made, &replayed);
            assert_eq!(
                made["north"]
                    .lines()
                    .filter(|line| line.starts_with("record\t"))
                    .count(),
                self.days
            );
            made
        })
    }
}

/// A recording as JSON lines.
pub fn lines_of(recording: &[u8]) -> Vec<String> {
    let line = |message: mcap::Message<'_>| {
        let mut object: serde_json::Map<_, _> = serde_json::from_slice(&message.data).unwrap();
        object.insert("topic".to_owned(), message.channel.topic.clone().into());
        object.insert("time".to_owned(), message.log_time.into());
        serde_json::to_string(&object).unwrap() + "\n"
    };
    let messages = mcap::MessageStream::new(recording).unwrap();
    messages.map(|message| line(message.unwrap())).collect()
}

/// A site's folder: configuration, watched folder, and `state` with everything the daemon writes.
pub struct Campaign {
    pub folder: TempDir,
    pub material: &'static Material,
    pub hook: Hook,
}

impl Campaign {
    pub fn new(material: &'static Material, more: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let hook = Hook::start();
        let socket = folder.path().join("state/in.sock");
        let operation = format!(
            "[store]\npath = \"state/site.db\"\n[ingest]\nfolder = \"archive\"\nlisten = [\"unix://{}\"]\nsettle_s = 3600\n\
             [[sink]]\nid = \"hook\"\nkind = \"webhook\"\nurl = \"http://{}/\"\n",
            socket.display(),
            hook.address
        );
        let http = if more.contains("[http]") {
            ""
        } else {
            "[http]\nlisten = \"off\"\n"
        };
        let config = site(&RODS) + &operation + http + more;
        fs::write(folder.path().join("site.toml"), config).unwrap();
        fs::create_dir(folder.path().join("archive")).unwrap();
        fs::create_dir(folder.path().join("state")).unwrap();
        Self {
            folder,
            material,
            hook,
        }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn feed(&self) -> Feed {
        Feed::start(Arc::clone(&self.material.data), self.folder.path())
    }

    pub fn start(&self, wrapped: &[&str]) -> Process {
        Process::start(self.folder.path(), wrapped)
    }

    pub fn records(&self) -> usize {
        let Ok(reader) = tirante::site::store::Reader::open(&self.path("state/site.db")) else {
            return 0;
        };
        let rods = reader.rods().unwrap_or_default();
        let counts = rods.iter().filter_map(|rod| reader.counts(rod).ok());
        counts.map(|counts| counts.records as usize).sum()
    }

    /// Lets an undisturbed daemon take the rest.
    pub fn finish(&self, feed: &mut Feed) {
        let daemon = self.start(&[]);
        self.finish_with(feed, daemon);
    }

    pub fn finish_with(&self, feed: &mut Feed, mut daemon: Process) {
        feed.kill_sender();
        feed.offer(1.0);
        let all = self.material.days * RODS.len();
        // All may be in already, and it answers to signals when it has begun only.
        daemon.wait_until("it is ready", |log| log.contains("ready"));
        daemon.wait_until("everything is in", |_| feed.is_done() && self.records() >= all);
        // Repeated alarms arrive within this time as well.
        let until = Instant::now() + DEADLINE;
        for id in self.alarms() {
            while !self.hook.received(&id) {
                assert!(
                    Instant::now() < until,
                    "alarm {id} did not arrive:\n{}",
                    daemon.log()
                );
                thread::sleep(Duration::from_millis(20));
            }
        }
        daemon.stop("-TERM");
    }

    fn alarms(&self) -> Vec<String> {
        let store = rusqlite::Connection::open(self.path("state/site.db")).unwrap();
        let mut statement = store.prepare("SELECT id FROM alarm").unwrap();
        let ids = statement.query_map((), |row| row.get(0)).unwrap();
        ids.map(Result::unwrap).collect()
    }

    /// Replays into a fresh store; returns the results of every rod.
    fn replay(&self, paths: &[&str]) -> BTreeMap<String, String> {
        let _ = fs::remove_file(self.path("replayed.db"));
        let words = ["replay", "--config", "site.toml", "--store", "replayed.db"];
        let output = tirante(self.folder.path(), &[&words[..], paths].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 3)), "{said}");
        self.results("replayed.db")
    }

    pub fn results(&self, store: &str) -> BTreeMap<String, String> {
        results(&self.path(store))
    }

    /// Checks the invariants after all data was fed. A store damaged on purpose must have been moved aside,
    /// no other.
    pub fn check(&self, what: &str, was_damaged: bool) {
        let made = self.results("state/site.db");
        compare(what, self.material.undisturbed(), &made);
        let is_aside = self.path("state/site.db.corrupt-1").exists();
        assert_eq!(is_aside, was_damaged, "{what}");
        let replayed = self.replay(&["archive", "state/journal"]);
        compare(&format!("{what}, replayed"), &made, &replayed);
    }
}

/// Results of every rod in a store, without the numbers that depend on the order of rods.
pub fn results(store: &Path) -> BTreeMap<String, String> {
    let store = rusqlite::Connection::open(store).unwrap();
    RODS.iter()
        .map(|rod| ((*rod).to_owned(), of_rod(&store, rod)))
        .collect()
}

/// Panics at the first difference of two results.
pub fn compare(what: &str, one: &BTreeMap<String, String>, other: &BTreeMap<String, String>) {
    for rod in RODS {
        for (line, (a, b)) in one[rod].lines().zip(other[rod].lines()).enumerate() {
            assert_eq!(a, b, "{what}: rod {rod}, line {line}");
        }
        let count = |results: &BTreeMap<String, String>| results[rod].lines().count();
        assert_eq!(count(one), count(other), "{what}: rod {rod}");
    }
}

fn of_rod(store: &rusqlite::Connection, rod: &str) -> String {
    let mut text = String::new();
    for (table, from, order) in [
        ("rod", "rod AS t WHERE t.rod = ?", "1"),
        ("segment", "segment AS t WHERE t.rod = ?", "number"),
        ("state", "state AS t WHERE t.rod = ?", "part"),
        ("record", "record AS t WHERE t.rod = ?", "id"),
        (
            "line",
            "line AS t JOIN record ON record.id = t.record WHERE record.rod = ?",
            "t.record",
        ),
        (
            "mode",
            "mode AS t JOIN record ON record.id = t.record WHERE record.rod = ?",
            "t.record, mode_order",
        ),
        ("period", "period AS t WHERE t.rod = ?", "segment, period"),
        ("snapshot", "snapshot AS t WHERE t.rod = ?", "number"),
        ("alarm", "alarm AS t WHERE t.rod = ?", "id"),
        ("outbox", "outbox AS t WHERE t.rod = ?", "t.number"),
    ] {
        let sql = format!("SELECT t.* FROM {from} ORDER BY {order}");
        let mut statement = store.prepare(&sql).unwrap();
        let names: Vec<String> = statement.column_names().map(str::to_owned).collect();
        // Records and news are numbered through all rods, and checksums are of the numbers, too.
        let is_kept = |name: &str| match name {
            "checksum" | "id" if table == "record" => false,
            "record" => false,
            "number" => table != "outbox",
            name => name != "checksum",
        };
        let mut rows = statement.query([rod]).unwrap();
        while let Some(row) = rows.next().unwrap() {
            text.push_str(table);
            for (place, name) in names.iter().enumerate().filter(|(_, name)| is_kept(name)) {
                let value: rusqlite::types::Value = row.get(place).unwrap();
                let _ = write!(text, "\t{name}={value:?}");
            }
            text.push('\n');
        }
    }
    // The configurations name ports and folders of this run.
    let mut statement = store.prepare("SELECT hash FROM config").unwrap();
    let configs = statement.query_map((), |row| row.get::<_, String>(0)).unwrap();
    configs.fold(text, |text, config| text.replace(&config.unwrap(), "CONFIG"))
}
