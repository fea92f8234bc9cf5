//! The stream of a client: its channels, its messages, and the batch they are gathered in.

use super::protocol::Refusal;
use super::queue::Queue;
use super::reply::LeftOut;
use super::server::TopicSet;
use crate::recording::note;
use crate::recording::read::mcap::{Damage, Item, Progress, Reader};
use crate::service::journal::{Batch, Definition, Entry, MAX_MESSAGE};
use std::collections::{BTreeSet, HashMap, VecDeque};
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

/// Largest number of topics of no rod that are kept per connection.
const MOST_STRAYS: usize = 16;

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
    /// Number of messages of no rod's topic since the last call.
    pub foreign: u64,
    /// First topics of messages that belong to no rod.
    pub strays: BTreeSet<String>,
    /// Topics that are always among them when their messages are not kept.
    pub named: Arc<TopicSet>,
    /// Number of messages of this connection that were kept, and of those too large.
    kept: u64,
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
                self.foreign += 1;
                stray(&mut self.strays, &topic, &self.named);
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
                self.foreign += 1;
                if let Some(channel) = other {
                    stray(&mut self.strays, &channel.topic, &self.named);
                }
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
        self.kept += 1;
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

    /// Messages of this connection that were not kept. Those of other topics are listed only if there are no others:
    /// then the topic is mistyped on one side.
    pub fn left_out(&self) -> Vec<LeftOut> {
        let mut left_out = Vec::new();
        if self.too_large > 0 {
            left_out.push(too_large(self.too_large));
        }
        if self.kept == 0 && self.too_large == 0 && self.messages > 0 {
            left_out.push(LeftOut {
                messages: self.messages,
                reason: "no rod reads their topics".to_owned(),
            });
        }
        left_out
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

/// Keeps a topic whose messages are not kept, up to the limit or if it is to be named anyway.
fn stray(strays: &mut BTreeSet<String>, topic: &str, named: &TopicSet) {
    let has_room = strays.len() < MOST_STRAYS || named.contains(topic);
    if has_room && topic != note::TOPIC && !strays.contains(topic) {
        strays.insert(topic.to_owned());
    }
}

fn too_large(messages: u64) -> LeftOut {
    LeftOut {
        messages,
        reason: format!("larger than {MAX_MESSAGE} bytes: send their samples in several messages"),
    }
}
