//! From a file's channels to the rods: which messages mean what, decoded and handed to the assemblers.

use super::Place;
use super::decode::{DecodeError, Decoded, SchemaRef, Time};
use super::hole::Hole;
use super::mcap::{ChannelInfo, Item, Message};
use super::plans::{Plans, Route};
use super::recording::Block;
use super::speakers::Speakers;
use super::summary::{Summary, TopicSummary};
use crate::analysis::signal::record::{
    Assembler, Channel, Cut, Event, RecordSettings, Rejection, RodChannels, TimeSource, Timestamp,
};
use crate::analysis::track::ordered::Reached;
use crate::recording::note::{self, Note, State};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::sync::Arc;

/// Bytes all rods' samples that are no record yet may take together; beyond, the longest stretch becomes a record.
const HELD: usize = 96 << 20;
/// The rods are weighed again when their samples may have grown by so much \[bytes\].
const WEIGHED_EVERY: usize = 1 << 20;
/// Samples of a message the buffer between two messages keeps room for.
const SCRATCH: usize = 1 << 17;

/// An event of a rod, and when it came.
#[derive(Debug)]
pub(super) struct Timed {
    pub event: Event,
    /// When it was complete, by the rod's own stamps.
    pub at: Timestamp,
    /// Times up to which the rods had been followed then.
    pub reached: Reached,
}

impl Timed {
    /// One, or zero for temperatures alone.
    pub fn records(&self) -> u64 {
        u64::from(!matches!(self.event, Event::Readings { .. }))
    }

    /// The event with the place at which it was complete.
    pub fn at_place(self, file: Arc<str>, bytes: u64, records: u64) -> (Event, Place) {
        let Self { event, at, reached } = self;
        let place = Place {
            file,
            bytes,
            records,
            at,
            reached,
        };
        (event, place)
    }
}

/// Everything between messages and events for one file, or for all parts of one journal.
pub(super) struct Router {
    pub(super) rods: Vec<Rod>,
    /// By channel id.
    channels: Vec<Listed>,
    scratch: Vec<f64>,
    topics: Vec<Topic>,
    topic_numbers: HashMap<String, usize>,
    plans: Plans,
    pub(super) unverified: bool,
    /// The streams of a journal that channels belong to.
    streams: Vec<String>,
    stream_numbers: HashMap<String, usize>,
    /// The journal that is read.
    pub(super) journal: Option<String>,
    /// Events until they are taken.
    ready: VecDeque<Timed>,
    /// What the file had of each rod.
    counts: Vec<Count>,
    /// True if a record ends with its file.
    ends_with_file: bool,
    ahead: Ahead,
    /// Bytes the rods' samples may have grown by since they were weighed.
    grown: usize,
    /// Records of each rod that ended because all rods together held too much.
    cuts: BTreeMap<usize, u64>,
    /// What the file lost, a clause each.
    holes: Vec<String>,
}

/// Contents of a file for one rod.
#[derive(Debug, Clone, Copy, Default)]
struct Count {
    messages: u64,
    samples: u64,
}

/// Messages behind those of other files, where several are read side by side.
#[derive(Default)]
struct Ahead {
    /// Log time up to which messages are handed on; `None` where all are \[ns\].
    limit: Option<u64>,
    /// The latest log time so far.
    front: Option<u64>,
    /// Those that wait, with the latest log time up to them.
    waiting: VecDeque<(u64, Owned)>,
}

/// A message that waits.
struct Owned {
    channel: u16,
    log_time: u64,
    publish_time: u64,
    data: Vec<u8>,
}

/// A topic of the file.
struct Topic {
    name: String,
    summary: TopicSummary,
    speakers: Speakers,
}

pub(super) struct Rod {
    pub(super) config: RodChannels,
    pub(super) assembler: Assembler,
    /// The stream its last sample came with, and the one its last temperature came with: indices into the streams.
    fed_by: [Option<usize>; 2],
    /// True if it ever had samples.
    pub(super) is_followed: bool,
}

#[derive(Default)]
struct Listed {
    /// Index into the topics.
    topic: usize,
    known: bool,
    routes: Option<Arc<[Route]>>,
    /// The stream it belongs to, in a journal.
    stream: Option<usize>,
    /// Whether it holds the notes of a journal.
    notes: bool,
}

