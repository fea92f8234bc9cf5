//! Open samples at the ends of the folder's files: they wait a while for the file that goes on there.

use super::begun::{BEGUN_UNDER, Begun};
use super::lane::Lane;
use crate::analysis::signal::record::{Event, RecordSettings, RodChannels, RodId};
use crate::recording::read::{Place, Tail, TailEnd, Tails};
use crate::service::telemetry::{Fault, Health};
use crate::site::store::Carry;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Beginning of the names under which the store keeps them, before the rod's id.
pub(in crate::service::daemon) const KEPT_UNDER: &str = "folder/";

/// Most bytes of open samples of all rods; beyond, records end with their files.
const MOST_BYTES: usize = 32 << 20;

/// Open samples of the files read so far.
pub(super) struct Joins {
    tails: Tails,
    /// Those with which files began that may be read again.
    pub(super) begun: Begun,
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
        let mut begun = Begun::default();
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
                    if !begun.load(name, tail) {
                        ended.kept.push(removed());
                    }
                }
                // The file's records will be others anyway.
                (None, Some(_)) => ended.kept.push(removed()),
                (None, None) => {
                    ended.kept.push(removed());
                    if Tail::decode(&carry.body).is_some_and(|tail| tail.is_memory()) {
                        continue;
                    }
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
    pub(super) fn join(&self, lane: &mut Lane) {
        let Some(begun) = self.begun.of(&lane.label, lane.begins) else {
            return lane.recording.join(&self.tails);
        };
        let own = Tails::new(*self.tails.settings());
        for tail in begun {
            drop(own.put(tail.clone()));
        }
        lane.recording.join(&own);
        lane.is_again = true;
    }

    /// Bytes that they take.
    pub(super) fn held(&self) -> usize {
        self.tails.held() + self.begun.held()
    }

    /// Pool from which files take, and into which they leave.
    pub(super) fn tails(&self) -> &Tails {
        &self.tails
    }

    /// Takes back what files had gone on with that are begun again.
    pub(super) fn give_back<'a>(&self, taken: impl Iterator<Item = &'a Tail>) {
        for tail in taken {
            drop(self.tails.put(tail.clone()));
        }
    }

    /// Takes what files left open at their end, and had `taken` before; `is_in_use` says which rods' samples are being read.
    pub(super) fn left(&self, left: Vec<Tail>, taken: &[Tail], is_in_use: impl Fn(&RodId) -> bool) -> Ended {
        let is_gone =
            |taken: &&Tail| !left.iter().any(|tail| tail.rod == taken.rod) && !self.tails.has(&taken.rod);
        let gone = taken.iter().filter(is_gone);
        let mut ended = Ended {
            events: Vec::new(),
            kept: gone.map(|tail| carry(&tail.rod, Vec::new())).collect(),
        };
        for tail in left {
            // Files of one topic side by side are copies, most likely.
            let waits = !is_in_use(&tail.rod) && self.tails.held() + tail.held() <= MOST_BYTES;
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
                if taken.iter().any(|taken| taken.rod == tail.rod) {
                    ended.kept.push(row);
                }
                Some(tail)
            };
            ended
                .events
                .extend(over.iter().flat_map(|tail| self.ended(tail).events));
        }
        ended
    }

    /// Ends those that have waited long enough, but for rods with a file that may go on with them.
    pub(super) fn end_late(&self, goes_on: impl Fn(&RodId) -> bool) -> Ended {
        let is_late = |tail: &Tail, since: Instant| {
            !tail.is_memory() && since.elapsed() >= self.wait && !goes_on(&tail.rod)
        };
        self.end(self.tails.remove_if(is_late), true)
    }

    /// Changes channels and settings: what was cut otherwise ends.
    pub(super) fn change(&mut self, channels: &[RodChannels], settings: &RecordSettings) -> Ended {
        let mut ended = self.end(
            self.tails.remove_if(|tail, _| !tail.fits(channels, settings)),
            false,
        );
        let changed = self.begun.forget_if(|_, tail| !tail.fits(channels, settings));
        ended.kept.extend(changed);
        let stay = self.tails.remove_if(|_, _| true);
        self.tails = Tails::new(*settings);
        for tail in stay {
            drop(self.tails.put(tail));
        }
        channels.clone_into(&mut self.channels);
        ended
    }

    /// Ends some; `remembers`: readings stay for samples still to come.
    fn end(&self, tails: Vec<Tail>, remembers: bool) -> Ended {
        let mut ended = Ended::default();
        for tail in tails {
            let TailEnd { events, remembered } = self.ended(&tail);
            ended.events.extend(events);
            let remembered = remembered.filter(|_| remembers);
            let body = remembered.as_ref().map_or_else(Vec::new, Tail::encode);
            ended.kept.push(carry(&tail.rod, body));
            if let Some(remembered) = remembered {
                drop(self.tails.put(remembered));
            }
        }
        ended
    }

    fn ended(&self, tail: &Tail) -> TailEnd {
        let ended = catch_unwind(AssertUnwindSafe(|| {
            tail.ended(&self.channels, self.tails.settings())
        }));
        ended.unwrap_or_default().unwrap_or_else(|| {
            let detail = format!(
                "{}: the samples of rod {} that it left open cannot be read; they are left out",
                tail.file, tail.rod
            );
            self.health.fault(Fault::Recording, detail);
            TailEnd::default()
        })
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
