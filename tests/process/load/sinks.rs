//! Twelve hours of dead sinks: data is analysed as fast as with healthy ones, and every alarm arrives in
//! order later.

use super::plant::{Plan, Plant, Take, wait};
use super::server::{Mood, Server};
use crate::survival::process::Process;
use std::fmt::Write;
use std::time::{Duration, Instant};

const RODS: usize = 6;
/// Twelve hours of a record a minute.
const RECORDS: usize = 720;
/// Number of bad records in a row, followed by as many good ones: an alarm is raised and cleared each time.
const BLOCK: usize = 6;
/// Largest factor on the time with dead sinks.
const SLOWER: f64 = 1.1;

const DEAD: [Mood; 4] = [
    Mood::Down,
    Mood::Hanging,
    Mood::Refusing("500 Broken\r\n"),
    Mood::Refusing("429 Too Many\r\nRetry-After: 2\r\n"),
];

/// A plant with four sinks in these moods, and its daemon.
fn plant(moods: [Mood; 4]) -> (Plant, [Server; 4], Process) {
    let servers = moods.map(Server::new);
    let mut more = String::from("settle_s = 3600\n[alarm]\nsensor_records = 3\nconfirm = 3\n");
    for (number, server) in servers.iter().enumerate() {
        write!(
            more,
            "[[sink]]\nid = \"s{number}\"\nkind = \"webhook\"\nurl = \"http://{}/\"\n",
            server.address
        )
        .unwrap();
    }
    let plant = Plant::new(Plan {
        rods: RODS,
        fs_hz: 100.0,
        window_s: 0.0,
        modes: 3,
        more,
        ..Plan::default()
    });
    let daemon = plant.start();
    (plant, servers, daemon)
}

/// Sends twelve hours through the socket, as fast as possible; returns the time until the last result \[s\].
fn twelve_hours(plant: &Plant, daemon: &mut Process) -> f64 {
    let mut special = String::new();
    for first in (BLOCK + 1..=RECORDS).step_by(2 * BLOCK) {
        let last = first + BLOCK - 1;
        write!(
            special,
            "[[simulation.rod.fault]]\nkind = \"held\"\nat_s = 3.0\nlength_s = 20.0\nfirst_record = {first}\nlast_record = {last}\n"
        )
        .unwrap();
    }
    plant.simulate(&Take {
        name: "half-day",
        rods: 0..RODS,
        records: RECORDS,
        interval_s: 60.0,
        record_s: 30.0,
        samples_per_message: 100,
        special: &special,
        ..Take::default()
    });
    let begun = Instant::now();
    let sender = plant.send("tower", &["half-day.mcap"], &["--speed", "max"]);
    wait(daemon, "all records are there", Duration::from_secs(600), || {
        plant.count("SELECT count(*) FROM record") == (RODS * RECORDS) as i64
    });
    let took_s = begun.elapsed().as_secs_f64();
    sender.finish();
    took_s
}

/// Ids in the order of the outbox.
fn told(plant: &Plant) -> Vec<(String, String)> {
    let store = plant.store();
    let mut statement = store
        .prepare("SELECT alarm, what FROM outbox ORDER BY number")
        .unwrap();
    let rows = statement
        .query_map((), |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap();
    rows.map(Result::unwrap).collect()
}

/// Waits until a sink has all events; returns the number that came more than once.
fn arrived(daemon: &mut Process, server: &Server, news: &[(String, String)]) -> usize {
    let mut seen: Vec<String> = Vec::new();
    let mut repeated = 0;
    let mut read = 0;
    let until = Instant::now() + Duration::from_secs(900);
    while seen.len() < news.len() {
        assert!(daemon.is_running(), "ended:\n{}", daemon.log());
        assert!(Instant::now() < until, "{} of {} arrived", seen.len(), news.len());
        let bodies = server.taken();
        for body in &bodies[read..] {
            let body: serde_json::Value = serde_json::from_str(body).unwrap();
            let id = body["id"].as_str().unwrap().to_owned();
            if seen.contains(&id) {
                repeated += 1;
                continue;
            }
            let (alarm, _) = &news[seen.len()];
            assert_eq!(body["alarm"], **alarm, "news {} out of order", seen.len());
            seen.push(id);
        }
        read = bodies.len();
        std::thread::sleep(Duration::from_millis(100));
    }
    repeated
}

#[test]
#[ignore = "minutes"]
fn twelve_hours_of_dead_sinks() {
    // Twice each, the better one counts: other work on the machine slows either.
    let (mut well_s, mut dead_s) = (f64::INFINITY, f64::INFINITY);
    let mut expected = Vec::new();
    for _ in 0..2 {
        let (healthy, _servers, mut daemon) = plant([Mood::Well; 4]);
        well_s = well_s.min(twelve_hours(&healthy, &mut daemon));
        expected = told(&healthy);
        daemon.stop("-TERM");
        let (dead, _servers, mut daemon) = plant(DEAD);
        dead_s = dead_s.min(twelve_hours(&dead, &mut daemon));
        daemon.stop("-TERM");
    }
    let (dead, servers, mut daemon) = plant(DEAD);
    dead_s = dead_s.min(twelve_hours(&dead, &mut daemon));
    let news = told(&dead);
    let records = (RODS * RECORDS) as f64;
    println!(
        "{records} records, {} news: {:.0} records a second with healthy sinks, {:.0} with dead ones",
        news.len(),
        records / well_s,
        records / dead_s
    );
    // The order of two rods' news is that in which their records came out of the journal; each rod's own is fixed.
    let sorted = |mut news: Vec<(String, String)>| {
        news.sort();
        news
    };
    assert!(sorted(news.clone()) == sorted(expected), "not the same news");
    assert!(news.len() > RODS * RECORDS / (3 * BLOCK), "{}", news.len());
    assert!(servers.iter().all(|server| server.taken().is_empty()));

    for server in &servers {
        server.heal();
    }
    for (server, mood) in servers.iter().zip(DEAD) {
        let begun = Instant::now();
        let repeated = arrived(&mut daemon, server, &news);
        println!(
            "  {mood:?}: refused {}, then all {} in order, {repeated} repeated, {:.0} s after it was back",
            server.refused(),
            news.len(),
            begun.elapsed().as_secs_f64()
        );
    }
    assert!(dead_s < SLOWER * well_s, "{dead_s} s and {well_s} s");
    daemon.stop("-TERM");
}
