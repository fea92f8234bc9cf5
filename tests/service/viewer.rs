//! Robotics viewers: the live view over a real WebSocket, and the file of results that `replay` writes, both
//! with the numbers of `history`.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::server::Server;
use crate::site::{Part, SITE, Site, campaign, lines};
use serde_json::{Value as Json, json};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, ErrorKind};
use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use tirante::analysis::signal::record::RodId;
use tirante::service::viewer::{self, Feed, Topic};
use tirante::site::store::{Durability, Reader, Store};
use tirante::{Config, Event, Others, Records};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message as Frame, WebSocket};

/// Longest wait on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Connects a viewer; the status of the answer if it is refused.
fn connect(server: &Server, protocol: &str, origin: Option<&str>) -> Result<Viewer, u16> {
    connect_to(server.address, protocol, origin)
}

fn connect_to(address: SocketAddr, protocol: &str, origin: Option<&str>) -> Result<Viewer, u16> {
    let mut request = format!("ws://{address}/viewer").into_client_request().unwrap();
    let headers = request.headers_mut();
    if !protocol.is_empty() {
        headers.insert("Sec-WebSocket-Protocol", protocol.parse().unwrap());
    }
    if let Some(origin) = origin {
        headers.insert("Origin", origin.parse().unwrap());
    }
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    match tungstenite::client(request, stream) {
        Ok((socket, answer)) => {
            assert_eq!(answer.headers()["Sec-WebSocket-Protocol"], protocol);
            Ok(Viewer {
                socket,
                channels: BTreeMap::new(),
            })
        }
        Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
            Err(answer.status().as_u16())
        }
        Err(error) => panic!("{error}"),
    }
}

struct Viewer {
    socket: WebSocket<TcpStream>,
    /// Advertised topics, by name.
    channels: BTreeMap<String, Json>,
}

/// Message of a server.
enum Said {
    Text(Json),
    /// The subscription, the time of sending [ns], and the message.
    Data(u32, u64, Json),
}

impl Viewer {
    fn next(&mut self) -> Said {
        loop {
            match self.socket.read().unwrap() {
                Frame::Text(text) => {
                    let said: Json = serde_json::from_str(&text).unwrap();
                    if said["op"] == "advertise" {
                        for channel in said["channels"].as_array().unwrap() {
                            let topic = channel["topic"].as_str().unwrap().to_owned();
                            assert_eq!(self.channels.insert(topic, channel.clone()), None);
                        }
                    }
                    return Said::Text(said);
                }
                Frame::Binary(frame) => {
                    assert_eq!(frame[0], 1);
                    let subscription = u32::from_le_bytes(frame[1..5].try_into().unwrap());
                    let told = u64::from_le_bytes(frame[5..13].try_into().unwrap());
                    return Said::Data(subscription, told, serde_json::from_slice(&frame[13..]).unwrap());
                }
                Frame::Ping(_) | Frame::Pong(_) => {}
                other => panic!("{other:?}"),
            }
        }
    }

    fn text(&mut self) -> Json {
        match self.next() {
            Said::Text(said) => said,
            Said::Data(..) => panic!("nothing was subscribed to"),
        }
    }

    fn say(&mut self, said: &Json) {
        self.socket.send(Frame::text(said.to_string())).unwrap();
    }

    /// Reads until this topic is advertised.
    fn channel(&mut self, topic: &str) -> Json {
        while !self.channels.contains_key(topic) {
            self.text();
        }
        self.channels[topic].clone()
    }

    fn subscribe(&mut self, id: u32, topic: &str) {
        let channel = self.channel(topic)["id"].clone();
        self.say(&json!({"op": "subscribe", "subscriptions": [{"id": id, "channelId": channel}]}));
    }

