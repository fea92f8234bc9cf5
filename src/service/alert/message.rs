//! Message of a sink about an alarm: one JSON object for machines, a subject and a text for people.

use crate::analysis::signal::record::Timestamp;
use crate::analysis::track::AlarmEvent;
use crate::analysis::track::alarm::change::Change;
use crate::analysis::track::alarm::{self, Alarm};
use crate::analysis::track::relative::Interval;
use crate::service::telemetry::Fault;
use crate::site::store::{ConditionEvent, News};
use serde::Serialize;
use std::fmt::Write;

/// Version of the JSON. It changes only if a field is removed or changes its meaning, not if one is
/// added.
const VERSION: u32 = 1;

/// Kind of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum What {
    /// The alarm is new.
    Raised,
    /// It is still active and not acknowledged.
    Repeated,
    /// It was acknowledged.
    Acknowledged,
    /// Its condition ended.
    Cleared,
    /// It was already active when the sink was added.
    Standing,
    /// No alarm: a test of the delivery.
    Test,
    /// Daily message that the daemon is working, with the present conditions.
    Alive,
    /// Last words of a daemon that ends by a failure.
    Ended,
}

impl What {
    /// Name in JSON.
    pub fn code(self) -> &'static str {
        match self {
            Self::Raised => "raised",
            Self::Repeated => "repeated",
            Self::Acknowledged => "acknowledged",
            Self::Cleared => "cleared",
            Self::Standing => "standing",
            Self::Test => "test",
            Self::Alive => "alive",
            Self::Ended => "ended",
        }
    }

    fn of(what: alarm::What) -> Self {
        match what {
            alarm::What::Raised => Self::Raised,
            alarm::What::Repeated => Self::Repeated,
            alarm::What::Acknowledged => Self::Acknowledged,
            alarm::What::Cleared => Self::Cleared,
        }
    }
}

/// An event as a sink sends it; its JSON is documented in docs/sinks.md.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Message {
    /// Version of the JSON.
    pub version: u32,
    /// Id of the event, the same whenever it is sent, also after a crash or by another sink.
    pub id: String,
    /// Kind of the message.
    pub what: What,
    /// Time of the event, in event time.
    pub time: Timestamp,
    /// Name of the site.
    pub site: String,
    /// Id of the rod; empty for messages about the daemon.
    pub rod: String,
    /// Id of the alarm at its site: one for each condition, from its raising to its end.
    pub alarm: String,
    /// Kind of the alarm.
    pub kind: String,
    /// Time of raising, in event time.
    pub raised: Timestamp,
    /// Description in one sentence.
    pub message: String,
    /// True if the alarm is active: its condition holds, or it concerns the rod and is not acknowledged.
    pub stands: bool,
    /// Time of its acknowledgement.
    pub acknowledged: Option<Timestamp>,
    /// Time of the end of its condition.
    pub cleared: Option<Timestamp>,
    /// Onset, size and rate, for a drift.
    pub change: Option<Change>,
    /// Sink, file or folder concerned by a condition of the daemon.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub about: Option<String>,
    /// Words of the person who acknowledged the alarm: `NAME: TEXT`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acknowledged_words: Option<String>,
}

impl Message {
    /// Message of an event of the outbox.
    pub fn of_news(site: &str, news: &News) -> Self {
        let AlarmEvent { what, time, alarm } = &news.event;
        Self::of_alarm(site, What::of(*what), *time, alarm, news.words.clone())
    }

    /// Message of an active alarm, with the words of its acknowledgement, if there are any.
    pub fn standing(site: &str, alarm: &Alarm, words: Option<String>) -> Self {
        Self::of_alarm(site, What::Standing, alarm.told, alarm, words)
    }

