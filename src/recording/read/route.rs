//! Routes messages of a file's channels to the rods: decodes them and passes the samples to the assemblers.

mod ahead;
mod counted;
mod events;
mod holes;
mod join;
mod memory;
mod message;
mod ready;
mod rod;
mod streams;
mod timed;

pub(super) use memory::held;
pub(super) use ready::Ready;
pub(super) use rod::{Files, Rod};
pub(super) use timed::Timed;

use super::decode::{DecodeError, SchemaRef};
use super::mcap::{ChannelInfo, Item, Message};
use super::plans::{Plans, Route};
use super::recording::Block;
use super::speakers::Speakers;
use super::summary::TopicSummary;
use super::tail::{Tail, Tails};
use crate::note;
use ahead::Ahead;
use memory::WEIGHED_EVERY;
use rod::Count;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use tirante_analysis::signal::record::{
    Assembler, Cut, Moments, RecordSettings, Rejection, RodChannels, RodId, Timestamp, Unit,
};

/// Most bytes of all rods' samples that are not yet in a record, if nothing else is said; beyond, the longest
/// stretch becomes a record.
pub const HELD: usize = 96 << 20;
/// Most bytes of samples in events of a source that wait to be taken before its next message, or another source, is read.
pub const MOST_READY: usize = 8 << 20;
/// Capacity of the sample buffer kept between two messages \[samples\].
const SCRATCH: usize = 1 << 17;

/// Receives the samples of a rod as they are read, in SI units: the time of the first, and the rate \[Hz\] if one was given.
pub type Listener = Arc<dyn Fn(&RodId, Timestamp, &[f64], Option<f64>) + Send + Sync>;

/// State between messages and events of one file, or of all parts of one journal.
pub(super) struct Router {
    pub(super) rods: Vec<Rod>,
    /// Channels by id.
    channels: Vec<Listed>,
    scratch: Vec<f64>,
    topics: Vec<Topic>,
    topic_numbers: HashMap<String, usize>,
    plans: Plans,
    pub(super) unverified: bool,
    /// Streams of a journal that channels belong to.
    streams: Vec<String>,
    stream_numbers: HashMap<String, usize>,
    /// Identity of the journal that is read.
    pub(super) journal: Option<String>,
    /// Name of the file, where several are read as one.
    pub(super) file: Option<Arc<str>>,
    /// Events not yet taken: beyond [`MOST_READY`] the next message waits until they are.
    ready: Ready,
    /// Contents of the file per rod.
    counts: Vec<Count>,
    /// True if a record ends with its file.
    pub(super) ends_with_file: bool,
    /// True if a fault of the message that is read in pieces is counted.
    is_faulty: bool,
    ahead: Ahead,
    /// Log time of the latest message that a rod took \[ns\].
    at: Option<u64>,
    /// Bytes of samples beyond which the longest stretch becomes a record.
    most: usize,
    /// Largest growth of the rods' samples since the last memory check \[bytes\].
    pub(super) grown: usize,
    /// Number of records of each rod that ended because all rods together held too much.
    cuts: BTreeMap<usize, u64>,
    /// Number of moments of each rod that closed early for the same reason.
    released: BTreeMap<usize, u64>,
    /// Data lost in the file, one clause each.
    holes: Vec<String>,
    /// Receiver of the samples, beside the assemblers.
    pub(super) listener: Option<Listener>,
    /// Open samples of the files read before, with which the rods go on; `None` if the file is read on its own.
    tails: Option<Tails>,
    /// Those with which they did.
    taken: Vec<Tail>,
    /// True if temperatures alone go on with them, too: of a file that is whole. One that grows, or was cut short, may have its
    /// samples elsewhere.
    takes_warmth: bool,
    /// Samples that other files of a stream had open at a rod's first message, if they are noted.
    before: Option<Vec<Tail>>,
}

/// A topic of the file.
struct Topic {
    name: String,
    summary: TopicSummary,
    speakers: Speakers,
}

#[derive(Default)]
struct Listed {
    /// Index into the topics.
    topic: usize,
    known: bool,
    routes: Option<Arc<[Route]>>,
    /// Index of its stream, in a journal.
    stream: Option<usize>,
    /// True if it holds the notes of a journal.
    notes: bool,
    /// True if it had a message.
    is_begun: bool,
}