    /// The next message of a subscription, checked against its schema's keys.
    fn message(&mut self, id: u32, topic: &str) -> Json {
        loop {
            if let Said::Data(subscription, told, body) = self.next()
                && subscription == id
            {
                assert!(told > 1_700_000_000_000_000_000, "{told}");
                check(&body, self.channels[topic]["schema"].as_str().unwrap());
                return body;
            }
        }
    }
}

fn check(body: &Json, schema: &str) {
    let schema: Json = serde_json::from_str(schema).unwrap();
    for key in body.as_object().unwrap().keys() {
        assert!(
            schema["properties"].get(key).is_some(),
            "{key} is not in the schema"
        );
    }
}

fn replayed() -> Site {
    let site = Site::new(SITE);
    site.simulate("0", &Part::new(0, 4));
    site.replay(&["archive"], "site.db");
    site
}

fn last_record(site: &Site, rod: &str) -> Json {
    let records = site.history("site.db", "records");
    records.into_iter().rfind(|line| line["rod"] == rod).unwrap()
}

fn assert_force(force: &Json, record: &Json) {
    let start =
        serde_json::from_value::<tirante::analysis::signal::record::Timestamp>(record["start"].clone())
            .unwrap();
    let nanos = force["timestamp"]["sec"].as_i64().unwrap() * 1_000_000_000
        + force["timestamp"]["nsec"].as_i64().unwrap();
    assert_eq!(nanos, start.as_nanos());
    assert!(force["axial_force_n"]["mean"].is_number(), "{force}");
    for key in ["axial_force_n", "relative_force", "temperature_c", "state"] {
        assert_eq!(force[key], record[key], "{key}");
    }
}

#[test]
fn a_viewer_sees_what_stands_and_then_what_comes() {
    let site = replayed();
    let server = Server::of(&site, "site.db");
    let mut viewer = connect(&server, "foxglove.sdk.v1", None).unwrap();
    let info = viewer.text();
    assert_eq!(
        (&info["op"], info["name"].is_string()),
        (&json!("serverInfo"), true)
    );
    let alarms = viewer.channel("/tirante/alarms");
    assert_eq!(alarms["schemaName"], "foxglove.Log");
    assert_eq!(viewer.channels.len(), 9, "{:?}", viewer.channels.keys());

    let topics = ["force", "modes", "waveform", "spectrum"].map(|what| format!("/tirante/south/{what}"));
    for (id, topic) in (10..).zip(&topics) {
        viewer.subscribe(id, topic);
    }
    let record = last_record(&site, "south");
    assert_force(&viewer.message(10, &topics[0]), &record);
    assert_eq!(viewer.message(11, &topics[1])["modes"], record["modes"]);
    let waveform = viewer.message(12, &topics[2]);
    assert_eq!(waveform["unit"], "m");
    let columns = ["time_s", "low", "high"].map(|column| waveform[column].as_array().unwrap().len());
    assert!(columns[0] > 100 && columns == [columns[0]; 3], "{columns:?}");
    let spectrum = viewer.message(13, &topics[3]);
    let looks = server.get("/api/v1/rods/south/latest");
    assert_eq!(spectrum["level_db"], looks["latest"]["curve"]["level_db"]);
    // The highest point of the spectrum is at the frequency of a mode, to a line and a half.
    let level = |i: usize| spectrum["level_db"][i].as_f64().unwrap();
    let highest = (1..spectrum["level_db"].as_array().unwrap().len())
        .max_by(|i, j| level(*i).total_cmp(&level(*j)))
        .unwrap();
    let at = spectrum["frequency_hz"][highest].as_f64().unwrap();
    let step = looks["latest"]["curve"]["step_hz"].as_f64().unwrap();
    let is_mode = |mode: &Json| (mode["frequency_hz"].as_f64().unwrap() - at).abs() < 1.5 * step;
    assert!(record["modes"].as_array().unwrap().iter().any(is_mode), "{at}");

    // After unsubscribing, only the new record comes, complete.
    viewer.say(&json!({"op": "unsubscribe", "subscriptionIds": [11]}));
    site.simulate("later", &Part::new(4, 1));
    site.replay(&["archive"], "site.db");
    let mut seen = BTreeMap::new();
    while seen.len() < 3 {
        match viewer.next() {
            Said::Data(id, _, body) => assert_eq!(seen.insert(id, body), None, "{id} came twice"),
            Said::Text(said) => panic!("{said}"),
        }
    }
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [10, 12, 13]);
    let record = last_record(&site, "south");
    assert_force(&seen[&10], &record);
    for id in [12, 13] {
        assert_eq!(seen[&id]["timestamp"], seen[&10]["timestamp"]);
    }
}

