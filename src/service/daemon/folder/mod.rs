//! The watched folder: finds recordings to read, and reads them one step at a time.

mod awaiting;
mod begun;
mod group;
mod growing;
mod joins;
mod lane;
mod listing;
mod scan;
mod span;
mod waits;

use self::awaiting::Awaiting;
pub(super) use self::begun::BEGUN_UNDER;
use self::group::{Group, Read};
pub(super) use self::joins::KEPT_UNDER;
use self::joins::{Ended, Joins};
use self::lane::{Lane, Stamp, has_end, stamp};
use self::listing::name_of;
use self::span::Spanned;
pub(super) use self::waits::Waits;
use super::remembered::Remembered;
use super::supervision::Watch;
use crate::analysis::signal::record::{RecordSettings, RodChannels, RodId};
use crate::recording::read::recordings::FileResult;
use crate::recording::read::{HELD, MOST_READY, Step, Stream};
use crate::service::telemetry::{Beat, Fault, Health};
use crate::site::store::{Carry, FileMark, FileState};
use std::collections::{BTreeSet, HashMap, HashSet, VecDeque};
use std::ffi::OsString;
use std::fs::Metadata;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Least room for the samples of a recording, whatever the journal and the other recordings hold \[bytes\].
const LEAST_ROOM: usize = 16 << 20;
/// Pause before a file that cannot be opened is tried again.
const RETRY: Duration = Duration::from_secs(60);

/// The watched folder.
pub(super) struct Folder {
    path: Arc<Path>,
    /// True if another file system was mounted there since the start.
    was_mount: bool,
    has_subfolders: bool,
    waits: Waits,
    channels: Vec<RodChannels>,
    settings: RecordSettings,
    health: Arc<Health>,
    /// Files read to their end, with their stamps then.
    done: HashMap<OsString, Stamp>,
    /// Finished files to be read, in the order of their first message.
    queue: BTreeSet<(u64, OsString)>,
    queued: HashMap<OsString, Stamp>,
    /// Finished files that are not queued yet.
    awaiting: Awaiting,
    /// Files that could not be opened, or are quarantined, with the time of the next try.
    failed: HashMap<OsString, Instant>,
    /// Growing files put off until they are finished, since all of them together held too much.
    postponed: HashSet<OsString>,
    /// Growing files that are to be read again as finished ones: their writer went back.
    finishing: BTreeSet<OsString>,
    /// Files set aside, each a condition.
    set_aside: BTreeSet<OsString>,
    /// Links that were named.
    links: BTreeSet<OsString>,
    /// Folders that cannot be read, each a condition; the empty path is the watched folder itself.
    unreadable: BTreeSet<PathBuf>,
    /// Finished files that are read.
    finished: Option<Group>,
    /// True if no other file joins them any more.
    is_sealed: bool,
    growing: VecDeque<Lane>,
    /// The next finished file, with its span.
    spanned: Option<Spanned>,
    /// Samples that files read to their end left open.
    joins: Joins,
    /// Steps taken already.
    ready: VecDeque<FolderStep>,
    next_scan: Instant,
    /// Bytes of samples that the journal holds.
    elsewhere: usize,
    /// True if the growing files have the next turn.
    is_turn_of_growing: bool,
    /// Number of growing files that have no place, at the last look.
    crowded: usize,
    /// True at the start, until all finished files present then are read.
    catches_up: bool,
}

/// Step of the folder.
pub(super) type FolderStep = Step<FolderEnd>;

/// End of files that were read as one, or of samples that they left open.
pub(super) struct FolderEnd {
    /// Marks and summaries of the files.
    pub files: Vec<(FileMark, FileResult)>,
    /// Rows of open samples that change with it.
    pub kept: Vec<Carry>,
}

