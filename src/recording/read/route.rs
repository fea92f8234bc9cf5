//! Routes messages of a file's channels to the rods: decodes them and passes the samples to the assemblers.

use super::Place;
use super::decode::{DecodeError, Decoded, SchemaRef, Time};
use super::hole::Hole;
use super::lanes::{self, Found};
use super::mcap::{ChannelInfo, Item, Message};
use super::plans::{Plans, Route};
use super::recording::Block;
use super::speakers::Speakers;
use super::summary::{Summary, TopicSummary};
use crate::analysis::signal::record::{
    Assembler, Channel, Cut, Event, Moments, RecordSettings, Rejection, RodChannels, RodId, TimeSource,
    Timestamp,
};
use crate::analysis::track::ordered::Reached;
use crate::recording::note::{self, Note, State};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::sync::Arc;

/// Most bytes of all rods' samples that are not yet in a record, if nothing else is said; beyond, the longest
/// stretch becomes a record.
pub const HELD: usize = 96 << 20;
/// Growth of the rods' samples after which their memory is checked again \[bytes\].
const WEIGHED_EVERY: usize = 1 << 20;
/// Error of a time that was computed from a length \[s\]: far below the interval of samples.
const ROUNDED_S: f64 = 1e-6;
/// Capacity of the sample buffer kept between two messages \[samples\].
const SCRATCH: usize = 1 << 17;

/// Receives the samples of a rod as they are read, in SI units: the time of the first, and the rate \[Hz\] if one was given.
pub type Listener = Arc<dyn Fn(&RodId, Timestamp, &[f64], Option<f64>) + Send + Sync>;

/// An event of a rod with its completion time.
#[derive(Debug)]
pub(super) struct Timed {
    pub event: Event,
    /// Completion time, by the rod's own stamps.
    pub at: Timestamp,
    /// Times up to which each rod had been read by then.
    pub reached: Reached,
    /// Name of the file that holds its last sample, where several are read as one.
    origin: Option<Arc<str>>,
}

impl Timed {
    /// Number of records in it: one, or zero for temperatures alone.
    pub fn records(&self) -> u64 {
        u64::from(!matches!(self.event, Event::Readings { .. }))
    }

    /// Returns the event with the place at which it was complete.
    pub fn at_place(self, file: Arc<str>, bytes: u64, records: u64) -> (Event, Place) {
        let Self {
            event,
            at,
            reached,
            origin,
        } = self;
        let place = Place {
            origin: origin.unwrap_or_else(|| Arc::clone(&file)),
            file,
            bytes,
            records,
            at,
            reached,
        };
        (event, place)
    }
}

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
    /// Events not yet taken.
    ready: VecDeque<Timed>,
    /// Contents of the file per rod.
    counts: Vec<Count>,
    /// True if a record ends with its file.
    ends_with_file: bool,
    ahead: Ahead,
    /// Log time of the latest message that a rod took \[ns\].
    at: Option<u64>,
    /// Bytes of samples beyond which the longest stretch becomes a record.
    most: usize,
    /// Largest growth of the rods' samples since the last memory check \[bytes\].
    grown: usize,
    /// Number of records of each rod that ended because all rods together held too much.
    cuts: BTreeMap<usize, u64>,
    /// Data lost in the file, one clause each.
    holes: Vec<String>,
    /// Receiver of the samples, beside the assemblers.
    pub(super) listener: Option<Listener>,
}

/// Contents of a file for one rod.
#[derive(Debug, Clone, Copy, Default)]
struct Count {
    messages: u64,
    samples: u64,
}

/// Messages ahead of those of other files, where several are read side by side.
#[derive(Default)]
struct Ahead {
    /// Log time up to which messages are passed on \[ns\]; `None`: all are.
    limit: Option<u64>,
    /// Latest log time so far \[ns\].
    front: Option<u64>,
    /// Waiting messages, with the latest log time up to each.
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

/// A rod with one sensor, or one sensor of a rod with several: these are next to each other.
pub(super) struct Rod {
    /// Channels of the lane.
    pub(super) config: RodChannels,
    /// Number of its sensor, from 0.
    pub(super) sensor: usize,
    /// Moments of the rod's sensors, with the first of several.
    pub(super) moments: Option<Moments>,
    pub(super) assembler: Assembler,
    /// Indices of the streams of its last sample and of its last temperature.
    fed_by: [Option<usize>; 2],
    /// True if it ever had samples.
    pub(super) is_followed: bool,
    pub(super) files: Files,
}

/// Most files of a rod that are remembered: beyond, a record waited for its temperature over as many files.
const FILES: usize = 16;

/// Latest files that gave a rod's samples, the latest first, each with the time of its first sample.
#[derive(Default)]
pub(super) struct Files(VecDeque<(Arc<str>, Timestamp)>);

impl Files {
    /// Notes samples of a file.
    #[inline]
    fn note(&mut self, file: Option<&Arc<str>>, time: Timestamp) {
        if let Some(file) = file
            && !self
                .0
                .front()
                .is_some_and(|(latest, _)| Arc::ptr_eq(latest, file))
        {
            self.0.push_front((Arc::clone(file), time));
            self.0.truncate(FILES);
        }
    }

