//! Heartbeat: a site with nothing to send still says that it lives, and how it stands.
//!
//! Only the latest of a site is kept at the post, in a stream of its own without a copy on the disk: it is sent once, and one that is
//! lost is replaced by the next.

use super::link::{Link, LinkError};
use crate::analysis::signal::record::Timestamp;
use crate::service::api::monitoring::Monitoring;
use crate::service::telemetry::Health;
use crate::site::clock;
use crate::site::store::{Reader, StoreError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// Stream with the latest heartbeat of each site.
pub const STREAM: &str = "TIRANTE_BEAT";
/// Subject of a site, without its name.
pub const SUBJECT: &str = "tirante.v1.beat";
/// Longest time for the post to take one; results wait meanwhile.
const ANSWER: Duration = Duration::from_secs(2);
/// Largest heartbeat that the stream takes \[bytes\].
pub const LARGEST: i32 = 16 << 10;

/// Most conditions told, and the longest text of each \[characters\].
const MOST: usize = 8;
const LONGEST: usize = 200;

/// State of a site at one moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// Time by the site's clock \[ns since 1970\].
    pub time_ns: i64,
    /// Id of its store.
    pub epoch: String,
    /// Last commit of its store.
    pub through: i64,
    /// Version of its program.
    pub version: String,
    /// State of the daemon's health in one word, as in `/healthz`.
    pub state: String,
    /// Number of rods by their state.
    pub rods: BTreeMap<String, u32>,
    /// Time since which nothing is measured or stored, UTC.
    pub stopped_since: Option<Timestamp>,
    /// Present conditions of the daemon, at most eight.
    pub conditions: Vec<Lasting>,
    /// Number of commands since the daemon's start that were not carried out, by reason.
    #[serde(default)]
    pub refused: BTreeMap<String, u64>,
}

/// A present condition of a site's daemon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Lasting {
    /// Kind of the condition, as in `/healthz`.
    pub kind: String,
    /// Description in one sentence.
    pub detail: String,
    /// Time of its begin by the site's clock, UTC.
    pub since: Timestamp,
}

impl Heartbeat {
    /// Present state of the store with the id `epoch`, and of the daemon that writes it.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn of(reader: &Reader, epoch: &str, health: &Health) -> Result<Self, StoreError> {
        let now = clock::now();
        let monitoring = Monitoring::live(&health.conditions(), now);
        let mut rods = BTreeMap::new();
        for standing in reader.standings_of(None, now)? {
            *rods.entry(standing.state.code().to_owned()).or_default() += 1;
        }
        let conditions = monitoring.conditions.into_iter().take(MOST);
        Ok(Self {
            time_ns: now.as_nanos(),
            epoch: epoch.to_owned(),
            through: reader.latest_change()?,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            state: health.state().code().to_owned(),
            rods,
            refused: BTreeMap::new(),
            stopped_since: monitoring.stopped_since,
            conditions: conditions
                .map(|one| Lasting {
                    kind: one.kind,
                    detail: one.detail.chars().take(LONGEST).collect(),
                    since: one.since,
                })
                .collect(),
        })
    }

    /// Sends it as a site's.
    ///
    /// # Errors
    /// The post does not take it.
    pub async fn send(&self, link: &Link, site: &str) -> Result<(), LinkError> {
        let payload = serde_json::to_vec(self).map_err(|error| LinkError::Failed(error.to_string()))?;
        let subject = format!("{SUBJECT}.{site}");
        let send = async {
            link.jetstream
                .publish(subject.clone(), payload.into())
                .await?
                .await
        };
        match tokio::time::timeout(ANSWER, send).await {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(error)) => Err(link.failed(&subject, &error)),
            Err(elapsed) => Err(link.failed(&subject, &elapsed)),
        }
    }
}