impl Folder {
    pub fn new(
        (path, has_subfolders): (PathBuf, bool),
        waits: Waits,
        channels: &[RodChannels],
        settings: &RecordSettings,
        remembered: &Remembered,
        health: Arc<Health>,
    ) -> Self {
        let marks = &remembered.files;
        let mut set_aside = BTreeSet::new();
        for mark in marks.values() {
            if let (FileState::Quarantined(why), Some(name)) = (&mark.state, name_of(&mark.name)) {
                health.hold(Fault::Quarantined, &mark.name, why);
                set_aside.insert(name);
            }
        }
        let done = marks
            .values()
            .filter_map(|mark| Some((name_of(&mark.name)?, (mark.size, mark.modified_ns))));
        let (joins, ended) = Joins::new(
            &remembered.open,
            channels,
            settings,
            waits.join,
            Arc::clone(&health),
        );
        let awaiting = Awaiting::new(joins.tails().remembering());
        let mut folder = Self {
            path: path.into(),
            was_mount: false,
            has_subfolders,
            waits,
            channels: channels.to_vec(),
            settings: *settings,
            joins,
            ready: VecDeque::new(),
            health,
            done: done.collect(),
            queue: BTreeSet::new(),
            queued: HashMap::new(),
            awaiting,
            failed: HashMap::new(),
            postponed: HashSet::new(),
            finishing: BTreeSet::new(),
            set_aside,
            links: BTreeSet::new(),
            unreadable: BTreeSet::new(),
            finished: None,
            is_sealed: false,
            growing: VecDeque::new(),
            spanned: None,
            next_scan: Instant::now(),
            elsewhere: 0,
            is_turn_of_growing: false,
            crowded: 0,
            catches_up: true,
        };
        folder.tell(ended, Vec::new());
        folder
    }

    /// True while finished files that were present at the start are read: side by side with the journal, by the time of their data.
    pub fn catches_up(&self) -> bool {
        self.catches_up
    }

    /// Log time up to which the finished files are read \[ns since 1970\]; 0 before the first look.
    pub fn at(&self) -> u64 {
        let next = self.queue.first().map_or(0, |(time, _)| *time);
        let finished = self.finished.as_ref();
        finished.map_or(next, Group::at)
    }

    /// True if finished files wait to be read, or are being read.
    pub fn has_backlog(&self) -> bool {
        self.catches_up || self.finished.is_some() || !self.queue.is_empty()
    }

    /// Changes channels, settings and the wait for readings: files not read to their end are begun again. Returns the steps before the
    /// change.
    pub fn change(
        &mut self,
        channels: &[RodChannels],
        settings: &RecordSettings,
        readings_s: f64,
    ) -> impl Iterator<Item = FolderStep> + use<> {
        let growing = self.growing.iter().flat_map(Lane::taken);
        let taken = self.finished.iter().flat_map(Group::taken).chain(growing);
        self.joins.give_back(taken);
        self.waits.set_readings(readings_s);
        let ended = self.joins.change(channels, settings);
        self.tell(ended, Vec::new());
        channels.clone_into(&mut self.channels);
        self.settings = *settings;
        self.finished = None;
        // One that has ended meanwhile is found as finished; others are found as growing.
        self.finishing
            .extend(self.growing.drain(..).map(|lane| lane.name));
        self.next_scan = Instant::now();
        std::mem::take(&mut self.ready).into_iter()
    }

    /// Queues the events of samples that ended, and the end of files behind them.
    fn tell(&mut self, ended: Ended, files: Vec<(FileMark, FileResult)>) {
        let Ended { events, kept } = ended;
        let events = events.into_iter();
        self.ready
            .extend(events.map(|(event, place)| Step::Event(event, place)));
        if !files.is_empty() || !kept.is_empty() {
            self.ready.push_back(Step::File(FolderEnd { files, kept }));
        }
    }

    /// Ends open samples that have waited long enough, unless a file that is there may go on with them.
    fn end_late(&mut self) {
        let is_unread = |lane: &Lane| lane.recording.is_unread() || !lane.has_rested;
        let all_read =
            self.finished.is_none() && self.queue.is_empty() && !self.growing.iter().any(is_unread);
        if all_read && self.postponed.is_empty() && self.crowded == 0 {
            let (awaiting, channels) = (&self.awaiting, &self.channels);
            let ended = self.joins.end_late(|rod| awaiting.has_samples_of(rod, channels));
            self.tell(ended, Vec::new());
        }
    }

