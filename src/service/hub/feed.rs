//! The stream as the centre reads it: checked at the start, then in order from any message on.
//!
//! Each message is asked for by its number, and comes inside an answer of the server's own: what a site may have written into its
//! headers cannot end the connection, none can be lost on the way unnoticed, and "there is none" is said, not guessed from silence.

use super::incoming::Incoming;
use super::lasting::Lasting;
use super::text::fit;
use crate::config::HubConfig;
use crate::config::settings::forward::HUB;
use crate::service::forward::link::{Link, LinkError};
use crate::service::forward::message::{OUT, STREAM};
use async_nats::jetstream::stream::Stream;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;
use serde_json::json;
use std::time::Duration;
use tokio::task::JoinHandle;

/// Most messages asked for at once.
const TOGETHER: u64 = 32;
/// Most bytes asked for at once, as far as the messages before tell.
const BYTES: usize = 16 << 20;
/// Wait after the end of the stream was reached.
const WAIT: Duration = Duration::from_millis(50);
/// The server's error for a message that is not there.
const NO_MESSAGE: u64 = 10_037;
/// The stream of the sites' results.
const RESULTS: Lasting = Lasting {
    name: STREAM,
    subject: OUT,
    kept: Duration::from_secs(90 * 86_400),
    remembers: Duration::ZERO,
};
/// Most bytes kept of a header's value: no label is longer.
const HEADER: usize = 200;
/// Most bytes kept of all headers.
const HEADERS: usize = 4096;

/// Reading end of the stream.
pub struct Feed {
    link: Link,
    stream: Stream,
    next: u64,
    /// Number of messages that are asked for beyond the next one.
    ahead: u64,
    reading: Reading,
}

/// Messages that are asked for; no longer when dropped.
#[derive(Default)]
struct Reading(Option<JoinHandle<Result<Vec<Incoming>, LinkError>>>);

impl Drop for Reading {
    fn drop(&mut self) {
        if let Some(reading) = &self.0 {
            reading.abort();
        }
    }
}

/// Answer of the server to the question for a message.
#[derive(Deserialize)]
struct Answer {
    message: Option<Stored>,
    error: Option<Refusal>,
}

#[derive(Deserialize)]
struct Refusal {
    #[serde(default)]
    err_code: u64,
    #[serde(default)]
    description: String,
}

/// A message as the server keeps it; headers and content in base64.
#[derive(Deserialize)]
struct Stored {
    subject: String,
    seq: u64,
    #[serde(default)]
    hdrs: String,
    #[serde(default)]
    data: String,
    time: String,
}

impl Stored {
    fn read(self) -> Result<Incoming, String> {
        let bytes = |text: &str| STANDARD.decode(text).map_err(|error| error.to_string());
        let time: jiff::Timestamp = self
            .time
            .parse()
            .map_err(|error: jiff::Error| error.to_string())?;
        Ok(Incoming {
            sequence: i64::try_from(self.seq).unwrap_or(i64::MAX),
            subject: fit(&self.subject, 255),
            headers: headers(&bytes(&self.hdrs)?),
            payload: bytes(&self.data)?,
            time_ns: i64::try_from(time.as_nanosecond()).unwrap_or(0),
        })
    }
}

/// Lines `Name: value` of a block of headers, whatever it holds; the labels' own first, since junk is cut off.
fn headers(block: &[u8]) -> String {
    let text = String::from_utf8_lossy(block);
    let mut lines: Vec<String> = text
        .split("\r\n")
        .skip(1)
        .filter_map(|line| line.split_once(':'))
        .map(|(name, value)| format!("{}: {}", fit(name.trim(), HEADER), fit(value.trim(), HEADER)))
        .collect();
    lines.sort_by_key(|line| !line.starts_with("Tirante-"));
    let mut kept = 0;
    lines.retain(|line| {
        kept += line.len() + 1;
        kept <= HEADERS
    });
    lines.join("\n")
}

impl Feed {
    /// Connects, checks server and stream, and creates a missing stream if that is configured.
    ///
    /// # Errors
    /// The server cannot be reached, refuses, or is not fit to keep the sites' results.
    pub async fn open(config: &HubConfig) -> Result<Self, LinkError> {
        let link = Link::open(&config.nats, HUB).await?;
        let stream = RESULTS.open(&link, config).await?;
        Ok(Self {
            link,
            stream,
            next: 1,
            ahead: 0,
            reading: Reading::default(),
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
    pub fn seek(&mut self, next: u64) {
        self.next = next.max(1);
        self.ahead = 0;
        self.reading = Reading::default();
    }

    /// The next messages, in order; none, after a short wait, at the end of the stream. Those after them are asked for meanwhile.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn fetch(&mut self) -> Result<Vec<Incoming>, LinkError> {
        let reading = match self.reading.0.take() {
            Some(reading) => reading,
            None => self.read_on(),
        };
        let found = reading.await;
        let found =
            found.map_err(|error| LinkError::Failed(format!("reading the stream {STREAM}: {error}")))??;
        let Some(last) = found.last() else {
            self.ahead = 0;
            tokio::time::sleep(WAIT).await;
            return Ok(found);
        };
        let more = found.len() as u64 - 1;
        let largest = found.iter().map(|one| one.payload.len()).max().unwrap_or(0);
        let room = (BYTES / largest.max(1)) as u64;
        self.ahead = if more == self.ahead {
            (2 * self.ahead + 1).min(TOGETHER).min(room)
        } else {
            more
        };
        self.next = number(last) + 1;
        self.reading.0 = Some(self.read_on());
        Ok(found)
    }

    /// Asks for the next messages.
    fn read_on(&self) -> JoinHandle<Result<Vec<Incoming>, LinkError>> {
        let (link, next, ahead) = (self.link.clone(), self.next, self.ahead);
        tokio::spawn(async move {
            let Some(first) = next_of(&link, next, &format!("{OUT}.>")).await? else {
                return Ok(Vec::new());
            };
            let begin = number(&first) + 1;
            let more = (begin..begin + ahead).map(|sequence| at(&link, sequence));
            let mut found = vec![first];
            for message in futures_util::future::join_all(more).await {
                let Some(message) = message? else { break };
                found.push(message);
            }
            Ok(found)
        })
    }

    /// The message of a number; `None` if the stream does not have it.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn at(&self, sequence: u64) -> Result<Option<Incoming>, LinkError> {
        at(&self.link, sequence).await
    }

    /// The first message of a site that is not before a number.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn next_of_site(&self, sequence: u64, site: &str) -> Result<Option<Incoming>, LinkError> {
        next_of(&self.link, sequence, &format!("{OUT}.{site}")).await
    }
}

