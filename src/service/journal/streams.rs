//! The streams of a journal: position, present connection, and changes to be noted.

use crate::recording::note::{Note, Standing, State};
use crate::site::clock::now_ns;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Most senders remembered; beyond, the one that was silent longest is forgotten.
const MAX_SENDERS: usize = 4096;

/// State of one stream.
struct Stream {
    standing: Standing,
    /// Id of the connection that feeds it.
    line: Option<u64>,
    durable: Option<watch::Sender<u64>>,
    /// Time since which no connection feeds it.
    alone: Option<Instant>,
    /// Time it had been without a connection before this program started \[s\].
    alone_before_s: f64,
}

/// All streams by their names.
#[derive(Default)]
pub(super) struct Streams {
    all: BTreeMap<String, Stream>,
    /// Changes for the next note.
    changed: BTreeMap<String, Standing>,
    /// Positions written, to be published once durable.
    written: Vec<(watch::Sender<u64>, u64)>,
}

/// True if a stream has a sender with a name, who may come back.
pub(super) fn is_named(stream: &str) -> bool {
    !stream.starts_with('#')
}

impl Streams {
    /// Restores the streams of earlier parts. Streams that cannot be resumed are broken.
    pub fn restored(standings: BTreeMap<String, Standing>) -> Self {
        let mut streams = Self::default();
        for (name, mut standing) in standings {
            if standing.state == State::Complete || (standing.state == State::Broken && !is_named(&name)) {
                continue;
            }
            if !is_named(&name) {
                standing.state = State::Broken;
                streams.changed.insert(name, standing);
                continue;
            }
            let alone_s = now_ns().saturating_sub(standing.seen_ns) as f64 * 1e-9;
            let stream = Stream {
                standing,
                line: None,
                durable: None,
                alone: Some(Instant::now()),
                alone_before_s: alone_s,
            };
            streams.all.insert(name, stream);
        }
        streams
    }

    /// Number of messages of a stream in the journal.
    pub fn messages(&self, name: &str) -> u64 {
        self.all.get(name).map_or(0, |stream| stream.standing.messages)
    }

    /// Gives a stream to a connection; returns the one that had it before.
    pub fn connect(&mut self, name: &str, line: u64, durable: watch::Sender<u64>) -> Option<u64> {
        let stream = self.all.entry(name.to_owned()).or_insert_with(|| Stream {
            standing: Standing {
                messages: 0,
                state: State::Open,
                seen_ns: now_ns(),
            },
            line: None,
            durable: None,
            alone: None,
            alone_before_s: 0.0,
        });
        stream.durable = Some(durable);
        stream.alone = None;
        stream.line.replace(line)
    }

    /// Notes the new position of a stream.
    pub fn advance(&mut self, name: &str, through: u64) {
        let Some(stream) = self.all.get_mut(name) else {
            return;
        };
        stream.standing = Standing {
            messages: through,
            state: State::Open,
            seen_ns: now_ns(),
        };
        self.changed.insert(name.to_owned(), stream.standing);
        if let Some(durable) = &stream.durable {
            self.written.push((durable.clone(), through));
        }
    }

    /// Notes that the connection of a stream is gone; the stream may be resumed.
    pub fn leave(&mut self, name: &str) {
        if let Some(stream) = self.all.get_mut(name) {
            stream.line = None;
            stream.durable = None;
            stream.alone = Some(Instant::now());
            stream.alone_before_s = 0.0;
        }
    }

    /// Ends a stream; returns true if there is a change to note. A named sender's broken stream keeps its
    /// position.
    pub fn end(&mut self, name: &str, state: State) -> bool {
        let keeps = state == State::Broken && is_named(name);
        let standing = if keeps {
            self.all.get_mut(name).map(|stream| {
                stream.standing.state = state;
                stream.standing
            })
        } else {
            self.all.remove(name).map(|stream| Standing {
                state,
                ..stream.standing
            })
        };
        // One that never sent anything is not worth a word.
        let Some(standing) = standing.filter(|standing| standing.messages > 0) else {
            return false;
        };
        self.changed.insert(name.to_owned(), standing);
        true
    }

    /// Named streams not resumed within `resume_s`, and those beyond the limit.
    pub fn expired(&self, resume_s: f64) -> Vec<String> {
        let is_over = |stream: &Stream| {
            let alone = stream.alone.map(|since| since.elapsed());
            stream.standing.state == State::Open
                && alone.is_some_and(|alone| alone.as_secs_f64() + stream.alone_before_s >= resume_s)
        };
        let over = self.all.iter().filter(|(_, stream)| is_over(stream));
        over.map(|(name, _)| name.clone()).collect()
    }

    /// Forgets senders beyond the limit, those silent longest first. Only broken streams can be forgotten.
    pub fn forget(&mut self) {
        while self.all.len() > MAX_SENDERS {
            let oldest = self
                .all
                .iter()
                .filter(|(_, stream)| stream.line.is_none() && stream.standing.state == State::Broken)
                .min_by_key(|(_, stream)| stream.standing.seen_ns)
                .map(|(name, _)| name.clone());
            let Some(oldest) = oldest else { return };
            self.all.remove(&oldest);
        }
    }

    /// Changes since the last note, taken out.
    pub fn take_note(&mut self) -> Note {
        Note {
            begins: None,
            streams: std::mem::take(&mut self.changed),
        }
    }

    /// Every stream with data, and the changes since the last note; they count as noted once
    /// [taken](Self::take_note).
    pub fn full_note(&self) -> Note {
        let mut note = Note {
            begins: None,
            streams: self.changed.clone(),
        };
        for (name, stream) in &self.all {
            if stream.standing.messages > 0 {
                note.streams.insert(name.clone(), stream.standing);
            }
        }
        note
    }

    /// Publishes the positions written, which are now durable.
    pub fn publish(&mut self) {
        for (durable, messages) in self.written.drain(..) {
            durable.send_replace(messages);
        }
    }

    /// Time until the next stream may expire; a coarse bound.
    pub fn patience(&self, resume_s: f64) -> Duration {
        Duration::from_secs_f64(resume_s.clamp(0.01, 1.0))
    }
}
