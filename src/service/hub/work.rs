//! One connection's work of the hub: folds what comes, takes up what was parked, looks for what is missing.

use super::batch::Batch;
use super::centre::{Centre, CentreError, SiteState};
use super::commands::Published;
use super::feed::{self, Feed, number};
use super::fold::{self, Fold, Judged};
use super::incoming::Incoming;
use super::regulator::Regulator;
use super::silence::Silence;
use super::sql::SqlError;
use super::text::fit;
use super::{ABOUT, Hub, HubError};
use crate::service::alert::Backoff;
use crate::service::forward::throttle;
use crate::service::telemetry::Fault;
use crate::site::clock;
use std::collections::{BTreeMap, BTreeSet};
use std::panic::resume_unwind;
use std::thread;
use std::time::{Duration, Instant};

/// Interval of looks at the end of the stream, which may have been set back.
const LOOK: Duration = Duration::from_secs(5);
/// Interval of looks at how far the folding is behind.
const REGULATE: Duration = Duration::from_secs(1);
/// Wait after the post did not take commands.
const AGAIN: Duration = Duration::from_secs(30);
/// Most earlier messages of a site that are folded at once, and their bytes.
const PAGE: usize = 64;
const PAGE_BYTES: usize = 8 << 20;
/// Longest reason of a message that the database refuses \[bytes\].
const LONGEST: usize = 500;

/// Subject of the condition of a server that does not flush each message, or of which that cannot be seen.
const FLUSHING: &str = "hub/flushing";

/// Subject of the condition of commands that the post does not take.
const COMMANDS: &str = "hub/commands";

/// Origin of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Origin {
    /// The stream, at the position: what does not fit is parked.
    Stream,
    /// The parked ones: what fits is parked no longer.
    Parked,
    /// The stream, before the position.
    Earlier,
}

/// Messages that are written together.
#[derive(Default)]
struct Part {
    batch: Batch,
    judged: Vec<Judged>,
}

impl Part {
    /// As many of the messages as one transaction holds.
    fn of(fold: &mut Fold, messages: &[Incoming], origin: Origin) -> Self {
        let mut part = Self::default();
        for message in messages {
            let judged = judge(fold, message, origin, &mut part.batch);
            part.judged.push(judged);
            if part.batch.is_full() {
                break;
            }
        }
        part
    }
}

fn judge(fold: &mut Fold, message: &Incoming, origin: Origin, batch: &mut Batch) -> Judged {
    match origin {
        Origin::Stream => fold.take(message, batch),
        Origin::Parked => fold.take_again(message, true, batch),
        Origin::Earlier => fold.take_again(message, false, batch),
    }
}

/// Stream, database, and what is known of each site.
pub(super) struct Work<'h> {
    hub: &'h Hub<'h>,
    centre: Centre,
    feed: Feed,
    fold: Fold,
    /// Sites whose missing commits were looked for, and of which nothing was folded since.
    searched: BTreeSet<String>,
    silence: Silence,
    /// Time of the start, and of the latest look at how far the folding is behind.
    opened: Instant,
    regulated: Instant,
    /// Number of the stream's last message that was folded.
    position: u64,
    /// True but for a rebuild, which nothing new waits for.
    is_regulating: bool,
    regulator: Regulator,
    published: Published,
    /// Faults of the sites that workers write, as they were a second ago.
    faults_of_thin: BTreeMap<String, (String, String)>,
    /// Faults of the sites as the hub's conditions have them; without one where that is not known yet.
    marked: BTreeMap<String, Option<(String, String)>>,
    /// Time before which commands are not taken to the post again, after it refused.
    command_again: Option<Instant>,
}

/// States of the sites that forward, from the database; those of the others are their workers' to write.
fn forwarding(hub: &Hub<'_>, centre: &mut Centre) -> Result<BTreeMap<String, SiteState>, CentreError> {
    let mut sites = centre.sites()?;
    sites.retain(|site, _| !hub.config.is_thin(site));
    Ok(sites)
}

/// Faults of the sites that workers write.
fn faults_of_thin(
    hub: &Hub<'_>,
    centre: &mut Centre,
) -> Result<BTreeMap<String, (String, String)>, CentreError> {
    centre.first_faults(|site| hub.config.is_thin(site))
}

