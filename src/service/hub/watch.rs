//! The hub's outbox: its conditions, among them silent sites, and the alarms of all sites, told to its sinks, each once, whatever is
//! restarted.
//!
//! It works on a thread and in a file of its own, so that a database or a post that hangs is told, too.

use super::relay::Relay;
use crate::config::HubConfig;
use crate::config::settings::alert::SinkSettings;
use crate::service::alert::{self, Conditions, Couriers};
use crate::service::telemetry::{Beat, Fault, Health, Metrics, Telemetry};
use crate::site::clock;
use crate::site::store::{Commit, ConditionEvent, Durability, Relayed, Store, StoreError};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Name of the hub in messages.
const NAME: &str = "centre";
/// Subject of the condition of an outbox that cannot be written.
const ABOUT: &str = "outbox";
/// Interval of looks.
const LOOK: Duration = Duration::from_millis(500);
/// Marks of deliveries that may wait.
const MARKS: usize = 64;
/// Pages of the sites' events that may wait.
const PAGES: usize = 4;

/// Error at the start of the watch.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// The outbox.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The system gives no thread.
    #[error(transparent)]
    Thread(#[from] std::io::Error),
}

/// The running watch, ended when dropped.
pub struct Watch {
    stop: Option<SyncSender<()>>,
    /// Dropped to end the relay, which is not waited for: the database may hang.
    relay: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    /// Starts the sinks of the configuration; `None` without any.
    ///
    /// # Errors
    /// The outbox cannot be opened, or the system gives no thread.
    pub fn start(
        config: &Arc<HubConfig>,
        health: &Arc<Health>,
        beat: Arc<Beat>,
    ) -> Result<Option<Self>, WatchError> {
        let Some(path) = config.outbox.as_ref().filter(|_| !config.sinks.is_empty()) else {
            return Ok(None);
        };
        let store = Store::open(path, Durability::Full)?;
        // Those of the sites, whose ids have a slash, are theirs to end.
        let mut standing = store.standing_notices()?;
        standing.retain(|notice| !notice.condition.contains('/'));
        for notice in &standing {
            stands_on(notice, config, health);
        }
        let metrics = Arc::new(Metrics::new(Arc::clone(health), Arc::clone(&beat)));
        let telemetry = Telemetry {
            health: Arc::clone(health),
            beat,
            beats: Arc::default(),
            metrics,
        };
        let (mark, marks) = sync_channel::<(String, i64)>(MARKS);
        let delivered = Box::new(move |sink, through| mark.send((sink, through)).is_ok());
        let mut couriers = Couriers::start(&config.sinks, NAME, path, delivered, telemetry);
        couriers.watch(&config.alert, NAME);
        let settle = Duration::from_secs_f64(config.alert.settle_s);
        let mut teller = Teller {
            store,
            unplaced: config.sinks.clone(),
            conditions: Conditions::new(settle, standing),
            unkept: Vec::new(),
            told: 0,
            unrelayed: None,
            health: Arc::clone(health),
        };
        let (page, pages) = sync_channel(PAGES);
        let (relay, relay_stopped) = sync_channel(0);
        let work = Relay::new(Arc::clone(config), Arc::clone(health), path.clone(), page);
        thread::Builder::new()
            .name("relay".to_owned())
            .spawn(move || work.run(&relay_stopped))?;
        let (stop, stopped) = sync_channel(0);
        let thread = thread::Builder::new().name("watch".to_owned()).spawn(move || {
            while stopped.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                if teller.look(&marks) | teller.take(&pages) {
                    couriers.wake();
                }
                teller.untold().iter().for_each(|notice| couriers.tell(notice));
                couriers.look_at_clock(clock::now());
            }
            // What is delivered while they end is marked, too.
            let ending = thread::spawn(move || drop(couriers));
            for (sink, through) in marks {
                teller.mark(&sink, through);
            }
            // It never panics; if it did, the panic could not be reported.
            let _ = ending.join();
        })?;
        Ok(Some(Self {
            stop: Some(stop),
            relay: Some(relay),
            thread: Some(thread),
        }))
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        drop(self.relay.take());
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Holds a condition of before the start that only a heartbeat can end; the others are found again by looking.
fn stands_on(notice: &ConditionEvent, config: &HubConfig, health: &Health) {
    for fault in [Fault::Silent, Fault::Clock] {
        if notice.fault == fault.code() && config.site(&notice.about).is_some() {
            health.hold(fault, &notice.about, &notice.detail);
        }
    }
}

/// Owner of the outbox.
struct Teller {
    store: Store,
    /// Sinks that may be without a position in the outbox; empty once each has one.
    unplaced: Vec<SinkSettings>,
    conditions: Conditions,
    /// Notices that the outbox does not have yet.
    unkept: Vec<ConditionEvent>,
    /// Number of these that were told past it.
    told: usize,
    /// Events of a site that the outbox does not have yet.
    unrelayed: Option<Relayed>,
    health: Arc<Health>,
}

impl Teller {
    /// Puts what began or ended into the outbox; returns true if there is news in it.
    fn look(&mut self, marks: &Receiver<(String, i64)>) -> bool {
        for (sink, through) in marks.try_iter() {
            self.mark(&sink, through);
        }
        let lasting = self.health.conditions();
        let told = self.conditions.look(&lasting, Instant::now(), clock::now());
        self.unkept.extend(told);
        if !self.place_sinks() || self.unkept.is_empty() {
            return false;
        }
        let written = self.store.watch(&self.unkept, None);
        if self.wrote(written) {
            self.unkept.clear();
            self.told = 0;
            return true;
        }
        false
    }

