//! The centre of many sites: folds their logs, as the post delivers them, into one database.
//!
//! One message is folded once: the position in the stream and each site's last commit are written in the transaction of the rows.
//! A message that cannot be folded is parked with its reason; its site is marked, the others go on. docs/hub.md describes it for operators.

pub mod batch;
pub mod beats;
pub mod centre;
pub mod commands;
pub mod copies;
pub mod copy;
pub mod feed;
pub mod fold;
pub mod incoming;
mod lasting;
pub mod map;
pub mod page;
pub mod park;
#[cfg(test)]
mod post;
mod postgres;
mod rebuild;
mod regulator;
mod relay;
#[cfg(test)]
mod relay_tests;
mod rows;
pub mod scratch;
mod silence;
pub mod sites;
pub mod sql;
mod sqlite;
pub mod tables;
mod text;
pub mod thin;
mod told;
pub mod watch;
mod work;

use crate::config::HubConfig;
use crate::config::settings::hub::Storage;
use crate::service::alert::{Backoff, Pace};
use crate::service::forward::link::LinkError;
use crate::service::telemetry::{Beat, Fault, Health};
use beats::Beats;
use centre::{Centre, CentreError};
use feed::Feed;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;
use work::Work;

/// Subject of the condition of folding that stands still. No site has a slash in its name.
const ABOUT: &str = "hub/folding";

/// Error of the hub.
#[derive(Debug, thiserror::Error)]
pub enum HubError {
    /// The database.
    #[error(transparent)]
    Centre(#[from] CentreError),
    /// The post.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A rebuild would lose results.
    #[error("a rebuild would lose results of {0}: {1}")]
    Lost(String, String),
}

/// Opens the database for folding.
///
/// # Errors
/// It refuses, or another hub has it.
pub fn open(storage: &Storage) -> Result<Centre, CentreError> {
    match storage {
        Storage::Sqlite(path) => Centre::open(Box::new(sqlite::Sqlite::open(path)?)),
        Storage::Postgres(settings) => Centre::open(Box::new(postgres::Postgres::open(settings)?)),
    }
}

/// Opens the database for reading beside the hub.
///
/// # Errors
/// It refuses.
pub fn beside(storage: &Storage) -> Result<Centre, CentreError> {
    match storage {
        Storage::Sqlite(path) => Centre::beside(Box::new(sqlite::Sqlite::beside(path)?)),
        Storage::Postgres(settings) => Centre::beside(Box::new(postgres::Postgres::beside(settings)?)),
    }
}

/// Opens the database for the work on a site, under leases that last so long.
///
/// # Errors
/// It refuses.
pub fn for_worker(storage: &Storage, lasts: Duration) -> Result<Centre, CentreError> {
    match storage {
        Storage::Postgres(settings) => {
            Centre::beside(Box::new(postgres::Postgres::for_worker(settings, lasts)?))
        }
        Storage::Sqlite(_) => beside(storage),
    }
}

/// The folding process.
pub struct Hub<'a> {
    config: &'a HubConfig,
    runtime: &'a Runtime,
    health: Arc<Health>,
    stopping: Arc<AtomicBool>,
    beat: Arc<Beat>,
    heard: Beats,
}

impl<'a> Hub<'a> {
    /// A hub that reports to `health` and works until `stopping` is true.
    pub fn new(
        config: &'a HubConfig,
        runtime: &'a Runtime,
        health: Arc<Health>,
        stopping: Arc<AtomicBool>,
    ) -> Self {
        Self {
            config,
            runtime,
            health,
            stopping,
            beat: Arc::default(),
            heard: Beats::default(),
        }
    }

    /// Sign of life of the folding.
    pub fn beat(&self) -> Arc<Beat> {
        Arc::clone(&self.beat)
    }

    /// Heartbeats of the sites, to be listened for.
    pub fn heard(&self) -> Beats {
        self.heard.clone()
    }

    fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed)
    }

    /// Checks server, stream and database.
    ///
    /// # Errors
    /// One of them is not fit, or cannot be reached.
    pub fn check(&self) -> Result<(), HubError> {
        open(&self.config.storage)?;
        self.runtime.block_on(Feed::open(self.config))?;
        Ok(feed::check_flushing(&self.config.monitors)?)
    }

    /// Folds until stopped; whatever fails is tried again.
    pub fn run(&self) {
        let mut backoff = Backoff::new(Pace::default(), 1);
        while !self.is_stopping() {
            let Err(error) = Work::open(self).and_then(|work| work.run(&mut backoff, None)) else {
                return;
            };
            let wait = backoff.after_failure(None).min(Duration::from_secs(30));
            let detail = format!("hub: {error}; tried again in {:.0} s", wait.as_secs_f64().ceil());
            self.health.hold(Fault::Forward, ABOUT, detail);
            let until = Instant::now() + wait;
            while Instant::now() < until && !self.is_stopping() {
                self.health.tick();
                std::thread::sleep(Duration::from_millis(50));
            }
        }
    }

    /// Names of the sites whose messages are taken: not of those that workers write.
    fn listed(&self) -> BTreeSet<String> {
        let forwarding = self.config.sites.iter().filter(|site| site.config.is_none());
        forwarding.map(|site| site.name.clone()).collect()
    }
}
