//! Files that are read side by side as one: their rods, and the order of their turns.

use super::folder::Span;
use super::route::{Ready, Rod, Router, held};
use super::tail::{Tail, Tails};
use super::{Event, Place, Recording, Source, Step};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::Arc;
use tirante_analysis::signal::record::{RecordSettings, RodChannels, RodId};

/// Largest overlap of consecutive files of one stream \[ns\]: messages at the seam come out of order.
pub(super) const SEAM_NS: u64 = 1_000_000_000;

/// Files that are read as one. Records go on from one into the next.
pub struct Stream {
    pub(super) rods: Vec<Rod>,
    /// True if a record ends with its file.
    ends_with_file: bool,
    /// Time spans and topics that later files may share.
    spans: Vec<Span>,
    /// Latest log time of each topic \[ns since 1970\].
    ends: BTreeMap<String, u64>,
    /// Events of what ended with the last file.
    events: Vec<(Event, Place)>,
    /// Open samples that the last file left.
    left: Vec<Tail>,
}

impl Stream {
    /// A stream without a file.
    pub fn new(channels: &[RodChannels], settings: &RecordSettings) -> Self {
        let router = Router::new(channels, settings);
        Self {
            ends_with_file: router.ends_with_file,
            rods: router.rods,
            spans: Vec::new(),
            ends: BTreeMap::new(),
            events: Vec::new(),
            left: Vec::new(),
        }
    }

    /// True if a file can join it. Files come in the order of their first messages.
    pub fn takes(&mut self, span: &Span) -> bool {
        self.spans
            .retain(|known| known.to > span.from.saturating_add(SEAM_NS));
        // One that ends before another one that began earlier goes beside it, not behind.
        !self
            .spans
            .iter()
            .any(|known| !known.topics.is_disjoint(&span.topics))
    }

    /// True if a file goes on with a rod's open samples in `tails`, and not with those of the stream, which end earlier: these come from a
    /// part of an older file.
    pub fn is_passed_by(&self, tails: &Tails, span: &Span) -> bool {
        self.rods.chunk_by(|_, next| next.sensor > 0).any(|lanes| {
            let has_samples = |lane: &Rod| span.topics.contains(&lane.config.displacement.topic);
            let read_to = lanes.iter().map(|lane| lane.to).max();
            let tail_to = lanes.first().and_then(|lane| tails.to(&lane.config.rod));
            lanes.iter().any(|lane| lane.is_begun)
                && lanes.iter().any(has_samples)
                && tail_to.is_some_and(|to| to <= span.from.saturating_add(SEAM_NS) && Some(to) >= read_to)
        })
    }

    /// Time up to which the latest of its files reaches that has a topic of this span \[ns since 1970\].
    pub(super) fn reaches(&self, span: &Span) -> Option<u64> {
        let latest = span.topics.iter().filter_map(|topic| self.ends.get(topic));
        latest.max().copied()
    }

    /// Adds a file by its span.
    pub fn add(&mut self, span: Span) {
        for topic in &span.topics {
            let to = self.ends.entry(topic.clone()).or_default();
            *to = span.to.max(*to);
        }
        self.spans.push(span);
    }

    /// Bytes of samples not yet in a record, and of records that wait for other sensors.
    pub fn held(&self) -> usize {
        held(&self.rods)
    }

    /// Does something with a recording that has the rods of the stream meanwhile.
    fn with<T>(&mut self, recording: &mut Recording, work: impl FnOnce(&mut Recording) -> T) -> T {
        recording.swap_rods(&mut self.rods);
        let swapped = Swapped {
            rods: &mut self.rods,
            recording,
        };
        work(&mut *swapped.recording)
    }

    /// Takes the next step of one of its recordings, which passes on nothing logged after `limit` \[ns\].
    pub fn poll(&mut self, recording: &mut Recording, limit: u64) -> Step<Infallible> {
        self.with(recording, |recording| recording.poll_up_to(limit))
    }

    /// True if a rod had samples in it since the last end.
    pub fn has_begun(&self, rod: &RodId) -> bool {
        self.rods
            .iter()
            .any(|lane| (lane.is_begun || lane.is_continued) && lane.config.rod == *rod)
    }

    /// Ends it behind its last file, of this name, bytes read and records returned.
    fn end(&mut self, tails: &Tails, (file, bytes, mut records): (Arc<str>, u64, u64)) {
        let mut router = Router::of(std::mem::take(&mut self.rods));
        let mut ended = Ready::default();
        if self.ends_with_file {
            router.finish(false, None, &mut ended);
        } else {
            router.join(tails.clone(), Arc::clone(&file), true);
            router.leave(&mut ended);
        }
        let events = ended.take().map(|timed| {
            records += timed.records();
            timed.at_place(Arc::clone(&file), bytes, records)
        });
        self.events = events.collect();
        self.left = router.left(&(file, bytes, records));
    }

    /// The events of what ended with its last file, and what that left open for files that go on there.
    pub fn into_ended(self) -> (Vec<(Event, Place)>, Vec<Tail>) {
        (self.events, self.left)
    }
}

/// Gives the rods back to their stream, even if the recording panics: those of the other files are whole.
struct Swapped<'a> {
    rods: &'a mut Vec<Rod>,
    recording: &'a mut Recording,
}

impl Drop for Swapped<'_> {
    fn drop(&mut self) {
        self.recording.swap_rods(self.rods);
    }
}

/// A recording of a stream.
pub struct Member<'a> {
    /// The recording.
    pub recording: &'a mut Recording,
    /// Its stream.
    pub stream: &'a mut Stream,
    /// Log time up to which it is read \[ns\].
    pub limit: u64,
    /// Receiver of the open samples, if it is the last of its stream that is read.
    pub last: Option<&'a Tails>,
}

impl Source for Member<'_> {
    type File = Infallible;

    fn poll(&mut self) -> Step<Infallible> {
        let step = self.stream.poll(self.recording, self.limit);
        // A step like any other: what it takes may be too much.
        if let (Step::End, Some(tails)) = (&step, self.last) {
            self.stream.end(tails, self.recording.counts());
        }
        step
    }

    fn position(&self) -> Option<(Arc<str>, u64)> {
        Source::position(self.recording)
    }

    fn abandon(&mut self, why: &str) {
        self.stream
            .with(self.recording, |recording| recording.abandon(why));
    }

    fn discard(&mut self, why: &str) {
        self.recording.discard(why);
    }
}

/// The one of several files that is furthest behind, by the log times they have reached, and the log time up to which it may be read before
/// another has its turn \[ns\].
pub fn turn(fronts: &[u64]) -> Option<(usize, u64)> {
    let all = fronts.iter().copied().enumerate();
    let (at, _) = all.clone().min_by_key(|(at, front)| (*front, *at))?;
    let limits = all
        .filter(|(other, _)| *other != at)
        .map(|(other, front)| match other < at {
            true => front.saturating_sub(1),
            false => front,
        });
    Some((at, limits.min().unwrap_or(u64::MAX)))
}