    /// The file that holds an event's last sample.
    pub(super) fn of(&self, event: &Event) -> Option<Arc<str>> {
        let end = match event {
            Event::Record(record) => {
                let last = record.samples.len().saturating_sub(1) as f64;
                Some(record.start.plus_seconds(last / record.fs_hz))
            }
            Event::Rejected {
                start, duration_s, ..
            } => start.map(|start| start.plus_seconds((duration_s - ROUNDED_S).max(0.0))),
            Event::Readings { .. } | Event::Moment(_) => None,
        };
        let has = |(_, from): &&(Arc<str>, Timestamp)| end.is_none_or(|end| *from <= end);
        let found = self.0.iter().find(has).or(self.0.back());
        found.map(|(file, _)| Arc::clone(file))
    }
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
            ahead: Ahead::default(),
            at: None,
            most: HELD,
            grown: 0,
            cuts: BTreeMap::new(),
            holes: Vec::new(),
            listener: None,
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
            ready: VecDeque::new(),
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

    /// Passes a message on if it is its turn.
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

    /// Sets the log time up to which messages are passed on from now on \[ns\].
    pub fn limit(&mut self, limit: u64) {
        self.ahead.limit = Some(limit);
    }

    /// True if messages wait for their turn.
    pub fn waits(&self) -> bool {
        !self.ahead.waiting.is_empty()
    }

    /// Log time of the next message, or of the latest one \[ns\].
    pub fn front(&self) -> Option<u64> {
        let next = self.ahead.waiting.front().map(|(front, _)| *front);
        next.or(self.ahead.front)
    }

    /// Log time of the latest message that a rod took \[ns\]: one wrong clock moves it for one message only.
    pub fn at(&self) -> Option<u64> {
        self.at
    }

    /// Passes on the waiting messages up to a log time \[ns\].
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
            file,
            listener,
            at,
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
                *at = Some(message.log_time);
                let Some(rod) = rods.get_mut(route.rod) else {
                    continue;
                };
                let Some(count) = counts.get_mut(route.rod) else {
                    continue;
                };
                rod.fed_by[usize::from(route.temperature)] = listed.stream;
                rod.is_followed |= !route.temperature;
                rod.assembler.set_unverified(*unverified);
                match route.take((rod, count), &message, file.as_ref(), scratch) {
                    Ok(Some(time)) => {
                        if let Some(listener) = listener.as_ref().filter(|_| rod.sensor == 0) {
                            listener(&rod.config.rod, time, scratch, rod.config.displacement.fs_hz);
                        }
                    }
                    Ok(None) => {}
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
        if let Some(fault) = fault {
            summary.undecodable += 1;
            summary.fault.get_or_insert_with(|| fault.to_string());
        }
        // At once, not at the end of a chunk: the progress of the other rods at that moment must not depend on the chunks of a file.
        if has_events {
            self.collect(false);
        }
        if self.grown > WEIGHED_EVERY {
            self.weigh();
        }
    }

    /// Bytes of samples of all rods that are not yet in a record or a moment.
    pub fn held(&self) -> usize {
        let rods = self.rods.iter();
        rods.map(|rod| rod.assembler.held() + rod.waiting()).sum()
    }

    /// Sets the bytes of samples beyond which the longest stretch becomes a record.
    pub fn bound(&mut self, most: usize) {
        self.most = most;
    }

