//! The watched folder: finds recordings to read, and reads them one step at a time.

use super::steps::{Guard, Watch};
use crate::analysis::signal::record::{RecordSettings, RodChannels};
use crate::recording::read::folder::first_time;
use crate::recording::read::recordings::FileResult;
use crate::recording::read::series::modified_ns;
use crate::recording::read::{HELD, Recording, SourceError, Step};
use crate::service::telemetry::{Fault, Health};
use crate::site::store::{FileMark, FileState};
use rustix::fs::{Mode, OFlags};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet, VecDeque};
use std::convert::Infallible;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Metadata};
use std::io::{self, Read, Seek, SeekFrom};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

/// Shortest time between two scans.
const SCAN_EVERY: Duration = Duration::from_secs(1);
/// Scans take at most one part in this many of the time.
const SCAN_SHARE: u32 = 20;
/// Most growing recordings read at once.
const MOST_GROWING: usize = 64;
/// Most bytes that growing recordings may hold together; beyond, the largest is read when it is finished.
const GROWING_BYTES: usize = 32 << 20;
/// Least room for the samples of a recording, whatever the journal and the other recordings hold \[bytes\].
const LEAST_ROOM: usize = 16 << 20;
/// Pause before a file that cannot be opened is tried again.
const RETRY: Duration = Duration::from_secs(60);

/// Size \[bytes\] and time of change \[ns since 1970\] of a file, to detect changes.
type Stamp = (u64, i64);

fn stamp(data: &Metadata) -> Stamp {
    (data.len(), data.modified().map_or(0, modified_ns))
}

/// The watched folder.
pub(super) struct Folder {
    path: PathBuf,
    settle: Duration,
    channels: Vec<RodChannels>,
    settings: RecordSettings,
    health: Arc<Health>,
    /// Files read to their end, with their stamps then.
    done: HashMap<OsString, Stamp>,
    /// Finished files to be read, in the order of their first message.
    queue: BTreeSet<(u64, OsString)>,
    queued: HashMap<OsString, Stamp>,
    /// Files that could not be opened, or are quarantined, with the time of the next try.
    failed: HashMap<OsString, Instant>,
    /// Growing files put off until they are finished, since all of them together held too much.
    postponed: HashSet<OsString>,
    /// Files set aside, each a condition.
    set_aside: BTreeSet<OsString>,
    finished: Option<Lane>,
    growing: VecDeque<Lane>,
    next_scan: Instant,
    /// Bytes of samples that the journal holds.
    elsewhere: usize,
    /// True if the growing files have the next turn.
    is_turn_of_growing: bool,
    /// True if finished files come first: at the start, until all present then are read.
    catches_up: bool,
}

/// A file that is being read.
struct Lane {
    name: OsString,
    label: Arc<str>,
    recording: Recording,
    guard: Guard,
    file: File,
    is_live: bool,
    /// Stamp when reading began, or when it was last seen to grow.
    stamp: Stamp,
    grew: Instant,
    /// True if another file has its name now.
    is_replaced: bool,
    /// Bytes in memory after its latest step.
    held: usize,
}

/// Step of the folder; the end of a file comes with its mark.
pub(super) type FolderStep = Step<(FileMark, FileResult)>;

impl Folder {
    pub fn new(
        path: PathBuf,
        settle: Duration,
        channels: &[RodChannels],
        settings: &RecordSettings,
        marks: &BTreeMap<String, FileMark>,
        health: Arc<Health>,
    ) -> Self {
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
        Self {
            path,
            settle,
            channels: channels.to_vec(),
            settings: *settings,
            health,
            done: done.collect(),
            queue: BTreeSet::new(),
            queued: HashMap::new(),
            failed: HashMap::new(),
            postponed: HashSet::new(),
            set_aside,
            finished: None,
            growing: VecDeque::new(),
            next_scan: Instant::now(),
            elsewhere: 0,
            is_turn_of_growing: false,
            catches_up: true,
        }
    }

    /// True if files that were present at the start come before everything live.
    pub fn catches_up(&self) -> bool {
        self.catches_up
    }

    /// True if finished files wait to be read, or are being read.
    pub fn has_backlog(&self) -> bool {
        self.catches_up || self.finished.is_some() || !self.queue.is_empty()
    }

    /// Changes channels and settings: files not read to their end are begun again.
    pub fn change(&mut self, channels: &[RodChannels], settings: &RecordSettings) {
        channels.clone_into(&mut self.channels);
        self.settings = *settings;
        self.finished = None;
        self.growing.clear();
        self.next_scan = Instant::now();
    }

