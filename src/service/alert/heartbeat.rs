//! Heartbeat to a dead-man switch: while it comes, the daemon is working and results are stored.

use super::Failure;
use super::post::post;
use super::signal::Signal;
use crate::config::settings::alert::HeartbeatSettings;
use crate::service::telemetry::{Fault, State, Telemetry};
use crate::site::clock;
use serde_json::json;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

/// Subject of the condition of a switch that cannot be reached. The slash keeps it apart from every `[[sink]]`, whose ids have
/// none.
const ABOUT: &str = "alert/heartbeat";
/// Name of its thread.
const THREAD: &str = "heartbeat";
/// Time limit of one heartbeat.
const DEADLINE: Duration = Duration::from_secs(10);
/// Time without progress after which the work loop counts as dead.
const ALIVE: Duration = Duration::from_secs(30);

/// Thread that sends heartbeats, ended on drop.
pub(super) struct Heartbeat {
    settings: HeartbeatSettings,
    site: String,
    telemetry: Telemetry,
    signal: Arc<Signal>,
}

impl Heartbeat {
    /// Starts the heartbeat; `None` if the system gives no thread for it.
    pub(super) fn start(settings: &HeartbeatSettings, site: &str, telemetry: &Telemetry) -> Option<Self> {
        let signal = Arc::<Signal>::default();
        let stopped = Arc::clone(&signal);
        let (own, name, told) = (settings.clone(), site.to_owned(), telemetry.clone());
        let work = move || {
            // The work loop has a moment to begin.
            let mut wait = Duration::from_secs_f64(own.every_s).min(Duration::from_secs(1));
            while stopped.pause(wait).is_ok() {
                wait = Duration::from_secs_f64(own.every_s);
                let sent = sign(&own, &name, &told);
                // One that is stopped while it sends has no condition any more.
                let _ = stopped.unless_stopped(|| match sent {
                    None => {}
                    Some(Ok(())) => told.health.over(Fault::Sink, ABOUT),
                    Some(Err(failure)) => {
                        told.health
                            .hold(Fault::Sink, ABOUT, format!("{THREAD}: {failure}"))
                    }
                });
            }
        };
        let spawned = thread::Builder::new().name(THREAD.to_owned()).spawn(work);
        if let Err(error) = spawned {
            telemetry
                .health
                .hold(Fault::Sink, ABOUT, format!("{THREAD}: no thread for it: {error}"));
            return None;
        }
        Some(Self {
            settings: settings.clone(),
            site: site.to_owned(),
            telemetry: telemetry.clone(),
            signal,
        })
    }

    /// True if it has these settings.
    pub(super) fn is_of(&self, settings: &HeartbeatSettings, site: &str) -> bool {
        self.settings == *settings && self.site == site
    }
}

impl Drop for Heartbeat {
    fn drop(&mut self) {
        self.signal.stop();
        self.telemetry.health.over(Fault::Sink, ABOUT);
    }
}

/// Sends one heartbeat, unless nothing is measured or stored.
fn sign(settings: &HeartbeatSettings, site: &str, telemetry: &Telemetry) -> Option<Result<(), Failure>> {
    let report = telemetry.health.report();
    let is_alive = telemetry.beat.age() < ALIVE && report.phase.not_ready().is_none();
    if !is_alive || report.state == State::Failing {
        return None;
    }
    let conditions: Vec<_> = report
        .conditions
        .iter()
        .map(|condition| json!({ "kind": condition.fault, "about": condition.about, "for_s": condition.for_s }))
        .collect();
    let body = json!({
        "version": 1,
        "what": "alive",
        "time": clock::now().to_string(),
        "site": site,
        "state": report.state.code(),
        "conditions": conditions,
    });
    let url = &settings.target.url;
    Some(post(&settings.target, url, &[], &body.to_string(), DEADLINE))
}