#[test]
fn a_picture_that_stands_is_not_told_again_and_a_commit_is_told_once() {
    let mut store = Store::in_memory().unwrap();
    crate::archive::fill(&mut store, 0..18);
    let rod = RodId("south è".to_owned());
    let wanted: BTreeSet<Topic> = Topic::of_rod(&rod).into_iter().collect();
    let mut feed = Feed::new(&store).unwrap();
    for topic in Topic::of_rod(&rod) {
        let standing = viewer::standing(&store, &topic).unwrap();
        assert!(standing.iter().all(|message| message.topic == topic));
        feed.told(&standing);
    }
    let mut told = |store: &Store| -> Vec<Topic> {
        let news = feed.news(store, &wanted).unwrap();
        assert_eq!((news.left_out, news.is_other_store), (0, false));
        news.messages.into_iter().map(|message| message.topic).collect()
    };
    // The rod's record 19 is rejected: a force message reports it, and the snapshot of record 17 is not sent again.
    crate::archive::fill(&mut store, 18..20);
    assert_eq!(told(&store), [Topic::Force(rod.clone())]);
    assert_eq!(told(&store), []);
    crate::archive::fill(&mut store, 20..22);
    let news = told(&store);
    assert_eq!(
        news.iter()
            .filter(|topic| matches!(topic, Topic::Spectrum(_)))
            .count(),
        1
    );
    assert_eq!(told(&store), []);
    // Far more than is sent at once.
    crate::archive::fill(&mut store, 22..700);
    let news = feed.news(&store, &wanted).unwrap();
    assert_eq!(news.left_out, 178);
}

#[test]
fn another_store_in_its_place_is_told_from_its_beginning() {
    let folder = tempfile::tempdir().unwrap();
    let reader = |name: &str, records: i64| {
        let path = folder.path().join(name);
        crate::archive::fill(&mut Store::open(&path, Durability::Replay).unwrap(), 0..records);
        Reader::open(&path).unwrap()
    };
    let (first, second) = (reader("first.db", 10), reader("second.db", 45));
    let wanted: BTreeSet<Topic> = Feed::topics(&first).unwrap().into_iter().collect();
    let mut feed = Feed::new(&first).unwrap();
    let news = feed.news(&second, &wanted).unwrap();
    assert!(news.is_other_store);
    let count = |is: fn(&Topic) -> bool| news.messages.iter().filter(|message| is(&message.topic)).count();
    assert_eq!(count(|topic| matches!(topic, Topic::Force(_))), 45);
    assert_eq!(count(|topic| matches!(topic, Topic::Alarms)), 1);
    let news = feed.news(&second, &wanted).unwrap();
    assert!(!news.is_other_store && news.messages.is_empty());
}

