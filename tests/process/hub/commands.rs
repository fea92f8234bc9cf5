//! Commands of the centre: carried out at most once, answered, and refused by name where they are not what they seem.

use super::beats::{publish, row, wait};
use super::fleet::{Fleet, Storage, text_of};
use super::servers::DEADLINE;
use crate::site::lines;
use serde_json::Value;
use std::fs;
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};
use tirante::service::forward::command::{Action, Order, Signed};
use tirante::site::store::{Filter, Reader};

/// Gives a command to todi; returns its number.
pub fn command(fleet: &Fleet, words: &[&str]) -> i64 {
    let who = ["--by", "M. Rossi", "--reason", "wedge inspected"];
    let given = fleet.hub_command(&[&["command", "todi"], words, &who].concat());
    assert!(given.status.success(), "{}", text_of(&given.stderr));
    let said = text_of(&given.stdout);
    said.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// The list's row of a command.
fn listed(fleet: &Fleet, number: i64) -> Value {
    let listed = fleet.hub_command(&["command", "--list", "--format", "json"]);
    let rows = lines(&listed.stdout);
    let found = rows.into_iter().find(|row| row["number"] == number);
    found.unwrap_or_default()
}

pub fn wait_for(fleet: &Fleet, number: i64, state: &str) -> Value {
    wait(fleet, &format!("command {number} is {state}"), || {
        listed(fleet, number)["state"] == state
    });
    listed(fleet, number)
}

fn store(fleet: &Fleet) -> PathBuf {
    fleet.edges[0].site.path("site.db")
}

/// Asks the post without a library of the program's own.
fn on_post<T>(fleet: &Fleet, work: impl AsyncFnOnce(async_nats::jetstream::Context) -> T) -> T {
    let address = format!("127.0.0.1:{}", fleet.nats_port());
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let client = async_nats::connect(address).await.unwrap();
        work(async_nats::jetstream::new(client)).await
    })
}

/// What the post has of todi's open commands.
fn open(fleet: &Fleet) -> String {
    on_post(fleet, async |jetstream| {
        let stream = jetstream.get_stream("TIRANTE_CMD").await.unwrap();
        let last = stream
            .get_last_raw_message_by_subject("tirante.v1.cmd.todi")
            .await;
        text_of(&last.unwrap().payload)
    })
}

/// The last message of todi's results, with its headers.
fn last_message(fleet: &Fleet) -> (async_nats::HeaderMap, Vec<u8>) {
    on_post(fleet, async |jetstream| {
        let stream = jetstream.get_stream("TIRANTE_OUT").await.unwrap();
        let last = stream
            .get_last_raw_message_by_subject("tirante.v1.out.todi")
            .await
            .unwrap();
        (last.headers, last.payload.to_vec())
    })
}

/// Publishes it as the first of a new stream.
fn publish_again(fleet: &Fleet, (mut headers, payload): (async_nats::HeaderMap, Vec<u8>)) {
    headers.insert("Nats-Expected-Last-Subject-Sequence", "0");
    on_post(fleet, async |jetstream| {
        let sent = jetstream
            .publish_with_headers("tirante.v1.out.todi", headers, payload.into())
            .await;
        sent.unwrap().await.unwrap();
    });
}

/// Number of requests in todi's store, applied or not.
fn requests(fleet: &Fleet) -> i64 {
    let connection = rusqlite::Connection::open(store(fleet)).unwrap();
    connection
        .query_row("SELECT count(*) FROM request", (), |row| row.get(0))
        .unwrap()
}

fn first_alarm(fleet: &Fleet) -> String {
    let reader = Reader::open(&store(fleet)).unwrap();
    let alarms = reader.alarms(&Filter::default()).unwrap();
    let standing = alarms
        .iter()
        .find(|alarm| alarm.acknowledged.is_none() && !alarm.is_over());
    standing.unwrap().id.clone()
}

