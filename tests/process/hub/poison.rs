//! Messages that a broken or stolen site can make: each is parked, and the others go on.

use super::fleet::{Fleet, Storage, text_of};
use super::servers::DEADLINE;
use crate::site::lines;
use rusqlite::types::Value;
use serde_json::Value as Json;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tirante::analysis::signal::record::{RodId, Timestamp};
use tirante::service::forward::message::encode;
use tirante::site::store::{Change, ChangedRow, ConditionEvent, FORGOTTEN, FORMAT, Store};

/// A client that sends any bytes as headers, which no library lets it do.
struct Raw(BufReader<TcpStream>);

impl Raw {
    fn connect(port: u16) -> Self {
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(DEADLINE)).unwrap();
        let mut raw = Self(BufReader::new(stream));
        raw.write(b"CONNECT {\"verbose\":false,\"pedantic\":false,\"headers\":true}\r\n");
        raw.flush();
        raw
    }

    fn write(&mut self, bytes: &[u8]) {
        self.0.get_mut().write_all(bytes).unwrap();
    }

    fn publish(&mut self, headers: &[u8], payload: &[u8]) {
        let total = headers.len() + payload.len();
        let head = format!("HPUB tirante.v1.out.gubbio {} {total}\r\n", headers.len());
        self.write(&[head.as_bytes(), headers, payload, b"\r\n"].concat());
    }

    /// Waits until the server has all.
    fn flush(&mut self) {
        self.write(b"PING\r\n");
        let mut line = String::new();
        while line != "PONG\r\n" {
            line.clear();
            assert!(self.0.read_line(&mut line).unwrap() > 0);
            assert!(!line.starts_with("-ERR"), "{line}");
        }
    }
}

/// Bytes of the headers of a label, as a site sends them.
fn headers(epoch: &str, first: i64, last: i64) -> Vec<u8> {
    let text = format!(
        "NATS/1.0\r\nTirante-N: {last}\r\nTirante-First: {first}\r\nTirante-Epoch: {epoch}\r\nTirante-Format: {FORMAT}\r\n\r\n"
    );
    text.into_bytes()
}

/// A store with some commits, of which all but the first say this.
fn store_of(said: &str) -> Store {
    let mut store = Store::in_memory().unwrap();
    store.keep_config("a", "tower", "text").unwrap();
    for at in 0..4 {
        let begun = ConditionEvent::raised("sink", "mail", Timestamp::from_nanos(1 + at), said);
        store.watch(&[begun], None).unwrap();
    }
    store.forget_rod(&RodId("north".to_owned())).unwrap();
    store
}

/// The checksum that anybody can compute.
fn checksum(values: &[Value]) -> Value {
    let mut sum = crc32fast::Hasher::new();
    for value in values {
        let (tag, bytes) = match value {
            Value::Null => (0, Vec::new()),
            Value::Integer(number) => (1, number.to_le_bytes().to_vec()),
            Value::Real(number) => (2, number.to_bits().to_le_bytes().to_vec()),
            Value::Text(text) => (3, text.as_bytes().to_vec()),
            Value::Blob(bytes) => (4, bytes.clone()),
        };
        sum.update(&[tag]);
        sum.update(&(bytes.len() as u64).to_le_bytes());
        sum.update(&bytes);
    }
    Value::Integer(i64::from(sum.finalize()))
}

/// Text that no compression makes short.
fn noise(length: usize) -> Vec<u8> {
    let mut state = 1_u64;
    let next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 40) as u8
    };
    std::iter::repeat_with(next).take(length).collect()
}

fn commit(rows: Vec<ChangedRow>) -> Vec<u8> {
    encode(&[Change { number: 1, rows }]).unwrap()
}

fn site(fleet: &Fleet) -> Json {
    let sites = lines(&fleet.hub_command(&["sites", "--format", "json"]).stdout);
    let found = sites.into_iter().find(|site| site["site"] == "gubbio");
    found.unwrap_or_default()
}

