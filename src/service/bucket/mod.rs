//! Copy of the journal's parts to object storage, in the order of their numbers.
//!
//! A part is complete once a later one was begun, and never changes again. Its name there holds its SHA-256: sent twice it is one
//! object. Nothing is removed because the bucket has it: the journal keeps its own rules, and keeps beside them every part that
//! the bucket does not have yet.

mod s3;

pub use s3::{S3, S3Error};

use crate::config::settings::bucket::BucketSettings;
use crate::recording::atomic::AtomicFile;
use crate::recording::part;
use crate::service::alert::{Backoff, Pace};
use crate::service::telemetry::metrics::Delivery;
use crate::service::telemetry::{Fault, Telemetry};
use crate::site::hex::hex;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, UNIX_EPOCH};

/// Id of the copy in conditions and metrics. The slash keeps it apart from every `[[sink]]`, whose ids have none.
pub const SINK: &str = "copy/bucket";
/// File beside the parts with the number of the last one that the bucket has.
const MARK: &str = ".bucket";
/// Interval of looks for complete parts.
const LOOK: Duration = Duration::from_secs(5);
/// Bytes read at once for the checksum.
const BLOCK: usize = 1 << 16;

/// Content of the mark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Mark {
    /// Address of the bucket.
    to: String,
    /// Number of the last part that it has.
    through: u32,
}

/// The running copy, ended when dropped.
#[derive(Debug)]
pub struct Uploader {
    stop: Option<SyncSender<()>>,
}

impl Uploader {
    /// Starts it over the journal in `folder`, with the waits of `pace` after failures; `held` is the number of the last part that the bucket has, for who removes parts.
    ///
    /// # Errors
    /// The system gives no thread, or the folder cannot be read.
    pub fn start(
        pace: Pace,
        settings: &BucketSettings,
        folder: &Path,
        held: Arc<AtomicU32>,
        telemetry: Telemetry,
    ) -> io::Result<Self> {
        // The last part is never copied: a mark that names it, or a later one, is of a journal that is gone.
        let last = part::list(folder)?.last().copied().unwrap_or(0);
        let mark = read_mark(folder).filter(|mark| mark.to == settings.address() && mark.through < last);
        held.store(mark.map_or(0, |mark| mark.through), Ordering::Relaxed);
        let (stop, stopped) = sync_channel(0);
        let work = Work {
            settings: settings.clone(),
            folder: folder.to_owned(),
            held,
            telemetry,
        };
        thread::Builder::new()
            .name("bucket".to_owned())
            .spawn(move || work.run(pace, &stopped))?;
        Ok(Self { stop: Some(stop) })
    }
}

impl Drop for Uploader {
    fn drop(&mut self) {
        // A send under way is left to itself: if it arrives, it is known by its name at the next start.
        drop(self.stop.take());
    }
}

/// Number of the last part that any bucket has, as the mark says.
fn read_mark(folder: &Path) -> Option<Mark> {
    serde_json::from_slice(&fs::read(folder.join(MARK)).ok()?).ok()
}

struct Work {
    settings: BucketSettings,
    folder: PathBuf,
    held: Arc<AtomicU32>,
    telemetry: Telemetry,
}

impl Work {
    fn run(self, pace: Pace, stopped: &Receiver<()>) {
        let seed =
            crate::analysis::numerics::random::seed(&[SINK.as_bytes(), self.settings.address().as_bytes()]);
        let mut backoff = Backoff::new(pace, seed);
        let mut wait = Duration::ZERO;
        while stopped.recv_timeout(wait) == Err(RecvTimeoutError::Timeout) {
            let health = &self.telemetry.health;
            match self.round(stopped) {
                Ok(()) => {
                    backoff.reset();
                    health.over(Fault::Forward, SINK);
                    wait = LOOK;
                }
                Err(error) => {
                    wait = backoff.after_failure(None);
                    self.telemetry.metrics.delivery(SINK, Delivery::Failed);
                    let detail = format!(
                        "parts of the journal to {}: {error}; tried again in {:.0} s",
                        self.settings.address(),
                        wait.as_secs_f64().ceil()
                    );
                    health.hold(Fault::Forward, SINK, detail);
                }
            }
        }
    }