    /// Takes one step: a scan if due, or at most one record or chunk of one file. `elsewhere`: bytes of samples
    /// that the journal holds.
    pub fn step(&mut self, watch: &mut Watch, stop: &AtomicBool, elsewhere: usize) -> FolderStep {
        self.elsewhere = elsewhere;
        if Instant::now() >= self.next_scan {
            let began = Instant::now();
            self.scan(stop);
            let took = began.elapsed();
            self.next_scan = Instant::now() + SCAN_EVERY.max(SCAN_SHARE * took);
        }
        if self.finished.is_none() {
            self.open_finished();
        }
        if let Some(mut lane) = self.finished.take() {
            self.is_turn_of_growing = !self.is_turn_of_growing && !self.catches_up;
            self.elsewhere = elsewhere + lane.held;
            if self.is_turn_of_growing
                && let Some(step) = self.step_growing(watch)
            {
                self.finished = Some(lane);
                return step;
            }
            self.elsewhere = elsewhere;
            lane.recording.bound(self.room());
            let step = lane.step(watch, self.settle, &self.health);
            if let Some(Step::End) = step {
                return self.close(lane, watch);
            }
            self.finished = Some(lane);
            return match step {
                Some(Step::Event(event, place)) => Step::Event(event, place),
                _ => Step::More,
            };
        }
        if self.queue.is_empty() {
            self.catches_up = false;
        } else {
            return Step::More;
        }
        self.step_growing(watch).unwrap_or(Step::Wait)
    }

    /// Takes a step of the next growing file with data.
    fn step_growing(&mut self, watch: &mut Watch) -> Option<FolderStep> {
        for _ in 0..self.growing.len() {
            let mut lane = self.growing.pop_front()?;
            lane.recording.bound(self.room());
            let step = lane.step(watch, self.settle, &self.health);
            match step {
                None => self.next_scan = Instant::now(),
                Some(Step::End) => return Some(self.close(lane, watch)),
                Some(Step::Wait) => self.growing.push_back(lane),
                Some(Step::More) => {
                    self.growing.push_back(lane);
                    self.make_room();
                    return Some(Step::More);
                }
                Some(Step::Event(event, place)) => {
                    // Events already read are returned before the next file's turn.
                    self.growing.push_front(lane);
                    return Some(Step::Event(event, place));
                }
            }
        }
        None
    }

    /// Room for the samples of a recording: what the journal and all other recordings leave \[bytes\].
    fn room(&self) -> usize {
        let others = self.growing.iter().chain(&self.finished);
        let held: usize = others.map(|lane| lane.held).sum();
        HELD.saturating_sub(self.elsewhere + held).max(LEAST_ROOM)
    }

    /// Puts off the largest growing files while all together hold too much: they are begun again when
    /// finished.
    fn make_room(&mut self) {
        while self.growing.len() > 1
            && self.growing.iter().map(|lane| lane.held).sum::<usize>() > GROWING_BYTES
            && let Some(at) = (0..self.growing.len()).max_by_key(|at| self.growing[*at].held)
            && let Some(lane) = self.growing.remove(at)
        {
            let detail = format!(
                "{}: growing files together hold more than {} MiB; it is read when it is finished",
                lane.label,
                GROWING_BYTES >> 20
            );
            self.health.fault(Fault::Folder, detail);
            self.postponed.insert(lane.name);
        }
    }

    fn close(&mut self, mut lane: Lane, watch: &Watch) -> FolderStep {
        let (size, modified_ns) = lane.stamp;
        (watch.is_read)(&lane.label);
        let quarantined = lane.guard.end(&lane.label);
        if quarantined.is_some() {
            self.set_aside.insert(lane.name.clone());
            // One that goes on growing is not worth every scan.
            self.failed.insert(lane.name.clone(), Instant::now() + RETRY);
        }
        self.done.insert(lane.name, lane.stamp);
        let losses = lane.recording.summary().faults();
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
        Step::File((mark, Ok(lane.recording.summary().clone())))
    }