    /// Takes one step: a scan if due, or at most one record or chunk of one file. `elsewhere`: bytes of samples
    /// that the journal holds.
    pub fn step(
        &mut self,
        watch: &mut dyn Watch,
        (stop, beat): (&AtomicBool, &Beat),
        elsewhere: usize,
    ) -> FolderStep {
        if let Some(step) = self.ready.pop_front() {
            return step;
        }
        self.elsewhere = elsewhere;
        self.scan_if_due(stop, beat);
        self.open_finished(watch);
        let is_spanning = self.is_spanning();
        if is_spanning || self.finished.is_some() {
            let group_goes_on = self.group_ready() > MOST_READY;
            self.is_turn_of_growing = self.growing_ready() > MOST_READY
                || (!group_goes_on && !self.is_turn_of_growing && !self.catches_up);
            if self.is_turn_of_growing
                && let Some(step) = self.step_growing(watch)
            {
                return step;
            }
        }
        if is_spanning {
            self.step_span(watch);
            return Step::More;
        }
        if let Some(mut group) = self.finished.take() {
            let next = self.queue.first().filter(|_| !self.is_sealed && group.is_open());
            let limit = next.map_or(u64::MAX, |(time, _)| *time);
            let step = group.step(
                watch,
                (self.waits.settle, &self.health),
                (self.room(), limit),
                self.joins.tails(),
            );
            return match step {
                Step::File(lane) => self.end_one(group, *lane, watch),
                step => {
                    self.finished = Some(group);
                    match step {
                        Step::Event(event, place) => Step::Event(event, place),
                        _ => Step::More,
                    }
                }
            };
        }
        if self.queue.is_empty() {
            self.catches_up = false;
        } else {
            return Step::More;
        }
        self.step_growing(watch).unwrap_or(Step::Wait)
    }

    /// Bytes of samples in events that wait to be taken.
    pub fn ready_bytes(&self) -> usize {
        let samples = |step: &FolderStep| match step {
            Step::Event(event, _) => event.samples(),
            _ => 0,
        };
        let ended: usize = self.ready.iter().map(samples).sum();
        8 * ended + self.group_ready() + self.growing_ready()
    }

    fn group_ready(&self) -> usize {
        self.finished.as_ref().map_or(0, Group::ready_bytes)
    }

    fn growing_ready(&self) -> usize {
        self.growing.iter().map(|lane| lane.recording.ready_bytes()).sum()
    }

    /// Room for the samples of a recording: what the journal and all other recordings leave \[bytes\].
    fn room(&self) -> usize {
        HELD.saturating_sub(self.elsewhere + self.held()).max(LEAST_ROOM)
    }

    /// Bytes of samples of all recordings, not yet in a record or in records not yet taken.
    pub fn held(&self) -> usize {
        let growing: usize = self.growing.iter().map(|lane| lane.held).sum();
        growing + self.finished.as_ref().map_or(0, Group::held) + self.joins.held()
    }

    /// Notes that a file was read to its end.
    fn read(&mut self, lane: &mut Lane, watch: &dyn Watch) -> Read {
        let (size, modified_ns) = lane.stamp;
        watch.is_read(&lane.label);
        let quarantined = lane.guard.end(&lane.label);
        if quarantined.is_some() {
            self.set_aside.insert(lane.name.clone());
            // One that goes on growing is not worth every scan.
            self.failed.insert(lane.name.clone(), Instant::now() + RETRY);
        }
        // What has no end of a recording may grow on, and what grew meanwhile is read again from its start.
        let is_now = |data: Metadata| stamp(&data) == lane.stamp;
        let is_whole = has_end(&lane.file) && lane.file.metadata().is_ok_and(is_now);
        let is_final = quarantined.is_some() || is_whole;
        let summary = lane.recording.summary().clone();
        let losses = summary.faults();
        let read = match losses.is_empty() {
            true => FileState::Done,
            false => FileState::Incomplete(losses.join("; ")),
        };
        let mark = FileMark {
            name: lane.label.to_string(),
            size,
            modified_ns,
            state: quarantined.map_or(read, FileState::Quarantined),
        };
        Read {
            name: lane.name.clone(),
            stamp: lane.stamp,
            mark,
            summary,
            begun: lane
                .recording
                .began_with()
                .filter(|_| !is_final)
                .cloned()
                .collect(),
            is_final,
            known_by: lane.known_by(),
        }
    }