async fn at(link: &Link, sequence: u64) -> Result<Option<Incoming>, LinkError> {
    let found = ask(link, STREAM, &json!({ "seq": sequence })).await?;
    let is_of_a_site = |found: &Incoming| found.subject.starts_with(&format!("{OUT}."));
    Ok(found.filter(is_of_a_site))
}

async fn next_of(link: &Link, sequence: u64, subject: &str) -> Result<Option<Incoming>, LinkError> {
    let question = json!({ "seq": sequence.max(1), "next_by_subj": subject });
    ask(link, STREAM, &question).await
}

/// The message of a stream that a question names; `None` if there is none.
///
/// # Errors
/// The server does not answer.
pub async fn ask(
    link: &Link,
    stream: &str,
    question: &serde_json::Value,
) -> Result<Option<Incoming>, LinkError> {
    let what = format!("reading the stream {stream} ({question})");
    let failed = |error: &dyn std::error::Error| link.failed(&what, error);
    let ask = async {
        let subject = format!("$JS.API.STREAM.MSG.GET.{stream}");
        let asked = link.client.request(subject, question.to_string().into());
        asked.await.map_err(|error| failed(&error))
    };
    let answer = link.unless_lost(ask).await?;
    let answer: Answer = serde_json::from_slice(&answer.payload).map_err(|error| failed(&error))?;
    match answer {
        Answer {
            message: Some(message),
            ..
        } => message.read().map(Some).map_err(LinkError::Failed),
        Answer {
            error: Some(error), ..
        } if error.err_code == NO_MESSAGE => Ok(None),
        Answer { error, .. } => {
            let said = error.map_or_else(String::new, |error| error.description);
            Err(LinkError::Failed(format!("{what}: {said}")))
        }
    }
}

/// Number of a message in the stream.
pub fn number(message: &Incoming) -> u64 {
    u64::try_from(message.sequence).unwrap_or(0)
}

/// Warning of a hub or worker that is told of no monitoring.
pub const UNSEEN: &str = "whether the server flushes each message (sync_interval: always) cannot be seen: name its monitoring as [nats] monitor";

/// Checks with the servers' monitoring that each flushes a message to the disk before it acknowledges it. Of a cluster some may be gone.
///
/// # Errors
/// One does not, or no monitoring can be read.
pub fn check_flushing(monitors: &[String]) -> Result<(), LinkError> {
    if monitors.is_empty() {
        tracing::warn!("{UNSEEN}");
        return Ok(());
    }
    let mut silent = Vec::new();
    for monitor in monitors {
        let address = format!("{monitor}/jsz");
        match is_flushing(&address) {
            Ok(true) => {}
            Ok(false) => {
                return Err(LinkError::Failed(format!(
                    "{address}: the server acknowledges messages that are not on the disk yet: put `sync_interval: always` into its jetstream section"
                )));
            }
            Err(error) => silent.push(format!("{address}: {error}")),
        }
    }
    if silent.len() == monitors.len() {
        return Err(LinkError::Failed(silent.join("; ")));
    }
    for error in silent {
        tracing::warn!("{error}: whether this server flushes each message is not known");
    }
    Ok(())
}

/// True if a server says that it flushes each message.
fn is_flushing(address: &str) -> Result<bool, Box<dyn std::error::Error>> {
    let agent = ureq::Agent::new_with_config(
        ureq::Agent::config_builder()
            .timeout_global(Some(Duration::from_secs(10)))
            .build(),
    );
    let text = agent.get(address).call()?.body_mut().read_to_string()?;
    let said: serde_json::Value = serde_json::from_str(&text)?;
    Ok(said.pointer("/config/sync_always") == Some(&serde_json::Value::Bool(true)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_read_whatever_they_hold() {
        let block = b"NATS/1.0 409 x\r\nTirante-N: 7\r\nA b: \0\xff\rq\r\nnothing\r\n\r\n";
        assert_eq!(headers(block), "Tirante-N: 7\nA b: \\u{0}\u{fffd}\\u{d}q");
        let junk = format!("NATS/1.0\r\n{}Tirante-N: 7\r\n\r\n", "X: y\r\n".repeat(9000));
        let kept = headers(junk.as_bytes());
        assert!(kept.starts_with("Tirante-N: 7\n") && kept.len() <= HEADERS);
        assert_eq!(headers(b""), "");
    }
}