impl Router {
    pub fn new(rods: &[RodChannels], settings: &RecordSettings) -> Self {
        // A declared cut takes a file for a measurement.
        let ends_with_file = matches!(settings.cut, Cut::File | Cut::FreeDecay { .. });
        let rods = rods.iter().map(|config| {
            let temperature = config.temperature.is_some();
            let fs_hz = config.displacement.fs_hz;
            Rod {
                config: config.clone(),
                assembler: Assembler::new(config.rod.clone(), *settings, fs_hz, temperature),
                fed_by: [None; 2],
                is_followed: false,
            }
        });
        Self {
            ends_with_file,
            ..Self::of(rods.collect())
        }
    }

    /// A router that hands samples to rods that may have some already.
    pub fn of(rods: Vec<Rod>) -> Self {
        Self {
            counts: vec![Count::default(); rods.len()],
            rods,
            ends_with_file: false,
            ahead: Ahead::default(),
            grown: 0,
            cuts: BTreeMap::new(),
            holes: Vec::new(),
            channels: Vec::new(),
            scratch: Vec::new(),
            topics: Vec::new(),
            topic_numbers: HashMap::new(),
            plans: Plans::default(),
            unverified: false,
            streams: Vec::new(),
            stream_numbers: HashMap::new(),
            journal: None,
            ready: VecDeque::new(),
        }
    }

