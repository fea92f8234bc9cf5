//! The store: commits of a replay, and opening a store of many records with every row looked at.
//!
//! Ids: `store::commits` with the number of records; `store::open`, `store::reader` with the records in the store.

#[path = "../tests/harness/archive/mod.rs"]
mod archive;

use archive::fill;
use divan::Bencher;
use tirante::site::store::{Durability, Reader, Store};

fn main() {
    divan::main();
}

#[divan::bench(args = [876, 8760], sample_count = 5, sample_size = 1)]
fn commits(bencher: Bencher, records: i64) {
    bencher
        .with_inputs(|| tempfile::tempdir().expect("a store"))
        .bench_values(|folder| {
            fill(
                &mut Store::open(&folder.path().join("site.db"), Durability::Replay).expect("a store"),
                0..records,
            );
            folder
        });
}

#[divan::bench(args = [100_000], sample_count = 5, sample_size = 1)]
fn open(bencher: Bencher, records: i64) {
    let folder = tempfile::tempdir().expect("a store");
    let path = folder.path().join("site.db");
    fill(
        &mut Store::open(&path, Durability::Replay).expect("a store"),
        0..records,
    );
    eprintln!("{} bytes", std::fs::metadata(&path).expect("a store").len());
    bencher.bench_local(|| {
        let mut store = Store::open(&path, Durability::Full).expect("a store");
        store.states().expect("a store")
    });
}

#[divan::bench(args = [100_000], sample_count = 5, sample_size = 1)]
fn reader(bencher: Bencher, records: i64) {
    let folder = tempfile::tempdir().expect("a store");
    let path = folder.path().join("site.db");
    fill(
        &mut Store::open(&path, Durability::Replay).expect("a store"),
        0..records,
    );
    bencher.bench_local(|| {
        Reader::open(&path)
            .expect("a store")
            .standings()
            .expect("a store")
    });
}
