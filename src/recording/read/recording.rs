//! One recording: an MCAP file as an iterator of records and rejections.

use super::file::FileReader;
use super::mcap::{Damage, Progress};
use super::path::FieldPath;
use super::route::{Ready, Rod, Router};
use super::source::{Source, Step};
use super::summary::Summary;
use super::tail::{Tail, Tails};
use super::{Place, SourceError};
use std::convert::Infallible;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::iter::Peekable;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tirante_analysis::signal::record::{Event, RecordSettings, RodChannels, RodId, TimeSource, Timestamp};

/// Options for following a file that still grows.
#[derive(Debug, Clone)]
pub struct Follow {
    /// Flag that ends the reading at the next pause.
    pub stop: Arc<AtomicBool>,
    /// Wait at the end before looking again.
    pub poll: Duration,
}

/// Options for reading a recording.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Waits at the end for more, until the file is finished or the flag is set.
    pub follow: Option<Follow>,
}

/// Progress in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Number of bytes read.
    pub read: u64,
    /// Size of the file when it was opened \[bytes\].
    pub total: u64,
}

trait Input: Read + Seek + Send {}
impl<T: Read + Seek + Send> Input for T {}

/// Samples of one channel that need no decoding: those of another program's file.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Topic.
    pub topic: Arc<str>,
    /// Time of the first sample.
    pub time: Timestamp,
    /// Sample rate \[Hz\].
    pub fs_hz: f64,
    /// Samples, in the unit of the topic's channel.
    pub samples: Vec<f64>,
}

/// Stage of reading.
enum Stage {
    /// Its messages are read.
    Reading(FileReader<Box<dyn Input>>),
    /// Its samples are passed on as they are.
    Given(Peekable<Box<dyn Iterator<Item = Block> + Send>>),
    /// It is at its end.
    Ended,
}

/// One recording. Iterate over its events; then look at the [summary](Self::summary).
///
/// Memory is bounded by one chunk and one record per rod, never by the file. It is `Send`: read on one thread
/// while another computes.
pub struct Recording {
    stage: Stage,
    router: Router,
    queue: Ready,
    /// Name in messages and in the store.
    name: Arc<str>,
    /// Number of records returned so far.
    records: u64,
    follow: Option<Follow>,
    total: u64,
    read: u64,
    offset: u64,
    summary: Summary,
    /// True if it is read while it may be written.
    is_live: bool,
    /// True if other files are read beside it and continue where it ends.
    is_joined: bool,
    /// Open samples that it left at its end.
    left: Vec<Tail>,
    /// Damage that may be a record still being written.
    doubt: Option<Damage>,
}

