//! Figures of docs/hub.md: many sites that come back together after a month, beside others at work.
//! `SITES=2000 cargo test --test process hub::returning -- --ignored --nocapture`

use super::fleet::{Fleet, Storage, get, text_of};
use crate::site::Part;
use futures_util::future::join_all;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;
use tirante::config::settings::forward::ForwardSettings;
use tirante::config::{Config, HubConfig};
use tirante::service::forward::throttle::Throttle;
use tirante::service::forward::{Session, SessionError};
use tirante::service::hub;
use tirante::site::store::Reader;

/// Days of two rods that a site has recorded beside the campaign's: some 720 records, as many as the hours of a month.
const DAYS: usize = 304;
/// Sites at work.
const AT_WORK: usize = 100;
/// Their new commits while sites come back, afterwards (10 000 rods every ten minutes), and with five times reserve \[1/s\].
const RATES_HZ: [f64; 3] = [17.0, 17.0, 85.0];
/// Time of the second and of the third.
const LIVE: Duration = Duration::from_secs(60);

/// A new commit on its way.
struct Sent {
    site: String,
    commit: i64,
    /// Number of its message in the stream.
    sequence: u64,
    at: Instant,
    /// Number of its rate.
    phase: usize,
}

/// A site of the list, as far as it is looked at here.
#[derive(Deserialize)]
struct Listed {
    site: String,
    through: i64,
}

/// Sends the whole log under a site's name, as the daemon does.
async fn send_all(settings: &ForwardSettings, reader: &Reader) -> Result<(), SessionError> {
    let mut session = Session::open(settings, reader, false).await?;
    let mut throttle = Throttle::new(random::seed(&[settings.site.as_bytes()]));
    let latest = reader.latest_change()?;
    loop {
        session.hear(&mut throttle);
        let (waiting, now) = (latest - session.end().through, Instant::now());
        if waiting == 0 {
            return Ok(());
        }
        match throttle.wait(waiting, now) {
            Some(wait) => tokio::time::sleep(wait.min(Duration::from_secs(1))).await,
            None => {
                session.send_next(reader, throttle.most(waiting, now)).await?;
                throttle.sent(waiting, Instant::now());
            }
        }
    }
}

/// Sends one commit at a time, all sites at work together at the rate of the phase.
async fn send_new(
    settings: ForwardSettings,
    reader: &Reader,
    phase: &AtomicUsize,
    place: usize,
    new: Sender<Sent>,
) {
    let mut session = Session::open(&settings, reader, false).await.unwrap();
    let mut share = place as f64 / AT_WORK as f64;
    let mut at = Instant::now();
    loop {
        let phase = phase.load(Ordering::Relaxed);
        let due = at + Duration::from_secs_f64(share * AT_WORK as f64 / RATES_HZ[phase]);
        share = 1.0;
        tokio::time::sleep(due.saturating_duration_since(Instant::now())).await;
        at = Instant::now();
        let commit = session.send_next(reader, 1).await.unwrap();
        let sent = Sent {
            site: settings.site.clone(),
            commit: commit.expect("a site at work has told everything"),
            sequence: session.end().sequence,
            at,
            phase,
        };
        let _ = new.send(sent);
    }
}

/// Times from sending to the database, and to the hub's list of sites \[s\].
#[derive(Default)]
struct Delays {
    to_database: Vec<f64>,
    to_list: Vec<f64>,
}

/// Notes when new commits arrive, until all have that were sent; also returns the longest time of an answer with the list \[s\].
fn watch(config: &HubConfig, address: &str, new: &Receiver<Sent>) -> ([Delays; 3], f64) {
    let mut centre = hub::beside(&config.storage).unwrap();
    let mut delays = [(); 3].map(|()| Delays::default());
    let (mut coming, mut folded) = (Vec::<Sent>::new(), Vec::<Sent>::new());
    let (mut longest_s, mut asked) = (0.0_f64, Instant::now());
    let mut is_over = false;
    while !(is_over && coming.is_empty() && folded.is_empty()) {
        loop {
            match new.try_recv() {
                Ok(sent) => coming.push(sent),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    is_over = true;
                    break;
                }
            }
        }
        let position = u64::try_from(centre.position().unwrap().sequence).unwrap();
        for sent in coming.extract_if(.., |sent| sent.sequence <= position) {
            delays[sent.phase]
                .to_database
                .push(sent.at.elapsed().as_secs_f64());
            folded.push(sent);
        }
        if asked.elapsed() > Duration::from_millis(250) {
            asked = Instant::now();
            let answer = get(address, "/api/v1/sites");
            longest_s = longest_s.max(asked.elapsed().as_secs_f64());
            let (_, body) = answer.split_once("\r\n\r\n").unwrap();
            let listed: Vec<Listed> = serde_json::from_str(body).unwrap();
            let through: BTreeMap<String, i64> =
                listed.into_iter().map(|one| (one.site, one.through)).collect();
            for sent in folded.extract_if(.., |sent| sent.commit <= through[&sent.site]) {
                delays[sent.phase].to_list.push(sent.at.elapsed().as_secs_f64());
            }
        }
        thread::sleep(Duration::from_millis(5));
    }
    (delays, longest_s)
}

