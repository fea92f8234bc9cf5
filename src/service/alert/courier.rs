//! One thread per sink: takes the next event from the store, sends it, reports its delivery, and repeats.

use super::marks::Marks;
use super::place::{Place, notices_mark, standing_mark};
use super::signal::{Signal, Stopped};
use super::{Backoff, Failure, Message, Pace, Sink, damping};
use crate::analysis::numerics::random;
use crate::analysis::track::alarm;
use crate::config::settings::alert::SinkSettings;
use crate::service::telemetry::metrics::Delivery;
use crate::service::telemetry::{Fault, Telemetry};
use crate::site::store::{Filter, News, Reader, StoreError};
use std::collections::{HashSet, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Number of events read at once.
const BATCH: usize = 100;

/// Interval at which the store is checked without notification.
const LOOK_EVERY: Duration = Duration::from_secs(30);

/// Reason why a round ended early.
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

/// Everything that a courier needs for its work.
pub(super) struct Errand {
    pub(super) settings: SinkSettings,
    pub(super) site: String,
    pub(super) store: Option<PathBuf>,
    pub(super) marks: Arc<Marks>,
    pub(super) telemetry: Telemetry,
}

/// One sink's courier.
pub(super) struct Courier {
    errand: Errand,
    sink: Box<dyn Sink>,
    reader: Option<Reader>,
    place: Option<Place>,
    /// Alarms active when the sink was added that it still has to get; `None` until they were looked up.
    standing: Option<VecDeque<Message>>,
    refreshed: Option<Instant>,
    /// Time since which messages are gathered to be sent together, and for how long.
    gathering: Option<(Instant, Duration)>,
    /// True until all that waited at the start was sent: it is not gathered further, or a daemon that never lives long would
    /// never send it.
    is_starting: bool,
    /// Messages sent past the store: they are not sent again when the store has them.
    told: HashSet<String>,
    backoff: Backoff,
    signal: Arc<Signal>,
}

impl Courier {
    /// A courier that continues at `place`, or at the position in the store.
    pub(super) fn new(errand: Errand, pace: Pace, place: Option<Place>, signal: Arc<Signal>) -> Self {
        let Errand { settings, site, .. } = &errand;
        let seed = random::seed(&[b"sink", site.as_bytes(), settings.id.as_bytes()]);
        Self {
            sink: super::open(settings, site, pace.deadline),
            reader: None,
            place,
            standing: None,
            refreshed: None,
            gathering: None,
            is_starting: true,
            told: HashSet::new(),
            backoff: Backoff::new(pace, seed),
            signal,
            errand,
        }
    }

    /// Works until stopped.
    pub(super) fn run(&mut self) {
        loop {
            let told = match self.round() {
                Ok(()) => self
                    .worked()
                    .and_then(|()| self.signal.wait_for_news(self.until_next_look())),
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

    /// Reports a failure and waits.
    fn failed(&mut self, failure: &Failure) -> Result<(), Stopped> {
        let wait = self.backoff.after_failure(failure.retry_after);
        let id = &self.errand.settings.id;
        self.errand.telemetry.metrics.delivery(id, Delivery::Failed);
        let next_s = wait.as_secs_f64().ceil();
        let detail = format!("sink {id}: {failure}; tried again in {next_s:.0} s");
        self.signal
            .unless_stopped(|| self.errand.telemetry.health.hold(Fault::Sink, id, detail))?;
        self.signal.pause(wait)
    }

    fn worked(&mut self) -> Result<(), Stopped> {
        self.backoff.reset();
        self.signal.unless_stopped(|| {
            self.errand
                .telemetry
                .health
                .over(Fault::Sink, &self.errand.settings.id)
        })
    }

    fn until_next_look(&self) -> Duration {
        if let Some((since, wait)) = self.gathering {
            return wait.saturating_sub(since.elapsed()).min(LOOK_EVERY);
        }
        match (self.sink.refresh_every(), self.refreshed) {
            (Some(every), Some(refreshed)) => every.saturating_sub(refreshed.elapsed()).min(LOOK_EVERY),
            (Some(every), None) => every.min(LOOK_EVERY),
            (None, _) => LOOK_EVERY,
        }
    }

    /// Sends all that is due.
    fn round(&mut self) -> Result<(), Trouble> {
        let sent = self.send_direct();
        let Some(store) = &self.errand.store else {
            return sent;
        };
        let reader = match self.reader.take() {
            Some(reader) => reader,
            // Without a store there is still what is sent past it.
            None => match Reader::open(store) {
                Ok(reader) => reader,
                Err(error) => return sent.and(Err(error.into())),
            },
        };
        let result = match sent {
            Ok(()) => self.send_all(&reader),
            Err(trouble) => self
                .place(&reader)
                .and_then(|place| self.count_waiting(&reader, place))
                .and(Err(trouble)),
        };
        self.reader = Some(reader);
        result
    }

    /// Sends what goes past the store.
    fn send_direct(&mut self) -> Result<(), Trouble> {
        while let Some(message) = self.signal.direct() {
            self.send(&message)?;
            self.worked()?;
            self.signal.delivered(&message.id);
            self.told.insert(message.id);
        }
        Ok(())
    }

    /// Tells the metrics how much waits for the sink.
    fn count_waiting(&self, reader: &Reader, place: Place) -> Result<(), Trouble> {
        let news = reader.latest_news()? - place.through;
        let notices = reader.latest_notice()? - place.notices;
        let waiting = usize::try_from(news + notices).unwrap_or(0);
        self.errand
            .telemetry
            .metrics
            .outbox(&self.errand.settings.id, waiting);
        Ok(())
    }

    fn send_all(&mut self, reader: &Reader) -> Result<(), Trouble> {
        let mut place = self.place(reader)?;
        self.count_waiting(reader, place)?;
        if !place.knows_standing {
            self.tell_standing(reader, &mut place)?;
        }
        self.send_notices(reader, &mut place)?;
        loop {
            self.count_waiting(reader, place)?;
            let news = reader.news_after(place.through, BATCH)?;
            let Some(last) = news.last().map(|news| news.number) else {
                break;
            };
            if !self.sink.gathers_for().is_zero() {
                let wants = |news: &&News| self.errand.settings.wants(news.event.alarm.kind, &news.rod);
                let wanted = news.iter().filter(wants);
                let (together, wait) = self.together(reader, wanted)?;
                let is_full = news.len() == BATCH;
                if !together.is_empty() && !self.send_together(&together, wait, is_full)? {
                    break;
                }
                place.through = last;
                self.arrive(place);
                self.report(&self.errand.settings.id, place.through)?;
                continue;
            }
            for news in &news {
                if self.errand.settings.wants(news.event.alarm.kind, &news.rod) {
                    self.send(&Message::of_news(&self.errand.site, news))?;
                    self.worked()?;
                    let (metrics, id) = (&self.errand.telemetry.metrics, &self.errand.settings.id);
                    metrics.delivery(id, Delivery::Delivered);
                } else if news.number < last {
                    // Events not meant for this sink are skipped without a commit each.
                    continue;
                }
                place.through = news.number;
                self.arrive(place);
                self.report(&self.errand.settings.id, place.through)?;
            }
        }
        self.is_starting = false;
        self.refresh(reader)
    }

    /// Messages of events, and the time for which they are gathered: that of the one which may wait least.
    fn together<'a>(
        &self,
        reader: &Reader,
        events: impl Iterator<Item = &'a News>,
    ) -> Result<(Vec<Message>, Duration), StoreError> {
        let mut messages = Vec::new();
        let mut wait = Duration::MAX;
        for news in events {
            let raises = damping::raises(reader, news)?;
            wait = wait.min(damping::wait(self.sink.gathers_for(), raises));
            let mut message = Message::of_news(&self.errand.site, news);
            message.message.extend(damping::remark(raises));
            messages.push(message);
        }
        Ok((messages, wait))
    }

    /// Sends messages together once they were gathered for `wait`, or `is_due`; returns false before.
    fn send_together(&mut self, messages: &[Message], wait: Duration, is_due: bool) -> Result<bool, Trouble> {
        // One that may wait less begins the time anew, so that what comes with it is in the same mail.
        let (since, wait) = match self.gathering {
            Some(gathering) if gathering.1 <= wait => gathering,
            _ => *self.gathering.insert((Instant::now(), wait)),
        };
        if since.elapsed() < wait && !is_due && !self.is_starting {
            return Ok(false);
        }
        guarded(|| self.sink.deliver_all(messages))?;
        self.gathering = None;
        self.worked()?;
        let (metrics, id) = (&self.errand.telemetry.metrics, &self.errand.settings.id);
        for _ in messages {
            metrics.delivery(id, Delivery::Delivered);
        }
        Ok(true)
    }

    /// Sends the notices of the daemon's conditions, which go to every sink.
    fn send_notices(&mut self, reader: &Reader, place: &mut Place) -> Result<(), Trouble> {
        loop {
            let mut notices = reader.notices_after(place.notices, BATCH)?;
            let Some(last) = notices.last().map(|notice| notice.number) else {
                return Ok(());
            };
            notices.retain(|notice| self.errand.settings.wants_site_of(&notice.condition));
            if notices.is_empty() {
                place.notices = last;
                self.arrive(*place);
                self.report(&notices_mark(&self.errand.settings.id), place.notices)?;
                continue;
            }
            if !self.sink.gathers_for().is_zero() {
                let messages = notices
                    .iter()
                    .map(|notice| Message::of_notice(&self.errand.site, notice));
                let mut waiting: Vec<Message> = messages.collect();
                waiting.retain(|message| !self.told.contains(&message.id));
                self.send_at_once(&waiting)?;
                self.told.clear();
                place.notices = last;
                self.arrive(*place);
                self.report(&notices_mark(&self.errand.settings.id), place.notices)?;
                continue;
            }
            for notice in notices {
                let message = Message::of_notice(&self.errand.site, &notice);
                if !self.told.remove(&message.id) {
                    self.send(&message)?;
                    self.worked()?;
                }
                place.notices = notice.number;
                self.arrive(*place);
                self.report(&notices_mark(&self.errand.settings.id), place.notices)?;
            }
        }
    }

    /// Position to continue from: as stored, or, for a new sink, after the present events.
    fn place(&mut self, reader: &Reader) -> Result<Place, Trouble> {
        if let Some(place) = self.place {
            return Ok(place);
        }
        let id = &self.errand.settings.id;
        let place = match Place::of(id, reader)? {
            Some(place) => place,
            None => {
                let place = Place::new(reader)?;
                // Nothing waited at the start.
                self.is_starting = false;
                for (mark, through) in place.marks(id) {
                    self.report(&mark, through)?;
                }
                place
            }
        };
        self.arrive(place);
        Ok(place)
    }

    /// Sends a new sink the alarms active when it was added.
    fn tell_standing(&mut self, reader: &Reader, place: &mut Place) -> Result<(), Trouble> {
        if self.standing.is_none() {
            self.standing = Some(self.standing_before(reader, *place)?);
        }
        if !self.sink.gathers_for().is_zero() {
            let standing: Vec<Message> = self.standing.iter().flatten().cloned().collect();
            for together in standing.chunks(BATCH) {
                self.send_at_once(together)?;
                let left = self.standing.as_mut();
                left.map(|standing| standing.drain(..together.len().min(standing.len())));
            }
        }
        while let Some(message) = self.standing.as_ref().and_then(VecDeque::front).cloned() {
            self.send(&message)?;
            self.worked()?;
            self.standing.as_mut().map(VecDeque::pop_front);
        }
        place.knows_standing = true;
        self.arrive(*place);
        // Nothing waits under this name.
        Ok(self.report(&standing_mark(&self.errand.settings.id), i64::MAX)?)
    }

    /// Active alarms, except those that later events will report.
    fn standing_before(&self, reader: &Reader, place: Place) -> Result<VecDeque<Message>, Trouble> {
        // Read before the events: what is raised meanwhile is one of these.
        let mut standing = self.messages_of_standing(reader)?;
        let mut later = HashSet::new();
        let mut number = place.through;
        loop {
            let news = reader.news_after(number, BATCH)?;
            let Some(last) = news.last() else { break };
            number = last.number;
            let raised = news
                .into_iter()
                .filter(|news| news.event.what == alarm::What::Raised);
            later.extend(raised.map(|news| news.event.alarm.id));
        }
        let mut number = place.notices;
        loop {
            let notices = reader.notices_after(number, BATCH)?;
            let Some(last) = notices.last() else { break };
            number = last.number;
            later.extend(notices.into_iter().map(|notice| notice.condition));
        }
        standing.retain(|message| !later.contains(&message.conversation()));
        Ok(standing.into())
    }

    fn messages_of_standing(&self, reader: &Reader) -> Result<Vec<Message>, Trouble> {
        let site = &self.errand.site;
        let mut alarms = reader.alarms(&Filter::default())?;
        alarms.retain(|alarm| !alarm.is_over() && self.errand.settings.wants(alarm.kind, &alarm.rod));
        let mut messages = Vec::new();
        for alarm in &alarms {
            messages.push(Message::standing(site, alarm, reader.acknowledged_words(alarm)?));
        }
        let mut conditions = reader.standing_notices()?;
        conditions.retain(|begun| self.errand.settings.wants_site_of(&begun.condition));
        messages.extend(conditions.iter().map(|begun| Message::lasting(site, begun)));
        Ok(messages)
    }

    /// Sends the active alarms again to a sink that forgets.
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

    /// Sends messages that waited, together and ungathered; nothing if there are none.
    fn send_at_once(&mut self, messages: &[Message]) -> Result<(), Trouble> {
        if messages.is_empty() {
            return Ok(());
        }
        guarded(|| self.sink.deliver_all(messages))?;
        self.worked()?;
        Ok(())
    }

    fn send(&mut self, message: &Message) -> Result<(), Trouble> {
        Ok(guarded(|| self.sink.deliver(message))?)
    }

    /// Notes the position reached, ahead of the store.
    fn arrive(&mut self, place: Place) {
        self.place = Some(place);
        self.signal.arrive(place);
    }

    /// Reports the position reached, to be stored.
    fn report(&self, mark: &str, through: i64) -> Result<(), Stopped> {
        self.signal
            .unless_stopped(|| self.errand.marks.put(mark, through))
    }
}

/// Turns a panic of a sink into a failure: its thread must go on.
fn guarded(send: impl FnOnce() -> Result<(), Failure>) -> Result<(), Failure> {
    catch_unwind(AssertUnwindSafe(send)).unwrap_or_else(|_| {
        Err(Failure::new(
            "sending broke off within the program; please report this",
        ))
    })
}
