//! Streams of a journal: what each fed last, and what its end ends.

use super::{Rod, Router};
use crate::note::{Note, State};
use crate::read::plans::Plans;

impl Router {
    /// Handles a journal's note: another journal ends everything, a stream that ended ends its rods' records.
    pub(super) fn note(&mut self, data: &[u8]) {
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
    pub(super) fn end_of(&mut self, stream: &str, cut_short: bool) {
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
    pub(super) fn end_rod(&mut self, at: usize, cut_short: bool) {
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
    pub(in crate::read) fn stream(&mut self, name: &str) -> usize {
        self.stream_numbers.get(name).copied().unwrap_or_else(|| {
            self.stream_numbers.insert(name.to_owned(), self.streams.len());
            self.streams.push(name.to_owned());
            self.streams.len() - 1
        })
    }

    /// Names of the streams that last fed a rod.
    pub(in crate::read) fn fed_by(&self, rod: &Rod) -> [Option<String>; 2] {
        rod.fed_by
            .map(|stream| stream.and_then(|stream| self.streams.get(stream).cloned()))
    }

    /// Notes which streams last fed a rod.
    pub(in crate::read) fn set_fed_by(&mut self, at: usize, names: [Option<String>; 2]) {
        let streams = names.map(|name| name.map(|name| self.stream(&name)));
        if let Some(rod) = self.rods.get_mut(at) {
            rod.fed_by = streams;
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
}
