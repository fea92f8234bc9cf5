//! A real Alertmanager: an alarm fires there, goes on firing, and is resolved.

use super::desk::*;
use super::fake::Fake;
use super::peers::{Server, program};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tirante::analysis::track::{Kind, What};

fn start(program: &Path, desk: &Desk, storage: &str) -> Server {
    Server::start_anywhere(program, |address| arguments(desk, storage, &address.to_string()))
}

fn arguments(desk: &Desk, storage: &str, address: &str) -> Vec<String> {
    vec![
        format!("--config.file={}", desk.path("alertmanager.yml").display()),
        format!("--storage.path={}", desk.path(storage).display()),
        format!("--web.listen-address={address}"),
        "--cluster.listen-address=".to_owned(),
    ]
}

fn alerts(server: &Server) -> Vec<Value> {
    let url = format!("http://{}/api/v2/alerts", server.address);
    let text = ureq::get(url)
        .call()
        .unwrap()
        .body_mut()
        .read_to_string()
        .unwrap();
    serde_json::from_str(&text).unwrap()
}

/// Each `status` that the Alertmanager sent to its own receiver about an alarm, in order.
fn told(fake: &Fake, alarm: &str) -> Vec<String> {
    let bodies = fake.bodies();
    let alerts = bodies.iter().flat_map(|body| body["alerts"].as_array().unwrap());
    alerts
        .filter(|alert| alert["labels"]["alarm"] == alarm)
        .map(|alert| alert["status"].as_str().unwrap().to_owned())
        .collect()
}

#[test]
fn an_alarm_fires_goes_on_and_is_resolved() {
    let Some(program) = program("prometheus-alertmanager", "prometheus-alertmanager") else {
        return;
    };
    let (desk, receiver) = (Desk::new(), Fake::new(&[]));
    let config = format!(
        "route: {{receiver: hook, group_by: ['alarm'], group_wait: 0s, group_interval: 1s, repeat_interval: 1h}}\n\
         receivers: [{{name: hook, webhook_configs: [{{url: '{}', send_resolved: true}}]}}]\n",
        receiver.url()
    );
    fs::write(desk.path("alertmanager.yml"), config).unwrap();
    let mut server = start(&program, &desk, "first");
    let sinks = sinks(&format!(
        "[[sink]]\nid = \"pager\"\nkind = \"alertmanager\"\nurl = \"http://{}\"\nresend_s = 1\n",
        server.address
    ));
    let couriers = desk.start(&sinks);
    eventually("the sink is known", || desk.delivered("pager") == Some(0));
    let alarm = desk.raise(0);
    couriers.wake();
    eventually("the receiver is told", || {
        told(&receiver, &alarm.id) == ["firing"]
    });
    let fired = &alerts(&server)[0];
    assert_eq!(fired["labels"]["alertname"], "TiranteAlarm");
    assert_eq!(fired["labels"]["site"], SITE);
    assert_eq!(fired["labels"]["rod"], "north");
    assert_eq!(fired["labels"]["kind"], "sensor");
    assert_eq!(fired["annotations"]["description"], "Alarm 0.");
    let ends = |alert: &Value| alert["endsAt"].as_str().unwrap().to_owned();
    let first_end = ends(fired);
    eventually("it is sent again", || {
        alerts(&server)
            .first()
            .is_some_and(|alert| ends(alert) > first_end)
    });

    // A server that lost its state still gets the active alarms.
    server.kill();
    eventually("the outage is told", || desk.condition("pager").is_some());
    let other = desk.raise(1);
    couriers.wake();
    let address = server.address;
    let arguments = arguments(&desk, "second", &address.to_string());
    let server = Server::start(&program, address, &arguments).unwrap();
    eventually("both fire", || alerts(&server).len() == 2);
    eventually("the outage is over", || desk.condition("pager").is_none());

    desk.clear(0);
    couriers.wake();
    eventually("the receiver is told", || {
        told(&receiver, &alarm.id)
            .last()
            .is_some_and(|status| status == "resolved")
    });
    assert!(told(&receiver, &other.id).iter().all(|status| status == "firing"));
    eventually("the mark", || desk.delivered("pager") == Some(3));
    // A sensor's clock far ahead.
    let ahead = desk.tell("south", Kind::Drift, 1_000_000, What::Raised);
    couriers.wake();
    eventually("it fires", || told(&receiver, &ahead.id) == ["firing"]);
    desk.tell("south", Kind::Drift, 1_000_000, What::Acknowledged);
    couriers.wake();
    eventually("the marks", || desk.delivered("pager") == Some(5));
    couriers.stop();
}