#[test]
fn what_one_site_forges_stops_no_other() {
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Postgres) else {
        return;
    };
    fleet.list_more(&["gubbio".to_owned()]);
    fleet.start();
    fleet.wait_until_equal();
    fleet.stop_hub();
    let mut raw = Raw::connect(fleet.nats_port());
    let mut count = 0;
    let mut send = |headers: &[u8], payload: &[u8]| {
        raw.publish(headers, payload);
        count += 1;
    };
    // Headers that a client of NATS may not parse, and dies of.
    send(b"NATS/1.0\r\nA: \xff\xfe\r\n\r\n", b"");
    send(b"NATS/1.0\r\nA b: c\r\n\r\n", b"x");
    send(b"NATS/1.0\r\nA: b\rc\r\n\r\n", b"x");
    send(b"NATS/1.0\r\nA: \0\r\n\r\n", b"x");
    send(b"NATS/1.0 409 Consumer Deleted\r\n\r\n", b"");
    send(b"NATS/1.0 404 No Messages\r\n\r\n", b"");
    send(b"NATS/1.0\r\n\r\n", b"");
    // Contents that a database may not take.
    let text = |text: &str| Value::Text(text.to_owned());
    let row = |table: &str, values: Vec<Value>| ChangedRow {
        table: table.to_owned(),
        values,
    };
    let label = headers("00ff", 1, 1);
    send(&label, &commit(vec![row("\0", vec![text("\0")])]));
    send(&label, &commit(vec![row(FORGOTTEN, vec![text("\0")])]));
    let long: String = noise(8000)
        .iter()
        .map(|byte| char::from(b'A' + byte % 57))
        .collect();
    send(&label, &commit(vec![row(FORGOTTEN, vec![text(&long)])]));
    // A record with a right checksum whose rod is too long for an index of PostgreSQL, and for nothing else.
    let mut record = fleet.latest_record(0);
    let rod = record
        .values
        .iter_mut()
        .find(|value| matches!(value, Value::Text(name) if name == "north" || name == "south"));
    *rod.unwrap() = text(&long);
    record.values.pop();
    record.values.push(checksum(&record.values));
    send(&label, &commit(vec![record]));
    // Numbers after which there are none.
    let empty = encode(&[]).unwrap();
    send(&headers("00ff", i64::MAX, i64::MAX), &empty);
    send(&headers("00ff", 1, i64::MAX), &empty);
    // More than 16 MB that wait.
    let block = noise(250_000);
    for _ in 0..80 {
        send(&label, &block);
    }
    // In the end what a good site sends.
    let store = store_of("refused");
    let epoch = store.epoch().unwrap().unwrap();
    let last = store.latest_change().unwrap();
    let changes = store.changes_after(0, 100).unwrap();
    raw.publish(&headers(&epoch, 1, last), &encode(&changes).unwrap());
    raw.flush();

    let before = fleet.hub_logged();
    fleet.more_records(0);
    fleet.start_hub();
    fleet.wait_until_sent_of(0);
    let until = Instant::now() + DEADLINE;
    while site(&fleet)["through"] != last {
        assert!(Instant::now() < until, "{}\n{}", site(&fleet), fleet.log());
        std::thread::sleep(Duration::from_millis(50));
    }
    let found = site(&fleet);
    assert_eq!(
        (&found["parked"], &found["fault"]),
        (&Json::from(count), &Json::from("unreadable")),
        "{found}"
    );
    let said = fleet.hub_log_after(before);
    assert!(!said.contains("tried again"), "{said}");
    let parked = text_of(&fleet.hub_command(&["parked", "gubbio"]).stdout);
    assert!(parked.contains("the database refuses it"), "{parked}");
    let todi = lines(&fleet.hub_command(&["sites", "--format", "json"]).stdout);
    let todi = todi.iter().find(|site| site["site"] == "todi").unwrap();
    assert_eq!((&todi["parked"], &todi["fault"]), (&Json::from(0), &Json::Null));
    // The next start tries them again, and goes on.
    fleet.stop_hub();
    fleet.start_hub();
    raw.publish(b"NATS/1.0\r\nA: \xff\r\n\r\n", b"");
    raw.flush();
    while site(&fleet)["parked"] != count + 1 {
        assert!(Instant::now() < until, "{}\n{}", site(&fleet), fleet.log());
        std::thread::sleep(Duration::from_millis(50));
    }
    // A copy of its store that went on otherwise: neither what comes again with another content is folded, nor what follows.
    let mut copy = store_of("out of reach");
    let begun = ConditionEvent::raised("sink", "mail", Timestamp::from_nanos(9), "later");
    copy.watch(&[begun], None).unwrap();
    let part = |after: i64, count: usize| encode(&copy.changes_after(after, count).unwrap()).unwrap();
    raw.publish(&headers(&epoch, 3, 4), &part(2, 2));
    raw.publish(&headers(&epoch, last + 1, last + 1), &part(last, 1));
    raw.flush();
    while site(&fleet)["parked"] != count + 3 {
        assert!(Instant::now() < until, "{}\n{}", site(&fleet), fleet.log());
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(site(&fleet)["through"], last);
    let parked = text_of(&fleet.hub_command(&["parked", "gubbio"]).stdout);
    assert_eq!(parked.matches("jump-back").count(), 2, "{parked}");
    // A database that hangs does not keep it from ending.
    fleet.freeze_postgres("-STOP");
    raw.publish(b"NATS/1.0\r\nA: \xff\r\n\r\n", b"");
    raw.flush();
    std::thread::sleep(Duration::from_millis(300));
    let asked = Instant::now();
    fleet.stop_hub();
    assert!(asked.elapsed() < Duration::from_secs(15), "{:?}", asked.elapsed());
    fleet.freeze_postgres("-CONT");
}
