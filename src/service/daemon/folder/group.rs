//! Finished files that overlap in time: they are read side by side as one, and done together.

use super::lane::{Lane, Stamp};
use crate::analysis::signal::record::RodId;
use crate::recording::read::folder::Span;
use crate::recording::read::stream::turn;
use crate::recording::read::{Member, Step, Stream, Summary, Tail, Tails};
use crate::service::daemon::supervision::Watch;
use crate::service::telemetry::Health;
use crate::site::store::FileMark;
use std::ffi::{OsStr, OsString};
use std::time::Duration;

/// Bytes of files beyond which no other joins: a restart reads all of a group again.
const MOST_BYTES: u64 = 1 << 30;

/// Most files of a group that are open at once.
const MOST_OPEN: usize = 64;
/// Bytes in memory beyond which no other file joins.
const MOST_HELD: usize = 32 << 20;

/// A file of the group that is read.
struct Open {
    lane: Lane,
    /// Log time reached by reading \[ns\]; at first that of its first message.
    front: u64,
}

/// A file of the group that was read to its end.
pub(super) struct Read {
    pub(super) name: OsString,
    pub(super) stamp: Stamp,
    pub(super) mark: FileMark,
    pub(super) summary: Summary,
    /// Open samples of earlier files that it went on with.
    pub(super) begun: Vec<Tail>,
    /// True if it is whole or quarantined, and not to be read again unless it changes.
    pub(super) is_final: bool,
    /// Log time of its first message \[ns\], by which it is known if it is read again.
    pub(super) known_by: Option<u64>,
}

/// Files that are read as one.
pub(super) struct Group {
    /// Rods that they share; `None` for a file that is read on its own: of unknown span, or suspected of ending the program.
    stream: Option<Stream>,
    open: Vec<Open>,
    read: Vec<Read>,
    /// Open samples of earlier files that those read to their end went on with.
    taken: Vec<Tail>,
    bytes: u64,
    /// Log time of the first message of its first file \[ns\].
    began: u64,
}

impl Group {
    /// A group of one file, whose first message has this log time.
    pub(super) fn of(lane: Lane, begins: u64, stream: Option<Stream>) -> Self {
        Self {
            stream,
            bytes: lane.stamp.0,
            began: begins,
            open: vec![Open { lane, front: begins }],
            read: Vec::new(),
            taken: Vec::new(),
        }
    }

    /// Log time up to which its files are read \[ns\].
    pub(super) fn at(&self) -> u64 {
        let fronts = self.open.iter().map(|open| match self.stream {
            Some(_) => open.front,
            None => open.lane.recording.at().unwrap_or(open.front),
        });
        fronts.min().unwrap_or(0)
    }

    /// Log time of the first message of its first file \[ns\].
    pub(super) fn began(&self) -> u64 {
        self.began
    }

    /// Bytes of its files.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Name of one of its files.
    pub(super) fn first(&self) -> Option<&OsString> {
        let open = self.open.iter().map(|open| &open.lane.name);
        open.chain(self.read.iter().map(|read| &read.name)).next()
    }

    /// True if other files may join it.
    pub(super) fn is_open(&self) -> bool {
        self.stream.is_some()
            && self.bytes <= MOST_BYTES
            && self.open.len() < MOST_OPEN
            && self.held() <= MOST_HELD
    }

    /// True if it is read up to the first message of a file, which has this log time.
    pub(super) fn has_come_to(&self, begins: u64) -> bool {
        let is_ready = self.open.iter().any(|open| open.lane.recording.is_ready());
        !is_ready && begins <= self.at()
    }

    /// True if a file can be read as one with the others, and not better with open samples that wait.
    pub(super) fn takes(&mut self, span: &Span, tails: &Tails) -> bool {
        let stream = self.stream.as_mut();
        stream.is_some_and(|stream| stream.takes(span) && !stream.is_passed_by(tails, span))
    }

    /// Adds a file.
    pub(super) fn add(&mut self, lane: Lane, begins: u64, span: Span) {
        self.bytes += lane.stamp.0;
        self.open.push(Open { lane, front: begins });
        if let Some(stream) = &mut self.stream {
            stream.add(span);
        }
    }

    /// True if a file is in it.
    pub(super) fn has(&self, name: &OsStr) -> bool {
        self.open.iter().any(|open| open.lane.name == name) || self.read.iter().any(|read| read.name == name)
    }

    /// True if a rod has samples in it, as far as it is read.
    pub(super) fn has_begun(&self, rod: &RodId) -> bool {
        match &self.stream {
            Some(stream) => stream.has_begun(rod),
            None => self.open.iter().any(|open| open.lane.recording.has_begun(rod)),
        }
    }

    /// Open samples of earlier files that its files went on with.
    pub(super) fn taken(&self) -> impl Iterator<Item = &Tail> {
        let open = self.open.iter().flat_map(|open| open.lane.taken());
        open.chain(&self.taken)
    }

    /// Bytes in memory.
    pub(super) fn held(&self) -> usize {
        let own: usize = self.open.iter().map(|open| open.lane.held).sum();
        own + self.stream.as_ref().map_or(0, Stream::held)
    }

    /// Bytes of samples in events that wait to be taken.
    pub(super) fn ready_bytes(&self) -> usize {
        self.open
            .iter()
            .map(|open| open.lane.recording.ready_bytes())
            .sum()
    }

    /// Takes one step of the file whose turn it is, which is handed over at its end, within this room \[bytes\]; nothing logged after `limit` is passed on, where files
    /// share a stream.
    pub(super) fn step(
        &mut self,
        watch: &mut dyn Watch,
        (settle, health): (Duration, &Health),
        (room, limit): (usize, u64),
        tails: &Tails,
    ) -> Step<Box<Lane>> {
        let fronts: Vec<u64> = self.open.iter().map(|open| open.front).collect();
        // Events already read are returned before another file's turn.
        let ready = self.open.iter().position(|open| open.lane.recording.is_ready());
        let Some((at, before_others)) = ready.map(|at| (at, 0)).or_else(|| turn(&fronts)) else {
            return Step::End;
        };
        let is_last = self.open.len() == 1;
        let Open { lane, front } = &mut self.open[at];
        lane.recording.bound(room);
        let step = match &mut self.stream {
            None => lane.step(watch, settle, health).unwrap_or(Step::More),
            Some(stream) => {
                let guard = &mut lane.guard;
                let mut member = Member {
                    recording: &mut lane.recording,
                    stream,
                    limit: before_others.min(limit),
                    last: is_last.then_some(tails),
                };
                let step = guard.poll(&mut member, &lane.input, watch, health);
                lane.held = lane.recording.held();
                *front = lane.recording.front().unwrap_or(*front).max(*front);
                step
            }
        };
        match step {
            Step::End => {
                let lane = self.open.remove(at).lane;
                self.taken.extend_from_slice(lane.taken());
                Step::File(Box::new(lane))
            }
            Step::Event(event, place) => Step::Event(event, place),
            _ => Step::More,
        }
    }

    /// Keeps a file that was read to its end; true if it was the last.
    pub(super) fn keep(&mut self, mut read: Read) -> bool {
        let begun = self.read.iter().chain([&read]).flat_map(|read| &read.begun);
        if begun.map(Tail::held).sum::<usize>() > MOST_HELD {
            read.begun.clear();
        }
        self.read.push(read);
        self.open.is_empty()
    }

    /// Takes it apart when all its files are read: their stream, they, and the open samples that they went on with.
    pub(super) fn into_parts(self) -> (Option<Stream>, Vec<Read>, Vec<Tail>) {
        (self.stream, self.read, self.taken)
    }
}