impl Router {
    pub fn new(rods: &[RodChannels], settings: &RecordSettings) -> Self {
        // A declared cut takes a file for a measurement.
        let ends_with_file = matches!(settings.cut, Cut::File | Cut::FreeDecay { .. });
        let rods = rods.iter().flat_map(|rod| {
            let beside = rod.beside.as_ref();
            let moments =
                beside.map(|beside| Moments::new(rod.rod.clone(), 1 + beside.channels.len(), beside.wait_s));
            let mut moments = moments.into_iter();
            rod.lanes().enumerate().map(move |(sensor, config)| {
                let temperature = config.temperature.is_some();
                let fs_hz = config.displacement.fs_hz;
                Rod {
                    assembler: Assembler::new(config.rod.clone(), *settings, fs_hz, temperature),
                    config,
                    sensor,
                    moments: moments.next(),
                    fed_by: [None; 2],
                    is_followed: false,
                    files: Files::default(),
                    to: 0,
                    is_begun: false,
                    is_warmed: false,
                    is_together: false,
                    is_continued: false,
                }
            })
        });
        Self {
            ends_with_file,
            ..Self::of(rods.collect())
        }
    }

    /// A router for rods that may hold samples already.
    pub fn of(rods: Vec<Rod>) -> Self {
        Self {
            counts: vec![Count::default(); rods.len()],
            rods,
            ends_with_file: false,
            is_faulty: false,
            ahead: Ahead::default(),
            at: None,
            most: HELD,
            grown: 0,
            cuts: BTreeMap::new(),
            released: BTreeMap::new(),
            holes: Vec::new(),
            listener: None,
            tails: None,
            taken: Vec::new(),
            takes_warmth: false,
            before: None,
            channels: Vec::new(),
            scratch: Vec::new(),
            topics: Vec::new(),
            topic_numbers: HashMap::new(),
            plans: Plans::default(),
            unverified: false,
            streams: Vec::new(),
            stream_numbers: HashMap::new(),
            journal: None,
            file: None,
            ready: Ready::default(),
        }
    }

    /// Takes an item of the reader.
    pub fn item(&mut self, item: Item<'_>) {
        match item {
            Item::Message(message) => self.in_turn(message),
            Item::Channel(id, channel, schema) => self.channel(id, channel, schema),
            Item::Unverified => self.unverified = true,
            Item::Hole(hole) => self.hole(hole),
        }
    }

    fn channel(&mut self, id: u16, channel: &ChannelInfo, schema: Option<SchemaRef<'_>>) {
        let id = usize::from(id);
        if self.channels.len() <= id {
            self.channels.resize_with(id + 1, Listed::default);
        }
        if channel.topic == note::TOPIC {
            self.channels[id] = Listed {
                notes: true,
                ..Listed::default()
            };
            return;
        }
        let topic = self.topic(&channel.topic, &channel.encoding);
        if let Some(said) = channel.metadata("unit").and_then(Unit::as_written) {
            let channels = self.rods.iter().flat_map(|rod| rod.config.all());
            let mut units = channels
                .filter(|own| own.topic == channel.topic)
                .map(|own| own.unit);
            self.topics[topic].summary.other_unit = units
                .find(|unit| *unit != said)
                .map(|unit| [said.key(), unit.key()]);
        }
        let rods = self.rods.iter().map(|rod| &rod.config);
        let routes = self.plans.routes(rods, channel, schema);
        let stream = channel.metadata(note::STREAM).map(|name| self.stream(name));
        self.channels[id] = Listed {
            topic,
            known: true,
            routes,
            stream,
            notes: false,
            is_begun: false,
        };
    }

    /// Index of a topic.
    fn topic(&mut self, name: &str, encoding: &str) -> usize {
        self.topic_numbers.get(name).copied().unwrap_or_else(|| {
            self.topic_numbers.insert(name.to_owned(), self.topics.len());
            self.topics.push(Topic {
                name: name.to_owned(),
                summary: TopicSummary {
                    encoding: encoding.to_owned(),
                    ..Default::default()
                },
                speakers: Speakers::default(),
            });
            self.topics.len() - 1
        })
    }

    /// Log time of the latest message that a rod took \[ns\]: one wrong clock moves it for one message only.
    pub fn at(&self) -> Option<u64> {
        self.at
    }

