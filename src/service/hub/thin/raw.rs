//! The stream with the samples of sites without a computer, as a worker reads it.

use crate::config::HubConfig;
use crate::config::settings::forward::WORK;
use crate::service::forward::beat::Heartbeat;
use crate::service::forward::link::{Link, LinkError};
use crate::service::hub::centre::Position;
use crate::service::hub::feed;
use crate::service::hub::incoming::Incoming;
use crate::service::hub::lasting::Lasting;
use async_nats::jetstream::stream::Stream;
use serde_json::json;
use std::time::{Duration, Instant};

/// Stream with the samples.
const STREAM: &str = "TIRANTE_RAW";
/// Subject of a site, without its name.
pub const RAW: &str = "tirante.v1.raw";

/// The stream as a worker creates it.
const SAMPLES: Lasting = Lasting {
    name: STREAM,
    subject: RAW,
    kept: Duration::from_secs(30 * 86_400),
    // A sensor that was cut off sends again what was not acknowledged.
    remembers: Duration::from_secs(86_400),
};
/// Most messages taken at once, and their bytes.
const MOST: usize = 256;
const BYTES: usize = 16 << 20;

/// Reading end of a site's subject.
pub struct Raw {
    link: Link,
    stream: Stream,
    subject: String,
    site: String,
    /// Place up to which messages were taken.
    position: Position,
    /// True after a stream that was set back was told.
    has_told: bool,
}

impl Raw {
    /// Connects, and creates the stream if it is missing and that is configured.
    ///
    /// # Errors
    /// The server cannot be reached, refuses, or is not fit to keep samples.
    pub async fn open(config: &HubConfig, site: &str) -> Result<Self, LinkError> {
        let link = Link::open(&config.nats, WORK).await?;
        let stream = SAMPLES.open(&link, config).await?;
        Ok(Self {
            stream,
            subject: format!("{RAW}.{site}"),
            site: site.to_owned(),
            link,
            position: Position::default(),
            has_told: false,
        })
    }

    /// Reads on after a message. A stream that was set back or made anew does not have it: it is read from its beginning, and
    /// records that are known are recognised by their content.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn seek(&mut self, after: Position) -> Result<(), LinkError> {
        let number = u64::try_from(after.sequence).unwrap_or(0);
        let info = self
            .link
            .unless_lost(async { Ok::<_, LinkError>(self.stream.info().await) })
            .await?;
        let last = match info {
            Ok(info) => info.state.last_sequence,
            Err(error) => return Err(self.link.failed(&format!("the stream {STREAM}"), &error)),
        };
        let is_the_same = number == 0
            || last >= number
                && self
                    .ask(&json!({ "seq": number }))
                    .await?
                    .is_none_or(|found| found.time_ns == after.time_ns);
        self.position = if is_the_same { after } else { Position::default() };
        if !is_the_same && !std::mem::replace(&mut self.has_told, true) {
            tracing::warn!(
                "{}: message {number} of the stream {STREAM} is not the one that was read: it was set back, and is read from its \
                 beginning",
                self.site
            );
        }
        Ok(())
    }

    /// The next messages of the site, in order, as many as come until a time; none at the end.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn fetch(&mut self, until: Instant) -> Result<Vec<Incoming>, LinkError> {
        let mut found = Vec::new();
        let mut bytes = 0;
        while found.len() < MOST && bytes < BYTES && (found.is_empty() || Instant::now() < until) {
            let next = json!({ "seq": self.position.sequence + 1, "next_by_subj": self.subject });
            let Some(message) = self.ask(&next).await? else {
                break;
            };
            bytes += message.payload.len();
            self.position = Position {
                sequence: message.sequence,
                time_ns: message.time_ns,
            };
            found.push(message);
        }
        Ok(found)
    }

    /// Sends a heartbeat of the site.
    ///
    /// # Errors
    /// The post does not take it.
    pub async fn beat(&self, beat: &Heartbeat) -> Result<(), LinkError> {
        beat.send(&self.link, &self.site).await
    }

    async fn ask(&self, question: &serde_json::Value) -> Result<Option<Incoming>, LinkError> {
        feed::ask(&self.link, STREAM, question).await
    }
}