    /// Takes what the reader hands out.
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
        let rods = self.rods.iter().map(|rod| &rod.config);
        let routes = self.plans.routes(rods, channel, schema);
        let stream = channel.metadata(note::STREAM).map(|name| self.stream(name));
        self.channels[id] = Listed {
            topic,
            known: true,
            routes,
            stream,
            notes: false,
        };
    }

    /// The number of a topic.
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

    /// Hands a message on if it is its turn.
    #[inline]
    fn in_turn(&mut self, message: Message<'_>) {
        let ahead = &mut self.ahead;
        if let Some(limit) = ahead.limit {
            let front = ahead
                .front
                .map_or(message.log_time, |front| front.max(message.log_time));
            ahead.front = Some(front);
            if front > limit || !ahead.waiting.is_empty() {
                let owned = Owned {
                    channel: message.channel,
                    log_time: message.log_time,
                    publish_time: message.publish_time,
                    data: message.data.to_vec(),
                };
                ahead.waiting.push_back((front, owned));
                return;
            }
        }
        self.message(message);
    }

    /// From now on only messages up to this log time are handed on \[ns\].
    pub fn limit(&mut self, limit: u64) {
        self.ahead.limit = Some(limit);
    }

    /// True if messages wait for their turn.
    pub fn waits(&self) -> bool {
        !self.ahead.waiting.is_empty()
    }

    /// The log time of the message that is next, or of the latest one \[ns\].
    pub fn front(&self) -> Option<u64> {
        let next = self.ahead.waiting.front().map(|(front, _)| *front);
        next.or(self.ahead.front)
    }

    /// Hands on those that wait, up to a log time \[ns\].
    pub fn go_on(&mut self, limit: u64) {
        while let Some((front, owned)) = self.ahead.waiting.pop_front() {
            if front > limit {
                self.ahead.waiting.push_front((front, owned));
                return;
            }
            self.message(Message {
                channel: owned.channel,
                log_time: owned.log_time,
                publish_time: owned.publish_time,
                data: &owned.data,
            });
        }
    }

    #[inline]
    fn message(&mut self, message: Message<'_>) {
        let Self {
            rods,
            counts,
            unverified,
            channels,
            scratch,
            topics,
            grown,
            ..
        } = self;
        let Some(listed) = channels.get(usize::from(message.channel)) else {
            return;
        };
        if listed.notes {
            return self.note(message.data);
        }
        if !listed.known {
            return;
        }
        let Some(Topic {
            name,
            summary,
            speakers,
        }) = topics.get_mut(listed.topic)
        else {
            return;
        };
        summary.messages += 1;
        let mut fault = None;
        let mut has_events = false;
        let routes = listed.routes.as_deref().unwrap_or_default();
        if !routes.is_empty() && !speakers.may_speak(message.channel, listed.stream, message.log_time) {
            let channels = speakers.names();
            for route in routes.iter().filter(|route| !route.temperature) {
                if let Some(rod) = rods.get_mut(route.rod)
                    && speakers.is_news()
                {
                    rod.assembler.refuse(Rejection::SharedTopic {
                        topic: name.clone(),
                        channels: channels.clone(),
                    });
                    has_events = true;
                }
            }
            fault = Some(DecodeError::SharedTopic { channels });
        } else {
            for route in routes {
                let Some(rod) = rods.get_mut(route.rod) else {
                    continue;
                };
                let Some(count) = counts.get_mut(route.rod) else {
                    continue;
                };
                rod.fed_by[usize::from(route.temperature)] = listed.stream;
                rod.is_followed |= !route.temperature;
                rod.assembler.set_unverified(*unverified);
                if let Err(found) = route.take(rod, count, &message, scratch) {
                    fault.get_or_insert(found);
                }
                // A stamp takes as much as two samples, and a single one is the least that is kept.
                *grown += 24 + 8 * scratch.len();
                has_events |= rod.assembler.has_events();
            }
        }
        if scratch.capacity() > SCRATCH {
            scratch.clear();
            scratch.shrink_to(SCRATCH);
        }
        if let Some(fault) = fault {
            summary.undecodable += 1;
            summary.fault.get_or_insert_with(|| fault.to_string());
        }
        // At once, not where a chunk ends: what others had come to then must not depend on how a file is packed.
        if has_events {
            self.collect();
        }
        if self.grown > WEIGHED_EVERY {
            self.weigh();
        }
    }

    /// Bytes of samples that are no record yet, of all rods.
    pub fn held(&self) -> usize {
        self.rods.iter().map(|rod| rod.assembler.held()).sum()
    }

    /// Ends the longest stretches while all rods together hold too much.
    fn weigh(&mut self) {
        self.grown = 0;
        let mut held = self.held();
        while held > HELD {
            let rods = self.rods.iter().map(|rod| rod.assembler.held());
            // Of equal ones the first.
            let Some((_, Reverse(at))) = rods.enumerate().map(|(at, held)| (held, Reverse(at))).max() else {
                return;
            };
            let Some(rod) = self.rods.get_mut(at) else { return };
            let before = rod.assembler.held();
            rod.assembler.cut_off();
            *self.cuts.entry(at).or_insert(0) += 1;
            self.collect();
            let now = self.rods.get(at).map_or(0, |rod| rod.assembler.held());
            held = held.saturating_sub(before - now.min(before));
            if now >= before {
                return;
            }
        }
    }

    /// Tells what the file lost, and refuses it to each rod that may have had messages in it.
    fn hole(&mut self, hole: &Hole) {
        let is_lost = |id: usize| {
            hole.channels.is_empty() || u16::try_from(id).is_ok_and(|id| hole.channels.contains(&id))
        };
        let (mut topics, mut rods) = (BTreeSet::new(), BTreeSet::new());
        let channels = self.channels.iter().enumerate();
        for (_, listed) in channels.filter(|(id, listed)| listed.known && is_lost(*id)) {
            topics.insert(listed.topic);
            let routes = listed.routes.as_deref().unwrap_or_default();
            rods.extend(
                routes
                    .iter()
                    .filter(|route| !route.temperature)
                    .map(|route| route.rod),
            );
        }
        // A hole before the channels of the file are known may be anybody's.
        if topics.is_empty() {
            rods.extend(0..self.rods.len());
        }
        let names: Vec<&str> = topics
            .iter()
            .filter_map(|topic| Some(self.topics.get(*topic)?.name.as_str()))
            .collect();
        let detail = hole.sentence(names.into_iter());
        for at in rods {
            if let Some(rod) = self.rods.get_mut(at) {
                let rejection = Rejection::Damaged {
                    detail: detail.clone(),
                };
                rod.assembler
                    .tell_lost(hole.start(), hole.duration_s(), rejection);
            }
        }
        self.holes.push(detail);
        self.collect();
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
        self.collect();
        if self.grown > WEIGHED_EVERY {
            self.weigh();
        }
    }

    /// Messages of all topics.
    pub fn messages(&self) -> u64 {
        self.topics.iter().map(|topic| topic.summary.messages).sum()
    }

    /// What a journal says of itself: another journal ends everything, a stream that ended ends its rods' records.
    fn note(&mut self, data: &[u8]) {
        // Notes of a newer version, or none at all: the data speak for themselves.
        let Ok(note) = serde_json::from_slice::<Note>(data) else {
            return;
        };
        if let Some(begins) = note.begins {
            let before = self.journal.replace(begins.journal);
            if before.is_some() && before != self.journal {
                for at in 0..self.rods.len() {
                    self.end_rod(at, true);
                }
            }
        }
        for (stream, standing) in &note.streams {
            match standing.state {
                State::Open => {}
                State::Complete => self.end_of(stream, false),
                State::Broken => self.end_of(stream, true),
            }
        }
    }

    /// A stream ended: so do the records of the rods that were last fed by it.
    fn end_of(&mut self, stream: &str, cut_short: bool) {
        let Some(stream) = self.stream_numbers.get(stream).copied() else {
            return;
        };
        for at in 0..self.rods.len() {
            if self.rods[at].fed_by[0] == Some(stream) {
                self.end_rod(at, cut_short);
            }
        }
        for topic in &mut self.topics {
            topic.speakers.end_of(stream);
        }
    }

    /// Ends a rod's records as the end of a file does, and begins anew. Its temperatures go on if they come from elsewhere.
    fn end_rod(&mut self, at: usize, cut_short: bool) {
        let Some(rod) = self.rods.get_mut(at) else { return };
        let count = std::mem::take(&mut self.counts[at]);
        rod.finish(count, cut_short, None);
        self.collect();
        let Some(rod) = self.rods.get_mut(at) else { return };
        let [samples, temperature] = rod.fed_by;
        let is_from_elsewhere = temperature.is_some() && temperature != samples;
        rod.assembler.renew(is_from_elsewhere);
        rod.fed_by = [None, temperature.filter(|_| is_from_elsewhere)];
    }

    /// The number of a stream.
    pub(super) fn stream(&mut self, name: &str) -> usize {
        self.stream_numbers.get(name).copied().unwrap_or_else(|| {
            self.stream_numbers.insert(name.to_owned(), self.streams.len());
            self.streams.push(name.to_owned());
            self.streams.len() - 1
        })
    }

    /// The names of the streams that last fed a rod.
    pub(super) fn fed_by(&self, rod: &Rod) -> [Option<String>; 2] {
        rod.fed_by
            .map(|stream| stream.and_then(|stream| self.streams.get(stream).cloned()))
    }

    /// Notes which streams last fed a rod.
    pub(super) fn set_fed_by(&mut self, at: usize, names: [Option<String>; 2]) {
        let streams = names.map(|name| name.map(|name| self.stream(&name)));
        if let Some(rod) = self.rods.get_mut(at) {
            rod.fed_by = streams;
        }
    }

    /// Messages of a rod so far, for what goes on after a restart.
    pub(super) fn messages_of(&self, at: usize) -> u64 {
        self.counts.get(at).map_or(0, |count| count.messages)
    }

    /// Goes on with samples that were there before a restart.
    pub(super) fn restore(&mut self, at: usize, assembler: Assembler, messages: u64) {
        let samples = assembler.samples();
        if let (Some(rod), Some(count)) = (self.rods.get_mut(at), self.counts.get_mut(at)) {
            rod.is_followed = samples > 0;
            rod.assembler = assembler;
            *count = Count { messages, samples };
        }
    }

    /// Another file of the same journal follows: channels are numbered anew, samples go on.
    pub fn next_part(&mut self) {
        let fed_by: Vec<_> = self.rods.iter().map(|rod| self.fed_by(rod)).collect();
        self.channels.clear();
        self.topics.clear();
        self.topic_numbers.clear();
        self.plans = Plans::default();
        self.streams.clear();
        self.stream_numbers.clear();
        self.holes.clear();
        self.cuts.clear();
        for (at, names) in fed_by.into_iter().enumerate() {
            self.set_fed_by(at, names);
        }
    }

    /// What became of the samples so far.
    pub fn events(&mut self, to: &mut impl Extend<Timed>) {
        to.extend(self.ready.drain(..));
    }

    /// Takes what became of the rods' samples from their assemblers.
    fn collect(&mut self) {
        let reached = self.reached();
        for rod in &mut self.rods {
            let timed = rod.assembler.timed_events().map(|(at, event)| Timed {
                event,
                at,
                reached: Arc::clone(&reached),
            });
            self.ready.extend(timed);
        }
    }

    /// Times up to which the rods have been followed.
    pub fn reached(&self) -> Reached {
        self.rods
            .iter()
            .filter(|rod| rod.is_followed)
            .map(|rod| (rod.config.rod.clone(), rod.assembler.complete_until()))
            .collect()
    }

    /// Ends every stream; `damage` stands for what was not read, one rejection for each rod the file had
    /// messages of.
    pub fn finish(&mut self, cut_short: bool, damage: Option<&str>, to: &mut impl Extend<Timed>) {
        for (rod, count) in self.rods.iter_mut().zip(&self.counts) {
            rod.finish(*count, cut_short, damage);
        }
        self.collect();
        self.events(to);
    }

    /// Ends one of several files that are read side by side. Records go on in the next one if this one ended as it
    /// should.
    pub fn end_file(&mut self, cut_short: bool, damage: Option<&str>) {
        let fed = self.rods.iter_mut().zip(&self.counts);
        for (rod, count) in fed.filter(|(_, count)| count.messages > 0) {
            if cut_short || self.ends_with_file {
                rod.assembler.finish(cut_short);
                rod.assembler.renew(true);
            }
            rod.tell_nothing(*count, damage);
        }
        self.collect();
    }

    /// What comes of samples that are left at the very end.
    pub fn ended(mut self) -> impl Iterator<Item = Timed> {
        let mut last = VecDeque::new();
        self.finish(false, None, &mut last);
        last.into_iter()
    }

    /// Fills in what the messages said.
    pub fn summarise(&self, summary: &mut Summary) {
        summary.unverified = self.unverified;
        let topics = self.topics.iter();
        summary.topics = topics
            .map(|topic| (topic.name.clone(), topic.summary.clone()))
            .collect();
        summary.holes = self.holes.clone();
        for (at, times) in &self.cuts {
            let Some(Rod { config, .. }) = self.rods.get(*at) else {
                continue;
            };
            summary.notes.push(format!(
                "{}: rod {}: {times} records end early: the samples of all rods together took more than {} MiB",
                summary.file,
                config.rod,
                HELD >> 20
            ));
        }
        summary.missing.clear();
        summary.wanted = 0;
        for (Rod { config, .. }, count) in self.rods.iter().zip(&self.counts) {
            summary.samples.insert(config.rod.clone(), count.samples);
            let wanted = [Some(&config.displacement), config.temperature.as_ref()];
            for Channel { topic, .. } in wanted.into_iter().flatten() {
                summary.wanted += 1;
                if !summary.topics.contains_key(topic) {
                    summary.missing.push((config.rod.clone(), topic.clone()));
                }
            }
        }
    }
}