    /// Takes the samples of a message from number `from` on; true if more follow.
    #[inline]
    fn message(&mut self, message: Message<'_>, from: usize) -> bool {
        if self.tails.is_some() {
            self.go_on_with_tails(message.channel, message.log_time);
        }
        let Self {
            rods,
            counts,
            unverified,
            channels,
            scratch,
            topics,
            grown,
            file,
            listener,
            at,
            is_faulty,
            ..
        } = self;
        let Some(listed) = channels.get(usize::from(message.channel)) else {
            return false;
        };
        if listed.notes {
            self.note(message.data);
            return false;
        }
        if !listed.known {
            return false;
        }
        let Some(Topic {
            name,
            summary,
            speakers,
        }) = topics.get_mut(listed.topic)
        else {
            return false;
        };
        summary.messages += u64::from(from == 0);
        let mut has_more = false;
        let mut fault = None;
        let mut has_events = false;
        let routes = listed.routes.as_deref().unwrap_or_default();
        if !routes.is_empty() && !speakers.may_speak(message.channel, listed.stream, message.log_time) {
            for route in routes.iter().filter(|route| !route.temperature) {
                if let Some(rod) = rods.get_mut(route.rod)
                    && speakers.is_news()
                {
                    rod.assembler.refuse(Rejection::SharedTopic {
                        topic: name.clone(),
                        channels: speakers.names().to_owned(),
                    });
                    has_events = true;
                }
            }
            fault = Some(DecodeError::SharedTopic {
                channels: speakers.names().to_owned(),
            });
        } else {
            for route in routes {
                *at = Some(message.log_time);
                let Some(rod) = rods.get_mut(route.rod) else {
                    continue;
                };
                let Some(count) = counts.get_mut(route.rod) else {
                    continue;
                };
                rod.fed_by[usize::from(route.temperature)] = listed.stream;
                rod.is_followed |= !route.temperature;
                if !route.temperature {
                    rod.to = rod.to.max(message.log_time);
                }
                rod.assembler.set_unverified(*unverified);
                match route.take((rod, count), (&message, from), file.as_ref(), scratch) {
                    Ok((time, more)) => {
                        has_more |= more;
                        if let Some(time) = time
                            && let Some(listener) = listener.as_ref().filter(|_| rod.sensor == 0)
                        {
                            listener(&rod.config.rod, time, scratch, rod.config.displacement.fs_hz);
                        }
                    }
                    Err(found) => {
                        fault.get_or_insert(found);
                    }
                }
                // A stamp takes as much as two samples, and a single one is the least that is kept.
                *grown += 24 + 8 * scratch.len();
                has_events |= rod.assembler.has_events();
                let first = route.rod - rod.sensor;
                let moments = rods.get(first).and_then(|first| first.moments.as_ref());
                has_events |= moments.is_some_and(Moments::is_waiting);
            }
        }
        if scratch.capacity() > SCRATCH {
            scratch.clear();
            scratch.shrink_to(SCRATCH);
        }
        *is_faulty &= from > 0;
        if let Some(fault) = fault {
            summary.undecodable += u64::from(!std::mem::replace(is_faulty, true));
            summary.fault.get_or_insert_with(|| fault.to_string());
        }
        // At once, not at the end of a chunk: the progress of the other rods at that moment must not depend on the chunks of a file.
        if has_events {
            self.collect(false);
        }
        if self.grown > WEIGHED_EVERY {
            self.weigh();
        }
        has_more
    }

    /// Takes samples that need no decoding.
    pub fn block(&mut self, block: Block) {
        let topic = self.topic(&block.topic, "");
        if let Some(topic) = self.topics.get_mut(topic) {
            topic.summary.messages += 1;
        }
        let Self {
            rods,
            counts,
            scratch,
            file,
            ..
        } = self;
        for (rod, count) in rods.iter_mut().zip(counts) {
            let channel = &rod.config.displacement;
            if *channel.topic == *block.topic {
                count.messages += 1;
                count.samples += block.samples.len() as u64;
                rod.is_followed = true;
                scratch.clear();
                scratch.extend(block.samples.iter().map(|raw| channel.unit.convert(*raw)));
                self.grown += 24 + 8 * scratch.len();
                rod.files.note(file.as_ref(), block.time);
                rod.assembler.push(block.time, scratch);
            }
            if let Some(channel) = &rod.config.temperature
                && *channel.topic == *block.topic
            {
                for (index, raw) in block.samples.iter().enumerate() {
                    let time = block.time.plus_seconds(index as f64 / block.fs_hz);
                    rod.assembler.push_temperature(time, channel.unit.convert(*raw));
                }
            }
        }
        self.collect(false);
        if self.grown > WEIGHED_EVERY {
            self.weigh();
        }
    }

    /// Number of messages of a rod so far, to be restored after a restart.
    pub(super) fn messages_of(&self, at: usize) -> u64 {
        self.counts.get(at).map_or(0, |count| count.messages)
    }

    /// Restores samples from before a restart.
    pub(super) fn restore(&mut self, at: usize, assembler: Assembler, messages: u64) {
        let samples = assembler.samples();
        if let (Some(rod), Some(count)) = (self.rods.get_mut(at), self.counts.get_mut(at)) {
            rod.is_followed = samples > 0;
            rod.assembler = assembler;
            *count = Count { messages, samples };
        }
    }
}
