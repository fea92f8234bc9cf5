//! One recording: an MCAP file as an iterator of records and rejections.

use super::SourceError;
use super::mcap::{Damage, Progress, Reader};
use super::path::FieldPath;
use super::route::Router;
use super::summary::Summary;
use super::verify::{self, Trust};
use crate::record::{Event, RecordSettings, RodChannels, TimeSource};
use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How a file that still grows is followed.
#[derive(Debug, Clone)]
pub struct Follow {
    /// Set to end the reading at the next pause.
    pub stop: Arc<AtomicBool>,
    /// How long to wait at the end before looking again.
    pub poll: Duration,
}

/// How a recording is read.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Wait at the end for more, until the file is finished or the flag is set.
    pub follow: Option<Follow>,
}

/// How far a recording was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Bytes read.
    pub read: u64,
    /// Bytes in the file when it was opened.
    pub total: u64,
}

trait Input: Read + Send {}
impl<T: Read + Send> Input for T {}

/// One recording. Iterate over its events; then look at the [summary](Self::summary).
///
/// Memory is bounded by one chunk and one record a rod, never by the file. It is `Send`: read on one
/// thread while another computes.
pub struct Recording {
    reader: Reader<Box<dyn Input>>,
    router: Router,
    queue: VecDeque<Event>,
    follow: Option<Follow>,
    total: u64,
    summary: Summary,
    done: bool,
}

impl Recording {
    /// Opens a file. A file that is complete is first read once for its checksum.
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

    /// Reads from anything that can be read and sought; `name` stands for it in sentences.
    pub fn new(
        name: &str,
        mut input: impl Read + Seek + Send + 'static,
        rods: &[RodChannels],
        settings: &RecordSettings,
        options: Options,
    ) -> Result<Self, SourceError> {
        for rod in rods {
            let channels = [Some(&rod.displacement), rod.temperature.as_ref()];
            for channel in channels.into_iter().flatten() {
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
        let live = options.follow.is_some();
        let total = input.seek(SeekFrom::End(0)).map_err(failed)?;
        input.seek(SeekFrom::Start(0)).map_err(failed)?;
        let trust = if live {
            Trust::Unverified
        } else {
            verify::verify(&mut input).map_err(failed)?
        };
        Ok(Self {
            reader: Reader::new(Box::new(input), trust, live),
            router: Router::new(rods, settings),
            queue: VecDeque::new(),
            follow: options.follow,
            total,
            summary: Summary {
                file: name.to_owned(),
                ..Default::default()
            },
            done: false,
        })
    }

    /// How far the file was read, for a progress bar.
    pub fn position(&self) -> Position {
        let read = self.reader.bytes_read();
        Position {
            read,
            total: self.total.max(read),
        }
    }

    /// What the file held; complete once the iterator has ended.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    fn end(&mut self, outcome: Result<Progress, Damage>) {
        self.done = true;
        let mut lost = None;
        let mut cut_short = false;
        match outcome {
            Err(Damage { offset, what }) => {
                let whole = self.reader.data_ended();
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
        self.router.finish(cut_short, lost.as_deref(), &mut self.queue);
        self.summary.messages = self.reader.messages();
        self.router.summarise(&mut self.summary);
    }
}

impl Iterator for Recording {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        loop {
            if let Some(event) = self.queue.pop_front() {
                return Some(event);
            }
            if self.done {
                return None;
            }
            let Self { reader, router, .. } = self;
            match reader.step(&mut |item| router.item(item)) {
                Ok(Progress::More) => self.router.events(&mut self.queue),
                Ok(Progress::Wait) => match &self.follow {
                    Some(follow) if !follow.stop.load(Ordering::Relaxed) => std::thread::sleep(follow.poll),
                    _ => self.end(Ok(Progress::Truncated)),
                },
                outcome => self.end(outcome),
            }
        }
    }
}