impl Rod {
    /// Ends its stream.
    fn finish(&mut self, count: Count, cut_short: bool, damage: Option<&str>) {
        self.assembler.finish(cut_short);
        self.assembler.tell_leftover();
        self.tell_nothing(count, damage);
    }

    /// Tells of a file that gave nothing, or nothing more.
    fn tell_nothing(&mut self, count: Count, damage: Option<&str>) {
        let rejection = match damage {
            Some(detail) if count.messages > 0 => Rejection::Damaged {
                detail: detail.to_owned(),
            },
            // Messages there were, samples none: one offered record that gave nothing.
            None if count.messages > 0 && count.samples == 0 => Rejection::Missing {
                share: 1.0,
                allowed: 0.0,
            },
            _ => return,
        };
        self.assembler.tell_nothing(rejection);
    }
}

impl Route {
    #[inline]
    fn take(
        &self,
        rod: &mut Rod,
        count: &mut Count,
        message: &Message<'_>,
        scratch: &mut Vec<f64>,
    ) -> Result<(), DecodeError> {
        let channel = match &rod.config.temperature {
            Some(channel) if self.temperature => channel,
            _ => &rod.config.displacement,
        };
        count.messages += u64::from(!self.temperature);
        scratch.clear();
        let decoder = self.decoder.as_ref().map_err(Clone::clone)?;
        let Decoded { array, time } = decoder.decode(message.data, scratch)?;
        let time = match (time, &channel.time) {
            (Time::Nanos(nanos), _) => nanos,
            (Time::Outside, stamped) => {
                let nanos = match stamped {
                    TimeSource::Publish => message.publish_time,
                    TimeSource::Log | TimeSource::Field(_) => message.log_time,
                };
                i64::try_from(nanos).map_err(|_| DecodeError::Stamp { nanos })?
            }
        };
        let time = Timestamp::from_nanos(time);
        let unit = channel.unit;
        if self.temperature {
            for &raw in scratch.iter() {
                rod.assembler.push_temperature(time, unit.convert(raw));
            }
            return Ok(());
        }
        if array && channel.fs_hz.is_none() {
            return Err(DecodeError::Rate {
                path: channel.field.clone(),
            });
        }
        for sample in scratch.iter_mut() {
            *sample = unit.convert(*sample);
        }
        count.samples += scratch.len() as u64;
        rod.assembler.push(time, scratch);
        Ok(())
    }
}
