//! What the sinks are told of the sites' alarms, of sites that are put off the list, replaced, put back, parked, or newer than the hub.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use super::beats::Heard;
use super::post::Post;
use super::relay::Relay;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::AlarmEvent;
use crate::analysis::track::alarm::{Alarm, Kind, What};
use crate::config::HubConfig;
use crate::service::forward::beat::Heartbeat;
use crate::site::store::{Change, ConditionEvent, Durability, Relayed, Store};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::sync::mpsc::sync_channel;

const RAISED: Timestamp = Timestamp::from_nanos(1_780_000_000_000_000_000);

/// Sites that send, a centre, and a hub's outbox.
struct Bench {
    post: Post,
    outbox: Store,
    relay: Relay,
    pages: Receiver<Relayed>,
    told: (i64, i64),
}

fn hub(post: &Post, listed: &[&str]) -> (Relay, Receiver<Relayed>) {
    let folder = post.folder.path();
    let mut text = format!(
        "[nats]\nto = \"nats://127.0.0.1\"\n[sqlite]\npath = \"{}\"\n",
        folder.join("centre.db").display()
    );
    for site in listed {
        text += &format!("[[site]]\nname = \"{site}\"\n");
    }
    let config = Arc::new(HubConfig::parse(&text, "hub.toml").unwrap());
    let (to, pages) = sync_channel(100);
    (
        Relay::new(config, Arc::default(), folder.join("outbox.db"), to),
        pages,
    )
}

impl Bench {
    fn new() -> Self {
        let post = Post::new();
        let outbox = Store::open(&post.folder.path().join("outbox.db"), Durability::Replay);
        let (relay, pages) = hub(&post, &["todi", "gubbio"]);
        Self {
            outbox: outbox.unwrap(),
            post,
            relay,
            pages,
            told: (0, 0),
        }
    }

    /// The hub started anew with these sites on its list.
    fn again(&mut self, listed: &[&str]) {
        (self.relay, self.pages) = hub(&self.post, listed);
    }

    /// All commits of a site's store come.
    fn comes(&mut self, site: &str, store: &Store) {
        let message = self.post.of(site, store, 1, store.latest_change().unwrap());
        self.post.send(&message);
    }

    /// What is told after a look, as `raised ID`; ids of conditions are those of what they are about.
    fn told(&mut self) -> Vec<String> {
        self.relay.round(&mut None).unwrap();
        for page in self.pages.try_iter() {
            self.outbox.relay(&page).unwrap();
        }
        let news = self.outbox.news_after(self.told.0, 100).unwrap();
        let notices = self.outbox.notices_after(self.told.1, 100).unwrap();
        self.told = (
            self.outbox.latest_news().unwrap(),
            self.outbox.latest_notice().unwrap(),
        );
        let news = news.into_iter().map(|news| {
            let what = serde_json::to_value(news.event.what).unwrap();
            format!("{} {}", what.as_str().unwrap(), news.rod.0)
        });
        let notices = notices.into_iter().map(|notice| {
            let what = if notice.is_raised { "raised" } else { "cleared" };
            format!("{what} {}", notice.about)
        });
        news.chain(notices).collect()
    }
}

/// A site's store in which alarms of these rods stand, and a condition about each of others.
fn store(rods: &[&str], about: &[&str]) -> Store {
    let mut store = Store::in_memory().unwrap();
    let raised = |rod: &&str| {
        let alarm = Alarm::new(
            &RodId((*rod).to_owned()),
            Kind::Drift,
            1,
            RAISED,
            "It fell.".to_owned(),
        );
        let (what, time) = (What::Raised, alarm.raised);
        AlarmEvent { what, time, alarm }
    };
    let begun = |about: &&str| ConditionEvent::raised("sink", about, RAISED, "refused");
    let all = Relayed {
        events: rods.iter().map(raised).collect(),
        notices: about.iter().map(begun).collect(),
        ..Relayed::default()
    };
    store.relay(&all).unwrap();
    store
}

#[test]
fn a_site_that_is_put_back_on_the_list_is_told_again() {
    let mut bench = Bench::new();
    bench.comes("todi", &store(&["nave-1"], &["mail"]));
    bench.comes("gubbio", &store(&["nave-1"], &[]));
    assert_eq!(
        bench.told(),
        ["raised gubbio/nave-1", "raised todi/nave-1", "raised mail"]
    );
    assert!(bench.told().is_empty());
    bench.again(&["gubbio"]);
    assert_eq!(bench.told(), ["cleared todi/nave-1", "cleared mail"]);
    bench.again(&["gubbio"]);
    assert!(bench.told().is_empty());
    bench.again(&["todi", "gubbio"]);
    assert_eq!(bench.told(), ["repeated todi/nave-1", "raised mail"]);
    bench.again(&["todi", "gubbio"]);
    assert!(bench.told().is_empty());
    assert_eq!(bench.outbox.standing_notices().unwrap().len(), 1);
}

