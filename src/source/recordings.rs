//! Many recordings, one after another.

use super::{Event, Follow, Options, Parts, Recording, Series, SeriesPoll, SourceError, Summary};
use crate::journal::part;
use crate::record::{RecordSettings, RodChannels};
use crate::step::Place;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Pause before a growing recording is looked at again.
const FOLLOW_POLL: Duration = Duration::from_millis(200);

/// One step of reading: an event of a recording, or its end.
pub enum Step {
    /// An event, and where its recording then stands.
    Event(Event, Place),
    /// The end of a recording: what it held, or why it could not be read.
    File(Result<Summary, SourceError>),
}

/// Opens a file that stands by itself, whatever its format.
pub type Opener = Box<dyn Fn(&Path, &Options) -> Result<Recording, SourceError> + Send>;

/// What is read as one.
enum Unit {
    File(PathBuf),
    /// Several parts of one journal.
    Journal(PathBuf, Vec<u32>),
}

/// What is open.
enum Open {
    /// The recording, its name, and how many records it has given.
    File(Box<Recording>, Arc<str>, u64),
    Journal(Box<Series>),
}

/// The events of many files, one after another, each followed by its end. Parts of one journal are one stream: where one
/// ends, nothing is cut.
pub struct Recordings {
    units: std::vec::IntoIter<Result<Unit, SourceError>>,
    channels: Vec<RodChannels>,
    settings: RecordSettings,
    options: Options,
    done: Arc<AtomicU64>,
    bytes_of_closed: u64,
    open: Option<Open>,
    opener: Option<Opener>,
}

impl Recordings {
    /// Reads `files` in their order. `done` counts the bytes read so far; with `follow`, a file that has no end yet is waited
    /// for.
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
            units: units(files).into_iter(),
            channels,
            settings,
            options: Options { follow },
            done,
            bytes_of_closed: 0,
            open: None,
            opener: None,
        }
    }

    /// The same, with files opened by `opener`; without it all are MCAP.
    pub fn opened_by(self, opener: Opener) -> Self {
        Self {
            opener: Some(opener),
            ..self
        }
    }
}

/// Parts of one journal together, where its first one stands; everything else by itself.
fn units(files: Vec<Result<PathBuf, SourceError>>) -> Vec<Result<Unit, SourceError>> {
    let part_of = |path: &Path| {
        let number = part::number(path.file_name()?.to_str()?)?;
        Some((path.parent()?.to_owned(), number))
    };
    let mut journals: HashMap<PathBuf, Vec<u32>> = HashMap::new();
    for (folder, number) in files.iter().flatten().filter_map(|path| part_of(path)) {
        journals.entry(folder).or_default().push(number);
    }
    let mut units = Vec::new();
    for file in files {
        let journal = file.as_deref().ok().and_then(part_of);
        match journal {
            None => units.push(file.map(Unit::File)),
            Some((folder, _)) => {
                if let Some(mut parts) = journals.remove(&folder) {
                    parts.sort_unstable();
                    units.push(Ok(Unit::Journal(folder, parts)));
                }
            }
        }
    }
    units
}

impl Recordings {
    /// One step; `None` where there is nothing to tell yet.
    fn step(&mut self, open: Open) -> Option<Step> {
        match open {
            Open::File(mut recording, file, records) => {
                let event = recording.next();
                let bytes = Recording::position(&recording).read;
                self.done.store(self.bytes_of_closed + bytes, Ordering::Relaxed);
                Some(match event {
                    Some(event) => {
                        let (at, reached) = recording.moment();
                        let records = records + u64::from(!matches!(event, Event::Readings { .. }));
                        let place = Place {
                            file: Arc::clone(&file),
                            bytes,
                            records,
                            at,
                            reached,
                        };
                        self.open = Some(Open::File(recording, file, records));
                        Step::Event(event, place)
                    }
                    None => {
                        self.bytes_of_closed += bytes;
                        Step::File(Ok(recording.summary().clone()))
                    }
                })
            }
            Open::Journal(mut series) => {
                let polled = series.poll();
                let bytes = self.bytes_of_closed + series.bytes_read();
                self.done.store(bytes, Ordering::Relaxed);
                let step = match polled {
                    SeriesPoll::Event(event, place) => Some(Step::Event(event, place)),
                    SeriesPoll::Part(end) => {
                        self.bytes_of_closed += end.size;
                        Some(Step::File(end.result))
                    }
                    SeriesPoll::More => None,
                    // Only the parts that are there are read: there is nothing to wait for.
                    SeriesPoll::Wait | SeriesPoll::End => return None,
                };
                self.open = Some(Open::Journal(series));
                step
            }
        }
    }
}

impl Iterator for Recordings {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        loop {
            if let Some(open) = self.open.take() {
                if let Some(step) = self.step(open) {
                    return Some(step);
                }
                continue;
            }
            let opened = self.units.next()?.and_then(|unit| match unit {
                Unit::File(path) => {
                    let file = Arc::from(path.display().to_string());
                    let recording = match &self.opener {
                        Some(open) => open(&path, &self.options)?,
                        None => Recording::open(&path, &self.channels, &self.settings, self.options.clone())?,
                    };
                    Ok(Open::File(Box::new(recording), file, 0))
                }
                Unit::Journal(folder, parts) => {
                    let series = Series::new(&folder, Parts::Given(parts), &self.channels, &self.settings);
                    Ok(Open::Journal(Box::new(series)))
                }
            });
            match opened {
                Ok(opened) => self.open = Some(opened),
                Err(error) => {
                    return Some(Step::File(Err(error)));
                }
            }
        }
    }
}
