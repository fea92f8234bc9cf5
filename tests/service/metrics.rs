//! Metrics: the documented ones are those shown, both ways, and labels stay bounded.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::time::{Duration, SystemTime};
use tirante::analysis::outcome::Outcome;
use tirante::analysis::signal::record::{RodId, Timestamp};
use tirante::analysis::track::relative::Interval;
use tirante::analysis::track::{Alarm, AtReference, Kind, RodState, SetAside, Verdict};
use tirante::service::telemetry::metrics::Delivery;
use tirante::service::telemetry::{Fault, Phase, Telemetry};
use tirante::site::store::{Durability, Store};

fn rod() -> RodId {
    RodId("nave-3".into())
}

/// A rod that lost force, and what is known of it after a record.
fn lost() -> Verdict {
    let about = |mean: f64| Interval {
        mean,
        sd: 0.01 * mean,
        q025: 0.98 * mean,
        q975: 1.02 * mean,
    };
    Verdict {
        state: RodState::Alarm,
        segment: 1,
        relative: None,
        at_reference: Some(AtReference {
            temperature_c: 15.0,
            ratio: about(0.96),
            force_n: about(712e3),
        }),
        set_aside: None,
        closed: Vec::new(),
        events: Vec::new(),
        alarms: vec![Alarm::new(
            &rod(),
            Kind::Drift,
            1,
            crate::archive::hour(1),
            "less force".to_owned(),
        )],
    }
}

/// A record of which the last sample came a moment ago.
fn live() -> Outcome {
    let mut outcome = crate::archive::identified(&rod(), 1);
    if let Outcome::Identified(identification) = &mut outcome {
        let measurement = identification.measurement.as_mut().unwrap();
        let now = SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos() as i64;
        let ago = (measurement.duration_s * 1e9) as i64 + 2_000_000_000;
        measurement.start = Timestamp::from_nanos(now - ago);
        identification.conflict.score = 5.0;
    }
    outcome
}

/// A daemon in which everything happened once.
fn everything() -> Telemetry {
    let telemetry = Telemetry::default();
    let metrics = &telemetry.metrics;
    telemetry.enter(Phase::Serving);
    telemetry.health.hold(Fault::Sink, "mail", "refused");
    let took = Duration::from_millis(4);
    metrics.taken(&crate::archive::rejected(&rod(), 0), &lost(), took);
    metrics.taken(&live(), &lost(), took);
    metrics.known(&rod());
    metrics.analysis(Duration::from_millis(20));
    metrics.clients(2);
    metrics.received(10, 1000);
    metrics.journal(1 << 20);
    metrics.outbox("mail", 4);
    metrics.delivery("mail", Delivery::Failed);
    metrics.watch_disk("store", "/".into());
    telemetry.health.credentials().ends("certificate", 1_900_000_000);
    telemetry
}

/// Type, unit, labels and meaning by the name a query uses.
fn shown(text: &str) -> BTreeMap<String, [String; 4]> {
    let mut families: Vec<(String, [String; 4])> = Vec::new();
    for line in text.lines() {
        let mut words = line.splitn(4, ' ');
        match (words.next(), words.next(), words.next(), words.next()) {
            (Some("#"), Some("HELP"), Some(name), Some(help)) => {
                let help = help.trim_end_matches('.').to_owned();
                families.push((
                    name.to_owned(),
                    [String::new(), String::new(), String::new(), help],
                ));
            }
            (Some("#"), Some("TYPE"), Some(name), Some(kind)) => {
                let family = families.last_mut().unwrap();
                assert_eq!(family.0, name);
                family.1[0] = kind.to_owned();
            }
            (Some("#"), Some("UNIT"), _, Some(unit)) => families.last_mut().unwrap().1[1] = unit.to_owned(),
            (Some("#"), Some("EOF"), ..) => {}
            _ => {
                let family = families.last_mut().unwrap();
                assert!(!line.contains("{}"), "{line}");
                assert!(line.starts_with(&family.0), "{line} behind {}", family.0);
                if let Some((labels, _)) = line.split_once('{').and_then(|(_, rest)| rest.split_once('}')) {
                    for label in labels.split("\",").filter(|label| !label.starts_with("le=")) {
                        let name = label.split('=').next().unwrap();
                        if !family.1[2].split(", ").any(|known| known == name) {
                            let comma = if family.1[2].is_empty() { "" } else { ", " };
                            write!(family.1[2], "{comma}{name}").unwrap();
                        }
                    }
                }
            }
        }
    }
    let queried = |(name, facts): (String, [String; 4])| match facts[0].as_str() {
        "counter" => (format!("{name}_total"), facts),
        "info" => (format!("{name}_info"), facts),
        _ => (name, facts),
    };
    families.into_iter().map(queried).collect()
}

#[test]
fn the_documentation_lists_every_metric_and_no_other() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/metrics.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let (begin, end) = (
        "<!-- metrics: written by UPDATE_DOCS=1 cargo test --test service metrics:: -->\n",
        "<!-- end of metrics -->\n",
    );
    let (before, rest) = page.split_once(begin).expect("the mark before the metrics");
    let (listed, after) = rest.split_once(end).expect("the mark behind the metrics");
    let mut wanted = "| name | type | unit | labels | meaning |\n|---|---|---|---|---|\n".to_owned();
    for (name, [kind, unit, labels, help]) in shown(&everything().metrics.text()) {
        writeln!(wanted, "| `{name}` | {kind} | {unit} | {labels} | {help} |").unwrap();
    }
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, format!("{before}{begin}{wanted}{end}{after}")).unwrap();
    } else {
        assert_eq!(
            listed, wanted,
            "UPDATE_DOCS=1 cargo test --test service brings the page up to date"
        );
    }
}