#[test]
fn rods_and_alarms_that_come_later_are_told() {
    let site = campaign();
    // The first weeks, of a site that has only one rod yet.
    let second = SITE.rfind("[[rod]]").unwrap();
    let alone = format!("{}{}", &SITE[..second], &SITE[SITE.find("[abc]").unwrap()..]);
    std::fs::write(site.path("alone.toml"), alone).unwrap();
    let weeks = ["archive/week-0.mcap", "archive/week-1.mcap"];
    let words = [
        "replay",
        weeks[0],
        weeks[1],
        "--config",
        "alone.toml",
        "--store",
        "site.db",
    ];
    let output = site.run(&words);
    assert!(
        output.status.code().is_some_and(|code| code == 0 || code == 3),
        "{output:?}"
    );

    let server = Server::of(&site, "site.db");
    let mut viewer = connect(&server, "foxglove.websocket.v1", Some("https://viewer.example")).unwrap();
    viewer.subscribe(1, "/tirante/alarms");
    viewer.channel("/tirante/north/force");
    assert!(!viewer.channels.contains_key("/tirante/south/force"));
    site.replay(&["archive"], "site.db");
    let until = Instant::now() + PATIENCE;
    let drift = loop {
        assert!(Instant::now() < until, "no drift is told");
        if let Said::Data(1, _, log) = viewer.next()
            && log["message"].as_str().unwrap().starts_with("drift")
        {
            break log;
        }
    };
    assert!(viewer.channels.contains_key("/tirante/south/force"));
    assert_eq!((&drift["level"], &drift["name"]), (&json!(3), &json!("north")));
    let alarms = site.history("site.db", "alarms");
    let alarm = alarms.iter().find(|alarm| alarm["id"] == drift["file"]).unwrap();
    assert_eq!(
        (&alarm["kind"], &alarm["rod"]),
        (&json!("drift"), &json!("north"))
    );
    // A new client gets the active alarms.
    let mut late = connect(&server, "foxglove.sdk.v1", None).unwrap();
    late.subscribe(7, "/tirante/alarms");
    let standing = alarms.iter().filter(|alarm| alarm["cleared"].is_null());
    let ids: Vec<Json> = standing
        .map(|_| late.message(7, "/tirante/alarms")["file"].clone())
        .collect();
    assert!(ids.contains(&drift["file"]), "{ids:?}");
}

#[test]
fn strangers_and_what_makes_no_sense_are_told_why() {
    let site = replayed();
    let server = Server::of(&site, "site.db");
    assert_eq!(connect(&server, "", None).err(), Some(400));
    assert_eq!(connect(&server, "mqtt", None).err(), Some(400));
    let sdk = "foxglove.sdk.v1";
    assert_eq!(
        connect(&server, sdk, Some("https://evil.example")).err(),
        Some(403)
    );
    assert_eq!(connect(&server, sdk, Some("null")).err(), Some(403));
    assert_eq!(connect(&server, sdk, Some("file://")).err(), Some(403));
    assert_eq!(server.refused("/viewer"), 400);
    let own = format!("http://{}", server.address);
    let mut viewer = connect(&server, sdk, Some(&own)).unwrap();
    viewer.channel("/tirante/alarms");
    for (said, answer) in [
        (
            json!({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}),
            "no channel 99",
        ),
        (json!({"op": "setParameters", "parameters": []}), "takes nothing"),
        (json!({"op": "subscribe"}), "not understood"),
        (json!([1, 2]), "not understood"),
    ] {
        viewer.say(&said);
        let status = viewer.text();
        assert_eq!(status["op"], "status");
        assert!(status["message"].as_str().unwrap().contains(answer), "{status}");
    }
    // One subscription a channel, and one channel a subscription.
    viewer.subscribe(5, "/tirante/north/force");
    viewer.message(5, "/tirante/north/force");
    for (id, topic, answer) in [
        (6, "/tirante/north/force", "already"),
        (5, "/tirante/south/force", "of another channel"),
    ] {
        viewer.subscribe(id, topic);
        let status = viewer.text();
        assert!(status["message"].as_str().unwrap().contains(answer), "{status}");
    }
    viewer.say(&json!({"op": "unsubscribe", "subscriptionIds": [5]}));
    // Too much at once ends this viewer, and it alone.
    let mut loud = connect(&server, sdk, None).unwrap();
    let _ = loud.socket.send(Frame::text("x".repeat(1 << 20)));
    assert_cut_off(&mut loud);
    viewer.subscribe(5, "/tirante/south/force");
    viewer.message(5, "/tirante/south/force");
}

