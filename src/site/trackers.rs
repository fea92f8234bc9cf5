//! One site: the trackers of its rods, folded in the order records come, and the store they commit to.

use crate::analysis::outcome::Outcome;
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::{Reading, RodId, Timestamp, is_one_motion};
use crate::analysis::track::alarm::Board;
use crate::analysis::track::{AlarmEvent, Kind, RodState, State, TrackPlan, Tracker, Verdict};
use crate::site::analyse::Analysed;
use crate::site::found::Found;
use crate::site::motion;
use crate::site::pictures::Pictures;
use crate::site::prepared::Provenance;
use crate::site::record_row::RecordRow;
use crate::site::resumption::{self, Renewed, Resumed};
use crate::site::store::{
    Asked, Carry, Commit, ConditionEvent, FileMark, NewRecord, Position, Reserved, RodRow, SnapshotRow,
    Standing, Store, StoreError, Stretch,
};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

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

/// Interval between snapshots of records \[s\].
const PICTURE_S: i64 = 600;

/// True if a record is the first of its stretch of [`PICTURE_S`], or the clock went back: by event time
/// alone, so that a replay keeps the same snapshots.
fn keeps_snapshot(before: Option<Timestamp>, start: Timestamp) -> bool {
    let stretch = |time: Timestamp| time.as_nanos().div_euclid(PICTURE_S * 1_000_000_000);
    before.is_none_or(|before| stretch(start) != stretch(before))
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
    /// Resumes from the store. A rod whose numbers have another meaning now begins a new segment, or goes on with one of before.
    ///
    /// # Errors
    /// The store cannot be read or written.
    pub fn open(
        plans: impl IntoIterator<Item = Arc<TrackPlan>>,
        mut store: Store,
        provenance: Provenance<'_>,
    ) -> Result<Self, StoreError> {
        store.keep_config(provenance.hash, provenance.site, provenance.effective)?;
        let mut states = store.states()?;
        let unfollowed_before = store.unfollowed()?;
        let (mut trackers, mut emulators) = (BTreeMap::new(), BTreeMap::new());
        let (mut renewed, mut fresh) = (Vec::new(), Vec::new());
        for plan in plans {
            let rod = plan.rod().clone();
            emulators.insert(rod.clone(), plan.emulator());
            let tracker = match states.remove(&rod) {
                None => {
                    fresh.push(rod.clone());
                    Tracker::new(plan)
                }
                Some(state) => {
                    let resumed = resumption::resume(&mut store, plan, state)?;
                    let Resumed { tracker, events, .. } = resumed;
                    let is_renewed = resumed.renewed.is_some();
                    renewed.extend(resumed.renewed);
                    if is_renewed || unfollowed_before.contains(&rod) {
                        store.commit(&Commit {
                            rod: Some(row(&tracker, &tracker.rod_state(), &events)),
                            ..Commit::default()
                        })?;
                    }
                    tracker
                }
            };
            trackers.insert(rod, tracker);
        }
        if !fresh.is_empty() {
            // A rod has a row before anything has come of it.
            store.begin_group()?;
            for tracker in fresh.iter().filter_map(|rod| trackers.get(rod)) {
                store.commit(&Commit {
                    rod: Some(row(tracker, &tracker.rod_state(), &[])),
                    ..Commit::default()
                })?;
            }
            store.end_group()?;
        }
        let (untouched, mut retired): (BTreeMap<_, _>, BTreeMap<_, _>) =
            states.into_iter().partition(|(_, state)| state.is_untouched());
        for state in untouched.into_values() {
            forget(&mut store, state)?;
        }
        // A rod of another site with the same store is not gone.
        let mut unfollowed = Vec::new();
        if sites_in(&store)?.len() == 1 {
            for state in retired.values_mut() {
                if !unfollowed_before.contains(&state.rod) {
                    unfollowed.push(state.rod.clone());
                    store.retire(state)?;
                }
            }
        }
        retired.retain(|_, state| !state.alarms.is_empty());
        Ok(Self {
            trackers,
            emulators,
            retired,
            store,
            config_hash: provenance.hash.to_owned(),
            renewed,
            unfollowed,
            expected: BTreeMap::new(),
            pictures: None,
        })
    }

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

    /// Continues with another configuration and the same store.
    ///
    /// # Errors
    /// The store cannot be read or written; the site is given up.
    pub fn reload(
        self,
        plans: impl IntoIterator<Item = Arc<TrackPlan>>,
        provenance: Provenance<'_>,
    ) -> Result<Self, StoreError> {
        Self::open(plans, self.store, provenance)
    }

    /// Rods whose numbers have another meaning since the site was opened.
    pub fn renewed(&self) -> &[Renewed] {
        &self.renewed
    }

    /// Rods of the store that the configuration had until the site was opened.
    pub fn unfollowed(&self) -> &[RodId] {
        &self.unfollowed
    }

    /// Rods with the start of their latest accepted record.
    pub fn latest(&self) -> impl Iterator<Item = (&RodId, Option<Timestamp>)> {
        self.trackers
            .iter()
            .map(|(rod, tracker)| (rod, tracker.state().latest))
    }

    /// Rods with the time since which each is silent: since its latest record, or since it is expected.
    pub fn silent_since(&self) -> impl Iterator<Item = (&RodId, Option<Timestamp>)> {
        self.latest()
            .map(|(rod, latest)| (rod, latest.or_else(|| self.expected.get(rod).copied())))
    }

    /// Rods without any accepted record, or without one for too long.
    pub fn unheard(&self) -> impl Iterator<Item = &RodId> {
        let is_unheard = |state: &State| {
            let is_silent = |kind: Kind| kind == Kind::NoData;
            let mut standing = state.alarms.iter().filter(|alarm| alarm.cleared.is_none());
            state.latest.is_none() || standing.any(|alarm| is_silent(alarm.kind))
        };
        self.trackers
            .iter()
            .filter(move |(_, tracker)| is_unheard(tracker.state()))
            .map(|(rod, _)| rod)
    }

    /// Rods of which no temperature reading was ever believed, with the time since which they are expected, if records of them came.
    pub fn unread(&self) -> impl Iterator<Item = (&RodId, Option<Timestamp>)> {
        let of_unread = self
            .trackers
            .iter()
            .filter(|(_, tracker)| tracker.state().thermometer.trusted_until().is_none());
        of_unread.map(|(rod, tracker)| {
            let since = tracker.state().latest.and_then(|_| self.expected.get(rod));
            (rod, since.copied())
        })
    }

    /// Status of its rods; the store may have others, which are no longer configured.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn standings(&self) -> Result<Vec<Standing>, StoreError> {
        let mut standings = self.store.standings()?;
        standings.retain(|standing| self.trackers.contains_key(&standing.rod));
        Ok(standings)
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
        // Only of the latest record in use: a snapshot with a wrong clock would stay for years.
        let snapshot = match outcome {
            Outcome::Identified(identification) => identification
                .measurement
                .as_ref()
                .map(|measurement| measurement.start)
                .filter(|start| tracker.state().latest == Some(*start) && before != Some(*start))
                .filter(|start| tracker.state().periods.is_empty() || keeps_snapshot(before, *start))
                .and_then(|_| Snapshot::of(tracker.plan().prior(), identification)),
            Outcome::Tabulated(_) => None,
            // The snapshot of a refused record shows the reason. It is kept as rarely, and never replaces that of a used record.
            Outcome::Rejected(rejected) => {
                let before = self.store.refused_picture(rod)?;
                let has_period = !tracker.state().periods.is_empty();
                rejected
                    .start
                    .filter(|start| !has_period || keeps_snapshot(before, *start))
                    .and_then(|_| Snapshot::of_rejected(rejected))
            }
        };
        let snapshot = match &self.pictures {
            None => snapshot,
            Some(pictures) => snapshot.and_then(|snapshot| pictures.complete(rod, snapshot)),
        };
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

/// Removes a rod from the store that is no longer configured and never had data; its alarm of missing data
/// ends.
fn forget(store: &mut Store, mut state: State) -> Result<(), StoreError> {
    let rod = state.rod.clone();
    if let Some(told) = state.alarms.iter().map(|alarm| alarm.told).max() {
        let mut board = Board::new(&rod, state.segment.number, &mut state.alarms);
        board.clear_all(told);
        let events = board.into_events();
        store.commit(&Commit {
            rod: Some(RodRow {
                stands: &RodState::Learning {
                    records: 0,
                    periods: 0,
                },
                state: &state,
                closed: &[],
                events: &events,
            }),
            ..Commit::default()
        })?;
    }
    store.forget_rod(&rod)
}

fn sites_in(store: &Store) -> Result<BTreeSet<String>, StoreError> {
    Ok(store.configs()?.into_iter().map(|[_, site, _]| site).collect())
}

/// Other sites with records in a store.
///
/// # Errors
/// The store cannot be read.
pub fn others_in(store: &Store, site: &str) -> Result<Vec<String>, StoreError> {
    let sites = sites_in(store)?;
    if sites.contains(site) {
        return Ok(Vec::new());
    }
    Ok(sites.into_iter().collect())
}