    /// Ends the longest stretches, or moments, while all rods together hold too much.
    fn weigh(&mut self) {
        self.grown = 0;
        let mut held = self.held();
        while held > self.most {
            if let Some(at) = (0..self.rods.len()).max_by_key(|at| self.rods[*at].waiting())
                && self.rods[at].waiting()
                    > self
                        .rods
                        .iter()
                        .map(|rod| rod.assembler.held())
                        .max()
                        .unwrap_or(0)
            {
                let mut found = Vec::new();
                lanes::release(&mut self.rods[at..], &mut found);
                self.take(found);
                held = self.held();
                continue;
            }
            let rods = self.rods.iter().map(|rod| rod.assembler.held());
            // Of equal ones the first.
            let Some((_, Reverse(at))) = rods.enumerate().map(|(at, held)| (held, Reverse(at))).max() else {
                return;
            };
            let Some(rod) = self.rods.get_mut(at) else { return };
            let before = rod.assembler.held();
            rod.assembler.cut_off();
            *self.cuts.entry(at).or_insert(0) += 1;
            self.collect(false);
            let now = self.rods.get(at).map_or(0, |rod| rod.assembler.held());
            held = self.held();
            if now >= before {
                return;
            }
        }
    }

    /// Notes data lost in the file, and rejects it for each rod that may have had messages there.
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
        self.collect(false);
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

    /// Number of messages of all topics.
    pub fn messages(&self) -> u64 {
        self.topics.iter().map(|topic| topic.summary.messages).sum()
    }

    /// Handles a journal's note: another journal ends everything, a stream that ended ends its rods' records.
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

    /// Ends the records of the rods last fed by a stream that ended.
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

    /// Ends a rod's records as the end of a file does, and starts again. Its temperatures are kept if they
    /// come from elsewhere.
    fn end_rod(&mut self, at: usize, cut_short: bool) {
        let Some(rod) = self.rods.get_mut(at) else { return };
        let count = std::mem::take(&mut self.counts[at]);
        rod.finish(count, cut_short, None);
        self.collect(false);
        let Some(rod) = self.rods.get_mut(at) else { return };
        let [samples, temperature] = rod.fed_by;
        let is_from_elsewhere = temperature.is_some() && temperature != samples;
        rod.assembler.renew(is_from_elsewhere);
        rod.fed_by = [None, temperature.filter(|_| is_from_elsewhere)];
    }

    /// Index of a stream.
    pub(super) fn stream(&mut self, name: &str) -> usize {
        self.stream_numbers.get(name).copied().unwrap_or_else(|| {
            self.stream_numbers.insert(name.to_owned(), self.streams.len());
            self.streams.push(name.to_owned());
            self.streams.len() - 1
        })
    }

    /// Names of the streams that last fed a rod.
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

    /// Prepares for another file of the same journal: channels are numbered anew, samples are kept.
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

    /// Moves the events so far to `to`.
    pub fn events(&mut self, to: &mut impl Extend<Timed>) {
        to.extend(self.ready.drain(..));
    }

    /// Collects the rods' events; with `all`, none waits for another sensor any more.
    fn collect(&mut self, all: bool) {
        let mut found = Vec::new();
        for lanes in self.rods.chunk_by_mut(|_, next| next.sensor > 0) {
            lanes::collect(lanes, all, &mut found);
        }
        self.take(found);
    }

    fn take(&mut self, found: Vec<Found>) {
        if found.is_empty() {
            return;
        }
        let mut reached = self.reached();
        let mut timed = Vec::with_capacity(found.len());
        // Of moments that close together the later are still to come when the first does.
        for (at, event, origin) in found.into_iter().rev() {
            let before = match &event {
                Event::Moment(moment) => reached
                    .iter()
                    .map(|(rod, reached)| {
                        let own = (*rod == moment.rod).then_some(at);
                        (rod.clone(), reached.iter().copied().chain(own).min())
                    })
                    .collect(),
                _ => Arc::clone(&reached),
            };
            timed.push(Timed {
                event,
                at,
                reached: std::mem::replace(&mut reached, before),
                origin,
            });
        }
        self.ready.extend(timed.into_iter().rev());
    }

    /// Times up to which each rod has been read.
    pub fn reached(&self) -> Reached {
        let rods = self.rods.chunk_by(|_, next| next.sensor > 0);
        rods.filter(|lanes| lanes.iter().any(|lane| lane.is_followed))
            .filter_map(|lanes| {
                let first = lanes.first()?;
                let own = |sensor: usize| lanes.get(sensor)?.assembler.complete_until();
                let reached = match &first.moments {
                    None => own(0),
                    Some(moments) => moments.complete_until(|sensor| own(sensor).is_some()),
                };
                Some((first.config.rod.clone(), reached))
            })
            .collect()
    }