/// Checks that the server ends the connection; silence for a while is not enough.
fn assert_cut_off(viewer: &mut Viewer) {
    loop {
        match viewer.socket.read() {
            Ok(_) => {}
            Err(tungstenite::Error::Io(error)) => {
                let is_silent = matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut);
                assert!(!is_silent, "it goes on");
                return;
            }
            Err(_) => return,
        }
    }
}

#[test]
fn a_viewer_that_takes_nothing_holds_up_nobody() {
    let site = replayed();
    let server = Server::of(&site, "site.db");
    let mut slow = connect(&server, "foxglove.sdk.v1", None).unwrap();
    // A picture each time, far more than the buffers between hold: it takes in none of them.
    let channel = slow.channel("/tirante/north/waveform")["id"].clone();
    let asked = Instant::now();
    for _ in 0..2000 {
        let subscribe = json!({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel}]});
        let unsubscribe = json!({"op": "unsubscribe", "subscriptionIds": [1]});
        let mut say = |said: &Json| slow.socket.send(Frame::text(said.to_string()));
        if say(&subscribe).and_then(|()| say(&unsubscribe)).is_err() {
            // It is cut off already.
            break;
        }
    }

    let mut quick = connect(&server, "foxglove.sdk.v1", None).unwrap();
    quick.subscribe(1, "/tirante/north/force");
    quick.message(1, "/tirante/north/force");
    for day in 4..6 {
        site.simulate(&format!("day-{day}"), &Part::new(day, 1));
        site.replay(&["archive"], "site.db");
        // The slow client is kept for eight seconds; the others do not wait as long.
        let begun = Instant::now();
        assert_force(
            &quick.message(1, "/tirante/north/force"),
            &last_record(&site, "north"),
        );
        server.get("/api/v1/site");
        assert!(begun.elapsed() < Duration::from_secs(6), "{:?}", begun.elapsed());
    }
    // It reads long after: the content of the buffers, and then the end, since it was cut off.
    std::thread::sleep(Duration::from_secs(40).saturating_sub(asked.elapsed()));
    assert_cut_off(&mut slow);
}

/// `tirante run` with sockets of its own, killed when this is dropped.
struct Daemon {
    child: Child,
    page: SocketAddr,
    socket: String,
}