    /// Ends a finished file; with the last of its group, all of the group are done.
    fn end_one(&mut self, mut group: Group, mut lane: Lane, watch: &dyn Watch) -> FolderStep {
        let read = self.read(&mut lane, watch);
        if !group.keep(read) {
            self.finished = Some(group);
            return Step::More;
        }
        let (stream, read, taken) = group.into_parts();
        let (events, left) = match stream {
            Some(stream) => stream.into_ended(),
            None => (Vec::new(), lane.take_left()),
        };
        let mut ended = self.joins.left(left, &taken, |rod| self.is_in_use(rod));
        ended.events.splice(0..0, events);
        self.done_with(ended, read)
    }

    /// True if a file that is read has samples of a rod.
    fn is_in_use(&self, rod: &RodId) -> bool {
        let finished = self.finished.as_ref();
        finished.is_some_and(|group| group.has_begun(rod))
            || self.growing.iter().any(|lane| lane.recording.has_begun(rod))
    }

    fn done_with(&mut self, mut ended: Ended, read: Vec<Read>) -> FolderStep {
        let mut files = Vec::with_capacity(read.len());
        for read in read {
            self.finishing.remove(&read.name);
            self.done.insert(read.name, read.stamp);
            let (begun, name) = (&mut self.joins.begun, &read.mark.name);
            ended.kept.extend(match read.known_by {
                _ if read.is_final => begun.forget_if(|label, _| label == name),
                Some(begins) => begun.keep(name, begins, read.begun),
                None => Vec::new(),
            });
            files.push((read.mark, Ok(read.summary)));
        }
        self.tell(ended, files);
        self.ready.pop_front().unwrap_or(Step::More)
    }

    /// Begins with the oldest finished file, or lets those join whose time has come.
    fn open_finished(&mut self, watch: &dyn Watch) {
        loop {
            match (&self.finished, self.queue.first()) {
                (None, Some(_)) => self.is_sealed = false,
                (Some(group), Some((begins, _)))
                    if !self.is_sealed && group.is_open() && group.has_come_to(*begins) => {}
                _ => return,
            }
            let Some((begins, name)) = self.queue.first().cloned() else {
                return;
            };
            if !self.knows_span(&name, watch) {
                return;
            }
            self.queue.pop_first();
            let found_bytes = self.queued.get(&name).map(|(bytes, _)| *bytes);
            let opened = self.open(&name).and_then(|file| {
                // One that was written to since is found again as what it is now.
                if Some(file.metadata()?.len()) != found_bytes {
                    return Err(io::ErrorKind::NotFound.into());
                }
                let span = self.span_of(&name);
                if let Some(group) = &mut self.finished
                    && (span.as_ref()).is_none_or(|span| !group.takes(span, self.joins.tails()))
                {
                    return Ok(None);
                }
                let begun = Lane::begin(&self.path, &name, file, false, &self.channels, &self.settings);
                let mut lane = begun.map_err(|error| io::Error::other(error.to_string()))?;
                if !has_end(&lane.file) {
                    lane.recording.note_start();
                }
                self.joins.join(&mut lane);
                Ok(Some((lane, span)))
            });
            match opened {
                // It has a topic of another one's at the same time, goes on elsewhere, or is read alone: its turn comes when the group is done.
                Ok(None) => {
                    self.is_sealed = true;
                    self.queue.insert((begins, name));
                    return;
                }
                Ok(Some((lane, span))) => {
                    self.spanned = None;
                    self.queued.remove(&name);
                    self.postponed.remove(&name);
                    match (&mut self.finished, span) {
                        (Some(group), Some(span)) => group.add(lane, begins, span),
                        (finished, span) => {
                            let stream = span.map(|span| {
                                let mut stream = Stream::new(&self.channels, &self.settings);
                                stream.add(span);
                                stream
                            });
                            *finished = Some(Group::of(lane, begins, stream));
                        }
                    }
                }
                Err(fault) => {
                    self.queued.remove(&name);
                    self.finishing.remove(&name);
                    self.spanned = None;
                    // It may have been removed or changed meanwhile.
                    if fault.kind() != io::ErrorKind::NotFound {
                        self.cannot_open(&name, &fault);
                    }
                }
            }
        }
    }
}
