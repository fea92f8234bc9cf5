//! The couriers of a daemon: started, woken, reloaded and stopped together.

use super::courier::{Courier, Errand};
use super::heartbeat::Heartbeat;
use super::marks::{Delivered, Marks};
use super::place::Place;
use super::presence::Presence;
use super::signal::Signal;
use super::{Message, Pace};
use crate::analysis::signal::record::Timestamp;
use crate::config::settings::alert::{AlertSettings, SinkKind, SinkSettings};
use crate::service::telemetry::{Fault, Telemetry};
use crate::site::clock;
use crate::site::ordered_map::message_of;
use crate::site::store::ConditionEvent;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Longest time for a courier to stop, unless it is in the middle of a send.
const STOP_WITHIN: Duration = Duration::from_millis(100);

/// Longest time for the reason of the end to reach the sinks, and the interval of looks.
const LAST_WORDS: Duration = Duration::from_secs(5);
const LOOK: Duration = Duration::from_millis(20);

/// All couriers of a daemon.
pub struct Couriers {
    /// `None` if there are only messages past it.
    store: Option<PathBuf>,
    marks: Arc<Marks>,
    marks_ended: Option<Receiver<()>>,
    telemetry: Telemetry,
    pace: Pace,
    running: Vec<Running>,
    alert: AlertSettings,
    heartbeat: Option<Heartbeat>,
    /// Time of the last check for the daily message.
    looked: Option<Timestamp>,
}

const DAY_S: f64 = 86_400.0;

/// Subject of the condition of delivery marks that cannot be kept. No sink id has a slash.
const MARKS: &str = "alert/marks";

struct Running {
    settings: SinkSettings,
    site: String,
    signal: Arc<Signal>,
    ended: Receiver<()>,
    _presence: Option<Presence>,
}

impl Couriers {
    /// Starts them for messages that come through no store, while it is not open yet.
    pub fn start_past_the_store(sinks: &[SinkSettings], site: &str, telemetry: Telemetry) -> Self {
        let mut couriers = Self::over(None, Pace::default(), telemetry);
        couriers.reload(sinks, site);
        couriers
    }

    /// Starts one courier for each sink and one for the log. They read `store` and report to `delivered`,
    /// which they hold until stopped.
    pub fn start(
        sinks: &[SinkSettings],
        site: &str,
        store: &Path,
        delivered: Delivered,
        telemetry: Telemetry,
    ) -> Self {
        Self::start_at(Pace::default(), sinks, site, store, delivered, telemetry)
    }

    /// Starts them at a given pace.
    pub fn start_at(
        pace: Pace,
        sinks: &[SinkSettings],
        site: &str,
        store: &Path,
        delivered: Delivered,
        telemetry: Telemetry,
    ) -> Self {
        let mut couriers = Self::over(Some(store.to_owned()), pace, telemetry);
        match couriers.marks.start(delivered) {
            Ok(ended) => couriers.marks_ended = Some(ended),
            Err(error) => {
                let detail = format!("what was delivered cannot be remembered, no thread for it: {error}");
                couriers.telemetry.health.hold(Fault::Sink, MARKS, detail);
            }
        }
        couriers.reload(sinks, site);
        couriers
    }

    fn over(store: Option<PathBuf>, pace: Pace, telemetry: Telemetry) -> Self {
        Self {
            store,
            marks: Arc::default(),
            marks_ended: None,
            telemetry,
            pace,
            running: Vec::new(),
            alert: AlertSettings::default(),
            heartbeat: None,
            looked: None,
        }
    }

    /// Sets the messages about the daemon itself.
    pub fn watch(&mut self, alert: &AlertSettings, site: &str) {
        self.alert = alert.clone();
        match &alert.heartbeat {
            None => self.heartbeat = None,
            Some(settings)
                if self
                    .heartbeat
                    .as_ref()
                    .is_some_and(|known| known.is_of(settings, site)) => {}
            Some(settings) => {
                self.heartbeat = None;
                self.heartbeat = Heartbeat::start(settings, site, &self.telemetry);
            }
        }
    }

    /// Sends every sink a condition that the store cannot keep now. It is not sent again when the store has
    /// it.
    pub fn tell(&self, notice: &ConditionEvent) {
        for courier in &self.running {
            courier.signal.tell(Message::of_notice(&courier.site, notice));
        }
    }

    /// Sends every sink the reason why the daemon ends, and waits until they have it, at most [`LAST_WORDS`].
    pub fn tell_end(&self, why: &str) {
        for courier in &self.running {
            courier
                .signal
                .tell(Message::ended(&courier.site, why, clock::now()));
        }
        let until = Instant::now() + LAST_WORDS;
        while Instant::now() < until && !self.running.iter().all(|courier| courier.signal.has_told()) {
            thread::sleep(LOOK);
        }
    }

