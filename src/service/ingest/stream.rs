//! The stream of a client: its channels, its messages, and the batch they are gathered in.

use super::foreign::Foreign;
use super::protocol::Refusal;
use super::queue::Queue;
use super::reply::LeftOut;
use super::server::TopicSet;
use crate::recording::note;
use crate::recording::read::mcap::{Damage, Item, Progress, Reader};
use crate::service::journal::{Batch, Definition, Entry, MAX_MESSAGE};
use std::collections::{HashMap, VecDeque};
use std::mem;
use std::sync::Arc;

/// Size of a full batch \[bytes\]; the journal keeps a batch whole.
const BATCH_BYTES: usize = 256 << 10;

/// Bytes that an entry counts beyond its data.
const ENTRY_BYTES: usize = 64;

/// Largest schema kept \[bytes\]; a longer one cannot be read anyway, and is cut so that it is refused as too
/// long.
const MAX_SCHEMA: usize = (1 << 20) + 1;

/// Most channels of one stream on topics that rods read.
const MAX_CHANNELS: usize = 1024;

/// State of a stream.
#[derive(Default)]
pub(super) struct Stream {
    /// True if its sender gave its name.
    pub is_named: bool,
    /// Number of messages so far, those before this connection and those of no rod's topic included.
    pub messages: u64,
    channels: HashMap<u16, Channel>,
    /// Schemas by their ids.
    schemas: HashMap<u16, Definition>,
    /// Number of channels in the journal.
    told: usize,
    /// Ids given to the topics of JSON lines.
    ids: HashMap<String, u16>,
    /// Full batches.
    full: VecDeque<Batch>,
    entries: Vec<Entry>,
    /// Bytes of the entries.
    weight: usize,
    /// Number of messages not yet in a batch.
    due: u64,
    /// Messages of topics that no rod reads.
    pub foreign: Foreign,
    /// Topics that rods read, those that this client may not send included.
    pub read: Arc<TopicSet>,
    /// Number of messages of this connection that were too large.
    too_large: u64,
    /// Messages left out for the first time, until reported.
    news: Option<LeftOut>,
    /// Reason why no more of the stream is taken.
    refusal: Option<Refusal>,
}

/// A channel as the client declared it.
struct Channel {
    topic: String,
    encoding: String,
    schema: Option<Definition>,
    is_wanted: bool,
    /// True if it is in the journal.
    is_told: bool,
}

impl Stream {
    /// Changes the topics from here on.
    pub fn retarget(&mut self, topics: &TopicSet) {
        for channel in self.channels.values_mut() {
            channel.is_wanted = is_wanted(&channel.topic, topics);
        }
    }

    /// Takes the items of a reader's next record.
    pub fn record(&mut self, reader: &mut Reader<Queue>, topics: &TopicSet) -> Result<Progress, Refusal> {
        let outcome = reader.step(&mut |item| match item {
            Item::Channel(id, channel, schema) => {
                let is_wanted = is_wanted(&channel.topic, topics);
                let channel = Channel {
                    topic: channel.topic.clone(),
                    encoding: channel.encoding.clone(),
                    schema: schema.map(|schema| {
                        let known = self.schemas.entry(channel.schema);
                        Arc::clone(known.or_insert_with(|| {
                            let mut owned = schema.owned();
                            owned.2.truncate(MAX_SCHEMA);
                            Arc::new(owned)
                        }))
                    }),
                    is_wanted,
                    is_told: false,
                };
                self.channels.insert(id, channel);
            }
            Item::Message(message) => {
                self.message(
                    message.channel,
                    message.log_time,
                    message.publish_time,
                    message.data,
                );
            }
            // Data from a socket have the journal's checksums from here on.
            Item::Unverified | Item::Hole(_) => {}
        });
        match self.refusal.take() {
            Some(refusal) => Err(refusal),
            None => outcome.map_err(|Damage { offset, what }| {
                Refusal(format!("at byte {offset} of the MCAP stream: {what}"))
            }),
        }
    }

