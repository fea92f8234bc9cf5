//! A real MQTT broker: acknowledged, killed and restarted, halted, refusing.

use super::desk::*;
use super::peers::{Server, program};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{Client, Event, MqttOptions};
use serde_json::Value;
use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tirante::service::alert::{self, Message, Pace};

struct Broker {
    program: PathBuf,
    tls: String,
}

impl Broker {
    /// A broker with a user `tirante` who may write below `tirante/` only.
    fn new(desk: &Desk) -> Option<Self> {
        let program = program("mosquitto", "mosquitto")?;
        let passwords = desk.path("passwords");
        let made = Command::new("mosquitto_passwd")
            .args(["-b", "-c"])
            .arg(&passwords)
            .args(["tirante", "secret"])
            .status();
        assert!(made.unwrap().success());
        fs::write(desk.path("acl"), "user tirante\ntopic readwrite tirante/#\n").unwrap();
        desk.secret("password", "secret\n");
        Some(Self {
            program,
            tls: String::new(),
        })
    }

    fn arguments(&self, desk: &Desk, address: SocketAddr) -> Vec<String> {
        let folder = desk.folder.path().display();
        let text = format!(
            "listener {} 127.0.0.1\nuser root\nallow_anonymous false\npassword_file {folder}/passwords\n\
             acl_file {folder}/acl\npersistence true\npersistence_location {folder}/\n{}",
            address.port(),
            self.tls
        );
        let path = desk.path("mosquitto.conf");
        fs::write(&path, text).unwrap();
        vec!["-c".to_owned(), path.display().to_string()]
    }

    fn start(&self, desk: &Desk) -> Server {
        Server::start_anywhere(&self.program, |address| self.arguments(desk, address))
    }

    fn start_at(&self, desk: &Desk, address: SocketAddr) -> Server {
        Server::start(&self.program, address, &self.arguments(desk, address)).unwrap()
    }
}

fn sink(desk: &Desk, url: &str, more: &str) -> String {
    let password = desk.path("password");
    format!(
        "[[sink]]\nid = \"broker\"\nkind = \"mqtt\"\nurl = \"{url}\"\nuser = \"tirante\"\npassword_file = {password:?}\n{more}"
    )
}

/// Everything published below `tirante/`: topics and messages. It connects again whenever it is cut off.
fn listen(address: SocketAddr) -> Arc<Mutex<Vec<(String, Value)>>> {
    let heard = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::downgrade(&heard);
    std::thread::spawn(move || {
        let mut options = MqttOptions::new("listener", address.ip().to_string(), address.port());
        options
            .set_credentials("tirante", "secret")
            .set_keep_alive(Duration::from_secs(5));
        let (client, mut connection) = Client::new(options, 10);
        while kept.strong_count() > 0 {
            match connection.recv_timeout(Duration::from_millis(100)) {
                Ok(Ok(Event::Incoming(Packet::ConnAck(_)))) => {
                    client.subscribe("tirante/#", QoS::AtLeastOnce).unwrap();
                }
                Ok(Ok(Event::Incoming(Packet::SubAck(_)))) => {
                    let Some(heard) = kept.upgrade() else { return };
                    heard.lock().unwrap().push(("subscribed".to_owned(), Value::Null));
                }
                Ok(Ok(Event::Incoming(Packet::Publish(publish)))) => {
                    let Some(heard) = kept.upgrade() else { return };
                    let topic = String::from_utf8(publish.topic.to_vec()).unwrap();
                    let message = serde_json::from_slice(&publish.payload).unwrap();
                    heard.lock().unwrap().push((topic, message));
                }
                Ok(Err(_)) => std::thread::sleep(Duration::from_millis(20)),
                _ => {}
            }
        }
    });
    heard
}

fn subscriptions(heard: &Mutex<Vec<(String, Value)>>) -> usize {
    let heard = heard.lock().unwrap();
    heard.iter().filter(|(topic, _)| topic == "subscribed").count()
}

/// The ids of the messages heard, each once.
fn ids(heard: &Mutex<Vec<(String, Value)>>) -> Vec<String> {
    let mut ids: Vec<String> = Vec::new();
    for (_, message) in heard
        .lock()
        .unwrap()
        .iter()
        .filter(|(_, message)| !message.is_null())
    {
        let id = message["id"].as_str().unwrap().to_owned();
        if !ids.contains(&id) {
            ids.push(id);
        }
    }
    ids
}

