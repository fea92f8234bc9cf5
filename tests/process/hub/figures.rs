//! Figures of docs/hub.md: cost at a site, delay from record to centre, rate of folding.
//! `cargo test --test process hub::figures -- --ignored --nocapture --test-threads 1`

use super::fleet::{Fleet, Storage};
use async_nats::jetstream;
use std::fs;
use std::thread;
use std::time::{Duration, Instant};

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

/// Rate of folding: a site's messages, one commit each as they come from a site at work, under many names.
#[test]
#[ignore = "minutes; prints figures"]
fn rate_of_folding() {
    let sites: usize = std::env::var("SITES").map_or(100, |text| text.parse().unwrap());
    let names: Vec<String> = (0..sites).map(|number| format!("site-{number:04}")).collect();
    for storage in [Storage::Postgres, Storage::Sqlite] {
        let Some(mut fleet) = Fleet::of(&["todi"], storage) else {
            return;
        };
        fleet.list_more(&names);
        fleet.start();
        fleet.wait_until_equal();
        fleet.stop_edge(0);
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
