//! Queue between the pipeline and the store: events in the order of their own times, files behind their events.

use super::{Done, Job};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::ordered::{Ordered, Reached};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::{Duration, Instant};

/// Silence of a rod after which events no longer wait for it, once all data present has been read.
const PATIENCE: Duration = Duration::from_secs(1);

/// Items on their way into the store.
pub struct Held {
    events: Ordered<(u64, Done)>,
    /// Numbers of the events not yet released.
    waiting: BTreeSet<u64>,
    /// Files read to their end, each after the events before its number.
    files: VecDeque<(u64, Done)>,
    next: u64,
    /// Time up to which each rod has been read, and since when.
    reached: BTreeMap<RodId, (Option<Timestamp>, Instant)>,
    /// False if events are released in the order they come.
    waits: bool,
}

impl Held {
    /// An empty queue. See [`Ordered::new`] for the window \[s\].
    pub fn new(window_s: f64) -> Self {
        Self {
            events: Ordered::new(window_s),
            waiting: BTreeSet::new(),
            files: VecDeque::new(),
            next: 0,
            reached: BTreeMap::new(),
            waits: true,
        }
    }

    /// Returns the queue with waiting for rods switched off.
    pub fn impatient(self) -> Self {
        Self { waits: false, ..self }
    }

    /// Releases all items still held, in their order, at the end of the input.
    pub fn rest(&mut self) -> Vec<Done> {
        let mut going = Vec::new();
        self.release_all(&mut going);
        going
    }

    /// Takes results of the pipeline; returns the items to be stored now, in order.
    pub fn take(&mut self, group: Vec<Done>, now: Instant) -> Vec<Done> {
        let mut going = Vec::with_capacity(group.len());
        for done in group {
            match done {
                Done::Event(analysed, place) => {
                    self.note(&place.reached, now);
                    let (rod, at) = (analysed.rod().clone(), place.at);
                    self.waiting.insert(self.next);
                    self.events
                        .push(&rod, at, (self.next, Done::Event(analysed, place)));
                    self.next += 1;
                    self.release(&mut going);
                }
                Done::Job(Job::Look(reached)) => {
                    self.note(&reached, now);
                    self.forget_silent(now);
                    self.release(&mut going);
                }
                Done::Job(job @ Job::Files { .. }) => {
                    self.files.push_back((self.next, Done::Job(job)));
                    self.release(&mut going);
                }
                Done::Job(Job::Reload(generation)) => {
                    self.release_all(&mut going);
                    self.events.set_window(generation.config.track.reorder_window_s);
                    going.push(Done::Job(Job::Reload(generation)));
                }
                Done::Job(job) => going.push(Done::Job(job)),
            }
        }
        going
    }

    fn note(&mut self, reached: &Reached, now: Instant) {
        for (rod, reached) in reached.iter() {
            let known = self.reached.get(rod);
            if known.is_none_or(|(known, _)| known != reached) {
                self.reached.insert(rod.clone(), (*reached, now));
                self.events.note(&[(rod.clone(), *reached)]);
            }
        }
    }

    /// Stops waiting for silent rods until they send data again.
    fn forget_silent(&mut self, now: Instant) {
        for (rod, (_, since)) in &self.reached {
            if now.saturating_duration_since(*since) >= PATIENCE {
                self.events.note(&[(rod.clone(), None)]);
            }
        }
    }

    fn release(&mut self, going: &mut Vec<Done>) {
        if !self.waits {
            return self.release_all(going);
        }
        while let Some(item) = self.events.next_settled() {
            self.gone(item, going);
        }
        self.release_files(going);
    }

    fn release_all(&mut self, going: &mut Vec<Done>) {
        while let Some(item) = self.events.next_of_all() {
            self.gone(item, going);
        }
        self.release_files(going);
    }

    fn gone(&mut self, (number, done): (u64, Done), going: &mut Vec<Done>) {
        self.waiting.remove(&number);
        going.push(done);
    }

    /// Releases marks of files, which enter the store only after the events of the file.
    fn release_files(&mut self, going: &mut Vec<Done>) {
        let first = self.waiting.first().copied().unwrap_or(u64::MAX);
        while self.files.front().is_some_and(|(number, _)| *number <= first) {
            going.extend(self.files.pop_front().map(|(_, file)| file));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::read::Place;
    use crate::recording::read::Summary;
    use crate::site::analyse::Analysed;
    use std::sync::Arc;

    fn event(rod: &str, second: i64, reached: &[(&str, i64)]) -> Done {
        let time = |second: i64| Timestamp::from_nanos(second * 1_000_000_000);
        let place = Place {
            origin: "".into(),
            file: Arc::from("x"),
            bytes: 0,
            records: 0,
            at: time(second),
            reached: reached
                .iter()
                .map(|(rod, second)| (RodId((*rod).to_owned()), Some(time(*second))))
                .collect(),
        };
        Done::Event(Analysed::Known(RodId(rod.to_owned()), [0; 32]), place)
    }

    fn file() -> Done {
        Done::Job(Job::Files {
            marks: Vec::new(),
            results: vec![Ok(Summary::default())],
            carry: Vec::new(),
        })
    }

    fn names(going: &[Done]) -> Vec<String> {
        let name = |done: &Done| match done {
            Done::Event(analysed, _) => analysed.rod().to_string(),
            Done::Job(Job::Files { .. }) => "file".to_owned(),
            Done::Job(_) => "job".to_owned(),
        };
        going.iter().map(name).collect()
    }

    #[test]
    fn a_file_is_told_behind_its_events_and_a_silent_rod_holds_nobody() {
        let begun = Instant::now();
        let mut held = Held::new(3600.0);
        let going = held.take(vec![event("b", 100, &[("a", 50), ("b", 101)]), file()], begun);
        assert!(going.is_empty());
        // A job that needs no order passes.
        let going = held.take(vec![Done::Job(Job::Tick { is_caught_up: true })], begun);
        assert_eq!(names(&going), ["job"]);
        let look = || Done::Job(Job::Look(Arc::from([])));
        assert!(held.take(vec![look()], begun + PATIENCE / 2).is_empty());
        let going = held.take(vec![look()], begun + PATIENCE);
        assert_eq!(names(&going), ["b", "file"]);
        // It speaks again: now it is waited for.
        let later = begun + 2 * PATIENCE;
        let going = held.take(vec![event("b", 200, &[("a", 150), ("b", 201)]), file()], later);
        assert!(going.is_empty());
        let going = held.take(vec![event("a", 180, &[("a", 190), ("b", 201)])], later);
        assert_eq!(names(&going), ["a"]);
        let going = held.take(vec![event("a", 220, &[("a", 230), ("b", 201)])], later);
        assert_eq!(names(&going), ["b", "file"]);
    }
}