    /// Looks for files that are new or changed.
    fn scan(&mut self, stop: &AtomicBool) {
        let path = self.path.display().to_string();
        let entries = match fs::read_dir(&self.path) {
            Ok(entries) => entries,
            Err(fault) => {
                let detail = format!("{path}: the watched folder cannot be read: {fault}");
                return self.health.hold(Fault::Folder, &path, detail);
            }
        };
        self.health.over(Fault::Folder, &path);
        let mut there = BTreeSet::new();
        for entry in entries {
            if stop.load(Ordering::Relaxed) {
                return;
            }
            let Ok(entry) = entry else { continue };
            let name = entry.file_name();
            // The entry's own type: links may lead out of the folder and are not followed.
            if !is_recording(&name) || !entry.file_type().is_ok_and(|kind| kind.is_file()) {
                continue;
            }
            // Gone since: it is no recording any more.
            let Ok(data) = entry.metadata() else { continue };
            self.found(&name, stamp(&data), &data);
            there.insert(name);
        }
        // A name that is gone may come back as another file.
        self.failed.retain(|name, _| there.contains(name));
        self.postponed.retain(|name| there.contains(name));
        let gone: Vec<OsString> = self.set_aside.difference(&there).cloned().collect();
        for name in gone {
            self.health.over(Fault::Quarantined, &label(&name));
            self.set_aside.remove(&name);
        }
        self.done.retain(|name, _| there.contains(name));
    }

    fn found(&mut self, name: &OsStr, stamp: Stamp, data: &Metadata) {
        if let Some(lane) = self.growing.iter_mut().find(|lane| lane.name == name) {
            let same = |open: Metadata| (open.dev(), open.ino()) == (data.dev(), data.ino());
            lane.is_replaced = !lane.file.metadata().is_ok_and(same);
            return;
        }
        let is_read = |lane: &Lane| lane.name == name;
        let is_waiting = self.failed.get(name).is_some_and(|until| Instant::now() < *until);
        if self.done.get(name) == Some(&stamp)
            || self.queued.contains_key(name)
            || is_waiting
            || self.finished.as_ref().is_some_and(is_read)
        {
            return;
        }
        let file = match self.open(name) {
            Ok(file) => file,
            Err(fault) => return self.cannot_open(name, &fault),
        };
        let age = data
            .modified()
            .ok()
            .and_then(|modified| SystemTime::now().duration_since(modified).ok());
        // One that was not written to for long does not grow any more.
        if has_end(&file) || age.is_some_and(|age| age >= self.settle) {
            let time = first_time(&file).unwrap_or(u64::MAX);
            self.queue.insert((time, name.to_owned()));
            self.queued.insert(name.to_owned(), stamp);
        } else if self.growing.len() < MOST_GROWING && !self.postponed.contains(name) {
            match self.lane(name, file, true) {
                Ok(lane) => self.growing.push_back(lane),
                Err(error) => self.health.fault(Fault::Folder, error),
            }
        }
    }

    fn open_finished(&mut self) {
        let Some((_, name)) = self.queue.pop_first() else {
            return;
        };
        self.queued.remove(&name);
        let opened = self.open(&name).and_then(|file| {
            self.lane(&name, file, false)
                .map_err(|error| io::Error::other(error.to_string()))
        });
        match opened {
            Ok(lane) => self.finished = Some(lane),
            // Removed meanwhile.
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => {}
            Err(fault) => self.cannot_open(&name, &fault),
        }
    }

    fn cannot_open(&mut self, name: &OsStr, fault: &io::Error) {
        let path = self.path.join(name);
        let detail = format!(
            "{}: cannot be opened: {fault}; it is tried again every minute",
            path.display()
        );
        self.health.fault(Fault::Folder, detail);
        self.failed.insert(name.to_owned(), Instant::now() + RETRY);
    }

    /// Opens a regular file: it may have changed since it was listed, and opening a pipe would block.
    fn open(&self, name: &OsStr) -> io::Result<File> {
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = File::from(rustix::fs::open(self.path.join(name), flags, Mode::empty())?);
        if file.metadata()?.is_file() {
            Ok(file)
        } else {
            Err(io::Error::other("not a regular file"))
        }
    }

    fn lane(&self, name: &OsStr, file: File, is_live: bool) -> Result<Lane, SourceError> {
        let label = label(name);
        let failed = |source| SourceError::Io {
            path: label.clone(),
            source,
        };
        let stamp = stamp(&file.metadata().map_err(failed)?);
        let input = file.try_clone().map_err(failed)?;
        let recording = Recording::begin(&label, input, &self.channels, &self.settings, is_live)?;
        Ok(Lane {
            name: name.to_owned(),
            label: Arc::from(label),
            recording,
            guard: Guard::default(),
            file,
            is_live,
            stamp,
            grew: Instant::now(),
            is_replaced: false,
            held: 0,
        })
    }
}

