//! One site under a lease: its state is fetched, messages are given to its daemon, and what comes of them is kept.
//!
//! Messages are given as a set: the next one when all of the set is read. The database has a state only at the ends of sets, so that
//! state, rows and position always say the same, whatever is killed and whoever goes on.

use super::daemon;
use super::lease::{Kept, Lease};
use super::minder::{Looked, Minder};
use super::payload::{self, Written};
use super::raw::{RAW, Raw};
use super::takeover::fetch;
use crate::config::settings::credential::CredentialError;
use crate::config::settings::hub::SiteSettings;
use crate::config::{HubConfig, within};
use crate::service::forward::beat::Heartbeat;
use crate::service::forward::link::LinkError;
use crate::service::forward::message::Label;
use crate::service::forward::obey::Obedience;
use crate::service::hub;
use crate::service::hub::batch::Batch;
use crate::service::hub::centre::{Centre, CentreError, Position};
use crate::service::hub::copy::CopyError;
use crate::service::hub::fold::{self, Fold};
use crate::service::hub::incoming::Incoming;
use crate::service::hub::park::Parked;
use crate::service::hub::text::fit;
use crate::service::telemetry::{Fault, Health};
use crate::site::clock;
use crate::site::store::{FORMAT, Reader, StoreError};
use sha2::{Digest, Sha256};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use std::{fs, io, thread};
use tokio::runtime::Runtime;

/// Interval between looks at the store.
const LOOK: Duration = Duration::from_millis(50);
/// Interval between looks at the end of the subject.
const POLL: Duration = Duration::from_secs(1);
/// Interval between heartbeats, and between looks for commands.
const BEAT: Duration = Duration::from_secs(60);
const COMMANDS: Duration = Duration::from_secs(5);
/// Wait after the post failed.
const POST_AGAIN: Duration = Duration::from_secs(5);
/// Number of recordings that are remembered, by their content, to know one that comes again.
const REMEMBERED: usize = 256;

/// Subjects of conditions.
const POST: &str = "work/post";
const READING: &str = "work/daemon";

