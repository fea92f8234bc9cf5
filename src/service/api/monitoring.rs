//! State of a site's monitoring, and the daemon's present conditions.

use crate::analysis::signal::record::Timestamp;
use crate::service::telemetry::{Condition, Fault};
use crate::site::store::{Reader, StoreError};
use serde::Serialize;
use std::time::Instant;

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
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lasting {
    /// Kind of the condition, as in `/healthz`.
    pub kind: String,
    /// Sink, file or folder concerned.
    pub about: String,
    /// One sentence.
    pub detail: String,
    /// Time of its begin, by the machine's clock.
    pub since: Timestamp,
}

impl Monitoring {
    /// State by the store at `now`; `None` if no daemon ever worked on it. `is_held`: true if a process
    /// writes to it now, if known.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(reader: &Reader, is_held: Option<bool>, now: Timestamp) -> Result<Option<Self>, StoreError> {
        let Some(last) = reader.stretches()?.last().copied() else {
            return Ok(None);
        };
        let conditions = reader.standing_notices()?.into_iter().map(|begun| Lasting {
            kind: begun.fault,
            about: begun.about,
            detail: begun.detail,
            since: begun.raised,
        });
        let mut monitoring = Self::by(conditions.collect());
        if is_held == Some(false) {
            monitoring.stop(last.to, "no daemon is at work on this store");
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
        });
        Self::by(lasting.collect())
    }

    fn by(conditions: Vec<Lasting>) -> Self {
        let mut monitoring = Self {
            stopped_since: None,
            why: None,
            conditions,
        };
        let is_grave = |lasting: &&Lasting| {
            let mut faults = Fault::ALL.iter();
            faults.any(|fault| fault.is_grave() && fault.code() == lasting.kind)
        };
        let grave = monitoring.conditions.iter().filter(is_grave);
        if let Some(first) = grave.min_by_key(|lasting| lasting.since).cloned() {
            monitoring.stop(first.since, &first.detail);
        }
        monitoring
    }

    fn stop(&mut self, since: Timestamp, why: &str) {
        self.stopped_since = Some(self.stopped_since.map_or(since, |known| known.min(since)));
        self.why = Some(why.to_owned());
    }

    /// Sentences about a stop and the present conditions.
    pub fn sentences(&self) -> Vec<String> {
        let stopped = self.stopped_since.map(|since| {
            let why = self.why.as_deref().unwrap_or_default();
            format!("monitoring stopped since {since}: {why}")
        });
        let lasting = self.conditions.iter().map(|one| {
            let Lasting {
                kind, detail, since, ..
            } = one;
            format!("{kind} since {since}: {detail}")
        });
        stopped.into_iter().chain(lasting).collect()
    }
}
