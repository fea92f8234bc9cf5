//! Three servers of one cluster as the post, of which any one may be gone.

use super::fleet::{Fleet, Storage};

/// Servers lost in the gate; `SERVERS=50 cargo test --test process hub::cluster` loses more.
const SERVERS: u32 = 1;

#[test]
fn one_server_of_three_may_be_gone() {
    let Some(mut fleet) = Fleet::clustered(&["todi", "gubbio"], Storage::Sqlite) else {
        return;
    };
    let servers = std::env::var("SERVERS").map_or(SERVERS, |text| text.parse().unwrap());
    fleet.start();
    fleet.wait_until_equal();
    for lost in 1..=servers {
        // New stores, so that there is something to send while it is gone.
        for place in 0..2 {
            fleet.stop_edge(place);
            fleet.remove_store(place);
            fleet.start_edge(place);
        }
        let gone = fleet.end_leader();
        fleet.keep_hub();
        fleet.wait_until_equal();
        eprintln!("{lost}: without server {gone} the tables are equal");
        fleet.server_again(gone);
    }
    fleet.wait_until_equal();
    // Each store once, and nothing set aside.
    for site in crate::site::lines(&fleet.hub_command(&["sites", "--format", "json"]).stdout) {
        assert_eq!(
            (&site["stores"], &site["parked"], &site["fault"]),
            (&(servers + 1).into(), &0.into(), &serde_json::Value::Null),
            "{site}"
        );
    }
}