/// Reason why a site is given up.
#[derive(Debug, thiserror::Error)]
pub enum WorkError {
    /// Another worker has it.
    #[error("another worker has the site: this one stood still for longer than its lease")]
    Fenced,
    /// Its daemon does not take the configuration, or cannot go on.
    #[error("its daemon ended ({0}); its own lines tell why")]
    Daemon(std::process::ExitStatus),
    /// Its configuration is bad, or none of a site without a computer.
    #[error("{0}")]
    Unfit(String),
    /// Rows and state at the centre contradict each other.
    #[error("{0}")]
    Contradiction(String),
    /// The database.
    #[error(transparent)]
    Centre(#[from] CentreError),
    /// The copy of its rows.
    #[error(transparent)]
    Copy(#[from] CopyError),
    /// The store on this machine.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The key of commands.
    #[error(transparent)]
    Credential(#[from] CredentialError),
    /// A file on this machine.
    #[error("{0}")]
    Io(#[from] io::Error),
}

/// Surroundings of the work.
#[derive(Clone, Copy)]
pub struct Around<'a> {
    /// Configuration of the centre.
    pub config: &'a HubConfig,
    /// For the post.
    pub runtime: &'a Runtime,
    /// Folder on this machine.
    pub folder: &'a Path,
    /// True when the worker is to end.
    pub stopping: &'a AtomicBool,
    /// Number of times that configurations are to be read again.
    pub reloads: &'a AtomicU64,
}

/// Messages that the daemon has, and does not have in its store yet.
struct Set {
    written: Written,
    /// Its last message.
    position: Position,
    /// Time since which its daemon has it.
    since: Instant,
}

/// A site under a lease.
pub struct Owned<'a> {
    around: Around<'a>,
    site: &'a SiteSettings,
    lease: Lease,
    centre: Centre,
    fold: Fold,
    /// Its folder on this machine.
    folder: PathBuf,
    reader: Reader,
    epoch: String,
    config: &'a Path,
    daemon: Minder,
    /// Contents of the latest recordings.
    remembered: VecDeque<[u8; 32]>,
    post: Option<Raw>,
    post_due: Instant,
    /// Message up to which the database has everything.
    position: Position,
    /// Last commit that the database has.
    through: i64,
    set: Option<Set>,
    /// Version of the store that was looked at last.
    seen: Option<i64>,
    renewed: Instant,
    beat_due: Instant,
    commands_due: Instant,
    obedience: Option<Obedience>,
    reloads: u64,
    health: Health,
}

impl<'a> Owned<'a> {
    /// Fetches the state of a site, and starts its daemon.
    ///
    /// # Errors
    /// Database or disk refuse, or the rows are not those of the state.
    pub fn begin(
        around: Around<'a>,
        (site, config): (&'a SiteSettings, &'a Path),
        mut centre: Centre,
        lease: Lease,
    ) -> Result<Self, WorkError> {
        let renewed = Instant::now();
        daemon::check(config).map_err(WorkError::Unfit)?;
        let folder = around.folder.join(&site.name);
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(within::recordings(&folder))?;
        let beside = hub::for_worker(&around.config.storage, lease.lasts)?;
        let renewing = RefCell::new((beside, renewed));
        // Years of rows take longer than a lease.
        let is_lost = || {
            let (centre, at) = &mut *renewing.borrow_mut();
            if at.elapsed() < lease.lasts / 3 {
                return false;
            }
            *at = Instant::now();
            !matches!(centre.renew(&lease), Ok(true))
        };
        let store = within::store(&folder);
        let (position, through) = fetch(&mut centre, &site.name, &store, &is_lost)?;
        let reader = Reader::open(&store)?;
        let epoch = reader.epoch()?.unwrap_or_default();
        let sites = centre.sites()?;
        let fold = Fold::new(
            BTreeSet::new(),
            centre.copied().to_vec(),
            sites.into_iter().filter(|(name, _)| *name == site.name).collect(),
            BTreeMap::new(),
        );
        let obedience = match &site.command_key {
            None => None,
            Some(file) => {
                let seed = String::from_utf8_lossy(&file.read_private()?).into_owned();
                let public = nkeys::KeyPair::from_seed(seed.trim()).map(|pair| pair.public_key());
                public
                    .ok()
                    .map(|key| Obedience::new(&key, &site.name, &store, config).of_worker())
            }
        };
        Ok(Self {
            daemon: Minder::start(&site.name, config, &folder)?,
            remembered: VecDeque::new(),
            config,
            around,
            site,
            lease,
            centre,
            fold,
            reader,
            epoch,
            folder,
            post: None,
            post_due: renewed,
            position,
            through,
            set: None,
            seen: None,
            renewed,
            beat_due: renewed,
            commands_due: renewed,
            obedience,
            reloads: around.reloads.load(Ordering::Relaxed),
            health: Health::default(),
        })
    }

    /// Works until the worker is to end; the site is free then.
    ///
    /// # Errors
    /// The site is to be given up: what is not in the database is done again by whoever has it next.
    pub fn run(mut self) -> Result<(), WorkError> {
        while !self.around.stopping.load(Ordering::Relaxed) {
            self.step()?;
            thread::sleep(LOOK);
        }
        self.daemon.stop();
        self.keep()?;
        Ok(self.centre.release(&self.lease)?)
    }

    fn step(&mut self) -> Result<(), WorkError> {
        self.mind_daemon()?;
        let reloads = self.around.reloads.load(Ordering::Relaxed);
        if reloads != self.reloads {
            self.reloads = reloads;
            match daemon::check(self.config) {
                Ok(()) => self.daemon.reload(),
                Err(reason) => {
                    tracing::error!("{}: the present configuration stays: {reason}", self.site.name)
                }
            }
        }
        self.health.tick();
        self.keep()?;
        if self.renewed.elapsed() >= self.lease.lasts / 3 {
            if !self.centre.renew(&self.lease)? {
                return Err(WorkError::Fenced);
            }
            self.renewed = Instant::now();
        }
        let now = Instant::now();
        if self.set.is_none() && now >= self.post_due {
            self.give()?;
        }
        if now >= self.beat_due {
            self.beat_due = now + BEAT;
            self.beat()?;
        }
        if now >= self.commands_due {
            self.commands_due = now + COMMANDS;
            self.obey()?;
        }
        Ok(())
    }

    fn mind_daemon(&mut self) -> Result<(), WorkError> {
        let given = self.set.as_ref().map(|set| set.since);
        match self.daemon.look(given)? {
            Looked::Well => self.health.over(Fault::Behind, READING),
            Looked::AsBefore => {}
            Looked::Ended(detail) => self.health.hold(Fault::Behind, READING, detail),
            Looked::GivenUp(status) => return Err(WorkError::Daemon(status)),
        }
        Ok(())
    }

    /// Keeps what the daemon has made, once it has read all that it was given.
    fn keep(&mut self) -> Result<(), WorkError> {
        let version = self.reader.data_version()?;
        if self.seen == Some(version) {
            return Ok(());
        }
        self.seen = Some(version);
        let files = self.set.iter().flat_map(|set| set.written.files.keys());
        let made = self.reader.together(|reader| {
            let Some(losses) = reader.losses_of(files)? else {
                return Ok(None);
            };
            let changes = reader.changes_after(self.through, usize::MAX)?;
            Ok(Some((losses, changes, reader.remainder()?)))
        })?;
        let Some((losses, changes, remainder)) = made else {
            return Ok(());
        };
        let mut batch = Batch::default();
        let now_ns = clock::now().as_nanos();
        // Somebody may have dropped what was parked.
        let fault = self.centre.first_fault(&self.site.name)?;
        self.fold.mark(&self.site.name, fault, &mut batch);
        let position = self.set.as_ref().map_or(self.position, |set| set.position);
        if let Some(last) = changes.last() {
            let label = Label {
                epoch: self.epoch.clone(),
                first: self.through + 1,
                last: last.number,
                format: FORMAT,
                mark: String::new(),
            };
            let came = Position {
                sequence: position.sequence,
                time_ns: now_ns,
            };
            let of = (self.site.name.as_str(), &label);
            let added = self.fold.add(of, came, || Ok(changes), &mut batch);
            added.map_err(|(fault, detail)| WorkError::Contradiction(format!("{fault}: {detail}")))?;
        }
        // Damaged recordings, and those that were set aside because the program ends at them.
        let of_files = self.set.iter().flat_map(|set| set.written.files.values());
        let of_files = of_files.zip(&losses);
        let lost = of_files.filter_map(|(message, loss)| Some((message.as_ref()?, loss.as_ref()?)));
        let unread = self.set.iter().flat_map(|set| &set.written.unread);
        let unread = unread.map(|(message, reason)| (message, reason));
        for (message, reason) in unread.chain(lost) {
            self.health.fault(
                Fault::Forward,
                format!(
                    "{}: message {} of {RAW}.{} is parked: {reason}",
                    self.site.name, message.sequence, self.site.name
                ),
            );
            let detail = fit(
                &format!("message {}: {reason}", message.sequence),
                fold::LONGEST_DETAIL,
            );
            let parked = Parked {
                site: self.site.name.clone(),
                ..message.parked(fold::UNREADABLE, detail)
            };
            self.fold.set_aside(parked, &mut batch);
        }
        let kept = Kept { position, remainder };
        if !self.centre.commit_under(&self.lease, batch, &kept)? {
            return Err(WorkError::Fenced);
        }
        self.renewed = Instant::now();
        self.through = kept.remainder.through;
        self.position = position;
        if let Some(set) = self.set.take() {
            self.daemon.came_to_an_end();
            for name in set.written.files.into_keys() {
                fs::remove_file(within::recordings(&self.folder).join(name))?;
            }
        }
        Ok(())
    }

    /// Gives the next messages to the daemon, if there are any.
    fn give(&mut self) -> Result<(), WorkError> {
        let messages = match self.fetch() {
            Ok(messages) => messages,
            Err(error) => {
                self.post = None;
                self.post_due = Instant::now() + POST_AGAIN;
                let detail = format!("{}: the post cannot be read: {error}", self.site.name);
                self.health.hold(Fault::Forward, POST, detail);
                return Ok(());
            }
        };
        self.health.over(Fault::Forward, POST);
        let Some(last) = messages.last() else {
            self.post_due = Instant::now() + POLL;
            return Ok(());
        };
        let position = Position {
            sequence: last.sequence,
            time_ns: last.time_ns,
        };
        let messages = self.news(messages);
        self.set = Some(Set {
            written: payload::write(&within::recordings(&self.folder), messages)?,
            position,
            since: Instant::now(),
        });
        self.seen = None;
        Ok(())
    }

    fn fetch(&mut self) -> Result<Vec<Incoming>, LinkError> {
        let runtime = self.around.runtime;
        let post = match &mut self.post {
            Some(post) => post,
            none => none.insert(runtime.block_on(Raw::open(self.around.config, &self.site.name))?),
        };
        // A request longer than the lease would lose it.
        let longest = self.lease.lasts / 3;
        let ask = async {
            post.seek(self.position).await?;
            post.fetch(Instant::now() + longest / 2).await
        };
        let asked = runtime.block_on(async { tokio::time::timeout(longest, ask).await });
        asked.unwrap_or_else(|_| Err(LinkError::Failed(format!("no answer within {longest:?}"))))
    }

    /// Messages without the recordings that came before: one whose acknowledgement was lost is sent again.
    fn news(&mut self, mut messages: Vec<Incoming>) -> Vec<Incoming> {
        messages.retain(|message| {
            if !payload::is_recording(message) {
                return true;
            }
            let content = <[u8; 32]>::from(Sha256::digest(&message.payload));
            let is_news = !self.remembered.contains(&content);
            if is_news {
                self.remembered.push_back(content);
            }
            if self.remembered.len() > REMEMBERED {
                self.remembered.pop_front();
            }
            is_news
        });
        messages
    }

    /// Says at the post that the site lives. A hub that does not listen is no reason to stop.
    fn beat(&mut self) -> Result<(), WorkError> {
        // A site whose daemon comes to no end is not one that lives: the hub is to tell that it is silent.
        let Some(post) = self.post.as_ref().filter(|_| self.daemon.is_well()) else {
            return Ok(());
        };
        let mut beat = Heartbeat::of(&self.reader, &self.epoch, &self.health)?;
        if let Some(obedience) = &self.obedience {
            beat.refused = obedience.refused().clone();
        }
        if let Err(error) = self.around.runtime.block_on(post.beat(&beat)) {
            tracing::warn!(
                "{}: the post does not take its heartbeat: {error}",
                self.site.name
            );
        }
        Ok(())
    }

    /// Carries out the commands that wait for the site in the database.
    fn obey(&mut self) -> Result<(), WorkError> {
        let Some(obedience) = &mut self.obedience else {
            return Ok(());
        };
        let mut open = self.centre.open_commands(clock::now().as_nanos())?;
        let open = open.remove(&self.site.name).unwrap_or_default();
        let open: Vec<_> = open.into_iter().map(|(_, signed)| signed).collect();
        Ok(obedience.follow(&open, &self.epoch, &self.reader, &self.health)?)
    }
}