impl Lane {
    /// Takes the next step; `None` if the file must be looked up again.
    fn step(&mut self, watch: &mut Watch, settle: Duration, health: &Health) -> Option<Step<Infallible>> {
        let step = self.guard.poll(&mut self.recording, watch, health);
        self.held = self.recording.held();
        match step {
            Step::Wait => return self.wait(settle),
            // A growing file was read as far as it is now; a finished one as it was when it was opened, so that
            // whatever came later is seen.
            Step::End if self.is_live => {
                if let Ok(data) = self.file.metadata()
                    && data.len() == self.recording.progress().read
                {
                    self.stamp = stamp(&data);
                }
            }
            _ => {}
        }
        Some(step)
    }

    /// Handles a file without data now: waits if it has grown lately.
    fn wait(&mut self, settle: Duration) -> Option<Step<Infallible>> {
        let Ok(data) = self.file.metadata() else {
            return Some(Step::Wait);
        };
        let now = stamp(&data);
        let shrank = now.0 < self.recording.progress().read;
        if now != self.stamp && !shrank {
            self.stamp = now;
            self.grew = Instant::now();
            if self.recording.is_in_doubt() && has_end(&self.file) {
                return None;
            }
        }
        if shrank || self.is_replaced || self.grew.elapsed() >= settle {
            // The apparently unfinished record is damage: read as a finished file, only that record is lost.
            if self.recording.is_in_doubt() && !shrank && !self.is_replaced {
                return None;
            }
            self.recording.give_up();
            return Some(Step::More);
        }
        Some(Step::Wait)
    }
}

/// True if a file of this name is a recording: `*.mcap`, and not hidden.
fn is_recording(name: &OsStr) -> bool {
    let name = name.as_bytes();
    let ends = name.len() > 5 && name[name.len() - 5..].eq_ignore_ascii_case(b".mcap");
    ends && name[0] != b'.'
}

/// True if a file has the end of a recording.
fn has_end(file: &File) -> bool {
    let mut file = file;
    let mut end = [0u8; 8];
    let is_end = file
        .seek(SeekFrom::End(-8))
        .and_then(|at| {
            file.read_exact(&mut end)?;
            Ok(at > 8 && end == mcap::MAGIC)
        })
        .unwrap_or(false);
    // The next reader starts at the front.
    file.seek(SeekFrom::Start(0)).is_ok() && is_end
}

/// A file name as text: bytes that are not UTF-8 as `\xNN`, a backslash as two.
fn label(name: &OsStr) -> String {
    let mut label = String::new();
    for chunk in name.as_bytes().utf8_chunks() {
        label.push_str(&chunk.valid().replace('\\', "\\\\"));
        for byte in chunk.invalid() {
            label.push_str(&format!("\\x{byte:02x}"));
        }
    }
    label
}

/// File name of a label; `None` for a part of the journal.
fn name_of(label: &str) -> Option<OsString> {
    if label.contains('/') {
        return None;
    }
    let mut name = Vec::new();
    let mut rest = label.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte != b'\\' {
            name.push(byte);
            continue;
        }
        match after {
            [b'x', high, low, after @ ..] => {
                let digits = [*high, *low];
                let digits = std::str::from_utf8(&digits).ok()?;
                name.push(u8::from_str_radix(digits, 16).ok()?);
                rest = after;
            }
            [b'\\', after @ ..] => {
                name.push(b'\\');
                rest = after;
            }
            _ => return None,
        }
    }
    Some(OsStr::from_bytes(&name).to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_lead_back_to_names() {
        for name in [
            &b"plain.mcap"[..],
            b"\xff\xfe.mcap",
            b"a\\b.mcap",
            b"a\\xff\xc3.mcap",
            "t\u{f6}di.mcap".as_bytes(),
        ] {
            let name = OsStr::from_bytes(name);
            assert_eq!(name_of(&label(name)).as_deref(), Some(name));
        }
        assert_eq!(name_of("journal/journal.000001.mcap"), None);
    }

    #[test]
    fn only_recordings_count() {
        let is = |name: &str| is_recording(OsStr::new(name));
        assert!(is("a.mcap") && is("A.MCAP"));
        assert!(!is(".mcap") && !is(".a.mcap") && !is("a.mcap.part") && !is("a.tmp") && !is("mcap"));
    }
}
