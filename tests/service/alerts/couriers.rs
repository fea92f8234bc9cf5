//! Delivery at least once, in order, with the same id, whatever fails or is restarted.

use super::desk::*;
use super::fake::{Answer, Fake};
use std::collections::BTreeSet;
use std::net::TcpListener;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};
use tirante::analysis::track::{Kind, What};
use tirante::config::settings::alert::{AlertSettings, SinkSettings};
use tirante::service::alert::Message;
use tirante::service::telemetry::{Fault, Phase};

fn hook(url: &str) -> String {
    format!("\n[[sink]]\nid = \"hook\"\nkind = \"webhook\"\nurl = \"{url}\"\n")
}

fn to(fake: &Fake) -> Vec<SinkSettings> {
    sinks(&hook(&fake.url()))
}

/// The messages that came, each once.
fn firsts(fake: &Fake) -> Vec<String> {
    let mut seen = BTreeSet::new();
    let ids = fake
        .bodies()
        .into_iter()
        .map(|body| body["id"].as_str().unwrap().to_owned());
    ids.filter(|id| seen.insert(id.clone())).collect()
}

fn id(what: &str, alarm: &tirante::analysis::track::Alarm) -> String {
    let time = alarm.cleared.unwrap_or(alarm.raised);
    format!("{}-{what}-{}", alarm.id, time.as_nanos() / 1_000_000_000)
}

#[test]
fn news_arrive_once_and_in_order() {
    let (desk, fake) = (Desk::new(), Fake::new(&[]));
    let couriers = desk.start(&to(&fake));
    eventually("the sink is known", || desk.delivered("hook") == Some(0));
    let mut expected = Vec::new();
    for hour in 0..20 {
        expected.push(id("raised", &desk.raise(hour)));
        expected.push(id("cleared", &desk.clear(hour)));
        couriers.wake();
    }
    eventually("all is marked", || desk.delivered("hook") == Some(40));
    couriers.stop();
    let bodies = fake.bodies();
    assert_eq!(field(&bodies, "id"), expected);
    assert_eq!(bodies[39]["stands"], false);
    assert_eq!(desk.condition("hook"), None);
}

#[test]
fn whatever_fails_is_sent_again_with_the_same_id_ever_more_rarely() {
    let desk = Desk::new();
    let fake = Fake::new(&[
        Answer::Status(500, ""),
        Answer::Drop,
        Answer::Hang(Duration::from_secs(2)),
        Answer::Status(404, ""),
        Answer::Status(307, "Location: http://example.org/\r\n"),
        Answer::Status(400, ""),
        Answer::Status(500, ""),
    ]);
    let couriers = desk.start(&to(&fake));
    eventually("the sink is known", || desk.delivered("hook") == Some(0));
    let alarms = [desk.raise(0), desk.raise(1)];
    couriers.wake();
    eventually("the trouble is told", || {
        desk.condition("hook").is_some_and(|detail| {
            detail.contains("answers 500") && detail.contains("(answer)") && detail.contains("tried again in")
        })
    });
    eventually("both are marked", || desk.delivered("hook") == Some(2));
    eventually("the trouble is over", || desk.condition("hook").is_none());
    couriers.stop();
    let requests = fake.requests();
    let ids: Vec<&str> = requests.iter().map(|r| r.body["id"].as_str().unwrap()).collect();
    assert_eq!(
        ids[..8],
        [id("raised", &alarms[0]).as_str(); 8],
        "the second waits for the first"
    );
    assert_eq!(ids[8..], [id("raised", &alarms[1]).as_str()]);
    for request in &requests {
        assert_eq!(
            request.headers["idempotency-key"],
            request.body["id"].as_str().unwrap()
        );
    }
    // 10 ms doubled six times, a fifth more or less.
    let waits: Vec<f64> = requests
        .windows(2)
        .map(|pair| (pair[1].time - pair[0].time).as_secs_f64())
        .collect();
    for (n, wait) in waits[..7].iter().enumerate() {
        assert!(*wait >= 0.8 * 0.01 * 2f64.powi(n as i32), "{waits:?}");
    }
}