    /// Sends the daily message that the daemon is working; called about every second.
    pub fn look_at_clock(&mut self, now: Timestamp) {
        let days = |time: Timestamp| (time.as_nanos() as f64 * 1e-9 - 3600.0 * self.alert.daily_h) / DAY_S;
        let before = self.looked.replace(now);
        if self.alert.daily.is_empty()
            || before.is_none_or(|before| days(before).floor() >= days(now).floor())
        {
            return;
        }
        let conditions = self.telemetry.health.conditions();
        let said = match conditions.len() {
            0 => "the daemon is at work, nothing is wrong".to_owned(),
            count => {
                let lines = conditions
                    .iter()
                    .map(|one| format!("{}: {}", one.fault.code(), one.detail));
                let lines: Vec<String> = lines.collect();
                format!(
                    "the daemon is at work, {count} conditions last: {}",
                    lines.join("; ")
                )
            }
        };
        let wanted = |courier: &&Running| self.alert.daily.contains(&courier.settings.id);
        for courier in self.running.iter().filter(wanted) {
            courier
                .signal
                .tell(Message::alive(&courier.site, said.clone(), now));
        }
    }

    /// Notifies the couriers that there may be events in the store.
    pub fn wake(&self) {
        for courier in &self.running {
            courier.signal.wake();
        }
    }

    /// Changes to these sinks. A courier with unchanged settings is not disturbed; one with changed settings
    /// continues at its position.
    pub fn reload(&mut self, sinks: &[SinkSettings], site: &str) {
        let log = SinkSettings::log();
        let mut wanted: Vec<&SinkSettings> = sinks.iter().collect();
        wanted.push(&log);
        let is_same = |courier: &Running| courier.site == site && wanted.contains(&&courier.settings);
        let (mut kept, changed): (Vec<Running>, Vec<Running>) =
            std::mem::take(&mut self.running).into_iter().partition(is_same);
        let stopped = stop(changed, Instant::now() + STOP_WITHIN);
        for (id, _) in &stopped {
            if !wanted.iter().any(|settings| settings.id == *id) {
                self.telemetry.health.over(Fault::Sink, id);
                self.telemetry.metrics.forget_sink(id);
            }
        }
        for settings in wanted {
            if kept.iter().any(|courier| courier.settings.id == settings.id) {
                continue;
            }
            let place = stopped
                .iter()
                .find(|(id, _)| *id == settings.id)
                .and_then(|(_, place)| *place);
            if let Some(courier) = self.spawn(settings, site, place) {
                kept.push(courier);
            }
        }
        self.running = kept;
    }

    /// Ends them all within 100 ms, as dropping them does (brokers that hold the daemon's state: within a
    /// second). One in the middle of a send is left to itself: if its message arrives, it is sent again at
    /// the next start, with the same id. What was delivered is still reported if the queue of jobs is read on
    /// until it is disconnected.
    pub fn stop(self) {}

    fn spawn(&self, settings: &SinkSettings, site: &str, place: Option<Place>) -> Option<Running> {
        let signal = Arc::new(Signal::default());
        let (ending, ended) = sync_channel(0);
        let id = settings.id.clone();
        let errand = Errand {
            settings: settings.clone(),
            site: site.to_owned(),
            store: self.store.clone(),
            marks: Arc::clone(&self.marks),
            telemetry: self.telemetry.clone(),
        };
        let mut courier = Courier::new(errand, self.pace, place, Arc::clone(&signal));
        let (name, health) = (id.clone(), Arc::clone(&self.telemetry.health));
        let spawned = thread::Builder::new().name(format!("sink {id}")).spawn(move || {
            // Nobody else would miss it: its alarms wait, and the daemon is well.
            if let Err(panic) = catch_unwind(AssertUnwindSafe(|| courier.run())) {
                let detail = format!(
                    "sink {name}: the program broke, please report it: {}; its alarms wait until the daemon is started anew",
                    message_of(&*panic)
                );
                health.hold(Fault::Sink, &name, detail);
            }
            drop(ending);
        });
        if let Err(error) = spawned {
            self.telemetry
                .health
                .hold(Fault::Sink, &id, format!("sink {id}: no thread for it: {error}"));
            return None;
        }
        let presence = match &settings.kind {
            SinkKind::Mqtt(mqtt) if self.store.is_some() => {
                Presence::start(mqtt, site, &settings.id, self.pace, &self.telemetry)
            }
            _ => None,
        };
        Some(Running {
            settings: settings.clone(),
            site: site.to_owned(),
            signal,
            ended,
            _presence: presence,
        })
    }
}

impl Drop for Couriers {
    fn drop(&mut self) {
        let until = Instant::now() + STOP_WITHIN;
        stop(std::mem::take(&mut self.running), until);
        self.marks.end();
        if let Some(ended) = &self.marks_ended {
            // Disconnected: it ended. Else it still waits for a place in the queue.
            let _ = ended.recv_timeout(until.saturating_duration_since(Instant::now()));
        }
    }
}

/// Stops couriers and waits for them until a deadline; returns their ids and positions.
fn stop(couriers: Vec<Running>, until: Instant) -> Vec<(String, Option<Place>)> {
    for courier in &couriers {
        courier.signal.stop();
    }
    for courier in &couriers {
        let left = until.saturating_duration_since(Instant::now());
        if courier.ended.recv_timeout(left) == Err(RecvTimeoutError::Timeout) {
            tracing::debug!("sink {}: left in the middle of a send", courier.settings.id);
        }
    }
    couriers
        .into_iter()
        .map(|courier| (courier.settings.id, courier.signal.place()))
        .collect()
}