/// A stream that lost its begin, and a centre that lost its database: the site has nothing new to send, and sends all of it again when it
/// is told to.
#[test]
fn what_the_post_lost_comes_again_by_command() {
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Sqlite) else {
        return;
    };
    fleet.give_keys();
    fleet.start();
    fleet.wait_until_complete();
    let (_, last) = fleet.end_of(0);
    let late = last_message(&fleet);
    // A new stream begins with the last message of the old one.
    fleet.stop_edge(0);
    fleet.stop_hub();
    fleet.forget_stream_and_centre();
    let logged = fleet.hub_logged();
    fleet.start_hub();
    fleet.wait_for_hub_log(logged, "ready: 1 sites");
    publish_again(&fleet, late);
    fleet.start_edge(0);
    wait(&fleet, "the site is parked", || {
        row(&fleet, "todi")["fault"] == "gap"
    });
    wait(&fleet, "the site is heard", || {
        !row(&fleet, "todi")["beat"].is_null()
    });
    let beyond = command(&fleet, &["resend", "1000000"]);
    let number = command(&fleet, &["resend", "1"]);
    let done = wait_for(&fleet, number, "carried-out");
    assert!(
        done["answer"].as_str().unwrap().starts_with("commits 1 to "),
        "{done}"
    );
    let refused = listed(&fleet, beyond);
    assert!(
        refused["answer"]
            .as_str()
            .unwrap()
            .contains("the store has commits 1 to"),
        "{refused}"
    );
    fleet.wait_until_complete();
    // A replay knows no key of commands.
    let compared = fleet.compare(0, "site.db", &[]);
    assert!(compared.status.success(), "{}", text_of(&compared.stdout));
    let now = row(&fleet, "todi");
    assert_eq!((&now["parked"], &now["stores"]), (&0.into(), &1.into()), "{now}");
    assert!(now["through"].as_i64().unwrap() >= last + 2, "{now}");
}

#[test]
fn commands_are_carried_out_once_and_answered() {
    let Some(mut fleet) = Fleet::of(&["todi", "gubbio"], Storage::Sqlite) else {
        return;
    };
    fleet.give_keys();
    fleet.start();
    fleet.wait_until_read(0, 7);
    fleet.wait_until_sent();
    let alarm = first_alarm(&fleet);
    let number = command(&fleet, &["acknowledge", &alarm]);
    let done = wait_for(&fleet, number, "carried-out");
    assert_eq!(
        (&done["by"], &done["site"]),
        (&"M. Rossi".into(), &"todi".into()),
        "{done}"
    );
    let reader = Reader::open(&store(&fleet)).unwrap();
    assert!(reader.alarm(&alarm).unwrap().unwrap().acknowledged.is_some());
    // Again: there is nothing to do, which is the answer.
    let again = command(&fleet, &["ack", &alarm]);
    assert!(again > number);
    let refused = wait_for(&fleet, again, "refused");
    assert!(
        refused["answer"]
            .as_str()
            .unwrap()
            .contains("was acknowledged at"),
        "{refused}"
    );
    let none = command(&fleet, &["rebaseline", "nowhere"]);
    let refused = wait_for(&fleet, none, "refused");
    assert!(
        refused["answer"].as_str().unwrap().contains("no rod nowhere"),
        "{refused}"
    );
    // A new baseline waits for the rod's next record, whatever is killed meanwhile.
    assert_eq!(requests(&fleet), 1);
    let number = command(&fleet, &["rebaseline", "north"]);
    for _ in 0..3 {
        fleet.kill_edge(0);
        fleet.kill_hub();
        fleet.kill_nats();
    }
    // A hub that finds no post at its start ends, and is begun again by its unit.
    let until = Instant::now() + DEADLINE;
    while listed(&fleet, number)["state"] != "accepted" {
        assert!(Instant::now() < until, "not accepted\n{}", fleet.log());
        fleet.keep_hub();
        thread::sleep(Duration::from_millis(200));
    }
    fleet.more_records(0);
    wait_for(&fleet, number, "carried-out");
    assert_eq!(requests(&fleet), 2);
    // One that nobody hears ends.
    fleet.stop_edge(0);
    let number = command(&fleet, &["rebaseline", "south", "--expires-h", "0.001"]);
    wait_for(&fleet, number, "expired");
    fleet.start_edge(0);
    // A configuration is kept beside the site's own, which stays as it is.
    let site = fleet.edges[0].site.path("site.toml");
    let own = fs::read_to_string(&site).unwrap();
    let offer = fleet.path("offer.toml");
    fs::write(&offer, own.replace("heartbeat_s = 1.0", "heartbeat_s = 2.0")).unwrap();
    let number = command(&fleet, &["configure", offer.to_str().unwrap()]);
    wait_for(&fleet, number, "carried-out");
    let offered = fleet.edges[0].site.path("site.toml.offered");
    assert_eq!(
        (fs::read(&offered).unwrap(), fs::read_to_string(&site).unwrap()),
        (fs::read(&offer).unwrap(), own)
    );
    let has_condition = |fleet: &Fleet| {
        let row = row(fleet, "todi");
        let mut conditions = row["conditions"].as_array().unwrap().iter();
        conditions.any(|one| one["kind"] == "command")
    };
    wait(&fleet, "the offer is a condition", || has_condition(&fleet));
    fs::remove_file(&offered).unwrap();
    wait(&fleet, "it is over", || !has_condition(&fleet));
    fs::write(&offer, "[site]\nnome = 1\n").unwrap();
    let number = command(&fleet, &["configure", offer.to_str().unwrap()]);
    wait_for(&fleet, number, "refused");
    assert!(!offered.exists());
    assert_eq!(requests(&fleet), 2);
}

