//! One site: the trackers of its rods, folded in the order records come, and the store they commit to.

mod open;
mod picture;
mod view;

pub use open::others_in;

use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{Reading, RodId, Timestamp, is_one_motion};
use crate::analysis::track::{AlarmEvent, RodState, State, Tracker, Verdict};
use crate::site::analyse::Analysed;
use crate::site::found::Found;
use crate::site::motion;
use crate::site::pictures::Pictures;
use crate::site::record_row::RecordRow;
use crate::site::resumption::Renewed;
use crate::site::store::{
    Asked, Carry, Commit, ConditionEvent, FileMark, NewRecord, Position, Reserved, RodRow, SnapshotRow,
    Store, StoreError, Stretch,
};
use std::collections::BTreeMap;

/// Trackers of a site's rods, and their store.
pub struct Site {
    trackers: BTreeMap<RodId, Tracker>,
    emulators: BTreeMap<RodId, &'static str>,
    /// States of rods with alarms that are no longer configured.
    retired: BTreeMap<RodId, State>,
    store: Store,
    config_hash: String,
    renewed: Vec<Renewed>,
    unfollowed: Vec<RodId>,
    /// Time since which each rod has been expected, by a daemon.
    expected: BTreeMap<RodId, Timestamp>,
    /// Pictures of records that come without samples; `None` where samples come.
    pictures: Option<Pictures>,
}

/// Result of one new record: its row, and its changes.
pub struct Taken {
    /// Row for the store.
    pub row: RecordRow,
    /// Verdict of tracking.
    pub verdict: Verdict,
    /// Refusal that it was taken as where its motion had a row already.
    pub late: Option<Outcome>,
}

impl Taken {
    /// The outcome as it was taken.
    pub fn outcome<'a>(&'a self, given: &'a Outcome) -> &'a Outcome {
        self.late.as_ref().unwrap_or(given)
    }
}

/// State of a daemon besides records.
#[derive(Debug, Clone, Copy)]
pub enum Note<'a> {
    /// Files were read to their ends.
    Files {
        /// Their marks.
        marks: &'a [FileMark],
        /// Open samples that they leave for the next part or file.
        carry: &'a [Carry],
    },
    /// A sink has all events up to a number.
    Delivered {
        /// Id of the sink.
        sink: &'a str,
        /// Number of the latest event delivered.
        through: i64,
    },
}

