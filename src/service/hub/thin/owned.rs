//! One site under a lease: its state is fetched, messages are given to its daemon, and what comes of them is kept.
//!
//! Messages are given as a set: the next one when all of the set is read. The database has a state only at the ends of sets, so that
//! state, rows and position always say the same, whatever is killed and whoever goes on.

use super::daemon::Daemon;
use super::lease::{Kept, Lease};
use super::payload;
use super::raw::{RAW, Raw};
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
use crate::service::hub::copy::{CopyError, SiteCopy};
use crate::service::hub::fold::{self, Fold};
use crate::service::hub::incoming::Incoming;
use crate::service::hub::text::fit;
use crate::service::telemetry::{Fault, Health};
use crate::site::clock;
use crate::site::store::{Durability, FORMAT, Reader, Store, StoreError};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
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
/// Longest time for a set to be read, after which it is told.
const SLOW: Duration = Duration::from_secs(600);

/// Subjects of conditions.
const POST: &str = "work/post";
const READING: &str = "work/reading";

/// Reason why a site is given up.
#[derive(Debug, thiserror::Error)]
pub enum WorkError {
    /// Another worker has it.
    #[error("another worker has the site: this one stood still for longer than its lease")]
    Fenced,
    /// Its daemon ended.
    #[error("its daemon ended ({0}); its own lines tell why")]
    Daemon(std::process::ExitStatus),
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
    files: Vec<String>,
    unread: Vec<(Incoming, String)>,
    /// Its last message.
    position: Position,
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
    daemon: Daemon,
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
        site: &'a SiteSettings,
        mut centre: Centre,
        lease: Lease,
    ) -> Result<Self, WorkError> {
        let renewed = Instant::now();
        let config = site.config.clone().unwrap_or_default();
        let folder = around.folder.join(&site.name);
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(within::recordings(&folder))?;
        let renewing = RefCell::new((hub::beside(&around.config.storage)?, renewed));
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
                    .map(|key| Obedience::new(&key, &site.name, &store, &config))
            }
        };
        let daemon = Daemon::start(&config, &folder)?;
        Ok(Self {
            daemon,
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
        if let Some(status) = self.daemon.ended()? {
            return Err(WorkError::Daemon(status));
        }
        let reloads = self.around.reloads.load(Ordering::Relaxed);
        if reloads != self.reloads {
            self.reloads = reloads;
            self.daemon.reload();
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

    /// Keeps what the daemon has made, once it has read all that it was given.
    fn keep(&mut self) -> Result<(), WorkError> {
        self.tell_slow();
        let version = self.reader.data_version()?;
        if self.seen == Some(version) {
            return Ok(());
        }
        self.seen = Some(version);
        let files = self.set.as_ref().map_or(&[][..], |set| &set.files);
        let made = self.reader.together(|reader| {
            if !reader.has_read(files)? {
                return Ok(None);
            }
            let changes = reader.changes_after(self.through, usize::MAX)?;
            Ok(Some((changes, reader.remainder()?)))
        })?;
        let Some((changes, remainder)) = made else {
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
        for (message, reason) in self.set.iter().flat_map(|set| &set.unread) {
            let detail = fit(
                &format!("message {}: {reason}", message.sequence),
                fold::LONGEST_DETAIL,
            );
            self.fold
                .set_aside(&self.site.name, message, (fold::UNREADABLE, detail), &mut batch);
        }
        let kept = Kept { position, remainder };
        if !self.centre.commit_under(&self.lease, batch, &kept)? {
            return Err(WorkError::Fenced);
        }
        self.renewed = Instant::now();
        self.through = kept.remainder.through;
        self.position = position;
        if let Some(set) = self.set.take() {
            for name in set.files {
                fs::remove_file(within::recordings(&self.folder).join(name))?;
            }
        }
        Ok(())
    }

    /// Tells of a set that the daemon does not come to the end of.
    fn tell_slow(&self) {
        let Some(set) = self.set.as_ref().filter(|set| set.since.elapsed() >= SLOW) else {
            return self.health.over(Fault::Behind, READING);
        };
        let detail = format!(
            "{}: its daemon has not read messages {} to {} of {RAW}.{} for {:.0} min; nothing more is given to it",
            self.site.name,
            self.position.sequence + 1,
            set.position.sequence,
            self.site.name,
            set.since.elapsed().as_secs_f64() / 60.0
        );
        self.health.hold(Fault::Behind, READING, detail);
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
        let (Some(_), Some(post)) = (messages.last(), &self.post) else {
            self.post_due = Instant::now() + POLL;
            return Ok(());
        };
        let position = post.position();
        let written = payload::write(&within::recordings(&self.folder), messages)?;
        for (message, reason) in &written.unread {
            let detail = format!(
                "{}: message {} of {RAW}.{} is parked: {reason}",
                self.site.name, message.sequence, self.site.name
            );
            self.health.fault(Fault::Forward, detail);
        }
        self.set = Some(Set {
            files: written.files,
            unread: written.unread,
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
        runtime.block_on(async {
            post.seek(self.position).await?;
            post.fetch().await
        })
    }

    /// Says at the post that the site lives. A hub that does not listen is no reason to stop.
    fn beat(&mut self) -> Result<(), WorkError> {
        let Some(post) = &self.post else { return Ok(()) };
        let mut beat = Heartbeat::of(&self.reader, &self.epoch, &self.health)?;
        if let Some(obedience) = &self.obedience {
            beat.refused = obedience.refused().clone();
        }
        let payload = serde_json::to_vec(&beat).map_err(io::Error::from)?;
        if let Err(error) = self.around.runtime.block_on(post.beat(payload)) {
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
        obedience.look(&self.health);
        let mut open = self.centre.open_commands(clock::now().as_nanos())?;
        let open = open.remove(&self.site.name).unwrap_or_default();
        let open: Vec<_> = open.into_iter().map(|(_, signed)| signed).collect();
        Ok(obedience.follow(&open, &self.epoch, &self.reader, &self.health)?)
    }
}

/// Makes the store of a site on this machine from what the database has, unless the site is lost meanwhile; returns the last message
/// and the last commit in it.
fn fetch(
    centre: &mut Centre,
    site: &str,
    path: &Path,
    is_lost: &dyn Fn() -> bool,
) -> Result<(Position, i64), WorkError> {
    let Some(kept) = centre.kept(site)? else {
        // Made here, so that it can be read before its daemon has begun.
        drop(Store::open(path, Durability::Replay)?);
        return Ok((Position::default(), 0));
    };
    let history = centre.sites()?.remove(site).and_then(|state| {
        let history = state.history()?;
        Some((history.epoch.clone(), history.through))
    });
    let (epoch, through) = (kept.remainder.epoch.clone(), kept.remainder.through);
    let mut store = match &history {
        None if through == 0 => Store::open(path, Durability::Replay)?,
        Some(own) if *own == (epoch, through) => {
            let mut copy = SiteCopy::begin(centre, site, None, None, path)?;
            copy.renew(centre, is_lost)?;
            copy.into_store()
        }
        _ => {
            return Err(WorkError::Contradiction(format!(
                "the centre's rows of {site} end with {history:?}, and its kept state with commit {through} of store {}: rows of this \
                 site were written, or removed, by something else",
                kept.remainder.epoch
            )));
        }
    };
    store.take_up(kept.remainder)?;
    Ok((kept.position, through))
}
