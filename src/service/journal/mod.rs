//! The journal: data of the sockets, on disk before it is processed.
//!
//! All live data go into one series of MCAP files, `journal.000001.mcap` and so on, in the order they arrived. Data are
//! acknowledged to their sender when they are durable here, and the daemon reads them from here like any recording. So
//! a replay of the journal gives the daemon's results by construction, and nothing acknowledged is ever lost.
//! docs/journal.md describes the files.

mod bell;
pub mod handle;
mod output;
pub mod retention;
mod start;
mod streams;
mod writer;

use crate::config::settings::journal::JournalSettings;
pub use bell::Bell;
pub use handle::{Batch, Closed, Definition, End, Entry, Handle, Line, MAX_MESSAGE};

use crate::service::telemetry::{Beat, Fault, Health};
use crate::site::clock;
use crate::site::ordered_map::message_of;
use output::Output;
use std::fs::{self, File, TryLockError};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use streams::Streams;
use tokio::sync::Semaphore;
use writer::{Work, Writer, is_full};

/// Reason why there is no journal, or no more.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The file system returned an error. Data not durable before is not acknowledged, and nothing is tried
    /// again.
    #[error("{}: the journal cannot be written: {source}; see to the disk, then start again", path.display())]
    Io {
        /// Path of the folder.
        path: PathBuf,
        /// Error of the file system.
        source: io::Error,
    },
    /// Another process writes to it.
    #[error("{}: another process writes this journal; give each daemon its own folder", path.display())]
    Held {
        /// Path of the folder.
        path: PathBuf,
    },
    /// Its thread panicked.
    #[error("{}: the program broke, please report it: {panic}", path.display())]
    Broken {
        /// Path of the folder.
        path: PathBuf,
        /// Message of the panic.
        panic: String,
    },
}

/// Gives the ages of some parts, the oldest first \[s\], as far as their content is known to be stored
/// elsewhere.
pub type Vouch = Box<dyn Fn(&[retention::Kept]) -> Vec<f64> + Send>;

/// Partners of a journal.
pub struct Around {
    /// Receiver of faults.
    pub health: Arc<Health>,
    /// Beat of its thread.
    pub beat: Arc<Beat>,
    /// While true, nothing is accepted or acknowledged.
    pub halted: Arc<AtomicBool>,
    /// Function that is asked before a part is removed.
    pub vouch: Vouch,
    /// Number of the last part that object storage has, where parts are copied there; later ones are not removed.
    pub copied: Option<Arc<AtomicU32>>,
}

/// A journal and the thread that writes it.
#[derive(Debug)]
pub struct Journal {
    handle: Handle,
    bell: Arc<Bell>,
    results_kept: Arc<AtomicU32>,
    stopping: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    _lock: File,
}

impl Journal {
    /// Resumes the journal in `folder`, or begins one. A named sender's stream that is not resumed within
    /// `resume_s` is broken. `failed` is called, on the journal's thread, after an error of the disk: nothing
    /// more is kept or acknowledged then, and the daemon must stop.
    ///
    /// # Errors
    /// The folder cannot be read or written, or another process has it.
    pub fn start(
        folder: &Path,
        settings: &JournalSettings,
        resume_s: f64,
        around: Around,
        failed: impl FnOnce(JournalError) + Send + 'static,
    ) -> Result<Self, JournalError> {
        let wrong = |source| JournalError::Io {
            path: folder.to_owned(),
            source,
        };
        fs::create_dir_all(folder).map_err(wrong)?;
        let lock = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(folder.join(".lock"))
            .map_err(wrong)?;
        lock.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => JournalError::Held {
                path: folder.to_owned(),
            },
            TryLockError::Error(source) => wrong(source),
        })?;
        let found = start::look(folder).map_err(wrong)?;
        if let Some(damage) = found.damage {
            around.health.fault(Fault::Recording, damage);
        }
        let (sender, receiver) = mpsc::channel();
        let room = Arc::new(Semaphore::new(handle::QUEUE_KIB as usize));
        let (bell, results_kept, stopping) = (Arc::default(), Arc::default(), Arc::default());
        let mut writer = Writer {
            folder: folder.to_owned(),
            journal: found.journal.unwrap_or_else(new_name),
            settings: settings.clone(),
            resume_s,
            streams: Streams::restored(found.streams),
            output: None,
            next: found.next,
            around,
            bell: Arc::clone(&bell),
            results_kept: Arc::clone(&results_kept),
            stopping: Arc::clone(&stopping),
            state: Work::default(),
        };
        // A folder that cannot be written is reported at once; a full one is waited for.
        let note = writer.first_note();
        match Output::create(folder, writer.next, &note) {
            Ok(output) => writer.opened(output),
            Err(fault) if is_full(&fault) => {}
            Err(fault) => return Err(wrong(fault)),
        }
        let handle = Handle::new(sender, Arc::clone(&room));
        let thread = thread::Builder::new()
            .name("journal".to_owned())
            .spawn(move || {
                // A thread that is gone would leave the daemon without live data, and in good health.
                let outcome =
                    catch_unwind(AssertUnwindSafe(|| writer.run(&receiver))).unwrap_or_else(|panic| {
                        Err(JournalError::Broken {
                            path: writer.folder.clone(),
                            panic: message_of(&*panic),
                        })
                    });
                room.close();
                if let Err(error) = outcome {
                    failed(error);
                }
            })
            .map_err(wrong)?;
        Ok(Self {
            handle,
            bell,
            results_kept,
            stopping,
            thread: Some(thread),
            _lock: lock,
        })
    }

    /// Handle for connections.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Bell that rings when new data can be read.
    pub fn bell(&self) -> Arc<Bell> {
        Arc::clone(&self.bell)
    }

    /// Number of the last part whose results are all in the store: parts up to it may be removed when old.
    pub fn results_kept(&self) -> Arc<AtomicU32> {
        Arc::clone(&self.results_kept)
    }

    /// Writes the appended data, closes the part and ends the thread.
    pub fn stop(mut self) {
        self.halt();
    }

    fn halt(&mut self) {
        self.stopping.store(true, Ordering::Relaxed);
        self.handle.stop();
        if let Some(thread) = self.thread.take() {
            // A panic there has already been reported by the panic hook.
            let _ = thread.join();
        }
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        self.halt();
    }
}

/// A unique name of a journal.
fn new_name() -> String {
    format!("{:x}-{:x}", clock::now_ns(), std::process::id())
}