impl Site {
    /// Expects records of its rods from now on, by the machine's clock, or continues to.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn expect_rods(&mut self, now: Timestamp) -> Result<(), StoreError> {
        let rods: Vec<&RodId> = self.trackers.keys().collect();
        self.expected = self.store.expect_rods(&rods, now)?;
        Ok(())
    }

    /// Takes records without samples from now on: views of them take waveform and spectrum from `pictures`, and are
    /// left out where these have none.
    pub fn without_samples(self, pictures: Pictures) -> Self {
        Self {
            pictures: Some(pictures),
            ..self
        }
    }

    /// Closes the site and keeps its store's lock.
    pub fn reserve(self) -> Option<Reserved> {
        self.store.reserve()
    }

    /// See [`Store::keep_lock`].
    ///
    /// # Errors
    /// Another process has the lock, or the file system refuses.
    pub fn keep_lock(&mut self) -> Result<bool, StoreError> {
        self.store.keep_lock()
    }

    /// Store of the site.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Runs several changes that become durable, and visible to others, at once.
    ///
    /// # Errors
    /// As of the changes; the site must be closed, none of them was kept.
    pub fn together<T>(
        &mut self,
        act: impl FnOnce(&mut Self) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.store.begin_group()?;
        let value = act(self)?;
        self.store.end_group()?;
        Ok(value)
    }

    /// Takes the outcome of one record and makes it durable; `None` if the store has the record already, or
    /// the site does not have its rod. Requests about the rod are applied first.
    ///
    /// # Errors
    /// The store refuses: nothing of the record was kept, and nothing more can be.
    pub fn take(
        &mut self,
        outcome: &Outcome,
        position: Option<Position<'_>>,
    ) -> Result<Option<Taken>, StoreError> {
        let rod = outcome.rod();
        let Some(identity) = outcome.identity() else {
            return Ok(None);
        };
        if self.store.known(rod, &identity) {
            return Ok(None);
        }
        let late = match self.has_row(outcome)? {
            true => Some(motion::late(outcome)),
            false => None,
        };
        let outcome = late.as_ref().unwrap_or(outcome);
        let Some(input) = outcome.input() else {
            return Ok(None);
        };
        self.do_as_asked(rod)?;
        let before = self.trackers.get(rod).and_then(|tracker| tracker.state().latest);
        let Some(verdict) = Tracker::step_among(&mut self.trackers, rod, &input) else {
            return Ok(None);
        };
        let Some(tracker) = self.trackers.get(rod) else {
            return Ok(None);
        };
        let snapshot = self.picture(tracker, outcome, before)?;
        let row = RecordRow::of(outcome, Some(&verdict), &self.config_hash);
        let found = Found::of(outcome);
        self.store.commit(&Commit {
            record: Some(NewRecord {
                row: &row,
                identity,
                found: found.as_ref(),
                rms: outcome.rms(),
                emulator: self.emulators.get(rod).copied().unwrap_or_default(),
            }),
            rod: Some(RodRow {
                state: tracker.state(),
                stands: &verdict.state,
                closed: &verdict.closed,
                events: &verdict.events,
            }),
            snapshot: snapshot.as_ref().map(|snapshot| SnapshotRow {
                rod,
                segment: verdict.segment,
                snapshot,
            }),
            source: position,
            ..Commit::default()
        })?;
        Ok(Some(Taken { row, verdict, late }))
    }

    /// True if the motion of a rod with several sensors has a row.
    fn has_row(&self, outcome: &Outcome) -> Result<bool, StoreError> {
        let Some(span) = motion::span(outcome) else {
            return Ok(false);
        };
        let known = self
            .store
            .spans_before(outcome.rod(), span.0.plus_seconds(span.1))?;
        Ok(known.into_iter().any(|known| is_one_motion(known, span)))
    }

    /// Takes the result of an event and makes it durable; `before` is the record of its rod that passed
    /// before it. `None` unless it is a new record.
    ///
    /// # Errors
    /// As [`Site::take`] and [`Site::take_readings`].
    pub fn take_event(
        &mut self,
        analysed: &Analysed,
        position: Option<Position<'_>>,
        before: Option<[u8; 32]>,
    ) -> Result<Option<Taken>, StoreError> {
        match analysed {
            Analysed::Record(outcome) => self.take(outcome, position),
            Analysed::Readings(rod, readings) => self.take_readings(rod, readings, before).map(|_| None),
            Analysed::Known(..) => Ok(None),
        }
    }

    /// Takes temperatures of a recording that belong to no record and makes them durable; returns true if any
    /// were new.
    ///
    /// `after` is the rod's record that came before them. They count only where that is the record the rod took last: so
    /// the same recording read again, or the same run begun again, changes nothing.
    ///
    /// # Errors
    /// The store refuses: nothing of them was kept.
    pub fn take_readings(
        &mut self,
        rod: &RodId,
        readings: &[Reading],
        after: Option<[u8; 32]>,
    ) -> Result<bool, StoreError> {
        let Some(tracker) = self.trackers.get_mut(rod) else {
            return Ok(false);
        };
        let Some(last) = readings.last() else {
            return Ok(false);
        };
        if self.store.last_identity(rod)? != after {
            return Ok(false);
        }
        let is_new = tracker.take_readings(readings);
        // Kept also if this fold has no use for them: that of other settings may.
        self.store.commit(&Commit {
            readings: Some((rod, last.time.as_nanos(), &Found::of_readings(readings))),
            rod: is_new.then_some(row(tracker, &tracker.rod_state(), &[])),
            ..Commit::default()
        })?;
        Ok(is_new)
    }

    /// Checks for missing data of a rod that has been silent for `elapsed_s` \[s\]; returns the alarm events.
    ///
    /// # Errors
    /// The store refuses: nothing of it was kept.
    pub fn look_at_clock(&mut self, rod: &RodId, elapsed_s: f64) -> Result<Vec<AlarmEvent>, StoreError> {
        let Some(tracker) = self.trackers.get_mut(rod) else {
            return Ok(Vec::new());
        };
        let awaited = self.expected.get(rod).copied();
        let Some(since) = tracker.state().latest.or(awaited) else {
            return Ok(Vec::new());
        };
        let now = since.plus_seconds(elapsed_s);
        let events = match (tracker.state().latest, awaited) {
            (None, Some(awaited)) => tracker.await_first(now, awaited),
            _ => tracker.look_at_clock(now),
        };
        if !events.is_empty() {
            self.store.commit(&Commit {
                rod: Some(row(tracker, &tracker.rod_state(), &events)),
                ..Commit::default()
            })?;
        }
        Ok(events)
    }

    /// Stores notices about the daemon itself, and that it is working.
    ///
    /// # Errors
    /// The store refuses: nothing of it was kept.
    pub fn watch(&mut self, notices: &[ConditionEvent], stretch: Stretch) -> Result<(), StoreError> {
        self.store.watch(notices, Some(stretch))
    }

    /// Applies the requests about any rod of the site, in their order; returns their number.
    ///
    /// # Errors
    /// The store returned an error: requests not applied yet still wait.
    pub fn apply_requests(&mut self) -> Result<usize, StoreError> {
        let mut applied = 0;
        let asked = self.store.rods_asked()?;
        let is_retired = asked.iter().any(|rod| self.retired.contains_key(rod));
        for rod in &asked {
            applied += self.do_as_asked(rod)?;
        }
        if is_retired {
            applied += self.store.acknowledge_waiting(&mut self.retired)?.0;
        }
        Ok(applied)
    }

    /// Stores the state of a daemon's sources and sinks.
    ///
    /// # Errors
    /// The store refuses: nothing of it was kept.
    pub fn note(&mut self, note: Note<'_>) -> Result<(), StoreError> {
        let commit = match note {
            Note::Files { marks, carry } => Commit {
                files: marks,
                carry,
                ..Commit::default()
            },
            Note::Delivered { sink, through } => Commit {
                delivered: Some((sink, through)),
                ..Commit::default()
            },
        };
        self.store.commit(&commit)
    }

    /// Removes JSON lines that are older than `keep_s` before the rod's latest record \[s\], a few at a time: see
    /// [`Store::forget_lines`]. With `copied_to`, a sink that copies the store, only what it has.
    ///
    /// # Errors
    /// The store refuses.
    pub fn forget_lines(
        &mut self,
        rod: &RodId,
        keep_s: f64,
        from: Option<Timestamp>,
        copied_to: Option<&str>,
    ) -> Result<Option<Timestamp>, StoreError> {
        let latest = self.trackers.get(rod).and_then(|tracker| tracker.state().latest);
        let Some(latest) = latest else { return Ok(from) };
        let unsent = match copied_to {
            Some(sink) => self
                .store
                .first_record_after(self.store.delivered(sink)?.unwrap_or(0))?,
            None => None,
        };
        self.store
            .forget_lines(rod, from, latest.plus_seconds(-keep_s), unsent)
    }

    /// Applies the requests about a rod, in their order; returns their number.
    fn do_as_asked(&mut self, rod: &RodId) -> Result<usize, StoreError> {
        let Some(tracker) = self.trackers.get_mut(rod) else {
            return Ok(0);
        };
        let requests = self.store.waiting(rod)?;
        for request in &requests {
            let events = match &request.what {
                Asked::Acknowledge { alarm, .. } => tracker.acknowledge(alarm, request.asked),
                Asked::Rebaseline { .. } => {
                    if let Some(latest) = behind(tracker.state().latest, request.asked) {
                        tracing::warn!(
                            "rod {rod}: the new baseline begins with the next record, but the latest is of {latest} and it was asked \
                             for at {}: the next records may be from before the work",
                            request.asked
                        );
                    }
                    tracker.rebaseline(None)
                }
            };
            self.store.commit(&Commit {
                rod: Some(row(tracker, &tracker.rod_state(), &events)),
                applied: Some(request.number),
                ..Commit::default()
            })?;
        }
        Ok(requests.len())
    }
}

/// Latest record of a rod if it is more than a day older than a request: others from before the request may come yet.
pub fn behind(latest: Option<Timestamp>, asked: Timestamp) -> Option<Timestamp> {
    latest.filter(|latest| asked.seconds_since(*latest) > 86_400.0)
}

/// Change of a rod without a record.
fn row<'a>(tracker: &'a Tracker, stands: &'a RodState, events: &'a [AlarmEvent]) -> RodRow<'a> {
    RodRow {
        state: tracker.state(),
        stands,
        closed: &[],
        events,
    }
}
