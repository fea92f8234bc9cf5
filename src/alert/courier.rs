//! One thread a sink: takes the next news from the store, sends it, reports that it arrived, for ever.

use super::signal::{Signal, Stopped};
use super::{Backoff, Failure, Message, Pace, Sink, SinkSettings};
use crate::daemon::Job;
use crate::random;
use crate::store::{Filter, Reader, StoreError};
use crate::telemetry::{Fault, Health};
use crate::track::alarm;
use std::collections::{HashSet, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// News read at once.
const BATCH: usize = 100;

/// How often the store is looked at without being told of news.
const LOOK_EVERY: Duration = Duration::from_secs(30);

/// How long a courier that is told to stop may take, unless it is in the middle of a send.
const STOP_WITHIN: Duration = Duration::from_millis(100);

/// All couriers of a daemon.
pub struct Couriers {
    store: PathBuf,
    jobs: SyncSender<Job>,
    health: Arc<Health>,
    pace: Pace,
    running: Vec<Running>,
}

struct Running {
    settings: SinkSettings,
    site: String,
    signal: Arc<Signal>,
    ended: Receiver<()>,
}

/// How far a sink's courier came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    /// The number of the latest news the sink has.
    through: i64,
    /// Whether it was told what stood when it was added.
    knows_standing: bool,
}

/// The name under which the store remembers that a sink was told what stood when it was added. No id has a slash.
fn standing_mark(sink: &str) -> String {
    format!("{sink}/standing")
}

impl Couriers {
    /// Starts one for each sink and one for the log. They read `store` and report through `jobs`, of which they keep a
    /// sender until they are stopped.
    pub fn start(
        sinks: &[SinkSettings],
        site: &str,
        store: &Path,
        jobs: SyncSender<Job>,
        health: Arc<Health>,
    ) -> Self {
        Self::start_at(Pace::default(), sinks, site, store, jobs, health)
    }

    /// Starts them at another pace than the usual one.
    pub fn start_at(
        pace: Pace,
        sinks: &[SinkSettings],
        site: &str,
        store: &Path,
        jobs: SyncSender<Job>,
        health: Arc<Health>,
    ) -> Self {
        let mut couriers = Self {
            store: store.to_owned(),
            jobs,
            health,
            pace,
            running: Vec::new(),
        };
        couriers.reload(sinks, site);
        couriers
    }

    /// There may be news in the store.
    pub fn wake(&self) {
        for courier in &self.running {
            courier.signal.wake();
        }
    }

    /// Goes on with these sinks. A courier whose settings are the same is not disturbed; one whose settings changed
    /// goes on where it was.
    pub fn reload(&mut self, sinks: &[SinkSettings], site: &str) {
        let log = SinkSettings::log();
        let mut wanted: Vec<&SinkSettings> = sinks.iter().collect();
        wanted.push(&log);
        let is_same = |courier: &Running| courier.site == site && wanted.contains(&&courier.settings);
        let (mut kept, changed): (Vec<Running>, Vec<Running>) =
            std::mem::take(&mut self.running).into_iter().partition(is_same);
        let stopped = stop(changed);
        for (id, _) in &stopped {
            if !wanted.iter().any(|settings| settings.id == *id) {
                self.health.over(Fault::Sink, id);
            }
        }
        for settings in wanted {
            if kept.iter().any(|courier| courier.settings.id == settings.id) {
                continue;
            }
            let place = stopped
                .iter()
                .find(|(id, _)| *id == settings.id)
                .and_then(|(_, place)| *place);
            if let Some(courier) = self.spawn(settings, site, place) {
                kept.push(courier);
            }
        }
        self.running = kept;
    }

    /// Ends them all within 100 ms. One in the middle of a send is left to itself: if its message arrives, it is sent
    /// again at the next start, with the same id.
    pub fn stop(self) {
        stop(self.running);
    }