impl Recording {
    /// Opens a file. A complete file is first read once for its checksum.
    pub fn open(
        path: &Path,
        rods: &[RodChannels],
        settings: &RecordSettings,
        options: Options,
    ) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        let failed = |source| SourceError::Io {
            path: name.clone(),
            source,
        };
        // Before it is opened: opening a pipe would wait for its writer.
        if !fs::metadata(path).map_err(failed)?.is_file() {
            return Err(SourceError::NotAFile { path: name });
        }
        let file = File::open(path).map_err(failed)?;
        Self::new(&name, file, rods, settings, options)
    }

    /// Reads from anything that can be read and sought; `name` names it in messages.
    pub fn new(
        name: &str,
        input: impl Read + Seek + Send + 'static,
        rods: &[RodChannels],
        settings: &RecordSettings,
        options: Options,
    ) -> Result<Self, SourceError> {
        let mut recording = Self::begin(name, input, rods, settings, options.follow.is_some())?;
        recording.follow = options.follow;
        recording.is_live = false;
        if let Stage::Reading(file) = &mut recording.stage {
            file.check().map_err(|source| SourceError::Io {
                path: name.to_owned(),
                source,
            })?;
        }
        Ok(recording)
    }

    /// As [`Recording::new`], to be read by [`Recording::poll`]; with `live` its end may not be there yet.
    ///
    /// # Errors
    /// It cannot be read, or a field of a rod is none.
    pub fn begin(
        name: &str,
        mut input: impl Read + Seek + Send + 'static,
        rods: &[RodChannels],
        settings: &RecordSettings,
        live: bool,
    ) -> Result<Self, SourceError> {
        for rod in rods {
            for channel in rod.all() {
                let time = match &channel.time {
                    TimeSource::Field(path) => path.as_str(),
                    TimeSource::Log | TimeSource::Publish => &channel.field,
                };
                for path in [channel.field.as_str(), time] {
                    FieldPath::parse(path).map_err(|source| SourceError::Field {
                        rod: rod.rod.to_string(),
                        source,
                    })?;
                }
            }
        }
        let failed = |source| SourceError::Io {
            path: name.to_owned(),
            source,
        };
        let total = input.seek(SeekFrom::End(0)).map_err(failed)?;
        input.seek(SeekFrom::Start(0)).map_err(failed)?;
        let input: Box<dyn Input> = Box::new(input);
        let lanes = rods.iter().flat_map(RodChannels::lanes);
        let sampled = lanes.map(|lane| lane.displacement.topic);
        Ok(Self {
            stage: Stage::Reading(match live {
                true => FileReader::unchecked(input, live),
                false => FileReader::by_time(input, Some(sampled.collect())).map_err(failed)?,
            }),
            router: Router::new(rods, settings),
            queue: Ready::default(),
            name: Arc::from(name),
            records: 0,
            follow: None,
            total,
            read: 0,
            offset: 0,
            summary: Summary {
                file: name.to_owned(),
                ..Default::default()
            },
            is_live: live,
            is_joined: false,
            left: Vec::new(),
            doubt: None,
        })
    }

    /// A recording of samples in memory; `total`: size of the file they come from \[bytes\].
    pub fn given(
        name: &str,
        blocks: impl Iterator<Item = Block> + Send + 'static,
        total: u64,
        rods: &[RodChannels],
        settings: &RecordSettings,
    ) -> Self {
        let blocks: Box<dyn Iterator<Item = Block> + Send> = Box::new(blocks);
        Self {
            stage: Stage::Given(blocks.peekable()),
            router: Router::new(rods, settings),
            queue: Ready::default(),
            name: Arc::from(name),
            records: 0,
            follow: None,
            total,
            // The file was read before.
            read: total,
            offset: total,
            summary: Summary {
                file: name.to_owned(),
                ..Default::default()
            },
            is_live: false,
            is_joined: false,
            left: Vec::new(),
            doubt: None,
        }
    }

    /// Adds a sentence to the summary: information that is no fault.
    pub fn note(&mut self, sentence: String) {
        self.summary.notes.push(sentence);
    }

    /// Lets its rods go on with the open samples of earlier files, and leave theirs at its end for the next one.
    pub fn join(&mut self, tails: &Tails) {
        self.router
            .join(tails.clone(), Arc::clone(&self.name), !self.is_live);
    }

    /// Takes the open samples that it left; none before its end, and none if it was cut short or damaged. One that was discarded leaves those of
    /// earlier files.
    pub fn take_left(&mut self) -> Vec<Tail> {
        std::mem::take(&mut self.left)
    }

    /// Open samples of earlier files that its rods went on with.
    pub fn taken(&self) -> &[Tail] {
        self.router.taken()
    }

    /// Notes with which open samples it goes on where it is one of several files of a stream: it may be read again on its own.
    pub fn note_start(&mut self) {
        self.router.note_start();
    }

    /// Open samples with which it began: of earlier files, and of other files of its stream if these are [noted](Self::note_start).
    pub fn began_with(&self) -> impl Iterator<Item = &Tail> {
        self.router.taken().iter().chain(self.router.before())
    }

    /// True if a rod has samples in it, as far as it is read.
    pub fn has_begun(&self, rod: &RodId) -> bool {
        self.router.has_begun(rod)
    }

    fn step(&mut self) -> Step<Infallible> {
        if let Some((event, place)) = self.pop() {
            return Step::Event(event, place);
        }
        if self.doubt.is_some() {
            return Step::Wait;
        }
        if !self.is_joined && self.router.waits() {
            self.router.go_on(u64::MAX);
            self.router.events(&mut self.queue);
            return self.next_step();
        }
        let outcome = match &mut self.stage {
            Stage::Ended => return Step::End,
            Stage::Reading(file) => {
                let router = &mut self.router;
                let outcome = file.step(&mut |item| router.item(item));
                if file.reader().is_some() {
                    self.read = file.bytes_read().max(self.read);
                    self.offset = file.offset();
                }
                outcome
            }
            Stage::Given(blocks) => match blocks.next() {
                Some(block) => {
                    self.router.block(block);
                    Ok(Progress::More)
                }
                None => Ok(Progress::Complete),
            },
        };
        match outcome {
            Ok(Progress::More) => self.router.events(&mut self.queue),
            Ok(Progress::Wait) => return Step::Wait,
            // Some writers go back and fill in lengths: until it settles this may be no damage.
            Err(damage) if self.is_live => {
                self.doubt = Some(damage);
                return Step::Wait;
            }
            outcome => self.end(outcome),
        }
        self.next_step()
    }

    fn next_step(&mut self) -> Step<Infallible> {
        self.pop()
            .map_or(Step::More, |(event, place)| Step::Event(event, place))
    }

    /// Next event that is ready.
    pub(super) fn pop(&mut self) -> Option<(Event, Place)> {
        let timed = self.queue.pop()?;
        self.records += timed.records();
        Some(timed.at_place(Arc::clone(&self.name), self.read, self.records))
    }

    /// Name, number of bytes read and number of records returned.
    pub fn counts(&self) -> (Arc<str>, u64, u64) {
        (Arc::clone(&self.name), self.read, self.records)
    }

    /// As [`Recording::poll`], for one of several files read side by side: passes on nothing logged after
    /// `limit` \[ns\], and leaves records open at its end that may continue in the next file.
    pub(super) fn poll_up_to(&mut self, limit: u64) -> Step<Infallible> {
        self.is_joined = true;
        if self.router.file.is_none() {
            self.router.file = Some(Arc::clone(&self.name));
        }
        if self.queue.is_empty() && self.router.waits() {
            self.router.go_on(limit);
            self.router.events(&mut self.queue);
            return self.next_step();
        }
        self.router.limit(limit);
        if limit < u64::MAX
            && let Stage::Given(blocks) = &mut self.stage
            && let Some(next) = blocks.peek()
        {
            let time = u64::try_from(next.time.as_nanos()).unwrap_or_default();
            self.router.waits_until(time);
            if time > limit {
                return Step::More;
            }
        }
        self.step()
    }

    /// True if its samples come from another program's file.
    pub(super) fn is_given(&self) -> bool {
        matches!(self.stage, Stage::Given(_))
    }

    /// True if events of it wait to be taken.
    pub fn is_ready(&self) -> bool {
        !self.queue.is_empty()
    }

    /// Bytes of samples in events that wait to be taken.
    pub fn ready_bytes(&self) -> usize {
        self.queue.bytes()
    }

    /// Log time up to which its messages were passed on \[ns\]; `None` before the first, and where they have
    /// none.
    pub fn front(&self) -> Option<u64> {
        self.router.front()
    }

    /// Log time of the latest message that a rod took \[ns\].
    pub fn at(&self) -> Option<u64> {
        self.router.at()
    }

    /// True if no message of it was read.
    pub fn is_unread(&self) -> bool {
        self.router.messages() == 0
    }

    /// Swaps in the rods that its samples are for, or takes them back.
    pub(super) fn swap_rods(&mut self, rods: &mut Vec<Rod>) {
        std::mem::swap(&mut self.router.rods, rods);
    }

    /// Handles a pause: waits, or gives the recording up if it is not followed.
    pub(super) fn wait_or_give_up(&mut self) {
        match &self.follow {
            Some(follow) if !follow.stop.load(Ordering::Relaxed) => std::thread::sleep(follow.poll),
            _ => self.give_up(),
        }
    }

    /// Ends a recording that no longer grows as one cut short; its last events are still to be taken.
    pub fn give_up(&mut self) {
        let outcome = self.doubt.take().map_or(Ok(Progress::Truncated), Err);
        self.end(outcome);
    }

    /// True if it contains apparent damage that may be a record still being written: it waits until it is
    /// [given up](Self::give_up) or opened again when finished.
    pub fn is_in_doubt(&self) -> bool {
        self.doubt.is_some()
    }

    /// Bytes in memory: samples not yet in a record, records not yet taken, and data read but not passed on.
    pub fn held(&self) -> usize {
        let reading = match &self.stage {
            Stage::Reading(file) => file.held(),
            Stage::Given(_) | Stage::Ended => 0,
        };
        let before = self.router.before().iter().map(Tail::held);
        self.router.held() + self.router.ahead_bytes() + reading + self.ready_bytes() + before.sum::<usize>()
    }

    /// Sets the bytes of samples beyond which records end early.
    pub fn bound(&mut self, most: usize) {
        self.router.bound(most);
    }

    /// Progress in the file, for a progress bar.
    pub fn progress(&self) -> Position {
        Position {
            read: self.read,
            total: self.total.max(self.read),
        }
    }

    /// Summary of the file; complete once the iterator has ended.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    fn end(&mut self, outcome: Result<Progress, Damage>) {
        let (whole, messages) = match std::mem::replace(&mut self.stage, Stage::Ended) {
            Stage::Reading(file) => {
                if let Some(beyond) = &file.beyond {
                    self.note(format!("{}: {beyond}", self.name));
                }
                file.reader()
                    .map_or((false, 0), |reader| (reader.data_ended(), reader.messages()))
            }
            Stage::Given(_) => (true, self.router.messages()),
            Stage::Ended => return,
        };
        let mut lost = None;
        let mut cut_short = false;
        match outcome {
            Err(Damage { offset, what }) => {
                let advice = if whole {
                    "its data was used"
                } else {
                    "nothing from there on was used, what came before was; copy the file again from the recorder"
                };
                let file = &self.summary.file;
                self.summary.damage = Some(format!("{file}: at byte {offset}: {what}; {advice}"));
                if !whole {
                    lost = Some(format!("at byte {offset}: {what}"));
                    cut_short = true;
                }
            }
            Ok(Progress::Complete) => {}
            Ok(_) => {
                self.summary.truncated = true;
                cut_short = true;
            }
        }
        self.summary.messages = messages;
        self.router.summarise(&mut self.summary);
        if self.is_joined {
            self.router.end_file(cut_short, lost.as_deref());
            self.router.events(&mut self.queue);
        } else if self.router.leaves_open() && !cut_short {
            self.router.leave(&mut self.queue);
            let records = self.records + self.queue.records();
            let place = (Arc::clone(&self.name), self.read, records);
            self.left = self.router.left(&place);
        } else {
            self.router.finish(cut_short, lost.as_deref(), &mut self.queue);
        }
    }
}

impl Iterator for Recording {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        loop {
            match self.step() {
                Step::Event(event, _) => return Some(event),
                Step::End => return None,
                Step::More => {}
                Step::Wait => self.wait_or_give_up(),
            }
        }
    }
}

/// A recording is a source of one file: both end together, and its summary is available then.
impl Source for Recording {
    type File = Infallible;

    fn poll(&mut self) -> Step<Infallible> {
        self.step()
    }

    fn position(&self) -> Option<(Arc<str>, u64)> {
        Some((Arc::clone(&self.name), self.offset))
    }

    fn abandon(&mut self, why: &str) {
        self.doubt = None;
        self.end(Err(Damage {
            offset: self.offset,
            what: why.to_owned(),
        }));
    }

    fn discard(&mut self, why: &str) {
        self.stage = Stage::Ended;
        self.doubt = None;
        self.queue.clear();
        let taken = self.router.take_taken();
        self.router = Router::of(Vec::new());
        // With none of its records told, these are as the file before left them.
        if self.records == 0 {
            self.left.clone_from(&taken);
        }
        self.router.keep_taken(taken);
        self.summary.damage = Some(format!("{}: {why}; nothing of it was used", self.summary.file));
    }
}
