//! Heartbeats of the sites as the centre hears them, on a connection of their own: what a site may write into one delays no results.

use super::feed::{self, number};
use super::text::fit;
use crate::config::HubConfig;
use crate::config::settings::forward::HUB;
use crate::service::forward::beat::{Heartbeat, LARGEST, STREAM, SUBJECT};
use crate::service::forward::link::{Link, LinkError};
use crate::service::telemetry::{Fault, Health};
use crate::site::clock;
use async_nats::jetstream::context::GetStreamErrorKind;
use async_nats::jetstream::stream::{Config, RetentionPolicy, StorageType};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Wait after the end of the stream was reached.
const WAIT: Duration = Duration::from_secs(1);
/// Wait after a failure.
const AGAIN: Duration = Duration::from_secs(10);
/// Age at which the latest heartbeat of a site is dropped.
const KEPT: Duration = Duration::from_secs(7 * 86_400);
/// Largest stream: the server keeps it in memory \[bytes\].
const STREAM_BYTES: i64 = 64 << 20;
/// Subject of the condition of heartbeats that are not heard.
const ABOUT: &str = "hub/heartbeats";
/// Longest text of a heartbeat \[bytes\].
const LONGEST: usize = 300;

/// A heartbeat with the time at which the server took it.
#[derive(Debug, Clone, PartialEq)]
pub struct Heard {
    /// Time at which the server took it \[ns since 1970\].
    pub heard_ns: i64,
    /// What the site said.
    pub beat: Heartbeat,
}

impl Heard {
    /// Lead of the site's clock over the server's \[s\].
    pub fn clock_off_s(&self) -> f64 {
        (i128::from(self.beat.time_ns) - i128::from(self.heard_ns)) as f64 * 1e-9
    }
}

/// Heartbeats as they are heard; shared with the one that keeps them.
#[derive(Debug, Clone, Default)]
pub struct Beats(Arc<Mutex<Ear>>);

#[derive(Debug, Default)]
struct Ear {
    /// Heartbeats that are not in the database yet, by site.
    came: BTreeMap<String, Heard>,
    /// Time since which they are heard \[ns since 1970\]; `None` while they are not.
    since_ns: Option<i64>,
}

impl Beats {
    /// Listens until the runtime ends; whatever fails is tried again.
    pub async fn listen(self, config: Arc<HubConfig>, health: Arc<Health>) {
        loop {
            let Err(error) = self.hear(&config, &health).await;
            self.lock().since_ns = None;
            let wait_s = AGAIN.as_secs();
            let detail = format!("heartbeats are not heard: {error}; tried again in {wait_s} s");
            health.hold(Fault::Forward, ABOUT, detail);
            tokio::time::sleep(AGAIN).await;
        }
    }

    /// Takes what was heard since the last call.
    pub fn take(&self) -> BTreeMap<String, Heard> {
        std::mem::take(&mut self.lock().came)
    }

    /// Time since which heartbeats are heard \[ns since 1970\]; `None` while they are not.
    pub fn since_ns(&self) -> Option<i64> {
        self.lock().since_ns
    }

