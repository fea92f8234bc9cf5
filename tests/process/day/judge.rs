//! The invariants, at the end of a campaign.

use super::scene::{Scene, Trouble};
use crate::load::usage::Usage;
use crate::survival::campaign::{compare, results, tirante};
use crate::survival::process::DEADLINE;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::thread;
use std::time::{Duration, Instant};

const PEAK_MB: f64 = 256.0;
const GROWTH_MB_PER_H: f64 = 1.0;
/// Hours of data after which a daemon's buffers and caches have their final size.
const SETTLED_H: f64 = 3.0;
/// Fewer samples say nothing about growth.
const ENOUGH: usize = 50;

/// One of what the sinks are to be told: id of alarm or condition, and what became of it.
type News = (String, String);

/// A record's row from its start on.
fn in_order_of_time(row: &str) -> &str {
    &row[row.find("start_ns=").unwrap()..]
}

impl Scene {
    /// Lets everything come in, then checks all invariants.
    pub fn finish(&mut self) {
        for sink in &self.sinks {
            sink.heal();
        }
        // A fresh daemon: an old one may wait for minutes until it tries a sink again.
        self.terminate();
        self.start();
        self.feed.offer(1.0);
        self.wait("the senders are done", |scene| scene.feed.is_done());
        // A file without an end counts as cut short when it has not grown for long; until then its last record is open.
        let config = self.config().replace("settle_s = 3600", "settle_s = 1");
        self.terminate();
        fs::write(self.path("site.toml"), config).unwrap();
        self.start();
        self.wait("all records are there", |scene| {
            scene.records() >= scene.material.records
        });
        self.wait("what is lost of files is told", |scene| {
            let lossy = scene.lossy();
            let mut broken = scene.material.broken.iter().chain(&scene.stumps);
            broken.all(|name| lossy.contains(name))
        });
        self.every_sink_was_told();
        self.look();
        self.terminate();
        self.same_answer();
        self.nothing_of_spoiled_records();
        self.never_silent();
        self.resources();
    }

