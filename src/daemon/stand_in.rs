//! Stands in for the reader: finished recordings of the watched folder, one after another.

use super::{Generation, Job};
use crate::record::Event;
use crate::source::{self, Options, Recording, SourceError};
use crate::step::Place;
use crate::store::{FileMark, FileState};
use std::collections::BTreeMap;
use std::fs::{File, Metadata};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, UNIX_EPOCH};

/// How often the folder is looked at.
const LOOK: Duration = Duration::from_millis(100);

/// The thread that reads.
pub struct Reader {
    stop: Arc<AtomicBool>,
    reloads: Sender<Arc<Generation>>,
    thread: Option<JoinHandle<()>>,
}

struct Reading {
    folder: PathBuf,
    marks: BTreeMap<String, FileMark>,
    generation: Arc<Generation>,
    reloads: Receiver<Arc<Generation>>,
    jobs: SyncSender<Job>,
    stop: Arc<AtomicBool>,
    caught_up: Arc<AtomicBool>,
}

impl Reader {
    /// Reads what `marks` do not name from now on; `caught_up` says whether everything there was is read.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn start(
        marks: BTreeMap<String, FileMark>,
        generation: Arc<Generation>,
        jobs: SyncSender<Job>,
        caught_up: Arc<AtomicBool>,
    ) -> io::Result<Self> {
        let (reloads, receiver) = channel();
        let stop: Arc<AtomicBool> = Arc::default();
        let Some(folder) = generation.config.ingest.folder.clone() else {
            caught_up.store(true, Ordering::Relaxed);
            return Ok(Self {
                stop,
                reloads,
                thread: None,
            });
        };
        let mut reading = Reading {
            folder,
            marks,
            generation,
            reloads: receiver,
            jobs,
            stop: Arc::clone(&stop),
            caught_up,
        };
        let thread = thread::Builder::new()
            .name("reader".to_owned())
            .spawn(move || reading.run())?;
        Ok(Self {
            stop,
            reloads,
            thread: Some(thread),
        })
    }

    /// Goes on with another configuration.
    pub fn reload(&self, generation: Arc<Generation>) {
        // A reader that is gone said so before.
        let _ = self.reloads.send(generation);
    }

    /// Stops without finishing anything.
    pub fn stop(self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Whether its thread ended.
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_some_and(JoinHandle::is_finished)
    }
}

impl Reading {
    fn run(&mut self) {
        while !self.is_stopped() {
            if let Ok(generation) = self.reloads.try_recv() {
                self.generation = Arc::clone(&generation);
                if self.jobs.send(Job::Reload(generation)).is_err() {
                    return;
                }
            }
            match self.next_file() {
                Some((path, mark)) => {
                    self.caught_up.store(false, Ordering::Relaxed);
                    if self.read(&path, mark).is_none() {
                        return;
                    }
                }
                None => {
                    self.caught_up.store(true, Ordering::Relaxed);
                    thread::sleep(LOOK);
                }
            }
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The first finished file, in the order of time, that was not read as it is.
    fn next_file(&self) -> Option<(PathBuf, FileMark)> {
        let files = source::recordings(std::slice::from_ref(&self.folder));
        files.into_iter().flatten().find_map(|path| {
            let mark = mark_of(&path, &path.metadata().ok()?)?;
            let is_new = self.marks.get(&mark.name) != Some(&mark);
            (is_new && is_finished(&path)).then_some((path, mark))
        })
    }

    /// Reads one file; `None` if the daemon stops.
    fn read(&mut self, path: &Path, mark: FileMark) -> Option<()> {
        let name: Arc<str> = Arc::from(mark.name.as_str());
        let channels = self.generation.channels();
        let opened = Recording::open(
            path,
            &channels,
            &self.generation.config.record,
            Options::default(),
        );
        let result = match opened {
            Ok(recording) => Ok(self.events(recording, &name)?),
            Err(error) => Err(error),
        };
        self.marks.insert(mark.name.clone(), mark.clone());
        let job = Job::File {
            mark: Some(mark),
            result,
            carry: None,
        };
        self.jobs.send(job).ok()
    }

    fn events(&self, mut recording: Recording, name: &Arc<str>) -> Option<source::Summary> {
        let mut records = 0;
        while let Some(event) = recording.next() {
            if self.is_stopped() {
                return None;
            }
            records += u64::from(!matches!(event, Event::Readings { .. }));
            let place = Place {
                file: Arc::clone(name),
                bytes: recording.position().read,
                records,
            };
            let generation = Arc::clone(&self.generation);
            let job = Job::Event {
                event,
                place,
                generation,
            };
            self.jobs.send(job).ok()?;
        }
        Some(recording.summary().clone())
    }
}

fn mark_of(path: &Path, data: &Metadata) -> Option<FileMark> {
    let modified = data.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some(FileMark {
        name: path.file_name()?.to_string_lossy().into_owned(),
        size: data.len(),
        modified_ns: i64::try_from(modified.as_nanos()).ok()?,
        state: FileState::Done,
    })
}

/// Whether it ends as a recording does.
fn is_finished(path: &Path) -> bool {
    let ends = || -> Result<bool, SourceError> {
        let io = |source| SourceError::Io {
            path: path.display().to_string(),
            source,
        };
        let mut file = File::open(path).map_err(io)?;
        file.seek(SeekFrom::End(-(mcap::MAGIC.len() as i64)))
            .map_err(io)?;
        let mut end = [0; 8];
        file.read_exact(&mut end).map_err(io)?;
        Ok(end == *mcap::MAGIC)
    };
    ends().unwrap_or(false)
}