    fn of_alarm(site: &str, what: What, time: Timestamp, alarm: &Alarm, words: Option<String>) -> Self {
        Self {
            version: VERSION,
            // An alarm is raised, acknowledged and cleared once, and repeated at different times.
            id: format!("{}-{}-{}", alarm.id, what.code(), time.as_nanos() / 1_000_000_000),
            what,
            time,
            site: site.to_owned(),
            rod: alarm.rod.0.clone(),
            alarm: alarm.id.clone(),
            kind: alarm.kind.code().to_owned(),
            raised: alarm.raised,
            message: alarm.message.clone(),
            stands: !alarm.is_over(),
            acknowledged: alarm.acknowledged,
            cleared: alarm.cleared,
            change: alarm.change.clone(),
            about: None,
            acknowledged_words: words,
        }
        .at_its_site()
    }

    /// The message of an alarm or condition that a centre took in from a site: ids and rods are kept behind the site's name and a
    /// slash, which no id of a store's own has.
    fn at_its_site(mut self) -> Self {
        if let Some((site, alarm)) = self.alarm.split_once('/') {
            if let Some((_, rod)) = self.rod.split_once('/') {
                self.rod = rod.to_owned();
            }
            self.site = site.to_owned();
            self.alarm = alarm.to_owned();
        }
        self
    }

    /// True if a centre tells it of one of its sites.
    pub fn is_of_centre(&self) -> bool {
        self.id.contains('/')
    }

    /// Name of its alarm that no other alarm has, of whatever site a centre tells.
    pub fn conversation(&self) -> String {
        if self.is_of_centre() {
            format!("{}/{}", self.site, self.alarm)
        } else {
            self.alarm.clone()
        }
    }

    /// Message about a condition of the daemon that began or ended.
    pub fn of_notice(site: &str, notice: &ConditionEvent) -> Self {
        let what = if notice.is_raised {
            What::Raised
        } else {
            What::Cleared
        };
        Self::of_condition(site, what, notice)
    }

    /// Message about a condition of the daemon that lasts.
    pub fn lasting(site: &str, begun: &ConditionEvent) -> Self {
        Self::of_condition(site, What::Standing, begun)
    }

    fn of_condition(site: &str, what: What, notice: &ConditionEvent) -> Self {
        let (time, id) = (notice.time, &notice.condition);
        Self {
            version: VERSION,
            id: format!("{id}-{}-{}", what.code(), time.as_nanos() / 1_000_000_000),
            what,
            time,
            site: site.to_owned(),
            rod: String::new(),
            alarm: id.clone(),
            kind: notice.fault.clone(),
            raised: notice.raised,
            message: notice.detail.clone(),
            stands: notice.is_raised,
            acknowledged: None,
            cleared: (!notice.is_raised).then_some(time),
            change: None,
            about: Some(notice.about.clone()),
            acknowledged_words: None,
        }
        .at_its_site()
    }

    /// Daily message; `said` lists the present conditions.
    pub fn alive(site: &str, said: String, now: Timestamp) -> Self {
        Self {
            what: What::Alive,
            id: format!("alive-{}", now.as_nanos() / 1_000_000_000),
            rod: String::new(),
            alarm: "alive".to_owned(),
            kind: "alive".to_owned(),
            message: said,
            ..Self::test(site, "", now)
        }
    }

    /// Last words of a daemon that ends by a failure: nothing is measured until it is started again.
    pub fn ended(site: &str, why: &str, now: Timestamp) -> Self {
        Self {
            what: What::Ended,
            id: format!("ended-{}", now.as_nanos() / 1_000_000_000),
            alarm: "ended".to_owned(),
            kind: "ended".to_owned(),
            ..Self::alive(site, format!("the daemon ends by a failure: {why}"), now)
        }
    }

    /// True if it is about the daemon, not about a rod.
    pub fn is_of_daemon(&self) -> bool {
        self.about.is_some()
    }

    /// Message that tests a sink.
    pub fn test(site: &str, sink: &str, now: Timestamp) -> Self {
        Self {
            version: VERSION,
            id: format!("test-{sink}-{}", now.as_nanos() / 1_000_000_000),
            what: What::Test,
            time: now,
            site: site.to_owned(),
            rod: "test".to_owned(),
            alarm: "test".to_owned(),
            kind: "test".to_owned(),
            raised: now,
            message: format!("A test of the sink {sink}: messages arrive, nothing is wrong."),
            stands: false,
            acknowledged: None,
            cleared: None,
            change: None,
            about: None,
            acknowledged_words: None,
        }
    }