#[test]
fn what_is_forged_changed_expired_repeated_or_anothers_is_refused_and_counted() {
    let Some(mut fleet) = Fleet::of(&["todi", "gubbio"], Storage::Sqlite) else {
        return;
    };
    fleet.give_keys();
    fleet.start();
    fleet.wait_until_read(0, 7);
    fleet.wait_until_sent();
    let number = command(&fleet, &["acknowledge", &first_alarm(&fleet)]);
    wait_for(&fleet, number, "carried-out");
    // From now on the hub has nothing to put in the place of what is forged.
    wait(&fleet, "no command is open", || open(&fleet) == "[]");
    let (epoch, _) = fleet.end_of(0);
    let order = |number: i64, site: &str, expires_ns: i64| Order {
        site: site.to_owned(),
        epoch: epoch.clone(),
        number,
        issued_ns: 1,
        expires_ns,
        by: "nobody".to_owned(),
        reason: "none".to_owned(),
        action: Action::Rebaseline {
            rod: "north".to_owned(),
        },
    };
    let seed = |name: &str| fs::read_to_string(fleet.path(&format!("{name}.ck"))).unwrap();
    let sign = |order: Order, name: &str| order.sign(&seed(name)).unwrap();
    let high = number + 1_000_000_000;
    let genuine = sign(order(high, "todi", i64::MAX), "todi");
    let changed = Signed {
        text: genuine.text.replace("north", "south"),
        ..genuine.clone()
    };
    assert_ne!(changed, genuine);
    let list = vec![
        sign(order(high, "todi", i64::MAX), "gubbio"),
        changed,
        sign(order(high, "gubbio", i64::MAX), "todi"),
        sign(order(number, "todi", i64::MAX), "todi"),
        sign(order(number + 1, "todi", 2), "todi"),
    ];
    let payload = serde_json::to_string(&list).unwrap();
    publish(&fleet, "tirante.v1.cmd.todi", payload.clone());
    let counts = |fleet: &Fleet| row(fleet, "todi")["refused"].clone();
    let wanted = serde_json::json!({ "forged": 2, "other-site": 1, "repeated": 1, "expired": 1 });
    wait(&fleet, "each is counted", || counts(&fleet) == wanted);
    // The whole list once more: what was judged to expire is known by its number now.
    publish(&fleet, "tirante.v1.cmd.todi", payload);
    let wanted = serde_json::json!({ "forged": 4, "other-site": 2, "repeated": 3, "expired": 1 });
    wait(&fleet, "each is counted again", || counts(&fleet) == wanted);
    publish(&fleet, "tirante.v1.cmd.todi", "junk".to_owned());
    wait(&fleet, "junk is counted", || counts(&fleet)["forged"] == 5);
    assert_eq!(requests(&fleet), 1, "nothing was carried out");
    let log = fs::read_to_string(fleet.edges[0].site.path("daemon.log")).unwrap();
    assert!(log.contains("fault=\"command\""), "{log}");
    // A forged number burns none: the next genuine command is carried out.
    let number = command(&fleet, &["rebaseline", "north"]);
    wait_for(&fleet, number, "accepted");
    assert_eq!(requests(&fleet), 2);
}
