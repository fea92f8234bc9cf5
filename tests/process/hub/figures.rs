//! Figures of docs/hub.md: cost at a site, delay from record to centre, rate of folding.
//! `cargo test --test process hub::figures -- --ignored --nocapture --test-threads 1`

use super::fleet::{Fleet, Storage};
use async_nats::jetstream;
use std::fs;
use std::thread;
use std::time::{Duration, Instant};
use tirante::config::HubConfig;
use tirante::service::hub;

/// Cost of `[forward]` at a site: processor time of a record, at rest, and memory, each against the same without it.
#[test]
#[ignore = "minutes; prints figures"]
fn cost_at_a_site() {
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Sqlite) else {
        return;
    };
    fleet.start_hub();
    let path = fleet.edges[0].site.path("site.toml");
    let with = fs::read_to_string(&path).unwrap();
    let without = with.split_once("[forward]").unwrap().0.to_owned();
    let mut figures = [(); 2].map(|()| [(); 3].map(|()| Vec::new()));
    for _ in 0..3 {
        for (text, of) in [(&with, 0), (&without, 1)] {
            fs::write(&path, text).unwrap();
            fleet.remove_store(0);
            fleet.start_edge(0);
            fleet.wait_until_read(0, 7);
            if of == 0 {
                fleet.wait_until_sent();
            }
            thread::sleep(Duration::from_secs(2));
            let (busy_s, peak_mb) = fleet.usage(0);
            let rest = Duration::from_secs(60);
            thread::sleep(rest);
            let (later_s, _) = fleet.usage(0);
            let share = (later_s - busy_s) / rest.as_secs_f64();
            for (place, value) in [busy_s, 100.0 * share, peak_mb].into_iter().enumerate() {
                figures[of][place].push(value);
            }
            fleet.stop_edge(0);
        }
    }
    let median = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    for (place, what) in [
        "processor time of 112 records [s]",
        "share of a core at rest [%]",
        "peak memory [MB]",
    ]
    .iter()
    .enumerate()
    {
        println!(
            "{what}: forward {:.3}, without {:.3}; all {:?}",
            median(&figures[0][place]),
            median(&figures[1][place]),
            [&figures[0][place], &figures[1][place]]
        );
    }
}

/// Time from the commit of a record at its site to its row at the centre, records coming one by one.
#[test]
#[ignore = "minutes; prints figures"]
fn delay_from_record_to_centre() {
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Postgres) else {
        return;
    };
    fleet.start();
    fleet.wait_until_equal();
    let mut delays = Vec::new();
    for day in 0..100 {
        delays.extend(fleet.delay_of_a_day(0, 60 + day));
    }
    delays.sort_by(f64::total_cmp);
    let at = |share: f64| 1e3 * delays[((delays.len() - 1) as f64 * share) as usize];
    println!(
        "{} commits, from commit to centre [ms]: median {:.0}, 95 % {:.0}, longest {:.0}",
        delays.len(),
        at(0.5),
        at(0.95),
        at(1.0)
    );
}

/// A hub that has all of one site, which is stopped, and the names of further sites on its list (`SITES`).
fn many(storage: Storage) -> Option<(Fleet, Vec<String>)> {
    let sites: usize = std::env::var("SITES").map_or(100, |text| text.parse().unwrap());
    let mut fleet = Fleet::of(&["todi"], storage)?;
    let names: Vec<String> = (0..sites).map(|number| format!("site-{number:04}")).collect();
    fleet.list_more(&names);
    fleet.start();
    fleet.wait_until_equal();
    fleet.stop_edge(0);
    Some((fleet, names))
}

/// Rate of folding: a site's messages, one commit each as they come from a site at work, under many names.
#[test]
#[ignore = "minutes; prints figures"]
fn rate_of_folding() {
    for storage in [Storage::Postgres, Storage::Sqlite] {
        let Some((mut fleet, names)) = many(storage) else {
            return;
        };
        fleet.stop_hub();
        let address = format!("127.0.0.1:{}", fleet.nats_port());
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap();
        let messages = runtime.block_on(async {
            let jetstream = jetstream::new(async_nats::connect(address).await.unwrap());
            let originals = originals(&jetstream).await;
            for name in &names {
                let subject = format!("tirante.v1.out.{name}");
                let mut sent = Vec::new();
                for (headers, payload) in &originals {
                    let one =
                        jetstream.publish_with_headers(subject.clone(), headers.clone(), payload.clone());
                    sent.push(one.await.unwrap());
                }
                for ack in sent {
                    ack.await.unwrap();
                }
            }
            originals.len() * (1 + names.len())
        });
        let begun = Instant::now();
        let rebuilt = fleet.hub_command(&["rebuild"]);
        let took = begun.elapsed().as_secs_f64();
        assert!(
            rebuilt.status.success(),
            "{}",
            String::from_utf8_lossy(&rebuilt.stderr)
        );
        fleet.assert_equal(0, &[]);
        let (records, rows) = fleet.counted();
        println!(
            "{storage:?}: {messages} messages, {records} records, {rows} rows in {took:.1} s: {:.0} records/s, {:.0} rows/s; 10 million records: {:.2} h",
            records as f64 / took,
            rows as f64 / took,
            1e7 * took / records as f64 / 3600.0
        );
    }
}

