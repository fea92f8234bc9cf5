//! The centre of many sites: folds their logs, as the post delivers them, into one database.
//!
//! One message is folded once: the position in the stream and each site's last commit are written in the transaction of the rows.
//! A message that cannot be folded is parked with its reason; its site is marked, the others go on. docs/hub.md describes it for operators.

pub mod centre;
pub mod feed;
pub mod fold;
pub mod page;
mod postgres;
pub mod sites;
pub mod sql;
mod sqlite;
pub mod tables;

use crate::config::HubConfig;
use crate::config::settings::hub::Storage;
use crate::service::alert::{Backoff, Pace};
use crate::service::forward::link::LinkError;
use crate::service::telemetry::{Fault, Health};
use centre::{Batch, Centre, CentreError};
use feed::Feed;
use fold::{Fold, Judged};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

/// Subject of the hub's conditions.
const ABOUT: &str = "hub";
/// Interval of looks at the end of the stream, which may have been set back.
const LOOK: Duration = Duration::from_secs(5);

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
    #[error(
        "the stream no longer begins with the first commit of {0}: a rebuild would lose what came before"
    )]
    Lost(String),
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

/// The folding process.
pub struct Hub<'a> {
    config: &'a HubConfig,
    runtime: &'a Runtime,
    health: Arc<Health>,
    stopping: Arc<AtomicBool>,
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
        }
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
        match &self.config.monitor {
            Some(monitor) => feed::check_flushing(monitor)?,
            None => tracing::warn!(
                "the hub cannot see whether the server flushes each message (sync_interval: always): name its monitoring as [nats] monitor"
            ),
        }
        Ok(())
    }

    /// Folds until stopped; whatever fails is tried again.
    pub fn run(&self) {
        let mut backoff = Backoff::new(Pace::default(), 1);
        while !self.is_stopping() {
            let Err(error) = self.work(&mut backoff, None) else {
                return;
            };
            let wait = backoff.after_failure(None).min(Duration::from_secs(30));
            let detail = format!("hub: {error}; tried again in {:.0} s", wait.as_secs_f64().ceil());
            self.health.hold(Fault::Forward, ABOUT, detail);
            let until = Instant::now() + wait;
            while Instant::now() < until && !self.is_stopping() {
                std::thread::sleep(Duration::from_millis(50));
            }
        }
    }

    /// Empties the database and folds the whole stream; returns the number of messages folded.
    ///
    /// # Errors
    /// The stream no longer has all that the database has, or something fails: then it is run again.
    pub fn rebuild(&self) -> Result<u64, HubError> {
        let mut centre = open(&self.config.storage)?;
        let mut feed = self.runtime.block_on(Feed::open(self.config))?;
        for (site, state) in centre.sites()? {
            if state.histories.is_empty() {
                continue;
            }
            let first = self.runtime.block_on(feed.first_of(&site))?;
            let begins = first.is_some_and(|first| {
                crate::service::forward::message::Label::read(&first.headers)
                    .is_ok_and(|label| label.first == 1)
            });
            if !begins {
                return Err(HubError::Lost(site));
            }
        }
        let (_, last) = self.runtime.block_on(feed.bounds())?;
        centre.clear()?;
        drop((centre, feed));
        self.work(&mut Backoff::new(Pace::default(), 1), Some(last))?;
        Ok(last)
    }

    /// Folds until stopped, or up to message `until`.
    fn work(&self, backoff: &mut Backoff, until: Option<u64>) -> Result<(), HubError> {
        let mut centre = open(&self.config.storage)?;
        let mut feed = self.runtime.block_on(Feed::open(self.config))?;
        let listed: BTreeSet<String> = self.config.sites.iter().map(|site| site.name.clone()).collect();
        let mut fold = Fold::new(listed, centre.copied().to_vec(), centre.sites()?);
        self.take_up_all(&mut fold, &mut centre)?;
        let mut position = self.begin(&mut feed, &mut centre)?;
        let mut looked = Instant::now();
        while !self.is_stopping() && until.is_none_or(|until| position < until) {
            let messages = self.runtime.block_on(feed.fetch())?;
            if messages.is_empty() && looked.elapsed() >= LOOK {
                looked = Instant::now();
                let (_, last) = self.runtime.block_on(feed.bounds())?;
                if last < position {
                    position = self.begin(&mut feed, &mut centre)?;
                }
            }
            let mut batch = Batch::default();
            let (mut healed, mut gaps) = (BTreeSet::new(), BTreeSet::new());
            for message in &messages {
                position = u64::try_from(message.sequence).unwrap_or(position);
                let site = message.subject.rsplit('.').next().unwrap_or_default();
                let is_marked = fold.sites().get(site).is_some_and(|state| state.fault.is_some());
                match fold.take(message, &mut batch) {
                    Judged::Parked(fault, detail) => {
                        if fault == fold::GAP && !is_marked {
                            gaps.insert(site.to_owned());
                        }
                        self.health.fault(
                            Fault::Forward,
                            format!(
                                "{}: message {} is parked ({fault}): {detail}",
                                message.subject, message.sequence
                            ),
                        );
                    }
                    Judged::Folded(_) if is_marked => {
                        healed.insert(site.to_owned());
                    }
                    Judged::Folded(_) | Judged::Known => {}
                }
            }
            if batch.position.is_some() {
                centre.commit(batch)?;
            }
            for site in gaps {
                self.look_back(&site, &feed, &mut fold, &mut centre)?;
                healed.insert(site);
            }
            for site in healed {
                self.take_up(&site, &mut fold, &mut centre)?;
            }
            self.tell_faults(&fold);
            backoff.reset();
            self.health.over(Fault::Forward, ABOUT);
        }
        Ok(())
    }

    /// Begins to read after the last message folded. A stream that was set back no longer has it, or has another one of its
    /// number: it is read again from its beginning, and what is known of it is recognised by the sites' own numbers. Returns the
    /// position.
    fn begin(&self, feed: &mut Feed, centre: &mut Centre) -> Result<u64, HubError> {
        let folded = centre.position()?;
        let position = u64::try_from(folded.sequence).unwrap_or(0);
        let (first, last) = self.runtime.block_on(feed.bounds())?;
        let is_the_same = last >= position
            && (position < first.max(1)
                || self
                    .runtime
                    .block_on(feed.time_of(position))?
                    .is_none_or(|time_ns| time_ns == folded.time_ns));
        let from = if is_the_same {
            position
        } else {
            tracing::warn!(
                "the stream ends with message {last}, and message {position} is not the one that was folded: it was set back; it is \
                 read again from {first}"
            );
            first.saturating_sub(1)
        };
        self.runtime.block_on(feed.seek(from + 1))?;
        Ok(from)
    }

    /// Tries the parked messages of every site again: a newer program, or a longer list, may take them.
    fn take_up_all(&self, fold: &mut Fold, centre: &mut Centre) -> Result<(), HubError> {
        let marked: Vec<String> = fold
            .sites()
            .iter()
            .filter(|(_, state)| state.fault.is_some())
            .map(|(site, _)| site.clone())
            .collect();
        for site in marked {
            self.take_up(&site, fold, centre)?;
        }
        Ok(())
    }

    fn take_up(&self, site: &str, fold: &mut Fold, centre: &mut Centre) -> Result<(), HubError> {
        let mut batch = Batch::default();
        let taken = fold.take_up(site, centre.parked(site)?, &mut batch);
        if taken > 0 {
            tracing::info!("{site}: {taken} parked messages are taken up");
        }
        Ok(centre.commit(batch)?)
    }

    /// Looks for missing commits among the earlier messages of a site: a stream that was set back and filled again holds them
    /// before the position.
    fn look_back(
        &self,
        site: &str,
        feed: &Feed,
        fold: &mut Fold,
        centre: &mut Centre,
    ) -> Result<(), HubError> {
        let found = self.runtime.block_on(feed.all_of(site))?;
        let mut batch = Batch::default();
        for message in &found {
            fold.look_again(message, &mut batch);
        }
        Ok(centre.commit(batch)?)
    }

    fn tell_faults(&self, fold: &Fold) {
        for (site, state) in fold.sites() {
            match &state.fault {
                Some((fault, detail)) => {
                    let detail = format!("{site}: its messages are parked ({fault}): {detail}");
                    self.health.hold(Fault::Forward, site, detail);
                }
                None => self.health.over(Fault::Forward, site),
            }
        }
    }
}
