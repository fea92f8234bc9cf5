//! Open samples at the ends of the folder's files: they wait a while for the file that goes on there.

use crate::analysis::signal::record::{Event, RecordSettings, RodChannels, RodId};
use crate::recording::read::{Place, Recording, Tail, Tails};
use crate::service::telemetry::{Fault, Health};
use crate::site::store::Carry;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

/// Beginning of the names under which the store keeps them, before the rod's id.
pub(in crate::service::daemon) const KEPT_UNDER: &str = "folder/";

/// Beginning of the names under which the store keeps what files began with that may be read again, before the rod's id, a slash and the label of the file.
pub(in crate::service::daemon) const BEGUN_UNDER: &str = "begun/";

/// Most bytes of open samples of all rods, and as many of what files began with; beyond, records end with their files, and files begin with
/// nothing when they are read again.
const MOST_BYTES: usize = 32 << 20;

/// Open samples of the files read so far.
pub(super) struct Joins {
    tails: Tails,
    /// Those with which files began that may be read again from their start, by the label of the file.
    begun: BTreeMap<String, Vec<Tail>>,
    /// Time for which they wait.
    wait: Duration,
    channels: Vec<RodChannels>,
    health: Arc<Health>,
}

/// Events of samples that nothing goes on with, and what the store keeps from then on.
#[derive(Default)]
pub(super) struct Ended {
    pub(super) events: Vec<(Event, Place)>,
    pub(super) kept: Vec<Carry>,
}

impl Joins {
    /// Takes up what the store kept. What does not fit the channels and settings any more is left out, and told; with the rows to be
    /// removed.
    pub(super) fn new(
        kept: &[Carry],
        channels: &[RodChannels],
        settings: &RecordSettings,
        wait: Duration,
        health: Arc<Health>,
    ) -> (Self, Ended) {
        let tails = Tails::new(*settings);
        let mut begun = BTreeMap::<String, Vec<Tail>>::new();
        let mut ended = Ended::default();
        for carry in kept {
            let found = Tail::decode(&carry.body).filter(|tail| tail.fits(channels, settings));
            let removed = || Carry {
                body: Vec::new(),
                ..carry.clone()
            };
            match (found, carry.journal.strip_prefix(BEGUN_UNDER)) {
                (Some(tail), None) => drop(tails.put(tail)),
                (Some(tail), Some(name)) => {
                    let label = name
                        .strip_prefix(&tail.rod.0)
                        .and_then(|name| name.strip_prefix('/'));
                    begun
                        .entry(label.unwrap_or(name).to_owned())
                        .or_default()
                        .push(tail);
                }
                // The file's records will be others anyway.
                (None, Some(_)) => ended.kept.push(removed()),
                (None, None) => {
                    ended.kept.push(removed());
                    health.fault(
                        Fault::Recording,
                        format!(
                            "rod {}: the samples that its latest file in the watched folder left open come from other channels or record \
                             settings, or from another version of the program; they are left out",
                            carry.journal.trim_start_matches(KEPT_UNDER)
                        ),
                    );
                }
            }
        }
        let joins = Self {
            tails,
            begun,
            wait,
            channels: channels.to_vec(),
            health,
        };
        (joins, ended)
    }

    /// Lets a file go on with what others left open; one that was read before, with what it went on with then.
    pub(super) fn join(&self, label: &str, recording: &mut Recording) {
        let Some(begun) = self.begun.get(label) else {
            return recording.join(&self.tails);
        };
        let own = Tails::new(*self.tails.settings());
        for tail in begun {
            drop(own.put(tail.clone()));
        }
        recording.join(&own);
    }

    /// Bytes that they take.
    pub(super) fn held(&self) -> usize {
        self.tails.held() + self.held_begun()
    }

    fn held_begun(&self) -> usize {
        self.begun.values().flatten().map(Tail::held).sum()
    }

    /// Remembers what a file began with that may be read again, instead of what is known of it; returns the rows that change.
    pub(super) fn keep_begun(&mut self, label: &str, begun: Vec<Tail>) -> Vec<Carry> {
        let mut kept = self.forget_if(|name| *name == *label);
        let held: usize = begun.iter().map(Tail::held).sum();
        if !begun.is_empty() && self.held_begun() + held <= MOST_BYTES {
            for tail in &begun {
                let row = begun_row(tail, label, tail.encode());
                kept.retain(|removed| removed.journal != row.journal);
                kept.push(row);
            }
            self.begun.insert(label.to_owned(), begun);
        }
        kept
    }

    /// Forgets what files of these labels began with; returns the rows to be removed.
    pub(super) fn forget_if(&mut self, is_gone: impl Fn(&str) -> bool) -> Vec<Carry> {
        let gone = self.begun.extract_if(.., |label, _| is_gone(label));
        let rows = gone.flat_map(|(label, tails)| {
            let rows = tails.iter().map(|tail| begun_row(tail, &label, Vec::new()));
            rows.collect::<Vec<_>>()
        });
        rows.collect()
    }