impl Daemon {
    fn start(site: &Site) -> Self {
        let more = "[store]\npath = \"site.db\"\n[http]\nlisten = \"127.0.0.1:0\"\n[ingest]\nlisten = [\"tcp://127.0.0.1:0\"]\n";
        std::fs::write(site.path("run.toml"), format!("{SITE}{more}")).unwrap();
        let mut command = site.command(&["run", "--config", "run.toml"]);
        let mut child = command
            .env("TIRANTE_LOG", "info")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (mut page, mut socket, mut is_ready) = (None, None, false);
        let mut log = BufReader::new(child.stderr.take().unwrap()).lines();
        for line in log.by_ref().map_while(Result::ok) {
            let after = |words: &str| {
                let rest = line.split(words).nth(1)?;
                rest.split_whitespace().next().map(str::to_owned)
            };
            page = page.or_else(|| after("metrics at http://"));
            socket = socket.or_else(|| after("listening at "));
            is_ready |= line.contains("ready");
            // The socket's line may come after it.
            if is_ready && page.is_some() && socket.is_some() {
                break;
            }
        }
        // The log goes on, and a full pipe would stop the daemon.
        std::thread::spawn(move || log.map_while(Result::ok).for_each(drop));
        Self {
            child,
            page: page.expect("the page").parse().unwrap(),
            socket: socket.expect("the socket"),
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn who_asks_for_a_signal_gets_every_sample_that_comes() {
    let site = Site::new(SITE);
    site.simulate("first", &Part::new(0, 1));
    let daemon = Daemon::start(&site);
    let mut viewer = connect_to(daemon.page, "foxglove.sdk.v1", None).unwrap();
    // Offered before any record, and not of a store without a daemon.
    viewer.subscribe(1, "/tirante/north/signal");
    viewer.channel("/tirante/south/signal");
    let words = [
        "send",
        "archive/first.mcap",
        "--to",
        &daemon.socket,
        "--sender",
        "nave",
    ];
    // The answer to a request that makes no sense comes after the subscription was taken.
    viewer.say(&json!({"op": "subscribe", "subscriptions": [{"id": 2, "channelId": 99}]}));
    while !viewer.text()["message"]
        .as_str()
        .is_some_and(|said| said.contains("99"))
    {}
    let output = site.run(&[&words[..], &["--speed", "max"]].concat());
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let config = Config::parse(SITE, "site.toml").unwrap();
    let record = Records::open(&[site.path("archive/first.mcap")], &config, Others::default())
        .find_map(|event| match event {
            Event::Record(record) if record.rod.0 == "north" => Some(record),
            _ => None,
        })
        .unwrap();
    assert!(record.samples.len() > 1000, "{}", record.samples.len());
    for (i, value) in record.samples.iter().enumerate() {
        let nanos = record.start.plus_seconds(i as f64 / record.fs_hz).as_nanos();
        let heard = viewer.message(1, "/tirante/north/signal");
        // A number read back from JSON may be one unit of the last place off.
        let off = (heard["value"].as_f64().unwrap() - value).abs();
        assert!(off <= f64::EPSILON * value.abs(), "sample {i}: {heard} {value}");
        assert_eq!(
            (&heard["unit"], &heard["header"]["frame_id"]),
            (&json!("m"), &json!("north"))
        );
        assert_eq!(heard["header"]["stamp"], heard["timestamp"]);
        let stamp = &heard["timestamp"];
        let at = stamp["sec"].as_i64().unwrap() * 1_000_000_000 + stamp["nsec"].as_i64().unwrap();
        // Stamps are computed from the first one of a message and the rate.
        assert!((at - nanos).abs() <= 1000, "sample {i}: {at} {nanos}");
    }
    // A store without a daemon has no live signal.
    let server = Server::of(&site, "site.db");
    let mut viewer = connect(&server, "foxglove.sdk.v1", None).unwrap();
    viewer.channel("/tirante/alarms");
    assert!(!viewer.channels.keys().any(|topic| topic.ends_with("/signal")));
}

#[test]
fn the_file_of_results_has_what_history_has() {
    let site = Site::new(SITE);
    site.simulate("0", &Part::new(0, 4));
    let words = [
        "replay",
        "archive",
        "--config",
        "site.toml",
        "--store",
        "site.db",
        "--results",
        "results.mcap",
    ];
    let output = site.run(&words);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let bytes = std::fs::read(site.path("results.mcap")).unwrap();
    let mut found: BTreeMap<String, Vec<Json>> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let body: Json = serde_json::from_slice(&message.data).unwrap();
        let schema = message.channel.schema.clone().unwrap();
        check(&body, std::str::from_utf8(&schema.data).unwrap());
        let stamp = &body["timestamp"];
        let nanos = stamp["sec"].as_u64().unwrap() * 1_000_000_000 + stamp["nsec"].as_u64().unwrap();
        assert_eq!(nanos, message.log_time);
        found.entry(message.channel.topic.clone()).or_default().push(body);
    }
    for rod in ["north", "south"] {
        let records: Vec<Json> = site
            .history("site.db", "records")
            .into_iter()
            .filter(|line| line["rod"] == rod)
            .collect();
        assert_eq!(records.len(), 4);
        let of = |what: &str| &found[&format!("/tirante/{rod}/{what}")];
        for what in ["force", "modes", "waveform", "spectrum"] {
            assert_eq!(of(what).len(), 4, "{rod} {what}");
        }
        for (force, record) in of("force").iter().zip(&records) {
            assert_force(force, record);
        }
        for (modes, record) in of("modes").iter().zip(&records) {
            assert_eq!(modes["modes"], record["modes"]);
        }
    }
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("results: 8 records in results.mcap"), "{said}");
    // An existing file is kept; a file that cannot be written is reported before anything is read.
    let again = site.run(&words);
    assert_eq!(again.status.code(), Some(2));
    assert_eq!(std::fs::read(site.path("results.mcap")).unwrap(), bytes);
    let words = [
        "replay",
        "archive",
        "--config",
        "site.toml",
        "--results",
        "nowhere/results.mcap",
    ];
    let refused = site.run(&words);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("nowhere/results.mcap"));
    assert!(lines(&refused.stdout).is_empty());
}

