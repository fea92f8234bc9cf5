//! The page's answers on a store of years of hourly records of twenty rods; `YEARS=10` makes the 1.75 million rows of
//! docs/performance.md (some minutes), one year is the usual.
//!
//! Ids: `page::first` (all days taken up, once after a start; questions are told so), `page::site`, `page::history` of all years, `page::records`, `page::chart`,
//! `page::rejected`.

#[path = "../tests/harness/archive/mod.rs"]
mod archive;

use archive::{CONFIG, identified, new_record, period, rejected, row, state};
use divan::Bencher;
use std::env;
use std::path::PathBuf;
use std::sync::{Arc, LazyLock};
use std::time::Instant;
use tirante::analysis::signal::record::{RodId, Timestamp};
use tirante::analysis::track::{Period, RodState};
use tirante::service::api::{Chart, Days, History, Records, SiteAnswer};
use tirante::service::http::{Shown, Unanswered};
use tirante::site::store::{Commit, Durability, Reader, RodRow, Store, StoreError};

const RODS: i64 = 20;
const HOURS: i64 = 8760;

fn main() {
    divan::main();
}

/// The store, made once.
static STORE: LazyLock<(tempfile::TempDir, PathBuf)> = LazyLock::new(|| {
    let years: i64 = env::var("YEARS").map_or(1, |years| years.parse().expect("YEARS is a number"));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("site.db");
    let begun = Instant::now();
    let mut store = Store::open(&path, Durability::Replay).expect("a store");
    store
        .keep_config(CONFIG, "Twenty rods", "[site]\nname = \"Twenty rods\"\n")
        .expect("a store");
    for day in 0..years * HOURS / 24 {
        store.begin_group().expect("a store");
        for rod in 0..RODS {
            let rod = RodId(format!("rod-{rod:02}"));
            for number in 24 * day..24 * (day + 1) {
                let outcome = if number % 50 == 49 {
                    rejected(&rod, number)
                } else {
                    identified(&rod, number)
                };
                let closed: Vec<Period> = (number % 24 == 23).then(|| period(day)).into_iter().collect();
                let now = state(&rod, number);
                let record = row(&outcome);
                let row = RodRow {
                    state: &now,
                    stands: &RodState::Monitoring,
                    closed: &closed,
                    events: &[],
                };
                let commit = Commit {
                    record: Some(new_record(&outcome, &record)),
                    rod: (!closed.is_empty()).then_some(row),
                    ..Commit::default()
                };
                store.commit(&commit).expect("a store");
            }
        }
        store.end_group().expect("a store");
    }
    eprintln!(
        "{} rows in {:.0} s",
        years * HOURS * RODS,
        begun.elapsed().as_secs_f64()
    );
    (folder, path)
});

/// The store as a server has it after its first question.
static SHOWN: LazyLock<Arc<Shown>> = LazyLock::new(|| {
    let shown = Shown::new(&STORE.1);
    asked(&shown, |_, _| Ok(()));
    shown
});

fn answer<T: serde::Serialize>(question: impl FnOnce(&Reader, &Days) -> Result<T, StoreError>) -> usize {
    let answer = SHOWN.ask(question).expect("an answer");
    serde_json::to_string(&answer).expect("JSON").len()
}

/// Asks until the store was read.
fn asked<T>(shown: &Shown, question: impl Fn(&Reader, &Days) -> Result<T, StoreError>) -> T {
    loop {
        match shown.ask(&question) {
            Ok(answer) => return answer,
            Err(Unanswered::Reading { .. }) => {}
            Err(Unanswered::Store(error)) => panic!("{error}"),
        }
    }
}

fn rod() -> RodId {
    RodId("rod-07".to_owned())
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn first(bencher: Bencher) {
    LazyLock::force(&STORE);
    bencher.bench_local(|| asked(&Shown::new(&STORE.1), |_, days| Ok(days.counts(&rod()))));
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn site(bencher: Bencher) {
    LazyLock::force(&SHOWN);
    bencher.bench_local(|| answer(SiteAnswer::of));
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn history(bencher: Bencher) {
    LazyLock::force(&SHOWN);
    let always = (Timestamp::from_nanos(0), Timestamp::MAX);
    bencher.bench_local(|| answer(|reader, days| History::of(reader, days, &rod(), always, 1200)));
}

/// The most records that are read for one answer: some two years of hours.
#[divan::bench(sample_count = 20, sample_size = 1)]
fn history_from_records(bencher: Bencher) {
    LazyLock::force(&SHOWN);
    let (first, _) = SHOWN
        .ask(|_, days| Ok(days.span(&rod())))
        .expect("a store")
        .expect("a rod");
    let span = (first, first.plus_seconds(3600.0 * 19_900.0));
    bencher.bench_local(|| answer(|reader, days| History::of(reader, days, &rod(), span, 1200)));
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn records(bencher: Bencher) {
    LazyLock::force(&SHOWN);
    bencher.bench_local(|| answer(|reader, days| Records::of(reader, days, &rod(), None, false, 25)));
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn rejections(bencher: Bencher) {
    LazyLock::force(&SHOWN);
    bencher.bench_local(|| answer(|reader, days| Records::of(reader, days, &rod(), None, true, 25)));
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn chart(bencher: Bencher) {
    LazyLock::force(&SHOWN);
    bencher.bench_local(|| answer(|reader, _| Chart::of(reader, &rod(), 1500)));
}
