//! Three servers of one cluster as the post, of which any one may be gone, and which lose no more than what sites send again.

use super::fleet::{Fleet, Storage};
use tirante::service::forward::message::STREAM;

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

/// One server, and all three, set back to what they had before the latest records: what a loss of power leaves where writes were not
/// flushed. The stream alone has everything again.
/// `cargo test --test process hub::cluster -- --ignored --nocapture`
#[test]
#[ignore = "a minute or two"]
fn servers_that_lost_power_lose_nothing() {
    for lost in [&[1][..], &[0, 1, 2]] {
        let Some(mut fleet) = Fleet::clustered(&["todi", "gubbio"], Storage::Sqlite) else {
            return;
        };
        for place in 0..2 {
            fleet.hide_later_weeks(place);
        }
        fleet.start();
        for place in 0..2 {
            fleet.wait_until_read(place, 3);
        }
        fleet.wait_until_sent();
        let copy = fleet.copy_stream();
        fleet.wait_until_healthy();
        for place in 0..2 {
            fleet.show_later_weeks(place);
        }
        fleet.wait_until_equal();
        let before = fleet.messages_of(STREAM);
        fleet.set_stream_back(&copy, lost);
        fleet.wait_until_healthy();
        fleet.wait_until_still();
        for place in 0..2 {
            fleet.assert_equal(place, &[]);
        }
        fleet.stop_hub();
        for place in 0..2 {
            fleet.wait_until_rebuilt(place);
        }
        eprintln!(
            "servers {lost:?} set back: {} messages before, {} now, the stream alone gives the rows of the replays",
            before,
            fleet.messages_of(STREAM)
        );
    }
}
