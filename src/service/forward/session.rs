//! One connection's work: finds where the subject ends, and continues it commit by commit, one message in flight.

use super::beat::Heartbeat;
use super::command;
use super::link::{ANSWER, Link, LinkError};
use super::message::{self, Label, MessageError, OUT, STREAM};
use super::obey::Obedience;
use super::throttle::{self, Throttle};
use crate::config::settings::forward::ForwardSettings;
use crate::service::telemetry::Health;
use crate::site::store::{Change, FORMAT, Reader, StoreError};
use async_nats::jetstream::context::PublishErrorKind;
use async_nats::jetstream::message::{PublishMessage, StreamMessage};
use async_nats::jetstream::stream::DirectGetErrorKind;
use async_nats::{HeaderValue, Subscriber};
use std::collections::BTreeMap;
use std::time::Duration;

/// Longest time for the post to answer for commands; results wait meanwhile.
const COMMANDS: Duration = Duration::from_secs(2);
/// Room for headers in a message \[bytes\].
const HEADERS: usize = 4096;
/// Largest message of several commits \[bytes\]; one commit alone may be as large as the server takes.
const LARGEST: usize = 1 << 20;

/// Reason why a connection is given up.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The post.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A message.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// The store is older than what was sent of it.
    #[error(
        "the post has commit {sent} of this store, which ends with {own} and does not have it so: the store was set back to a copy, \
         and what follows would contradict what the centre has; begin a new store, it opens a segment of its own there"
    )]
    SetBack {
        /// Last commit of the store at the post.
        sent: i64,
        /// Last commit of the store.
        own: i64,
    },
    /// Another store sends under the same name.
    #[error(
        "store {other} sends as site {site}, too, and this is store {own}: one of two machines has the wrong name, or an old one is \
         still at work"
    )]
    TwoStores {
        /// Name of the site.
        site: String,
        /// Id of the other store.
        other: String,
        /// Id of this one.
        own: String,
    },
    /// A commit does not fit into a message.
    #[error(
        "commit {number} makes a message of {bytes} bytes, and the server takes {allowed}: raise its max_payload, and max_msg_size of \
         the stream {STREAM} if it has one"
    )]
    TooLarge {
        /// Number of the commit.
        number: i64,
        /// Size of the message \[bytes\].
        bytes: usize,
        /// Largest message the server takes \[bytes\].
        allowed: usize,
    },
    /// The store has no id.
    #[error("the store is of an older format")]
    Old,
}

/// End of a site's subject.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct End {
    /// Sequence of its last message in the stream; 0 without any.
    pub sequence: u64,
    /// Last commit of this store in it; 0 without any.
    pub through: i64,
}

/// Work of one connection.
pub struct Session<'a> {
    link: Link,
    settings: &'a ForwardSettings,
    epoch: String,
    end: End,
    subject: String,
    allowed: usize,
    pauses: Subscriber,
}

impl<'a> Session<'a> {
    /// Connects, and finds the end of the subject. `has_led` is true if this process has sent already: another store at the end
    /// is then one that works at the same time.
    ///
    /// # Errors
    /// The post refuses, or the store does not continue what was sent.
    pub async fn open(
        settings: &'a ForwardSettings,
        reader: &Reader,
        has_led: bool,
    ) -> Result<Self, SessionError> {
        let epoch = reader.epoch()?.ok_or(SessionError::Old)?;
        let link = Link::open(&settings.nats, &settings.site).await?;
        let allowed = link.client.server_info().max_payload.saturating_sub(HEADERS);
        let subscribed = link.client.subscribe(throttle::SUBJECT).await;
        let pauses = subscribed.map_err(|error| link.failed(throttle::SUBJECT, &error))?;
        let mut session = Self {
            link,
            settings,
            epoch,
            end: End {
                sequence: 0,
                through: 0,
            },
            subject: format!("{OUT}.{}", settings.site),
            allowed,
            pauses,
        };
        session.find_end(reader, has_led).await?;
        // The server answers in order: had it refused the subscription, it would have said so by now.
        if let Some(said) = session.link.take_refused_pauses() {
            tracing::warn!(
                "{said}: give the site the rights of config/fleet/rights.conf; without this one its backlogs do not pause when the hub \
                 asks, and what is new at other sites waits behind them"
            );
        }
        Ok(session)
    }

    /// Connection of the session.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// End of the subject as known.
    pub fn end(&self) -> End {
        self.end
    }

    /// Reads the last message of the subject and continues after it.
    async fn find_end(&mut self, reader: &Reader, has_led: bool) -> Result<(), SessionError> {
        let Some(last) = self.last_of(STREAM, &self.subject, ANSWER).await? else {
            self.end = End {
                sequence: 0,
                through: 0,
            };
            return Ok(());
        };
        let header = |name: &'static str| last.headers.get(name).map(HeaderValue::as_str);
        // A message without a label, or of a content that cannot be read, says nothing of the commits before it: the centre parks it, and this
        // store is sent again from its beginning. What the centre has is recognised there by its number.
        let label = Label::read(header)
            .and_then(|label| message::decode(&label, &last.payload).map(|_| label))
            .ok()
            .filter(|label| label.epoch != self.epoch || !label.mark.is_empty());
        let through = match label {
            Some(label) if label.epoch == self.epoch => {
                let own = reader.latest_change()?;
                // Rows of another format have other checksums.
                let is_ours = label.format != FORMAT || reader.mark_of(label.last)? == label.mark;
                if label.last > own || !is_ours {
                    return Err(SessionError::SetBack {
                        sent: label.last,
                        own,
                    });
                }
                label.last
            }
            Some(label) if has_led => {
                return Err(SessionError::TwoStores {
                    site: self.settings.site.clone(),
                    other: label.epoch,
                    own: self.epoch.clone(),
                });
            }
            // Another store's history ends here, and this one's begins; the centre keeps them apart.
            _ => 0,
        };
        self.end = End {
            sequence: last.sequence,
            through,
        };
        Ok(())
    }