    /// Subject in one line: `Duomo, rod nave-3: drift raised`.
    pub fn subject(&self) -> String {
        match self.what {
            What::Test => format!("{}: test of an alarm sink", self.site),
            What::Alive | What::Ended => format!("{}: {}", self.site, self.message),
            // The outcome of a command, which stands for itself.
            What::Cleared if self.alarm.starts_with("command-") => {
                let about = self.about.as_deref().unwrap_or_default();
                format!("{}, command of the centre: {about}", self.site)
            }
            What::Cleared if self.kind == Fault::Silent.code() => {
                let about = self.about.as_deref().unwrap_or_default();
                format!("{about}: {} is over ({})", self.kind, self.site)
            }
            What::Cleared if self.is_of_daemon() => {
                format!("{}, monitoring: {} is over", self.site, self.kind)
            }
            // Of a centre, whose subjects are sites.
            _ if self.kind == Fault::Silent.code() => {
                let about = self.about.as_deref().unwrap_or_default();
                format!("{about}: {} ({})", self.kind, self.site)
            }
            _ if self.is_of_daemon() => format!("{}, monitoring: {}", self.site, self.kind),
            What::Standing => format!("{}, rod {}: {} stands", self.site, self.rod, self.kind),
            What::Repeated => format!(
                "{}, rod {}: {} stands, not acknowledged",
                self.site, self.rod, self.kind
            ),
            what => format!("{}, rod {}: {} {}", self.site, self.rod, self.kind, what.code()),
        }
    }

    /// Text of a few lines, without a final line end.
    pub fn text(&self) -> String {
        let mut text = format!("{}\n\n", self.message);
        let mut line = |name: &str, value: &str| {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{:<14}{value}", format!("{name}:"));
        };
        line("Site", &self.site);
        if let Some(about) = &self.about {
            line("Condition", &format!("{} ({about})", self.kind));
            line("Since", &self.raised.to_string());
            if let Some(time) = self.cleared {
                line("Over", &time.to_string());
            }
        } else if !matches!(self.what, What::Test | What::Alive | What::Ended) {
            line("Rod", &self.rod);
            line("Alarm", &format!("{} ({})", self.kind, self.alarm));
            line("Raised", &self.raised.to_string());
            let times = [
                ("Acknowledged", self.acknowledged),
                ("Condition over", self.cleared),
            ];
            for (name, time) in times {
                if let Some(time) = time {
                    line(name, &time.to_string());
                }
                if let ("Acknowledged", Some(words)) = (name, &self.acknowledged_words) {
                    line("By", words);
                }
            }
            line("Stands", if self.stands { "yes" } else { "no" });
        }
        if let Some(change) = &self.change {
            line("Change", &percent(&change.size));
            line("Rate", &format!("{} a year", percent(&change.rate_per_year)));
            line(
                "Onset",
                &format!(
                    "{} (95 %: {} to {})",
                    change.onset, change.onset_q025, change.onset_q975
                ),
            );
        }
        if !self.stands || self.acknowledged.is_some() || self.is_of_daemon() {
            // Nothing to acknowledge.
        } else if self.is_of_centre() {
            text += &format!(
                "\n`tirante hub command {} acknowledge {} --by NAME --reason TEXT --config hub.toml` says that somebody knows: it \
                 is then not told again.",
                self.site, self.alarm
            );
        } else {
            text += &format!(
                "\n`tirante ack --config FILE {}` says that somebody knows: it is then not told again.",
                self.alarm
            );
        }
        text.trim_end().to_owned()
    }

    /// The documented JSON object, one line.
    pub fn json(&self) -> String {
        // Strings, numbers and times: nothing that JSON cannot hold.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// `-4.1 % (95 %: -5.0 % to -3.2 %)`.
fn percent(interval: &Interval) -> String {
    format!(
        "{:+.1} % (95 %: {:+.1} % to {:+.1} %)",
        100.0 * interval.mean,
        100.0 * interval.q025,
        100.0 * interval.q975
    )
}

#[cfg(test)]
mod tests;
