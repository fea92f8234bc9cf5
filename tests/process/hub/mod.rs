//! Sites, post and centre with real servers: the centre's rows are those of each site's `replay`, whatever is killed.

mod alarms;
mod beats;
mod cluster;
mod commands;
mod database;
mod figures;
mod fleet;
mod pages;
mod poison;
mod power;
mod refusals;
mod returning;
mod rights;
mod servers;
mod thin;
mod wire;

use crate::site::{Part, lines};
use fleet::{Fleet, Storage};
use rand::RngExt;
use serde_json::Value;
use std::fs;
use std::thread;
use std::time::Duration;
use tirante::analysis::numerics::random;

#[test]
fn two_sites_end_in_one_sqlite_file_as_replayed() {
    let Some(mut fleet) = Fleet::of(&["todi", "gubbio"], Storage::Sqlite) else {
        return;
    };
    fleet.start();
    fleet.wait_until_equal();
    let sites = lines(
        fleet
            .hub_command(&["sites", "--format", "json"])
            .stdout
            .as_slice(),
    );
    assert_eq!(sites.len(), 2);
    for site in &sites {
        assert_eq!(site["stores"], 1, "{site}");
        assert_eq!(site["parked"], 0, "{site}");
    }
    // The losses of a tenth have alarmed.
    assert_eq!(sites[0]["worst"], "alarm");
    let page = fleet.get("/");
    assert!(page.contains("todi") && page.contains("gubbio") && page.contains("alarm"));
    // One region for readers of the screen, and no reload that takes the place in it away.
    assert!(page.contains("<main>") && !page.contains("http-equiv"));
    assert!(fleet.get("/follow.js").contains("text/javascript"));
    assert!(
        fleet
            .get("/metrics")
            .contains("tirante_site_alarms{site=\"gubbio\"}")
    );
    assert!(fleet.get("/healthz").contains("\"ok\""));
    // A site whose store is replaced begins a history of its own; the old one stays.
    fleet.stop_edge(0);
    fleet.remove_store(0);
    fleet.start_edge(0);
    fleet.wait_until_equal();
    let sites = lines(
        fleet
            .hub_command(&["sites", "--format", "json"])
            .stdout
            .as_slice(),
    );
    let todi = sites.iter().find(|site| site["site"] == "todi").unwrap();
    assert_eq!(todi["stores"], 2, "{todi}");
    fleet.assert_equal(0, &["--segment", "1"]);
    // Everything again, from the stream alone.
    fleet.stop_hub();
    let rebuilt = fleet.hub_command(&["rebuild"]);
    assert!(
        rebuilt.status.success(),
        "{}",
        String::from_utf8_lossy(&rebuilt.stderr)
    );
    fleet.assert_equal(0, &["--segment", "1"]);
    fleet.assert_equal(0, &[]);
    fleet.assert_equal(1, &[]);
    // A difference is found.
    let site = &fleet.edges[1].site;
    site.simulate("more", &Part::new(60, 2));
    let (_, code) = site.replay(&["archive"], "longer.db");
    assert!(code == 0 || code == 3);
    let compared = fleet.compare(1, "longer.db", &[]);
    assert_eq!(compared.status.code(), Some(3));
}

/// Kills in the gate; [`a_campaign_of_kills`] has more.
const KILLS: u32 = 12;
/// Kills between two comparisons; then the sites begin new stores, so that records are under way again.
const ROUND: u32 = 12;

#[test]
fn whatever_is_killed_the_centre_has_the_rows_of_a_replay() {
    let Some(mut fleet) = Fleet::wired(&["todi", "gubbio"], Storage::Postgres) else {
        return;
    };
    kill_at_random(&mut fleet, KILLS, 0);
    // Grafana's questions have answers.
    for question in questions() {
        assert!(fleet.rows(&question) > 0, "{question}");
    }
}

/// `KILLS=1000 cargo test --test process hub::a_campaign -- --ignored --nocapture`
#[test]
#[ignore = "minutes to hours"]
fn a_campaign_of_kills() {
    let kills = std::env::var("KILLS").map_or(100, |text| text.parse().unwrap());
    for (storage, share) in [
        (Storage::Postgres, kills - kills / 4),
        (Storage::Sqlite, kills / 4),
    ] {
        let Some(mut fleet) = Fleet::wired(&["todi", "gubbio"], storage) else {
            return;
        };
        let seed = std::env::var("SEED").map_or(0, |text| text.parse().unwrap());
        kill_at_random(&mut fleet, share, seed);
    }
}