    /// The last message of a subject.
    async fn last_of(
        &self,
        stream: &str,
        subject: &str,
        longest: Duration,
    ) -> Result<Option<StreamMessage>, SessionError> {
        let what = format!("the last message of {subject}");
        let stream = self.link.jetstream.get_stream_no_info(stream).await;
        let stream = stream.map_err(|error| self.link.failed(&what, &error))?;
        let ask = async {
            // A request that may not be asked is never answered.
            let asked = stream.direct_get_last_for_subject(subject);
            match tokio::time::timeout(longest, asked).await {
                Ok(Ok(message)) => Ok(Some(message)),
                Ok(Err(error)) if error.kind() == DirectGetErrorKind::NotFound => Ok(None),
                Ok(Err(error)) => Err(self.link.failed(&what, &error).into()),
                Err(elapsed) => Err(self.link.failed(&what, &elapsed).into()),
            }
        };
        self.link.unless_lost(ask).await
    }

    /// Takes what the centre asks of the sites that have a backlog.
    pub fn hear(&mut self, throttle: &mut Throttle) {
        throttle.hear(&mut self.pauses);
    }

    /// Sends the next message, of at most `most` commits; returns the last commit it held, or `None` if there is nothing to send.
    ///
    /// # Errors
    /// The post or the store refuses; what was sent last is not known then.
    pub async fn send_next(&mut self, reader: &Reader, most: usize) -> Result<Option<i64>, SessionError> {
        let changes = reader.changes_after(self.end.through, most)?;
        let Some((count, payload)) = self.fit(&changes)? else {
            return Ok(None);
        };
        let label = Label {
            epoch: self.epoch.clone(),
            first: self.end.through + 1,
            last: self.end.through + count as i64,
            format: FORMAT,
            mark: reader.mark_of(self.end.through + count as i64)?,
        };
        let message = PublishMessage::build()
            .payload(payload.into())
            .headers(label.headers(self.end.sequence));
        let what = format!("commits {} to {}", label.first, label.last);
        let send = async {
            let sent = self
                .link
                .jetstream
                .send_publish(self.subject.clone(), message)
                .await;
            Ok::<_, SessionError>(match sent {
                Ok(sent) => sent.await,
                Err(error) => Err(error),
            })
        };
        match self.link.unless_lost(send).await? {
            Ok(ack) if ack.stream == STREAM => {
                self.end = End {
                    sequence: ack.sequence,
                    through: label.last,
                };
            }
            Ok(ack) => {
                let wrong = format!("the stream {} took it instead of {STREAM}", ack.stream);
                return Err(LinkError::Failed(wrong).into());
            }
            // The last acknowledgement was lost, the stream was set back, or another store sends: its end tells which.
            Err(error) if error.kind() == PublishErrorKind::WrongLastSequence => {
                let before = self.end;
                self.find_end(reader, true).await?;
                if self.end == before {
                    // A copy of the stream that is not up to date yet.
                    return Err(self.link.failed(&what, &error).into());
                }
            }
            Err(error) => return Err(self.link.failed(&what, &error).into()),
        }
        Ok(Some(self.end.through))
    }

    /// Goes back to a commit: it and all after it are sent again, behind what is there.
    pub fn go_back(&mut self, to: i64) {
        self.end.through = self.end.through.min(to - 1);
    }

    /// Asks for the centre's open commands, and carries out what is new.
    ///
    /// # Errors
    /// The post does not answer, or the store cannot be read or written.
    pub async fn commands(
        &self,
        obedience: &mut Obedience,
        reader: &Reader,
        health: &Health,
    ) -> Result<(), SessionError> {
        let subject = format!("{}.{}", command::SUBJECT, self.settings.site);
        let last = self.last_of(command::STREAM, &subject, COMMANDS).await?;
        if let Some(last) = last.filter(|last| obedience.is_new(last.sequence)) {
            let message = (last.sequence, &last.payload[..]);
            obedience.take(message, &self.epoch, reader, health)?;
        }
        Ok(())
    }

    /// Says that the site lives, and how it stands.
    ///
    /// # Errors
    /// The post does not take it, or the store cannot be read.
    pub async fn beat(
        &self,
        reader: &Reader,
        health: &Health,
        refused: Option<&BTreeMap<String, u64>>,
    ) -> Result<(), SessionError> {
        let mut beat = Heartbeat::of(reader, &self.epoch, health)?;
        beat.refused = refused.cloned().unwrap_or_default();
        Ok(beat.send(&self.link, &self.settings.site).await?)
    }

    /// As many of the commits as fit into a message, and its content; `None` without commits.
    fn fit(&self, changes: &[Change]) -> Result<Option<(usize, Vec<u8>)>, SessionError> {
        let mut count = changes.len();
        while let Some(change) = changes.first() {
            let allowed = if count == 1 {
                self.allowed
            } else {
                self.allowed.min(LARGEST)
            };
            let bytes = match message::encode(&changes[..count]) {
                Ok(payload) if payload.len() <= allowed => return Ok(Some((count, payload))),
                Ok(payload) => payload.len(),
                Err(MessageError::Large(bytes)) if count > 1 => bytes,
                Err(error) => return Err(error.into()),
            };
            if count == 1 {
                let number = change.number;
                return Err(SessionError::TooLarge {
                    number,
                    bytes,
                    allowed,
                });
            }
            count = count.div_ceil(2);
        }
        Ok(None)
    }
}