    /// Pool from which files take, and into which they leave.
    pub(super) fn tails(&self) -> &Tails {
        &self.tails
    }

    /// Takes back what files had gone on with that are begun again.
    pub(super) fn give_back<'a>(&self, taken: impl Iterator<Item = &'a Tail>) {
        for tail in taken.filter(|tail| !self.is_of_one_file(tail)) {
            drop(self.tails.put(tail.clone()));
        }
    }

    /// True if a file that was read before began with it: no other goes on with it.
    fn is_of_one_file(&self, tail: &Tail) -> bool {
        let of = |other: &Tail| (&other.rod, &other.file, other.to) == (&tail.rod, &tail.file, tail.to);
        self.begun.values().flatten().any(of)
    }

    /// Takes what files left open at their end, and had `taken` before; `is_in_use` says which rods' samples are being read.
    pub(super) fn left(&self, left: Vec<Tail>, taken: &[Tail], is_in_use: impl Fn(&RodId) -> bool) -> Ended {
        let taken = || taken.iter().filter(|tail| !self.is_of_one_file(tail));
        let is_gone =
            |taken: &&Tail| !left.iter().any(|tail| tail.rod == taken.rod) && !self.tails.has(&taken.rod);
        let gone = taken().filter(is_gone);
        let mut ended = Ended {
            events: Vec::new(),
            kept: gone.map(|tail| carry(&tail.rod, Vec::new())).collect(),
        };
        for tail in left {
            // Files of one topic side by side are copies, most likely.
            let waits = !is_in_use(&tail.rod) && self.held() + tail.held() <= MOST_BYTES;
            let mut row = carry(&tail.rod, Vec::new());
            let over = if waits {
                row.body = tail.encode();
                match self.tails.put(tail) {
                    Ok(before) => {
                        ended.kept.push(row);
                        before
                    }
                    Err(older) => Some(older),
                }
            } else {
                if taken().any(|taken| taken.rod == tail.rod) {
                    ended.kept.push(row);
                }
                Some(tail)
            };
            ended
                .events
                .extend(over.iter().flat_map(|tail| self.events(tail)));
        }
        ended
    }

    /// Ends those that have waited long enough.
    pub(super) fn end_late(&self) -> Ended {
        self.end(self.tails.remove_if(|_, since| since.elapsed() >= self.wait))
    }

    /// Changes channels and settings: what was cut otherwise ends.
    pub(super) fn change(&mut self, channels: &[RodChannels], settings: &RecordSettings) -> Ended {
        let mut ended = self.end(self.tails.remove_if(|tail, _| !tail.fits(channels, settings)));
        let begun = &self.begun;
        let changed: Vec<String> = begun
            .iter()
            .filter(|(_, tails)| !tails.iter().all(|tail| tail.fits(channels, settings)))
            .map(|(label, _)| label.clone())
            .collect();
        ended
            .kept
            .extend(self.forget_if(|label| changed.iter().any(|changed| changed == label)));
        let stay = self.tails.remove_if(|_, _| true);
        self.tails = Tails::new(*settings);
        for tail in stay {
            drop(self.tails.put(tail));
        }
        channels.clone_into(&mut self.channels);
        ended
    }

    fn end(&self, tails: Vec<Tail>) -> Ended {
        Ended {
            events: tails.iter().flat_map(|tail| self.events(tail)).collect(),
            kept: tails.iter().map(|tail| carry(&tail.rod, Vec::new())).collect(),
        }
    }

    fn events(&self, tail: &Tail) -> Vec<(Event, Place)> {
        let ended = catch_unwind(AssertUnwindSafe(|| {
            tail.ended(&self.channels, self.tails.settings())
        }));
        ended.unwrap_or_default().unwrap_or_else(|| {
            let detail = format!(
                "{}: the samples of rod {} that it left open cannot be read; they are left out",
                tail.file, tail.rod
            );
            self.health.fault(Fault::Recording, detail);
            Vec::new()
        })
    }
}

/// Row of the store for what a file began with of a rod; an empty one is removed.
fn begun_row(tail: &Tail, label: &str, body: Vec<u8>) -> Carry {
    Carry {
        journal: format!("{BEGUN_UNDER}{}/{label}", tail.rod),
        part: 0,
        body,
    }
}

/// Row of the store for a rod's open samples; an empty one is removed.
fn carry(rod: &RodId, body: Vec<u8>) -> Carry {
    Carry {
        journal: format!("{KEPT_UNDER}{rod}"),
        part: 0,
        body,
    }
}
