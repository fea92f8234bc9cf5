//! Sites without a computer: their samples come through the post, and a worker of the centre has their daemon.
//!
//! A worker has whole sites, each under a lease. The daemon of a site is this program's own, over a store that the worker makes from
//! the database and copies back to it; it ends in the rows of a replay, whichever worker had the site, and whatever was killed.

mod daemon;
mod lease;
mod minder;
mod owned;
mod payload;
mod raw;
mod takeover;

use super::centre::CentreError;
use super::feed;
use super::scratch::Scratch;
use crate::config::HubConfig;
use crate::config::settings::hub::SiteSettings;
use crate::config::settings::ingest::names;
use crate::service::forward::link::LinkError;
use owned::{Around, Owned, WorkError};
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, ScopedJoinHandle};
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

/// Interval between looks for free sites.
const LOOK: Duration = Duration::from_secs(1);
/// Waits before a site that was given up is taken again, and before the database is asked again.
const AGAIN: Duration = Duration::from_secs(10);
const DATABASE_AGAIN: Duration = Duration::from_secs(5);
/// Step in which a wait looks for the end.
const STEP: Duration = Duration::from_millis(50);

/// Reason why a worker cannot begin.
#[derive(Debug, thiserror::Error)]
pub enum BeginError {
    /// No site has a configuration at the centre.
    #[error("no [[site]] of the list has a `config`{0}: only sites without a computer are worked on")]
    NoSites(String),
    /// The configurations of all sites are bad, or none of a site without a computer.
    #[error("{0}")]
    Unfit(String),
    /// The database.
    #[error(transparent)]
    Centre(#[from] CentreError),
    /// The post.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The folder for the sites' stores.
    #[error("{0}: {1}")]
    Folder(String, io::Error),
}

/// Choice of a worker.
#[derive(Debug, Clone)]
pub struct Choice {
    /// Names of sites, or their beginnings with a `*` behind. All sites without any.
    pub sites: Vec<String>,
    /// Most sites at once.
    pub most: usize,
    /// Time for which a lease lasts without being renewed.
    pub lease: Duration,
    /// Name of the worker, for people.
    pub holder: String,
}

/// A worker.
pub struct Worker<'a> {
    config: &'a HubConfig,
    runtime: &'a Runtime,
    choice: Choice,
    /// Sites that it may take, each with its configuration.
    sites: Vec<(&'a SiteSettings, &'a Path)>,
    folder: Scratch,
    stopping: Arc<AtomicBool>,
    reloads: Arc<AtomicU64>,
}

impl<'a> Worker<'a> {
    /// Checks configurations, database and post.
    ///
    /// # Errors
    /// One of them is not fit, or cannot be reached.
    pub fn new(
        config: &'a HubConfig,
        runtime: &'a Runtime,
        choice: Choice,
        (stopping, reloads): (Arc<AtomicBool>, Arc<AtomicU64>),
    ) -> Result<Self, BeginError> {
        let is_chosen = |site: &SiteSettings| {
            choice.sites.is_empty() || choice.sites.iter().any(|pattern| names(pattern, &site.name))
        };
        let thin = config.sites.iter().filter(|site| is_chosen(site));
        let sites: Vec<_> = thin
            .filter_map(|site| Some((site, site.config.as_deref()?)))
            .collect();
        if sites.is_empty() {
            let chosen = match choice.sites.as_slice() {
                [] => String::new(),
                some => format!(" and a name like {}", some.join(", ")),
            };
            return Err(BeginError::NoSites(chosen));
        }
        // A site whose configuration is bad does not keep the others down.
        let bad = sites.iter().filter_map(|(_, config)| daemon::check(config).err());
        let bad: Vec<String> = bad.collect();
        if bad.len() == sites.len() {
            return Err(BeginError::Unfit(bad.join("\n")));
        }
        for reason in bad {
            tracing::error!("{reason}");
        }
        super::for_worker(&config.storage, choice.lease)?.holders()?;
        runtime.block_on(raw::Raw::open(config, &sites[0].0.name))?;
        // The post has the only copy of the samples.
        feed::check_flushing(&config.monitors)?;
        let below = &config.copies.path;
        let folder =
            Scratch::new(below).map_err(|error| BeginError::Folder(below.display().to_string(), error))?;
        Ok(Self {
            config,
            runtime,
            sites,
            folder,
            stopping,
            reloads,
            choice,
        })
    }

    /// Number of sites that it may take.
    pub fn candidates(&self) -> usize {
        self.sites.len()
    }

    /// Takes free sites and works on them until stopped; whatever fails is tried again.
    pub fn run(&self) {
        thread::scope(|scope| {
            let mut taken: BTreeMap<&str, ScopedJoinHandle<'_, ()>> = BTreeMap::new();
            let mut again: BTreeMap<&str, Instant> = BTreeMap::new();
            let mut centre = None;
            while !self.is_stopping() {
                taken.retain(|site, work| {
                    let goes_on = !work.is_finished();
                    if !goes_on {
                        again.insert(site, Instant::now() + AGAIN);
                    }
                    goes_on
                });
                let mut look = || -> Result<(), CentreError> {
                    let centre = match &mut centre {
                        Some(centre) => centre,
                        none => none.insert(super::for_worker(&self.config.storage, self.choice.lease)?),
                    };
                    for (site, config) in &self.sites {
                        let name = site.name.as_str();
                        let is_due = again.get(name).is_none_or(|until| Instant::now() >= *until);
                        if taken.len() >= self.choice.most || taken.contains_key(name) || !is_due {
                            continue;
                        }
                        let lasts = self.choice.lease;
                        if let Some(lease) = centre.take_lease(name, &self.choice.holder, lasts)? {
                            taken.insert(name, scope.spawn(move || self.work((site, config), lease)));
                        }
                    }
                    Ok(())
                };
                match look() {
                    Ok(()) => self.wait(LOOK),
                    Err(error) => {
                        tracing::warn!("the database cannot be asked for free sites: {error}");
                        centre = None;
                        self.wait(DATABASE_AGAIN);
                    }
                }
            }
        });
    }

    /// Works on a site until it is given up.
    fn work(&self, (site, config): (&SiteSettings, &Path), lease: lease::Lease) {
        let name = &site.name;
        tracing::info!("{name}: taken");
        let around = Around {
            config: self.config,
            runtime: self.runtime,
            folder: self.folder.path(),
            stopping: &self.stopping,
            reloads: &self.reloads,
        };
        let work = || -> Result<(), WorkError> {
            let centre = super::for_worker(&self.config.storage, lease.lasts)?;
            Owned::begin(around, (site, config), centre, lease.clone())?.run()
        };
        match work() {
            Ok(()) => tracing::info!("{name}: given back"),
            Err(error) => {
                tracing::error!("{name}: given up: {error}");
                // If the database is not there, the lease ends by itself.
                let centre = super::for_worker(&self.config.storage, lease.lasts);
                let _ = centre.and_then(|mut centre| centre.release(&lease));
            }
        }
    }

    fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed)
    }

    fn wait(&self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until && !self.is_stopping() {
            thread::sleep(STEP);
        }
    }
}