/// A message as the stream has it: headers and payload.
type Message = (async_nats::HeaderMap, bytes::Bytes);

/// The messages of the one site that has sent.
async fn originals(jetstream: &jetstream::Context) -> Vec<Message> {
    let mut stream = jetstream.get_stream("TIRANTE_OUT").await.unwrap();
    let last = stream.info().await.unwrap().state.last_sequence;
    let mut originals = Vec::new();
    for sequence in 1..=last {
        let found = stream.get_raw_message(sequence).await.unwrap();
        let mut headers = async_nats::HeaderMap::new();
        for name in ["Tirante-N", "Tirante-First", "Tirante-Epoch", "Tirante-Format"] {
            headers.insert(name, found.headers.get(name).unwrap().as_str());
        }
        originals.push((headers, found.payload));
    }
    originals
}

/// Copies of one site: all of them come back together with half of what they have to tell, then tell the rest one message at a time,
/// 17 a second for a minute.
/// `SITES=2000 cargo test --release --test process hub::figures::many -- --ignored --nocapture`
#[test]
#[ignore = "minutes; prints figures"]
fn many_sites_come_back_together() {
    let Some((fleet, names)) = many(Storage::Postgres) else {
        return;
    };
    let sites = names.len();
    let address = format!("127.0.0.1:{}", fleet.nats_port());
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .unwrap();
    let jetstream = runtime.block_on(async { jetstream::new(async_nats::connect(address).await.unwrap()) });
    let originals = runtime.block_on(originals(&jetstream));
    let half = originals.len() / 2;
    let send = async |name: &str, (headers, payload): &Message| {
        let subject = format!("tirante.v1.out.{name}");
        let sent = jetstream.publish_with_headers(subject, headers.clone(), payload.clone());
        sent.await.unwrap()
    };
    let config = HubConfig::load(&fleet.config()).unwrap();
    let mut centre = hub::beside(&config.storage).unwrap();
    let mut folded = || u64::try_from(centre.position().unwrap().sequence).unwrap();

    let (before, (busy_before_s, _)) = (fleet.counted(), fleet.hub_usage());
    let begun = Instant::now();
    let last = runtime.block_on(async {
        let mut last = 0;
        for message in &originals[..half] {
            let mut sent = Vec::new();
            for name in &names {
                sent.push(send(name, message).await);
            }
            for ack in sent {
                last = ack.await.unwrap().sequence;
            }
        }
        last
    });
    let published_s = begun.elapsed().as_secs_f64();
    while folded() < last {
        thread::sleep(Duration::from_millis(5));
    }
    let (took_s, (busy_s, _)) = (begun.elapsed().as_secs_f64(), fleet.hub_usage());
    let after = fleet.counted();
    let (records, rows) = (after.0 - before.0, after.1 - before.1);

    let mut delays = Vec::new();
    let live = Duration::from_secs(60);
    let (begun, (live_before_s, _)) = (Instant::now(), fleet.hub_usage());
    let mut pages = Vec::new();
    for number in 0.. {
        let due = Duration::from_secs_f64(f64::from(number) / 17.0);
        if due > live {
            break;
        }
        thread::sleep(due.saturating_sub(begun.elapsed()));
        let place = number as usize % names.len();
        let Some(message) = originals.get(half + number as usize / names.len()) else {
            break;
        };
        let sent = Instant::now();
        let sequence = runtime.block_on(async { send(&names[place], message).await.await.unwrap().sequence });
        while folded() < sequence {
            thread::sleep(Duration::from_millis(2));
        }
        delays.push(sent.elapsed().as_secs_f64());
        if number % 170 == 0 {
            let asked = Instant::now();
            assert!(fleet.get("/").contains(&names[0]));
            pages.push(asked.elapsed().as_secs_f64());
        }
    }
    let lasted_s = begun.elapsed().as_secs_f64();
    let (live_s, peak_mb) = fleet.hub_usage();
    delays.sort_by(f64::total_cmp);
    let at = |share: f64| 1e3 * delays[((delays.len() - 1) as f64 * share) as usize];
    println!(
        "{sites} sites back together: {records} records, {rows} rows, published in {published_s:.1} s, folded after {took_s:.1} s: {:.0} records/s, \
         {:.2} ms of the hub's processor each\n\
         then {} messages at {:.1} a second: to the centre median {:.0} ms, 95 % {:.0}, 99 % {:.0}, longest {:.0}; hub {:.1} % of a core, \
         {peak_mb:.0} MB at most; list of all sites {:.0} ms at most",
        records as f64 / took_s,
        1e3 * (busy_s - busy_before_s) / records as f64,
        delays.len(),
        delays.len() as f64 / lasted_s,
        at(0.5),
        at(0.95),
        at(0.99),
        at(1.0),
        100.0 * (live_s - live_before_s) / lasted_s,
        1e3 * pages.iter().copied().fold(0.0, f64::max)
    );
    assert!(
        delays.len() > 30,
        "a site has too little to tell: {}",
        originals.len()
    );
}
