//! The stream as the centre reads it: checked at the start, then in order from any message on.

use super::fold::Incoming;
use crate::config::HubConfig;
use crate::service::forward::link::{ANSWER, Link, LinkError};
use crate::service::forward::message::{OUT, STREAM};
use async_nats::jetstream::consumer::pull::Config as Pull;
use async_nats::jetstream::consumer::{AckPolicy, Consumer, DeliverPolicy};
use async_nats::jetstream::context::GetStreamErrorKind;
use async_nats::jetstream::stream::{Config, DiscardPolicy, RetentionPolicy, StorageType, Stream};
use futures_util::StreamExt;
use std::time::Duration;

/// Name of the hub at the server.
pub const NAME: &str = "HUB";

/// Most messages fetched at once.
const TOGETHER: usize = 256;
/// Most bytes fetched at once.
const BYTES: usize = 16 << 20;
/// Longest wait for messages.
const WAIT: Duration = Duration::from_millis(500);
/// Time after which the server forgets a reader that is gone.
const FORGOTTEN: Duration = Duration::from_secs(60);
/// Age at which a stream that the hub creates drops messages.
const KEPT: Duration = Duration::from_secs(90 * 86_400);
/// Largest message.
const LARGEST: i32 = 1 << 20;
/// Largest stream that the hub creates \[bytes\].
const STREAM_BYTES: i64 = 16 << 30;

/// Reading end of the stream.
pub struct Feed {
    link: Link,
    stream: Stream,
    reader: Option<Consumer<Pull>>,
    next: u64,
}

impl Feed {
    /// Connects, checks server and stream, and creates a missing stream if that is configured.
    ///
    /// # Errors
    /// The server cannot be reached, refuses, or is not fit to keep the sites' results.
    pub async fn open(config: &HubConfig) -> Result<Self, LinkError> {
        let link = Link::open(&config.nats, NAME).await?;
        let url = config.nats.url();
        let stream = match link.jetstream.get_stream(STREAM).await {
            Ok(stream) => stream,
            Err(error) if matches!(error.kind(), GetStreamErrorKind::JetStream(_)) && config.is_creating => {
                link.jetstream
                    .create_stream(wanted())
                    .await
                    .map_err(|error| link.failed(&format!("creating the stream {STREAM}"), &error))?
            }
            Err(error) => return Err(link.failed(&format!("the stream {STREAM}"), &error)),
        };
        if let Some(wrong) = unfit(&stream.cached_info().config) {
            return Err(LinkError::Failed(format!("{url}: the stream {STREAM} {wrong}")));
        }
        Ok(Self {
            link,
            stream,
            reader: None,
            next: 1,
        })
    }

    /// Connection of the feed.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// Number of the stream's first message, and of its last; 0 for an empty one.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn bounds(&mut self) -> Result<(u64, u64), LinkError> {
        let info = self
            .link
            .unless_lost(async { Ok::<_, LinkError>(self.stream.info().await) })
            .await?;
        match info {
            Ok(info) => Ok((info.state.first_sequence, info.state.last_sequence)),
            Err(error) => Err(self.link.failed(&format!("the stream {STREAM}"), &error)),
        }
    }

    /// Reads on from a message.
    ///
    /// # Errors
    /// The server refuses.
    pub async fn seek(&mut self, next: u64) -> Result<(), LinkError> {
        self.reader = Some(self.reader_from(next, format!("{OUT}.>")).await?);
        self.next = next;
        Ok(())
    }

    async fn reader_from(&self, next: u64, subject: String) -> Result<Consumer<Pull>, LinkError> {
        let settings = Pull {
            deliver_policy: DeliverPolicy::ByStartSequence {
                start_sequence: next.max(1),
            },
            // The position is kept with the rows: an acknowledgement would say the same a second time.
            ack_policy: AckPolicy::None,
            filter_subject: subject,
            inactive_threshold: FORGOTTEN,
            memory_storage: true,
            num_replicas: 1,
            ..Pull::default()
        };
        self.stream
            .create_consumer(settings)
            .await
            .map_err(|error| self.link.failed(&format!("reading the stream {STREAM}"), &error))
    }

    /// The next messages, in order; none if none came within half a second.
    ///
    /// # Errors
    /// The server does not answer, or messages were lost on the way: seek again.
    pub async fn fetch(&mut self) -> Result<Vec<Incoming>, LinkError> {
        let Some(reader) = &self.reader else {
            return Err(LinkError::Failed("the stream is not being read".to_owned()));
        };
        let found = self.link.unless_lost(self.fetch_from(reader)).await?;
        for message in &found {
            let sequence = u64::try_from(message.sequence).unwrap_or(0);
            if sequence < self.next {
                return Err(LinkError::Failed(format!(
                    "message {sequence} came after {}",
                    self.next
                )));
            }
            self.next = sequence + 1;
        }
        Ok(found)
    }

    async fn fetch_from(&self, reader: &Consumer<Pull>) -> Result<Vec<Incoming>, LinkError> {
        let failed =
            |error: &dyn std::error::Error| self.link.failed(&format!("reading the stream {STREAM}"), error);
        let asked = reader
            .fetch()
            .max_messages(TOGETHER)
            .max_bytes(BYTES)
            .expires(WAIT)
            .messages();
        let mut messages = asked.await.map_err(|error| failed(&error))?;
        let mut found = Vec::new();
        let mut before = None;
        loop {
            let next = tokio::time::timeout(ANSWER, messages.next()).await;
            let Some(next) = next.map_err(|elapsed| failed(&elapsed))? else {
                return Ok(found);
            };
            let message = next.map_err(|error| LinkError::Failed(error.to_string()))?;
            let info = message
                .info()
                .map_err(|error| LinkError::Failed(error.to_string()))?;
            // Messages of one reader are numbered: a gap was lost on the way, and is read again.
            if before.is_some_and(|before| info.consumer_sequence != before + 1) {
                return Ok(found);
            }
            before = Some(info.consumer_sequence);
            let time_ns = i64::try_from(info.published.unix_timestamp_nanos()).unwrap_or(0);
            let sequence = i64::try_from(info.stream_sequence).unwrap_or(i64::MAX);
            let message = message.message;
            found.push(Incoming {
                sequence,
                subject: message.subject.to_string(),
                headers: message.headers.unwrap_or_default(),
                payload: message.payload.to_vec(),
                time_ns,
            });
        }
    }

    /// Time at which the server took a message \[ns since 1970\]; `None` if the stream no longer has it.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn time_of(&self, sequence: u64) -> Result<Option<i64>, LinkError> {
        let reader = self.reader_from(sequence, format!("{OUT}.>")).await?;
        let next = self.fetch_from(&reader).await?.into_iter().next();
        let is_it = |found: &Incoming| u64::try_from(found.sequence) == Ok(sequence);
        Ok(next.filter(is_it).map(|found| found.time_ns))
    }

    /// First message of a site that the stream still has.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn first_of(&self, site: &str) -> Result<Option<Incoming>, LinkError> {
        let reader = self.reader_from(1, format!("{OUT}.{site}")).await?;
        Ok(self.fetch_from(&reader).await?.into_iter().next())
    }

    /// All messages of a site that the stream has.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn all_of(&self, site: &str) -> Result<Vec<Incoming>, LinkError> {
        let reader = self.reader_from(1, format!("{OUT}.{site}")).await?;
        let mut all = Vec::new();
        loop {
            let found = self.fetch_from(&reader).await?;
            if found.is_empty() {
                return Ok(all);
            }
            all.extend(found);
        }
    }
}