/// The same results as JSON, protobuf and CDR, each read by the schema in its own file.
#[test]
fn results_say_the_same_in_every_encoding() {
    let site = Site::new(SITE);
    site.simulate("0", &Part::new(0, 2));
    let read = |encoding: &str, decode: fn(&str, &[u8], &[u8]) -> Json| -> Vec<(String, Json)> {
        let file = format!("{encoding}.mcap");
        let words = ["replay", "archive", "--config", "site.toml", "--results", &file];
        let output = site.run(&[&words[..], &["--results-encoding", encoding]].concat());
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let bytes = std::fs::read(site.path(&file)).unwrap();
        let messages = mcap::MessageStream::new(&bytes).unwrap().map(|message| {
            let message = message.unwrap();
            let schema = message.channel.schema.clone().unwrap();
            let text = String::from_utf8_lossy(&schema.data).into_owned();
            assert!(
                text.contains("axial force of this record alone, at its own temperature [N]")
                    || !schema.name.ends_with("Force"),
                "{text}"
            );
            (
                message.channel.topic.clone(),
                decode(&schema.name, &schema.data, &message.data),
            )
        });
        messages.collect()
    };
    let json = read("json", |_, _, data| serde_json::from_slice(data).unwrap());
    let protobuf = read("protobuf", |name, schema, data| {
        let pool = prost_reflect::DescriptorPool::decode(schema).unwrap();
        let message = pool.get_message_by_name(name).unwrap();
        as_json(&prost_reflect::DynamicMessage::decode(message, data).unwrap())
    });
    let cdr = read("cdr", |_, schema, data| {
        assert_eq!(data[..4], [0, 1, 0, 0]);
        let text = std::str::from_utf8(schema).unwrap();
        let mut place = 4;
        let body = from_cdr(
            text.split(&"=".repeat(80)).collect::<Vec<_>>()[0],
            text,
            data,
            &mut place,
        );
        assert_eq!(place, data.len(), "the definition reads the whole message");
        body
    });
    assert!(json.len() >= 16);
    for (name, others) in [("protobuf", &protobuf), ("cdr", &cdr)] {
        assert_eq!(json.len(), others.len());
        for ((topic, body), (other_topic, other)) in json.iter().zip(others) {
            assert_eq!(topic, other_topic);
            same(body, other, &format!("{name} {topic}"));
        }
    }
}

/// Asserts that what the other encoding names has the value of JSON: null there is NaN, 0, empty or absent here.
fn same(json: &Json, other: &Json, at: &str) {
    match (json, other) {
        (Json::Object(json), Json::Object(other)) => {
            for (key, value) in other {
                same(
                    json.get(key).unwrap_or(&Json::Null),
                    value,
                    &format!("{at}.{key}"),
                );
            }
        }
        (Json::Array(json), Json::Array(other)) => {
            assert_eq!(json.len(), other.len(), "{at}");
            json.iter().zip(other).for_each(|(one, two)| same(one, two, at));
        }
        (Json::Null, Json::Object(parts)) => parts.values().for_each(|part| same(&Json::Null, part, at)),
        (Json::Null, Json::Array(parts)) => assert!(parts.is_empty(), "{at}"),
        (Json::Null, missing) => assert!(
            [json!(null), json!("NaN"), json!(0), json!("")].contains(missing),
            "{at}: {missing}"
        ),
        (Json::Number(one), Json::Number(two)) => assert_eq!(one.as_f64(), two.as_f64(), "{at}"),
        _ => assert_eq!(json, other, "{at}"),
    }
}