    /// Notices to be told past an outbox that does not take them; the sinks do not get them again from it.
    fn untold(&mut self) -> &[ConditionEvent] {
        let told = std::mem::replace(&mut self.told, self.unkept.len());
        self.unkept.get(told..).unwrap_or_default()
    }

    /// Puts what the sites told into the outbox; returns true if there is news in it.
    fn take(&mut self, pages: &Receiver<Relayed>) -> bool {
        let mut has_news = false;
        if !self.place_sinks() {
            return false;
        }
        while let Some(relayed) = self.unrelayed.take().or_else(|| pages.try_recv().ok()) {
            let written = self.store.relay(&relayed);
            if !self.wrote(written) {
                self.unrelayed = Some(relayed);
                break;
            }
            has_news |= !(relayed.events.is_empty() && relayed.notices.is_empty());
        }
        has_news
    }

    /// Gives each new sink its position before anything further is put into the outbox; returns false if it cannot be written.
    fn place_sinks(&mut self) -> bool {
        if self.unplaced.is_empty() {
            return true;
        }
        let is_placed = match alert::marks_of_new(&self.unplaced, &self.store) {
            Ok(marks) => marks.iter().all(|(sink, through)| self.mark(sink, *through)),
            Err(error) => self.wrote(Err(error)),
        };
        if is_placed {
            self.unplaced.clear();
        }
        is_placed
    }

    fn mark(&mut self, sink: &str, through: i64) -> bool {
        let written = self.store.commit(&Commit {
            delivered: Some((sink, through)),
            ..Commit::default()
        });
        self.wrote(written)
    }

    fn wrote(&self, written: Result<(), StoreError>) -> bool {
        match written {
            Ok(()) => {
                self.health.over(Fault::Write, ABOUT);
                true
            }
            Err(error) => {
                let detail = format!("what the sinks are told cannot be kept: {error}");
                self.health.hold(Fault::Write, ABOUT, detail);
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outbox_that_takes_nothing_is_told_past_it_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("outbox.db");
        let store = Store::open(&path, Durability::Full).unwrap();
        let other = rusqlite::Connection::open(&path).unwrap();
        let full = "CREATE TRIGGER full BEFORE INSERT ON notice BEGIN SELECT RAISE(ABORT, 'no room'); END";
        other.execute_batch(full).unwrap();
        let health = Arc::<Health>::default();
        let mut teller = Teller {
            store,
            unplaced: Vec::new(),
            conditions: Conditions::new(Duration::ZERO, Vec::new()),
            unkept: Vec::new(),
            told: 0,
            unrelayed: None,
            health: Arc::clone(&health),
        };
        let (_mark, marks) = sync_channel(1);
        let abouts = |notices: &[ConditionEvent]| -> Vec<String> {
            notices.iter().map(|notice| notice.about.clone()).collect()
        };
        health.hold(Fault::Silent, "todi", "nothing came");
        assert!(!teller.look(&marks));
        assert_eq!(abouts(teller.untold()), ["todi"]);
        assert!(!teller.look(&marks));
        assert_eq!(abouts(teller.untold()), [ABOUT]);
        assert!(!teller.look(&marks));
        assert!(teller.untold().is_empty());
        other.execute_batch("DROP TRIGGER full").unwrap();
        assert!(teller.look(&marks), "all is kept once there is room");
        assert!(teller.untold().is_empty());
        assert_eq!(
            abouts(&teller.store.notices_after(0, 9).unwrap()),
            ["todi", ABOUT]
        );
    }
}