#[test]
fn a_broker_that_is_killed_and_halted_gets_everything_in_order() {
    let desk = Desk::new();
    let Some(broker) = Broker::new(&desk) else { return };
    let mut server = broker.start(&desk);
    let address = server.address;
    let heard = listen(address);
    eventually("the listener listens", || subscriptions(&heard) == 1);
    let couriers = desk.start(&sinks(&sink(&desk, &format!("mqtt://{address}"), "")));
    eventually("the sink is known", || desk.delivered("broker") == Some(0));
    let mut expected: Vec<String> = Vec::new();
    let mut tell = |hours: std::ops::Range<usize>| {
        for hour in hours {
            let alarm = desk.raise(hour);
            expected.push(format!(
                "{}-raised-{}",
                alarm.id,
                alarm.raised.as_nanos() / 1_000_000_000
            ));
            couriers.wake();
        }
        expected.clone()
    };
    let all = tell(0..20);
    eventually("the first arrive", || ids(&heard) == all);
    server.kill();
    let all = tell(20..40);
    eventually("the outage is told", || desk.condition("broker").is_some());
    let server = broker.start_at(&desk, address);
    eventually("the listener is back", || subscriptions(&heard) == 2);
    // The sink may have been back before the listener: then the broker has the messages that the listener missed.
    let more = tell(40..45);
    eventually("all are marked", || desk.delivered("broker") == Some(45));
    eventually("the outage is over", || desk.condition("broker").is_none());
    eventually("the latest arrive", || ids(&heard).ends_with(&more[40..]));
    assert!(ids(&heard).starts_with(&all[..20]));
    // Halted: nothing is refused, nothing answered.
    server.signal("-STOP");
    let all = tell(45..50);
    eventually("it is told", || {
        desk.condition("broker")
            .is_some_and(|detail| detail.contains("imeout") || detail.contains("within"))
    });
    server.signal("-CONT");
    eventually("all are marked", || desk.delivered("broker") == Some(50));
    couriers.stop();
    eventually("all arrive", || ids(&heard).ends_with(&all[45..]));
    let heard = heard.lock().unwrap();
    assert_eq!(heard[1].0, "tirante/Duomo/north/sensor");
    assert_eq!(heard[1].1["message"], "Alarm 0.");
}

#[test]
fn what_a_broker_refuses_is_not_delivered() {
    let desk = Desk::new();
    let Some(broker) = Broker::new(&desk) else { return };
    let server = broker.start(&desk);
    let url = format!("mqtt://{}", server.address);
    let deliver = |text: &str| {
        let mut sink = alert::open(&sinks(text)[0], SITE, Pace::default().deadline);
        sink.deliver(&Message::test(SITE, "broker", at(0)))
    };
    assert_eq!(deliver(&sink(&desk, &url, "retain = \"yes\"\n")), Ok(()));
    // A broker of MQTT 3.1.1 acknowledges this one, too, and throws it away.
    let refused = deliver(&sink(&desk, &url, "topic = \"elsewhere/{rod}\"\n")).unwrap_err();
    assert!(refused.reason.contains("NotAuthorized"), "{refused}");
    desk.secret("password", "wrong\n");
    let refused = deliver(&sink(&desk, &url, "")).unwrap_err();
    assert!(refused.reason.contains("NotAuthorized"), "{refused}");
    // Retained: a later subscriber gets the message.
    let heard = listen(server.address);
    eventually("the retained message", || ids(&heard).len() == 1);
    assert_eq!(
        heard
            .lock()
            .unwrap()
            .iter()
            .filter(|(topic, _)| topic == "tirante/Duomo/test/test")
            .count(),
        1
    );
}

#[test]
fn an_encrypted_broker_must_have_the_named_certificate() {
    let desk = Desk::new();
    let Some(mut broker) = Broker::new(&desk) else {
        return;
    };
    let own = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let write = |name: &str, text: String| {
        fs::write(desk.path(name), text).unwrap();
        desk.path(name)
    };
    let certificate = write("broker.pem", own.cert.pem());
    let key = write("broker.key", own.signing_key.serialize_pem());
    broker.tls = format!("certfile {}\nkeyfile {}\n", certificate.display(), key.display());
    let server = broker.start(&desk);
    let url = format!("mqtts://localhost:{}", server.address.port());
    let deliver = |ca: Option<&Path>| {
        let ca = ca.map_or(String::new(), |ca| format!("ca_file = {ca:?}\n"));
        let text = sink(&desk, &url, &ca);
        let mut sink = alert::open(&sinks(&text)[0], SITE, Pace::default().deadline);
        sink.deliver(&Message::test(SITE, "broker", at(0)))
    };
    assert_eq!(deliver(Some(&certificate)), Ok(()));
    let refused = deliver(None).unwrap_err();
    assert!(refused.reason.contains("certificate"), "{refused}");
}