fn number(value: f64) -> Json {
    if value.is_nan() {
        json!("NaN")
    } else {
        json!(value)
    }
}

fn as_json(message: &prost_reflect::DynamicMessage) -> Json {
    use prost_reflect::{ReflectMessage, Value};
    fn one(value: &Value) -> Json {
        match value {
            Value::F64(value) => number(*value),
            Value::U32(value) => json!(value),
            Value::Bool(value) => json!(value),
            Value::String(value) => json!(value),
            Value::Message(message) if message.descriptor().name() == "Timestamp" => json!({
                "sec": message.get_field_by_name("seconds").unwrap().as_i64().unwrap(),
                "nsec": message.get_field_by_name("nanos").unwrap().as_i32().unwrap(),
            }),
            Value::Message(message) => as_json(message),
            Value::List(list) => list.iter().map(one).collect(),
            other => panic!("{other:?}"),
        }
    }
    let descriptor = message.descriptor();
    let fields = descriptor.fields().map(|field| {
        let is_absent = field.kind().as_message().is_some() && !field.is_list() && !message.has_field(&field);
        let value = if is_absent {
            Json::Null
        } else {
            one(&message.get_field(&field))
        };
        (field.name().to_owned(), value)
    });
    Json::Object(fields.collect())
}

/// Reads a message by its `.msg` definition (XCDR1, little endian: each number is aligned to its size behind the four bytes of the head).
fn from_cdr(definition: &str, all: &str, data: &[u8], place: &mut usize) -> Json {
    fn take<'d>(data: &'d [u8], place: &mut usize, size: usize) -> &'d [u8] {
        *place = 4 + (*place - 4).div_ceil(size) * size;
        *place += size;
        &data[*place - size..*place]
    }
    let whole = |place: &mut usize| u32::from_le_bytes(take(data, place, 4).try_into().unwrap());
    let mut found = serde_json::Map::new();
    for line in definition
        .lines()
        .filter(|line| !line.trim().is_empty() && !line.starts_with("MSG: "))
    {
        let mut words = line.split_whitespace();
        let (kind, name) = (words.next().unwrap(), words.next().unwrap());
        let (element, is_list) = (kind.trim_end_matches("[]"), kind.ends_with("[]"));
        let count = if is_list { whole(place) as usize } else { 1 };
        let mut values = Vec::new();
        for _ in 0..count {
            values.push(match element {
                "float64" => number(f64::from_le_bytes(take(data, place, 8).try_into().unwrap())),
                "uint32" => json!(whole(place)),
                "int32" => json!(i32::from_le_bytes(take(data, place, 4).try_into().unwrap())),
                "bool" => json!(take(data, place, 1)[0] == 1),
                "string" => {
                    let length = whole(place) as usize;
                    *place += length;
                    json!(std::str::from_utf8(&data[*place - length..*place - 1]).unwrap())
                }
                other => {
                    let head = format!("MSG: {other}\n");
                    let (_, rest) = all
                        .split_once(&head)
                        .unwrap_or_else(|| panic!("no {other} in {all}"));
                    from_cdr(rest.split(&"=".repeat(80)).next().unwrap(), all, data, place)
                }
            });
        }
        let value = if is_list {
            Json::Array(values)
        } else {
            values.remove(0)
        };
        let name = name.replace("nanosec", "nsec");
        found.insert(name, value);
    }
    Json::Object(found)
}