    fn spawn(&self, settings: &SinkSettings, site: &str, place: Option<Place>) -> Option<Running> {
        let signal = Arc::new(Signal::new(self.jobs.clone()));
        let (ending, ended) = sync_channel(0);
        let id = settings.id.clone();
        let mut courier = Courier {
            sink: super::open(settings, site, self.pace.deadline),
            settings: settings.clone(),
            site: site.to_owned(),
            store: self.store.clone(),
            reader: None,
            place,
            standing: None,
            refreshed: None,
            backoff: Backoff::new(
                self.pace,
                random::seed(&[b"sink", site.as_bytes(), id.as_bytes()]),
            ),
            signal: Arc::clone(&signal),
            health: Arc::clone(&self.health),
        };
        let spawned = thread::Builder::new().name(format!("sink {id}")).spawn(move || {
            courier.run();
            drop(ending);
        });
        if let Err(error) = spawned {
            self.health
                .hold(Fault::Sink, &id, format!("sink {id}: no thread for it: {error}"));
            return None;
        }
        Some(Running {
            settings: settings.clone(),
            site: site.to_owned(),
            signal,
            ended,
        })
    }
}

/// Stops couriers; their ids and how far they came.
fn stop(couriers: Vec<Running>) -> Vec<(String, Option<Place>)> {
    for courier in &couriers {
        courier.signal.stop();
    }
    let until = Instant::now() + STOP_WITHIN;
    for courier in &couriers {
        let left = until.saturating_duration_since(Instant::now());
        if courier.ended.recv_timeout(left) == Err(RecvTimeoutError::Timeout) {
            tracing::debug!("sink {}: left in the middle of a send", courier.settings.id);
        }
    }
    couriers
        .into_iter()
        .map(|courier| (courier.settings.id, courier.signal.place()))
        .collect()
}

/// Why a round ended early.
enum Trouble {
    Stopped,
    Failed(Failure),
    Unreadable(StoreError),
}

impl From<Stopped> for Trouble {
    fn from(_: Stopped) -> Self {
        Self::Stopped
    }
}

impl From<Failure> for Trouble {
    fn from(failure: Failure) -> Self {
        Self::Failed(failure)
    }
}

impl From<StoreError> for Trouble {
    fn from(error: StoreError) -> Self {
        Self::Unreadable(error)
    }
}

struct Courier {
    sink: Box<dyn Sink>,
    settings: SinkSettings,
    site: String,
    store: PathBuf,
    reader: Option<Reader>,
    place: Option<Place>,
    /// What stood when the sink was added and it still has to be told; `None` until that was looked up.
    standing: Option<VecDeque<Message>>,
    refreshed: Option<Instant>,
    backoff: Backoff,
    signal: Arc<Signal>,
    health: Arc<Health>,
}

impl Courier {
    fn run(&mut self) {
        loop {
            let told = match self.round() {
                Ok(()) => {
                    self.worked();
                    self.signal.wait_for_news(self.until_next_look())
                }
                Err(Trouble::Stopped) => return,
                Err(Trouble::Failed(failure)) => self.failed(&failure),
                Err(Trouble::Unreadable(error)) => {
                    self.reader = None;
                    self.failed(&Failure::new(error.to_string()))
                }
            };
            if told == Err(Stopped) {
                return;
            }
        }
    }

    /// Says so and waits.
    fn failed(&mut self, failure: &Failure) -> Result<(), Stopped> {
        let wait = self.backoff.after_failure(failure.retry_after);
        let id = &self.settings.id;
        let next_s = wait.as_secs_f64().ceil();
        self.health.hold(
            Fault::Sink,
            id,
            format!("sink {id}: {failure}; tried again in {next_s:.0} s"),
        );
        self.signal.pause(wait)
    }

    fn worked(&mut self) {
        self.backoff.reset();
        self.health.over(Fault::Sink, &self.settings.id);
    }

    fn until_next_look(&self) -> Duration {
        match (self.sink.refresh_every(), self.refreshed) {
            (Some(every), Some(refreshed)) => every.saturating_sub(refreshed.elapsed()).min(LOOK_EVERY),
            (Some(every), None) => every.min(LOOK_EVERY),
            (None, _) => LOOK_EVERY,
        }
    }

    /// Sends everything there is to send.
    fn round(&mut self) -> Result<(), Trouble> {
        let reader = match self.reader.take() {
            Some(reader) => reader,
            None => Reader::open(&self.store)?,
        };
        let result = self.send_all(&reader);
        self.reader = Some(reader);
        result
    }