    /// Sends the complete parts that the bucket does not have.
    fn round(&self, stopped: &Receiver<()>) -> Result<(), S3Error> {
        let parts = part::list(&self.folder).map_err(|error| named(&self.folder, &error))?;
        // The last one is being written, or will be gone on with.
        let complete = parts.split_last().map_or(&[][..], |(_, complete)| complete);
        let held = self.held.load(Ordering::Relaxed);
        let waiting: Vec<u32> = complete.iter().copied().filter(|number| *number > held).collect();
        for (place, number) in waiting.iter().enumerate() {
            self.telemetry.metrics.outbox(SINK, waiting.len() - place);
            self.send(*number)?;
            self.note(*number)?;
            self.telemetry.health.over(Fault::Forward, SINK);
            self.telemetry.metrics.delivery(SINK, Delivery::Delivered);
            if stopped.try_recv() == Err(std::sync::mpsc::TryRecvError::Disconnected) {
                break;
            }
        }
        self.telemetry.metrics.outbox(SINK, 0);
        Ok(())
    }

    /// Sends a part, and asks how much of it is there.
    fn send(&self, number: u32) -> Result<(), S3Error> {
        let path = part::path(&self.folder, number);
        let of = |error: io::Error| named(&path, &error);
        let (sum, bytes) = File::open(&path).and_then(checksum).map_err(of)?;
        let name = self.name_of(number, &fs::metadata(&path).map_err(of)?, &sum);
        let bucket = S3::new(&self.settings)?;
        if bucket.length(&name)? == Some(bytes) {
            return Ok(());
        }
        bucket.put(&name, File::open(&path).map_err(of)?, bytes, &sum)?;
        match bucket.length(&name)? {
            Some(there) if there == bytes => Ok(()),
            there => Err(S3Error::Server(format!(
                "{}: took {name} of {bytes} bytes, and has {} of it",
                self.settings.server,
                there.map_or_else(|| "nothing".to_owned(), |there| format!("{there} bytes"))
            ))),
        }
    }

    /// `PREFIX/2026/03/01/journal.000001-0123456789abcdef.mcap`: the day of its last write, its number, its checksum.
    fn name_of(&self, number: u32, data: &fs::Metadata, sum: &[u8]) -> String {
        let written = data
            .modified()
            .ok()
            .and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let seconds = written.map_or(0, |since| i64::try_from(since.as_secs()).unwrap_or(0));
        let day = jiff::Timestamp::from_second(seconds).map_or_else(
            |_| "1970/01/01".to_owned(),
            |time| {
                time.to_zoned(jiff::tz::TimeZone::UTC)
                    .strftime("%Y/%m/%d")
                    .to_string()
            },
        );
        let prefix = match self.settings.prefix.as_str() {
            "" => String::new(),
            prefix => format!("{prefix}/"),
        };
        format!("{prefix}{day}/journal.{number:06}-{}.mcap", hex(&sum[..8]))
    }

    /// Keeps the number of the last part that the bucket has.
    fn note(&self, number: u32) -> Result<(), S3Error> {
        let mark = Mark {
            to: self.settings.address(),
            through: number,
        };
        let mut file = AtomicFile::create(&self.folder.join(MARK))?;
        file.write_all(serde_json::to_string(&mark).map_err(io::Error::from)?.as_bytes())?;
        file.commit()?;
        self.held.store(number, Ordering::Relaxed);
        Ok(())
    }
}

/// An error with the path that it is about.
fn named(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// SHA-256 and length of a file.
fn checksum(mut file: File) -> io::Result<(Vec<u8>, u64)> {
    let (mut sum, mut bytes, mut block) = (Sha256::new(), 0, vec![0; BLOCK]);
    loop {
        match file.read(&mut block)? {
            0 => return Ok((sum.finalize().to_vec(), bytes)),
            count => {
                sum.update(&block[..count]);
                bytes += count as u64;
            }
        }
    }
}
