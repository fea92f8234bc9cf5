//! Alarms of all sites through the centre's sinks: each once under its own id, whatever is killed, replaced or rebuilt.

use super::beats::{desk, row, wait};
use super::commands::{command, wait_for};
use super::fleet::{Fleet, Storage, text_of};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;
use tirante::site::store::{Filter, Reader};

/// Messages about rods that a desk has, each id once, with the number of times it came; a suspicion, which ends within a record, may
/// come and go while a hub is down.
fn told(came: &Arc<Mutex<Vec<Value>>>, what: &str) -> BTreeMap<String, (Value, usize)> {
    let came = came.lock().unwrap();
    let mut told = BTreeMap::<String, (Value, usize)>::new();
    for one in came
        .iter()
        .filter(|one| one["what"] == what && one["rod"] != "" && one["kind"] != "suspected")
    {
        let id = one["id"].as_str().unwrap().to_owned();
        told.entry(id).or_insert_with(|| (one.clone(), 0)).1 += 1;
    }
    told
}

/// Ids under which the standing alarms of a site must be told.
fn standing(fleet: &Fleet, place: usize, name: &str) -> Vec<String> {
    let reader = Reader::open(&fleet.edges[place].site.path("site.db")).unwrap();
    let alarms = reader.alarms(&Filter::default()).unwrap();
    let standing = alarms.iter().filter(|alarm| !alarm.is_over());
    standing
        .map(|alarm| {
            let raised_s = alarm.raised.as_nanos() / 1_000_000_000;
            format!("{name}/{}-raised-{raised_s}", alarm.id)
        })
        .collect()
}

fn sink(id: &str, address: &str, more: &str) -> String {
    format!("[[sink]]\nid = \"{id}\"\nkind = \"webhook\"\nurl = \"{address}\"\n{more}")
}

#[test]
fn alarms_of_all_sites_reach_the_centres_sinks_once() {
    let Some(mut fleet) = Fleet::of(&["todi", "gubbio"], Storage::Postgres) else {
        return;
    };
    let (address, came) = desk();
    let (region, came_region) = desk();
    fleet.give_keys();
    fleet.reconfigure_hub(|text| {
        text + &format!("[outbox]\npath = \"{}\"\n", fleet.path("outbox.db").display())
            + &sink("desk", &address, "")
            + &sink("region", &region, "sites = [\"gubbio\"]\n")
    });
    fleet.start();
    for _ in 0..4 {
        thread::sleep(Duration::from_millis(700));
        fleet.kill_hub();
    }
    fleet.wait_until_complete();
    let mut wanted = [standing(&fleet, 0, "todi"), standing(&fleet, 1, "gubbio")].concat();
    wanted.sort();
    assert!(wanted.len() >= 4, "{wanted:?}");
    wait(&fleet, "all alarms are told", || {
        told(&came, "raised").len() == wanted.len()
    });
    let raised = told(&came, "raised");
    assert_eq!(raised.keys().cloned().collect::<Vec<_>>(), wanted);
    // Both sites have rods and alarms of one name: the site tells them apart.
    let (message, _) = raised.values().find(|(one, _)| one["site"] == "todi").unwrap();
    assert!(
        message["rod"] == "north" || message["rod"] == "south",
        "{message}"
    );
    // A region is told of its own sites alone.
    wait(&fleet, "the region is told", || {
        told(&came_region, "raised").len() == standing(&fleet, 1, "gubbio").len()
    });
    assert!(
        told(&came_region, "raised")
            .values()
            .all(|(one, _)| one["site"] == "gubbio")
    );
    // Who acknowledges at the centre sees it told by the centre.
    let alarm = message["alarm"].as_str().unwrap().to_owned();
    let number = command(&fleet, &["acknowledge", &alarm]);
    wait_for(&fleet, number, "carried-out");
    wait(&fleet, "the acknowledgement is told", || {
        let told = told(&came, "acknowledged");
        told.values()
            .any(|(one, _)| one["alarm"] == alarm.as_str() && one["site"] == "todi")
    });
    // A store that is begun anew finds the same alarms again, which is no news; that nobody has acknowledged it there is none either.
    let before = told(&came, "raised").len();
    fleet.stop_edge(0);
    fleet.remove_store(0);
    fleet.start_edge(0);
    fleet.wait_until_complete();
    wait(&fleet, "all of the new store has come", || {
        row(&fleet, "todi")["behind"] == 0
    });
    // A centre that is made anew from the stream tells nothing again.
    fleet.stop_hub();
    let rebuilt = fleet.hub_command(&["rebuild"]);
    assert!(rebuilt.status.success(), "{}", text_of(&rebuilt.stderr));
    let logged = fleet.hub_logged();
    fleet.start_hub();
    fleet.wait_for_hub_log(logged, "ready: 2 sites");
    thread::sleep(Duration::from_secs(5));
    let again = told(&came, "raised");
    assert_eq!(again.len(), before, "{:?}", again.keys());
    // A hub killed between a delivery and its mark sends the message again under its id: at most once a kill.
    let twice = again.values().filter(|(_, times)| *times > 1).count();
    assert!(twice <= 4, "{again:?}");
    // What is left of a site that is taken from the list ends.
    fleet.stop_hub();
    fleet.stop_edge(1);
    fleet.reconfigure_hub(|text| {
        let (begin, rest) = text.split_once("[[site]]\nname = \"gubbio\"\n").unwrap();
        let rest: Vec<&str> = rest
            .split('\n')
            .filter(|line| !line.starts_with("command_key"))
            .collect();
        format!("{begin}{}", rest.join("\n")).replace("sites = [\"gubbio\"]\n", "")
    });
    fleet.start_hub();
    wait(&fleet, "the alarms of gubbio end", || {
        let ended = told(&came, "cleared");
        let of = ended.values().filter(|(one, _)| {
            one["site"] == "gubbio" && one["message"].as_str().unwrap().contains("no longer on the list")
        });
        of.count() == standing(&fleet, 1, "gubbio").len()
    });
}
