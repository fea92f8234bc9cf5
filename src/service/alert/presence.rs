//! The daemon's state on a broker: kept there, and replaced by the broker itself with "gone" when the daemon dies.

use super::mqtt::{self, Mqtt};
use super::{Backoff, Failure, Pace};
use crate::config::settings::alert::MqttSettings;
use crate::service::telemetry::{Fault, Telemetry};
use crate::site::clock;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{LastWill, Packet};
use rumqttc::v5::{Client, Connection, Event, RecvTimeoutError};
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Interval between checks of the state.
const LOOK: Duration = Duration::from_secs(1);
/// Time limit for the last message.
const FAREWELL: Duration = Duration::from_millis(600);
/// Time after which an unchanged state is sent again.
const AGAIN: Duration = Duration::from_secs(60);

/// Thread with a connection to a broker. On drop it reports to the broker that the daemon stopped.
pub(super) struct Presence {
    stop: Arc<AtomicBool>,
    ended: Receiver<()>,
}

impl Presence {
    /// Starts sending the state to a broker; `None` if it is not configured, or the system gives no thread
    /// for it.
    pub(super) fn start(
        settings: &MqttSettings,
        site: &str,
        id: &str,
        pace: Pace,
        telemetry: &Telemetry,
    ) -> Option<Self> {
        let topic = settings.status_topic.as_ref()?;
        let topic = topic.replace("{site}", &mqtt::level(site));
        let broker = Mqtt::new(settings.clone(), site, &format!("{id}/status"), pace.deadline);
        let stop = Arc::<AtomicBool>::default();
        let (ending, ended) = sync_channel(0);
        let work = Work {
            broker,
            topic,
            site: site.to_owned(),
            about: format!("{id}/status"),
            backoff: Backoff::new(pace, 1),
            telemetry: telemetry.clone(),
            stop: Arc::clone(&stop),
        };
        let spawned = thread::Builder::new().name("presence".to_owned()).spawn(move || {
            work.run();
            drop(ending);
        });
        spawned.ok().map(|_| Self { stop, ended })
    }
}

impl Drop for Presence {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // Disconnected: the broker was told. One that does not answer is left to its last will.
        let _ = self.ended.recv_timeout(FAREWELL);
    }
}

struct Work {
    broker: Mqtt,
    topic: String,
    site: String,
    about: String,
    backoff: Backoff,
    telemetry: Telemetry,
    stop: Arc<AtomicBool>,
}

impl Work {
    fn run(mut self) {
        while !self.is_stopped() {
            let Err(failure) = self.connection() else { break };
            let wait = self.backoff.after_failure(None);
            let detail = format!("sink {}: {failure}", self.about);
            self.telemetry.health.hold(Fault::Sink, &self.about, detail);
            let until = Instant::now() + wait;
            while Instant::now() < until && !self.is_stopped() {
                thread::sleep(Duration::from_millis(50));
            }
        }
        self.telemetry.health.over(Fault::Sink, &self.about);
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Runs one connection; returns without error only after a request to stop.
    fn connection(&mut self) -> Result<(), Failure> {
        let mut options = self.broker.options()?;
        let will = LastWill::new(
            self.topic.clone(),
            self.said("gone"),
            QoS::AtLeastOnce,
            true,
            None,
        );
        options.set_last_will(will);
        let (client, mut connection) = Client::new(options, 8);
        let mut told: Option<(String, Instant)> = None;
        let mut is_connected = false;
        while !self.is_stopped() {
            is_connected |= self.wait(&mut connection, LOOK)?;
            let state = self.telemetry.health.state().code();
            let is_due = told
                .as_ref()
                .is_none_or(|(before, when)| before != state || when.elapsed() >= AGAIN);
            if is_connected && is_due {
                self.publish(&client, state)?;
                told = Some((state.to_owned(), Instant::now()));
                self.backoff.reset();
                self.telemetry.health.over(Fault::Sink, &self.about);
            }
        }
        if is_connected {
            self.publish(&client, "stopped")?;
            // Polite: a broker that is told goodbye does not execute the will.
            self.wait(&mut connection, Duration::from_millis(200))?;
            let _ = client.try_disconnect();
            let _ = self.wait(&mut connection, Duration::from_millis(100));
        }
        Ok(())
    }

    /// Works on the connection for a while; returns true if the broker accepted it.
    fn wait(&self, connection: &mut Connection, time: Duration) -> Result<bool, Failure> {
        let until = Instant::now() + time;
        let mut is_connected = false;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() || self.is_stopped() && time == LOOK {
                return Ok(is_connected);
            }
            match connection.recv_timeout(left.min(Duration::from_millis(100))) {
                Ok(Ok(Event::Incoming(Packet::ConnAck(_)))) => is_connected = true,
                Ok(Ok(Event::Incoming(Packet::Disconnect(end)))) => {
                    return Err(Failure::new(format!(
                        "the broker ends the connection: {:?}",
                        end.reason_code
                    )));
                }
                Ok(Ok(_)) | Err(RecvTimeoutError::Timeout) => {}
                Ok(Err(error)) => return Err(Failure::new(error.to_string())),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Failure::new("the connection ended"));
                }
            }
        }
    }

    fn publish(&self, client: &Client, state: &str) -> Result<(), Failure> {
        client
            .try_publish(self.topic.clone(), QoS::AtLeastOnce, true, self.said(state))
            .map_err(|error| Failure::new(error.to_string()))
    }

    fn said(&self, state: &str) -> String {
        json!({ "version": 1, "site": self.site, "state": state, "time": clock::now().to_string() })
            .to_string()
    }
}
