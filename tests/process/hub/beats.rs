//! Heartbeats: a site with nothing to send is heard, its silence is told once, and one that is forged is no sign of life.

use super::fleet::{Fleet, Storage};
use super::servers::DEADLINE;
use crate::site::lines;
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Takes what a webhook posts; returns its address and the messages so far.
pub fn desk() -> (String, Arc<Mutex<Vec<Value>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/", listener.local_addr().unwrap());
    let came = Arc::<Mutex<Vec<Value>>>::default();
    let takes = Arc::clone(&came);
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut reader = BufReader::new(stream.unwrap());
            let (mut line, mut length) = (String::new(), 0);
            while reader.read_line(&mut line).unwrap() > 2 {
                if let Some(text) = line.to_ascii_lowercase().strip_prefix("content-length:") {
                    length = text.trim().parse().unwrap();
                }
                line.clear();
            }
            let mut body = vec![0; length];
            reader.read_exact(&mut body).unwrap();
            takes.lock().unwrap().push(serde_json::from_slice(&body).unwrap());
            let answer = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
            reader.get_mut().write_all(answer).unwrap();
        }
    });
    (address, came)
}

/// The list's row of a site.
pub fn row(fleet: &Fleet, name: &str) -> Value {
    let sites = lines(&fleet.hub_command(&["sites", "--format", "json"]).stdout);
    let row = sites.into_iter().find(|site| site["site"] == name);
    row.unwrap_or_default()
}

pub fn wait(fleet: &Fleet, what: &str, mut is_so: impl FnMut() -> bool) {
    let until = Instant::now() + DEADLINE;
    while !is_so() {
        assert!(Instant::now() < until, "not so: {what}\n{}", fleet.log());
        thread::sleep(Duration::from_millis(200));
    }
}

/// Publishes without a library of the program's own.
pub fn publish(fleet: &Fleet, subject: &'static str, payload: String) {
    let address = format!("127.0.0.1:{}", fleet.nats_port());
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let client = async_nats::connect(address).await.unwrap();
        client.publish(subject, payload.into()).await.unwrap();
        client.flush().await.unwrap();
    });
}

#[test]
fn a_site_with_nothing_to_send_is_heard_and_its_silence_is_told_once() {
    let Some(mut fleet) = Fleet::of(&["todi", "gubbio"], Storage::Sqlite) else {
        return;
    };
    let (address, came) = desk();
    fleet.reconfigure_hub(|text| {
        text.replace("[[site]]\n", "[[site]]\nsilent_h = 0.004\n")
            + &format!(
                "[alert]\nsettle_s = 0.0\n[outbox]\npath = \"{}\"\n[[sink]]\nid = \"desk\"\nkind = \"webhook\"\nurl = \"{address}\"\n",
                fleet.path("outbox.db").display()
            )
    });
    fleet.start();
    fleet.wait_until_equal();
    for name in ["todi", "gubbio"] {
        wait(&fleet, "all its commits have come", || {
            row(&fleet, name)["behind"] == 0
        });
        let row = row(&fleet, name);
        assert_eq!(row["version"], env!("CARGO_PKG_VERSION"), "{row}");
        // Records were refused a moment ago.
        assert!(row["state"] == "ok" || row["state"] == "degraded", "{row}");
        assert_eq!(
            (&row["clock_off_s"], &row["stopped_since"]),
            (&Value::Null, &Value::Null),
            "{row}"
        );
    }
    // Nothing is sent any more: it is the heartbeats that are heard for twice the limit.
    thread::sleep(Duration::from_secs(30));
    let told = |what: &str, kind: &str| -> Vec<String> {
        let came = came.lock().unwrap();
        // What a hub was killed over, before it noted the delivery, comes again under its id.
        let mut ids = BTreeSet::new();
        let of = came.iter().filter(|one| {
            one["what"] == what && one["kind"] == kind && ids.insert(one["id"].as_str().unwrap())
        });
        of.map(|one| one["about"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(told("raised", "silent"), [""; 0], "{}", fleet.log());
    fleet.stop_edge(1);
    // Junk on its subject is no sign of life, and ends nothing.
    let before = fleet.hub_logged();
    publish(&fleet, "tirante.v1.beat.gubbio", "junk".to_owned());
    publish(&fleet, "tirante.v1.beat.other", "{}".to_owned());
    fleet.wait_for_hub_log(before, "a heartbeat cannot be read");
    wait(&fleet, "its silence is told", || {
        told("raised", "silent") == ["gubbio"]
    });
    let silent = row(&fleet, "gubbio");
    assert!(silent["silent_since"].is_string(), "{silent}");
    assert!(fleet.get("/").contains("silent since"));
    assert!(
        fleet
            .get("/metrics")
            .contains("tirante_site_silent{site=\"gubbio\"} 1")
    );
    // A hub that begins again knows that it was told, and does not end it.
    fleet.kill_hub();
    fleet.wait_for_hub_log(before, "ready: 2 sites");
    thread::sleep(Duration::from_secs(3));
    assert_eq!(
        (told("raised", "silent"), told("cleared", "silent").len()),
        (vec!["gubbio".to_owned()], 0)
    );
    fleet.start_edge(1);
    wait(&fleet, "its end is told", || {
        told("cleared", "silent") == ["gubbio"]
    });
    // A clock that is two minutes ahead.
    fleet.stop_edge(1);
    let ns = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos() as i64 + 120_000_000_000;
    let (epoch, through) = fleet.end_of(1);
    let beat = serde_json::json!({ "time_ns": ns, "epoch": epoch, "through": through + 3, "version": "0.1.0", "state": "failing",
        "rods": {}, "stopped_since": "2026-01-05T00:00:00Z", "conditions": [] });
    publish(&fleet, "tirante.v1.beat.gubbio", beat.to_string());
    wait(&fleet, "its clock is told", || {
        told("raised", "clock") == ["gubbio"]
    });
    let off = row(&fleet, "gubbio");
    let off_s = off["clock_off_s"].as_f64().unwrap();
    assert!((100.0..121.0).contains(&off_s), "{off}");
    assert_eq!(
        (&off["behind"], &off["stopped_since"]),
        (&Value::from(3), &Value::from("2026-01-05T00:00:00Z"))
    );
    let silent = told("raised", "silent");
    assert!(silent.iter().all(|name| name == "gubbio"), "{silent:?}");
    // However many there were: the post keeps the latest of each subject.
    let kept = fleet.messages_of("TIRANTE_BEAT");
    assert!((1..=3).contains(&kept), "{kept} heartbeats at the post");
}
