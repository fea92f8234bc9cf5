//! Many recordings, one after another.

use super::{Event, Follow, Options, Recording, SourceError, Summary};
use crate::record::{RecordSettings, RodChannels};
use crate::step::Place;
use std::path::PathBuf;
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

/// The events of many files, one after another, each followed by its end.
pub struct Recordings {
    files: std::vec::IntoIter<Result<PathBuf, SourceError>>,
    channels: Vec<RodChannels>,
    settings: RecordSettings,
    options: Options,
    done: Arc<AtomicU64>,
    bytes_of_closed: u64,
    /// The recording, its name, and how many records it has given.
    open: Option<(Recording, Arc<str>, u64)>,
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
            files: files.into_iter(),
            channels,
            settings,
            options: Options { follow },
            done,
            bytes_of_closed: 0,
            open: None,
        }
    }
}

impl Iterator for Recordings {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        loop {
            if let Some((mut recording, file, records)) = self.open.take() {
                let event = recording.next();
                let bytes = recording.position().read;
                self.done.store(self.bytes_of_closed + bytes, Ordering::Relaxed);
                return Some(match event {
                    Some(event) => {
                        let records = records + u64::from(!matches!(event, Event::Readings { .. }));
                        let place = Place {
                            file: Arc::clone(&file),
                            bytes,
                            records,
                        };
                        self.open = Some((recording, file, records));
                        Step::Event(event, place)
                    }
                    None => {
                        self.bytes_of_closed += bytes;
                        Step::File(Ok(recording.summary().clone()))
                    }
                });
            }
            let opened = self.files.next()?.and_then(|path| {
                let file = Arc::from(path.display().to_string());
                let recording = Recording::open(&path, &self.channels, &self.settings, self.options.clone())?;
                Ok((recording, file, 0))
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