impl<'h> Work<'h> {
    /// Opens both.
    pub(super) fn open(hub: &'h Hub<'h>) -> Result<Self, HubError> {
        let mut centre = super::open(&hub.config.storage)?;
        let feed = hub.runtime.block_on(Feed::open(hub.config))?;
        // A server that was begun anew may be a laxer one.
        let flushing = feed::check_flushing(&hub.config.monitors);
        match &flushing {
            Err(error) => hub.health.hold(Fault::Forward, FLUSHING, error.to_string()),
            Ok(()) if hub.config.monitors.is_empty() => {
                hub.health.hold(Fault::Forward, FLUSHING, feed::UNSEEN.to_owned());
            }
            Ok(()) => hub.health.over(Fault::Forward, FLUSHING),
        }
        flushing?;
        let (sites, overruled) = (forwarding(hub, &mut centre)?, centre.overruled()?);
        let listed = hub.config.sites.iter().map(|site| &site.name);
        let silence = Silence::begin(centre.beats()?, clock::now().as_nanos());
        let marked = listed
            .chain(sites.keys())
            .map(|site| (site.clone(), None))
            .collect();
        Ok(Self {
            faults_of_thin: faults_of_thin(hub, &mut centre)?,
            marked,
            fold: Fold::new(hub.listed(), centre.copied().to_vec(), sites, overruled),
            hub,
            centre,
            feed,
            searched: BTreeSet::new(),
            silence,
            opened: Instant::now(),
            regulated: Instant::now(),
            position: 0,
            is_regulating: false,
            regulator: Regulator::new(hub.config.sites.len()),
            published: Published::default(),
            command_again: None,
        })
    }

    /// Folds until stopped, or, as a rebuild that can be run again, up to message `until` or the end of the stream.
    pub(super) fn run(mut self, backoff: &mut Backoff, until: Option<u64>) -> Result<(), HubError> {
        self.take_up_all()?;
        self.tell_faults();
        self.begin()?;
        self.is_regulating = until.is_none();
        if until.is_some() {
            self.centre.flush_later()?;
        }
        let mut looked = Instant::now();
        while !self.hub.is_stopping() && until.is_none_or(|until| self.position < until) {
            let messages = self.hub.runtime.block_on(self.feed.fetch())?;
            self.hub.beat.pass();
            match messages.last() {
                Some(_) => {
                    self.fold_next(&messages)?;
                    self.tell_faults();
                    self.hear(false)?;
                }
                None if until.is_some() => break,
                None if looked.elapsed() >= LOOK => {
                    looked = Instant::now();
                    let (_, last) = self.hub.runtime.block_on(self.feed.bounds())?;
                    if last < self.position {
                        self.begin()?;
                    }
                }
                None => self.hear(true)?,
            }
            self.regulate()?;
            self.hub.health.tick();
            backoff.reset();
            self.hub.health.over(Fault::Forward, ABOUT);
        }
        Ok(())
    }

    /// Begins to read after the last message folded. A stream that was set back no longer has it, or has another one of its
    /// number: it is read again from its beginning, and what is known of it is recognised by the sites' own numbers.
    fn begin(&mut self) -> Result<(), HubError> {
        let folded = self.centre.position()?;
        let position = u64::try_from(folded.sequence).unwrap_or(0);
        let runtime = self.hub.runtime;
        let (first, last) = runtime.block_on(self.feed.bounds())?;
        let is_the_same = last >= position
            && (position < first.max(1)
                || runtime
                    .block_on(self.feed.at(position))?
                    .is_none_or(|found| found.time_ns == folded.time_ns));
        let from = if is_the_same {
            position
        } else {
            tracing::warn!(
                "the stream ends with message {last}, and message {position} is not the one that was folded: it was set back; it is \
                 read again from {first}"
            );
            first.saturating_sub(1)
        };
        self.feed.seek(from + 1);
        self.position = from;
        Ok(())
    }

    /// Folds the next messages of the stream, and what they make fit.
    fn fold_next(&mut self, messages: &[Incoming]) -> Result<(), HubError> {
        let judged = self.settle(messages, Origin::Stream)?;
        let (mut folded, mut gaps) = (BTreeSet::new(), BTreeSet::new());
        for (message, judged) in messages.iter().zip(judged) {
            let site = message.site();
            match judged {
                Judged::Parked(fault, detail) => {
                    if fault == fold::GAP && !self.searched.contains(site) {
                        gaps.insert(site);
                    }
                    let subject = &message.subject;
                    let detail = format!(
                        "{subject}: message {} is parked ({fault}): {detail}",
                        message.sequence
                    );
                    self.hub.health.fault(Fault::Forward, detail);
                }
                Judged::Folded(_) => {
                    self.searched.remove(site);
                    if self
                        .fold
                        .sites()
                        .get(site)
                        .is_some_and(|state| state.fault.is_some())
                    {
                        folded.insert(site);
                    }
                }
                Judged::Known => {}
            }
        }
        for site in &gaps {
            self.look_back(site)?;
        }
        for site in folded.union(&gaps) {
            self.take_up(site, Some(fold::GAP))?;
        }
        Ok(())
    }