    fn send_all(&mut self, reader: &Reader) -> Result<(), Trouble> {
        let mut place = self.place(reader)?;
        if !place.knows_standing {
            self.tell_standing(reader, &mut place)?;
        }
        loop {
            let news = reader.news_after(place.through, BATCH)?;
            let Some(last) = news.last().map(|news| news.number) else {
                break;
            };
            for news in &news {
                if self.settings.wants(news.event.alarm.kind, &news.rod) {
                    self.send(&Message::of_news(&self.site, news))?;
                    self.worked();
                } else if news.number < last {
                    // What is not for this sink is passed over without a commit each.
                    continue;
                }
                place.through = news.number;
                self.arrive(place);
                self.report(&self.settings.id, place.through)?;
            }
        }
        self.refresh(reader)
    }

    /// Where to go on: as remembered, or, for a sink that is new, behind the news there are now.
    fn place(&mut self, reader: &Reader) -> Result<Place, Trouble> {
        if let Some(place) = self.place {
            return Ok(place);
        }
        let id = &self.settings.id;
        let place = match reader.delivered(id)? {
            Some(through) => Place {
                through,
                knows_standing: reader.delivered(&standing_mark(id))?.is_some(),
            },
            None => {
                let place = Place {
                    through: reader.latest_news()?,
                    knows_standing: false,
                };
                self.report(id, place.through)?;
                place
            }
        };
        self.arrive(place);
        Ok(place)
    }

    /// Tells a sink that is new what stood when it was added.
    fn tell_standing(&mut self, reader: &Reader, place: &mut Place) -> Result<(), Trouble> {
        if self.standing.is_none() {
            self.standing = Some(self.standing_before(reader, place.through)?);
        }
        while let Some(message) = self.standing.as_ref().and_then(VecDeque::front).cloned() {
            self.send(&message)?;
            self.worked();
            self.standing.as_mut().map(VecDeque::pop_front);
        }
        place.knows_standing = true;
        self.arrive(*place);
        // Nothing waits under this name.
        Ok(self.report(&standing_mark(&self.settings.id), i64::MAX)?)
    }

    /// What stands, but for what the sink is told of by later news.
    fn standing_before(&self, reader: &Reader, through: i64) -> Result<VecDeque<Message>, Trouble> {
        let mut later = HashSet::new();
        let mut number = through;
        loop {
            let news = reader.news_after(number, BATCH)?;
            let Some(last) = news.last() else { break };
            number = last.number;
            let raised = news
                .into_iter()
                .filter(|news| news.event.what == alarm::What::Raised);
            later.extend(raised.map(|news| news.event.alarm.id));
        }
        let mut standing = self.messages_of_standing(reader)?;
        standing.retain(|message| !later.contains(&message.alarm));
        Ok(standing.into())
    }

    fn messages_of_standing(&self, reader: &Reader) -> Result<Vec<Message>, Trouble> {
        let alarms = reader.alarms(&Filter::default())?;
        Ok(alarms
            .iter()
            .filter(|alarm| !alarm.is_over() && self.settings.wants(alarm.kind, &alarm.rod))
            .map(|alarm| Message::standing(&self.site, alarm))
            .collect())
    }

    /// Sends again what stands to a sink that forgets.
    fn refresh(&mut self, reader: &Reader) -> Result<(), Trouble> {
        let Some(every) = self.sink.refresh_every() else {
            return Ok(());
        };
        if self
            .refreshed
            .is_some_and(|refreshed| refreshed.elapsed() < every)
        {
            return Ok(());
        }
        let standing = self.messages_of_standing(reader)?;
        guarded(|| self.sink.refresh(&standing))?;
        self.refreshed = Some(Instant::now());
        Ok(())
    }

    fn send(&mut self, message: &Message) -> Result<(), Trouble> {
        Ok(guarded(|| self.sink.deliver(message))?)
    }

    /// This thread is ahead of what the store remembers.
    fn arrive(&mut self, place: Place) {
        self.place = Some(place);
        self.signal.arrive(place);
    }

    /// The store shall remember what was reached.
    fn report(&self, mark: &str, through: i64) -> Result<(), Stopped> {
        self.signal.report(Job::Delivered {
            sink: mark.to_owned(),
            through,
        })
    }
}

/// A sink that breaks is a sink that failed: its thread must go on.
fn guarded(send: impl FnOnce() -> Result<(), Failure>) -> Result<(), Failure> {
    catch_unwind(AssertUnwindSafe(send)).unwrap_or_else(|_| {
        Err(Failure::new(
            "sending broke off within the program; please report this",
        ))
    })
}