    fn wait(&self, what: &str, is_so: impl Fn(&Self) -> bool) {
        let until = Instant::now() + DEADLINE;
        while !is_so(self) {
            assert!(
                Instant::now() < until,
                "not so: {what}; {} records of {}, lost of {:?}\n{}",
                self.records(),
                self.material.records,
                self.lossy(),
                self.log()
            );
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// Files of which something is lost, as `tirante files --losses` lists them.
    fn lossy(&self) -> Vec<String> {
        let words = [
            "files",
            "--store",
            "state/site.db",
            "--losses",
            "--format",
            "json",
        ];
        let output = tirante(self.folder.path(), &words);
        let lines = String::from_utf8(output.stdout).unwrap();
        let name = |line: &str| {
            serde_json::from_str::<Value>(line).unwrap()["file"]
                .as_str()
                .unwrap()
                .to_owned()
        };
        lines.lines().map(name).collect()
    }

    fn news(&self, sql: &str) -> Vec<News> {
        let store = self.store().unwrap();
        let mut statement = store.prepare(sql).unwrap();
        let rows = statement
            .query_map((), |row| Ok((row.get(0)?, row.get(1)?)))
            .unwrap();
        rows.map(Result::unwrap).collect()
    }

    /// I5: every sink has everything, in order, and an id always means the same.
    fn every_sink_was_told(&mut self) {
        let alarms = self.news("SELECT alarm, what FROM outbox ORDER BY number");
        let notices = self.news("SELECT condition, what FROM notice ORDER BY number");
        assert!(
            !alarms.is_empty() || self.material.hours < 4,
            "no alarm in so long a time"
        );
        for number in 0..self.sinks.len() {
            let until = Instant::now() + DEADLINE;
            loop {
                let (told_alarms, told_notices) = self.told(number);
                if told_alarms.len() >= alarms.len()
                    && notices.iter().all(|notice| told_notices.contains(notice))
                {
                    assert_eq!(told_alarms, alarms, "sink {number}: the alarms in their order");
                    break;
                }
                assert!(
                    Instant::now() < until,
                    "sink {number}: {} of {} news, of the conditions {told_notices:?} of {notices:?}\n{}",
                    told_alarms.len(),
                    alarms.len(),
                    self.log()
                );
                thread::sleep(Duration::from_millis(100));
            }
        }
        println!(
            "  {} news of alarms, {} of conditions at each sink",
            alarms.len(),
            notices.len()
        );
    }

    /// What a sink took, the first time each: of alarms, of conditions.
    fn told(&self, number: usize) -> (Vec<News>, Vec<News>) {
        let mut by_id: BTreeMap<String, Value> = BTreeMap::new();
        let (mut alarms, mut notices) = (Vec::new(), Vec::new());
        for body in self.sinks[number].taken() {
            let body: Value = serde_json::from_str(&body).unwrap();
            let word = |key: &str| body[key].as_str().unwrap_or_default().to_owned();
            if let Some(before) = by_id.get(&word("id")) {
                for key in ["alarm", "rod", "kind", "what", "raised"] {
                    assert_eq!(before[key], body[key], "one id, two meanings: {before} {body}");
                }
                continue;
            }
            let of = if word("rod").is_empty() {
                &mut notices
            } else {
                &mut alarms
            };
            of.push((word("alarm"), word("what")));
            by_id.insert(word("id"), body);
        }
        (alarms, notices)
    }

    /// I1, I2, I3: the rows of an undisturbed replay, each once. An acknowledged message that was lost would be missing here, and
    /// the senders check by themselves that none is asked for again.
    fn same_answer(&self) {
        let made = results(&self.path("state/site.db"));
        for (rod, replayed) in &self.material.replayed {
            // What is missing says more than the first line that differs.
            let records = |text: &str| -> BTreeSet<String> {
                let lines = text.lines().filter(|line| line.starts_with("record\t"));
                lines.map(str::to_owned).collect()
            };
            let (replayed, made) = (records(replayed), records(&made[rod]));
            let [missing, further] = [(&replayed, &made), (&made, &replayed)].map(|(these, those)| {
                let mut only: Vec<_> = these.difference(those).map(|row| in_order_of_time(row)).collect();
                only.sort_unstable();
                only
            });
            assert!(
                missing.is_empty() && further.is_empty(),
                "rod {rod}: {} missing, {} further, the first of them {:#?}, {:#?}",
                missing.len(),
                further.len(),
                &missing[..missing.len().min(3)],
                &further[..further.len().min(3)]
            );
        }
        compare("after a day of trouble", &self.material.replayed, &made);
        let (alarms, replayed) = (
            ids(&self.path("state/site.db")),
            ids(&self.material.path("replayed.db")),
        );
        assert_eq!(alarms, replayed);
        let words = ["backup", "--store", "state/site.db", "whole.db"];
        let checked = tirante(self.folder.path(), &words);
        let said = String::from_utf8_lossy(&checked.stderr);
        assert!(checked.status.success(), "each row has its checksum: {said}");
    }

    /// I4: no force, no mode and no share in a baseline from records that failed.
    fn nothing_of_spoiled_records(&self) {
        let store = self.store().unwrap();
        let count =
            |sql: &str, of: (&str, i64, i64)| -> i64 { store.query_row(sql, of, |row| row.get(0)).unwrap() };
        let anything = "SELECT count(*) FROM record WHERE rejection IS NOT NULL AND (axial_force_n IS NOT NULL OR tracked_force_n IS NOT NULL
            OR EXISTS (SELECT 1 FROM mode WHERE mode.record = record.id)) AND ?1 || ?2 || ?3 IS NOT NULL";
        assert_eq!(count(anything, ("", 0, 0)), 0);
        let overlaps = "FROM record WHERE rod = ?1 AND start_ns < ?3 AND start_ns + 1e9 * duration_s > ?2";
        for spoiled in &self.material.spoiled {
            let of = (spoiled.rod, spoiled.from_ns, spoiled.to_ns);
            let believed = format!("SELECT count(*) {overlaps} AND axial_force_n IS NOT NULL");
            assert_eq!(count(&believed, of), 0, "a force of spoiled data: {spoiled}");
        }
        println!(
            "  {} times of spoiled data, none believed",
            self.material.spoiled.len()
        );
    }

    /// I6: what was done was counted, shown and logged.
    fn never_silent(&self) {
        let kind = |trouble: &Trouble| match trouble {
            Trouble::BadReload => Some("reload"),
            Trouble::FullDisk => Some("disk-full"),
            Trouble::ReadOnlyDisk | Trouble::StoreAway | Trouble::JournalAway => Some("files"),
            Trouble::FolderAway => Some("folder"),
            Trouble::Junk => Some("recording"),
            Trouble::Garbage => Some("client"),
            _ => None,
        };
        let mut wanted: Vec<&str> = self.done.keys().filter_map(kind).collect();
        if !self.material.broken.is_empty() {
            wanted.push("recording");
        }
        if !self.material.spoiled.is_empty() {
            wanted.push("rejected");
        }
        if self.sinks.iter().any(|sink| sink.refused() > 0) {
            wanted.push("sink");
        }
        for kind in wanted {
            let counted = self.seen.counted.get(kind).copied().unwrap_or_default();
            assert!(counted > 0.0, "{kind} was not counted: {:?}", self.seen.counted);
            assert!(
                self.seen.shown.contains(kind),
                "{kind} was not shown: {:?}",
                self.seen.shown
            );
            assert!(
                self.seen.logged.contains(kind),
                "{kind} was not logged: {:?}",
                self.seen.logged
            );
        }
        for innocent in ["quarantined", "broken", "store-damaged", "write", "stalled"] {
            let counted = self.seen.counted.get(innocent).copied().unwrap_or_default();
            assert!(counted < 1.0, "{innocent}: {counted}");
        }
        let counted: Vec<_> = self
            .seen
            .counted
            .iter()
            .filter(|(_, count)| **count > 0.0)
            .collect();
        println!("  faults counted: {counted:?}");
    }

    /// Memory by hour of data within the longest life, and its peak in all.
    fn resources(&self) {
        let peak_mb = self
            .samples
            .iter()
            .map(|sample| sample.usage.peak_mb)
            .fold(0.0, f64::max);
        assert!(peak_mb < PEAK_MB, "{peak_mb} MB");
        let mut lives: BTreeMap<usize, Vec<(f64, Usage)>> = BTreeMap::new();
        for sample in &self.samples {
            lives
                .entry(sample.life)
                .or_default()
                .push((sample.hour, sample.usage));
        }
        let span = |life: &Vec<(f64, Usage)>| life.last().unwrap().0 - life[0].0;
        let longest = lives
            .values()
            .max_by(|one, other| span(one).total_cmp(&span(other)))
            .unwrap();
        let begun = longest[0].0;
        let settled: Vec<&(f64, Usage)> = longest
            .iter()
            .filter(|(hour, _)| *hour >= begun + SETTLED_H)
            .collect();
        if settled.len() < ENOUGH {
            println!("  peak {peak_mb:.0} MB in {} lives", lives.len());
            return;
        }
        let growth = crate::load::slope(settled.iter().map(|(hour, usage)| (*hour, usage.resident_mb)));
        let descriptors = settled.iter().map(|(_, usage)| usage.descriptors);
        println!(
            "  peak {peak_mb:.0} MB in {} lives; in the longest, {:.1} h, {growth:+.2} MB an hour of data from {SETTLED_H} h on, {} to {} descriptors",
            lives.len(),
            span(longest),
            descriptors.clone().min().unwrap(),
            descriptors.max().unwrap()
        );
        assert!(growth < GROWTH_MB_PER_H, "{growth} MB an hour of data");
    }
}

/// Alarms of a store: id, rod and kind.
fn ids(store: &std::path::Path) -> Vec<(String, String, String)> {
    let store = rusqlite::Connection::open(store).unwrap();
    let mut statement = store
        .prepare("SELECT id, rod, kind FROM alarm ORDER BY id")
        .unwrap();
    let rows = statement
        .query_map((), |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))
        .unwrap();
    rows.map(Result::unwrap).collect()
}