    async fn hear(&self, config: &HubConfig, health: &Health) -> Result<std::convert::Infallible, LinkError> {
        let link = Link::open(&config.nats, HUB).await?;
        check(&link, config).await?;
        let listed: BTreeSet<&str> = config.sites.iter().map(|site| site.name.as_str()).collect();
        let mut next = 1;
        loop {
            let question = serde_json::json!({ "seq": next, "next_by_subj": format!("{SUBJECT}.>") });
            let found = feed::ask(&link, STREAM, &question).await?;
            health.over(Fault::Forward, ABOUT);
            self.lock()
                .since_ns
                .get_or_insert_with(|| clock::now().as_nanos());
            let Some(message) = found else {
                let wait = async {
                    tokio::time::sleep(WAIT).await;
                    Ok::<_, LinkError>(())
                };
                link.unless_lost(wait).await?;
                continue;
            };
            next = number(&message) + 1;
            let site = message.subject.strip_prefix(SUBJECT).unwrap_or_default();
            let site = site.trim_start_matches('.');
            if !listed.contains(site) {
                let detail = format!("a heartbeat of {site}, which is not on the list of sites");
                health.fault(Fault::Forward, detail);
                continue;
            }
            match read(&message.payload) {
                Ok(beat) => {
                    let heard_ns = message.time_ns;
                    let heard = Heard { heard_ns, beat };
                    self.lock().came.insert(site.to_owned(), heard);
                }
                Err(error) => {
                    let detail = format!("{site}: a heartbeat cannot be read: {}", fit(&error, LONGEST));
                    health.fault(Fault::Forward, detail);
                }
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Ear> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A heartbeat with texts that every database and log takes.
fn read(payload: &[u8]) -> Result<Heartbeat, String> {
    let mut beat: Heartbeat = serde_json::from_slice(payload).map_err(|error| error.to_string())?;
    for text in [&mut beat.epoch, &mut beat.version, &mut beat.state] {
        *text = fit(text, LONGEST);
    }
    beat.rods = beat
        .rods
        .into_iter()
        .map(|(state, count)| (fit(&state, LONGEST), count))
        .collect();
    beat.refused = beat
        .refused
        .into_iter()
        .map(|(reason, count)| (fit(&reason, LONGEST), count))
        .collect();
    for lasting in &mut beat.conditions {
        lasting.kind = fit(&lasting.kind, LONGEST);
        lasting.detail = fit(&lasting.detail, LONGEST);
    }
    Ok(beat)
}

/// Creates the stream if it is missing and that is configured, and checks that it keeps the latest heartbeats alone.
async fn check(link: &Link, config: &HubConfig) -> Result<(), LinkError> {
    let stream = match link.jetstream.get_stream(STREAM).await {
        Err(error) if matches!(error.kind(), GetStreamErrorKind::JetStream(_)) && config.is_creating => {
            let created = link.jetstream.create_stream(wanted(config.nats.replicas())).await;
            created.map_err(|error| link.failed(&format!("creating the stream {STREAM}"), &error))?
        }
        found => found.map_err(|error| link.failed(&format!("the stream {STREAM}"), &error))?,
    };
    let found = &stream.cached_info().config;
    let replicas = config.nats.replicas();
    let is_fit = found.max_messages_per_subject == 1
        && found.num_replicas.max(1) >= replicas
        && found.retention == RetentionPolicy::Limits
        && found.subjects == [format!("{SUBJECT}.*")];
    if is_fit {
        return Ok(());
    }
    let what = format!(
        "the stream {STREAM} is not that of the sites' latest heartbeats: its subjects must be {SUBJECT}.*, its max_msgs_per_subject 1, its replicas {replicas}"
    );
    Err(LinkError::Failed(what))
}

/// The stream that the hub creates.
fn wanted(replicas: usize) -> Config {
    Config {
        name: STREAM.to_owned(),
        num_replicas: replicas,
        subjects: vec![format!("{SUBJECT}.*")],
        retention: RetentionPolicy::Limits,
        storage: StorageType::Memory,
        max_messages_per_subject: 1,
        max_age: KEPT,
        max_bytes: STREAM_BYTES,
        max_message_size: LARGEST,
        deny_delete: true,
        deny_purge: true,
        ..Config::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heartbeat_reads_back_and_junk_does_not() {
        let beat = Heartbeat {
            time_ns: 120_000_000_000,
            epoch: "00ff".to_owned(),
            through: 7,
            version: "0.1.0".to_owned(),
            state: "ok\0".to_owned(),
            rods: BTreeMap::from([("monitoring".to_owned(), 2)]),
            stopped_since: None,
            conditions: Vec::new(),
            refused: BTreeMap::new(),
        };
        let sent = serde_json::to_vec(&beat).unwrap();
        let found = read(&sent).unwrap();
        assert!(!found.state.contains('\0') && found.rods == beat.rods);
        let heard = |heard_ns| Heard {
            heard_ns,
            beat: beat.clone(),
        };
        assert!((heard(0).clock_off_s() - 120.0).abs() < 1e-9);
        assert!((heard(240_000_000_000).clock_off_s() + 120.0).abs() < 1e-9);
        for junk in [&b""[..], b"{}", b"nothing", &sent[..sent.len() - 1]] {
            assert!(read(junk).is_err());
        }
    }
}