/// The stream that the hub creates.
fn wanted() -> Config {
    Config {
        name: STREAM.to_owned(),
        subjects: vec![format!("{OUT}.*")],
        retention: RetentionPolicy::Limits,
        storage: StorageType::File,
        discard: DiscardPolicy::Old,
        max_age: KEPT,
        max_bytes: STREAM_BYTES,
        max_message_size: LARGEST,
        allow_direct: true,
        deny_delete: true,
        deny_purge: true,
        ..Config::default()
    }
}

/// Reason why a stream is not fit to keep the sites' results.
fn unfit(config: &Config) -> Option<String> {
    let least_s = Duration::from_secs(7 * 86_400);
    let wrong = if config.storage != StorageType::File {
        "is kept in memory: it needs file storage"
    } else if config.retention != RetentionPolicy::Limits {
        "drops what was read: its retention must be limits"
    } else if config.max_age.is_zero() && config.max_bytes <= 0 {
        "has no limit: give it max_age and max_bytes, or it fills the disk"
    } else if !config.max_age.is_zero() && config.max_age < least_s {
        "drops messages before they are seven days old: raise max_age"
    } else if !config.allow_direct {
        "does not let a site read its own last message: set allow_direct"
    } else if config.no_ack {
        "does not acknowledge: unset no_ack"
    } else {
        return None;
    };
    Some(wrong.to_owned())
}

/// Checks with the server's monitoring that it flushes each message to the disk before it acknowledges it.
///
/// # Errors
/// It does not, or the monitoring cannot be read.
pub fn check_flushing(monitor: &str) -> Result<(), LinkError> {
    let address = format!("{monitor}/jsz");
    let failed = |error: &dyn std::fmt::Display| LinkError::Failed(format!("{address}: {error}"));
    let agent = ureq::Agent::new_with_config(
        ureq::Agent::config_builder()
            .timeout_global(Some(Duration::from_secs(10)))
            .build(),
    );
    let mut answer = agent.get(&address).call().map_err(|error| failed(&error))?;
    let text = answer
        .body_mut()
        .read_to_string()
        .map_err(|error| failed(&error))?;
    let said: serde_json::Value = serde_json::from_str(&text).map_err(|error| failed(&error))?;
    if said.pointer("/config/sync_always") == Some(&serde_json::Value::Bool(true)) {
        return Ok(());
    }
    Err(LinkError::Failed(format!(
        "{address}: the server acknowledges messages that are not on the disk yet: put `sync_interval: always` into its jetstream section"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stream_that_is_created_is_fit_and_laxer_ones_are_not() {
        assert_eq!(unfit(&wanted()), None);
        let laxer: [fn(&mut Config); 6] = [
            |config| config.storage = StorageType::Memory,
            |config| config.retention = RetentionPolicy::WorkQueue,
            |config| (config.max_age, config.max_bytes) = (Duration::ZERO, -1),
            |config| config.max_age = Duration::from_secs(3600),
            |config| config.allow_direct = false,
            |config| config.no_ack = true,
        ];
        for change in laxer {
            let mut config = wanted();
            change(&mut config);
            assert!(unfit(&config).is_some(), "{config:?}");
        }
    }
}