/// The share of them that is not longer \[s\].
fn at(delays: &[f64], share: f64) -> f64 {
    delays[((delays.len() - 1) as f64 * share) as usize]
}

#[test]
#[ignore = "minutes; prints figures"]
fn many_sites_come_back_together() {
    let count: usize = std::env::var("SITES").map_or(100, |text| text.parse().unwrap());
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Postgres) else {
        return;
    };
    fleet.edges[0].site.simulate("month", &Part::new(60, DAYS));
    let names = |kind: &str, count: usize| -> Vec<String> {
        (0..count).map(|number| format!("{kind}-{number:04}")).collect()
    };
    let (returning, at_work) = (names("back", count), names("work", AT_WORK));
    fleet.list_more(&[returning.clone(), at_work.clone()].concat());
    fleet.start();
    fleet.wait_until_read(0, 8);
    fleet.wait_until_sent();
    fleet.stop_edge(0);

    let site = &fleet.edges[0].site;
    let own = Config::load(&site.path("site.toml")).unwrap().forward.unwrap();
    let settings = |name: &String| ForwardSettings {
        site: name.clone(),
        ..own.clone()
    };
    let reader = Reader::open(&site.path("site.db")).unwrap();
    let commits = reader.latest_change().unwrap();
    let config = HubConfig::load(&fleet.config()).unwrap();
    let (phase, (sent, new)) = (AtomicUsize::new(0), channel());
    let watching = {
        let (config, address) = (config.clone(), fleet.address());
        thread::spawn(move || watch(&config, &address, &new))
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let of_one = fleet.counted();
    let (mut busy_s, mut took_s) = (vec![fleet.hub_usage().0], 0.0);
    runtime.block_on(async {
        let new = at_work.iter().enumerate();
        let new = new.map(|(place, name)| send_new(settings(name), &reader, &phase, place, sent.clone()));
        let back = async {
            let begun = Instant::now();
            join_all(returning.iter().map(async |name| {
                let settings = settings(name);
                // Whatever fails is tried again, as the daemon does.
                while let Err(error) = send_all(&settings, &reader).await {
                    println!("{name}: {error}");
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
            }))
            .await;
            loop {
                let storage = config.storage.clone();
                let ask = move || hub::beside(&storage).unwrap().sites().unwrap();
                let known = tokio::task::spawn_blocking(ask).await.unwrap();
                let through = |name: &String| known.get(name)?.history().map(|history| history.through);
                if returning.iter().all(|name| through(name) == Some(commits)) {
                    break;
                }
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
            took_s = begun.elapsed().as_secs_f64();
            for next in [1, 2] {
                busy_s.push(fleet.hub_usage().0);
                phase.store(next, Ordering::Relaxed);
                tokio::time::sleep(LIVE).await;
            }
            busy_s.push(fleet.hub_usage().0);
        };
        tokio::select! {
            _ = join_all(new) => {}
            () = back => {}
        }
    });
    drop(sent);
    let (mut delays, longest_s) = watching.join().unwrap();
    let records = count * of_one.0;
    println!(
        "{count} sites with {commits} commits each came back within {took_s:.0} s: {records} records and {} rows, {:.0} records/s, {:.2} ms \
         of the hub's processor each; {:.0} MB of the hub's memory; longest answer with the list {longest_s:.2} s",
        count * of_one.1,
        records as f64 / took_s,
        1e3 * (busy_s[1] - busy_s[0]) / records as f64,
        fleet.hub_usage().1,
    );
    for (place, delays) in delays.iter_mut().enumerate() {
        let mut told = format!(
            "{} new commits at {:.0} a second",
            delays.to_database.len(),
            RATES_HZ[place]
        );
        for (what, delays) in [
            ("database", &mut delays.to_database),
            ("list", &mut delays.to_list),
        ] {
            delays.sort_by(f64::total_cmp);
            let [half, most, nearly, all] = [0.5, 0.95, 0.99, 1.0].map(|share| at(delays, share));
            told += &format!(
                "; to the {what} median {half:.2} s, 95 % {most:.2}, 99 % {nearly:.2}, longest {all:.2}"
            );
        }
        let share =
            (busy_s[place + 1] - busy_s[place]) / if place == 0 { took_s } else { LIVE.as_secs_f64() };
        println!("{told}; hub {:.0} % of a core", 100.0 * share);
    }
    fleet.stop_hub();
    let (records, rows) = fleet.counted();
    let begun = Instant::now();
    let rebuilt = fleet.hub_command(&["rebuild"]);
    assert!(rebuilt.status.success(), "{}", text_of(&rebuilt.stderr));
    let took = begun.elapsed().as_secs_f64();
    println!(
        "rebuilt: {records} records, {rows} rows in {took:.0} s: {:.0} records/s; 10 million records: {:.2} h",
        records as f64 / took,
        1e7 * took / records as f64 / 3600.0
    );
    assert_eq!(fleet.counted(), (records, rows));
    assert!(
        at(&delays[0].to_database, 0.99) < 60.0,
        "what is new waited behind what is old"
    );
    assert!(took_s < 3600.0);
}
