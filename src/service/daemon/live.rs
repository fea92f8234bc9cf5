//! The live half of a daemon: its sockets, and the journal behind them.

use super::LifecycleEvent;
use super::reader::JournalSource;
use crate::analysis::signal::record::Timestamp;
use crate::config::{Config, RodConfig};
use crate::recording::part;
use crate::service::alert::Pace;
use crate::service::bucket::Uploader;
use crate::service::ingest::{self, Counts, Listener, Server, TopicSet};
use crate::service::journal::retention::Kept;
use crate::service::journal::{Around, Bell, Journal};
use crate::service::telemetry::{Fault, Metrics, Telemetry};
use crate::service::viewer::Signals;
use crate::site::clock;
use crate::site::store::{Reader as StoreReader, StoreError, Stretch};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::runtime::Runtime;
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Longest time for clients to leave.
const FAREWELL: Duration = Duration::from_secs(2);

/// The sockets of a daemon, bound before anything else is started: an address in use is reported at once.
#[derive(Default)]
pub struct Bound {
    ingest: Vec<Listener>,
    /// Where viewers hear the samples.
    signals: Arc<Signals>,
}

impl Bound {
    /// Binds the configured addresses and the sockets handed over by systemd.
    ///
    /// # Errors
    /// An address is taken.
    pub fn bind(config: &Config, inherited: Vec<Listener>, signals: Arc<Signals>) -> anyhow::Result<Self> {
        Ok(Self {
            signals,
            ingest: Listener::all(inherited, &config.ingest.listen)?,
        })
    }
}

/// Journal and sockets at work.
pub struct Live {
    journal: Option<(Journal, PathBuf)>,
    topics: watch::Sender<Arc<TopicSet>>,
    stop: watch::Sender<bool>,
    serving: Option<JoinHandle<()>>,
    counts: Arc<Counts>,
    signals: Arc<Signals>,
    uploader: Option<Uploader>,
}

impl Live {
    /// Resumes the journal and admits clients. Without a socket there is a journal only if one existed
    /// before: its content is still read.
    ///
    /// # Errors
    /// The journal or a certificate cannot be used.
    pub fn start(
        config: &Config,
        store: &Path,
        bound: Bound,
        runtime: &Runtime,
        telemetry: &Telemetry,
        (sender, halted): (&Sender<LifecycleEvent>, Arc<AtomicBool>),
    ) -> anyhow::Result<Self> {
        let health = &telemetry.health;
        let (topics, wanted) = watch::channel(Arc::new(ingest::topics_of(&config.rods)));
        let (stop, stopped) = watch::channel(false);
        let counts = Arc::<Counts>::default();
        let mut live = Self {
            journal: None,
            topics,
            stop,
            serving: None,
            counts: Arc::clone(&counts),
            signals: bound.signals,
            uploader: None,
        };
        let folder = folder_of(config, store);
        if bound.ingest.is_empty() && !folder.is_dir() {
            return Ok(live);
        }
        let failed = {
            let (sender, health) = (sender.clone(), Arc::clone(health));
            move |error: crate::service::journal::JournalError| {
                health.hold(Fault::Write, "journal", &error);
                // A daemon that stops does not listen any more.
                let _ = sender.send(LifecycleEvent::Failed(error.into()));
            }
        };
        let resume_s = config.ingest.resume_s;
        let around = Around {
            beat: telemetry.beats.of("journal"),
            health: Arc::clone(health),
            halted,
            vouch: Box::new(vouch(store)),
            copied: config.bucket.as_ref().map(|_| Arc::default()),
        };
        let copied = around.copied.clone();
        let journal = Journal::start(&folder, &config.journal, resume_s, around, failed)?;
        refuse_within(&folder, config)?;
        if let (Some(bucket), Some(copied)) = (&config.bucket, copied) {
            live.uploader = Some(Uploader::start(
                Pace::default(),
                bucket,
                &folder,
                copied,
                telemetry.clone(),
            )?);
        }
        telemetry.metrics.watch_disk("journal", folder.clone());
        if !bound.ingest.is_empty() {
            let server = Server::new(
                config.ingest.clone(),
                wanted,
                journal.handle(),
                Arc::clone(health),
                counts,
            )?;
            let (sender, stop) = (sender.clone(), stopped.clone());
            let serving = runtime.spawn(ingest::serve(bound.ingest, server, stopped));
            live.serving = Some(runtime.spawn(async move {
                let error = match serving.await {
                    Ok(Ok(())) if *stop.borrow() => return,
                    Ok(Ok(())) => anyhow::anyhow!("the sockets closed by themselves"),
                    Ok(Err(error)) => error.into(),
                    Err(broken) => {
                        anyhow::anyhow!("the sockets: the program broke, please report it: {broken}")
                    }
                };
                // A daemon that stops does not listen any more.
                let _ = sender.send(LifecycleEvent::Failed(error));
            }));
        }
        live.journal = Some((journal, folder));
        Ok(live)
    }

