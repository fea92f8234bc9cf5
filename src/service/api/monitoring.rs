//! State of a site's monitoring, and the daemon's present conditions.

use crate::analysis::signal::record::Timestamp;
use crate::service::telemetry::{Condition, Fault};
use crate::site::store::{Reader, StoreError};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Longest reason told past the store, in characters.
const LONGEST: usize = 400;
/// Most conditions told past the store.
const MOST: usize = 4;

/// Three times the longest interval at which a daemon records in the store that it is working \[s\].
const ALIVE_S: f64 = 900.0;

/// State of a site's monitoring.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Monitoring {
    /// Time since which nothing is measured or stored; `null` while monitoring works.
    pub stopped_since: Option<Timestamp>,
    /// Reason in one sentence.
    pub why: Option<String>,
    /// Present conditions.
    pub conditions: Vec<Lasting>,
}

/// A present condition of the daemon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Lasting {
    /// Kind of the condition, as in `/healthz`.
    pub kind: String,
    /// Sink, file or folder concerned.
    pub about: String,
    /// One sentence.
    pub detail: String,
    /// Time of its begin, by the machine's clock.
    pub since: Timestamp,
    /// True if it is the reason in `why`.
    pub is_told: bool,
}

impl Monitoring {
    /// State by the store at `now`; `None` if no daemon ever worked on it. `is_held`: true if a process
    /// writes to it now, if known; `told` is what that process told past the store ([`Monitoring::past_the_store`]).
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(
        reader: &Reader,
        is_held: Option<bool>,
        told: Option<&str>,
        now: Timestamp,
    ) -> Result<Option<Self>, StoreError> {
        let mut conditions = told.map(past).unwrap_or_default();
        let last = reader.stretches()?.last().copied();
        if last.is_none() && conditions.is_empty() {
            return Ok(None);
        }
        for begun in reader.standing_notices()? {
            let is_known = |known: &Lasting| known.kind == begun.fault && known.about == begun.about;
            if !conditions.iter().any(is_known) {
                conditions.push(Lasting {
                    kind: begun.fault,
                    about: begun.about,
                    detail: begun.detail,
                    since: begun.raised,
                    is_told: false,
                });
            }
        }
        let mut monitoring = Self::by(conditions);
        let Some(last) = last else {
            return Ok(Some(monitoring));
        };
        if is_held == Some(false) {
            monitoring.stop(
                last.to,
                "no daemon is at work on this store (one at work says so every five minutes)",
            );
        } else if now.seconds_since(last.to) > ALIVE_S {
            monitoring.stop(last.to, "no daemon has told the store since that it is at work");
        }
        Ok(Some(monitoring))
    }

    /// State by the conditions of a running daemon.
    pub fn live(conditions: &[Condition], now: Timestamp) -> Self {
        let (instant, lasting) = (Instant::now(), conditions.iter());
        let lasting = lasting.map(|condition| Lasting {
            kind: condition.fault.code().to_owned(),
            about: condition.about.clone(),
            detail: condition.detail.clone(),
            since: now.plus_seconds(-instant.saturating_duration_since(condition.since).as_secs_f64()),
            is_told: false,
        });
        Self::by(lasting.collect())
    }

    /// State by what a daemon told past its store alone ([`Monitoring::past_the_store`]).
    pub fn of_told(told: &str) -> Self {
        Self::by(past(told))
    }

    /// Text for those who can ask neither daemon nor store: the reasons why nothing is stored, empty if it is.
    pub fn past_the_store(conditions: &[Condition], now: Timestamp) -> String {
        let grave: Vec<Condition> = conditions
            .iter()
            .filter(|condition| condition.fault.is_grave())
            .take(MOST)
            .cloned()
            .collect();
        if grave.is_empty() {
            return String::new();
        }
        let mut lasting = Self::live(&grave, now).conditions;
        for one in &mut lasting {
            one.detail = one.detail.chars().take(LONGEST).collect();
            one.is_told = false;
        }
        serde_json::to_string(&lasting).unwrap_or_default()
    }

