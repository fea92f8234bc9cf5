//! Metrics: what is documented is what is shown, both ways, and labels stay bounded.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::time::Duration;
use tirante::record::RodId;
use tirante::telemetry::metrics::{Delivery, Queue, RecordOutcome, RodStanding};
use tirante::telemetry::{Fault, Phase, Telemetry};
use tirante::track::{Kind, RodState};

/// A daemon in which everything happened once.
fn everything() -> Telemetry {
    let telemetry = Telemetry::default();
    let metrics = &telemetry.metrics;
    let rod = RodId("nave-3".into());
    telemetry.enter(Phase::Serving);
    telemetry.health.hold(Fault::Sink, "mail", "refused");
    metrics.record(&rod, RecordOutcome::Used);
    metrics.rejection(&rod, "no-peak");
    metrics.analysis(Duration::from_millis(20));
    metrics.commit(Duration::from_millis(4));
    metrics.latency(Duration::from_millis(400));
    metrics.queue(Queue::Journal, 3, 64);
    metrics.queue(Queue::Jobs, 1, 16);
    metrics.clients(2);
    metrics.received(10, 1000);
    metrics.journal(1 << 20);
    metrics.outbox("mail", 4);
    metrics.delivery("mail", Delivery::Failed);
    metrics.watch_disk("store", "/".into());
    metrics.rod(
        &rod,
        &RodStanding {
            state: &RodState::Alarm,
            last_record_s: Some(1.7e9),
            force_n: Some(712e3),
            relative_force: Some(0.96),
            alarms: &[Kind::Drift],
        },
    );
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
        "<!-- metrics: written by UPDATE_DOCS=1 cargo test --test metrics -->\n",
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
            "UPDATE_DOCS=1 cargo test --test metrics brings the page up to date"
        );
    }
}

#[test]
fn values_are_those_that_were_given() {
    let text = everything().metrics.text();
    for line in [
        "tirante_records_total{rod=\"nave-3\",outcome=\"used\"} 1",
        "tirante_records_total{rod=\"nave-3\",outcome=\"rejected\"} 1",
        "tirante_rejections_total{rod=\"nave-3\",reason=\"no-peak\"} 1",
        "tirante_received_bytes_total 1000",
        "tirante_rod_force_newtons{rod=\"nave-3\"} 712000.0",
        "tirante_rod_state{rod=\"nave-3\",state=\"alarm\"} 1",
        "tirante_rod_state{rod=\"nave-3\",state=\"learning\"} 0",
        "tirante_alarms_standing{rod=\"nave-3\",kind=\"drift\"} 1",
        "tirante_faults_total{kind=\"sink\"} 1.0",
        "tirante_faults_total{kind=\"disk-full\"} 0.0",
        "tirante_condition{kind=\"sink\",about=\"mail\"} 1.0",
        "tirante_state{state=\"degraded\"} 1.0",
        "tirante_ready 1.0",
        "tirante_commit_seconds_count 1",
    ] {
        assert!(text.lines().any(|other| other == line), "no {line} in\n{text}");
    }
    assert!(text.ends_with("# EOF\n"));
}

#[test]
fn rods_that_are_gone_and_forces_that_are_not_known_are_not_shown() {
    let telemetry = everything();
    let rod = RodId("nave-3".into());
    let standing = RodStanding {
        state: &RodState::Monitoring,
        last_record_s: None,
        force_n: None,
        relative_force: None,
        alarms: &[],
    };
    telemetry.metrics.rod(&rod, &standing);
    let text = telemetry.metrics.text();
    assert!(!text.contains("tirante_rod_force_newtons{"), "{text}");
    assert!(text.contains("tirante_rod_state{rod=\"nave-3\",state=\"monitoring\"} 1"));
    telemetry.metrics.forget_standing();
    assert!(!telemetry.metrics.text().contains("tirante_rod_state{"));
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