    /// Folds messages in transactions of a bounded size. If the database refuses what they hold, they are folded one by one, and
    /// the one that it refuses is parked: the others go on.
    fn settle(&mut self, messages: &[Incoming], origin: Origin) -> Result<Vec<Judged>, HubError> {
        let mut judged = Vec::new();
        let mut rest = messages;
        let mut part = Part::of(&mut self.fold, rest, origin);
        while !rest.is_empty() {
            let (now, later) = rest.split_at(part.judged.len());
            let Part {
                batch,
                judged: mut some,
            } = part;
            let (fold, centre) = (&mut self.fold, &mut self.centre);
            // The next are judged while these are written.
            let (written, next) = if later.is_empty() {
                (centre.commit(batch), Part::default())
            } else {
                thread::scope(|scope| {
                    let writing = scope.spawn(|| centre.commit(batch));
                    let next = Part::of(fold, later, origin);
                    let written = writing.join();
                    (written.unwrap_or_else(|panic| resume_unwind(panic)), next)
                })
            };
            part = match written {
                Err(CentreError::Sql(error)) if error.is_of_content() => {
                    for message in now {
                        judged.push(self.settle_alone(message, origin)?);
                    }
                    // They were judged as if these had been written.
                    Part::of(&mut self.fold, later, origin)
                }
                done => {
                    done?;
                    judged.append(&mut some);
                    next
                }
            };
            if origin == Origin::Stream {
                self.position = now.last().map_or(self.position, number);
            }
            self.regulate()?;
            self.hub.beat.pass();
            rest = later;
        }
        Ok(judged)
    }

    fn settle_alone(&mut self, message: &Incoming, origin: Origin) -> Result<Judged, HubError> {
        self.fold.again(forwarding(self.hub, &mut self.centre)?);
        let mut batch = Batch::default();
        let judged = judge(&mut self.fold, message, origin, &mut batch);
        let error = match self.centre.commit(batch) {
            Err(CentreError::Sql(error)) if error.is_of_content() => error,
            done => return Ok(done.map(|()| judged)?),
        };
        self.fold.again(forwarding(self.hub, &mut self.centre)?);
        let (fault, detail) = match error {
            SqlError::Contradiction(detail) => {
                self.fold.set_back(message);
                (fold::JUMP_BACK, detail)
            }
            error => (fold::UNREADABLE, format!("the database refuses it: {error}")),
        };
        let detail = fit(&detail, LONGEST);
        if origin == Origin::Stream {
            let mut batch = Batch::default();
            self.fold.park(message, fault, detail.clone(), &mut batch);
            self.centre.commit(batch)?;
        }
        Ok(Judged::Parked(fault, detail))
    }

    /// Tries the parked messages of every site again: a newer program, or a longer list, may take them, and missing commits may
    /// be in the stream.
    fn take_up_all(&mut self) -> Result<(), HubError> {
        let marked = self.fold.sites().iter().filter_map(|(site, state)| {
            let (fault, _) = state.fault.as_ref()?;
            Some((site.clone(), fault == fold::GAP))
        });
        for (site, is_gap) in marked.collect::<Vec<_>>() {
            if is_gap {
                self.look_back(&site)?;
            }
            self.take_up(&site, None)?;
        }
        Ok(())
    }

    /// Tries the parked messages of a site again, those of one fault alone or all; its mark is then that of the first that still
    /// does not fit.
    fn take_up(&mut self, site: &str, fault: Option<&str>) -> Result<(), HubError> {
        let (mut after, mut taken) = ((i64::MIN, i64::MIN), 0);
        while !self.hub.is_stopping() {
            let page = self.centre.parked(site, fault, after)?;
            let Some(last) = page.last() else { break };
            after = (last.sequence, last.time_ns);
            let faults: Vec<String> = page.iter().map(|parked| parked.fault.clone()).collect();
            let messages: Vec<Incoming> = page.into_iter().map(Incoming::of_parked).collect();
            let judged = self.settle(&messages, Origin::Parked)?;
            for ((message, before), judged) in messages.iter().zip(faults).zip(judged) {
                match judged {
                    Judged::Parked(now, detail) if now != before => {
                        self.centre
                            .rename((message.sequence, message.time_ns), now, &detail)?;
                    }
                    Judged::Parked(..) => {}
                    Judged::Folded(_) | Judged::Known => taken += 1,
                }
            }
        }
        if taken > 0 {
            tracing::info!("{site}: {taken} parked messages are taken up");
        }
        let mut batch = Batch::default();
        self.fold.mark(site, self.centre.first_fault(site)?, &mut batch);
        Ok(self.centre.commit(batch)?)
    }

