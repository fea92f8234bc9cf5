//! A store with alarm events, and a stand-in for the daemon's core thread, its only writer.

use serde_json::Value;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tirante::analysis::signal::record::{RodId, Timestamp};
use tirante::analysis::track::{Alarm, AlarmEvent, Kind, RodState, State, What};
use tirante::config::Config;
use tirante::config::settings::alert::SinkSettings;
use tirante::service::alert::{Couriers, Pace};
use tirante::service::telemetry::{Fault, Health, Telemetry};
use tirante::site::store::{Commit, ConditionEvent, Durability, Relayed, RodRow, Store};

pub const SITE: &str = "Duomo";

/// As the daemon's, a hundred times as fast.
pub const FAST: Pace = Pace {
    first: Duration::from_millis(10),
    longest: Duration::from_secs(3),
    deadline: Duration::from_millis(300),
};

/// A sink's id and the number of the latest event delivered to it.
pub type Report = (String, i64);

pub struct Desk {
    pub folder: TempDir,
    pub store: Arc<Mutex<Store>>,
    pub telemetry: Telemetry,
    pub health: Arc<Health>,
    pub reports: SyncSender<Report>,
}

impl Desk {
    pub fn new() -> Self {
        Self::on(tempfile::tempdir().unwrap())
    }

    /// On the store in a folder.
    pub fn on(folder: TempDir) -> Self {
        let telemetry = Telemetry::default();
        let store = Store::open(&folder.path().join("site.db"), Durability::Replay).unwrap();
        let store = Arc::new(Mutex::new(store));
        let (reports, received) = sync_channel::<Report>(4);
        let writer = Arc::clone(&store);
        thread::spawn(move || {
            for (sink, through) in received {
                writer
                    .lock()
                    .unwrap()
                    .commit(&Commit {
                        delivered: Some((&sink, through)),
                        ..Commit::default()
                    })
                    .unwrap();
            }
        });
        Self {
            folder,
            store,
            health: Arc::clone(&telemetry.health),
            telemetry,
            reports,
        }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a secret that nobody else on this machine can read.
    pub fn secret(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, text).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        path
    }

    /// Adds an event to the outbox, about the alarm of `rod` and `kind` of this hour.
    pub fn tell(&self, rod: &str, kind: Kind, hour: usize, what: What) -> Alarm {
        let raised = at(hour);
        let rod = RodId(rod.into());
        let mut alarm = Alarm::new(&rod, kind, 1, raised, format!("Alarm {hour}."));
        match what {
            What::Raised | What::Repeated => {}
            What::Acknowledged => alarm.acknowledged = Some(raised.plus_seconds(60.0)),
            What::Cleared => alarm.cleared = Some(raised.plus_seconds(120.0)),
        }
        let event = AlarmEvent {
            what,
            time: alarm.cleared.or(alarm.acknowledged).unwrap_or(raised),
            alarm: alarm.clone(),
        };
        self.store
            .lock()
            .unwrap()
            .commit(&Commit {
                rod: Some(RodRow {
                    state: &State::new(rod, "key".into()),
                    stands: &RodState::Alarm,
                    closed: &[],
                    events: &[event],
                }),
                ..Commit::default()
            })
            .unwrap();
        alarm
    }

    /// As at a centre: alarms of rods of a site, and conditions of its daemon about these subjects.
    pub fn relay(&self, site: &str, rods: &[&str], about: &[String]) {
        let raised = |rod: &&str| {
            let id = RodId(format!("{site}/{rod}"));
            let mut alarm = Alarm::new(&id, Kind::Sensor, 1, at(0), format!("Alarm of {rod}."));
            alarm.id = format!("{site}/{}", alarm.id);
            AlarmEvent {
                what: What::Raised,
                time: at(0),
                alarm,
            }
        };
        let begun = |about: &String| {
            let mut begun = ConditionEvent::raised("sink", about, at(0), "refused");
            begun.condition = format!("{site}/{}", begun.condition);
            begun
        };
        let relayed = Relayed {
            owner: site.to_owned(),
            events: rods.iter().map(raised).collect(),
            notices: about.iter().map(begun).collect(),
            ..Relayed::default()
        };
        self.store.lock().unwrap().relay(&relayed).unwrap();
    }

    /// An alarm that ends with its condition.
    pub fn raise(&self, hour: usize) -> Alarm {
        self.tell("north", Kind::Sensor, hour, What::Raised)
    }

    pub fn clear(&self, hour: usize) -> Alarm {
        self.tell("north", Kind::Sensor, hour, What::Cleared)
    }

    pub fn start(&self, sinks: &[SinkSettings]) -> Couriers {
        self.start_with(sinks, self.reports.clone())
    }

    pub fn start_with(&self, sinks: &[SinkSettings], reports: SyncSender<Report>) -> Couriers {
        Couriers::start_at(
            FAST,
            sinks,
            SITE,
            &self.path("site.db"),
            Box::new(move |sink, through| reports.send((sink, through)).is_ok()),
            self.telemetry.clone(),
        )
    }

    pub fn delivered(&self, sink: &str) -> Option<i64> {
        self.store.lock().unwrap().delivered(sink).unwrap()
    }

    /// Lasting condition of this sink.
    pub fn condition(&self, sink: &str) -> Option<String> {
        let conditions = self.health.conditions();
        conditions
            .into_iter()
            .find(|condition| condition.fault == Fault::Sink && condition.about == sink)
            .map(|condition| condition.detail)
    }
}

pub fn at(hour: usize) -> Timestamp {
    Timestamp::from_nanos(1_772_344_800_000_000_000 + 3_600_000_000_000 * hour as i64)
}

/// A configuration with these sinks, on two rods.
pub fn config_text(sinks: &str) -> String {
    let rod = |id: &str| {
        format!(
            r#"
[[rod]]
id = "{id}"
length_m = 10
section = "direct"
[rod.priors]
axial_force_n = {{ mean = 1e5, cv = 0.2 }}
flexural_rigidity_n_m2 = 3e5
mass_per_length_kg_m = 20
spring_left_n_m = 0
spring_right_n_m = 0
[rod.channel]
topic = "/{id}"
"#
        )
    };
    format!(
        "[site]\nname = \"{SITE}\"\n{}{}{sinks}",
        rod("north"),
        rod("south")
    )
}

/// The sinks of a configuration.
pub fn sinks(text: &str) -> Vec<SinkSettings> {
    match Config::parse(&config_text(text), "site.toml") {
        Ok(config) => config.sinks,
        Err(error) => panic!("{error}"),
    }
}

/// Waits until `holds`, for 30 s at most.
pub fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let until = Instant::now() + Duration::from_secs(30);
    while !holds() {
        assert!(Instant::now() < until, "{what}: not within 30 s");
        thread::sleep(Duration::from_millis(5));
    }
}

/// A field of every message.
pub fn field<'a>(messages: &'a [Value], name: &str) -> Vec<&'a str> {
    messages
        .iter()
        .map(|message| message[name].as_str().unwrap())
        .collect()
}