    /// Takes a JSON line as a message of its topic.
    pub fn line(&mut self, topic: String, time: u64, line: &[u8], topics: &TopicSet) -> Result<(), Refusal> {
        let known = self.ids.get(&topic).copied();
        let id = match known {
            Some(id) => id,
            // Not remembered: a client may name topics without end.
            None if !is_wanted(&topic, topics) => {
                self.count();
                self.foreign.came(Some(&topic), &self.read);
                return Ok(());
            }
            None => {
                let id = u16::try_from(self.ids.len()).map_err(|_| Refusal("too many topics".to_owned()))?;
                let channel = Channel {
                    topic: topic.clone(),
                    encoding: "json".to_owned(),
                    schema: None,
                    is_wanted: true,
                    is_told: false,
                };
                self.channels.insert(id, channel);
                self.ids.insert(topic, id);
                id
            }
        };
        self.message(id, time, time, line);
        self.refusal.take().map_or(Ok(()), Err)
    }

    fn message(&mut self, id: u16, log_time: u64, publish_time: u64, data: &[u8]) {
        self.count();
        let channel = match self.channels.get_mut(&id) {
            Some(channel) if channel.is_wanted => channel,
            other => {
                let topic = other.map(|channel| channel.topic.as_str());
                self.foreign.came(topic, &self.read);
                return;
            }
        };
        if data.len() > MAX_MESSAGE {
            self.too_large += 1;
            if self.too_large == 1 {
                self.news = Some(too_large(1));
            }
            return;
        }
        if !mem::replace(&mut channel.is_told, true) {
            self.told += 1;
            if self.told > MAX_CHANNELS {
                let what = format!("more than {MAX_CHANNELS} channels on topics of rods");
                self.refusal = Some(Refusal(what));
                return;
            }
            self.entries.push(Entry::Channel {
                id,
                topic: channel.topic.clone(),
                encoding: channel.encoding.clone(),
                schema: channel.schema.clone(),
            });
        }
        self.weight += ENTRY_BYTES + data.len();
        self.entries.push(Entry::Message {
            channel: id,
            log_time,
            publish_time,
            data: data.to_vec(),
        });
        if self.weight >= BATCH_BYTES {
            let full = self.close_batch();
            self.full.extend(full);
        }
    }

    fn count(&mut self) {
        self.messages += 1;
        self.due += 1;
    }

    /// Messages left out for the first time since the last call.
    pub fn take_news(&mut self) -> Option<LeftOut> {
        self.news.take()
    }

    /// Messages of this connection that were not kept.
    pub fn left_out(&self) -> Vec<LeftOut> {
        let too_large = (self.too_large > 0).then(|| too_large(self.too_large));
        let foreign = self.foreign.left_out(&self.read);
        too_large.into_iter().chain(foreign).collect()
    }

    /// The next full batch.
    pub fn full_batch(&mut self) -> Option<Batch> {
        self.full.pop_front()
    }

    /// Batch of the entries gathered so far, if any.
    pub fn batch(&mut self) -> Option<Batch> {
        self.full_batch().or_else(|| self.close_batch())
    }

    /// Closes the batch; a named stream counts messages of no rod's topic too.
    fn close_batch(&mut self) -> Option<Batch> {
        let is_due = self.due > 0 && (self.is_named || !self.entries.is_empty());
        if !is_due {
            return None;
        }
        self.due = 0;
        self.weight = 0;
        Some(Batch {
            entries: mem::take(&mut self.entries),
            through: self.messages,
        })
    }
}

/// True if messages of a topic are kept; the journal's own notes come from no client.
fn is_wanted(topic: &str, topics: &TopicSet) -> bool {
    topics.contains(topic) && topic != note::TOPIC
}

fn too_large(messages: u64) -> LeftOut {
    LeftOut {
        messages,
        reason: format!("larger than {MAX_MESSAGE} bytes: send their samples in several messages"),
    }
}
