//! Time for the daemon to be ready: a hundred rods, no two alike, with nothing and with a hundred thousand
//! records.

use super::plant::{Plan, Plant};
use crate::archive;
use crate::survival::process::Process;
use std::path::Path;
use std::time::{Duration, Instant};
use tirante::analysis::signal::record::RodId;
use tirante::site::store::{Commit, Durability, Store};

const RODS: usize = 100;
const RECORDS: i64 = 100_000;
const LIMIT: Duration = Duration::from_secs(2);

/// Starts a daemon, kills it when ready, and returns the time to be ready.
fn ready(plant: &Plant, cache: &Path) -> Duration {
    let begun = Instant::now();
    let variables = [("TIRANTE_CACHE_DIR", cache.to_str().unwrap())];
    let mut daemon = Process::with(plant.folder.path(), &[], &variables);
    daemon.wait_until("ready", |log| log.contains("ready"));
    let took = begun.elapsed();
    daemon.child.kill().unwrap();
    daemon.wait();
    took
}

/// Puts made-up records of all rods into the daemon's store.
fn fill(plant: &Plant) {
    let mut store = Store::open(&plant.path("site.db"), Durability::Replay).unwrap();
    store
        .keep_config(archive::CONFIG, "Load", "[site]\nname = \"Load\"\n")
        .unwrap();
    store.begin_group().unwrap();
    for number in 0..RECORDS {
        let rod = RodId(format!("rod-{}", number % RODS as i64));
        let outcome = archive::identified(&rod, number);
        store
            .commit(&Commit {
                record: Some(archive::new_record(&outcome, &archive::row(&outcome))),
                ..Commit::default()
            })
            .unwrap();
    }
    store.end_group().unwrap();
}

#[test]
#[ignore = "a minute on a quiet machine"]
fn ready_with_a_hundred_thousand_records() {
    let plant = Plant::new(Plan {
        rods: RODS,
        ..Plan::default()
    });
    let cold = tempfile::tempdir().unwrap();
    let first = ready(&plant, cold.path());
    let empty = ready(&plant, cold.path());
    fill(&plant);
    let full: Vec<Duration> = (0..5).map(|_| ready(&plant, cold.path())).collect();
    let size_mb = std::fs::metadata(plant.path("site.db")).unwrap().len() >> 20;
    println!("{RODS} rods, no two alike, ready after");
    println!("  {first:?} with no cache and no store");
    println!("  {empty:?} with an empty store");
    println!("  {full:?} with {RECORDS} records, {size_mb} MB, killed before");
    assert!(first < LIMIT && empty < LIMIT);
    assert!(full.iter().all(|took| *took < LIMIT));
}
