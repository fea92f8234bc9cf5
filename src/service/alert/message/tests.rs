//! Tests of the forms of a message.

use super::*;
use crate::analysis::signal::record::RodId;
use crate::analysis::track::alarm::Kind;

const RAISED: Timestamp = Timestamp::from_nanos(1_780_000_000_500_000_000);

fn drift() -> Alarm {
    let interval = |mean: f64| Interval {
        mean,
        sd: 0.005,
        q025: mean - 0.01,
        q975: mean + 0.01,
    };
    let mut alarm = Alarm::new(
        &RodId("nave-3".into()),
        Kind::Drift,
        1,
        RAISED,
        "The force fell by 4 %.".into(),
    );
    alarm.change = Some(Change {
        onset: RAISED.plus_seconds(-86_400.0),
        onset_q025: RAISED.plus_seconds(-2.0 * 86_400.0),
        onset_q975: RAISED,
        size: interval(-0.04),
        rate_per_year: interval(0.0),
        step_probability: 0.9,
    });
    alarm
}

fn news(what: alarm::What, time: Timestamp, alarm: Alarm) -> News {
    News {
        number: 5,
        rod: alarm.rod.clone(),
        event: AlarmEvent { what, time, alarm },
        words: None,
    }
}

/// Names and order of the fields are a contract: docs/sinks.md.
#[test]
fn the_json_is_the_documented_one() {
    let message = Message::of_news("Duomo", &news(alarm::What::Raised, RAISED, drift()));
    let id = &message.alarm;
    assert_eq!(
        message.json(),
        format!(
            concat!(
                r#"{{"version":1,"id":"{0}-raised-1780000000","what":"raised","time":"2026-05-28T20:26:40.5Z","#,
                r#""site":"Duomo","rod":"nave-3","alarm":"{0}","kind":"drift","raised":"2026-05-28T20:26:40.5Z","#,
                r#""message":"The force fell by 4 %.","stands":true,"acknowledged":null,"cleared":null,"#,
                r#""change":{{"onset":"2026-05-27T20:26:40.5Z","onset_q025":"2026-05-26T20:26:40.5Z","#,
                r#""onset_q975":"2026-05-28T20:26:40.5Z","size":{{"mean":-0.04,"sd":0.005,"q025":-0.05,"q975":-0.03}},"#,
                r#""rate_per_year":{{"mean":0.0,"sd":0.005,"q025":-0.01,"q975":0.01}},"step_probability":0.9}}}}"#
            ),
            id
        )
    );
}

#[test]
fn a_condition_of_the_daemon_is_told_with_one_id_and_nothing_to_acknowledge() {
    let begun = ConditionEvent::raised("disk-full", "site.db", RAISED, "no room on the disk");
    let message = Message::of_notice("Duomo", &begun);
    assert_eq!(message.subject(), "Duomo, monitoring: disk-full");
    let text = message.text();
    assert!(
        text.contains("disk-full (site.db)") && !text.contains("tirante ack"),
        "{text}"
    );
    let over = Message::of_notice("Duomo", &begun.cleared(RAISED.plus_seconds(60.0)));
    assert_eq!(over.subject(), "Duomo, monitoring: disk-full is over");
    assert!(message.stands && !over.stands && over.alarm == message.alarm);
    assert!(
        over.text().contains("Over:         2026-05-28T20:27:40.5Z"),
        "{}",
        over.text()
    );
    let json: serde_json::Value = serde_json::from_str(&over.json()).unwrap();
    assert_eq!((&json["rod"], &json["about"]), (&"".into(), &"site.db".into()));
}

#[test]
fn every_news_of_an_alarm_has_an_id_of_its_own_and_always_the_same() {
    let mut ids: Vec<String> = [
        (alarm::What::Raised, 0.0),
        (alarm::What::Repeated, 1e6),
        (alarm::What::Repeated, 2e6),
        (alarm::What::Acknowledged, 2e6),
        (alarm::What::Cleared, 2e6),
    ]
    .map(|(what, s)| Message::of_news("Duomo", &news(what, RAISED.plus_seconds(s), drift())).id)
    .to_vec();
    ids.push(Message::standing("Duomo", &drift(), None).id);
    assert_eq!(ids.iter().collect::<std::collections::BTreeSet<_>>().len(), 6);
    assert_eq!(ids[5], Message::standing("Duomo", &drift(), None).id);
}

#[test]
fn a_centre_tells_an_alarm_under_its_sites_name() {
    let mut alarm = drift();
    let own = Message::of_news("centre", &news(alarm::What::Raised, RAISED, alarm.clone()));
    alarm.id = format!("todi/{}", alarm.id);
    alarm.rod = RodId("todi/nave-3".into());
    let message = Message::of_news("centre", &news(alarm::What::Raised, RAISED, alarm));
    assert_eq!(
        (message.site.as_str(), message.rod.as_str(), &message.alarm),
        ("todi", "nave-3", &own.alarm)
    );
    assert_eq!(message.id, format!("todi/{}", own.id));
    assert_eq!(message.subject(), "todi, rod nave-3: drift raised");
    let hint = format!("tirante hub command todi acknowledge {} --by", own.alarm);
    assert!(message.text().contains(&hint), "{}", message.text());
    let mut begun = ConditionEvent::raised("disk-full", "site.db", RAISED, "no room on the disk");
    begun.condition = format!("todi/{}", begun.condition);
    let message = Message::of_notice("centre", &begun);
    assert_eq!(message.subject(), "todi, monitoring: disk-full");
}

#[test]
fn an_acknowledgement_says_who_and_why() {
    let mut alarm = drift();
    alarm.acknowledged = Some(RAISED.plus_seconds(60.0));
    let mut event = news(alarm::What::Acknowledged, RAISED.plus_seconds(60.0), alarm);
    let silent = Message::of_news("Duomo", &event);
    assert!(!silent.json().contains("acknowledged_words"), "{}", silent.json());
    event.words = Some("M. \"Mario\" Rossi: wedge sound".to_owned());
    let message = Message::of_news("Duomo", &event);
    let end = r#","acknowledged_words":"M. \"Mario\" Rossi: wedge sound"}"#;
    assert!(message.json().ends_with(end), "{}", message.json());
    let lines = "Acknowledged: 2026-05-28T20:27:40.5Z\nBy:           M. \"Mario\" Rossi: wedge sound\n";
    assert!(message.text().contains(lines), "{}", message.text());
}

#[test]
fn people_read_what_to_do() {
    let mut alarm = drift();
    let message = Message::standing("Duomo", &alarm, None);
    assert_eq!(message.subject(), "Duomo, rod nave-3: drift stands");
    let text = message.text();
    assert!(text.contains("-4.0 % (95 %: -5.0 % to -3.0 %)"), "{text}");
    assert!(
        text.contains(&format!("tirante ack --config FILE {}", alarm.id)),
        "{text}"
    );
    alarm.acknowledged = Some(RAISED);
    alarm.cleared = Some(RAISED);
    let text = Message::standing("Duomo", &alarm, None).text();
    assert!(
        text.contains("Stands:       no") && !text.contains("tirante ack"),
        "{text}"
    );
}