#[test]
fn a_server_that_asks_for_time_gets_it() {
    let desk = Desk::new();
    let fake = Fake::new(&[
        Answer::Status(429, "Retry-After: 1\r\n"),
        Answer::Status(503, "Retry-After: 1\r\n"),
        Answer::Status(500, "Retry-After: 3600\r\n"),
    ]);
    let couriers = desk.start(&to(&fake));
    eventually("the sink is known", || desk.delivered("hook") == Some(0));
    desk.raise(0);
    couriers.wake();
    eventually("it arrives", || desk.delivered("hook") == Some(1));
    couriers.stop();
    let times: Vec<Instant> = fake.requests().iter().map(|request| request.time).collect();
    assert!(times[1] - times[0] >= Duration::from_millis(990));
    assert!(times[2] - times[1] >= Duration::from_millis(990));
    assert!(
        times[3] - times[2] < Duration::from_millis(900),
        "500 asks for nothing"
    );
}

/// Days without the sink: the events wait in the store, and nothing waits for them.
#[test]
fn a_thousand_news_survive_an_outage_and_arrive_in_order() {
    let desk = Desk::new();
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let sinks = sinks(&hook(&format!("http://{address}/")));
    let couriers = desk.start(&sinks);
    eventually("the sink is known", || desk.delivered("hook") == Some(0));
    let mut expected = Vec::new();
    for hour in 0..500 {
        expected.push(id("raised", &desk.raise(hour)));
        expected.push(id("cleared", &desk.clear(hour)));
        couriers.wake();
    }
    eventually("the outage is told", || desk.condition("hook").is_some());
    eventually("the log has all", || desk.delivered("log") == Some(1000));
    assert_eq!(desk.delivered("hook"), Some(0));
    // A restart in the middle of it.
    couriers.stop();
    let couriers = desk.start(&sinks);
    let fake = Fake::at(address, &[], None);
    eventually("all is marked", || desk.delivered("hook") == Some(1000));
    eventually("the outage is over", || desk.condition("hook").is_none());
    couriers.stop();
    assert_eq!(field(&fake.bodies(), "id"), expected);
}

/// Killed between the send and its mark: sent again, with the same id.
#[test]
fn a_restart_before_the_mark_repeats_the_same_id() {
    let (desk, fake) = (Desk::new(), Fake::new(&[]));
    let couriers = desk.start(&to(&fake));
    eventually("the sink is known", || desk.delivered("hook/standing").is_some());
    couriers.stop();
    let expected: Vec<String> = (0..3).map(|hour| id("raised", &desk.raise(hour))).collect();
    // These reports never reach the store.
    let (reports, lost) = sync_channel(100);
    let couriers = desk.start_with(&to(&fake), reports);
    eventually("all are sent", || fake.requests().len() == 3);
    couriers.stop();
    assert!(lost.iter().count() > 0, "and the queue is closed");
    assert_eq!(desk.delivered("hook"), Some(0));
    let couriers = desk.start(&to(&fake));
    eventually("all are marked", || desk.delivered("hook") == Some(3));
    couriers.stop();
    assert_eq!(field(&fake.bodies(), "id"), [expected.clone(), expected].concat());
}

#[test]
fn a_new_sink_is_told_what_stands_and_then_what_comes() {
    let desk = Desk::new();
    desk.raise(0);
    desk.clear(0);
    let stands = desk.tell("south", Kind::Drift, 1, What::Raised);
    let latched = desk.tell("south", Kind::Limit, 2, What::Raised);
    desk.tell("south", Kind::Limit, 2, What::Cleared);
    // While it cannot be reached, one comes and goes and one comes to stay; and the daemon is restarted.
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let sinks = sinks(&hook(&format!("http://{address}/")));
    let couriers = desk.start(&sinks);
    eventually("it is known from here on", || desk.delivered("hook") == Some(5));
    let came = desk.raise(3);
    let went = desk.clear(3);
    let stays = desk.tell("south", Kind::NotAxial, 4, What::Raised);
    eventually("it fails", || desk.condition("hook").is_some());
    couriers.stop();
    let fake = Fake::at(address, &[], None);
    let couriers = desk.start(&sinks);
    eventually("all is marked", || desk.delivered("hook") == Some(8));
    couriers.stop();
    let mut limit = latched;
    limit.cleared = Some(limit.raised.plus_seconds(120.0));
    let expected = [
        Message::standing(SITE, &stands, None).id,
        Message::standing(SITE, &limit, None).id,
        id("raised", &came),
        id("cleared", &went),
        id("raised", &stays),
    ];
    assert_eq!(field(&fake.bodies(), "id"), expected);
    assert_eq!(field(&fake.bodies(), "what")[..2], ["standing"; 2]);
    // It is reported once.
    let couriers = desk.start(&sinks);
    let last = desk.raise(5);
    couriers.wake();
    eventually("the next is marked", || desk.delivered("hook") == Some(9));
    couriers.stop();
    assert_eq!(firsts(&fake).last(), Some(&id("raised", &last)));
    assert_eq!(fake.requests().len(), 6);
}