#[test]
fn values_are_those_that_were_given() {
    let text = everything().metrics.text();
    for line in [
        "tirante_records_total{rod=\"nave-3\",outcome=\"used\"} 1",
        "tirante_records_total{rod=\"nave-3\",outcome=\"rejected\"} 1",
        "tirante_records_total{rod=\"nave-3\",outcome=\"known\"} 1",
        "tirante_alarms_standing{rod=\"nave-3\",kind=\"limit\"} 0",
        "tirante_rod_relative_force{rod=\"nave-3\"} 0.96",
        "tirante_latency_seconds_count 1",
        "tirante_latency_seconds_bucket{le=\"1.0\"} 0",
        "tirante_latency_seconds_bucket{le=\"10.0\"} 1",
        "tirante_received_bytes_total 1000",
        "tirante_rod_force_newtons{rod=\"nave-3\"} 712000.0",
        "tirante_rod_force_doubt{rod=\"nave-3\",doubt=\"conflict\"} 1",
        "tirante_rod_force_doubt{rod=\"nave-3\",doubt=\"orders\"} 0",
        "tirante_rod_state{rod=\"nave-3\",state=\"alarm\"} 1",
        "tirante_rod_state{rod=\"nave-3\",state=\"learning\"} 0",
        "tirante_alarms_standing{rod=\"nave-3\",kind=\"drift\"} 1",
        "tirante_faults_total{kind=\"sink\"} 1.0",
        "tirante_faults_total{kind=\"disk-full\"} 0.0",
        "tirante_condition{kind=\"sink\",about=\"mail\"} 1.0",
        "tirante_state{state=\"degraded\"} 1.0",
        "tirante_ready 1.0",
        "tirante_commit_seconds_count 2",
    ] {
        assert!(text.lines().any(|other| other == line), "no {line} in\n{text}");
    }
    assert!(text.ends_with("# EOF\n"));
}

#[test]
fn a_force_that_is_not_known_is_absent_and_a_record_that_does_not_count_changes_none() {
    let telemetry = everything();
    let force = "tirante_rod_force_newtons{rod=\"nave-3\"} 712000.0";
    let took = Duration::from_millis(1);
    let unknown = Verdict {
        state: RodState::Monitoring,
        at_reference: None,
        alarms: Vec::new(),
        ..lost()
    };
    telemetry
        .metrics
        .taken(&crate::archive::rejected(&rod(), 2), &unknown, took);
    let set_aside = Verdict {
        set_aside: Some(SetAside::Late),
        ..unknown.clone()
    };
    telemetry
        .metrics
        .taken(&crate::archive::identified(&rod(), 3), &set_aside, took);
    let text = telemetry.metrics.text();
    assert!(text.contains(force), "{text}");
    assert!(text.contains("tirante_rod_state{rod=\"nave-3\",state=\"monitoring\"} 1"));
    assert!(text.contains("tirante_alarms_standing{rod=\"nave-3\",kind=\"drift\"} 0"));
    assert!(text.contains("tirante_records_total{rod=\"nave-3\",outcome=\"set-aside\"} 1"));
    telemetry
        .metrics
        .taken(&crate::archive::identified(&rod(), 4), &unknown, took);
    assert!(!telemetry.metrics.text().contains("tirante_rod_force_newtons{"));
    assert!(!telemetry.metrics.text().contains("tirante_rod_force_doubt{"));
    let late = telemetry.metrics.text();
    assert!(
        late.contains("tirante_latency_seconds_count 1\n"),
        "an old record was not live"
    );
}

#[test]
fn the_rods_of_a_store_stand_from_the_start_and_those_that_are_gone_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open(&folder.path().join("site.sqlite"), Durability::Full).unwrap();
    crate::archive::fill(&mut store, 0..30);
    let telemetry = everything();
    telemetry.metrics.standings(&store.standings().unwrap());
    let text = telemetry.metrics.text();
    assert!(!text.contains("tirante_rod_state{rod=\"nave-3\""), "{text}");
    let rods = store.rods().unwrap();
    assert!(!rods.is_empty());
    for rod in rods {
        for wanted in [
            format!("tirante_rod_state{{rod=\"{rod}\",state=\"monitoring\"}} 1"),
            format!("tirante_rod_last_record_timestamp_seconds{{rod=\"{rod}\"}} 17001"),
            format!("tirante_rod_relative_force{{rod=\"{rod}\"}} 0.9515"),
        ] {
            assert!(text.contains(&wanted), "no {wanted} in\n{text}");
        }
    }
}

#[test]
fn many_conditions_with_strange_names_stay_bounded_and_readable() {
    let telemetry = Telemetry::default();
    for i in 0..1000 {
        telemetry
            .health
            .hold(Fault::Recording, &format!("a\"\\\n{i}.mcap"), "damaged");
    }
    let text = telemetry.metrics.text();
    let shown = text
        .lines()
        .filter(|line| line.starts_with("tirante_condition{"))
        .count();
    assert_eq!(shown, 64);
    assert!(text.contains("about=\"a\\\"\\\\ 0.mcap\""), "{text}");
    assert!(text.contains("tirante_faults_total{kind=\"recording\"} 1000.0"));
}
