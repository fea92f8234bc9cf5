//! The API of a Prometheus Alertmanager, which drops alerts that are not sent again.

use super::post::post;
use super::{Failure, Message, Sink, What};
use crate::analysis::signal::record::Timestamp;
use crate::config::settings::alert::AlertmanagerSettings;
use crate::site::clock;
use serde_json::{Value as Json, json};
use std::time::Duration;

/// Time for which an alert fires without being sent again \[s\].
const LASTS_S: f64 = 300.0;

/// An Alertmanager.
pub(super) struct Alertmanager {
    settings: AlertmanagerSettings,
    deadline: Duration,
}

impl Alertmanager {
    pub(super) fn new(settings: AlertmanagerSettings, deadline: Duration) -> Self {
        Self { settings, deadline }
    }

    fn post(&self, alerts: &[Json]) -> Result<(), Failure> {
        let target = &self.settings.target;
        let url = format!("{}/api/v2/alerts", target.url.trim_end_matches('/'));
        post(target, &url, &[], &Json::from(alerts).to_string(), self.deadline)
    }
}

impl Sink for Alertmanager {
    fn deliver(&mut self, message: &Message) -> Result<(), Failure> {
        self.post(&[alert(message, clock::now())])
    }

    fn refresh_every(&self) -> Option<Duration> {
        Some(Duration::from_secs_f64(self.settings.resend_s))
    }

    fn refresh(&mut self, standing: &[Message]) -> Result<(), Failure> {
        if standing.is_empty() {
            return Ok(());
        }
        let now = clock::now();
        let alerts: Vec<Json> = standing.iter().map(|message| alert(message, now)).collect();
        self.post(&alerts)
    }
}

/// The alert of a message: its labels are the same for all events of an alarm.
fn alert(message: &Message, now: Timestamp) -> Json {
    let is_momentary = matches!(message.what, What::Test | What::Alive | What::Ended);
    let ends = if message.stands || is_momentary {
        now.plus_seconds(LASTS_S)
    } else {
        now
    };
    // An alert that begins after its end is refused; a sensor's clock may be ahead of ours.
    let starts = message.raised.min(now);
    let mut annotations = json!({
        "summary": message.subject(),
        "description": message.message,
    });
    if let Some(time) = message.acknowledged {
        annotations["acknowledged"] = Json::from(time.to_string());
    }
    if let Some(words) = &message.acknowledged_words {
        annotations["acknowledged_words"] = Json::from(words.as_str());
    }
    json!({
        "labels": {
            "alertname": match message.what {
                What::Test | What::Alive => "TiranteTest",
                What::Ended => "TiranteCondition",
                _ if message.is_of_daemon() => "TiranteCondition",
                _ => "TiranteAlarm",
            },
            "site": message.site,
            "rod": message.rod,
            "kind": message.kind,
            "alarm": message.alarm,
        },
        "annotations": annotations,
        "startsAt": starts.to_string(),
        "endsAt": ends.to_string(),
    })
}