#[test]
fn a_centre_tells_what_stands_or_that_it_was_raised_and_not_both() {
    let (desk, fake) = (Desk::new(), Fake::new(&[]));
    // Killed after it noted from where on it tells, and before it told what stood there.
    for mark in ["hook/conditions", "hook"] {
        desk.reports.send((mark.to_owned(), 0)).unwrap();
    }
    eventually("they are noted", || desk.delivered("hook") == Some(0));
    // More conditions than are read at once.
    let about: Vec<String> = (0..130).map(|number| format!("sink-{number}")).collect();
    desk.relay("todi", &["nave-1"], &about);
    let couriers = desk.start(&to(&fake));
    eventually("all is marked", || {
        desk.delivered("hook") == Some(1) && desk.delivered("hook/conditions") == Some(130)
    });
    couriers.stop();
    let bodies = fake.bodies();
    assert_eq!(bodies.len(), 131);
    assert!(field(&bodies, "what").iter().all(|what| *what == "raised"));
    assert!(field(&bodies, "site").iter().all(|site| *site == "todi"));
}

#[test]
fn a_reload_sends_nothing_twice() {
    let (desk, fake) = (Desk::new(), Fake::new(&[]));
    // No mark reaches the store: only the couriers themselves know how far they are.
    let (reports, unwritten) = sync_channel(100);
    let mut couriers = desk.start_with(&to(&fake), reports);
    let next = |couriers: &tirante::service::alert::Couriers, hour| {
        let alarm = desk.raise(hour);
        couriers.wake();
        eventually("it arrives", || fake.requests().len() == hour + 1);
        // The answer, too: news whose answer is on its way are sent again.
        eventually("it is marked", || {
            unwritten.try_iter().any(|(sink, _)| sink == "hook")
        });
        id("raised", &alarm)
    };
    eventually("the sink is known", || {
        unwritten.try_iter().any(|(sink, _)| sink == "hook/standing")
    });
    let mut expected = vec![next(&couriers, 0)];
    couriers.reload(&to(&fake), SITE);
    expected.push(next(&couriers, 1));
    let changed = sinks(&(hook(&fake.url()) + "headers = [\"X-New: 1\"]\n"));
    couriers.reload(&changed, SITE);
    expected.push(next(&couriers, 2));
    assert_eq!(field(&fake.bodies(), "id"), expected);
    assert_eq!(fake.requests()[2].headers["x-new"], "1");
    couriers.reload(&[], SITE);
    desk.raise(3);
    couriers.wake();
    couriers.stop();
    assert_eq!(fake.requests().len(), 3);
}

#[test]
fn couriers_stop_at_once() {
    let desk = Desk::new();
    let hanging = Fake::new(&vec![Answer::Hang(Duration::from_secs(5)); 10]);
    let failing = Fake::new(&vec![Answer::Status(500, "Retry-After: 60\r\n"); 10_000]);
    let second = hook(&failing.url()).replace("\"hook\"", "\"other\"");
    let sinks = sinks(&(hook(&hanging.url()) + &second));
    let (reports, received) = sync_channel(1);
    let couriers = desk.start_with(&sinks, reports);
    // Three sinks report where they begin, and the queue holds one report: the others wait.
    let mut reports = 0;
    while reports < 6 && received.recv_timeout(Duration::from_millis(500)).is_ok() {
        reports += 1;
    }
    assert_eq!(reports, 6, "where they begin, and that nothing stood");
    desk.raise(0);
    couriers.wake();
    eventually("one hangs", || !hanging.requests().is_empty());
    eventually("one fails", || !failing.requests().is_empty());
    let begun = Instant::now();
    couriers.stop();
    assert!(
        begun.elapsed() < Duration::from_millis(250),
        "{:?}",
        begun.elapsed()
    );
    // No courier holds the queue open, not even one that hangs.
    let begun = Instant::now();
    while received.recv().is_ok() {}
    assert!(
        begun.elapsed() < Duration::from_millis(250),
        "{:?}",
        begun.elapsed()
    );
}