#[test]
fn a_store_that_is_made_the_present_one_again_is_told_again() {
    let mut bench = Bench::new();
    let (right, wrong) = (
        store(&["nave-1", "nave-2"], &[]),
        store(&["nave-2", "nave-3"], &[]),
    );
    bench.comes("todi", &right);
    // Raised at one time, they come in the order of their ids.
    let mut told = bench.told();
    told.sort();
    assert_eq!(told, ["raised todi/nave-1", "raised todi/nave-2"]);
    bench.comes("todi", &wrong);
    assert_eq!(bench.told(), ["cleared todi/nave-1", "raised todi/nave-3"]);
    let epoch = right.epoch().unwrap().unwrap();
    bench.post.centre.make_present("todi", &epoch).unwrap();
    // Whether the hub was begun anew or looks on.
    assert_eq!(bench.told(), ["cleared todi/nave-3", "repeated todi/nave-1"]);
    bench.again(&["todi"]);
    assert!(bench.told().is_empty());
}

#[test]
fn what_still_waits_for_the_outbox_ends_with_its_store() {
    let mut bench = Bench::new();
    bench.comes("todi", &store(&["nave-1"], &["mail"]));
    bench.relay.round(&mut None).unwrap();
    bench.comes("todi", &store(&["nave-2"], &[]));
    // Both pages were under way when the second store was looked at.
    assert_eq!(
        bench.told(),
        [
            "raised todi/nave-1",
            "cleared todi/nave-1",
            "raised todi/nave-2",
            "raised mail",
            "cleared mail"
        ]
    );
}

#[test]
fn a_site_whose_messages_are_parked_is_told_as_far_as_it_came() {
    let mut bench = Bench::new();
    let todi = store(&["nave-1"], &[]);
    bench.comes("todi", &todi);
    let epoch = todi.epoch().unwrap().unwrap();
    let beat = Heartbeat {
        time_ns: 0,
        epoch: epoch.clone(),
        through: 9,
        version: String::new(),
        state: "ok".to_owned(),
        rods: BTreeMap::new(),
        stopped_since: None,
        conditions: Vec::new(),
        refused: BTreeMap::new(),
    };
    let heard = Heard { heard_ns: 1, beat };
    bench
        .post
        .centre
        .keep_beats(&[("todi".to_owned(), heard)].into())
        .unwrap();
    // Eight commits are on their way.
    assert!(bench.told().is_empty());
    let changes = todi.changes_after(0, 1).unwrap();
    let late: Vec<_> = changes
        .iter()
        .map(|change| Change {
            number: 9,
            rows: change.rows.clone(),
        })
        .collect();
    let gap = bench.post.with("todi", &epoch, 9, 9, &late);
    bench.post.send(&gap);
    assert_eq!(bench.told(), ["raised todi/nave-1"]);
}

#[test]
fn an_alarm_of_a_newer_program_is_told_by_its_columns_and_read_after_an_update() {
    let mut bench = Bench::new();
    bench.comes("todi", &store(&["nave-1"], &[]));
    let kind = |bench: &mut Bench, from: &str, to: &str| {
        for table in ["alarm", "outbox"] {
            let sql =
                format!("UPDATE \"{table}\" SET \"json\" = replace(\"json\", '\"{from}\"', '\"{to}\"')");
            bench.post.centre.sql().batch(&sql).unwrap();
        }
    };
    kind(&mut bench, "drift", "tilt");
    assert_eq!(bench.told(), ["raised nave-1"]);
    let standing = bench.outbox.standing_notices().unwrap();
    assert!(
        standing[0].detail.contains("rod nave-1, drift") && standing[0].detail.contains("It fell."),
        "{standing:?}"
    );
    bench.again(&["todi"]);
    assert!(bench.told().is_empty());
    kind(&mut bench, "tilt", "drift");
    bench.again(&["todi"]);
    assert_eq!(bench.told(), ["raised todi/nave-1", "cleared nave-1"]);
    assert!(bench.outbox.standing_notices().unwrap().is_empty());
}