    fn by(conditions: Vec<Lasting>) -> Self {
        let mut monitoring = Self {
            stopped_since: None,
            why: None,
            conditions,
        };
        let is_grave = |lasting: &&mut Lasting| {
            let mut faults = Fault::ALL.iter();
            faults.any(|fault| fault.is_grave() && fault.code() == lasting.kind)
        };
        let grave = monitoring.conditions.iter_mut().filter(is_grave);
        if let Some(first) = grave.min_by_key(|lasting| lasting.since) {
            first.is_told = true;
            monitoring.stopped_since = Some(first.since);
            monitoring.why = Some(first.detail.clone());
        }
        monitoring
    }

    /// Adds a reason: the earlier one comes first, and the time is its own.
    fn stop(&mut self, since: Timestamp, why: &str) {
        let (since, why) = match (self.stopped_since, self.why.take()) {
            (Some(known), Some(first)) if known <= since => {
                (known, format!("{first}; since {}: {why}", minutes(since)))
            }
            (Some(known), Some(then)) => (since, format!("{why}; since {}: {then}", minutes(known))),
            _ => (since, why.to_owned()),
        };
        (self.stopped_since, self.why) = (Some(since), Some(why));
    }

    /// Sentences about a stop and the present conditions.
    pub fn sentences(&self) -> Vec<String> {
        let stopped = self.stopped_since.map(|since| {
            let why = self.why.as_deref().unwrap_or_default();
            format!("monitoring stopped since {}: {why}", minutes(since))
        });
        let lasting = self.conditions.iter().filter(|one| !one.is_told).map(|one| {
            let Lasting {
                kind, detail, since, ..
            } = one;
            format!("{kind} since {}: {detail}", minutes(*since))
        });
        stopped.into_iter().chain(lasting).collect()
    }
}

/// Conditions in a text of [`Monitoring::past_the_store`]; none if it is another program's.
fn past(told: &str) -> Vec<Lasting> {
    serde_json::from_str(told).unwrap_or_default()
}

/// A time to the minute, which is as well as it is known: `2026-03-01 12:00 UTC`.
fn minutes(time: Timestamp) -> String {
    let text = time.to_string();
    format!("{} UTC", text.get(..16).unwrap_or(&text).replace('T', " "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_reason_of_a_stop_has_its_own_time() {
        let at = |hour: i64| Timestamp::from_nanos(1_767_225_600_000_000_000 + hour * 3_600_000_000_000);
        let disk = Lasting {
            kind: "disk-full".to_owned(),
            about: "/data".to_owned(),
            detail: "there is no room".to_owned(),
            since: at(10),
            is_told: false,
        };
        let sink = Lasting {
            kind: "sink".to_owned(),
            detail: "it does not answer".to_owned(),
            ..disk.clone()
        };
        let mut monitoring = Monitoring::by(vec![sink, disk.clone()]);
        monitoring.stop(at(12), "no daemon is at work");
        let told = [
            "monitoring stopped since 2026-01-01 10:00 UTC: there is no room; since 2026-01-01 12:00 UTC: no daemon is at work",
            "sink since 2026-01-01 10:00 UTC: it does not answer",
        ];
        assert_eq!(monitoring.sentences(), told);
        // The other way round.
        let mut monitoring = Monitoring::by(vec![disk]);
        monitoring.stop(at(9), "no daemon is at work");
        assert_eq!(
            monitoring.sentences(),
            [
                "monitoring stopped since 2026-01-01 09:00 UTC: no daemon is at work; since 2026-01-01 10:00 UTC: there is no room"
            ]
        );
    }

    #[test]
    fn what_is_told_past_the_store_stops_monitoring_and_fits_into_a_page() {
        let health = crate::service::telemetry::Health::default();
        health.hold(Fault::Sink, "mail", "it does not answer");
        assert_eq!(
            Monitoring::past_the_store(&health.conditions(), Timestamp::from_nanos(0)),
            ""
        );
        for number in 0..10 {
            health.hold(Fault::DiskFull, &format!("disk {number}"), "no room ".repeat(200));
        }
        let told = Monitoring::past_the_store(&health.conditions(), Timestamp::from_nanos(0));
        assert!(told.len() < 4000, "{}", told.len());
        let monitoring = Monitoring::of_told(&told);
        assert!(monitoring.stopped_since.is_some());
        assert!(monitoring.sentences()[0].starts_with("monitoring stopped since"));
        assert!(Monitoring::of_told("written by another").conditions.is_empty());
    }
}
