//! Many recordings, read side by side in the order of their messages.
//!
//! Files of one series are one stream, as the parts of a journal are: nothing is cut where one ends and the
//! next continues, and each rod of a site may have its own files. A file with a topic at times at which
//! another file has it too (most likely a copy) is a series of its own, and so is one that is followed, one of unknown span,
//! and one of another program, unless it holds sensors of a rod with several.

use super::folder::{Span, first_time_at, span_at};
use super::route::{Rod, Router};
use super::source::{Source, Step};
use super::stream::{Stream, turn};
use super::{Follow, Options, Parts, Recording, Series, SourceError, Summary};
use crate::part;
use std::cmp::Reverse;
use std::collections::{HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tirante_analysis::signal::record::{RecordSettings, RodChannels};

/// Pause before a growing recording is read again.
const FOLLOW_POLL: Duration = Duration::from_millis(200);
/// Opens files of any format.
pub trait Opener: Send {
    /// Opens one.
    ///
    /// # Errors
    /// It cannot be read.
    fn open(&self, path: &Path, options: &Options) -> Result<Recording, SourceError>;

    /// Time span and topics of one that is no recording and may be read beside others.
    fn span(&self, path: &Path) -> Option<Span>;
}

/// Summary of a file, or the error that prevented reading it.
pub type FileResult = Result<Summary, SourceError>;

/// Parts that are read as one file.
enum Input {
    Waiting(PathBuf),
    File(Box<Recording>),
    Journal(Box<Series>),
}

/// A file among others.
struct Lane {
    input: Input,
    /// Log time reached by reading \[ns\]; before it is opened, that of its first message.
    front: u64,
    /// Index of its series.
    series: usize,
}

/// A stream with the files that are still to be read.
struct Planned {
    stream: Stream,
    /// Number of files not yet read.
    left: usize,
    /// True if other files may join it.
    is_open: bool,
}

/// The events of many files, in the order of their messages. Each file's end follows when it is read; records
/// that continue in another file come later.
pub struct Recordings {
    lanes: Vec<Lane>,
    streams: Vec<Planned>,
    channels: Vec<RodChannels>,
    settings: RecordSettings,
    options: Options,
    done: Arc<AtomicU64>,
    bytes_of_closed: u64,
    opener: Option<Box<dyn Opener>>,
    /// Files that have no series yet.
    unplanned: Vec<Result<PathBuf, SourceError>>,
    ready: VecDeque<Step<FileResult>>,
}

impl Recordings {
    /// Reads `files`, which are in the order of their first messages. `done` counts the bytes read so far;
    /// with `follow`, a file that has no end yet is waited for.
    pub fn new(
        files: Vec<Result<PathBuf, SourceError>>,
        channels: Vec<RodChannels>,
        settings: RecordSettings,
        follow: bool,
        done: Arc<AtomicU64>,
    ) -> Self {
        let follow = follow.then(|| Follow {
            stop: Arc::default(),
            poll: FOLLOW_POLL,
        });
        Self {
            lanes: Vec::new(),
            streams: Vec::new(),
            channels,
            settings,
            options: Options { follow },
            done,
            bytes_of_closed: 0,
            opener: None,
            unplanned: files,
            ready: VecDeque::new(),
        }
    }

    /// Uses `opener` to open files; without it all are MCAP.
    pub fn opened_by(self, opener: impl Opener + 'static) -> Self {
        Self {
            opener: Some(Box::new(opener)),
            ..self
        }
    }

    /// Assigns files to series. Parts of one journal are one series, at the place of the first part.
    fn plan(&mut self, files: Vec<Result<PathBuf, SourceError>>) {
        let mut journals = journals(&files);
        let mut latest = 0;
        for file in files {
            let path = match file {
                Ok(path) => path,
                Err(error) => {
                    self.ready.push_back(Step::File(Err(error)));
                    continue;
                }
            };
            let foreign = || self.opener.as_ref()?.span(&path);
            let span = match self.options.follow {
                None => span_at(&path).or_else(foreign),
                Some(_) => None,
            };
            // A file of unknown start comes after the one before it.
            let begins = span
                .as_ref()
                .map(|span| span.from)
                .or_else(|| first_time_at(&path));
            latest = latest.max(begins.unwrap_or(0));
            let (input, series) = match part_of(&path) {
                None => (Input::Waiting(path), self.series_for(span)),
                Some((folder, _)) => match journals.remove(&folder) {
                    None => continue,
                    Some(parts) => {
                        let series =
                            Series::new(&folder, Parts::Given(parts), &self.channels, &self.settings);
                        (Input::Journal(Box::new(series)), self.series_for(None))
                    }
                },
            };
            self.lanes.push(Lane {
                input,
                front: latest,
                series,
            });
        }
    }

    /// Index of the series of a file: of those that take it, the one whose latest file of its topics ends last, or the first.
    fn series_for(&mut self, span: Option<Span>) -> usize {
        let found = span.as_ref().and_then(|span| {
            let all = self.streams.iter_mut().enumerate();
            let taking = all.filter_map(|(at, planned)| {
                let takes = planned.is_open && planned.stream.takes(span);
                takes.then(|| (planned.stream.reaches(span), Reverse(at)))
            });
            taking.max().map(|(_, Reverse(at))| at)
        });
        let at = found.unwrap_or_else(|| {
            self.streams.push(Planned {
                stream: Stream::new(&self.channels, &self.settings),
                left: 0,
                is_open: span.is_some(),
            });
            self.streams.len() - 1
        });
        self.streams[at].left += 1;
        if let Some(span) = span {
            self.streams[at].stream.add(span);
        }
        at
    }

    /// Takes one step of the lane whose turn it is.
    fn step(&mut self, at: usize, limit: u64) {
        let lane = &mut self.lanes[at];
        if let Input::Waiting(path) = &lane.input {
            let name: Arc<str> = Arc::from(path.display().to_string());
            let opened = match &self.opener {
                Some(opener) => opener.open(path, &self.options),
                None => Recording::open(path, &self.channels, &self.settings, self.options.clone()),
            };
            match opened {
                Ok(recording) => lane.input = Input::File(Box::new(recording)),
                Err(error) => {
                    self.ready.push_back(Step::File(Err(error)));
                    self.close(at, (name, 0, 0));
                }
            }
            return;
        }
        match &mut lane.input {
            Input::Waiting(_) => {}
            Input::Journal(series) => {
                let polled = series.poll();
                lane.front = series.at().unwrap_or(lane.front).max(lane.front);
                let bytes = self.bytes_of_closed + series.bytes_read();
                self.done.store(bytes, Ordering::Relaxed);
                match polled {
                    Step::Event(event, place) => self.ready.push_back(Step::Event(event, place)),
                    Step::File(end) => {
                        self.bytes_of_closed += end.size;
                        self.ready.push_back(Step::File(end.result));
                    }
                    Step::More => {}
                    // Only the parts that are there are read: there is nothing to wait for.
                    Step::Wait | Step::End => self.close(at, (Arc::from(""), 0, 0)),
                }
            }
            Input::File(recording) => {
                let planned = &mut self.streams[lane.series];
                // Samples that are no messages take turns only where another file may belong to them.
                let limit = match planned.is_open || !recording.is_given() {
                    true => limit,
                    false => u64::MAX,
                };
                let polled = planned.stream.poll(recording, limit);
                lane.front = recording.front().unwrap_or(lane.front).max(lane.front);
                let (_, bytes, _) = recording.counts();
                self.done.store(self.bytes_of_closed + bytes, Ordering::Relaxed);
                match polled {
                    Step::Event(event, place) => {
                        self.ready.push_back(Step::Event(event, place));
                        // All of them, because another file's turn comes after the events already read.
                        while let Some((event, place)) = recording.pop() {
                            self.ready.push_back(Step::Event(event, place));
                        }
                    }
                    Step::More => {}
                    Step::Wait => recording.wait_or_give_up(),
                    Step::End => {
                        let (summary, counts) = (recording.summary().clone(), recording.counts());
                        self.bytes_of_closed += bytes;
                        self.close(at, counts);
                        self.ready.push_back(Step::File(Ok(summary)));
                    }
                }
            }
        }
    }

    /// Closes a lane at its end; after the last lane of a series its records end.
    fn close(&mut self, at: usize, (file, bytes, mut records): (Arc<str>, u64, u64)) {
        let series = self.lanes.remove(at).series;
        let planned = &mut self.streams[series];
        planned.left -= 1;
        if planned.left > 0 {
            return;
        }
        let rods = std::mem::take(&mut planned.stream.rods);
        let is_elsewhere = |rod: &Rod| {
            let others = self.streams.iter().flat_map(|planned| &planned.stream.rods);
            others
                .filter(|other| other.config.rod == rod.config.rod)
                .any(|other| other.is_followed)
        };
        let is_followed = |rod: &Rod| {
            let mut lanes = rods.iter().filter(|lane| lane.config.rod == rod.config.rod);
            lanes.any(|lane| lane.is_followed)
        };
        // Readings for a rod that is followed in other files come with those.
        let stays: Vec<bool> = rods
            .iter()
            .map(|rod| is_followed(rod) || !is_elsewhere(rod))
            .collect();
        let rods = rods.into_iter().zip(stays).filter(|(_, stays)| *stays);
        for timed in Router::of(rods.map(|(rod, _)| rod).collect()).ended() {
            records += timed.records();
            let (event, place) = timed.at_place(Arc::clone(&file), bytes, records);
            self.ready.push_back(Step::Event(event, place));
        }
    }
}

/// Folder and number of a part of a journal.
fn part_of(path: &Path) -> Option<(PathBuf, u32)> {
    let number = part::number(path.file_name()?.to_str()?)?;
    Some((path.parent()?.to_owned(), number))
}

/// Journals with parts among the files, with their parts.
fn journals(files: &[Result<PathBuf, SourceError>]) -> HashMap<PathBuf, Vec<u32>> {
    let mut journals: HashMap<PathBuf, Vec<u32>> = HashMap::new();
    for (folder, number) in files.iter().flatten().filter_map(|path| part_of(path)) {
        journals.entry(folder).or_default().push(number);
    }
    for parts in journals.values_mut() {
        parts.sort_unstable();
    }
    journals
}

impl Iterator for Recordings {
    type Item = Step<FileResult>;

    fn next(&mut self) -> Option<Step<FileResult>> {
        let files = std::mem::take(&mut self.unplanned);
        self.plan(files);
        loop {
            if let Some(step) = self.ready.pop_front() {
                return Some(step);
            }
            let fronts: Vec<u64> = self.lanes.iter().map(|lane| lane.front).collect();
            let (at, limit) = turn(&fronts)?;
            self.step(at, limit);
        }
    }
}