    /// Source for the reader.
    pub fn source(&self) -> Option<JournalSource> {
        self.journal.as_ref().map(|(journal, folder)| JournalSource {
            folder: folder.clone(),
            handle: journal.handle(),
            results_kept: journal.results_kept(),
            signals: Arc::clone(&self.signals),
        })
    }

    /// Bell that rings when there is new data to read.
    pub fn bell(&self) -> Arc<Bell> {
        self.journal
            .as_ref()
            .map_or_else(Arc::default, |(journal, _)| journal.bell())
    }

    /// See [`Journal::results_kept`].
    pub fn results_kept(&self) -> Arc<AtomicU32> {
        self.journal
            .as_ref()
            .map_or_else(Arc::default, |(journal, _)| journal.results_kept())
    }

    /// Gauges to be shown from time to time.
    pub fn gauges(&self) -> Gauges {
        Gauges {
            counts: Arc::clone(&self.counts),
            journal: self.journal.as_ref().map(|(_, folder)| folder.clone()),
            shown: Mutex::default(),
        }
    }

    /// Changes the rods on whose topics clients' messages are kept from now on.
    pub fn retarget(&self, rods: &[RodConfig]) {
        self.topics.send_replace(Arc::new(ingest::topics_of(rods)));
    }

    /// Admits no more clients, and begins to disconnect those present.
    pub fn hang_up(&self) {
        self.stop.send_replace(true);
    }

    /// Waits for the clients to leave and makes their data durable.
    pub fn stop(self, runtime: &Runtime) {
        if let Some(serving) = self.serving {
            // A client that does not go is cut off with the runtime.
            let _ = runtime.block_on(async { tokio::time::timeout(FAREWELL, serving).await });
        }
        drop(self.uploader);
        if let Some((journal, _)) = self.journal {
            journal.stop();
        }
    }
}

/// Refuses a journal whose parts the watched folder would bring once more, cut otherwise.
fn refuse_within(journal: &Path, config: &Config) -> anyhow::Result<()> {
    let Some(watched) = &config.ingest.folder else {
        return Ok(());
    };
    let real = |path: &Path| path.canonicalize().or_else(|_| std::path::absolute(path));
    let (inner, outer) = (real(journal)?, real(watched)?);
    anyhow::ensure!(
        inner != outer && !(config.ingest.subfolders && inner.starts_with(&outer)),
        "the journal {} lies in the watched folder {}, which would read its parts a second time: put another folder into \
         [journal] folder or [ingest] folder",
        journal.display(),
        watched.display()
    );
    Ok(())
}

/// Folder of the journal: the configured one, or `journal` next to the store.
pub(super) fn folder_of(config: &Config, store: &Path) -> PathBuf {
    config
        .journal
        .folder
        .clone()
        .unwrap_or_else(|| store.parent().unwrap_or(Path::new(".")).join("journal"))
}

/// Returns a function that gives the ages of a journal's parts, the oldest first, in working time of daemons
/// \[s\]: of the parts that were read to their end according to the store on disk, opened again by its name.
pub fn vouch(store: &Path) -> impl Fn(&[Kept]) -> Vec<f64> + Send + use<> {
    let store = store.to_owned();
    move |parts| {
        let asked = || -> Result<Vec<f64>, StoreError> {
            let reader = StoreReader::open(&store)?;
            let (files, lived, now) = (reader.files()?, reader.stretches()?, clock::now());
            let age_s = |kept: &Kept| {
                let mark = files.get(&part::mark_name(kept.part))?;
                let written = Timestamp::from_nanos(kept.modified_ns);
                let is_same = (mark.size, mark.modified_ns) == (kept.bytes, kept.modified_ns);
                is_same.then(|| Stretch::lived(&lived, written, now))
            };
            Ok(parts.iter().map_while(age_s).collect())
        };
        asked().unwrap_or_else(|error| {
            tracing::warn!("parts of the journal stay: {error}");
            Vec::new()
        })
    }
}

/// Counts of the sockets on their way to the metrics.
pub struct Gauges {
    counts: Arc<Counts>,
    journal: Option<PathBuf>,
    /// Numbers of messages and bytes shown so far.
    shown: Mutex<(u64, u64)>,
}

impl Gauges {
    /// Adds the counts since the last call to the metrics.
    pub fn show(&self, metrics: &Metrics) {
        let of = |count: &std::sync::atomic::AtomicU64| count.load(Ordering::Relaxed);
        let (messages, bytes) = (of(&self.counts.messages), of(&self.counts.bytes));
        let mut shown = self
            .shown
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        metrics.received(messages - shown.0, bytes - shown.1);
        metrics.clients(usize::try_from(of(&self.counts.clients)).unwrap_or(usize::MAX));
        *shown = (messages, bytes);
        if let Some(folder) = &self.journal {
            metrics.journal(bytes_in(folder));
        }
    }
}

/// Total size of a journal's parts \[bytes\].
fn bytes_in(folder: &Path) -> u64 {
    let parts = part::list(folder).unwrap_or_default();
    let size = |part: u32| std::fs::metadata(part::path(folder, part)).map_or(0, |data| data.len());
    parts.into_iter().map(size).sum()
}