/// A sink removed while it hangs reports nothing more, however its send ends.
#[test]
fn a_sink_that_is_taken_out_leaves_no_condition_behind() {
    let desk = Desk::new();
    let hanging = Fake::new(&vec![Answer::Hang(Duration::from_secs(5)); 10]);
    let mut couriers = desk.start(&to(&hanging));
    eventually("the sink is known", || desk.delivered("hook") == Some(0));
    desk.raise(0);
    couriers.wake();
    eventually("the second send hangs", || hanging.requests().len() == 2);
    assert!(desk.condition("hook").is_some());
    couriers.reload(&[], SITE);
    // Longer than the send may take: FAST.deadline.
    let until = Instant::now() + 3 * FAST.deadline;
    while Instant::now() < until {
        assert_eq!(desk.condition("hook"), None);
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(hanging.requests().len(), 2);
    couriers.stop();
}

#[test]
fn a_full_queue_keeps_couriers_neither_from_sending_nor_from_stopping() {
    let (desk, fake) = (Desk::new(), Fake::new(&[]));
    let (reports, received) = sync_channel(1);
    let couriers = desk.start_with(&to(&fake), reports);
    eventually("the first report", || received.try_iter().next().is_some());
    // It stays full while an archive is read: alarms arrive all the same.
    eventually("the sink is known", || {
        !fake.requests().is_empty() || {
            desk.raise(fake.requests().len());
            couriers.wake();
            false
        }
    });
    for hour in 1000..1020 {
        desk.raise(hour);
    }
    couriers.wake();
    let last = at(1019).to_string();
    eventually("all arrive", || {
        fake.bodies()
            .last()
            .is_some_and(|body| body["raised"] == last.as_str())
    });
    let begun = Instant::now();
    couriers.stop();
    assert!(
        begun.elapsed() < Duration::from_millis(250),
        "{:?}",
        begun.elapsed()
    );
}

#[test]
fn a_sink_hears_only_what_it_wants() {
    let (desk, fake) = (Desk::new(), Fake::new(&[]));
    let filtered = sinks(&(hook(&fake.url()) + "kinds = [\"drift\", \"no-data\"]\nrods = [\"south\"]\n"));
    let couriers = desk.start(&filtered);
    eventually("the sink is known", || desk.delivered("hook") == Some(0));
    for hour in 0..250 {
        desk.raise(hour);
    }
    desk.tell("north", Kind::Drift, 250, What::Raised);
    let wanted = desk.tell("south", Kind::Drift, 251, What::Raised);
    desk.tell("south", Kind::Limit, 252, What::Raised);
    couriers.wake();
    eventually("all is marked", || desk.delivered("hook") == Some(253));
    couriers.stop();
    assert_eq!(field(&fake.bodies(), "id"), [id("raised", &wanted)]);
}

#[test]
fn a_store_that_cannot_be_read_is_told_and_tried_again() {
    let (desk, fake) = (Desk::new(), Fake::new(&[]));
    let missing = desk.path("none.db");
    let couriers = tirante::service::alert::Couriers::start_at(
        FAST,
        &to(&fake),
        SITE,
        &missing,
        Box::new(|_, _| true),
        desk.telemetry.clone(),
    );
    eventually("it is told", || {
        desk.condition("hook").is_some() && desk.condition("log").is_some()
    });
    drop(tirante::site::store::Store::open(&missing, tirante::site::store::Durability::Replay).unwrap());
    eventually("it is over", || desk.condition("hook").is_none());
    couriers.stop();
}

#[test]
fn a_word_a_day_goes_to_those_who_asked_for_it() {
    let (desk, fake, other) = (Desk::new(), Fake::new(&[]), Fake::new(&[]));
    let two = hook(&fake.url()) + &hook(&other.url()).replace("\"hook\"", "\"other\"");
    let mut couriers = desk.start(&sinks(&two));
    let alert = AlertSettings {
        daily: vec!["hook".to_owned()],
        daily_h: 6.0,
        ..AlertSettings::default()
    };
    couriers.watch(&alert, SITE);
    // `at(0)` is six in the morning.
    let words = || {
        fake.bodies()
            .iter()
            .filter(|body| body["what"] == "alive")
            .count()
    };
    for (seconds, count) in [(-10.0, 0), (1.0, 1), (2.0, 1), (86_399.0, 1), (86_400.0, 2)] {
        couriers.look_at_clock(at(0).plus_seconds(seconds));
        eventually("the word", || words() == count);
    }
    desk.health.hold(Fault::Clock, "clock", "it jumped");
    couriers.look_at_clock(at(49));
    eventually("the word", || words() == 3);
    couriers.stop();
    let bodies = fake.bodies();
    assert!(
        bodies[0]["message"]
            .as_str()
            .unwrap()
            .contains("nothing is wrong")
    );
    assert!(
        bodies[2]["message"]
            .as_str()
            .unwrap()
            .contains("clock: it jumped")
    );
    assert_eq!(bodies.len(), 3, "each once");
    assert!(other.bodies().is_empty());
}

#[test]
fn the_last_words_are_out_before_the_daemon_ends() {
    let (desk, fake) = (Desk::new(), Fake::new(&[]));
    // One that nobody answers holds nothing up for long.
    let dead = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", dead.local_addr().unwrap());
    let both = hook(&fake.url()) + &hook(&url).replace("\"hook\"", "\"dead\"");
    let couriers = desk.start(&sinks(&both));
    let begun = Instant::now();
    couriers.tell_end("the store cannot be written: disk I/O error");
    let bodies = fake.bodies();
    assert_eq!(bodies.len(), 1, "before the call returns");
    assert_eq!(bodies[0]["what"], "ended");
    assert!(bodies[0]["message"].as_str().unwrap().contains("disk I/O error"));
    assert!(begun.elapsed() < Duration::from_secs(8), "{:?}", begun.elapsed());
    couriers.stop();
}

#[test]
fn the_position_of_the_copy_to_a_centre_is_no_sinks_mark() {
    let desk = Desk::new();
    let stands = desk.raise(0);
    // As a program that copies to a centre noted the number of its last commit once.
    desk.reports.send(("forward".to_owned(), 57)).unwrap();
    eventually("it is noted", || desk.delivered("forward") == Some(57));
    let fake = Fake::new(&[]);
    let sinks = sinks(&hook(&fake.url()).replace("\"hook\"", "\"forward\""));
    let couriers = desk.start(&sinks);
    eventually("it is known from here on", || {
        desk.delivered("forward") == Some(1)
    });
    // Beside the list of what stands, in which it must not be.
    let next = desk.raise(1);
    couriers.wake();
    eventually("the next is marked", || desk.delivered("forward") == Some(2));
    couriers.stop();
    let expected = [Message::standing(SITE, &stands, None).id, id("raised", &next)];
    assert_eq!(field(&fake.bodies(), "id"), expected);
    assert!(tirante::service::forward::SINK.contains('/'), "an id of a sink");
}

#[test]
fn a_dead_switch_and_a_sink_of_its_name_have_conditions_of_their_own() {
    let desk = Desk::new();
    let fake = Fake::new(&[]);
    let text = hook(&fake.url()).replace("\"hook\"", "\"heartbeat\"");
    let dead = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let config = config_text(&format!(
        "{text}\n[alert.heartbeat]\nurl = \"http://{dead}/\"\nevery_min = 0.01\n"
    ));
    let config = tirante::config::Config::parse(&config, "test").unwrap();
    desk.telemetry.enter(Phase::Serving);
    let mut couriers = desk.start(&config.sinks);
    couriers.watch(&config.alert, SITE);
    eventually("the switch is dead", || {
        desk.condition("alert/heartbeat").is_some()
    });
    // The sink works, which says nothing about the switch.
    desk.raise(0);
    couriers.wake();
    eventually("the sink has it", || desk.delivered("heartbeat") == Some(1));
    assert!(desk.condition("alert/heartbeat").is_some());
    assert_eq!(desk.condition("heartbeat"), None);
    couriers.stop();
}