    /// Looks for missing commits among the earlier messages of a site: a stream that was set back and filled again holds them
    /// before the position.
    fn look_back(&mut self, site: &str) -> Result<(), HubError> {
        self.searched.insert(site.to_owned());
        let (mut next, mut is_end) = (1, false);
        while !is_end && !self.hub.is_stopping() {
            let mut some = Vec::new();
            let mut bytes = 0;
            while some.len() < PAGE && bytes < PAGE_BYTES && !is_end {
                let found = self.hub.runtime.block_on(self.feed.next_of_site(next, site))?;
                is_end = found.is_none();
                if let Some(message) = found {
                    next = number(&message) + 1;
                    bytes += message.payload.len();
                    some.push(message);
                }
            }
            self.settle(&some, Origin::Earlier)?;
        }
        Ok(())
    }

    /// Keeps the heartbeats that came, tells which sites are silent, and takes new commands to the post; `is_caught_up`: all messages are read.
    fn hear(&mut self, is_caught_up: bool) -> Result<(), HubError> {
        let now_ns = clock::now().as_nanos();
        if !self.silence.is_due(now_ns) {
            return Ok(());
        }
        let came = self.hub.heard.take();
        if !came.is_empty() {
            self.centre.keep_beats(&came)?;
        }
        self.silence.take(came, self.hub.heard.since_ns());
        let (sites, health) = (&self.hub.config.sites, &self.hub.health);
        self.silence
            .tell(sites, self.fold.sites(), health, (now_ns, is_caught_up));
        if sites.iter().any(|site| site.config.is_some()) {
            self.faults_of_thin = faults_of_thin(self.hub, &mut self.centre)?;
            self.tell_faults();
        }
        self.command(now_ns)
    }

    /// Tells the sites that have a backlog, once a second, how long to pause between two messages, if that is needed.
    fn regulate(&mut self) -> Result<(), HubError> {
        if !self.is_regulating || self.regulated.elapsed() < REGULATE {
            return Ok(());
        }
        self.regulated = Instant::now();
        let runtime = self.hub.runtime;
        let (_, last) = runtime.block_on(self.feed.bounds())?;
        let now_s = self.opened.elapsed().as_secs_f64();
        if let Some(pause) = self.regulator.look(now_s, last, self.position) {
            let link = self.feed.link();
            let payload = serde_json::to_vec(&pause).unwrap_or_default();
            let told = runtime.block_on(link.client.publish(throttle::SUBJECT, payload.into()));
            told.map_err(|error| link.failed(throttle::SUBJECT, &error))?;
            // Who may not publish it is told beside the answers: folding goes on.
            if let Some(said) = link.take_refused_pauses() {
                self.hub.health.fault(
                    Fault::Forward,
                    format!("{said}: give the hub the rights of config/fleet/rights.conf"),
                );
            }
        }
        Ok(())
    }

    /// Takes new commands to the post, if any site can be commanded.
    fn command(&mut self, now_ns: i64) -> Result<(), HubError> {
        let config = self.hub.config;
        let is_none = config.sites.iter().all(|site| site.command_key.is_none());
        if is_none || self.command_again.is_some_and(|at| Instant::now() < at) {
            return Ok(());
        }
        let open = self.centre.open_commands(now_ns)?;
        let publish = self.published.publish(self.feed.link(), open, config);
        self.command_again = match self.hub.runtime.block_on(publish) {
            Ok(()) => {
                self.hub.health.over(Fault::Forward, COMMANDS);
                None
            }
            Err(error) => {
                let detail = format!("commands to the sites wait: {error}");
                self.hub.health.hold(Fault::Forward, COMMANDS, detail);
                Some(Instant::now() + AGAIN)
            }
        };
        Ok(())
    }

    /// Tells the faults of all sites, and which of them are over.
    fn tell_faults(&mut self) {
        let (config, health) = (self.hub.config, &self.hub.health);
        let of_forwarding = self.fold.sites().iter();
        let of_forwarding = of_forwarding
            .filter_map(|(site, state)| Some((site, state.fault.as_ref()?)))
            .filter(|(site, _)| !config.is_thin(site));
        let mut marked = BTreeMap::new();
        for (site, fault) in of_forwarding.chain(&self.faults_of_thin) {
            let known = self.marked.remove(site).flatten();
            if known.as_ref() != Some(fault) {
                let (fault, detail) = fault;
                let detail = format!("{site}: its messages are parked ({fault}): {detail}");
                health.hold(Fault::Forward, site, detail);
            }
            marked.insert(site.clone(), Some(fault.clone()));
        }
        for site in self.marked.keys() {
            health.over(Fault::Forward, site);
        }
        self.marked = marked;
    }
}