/// Kills sites, hub, post and database and cuts the networks between them, one at a time, and compares the centre with the replays
/// after each round.
fn kill_at_random(fleet: &mut Fleet, kills: u32, seed: u64) {
    let mut generator = random::stream(random::seed(&[b"hub kill"]), seed);
    let mut killed = [0; 6];
    let victims = if fleet.has_server() { 6 } else { 5 };
    fleet.start();
    for kill in 0..kills {
        if kill > 0 && kill % ROUND == 0 {
            fleet.wait_until_whole();
            fleet.wait_until_equal();
            eprintln!("{kill} kills and cuts: tables equal");
            for place in 0..2 {
                fleet.stop_edge(place);
                fleet.remove_store(place);
                fleet.start_edge(place);
            }
        }
        thread::sleep(Duration::from_millis(generator.random_range(0..400)));
        let victim = generator.random_range(0..victims);
        killed[victim] += 1;
        match victim {
            0 | 1 => fleet.kill_edge(victim),
            2 => fleet.kill_hub(),
            3 => fleet.kill_nats(),
            4 => fleet.cut(&mut generator),
            _ => fleet.kill_postgres(),
        }
    }
    fleet.wait_until_whole();
    fleet.wait_until_equal();
    let met = fleet.cuts_met();
    eprintln!(
        "{kills} kills and cuts (site, site, hub, post, network, database: {killed:?}; {met} cuts met by a connection): tables equal"
    );
    assert!(met > 0, "no network was cut");
    let sites = lines(&fleet.hub_command(&["sites", "--format", "json"]).stdout);
    assert_eq!(sites.len(), 2);
    for site in &sites {
        assert_eq!(
            (&site["parked"], &site["fault"]),
            (&Value::from(0), &Value::Null),
            "{site}"
        );
    }
}

/// SQL of the shipped dashboard, for one site and all times.
fn questions() -> Vec<String> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/config/fleet/dashboard.json");
    let dashboard: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let variables = dashboard["templating"]["list"].as_array().unwrap();
    let of_panels = panels.iter().map(|panel| &panel["targets"][0]["rawSql"]);
    let of_variables = variables
        .iter()
        .filter(|one| one["type"] == "query")
        .map(|one| &one["query"]);
    let questions: Vec<String> = of_panels
        .chain(of_variables)
        .map(|sql| {
            let sql = sql
                .as_str()
                .unwrap()
                .replace("$site", "gubbio")
                .replace("$rod", "'north', 'south'");
            sql.replace("$__unixEpochNanoFrom()", "0")
                .replace("$__unixEpochNanoTo()", "4102444800000000000")
        })
        .collect();
    assert!(questions.len() >= 6);
    questions
}

/// A stream that was set back to an earlier day's copy under a hub that goes on: the sites send again what it lost, and what the
/// hub knows is no fault, not even of a store that was replaced before.
#[test]
fn a_stream_that_was_set_back_loses_nothing() {
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Sqlite) else {
        return;
    };
    fleet.hide_later_weeks(0);
    fleet.start();
    for is_first in [true, false] {
        fleet.wait_until_read(0, 3);
        fleet.wait_until_sent();
        if is_first {
            fleet.stop_edge(0);
            fleet.remove_store(0);
            fleet.start_edge(0);
        }
    }
    let copy = fleet.copy_stream();
    fleet.show_later_weeks(0);
    fleet.wait_until_equal();
    let before = fleet.hub_logged();
    fleet.set_stream_back(&copy, &[0]);
    // A rebuild of half the stream would lose what the site has not sent again.
    fleet.stop_edge(0);
    fleet.stop_hub();
    let rebuilt = fleet.hub_command(&["rebuild"]);
    let said = fleet::text_of(&rebuilt.stderr);
    assert!(
        rebuilt.status.code() == Some(1) && said.contains("would lose results of todi: of store"),
        "{said}"
    );
    fleet.start_hub();
    fleet.wait_for_hub_log(before, "it was set back");
    fleet.start_edge(0);
    // The stream has everything again soon, and the hub has gone through all of it.
    fleet.wait_until_still();
    let sites = lines(&fleet.hub_command(&["sites", "--format", "json"]).stdout);
    assert_eq!(
        (&sites[0]["parked"], &sites[0]["fault"], &sites[0]["stores"]),
        (&Value::from(0), &Value::Null, &Value::from(2)),
        "{sites:?}"
    );
    fleet.assert_equal(0, &[]);
    fleet.stop_hub();
    // A centre that is made from it alone equals the replay.
    fleet.wait_until_rebuilt(0);
}