    /// Ends every stream; `damage` describes the part not read and gives one rejection for each rod with
    /// messages in the file.
    pub fn finish(&mut self, cut_short: bool, damage: Option<&str>, to: &mut impl Extend<Timed>) {
        for (rod, count) in self.rods.iter_mut().zip(&self.counts) {
            rod.finish(*count, cut_short, damage);
        }
        self.collect(true);
        self.events(to);
    }

    /// Ends one of several files that are read side by side. Records continue in the next one if this one
    /// ended properly.
    pub fn end_file(&mut self, cut_short: bool, damage: Option<&str>) {
        let fed = self.rods.iter_mut().zip(&self.counts);
        for (rod, count) in fed.filter(|(_, count)| count.messages > 0) {
            if cut_short || self.ends_with_file {
                rod.assembler.finish(cut_short);
                rod.assembler.renew(true);
            }
            rod.tell_nothing(*count, damage);
        }
        self.collect(false);
    }

    /// Events of the samples left at the very end.
    pub fn ended(mut self) -> impl Iterator<Item = Timed> {
        let mut last = VecDeque::new();
        self.finish(false, None, &mut last);
        last.into_iter()
    }

    /// Adds the counts of messages to a summary.
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
                "{}: rod {}: {times} records end early: the samples of all rods together took too much memory",
                summary.file, config.rod
            ));
        }
        summary.missing.clear();
        summary.wanted = 0;
        summary.samples.clear();
        for (Rod { config, sensor, .. }, count) in self.rods.iter().zip(&self.counts) {
            *summary.samples.entry(config.rod.clone()).or_default() += count.samples;
            let temperature = config.temperature.as_ref().filter(|_| *sensor == 0);
            let wanted = [Some(&config.displacement), temperature];
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
    /// Bytes of the records that wait for the rod's other sensors.
    fn waiting(&self) -> usize {
        let waiting = self.moments.iter().flat_map(Moments::waiting);
        waiting.map(|event| 8 * event.samples()).sum()
    }

    /// Ends its stream.
    fn finish(&mut self, count: Count, cut_short: bool, damage: Option<&str>) {
        self.assembler.finish(cut_short);
        self.assembler.tell_leftover();
        self.tell_nothing(count, damage);
    }

    /// Reports a file that gave nothing, or nothing more.
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

/// Nanoseconds of a time that counts whole seconds, milliseconds or microseconds: programs write 1772344800.0 as 1772344800. Nanoseconds
/// since 1970 it cannot be if in such a unit it lies within a day of the time at which it was logged.
#[inline]
fn of_coarser_unit(time: i64, log_time: u64) -> Option<i64> {
    const DAY_NS: u64 = 86_400_000_000_000;
    let is_near = |nanos: i64| u64::try_from(nanos).is_ok_and(|nanos| nanos.abs_diff(log_time) < DAY_NS);
    if is_near(time) || time <= 1_000_000_000 {
        return None;
    }
    let in_unit = |nanos: &i64| time.checked_mul(*nanos).filter(|time| is_near(*time));
    [1_000_000_000, 1_000_000, 1_000].iter().find_map(in_unit)
}

impl Route {
    /// Passes a message on to the rod; returns the time of its first sample, if it has samples.
    #[inline]
    fn take(
        &self,
        (rod, count): (&mut Rod, &mut Count),
        message: &Message<'_>,
        file: Option<&Arc<str>>,
        scratch: &mut Vec<f64>,
    ) -> Result<Option<Timestamp>, DecodeError> {
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
        let time = Timestamp::from_nanos(of_coarser_unit(time, message.log_time).unwrap_or(time));
        let unit = channel.unit;
        if self.temperature {
            for &raw in scratch.iter() {
                rod.assembler.push_temperature(time, unit.convert(raw));
            }
            return Ok(None);
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
        rod.files.note(file, time);
        rod.assembler.push(time, scratch);
        Ok(Some(time))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_in_a_coarser_unit_is_known_by_the_time_of_its_log() {
        let six = 1_772_344_800_000_000_000;
        let logged = six as u64 + 3_600_000_000_000;
        for unit in [1_000_000_000, 1_000_000, 1_000] {
            assert_eq!(of_coarser_unit(six / unit, logged), Some(six), "{unit}");
            // Two days on, it may count nanoseconds of a clock that nobody set.
            assert_eq!(
                of_coarser_unit(six / unit, logged + 172_800_000_000_000),
                None,
                "{unit}"
            );
        }
        assert_eq!(of_coarser_unit(six, logged), None);
        assert_eq!(of_coarser_unit(5, 0), None);
    }
}
