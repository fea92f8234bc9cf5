//! Alarms and conditions of all sites on their way from the centre's tables into the hub's own outbox, which the sinks read.
//!
//! Places are kept by site and store in the transaction of the events: a restart, a rebuild or a stream that was set back tells
//! nothing again. Of a store that becomes the present one of its site only what stands is told, once all of it is here; the places of
//! the one before are forgotten then, so that one that is put back is told again, too.

use super::beats::Heard;
use super::centre::{Centre, CentreError, History, SiteState};
use super::sql::integer;
use super::told::{self, Told};
use crate::config::HubConfig;
use crate::service::telemetry::{Fault, Health};
use crate::site::clock;
use crate::site::store::{Reached, Reader, Relayed, StoreError};
use rusqlite::types::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};

/// Interval of looks for new commits.
const LOOK: Duration = Duration::from_secs(1);
/// Most events read at once.
const PAGE: usize = 500;
/// Time after which a store that sends no heartbeats, took the place of another, or is no longer added to counts as whole.
const WHOLE: Duration = Duration::from_secs(3600);
/// Subject of the condition of alarms that are not told on. No site has a slash in its name.
const ABOUT: &str = "hub/alarms";

/// Reason why a round ended early.
#[derive(Debug, thiserror::Error)]
pub(super) enum Halt {
    /// The outbox takes nothing more: the hub ends.
    #[error("the hub ends")]
    Ended,
    #[error(transparent)]
    Centre(#[from] CentreError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Told(#[from] told::Error),
}

/// Site and number of a store.
type Key = (String, i64);

/// The reader of the centre's tables.
pub(super) struct Relay {
    config: Arc<HubConfig>,
    health: Arc<Health>,
    outbox: PathBuf,
    to: SyncSender<Relayed>,
    /// Last commit of each store that was looked through, and whether it was the present one of its site.
    seen: BTreeMap<Key, (i64, bool)>,
    /// Last commit of each store that is not whole yet, and since when it is that.
    waits: BTreeMap<Key, (i64, Instant)>,
    /// Places of the stores that are read on.
    places: BTreeMap<Key, Reached>,
}

impl Relay {
    /// A relay into the owner of `outbox`.
    pub(super) fn new(
        config: Arc<HubConfig>,
        health: Arc<Health>,
        outbox: PathBuf,
        to: SyncSender<Relayed>,
    ) -> Self {
        Self {
            config,
            health,
            outbox,
            to,
            seen: BTreeMap::new(),
            waits: BTreeMap::new(),
            places: BTreeMap::new(),
        }
    }

    /// Works until `stopped` is disconnected; whatever fails is tried again.
    pub(super) fn run(mut self, stopped: &Receiver<()>) {
        let mut centre = None;
        while stopped.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
            match self.round(&mut centre) {
                Ok(()) => self.health.over(Fault::Forward, ABOUT),
                Err(Halt::Ended) => return,
                Err(error) => {
                    centre = None;
                    let detail = format!("alarms of the sites wait: {error}");
                    self.health.hold(Fault::Forward, ABOUT, detail);
                }
            }
        }
    }

    /// Looks through all sites once.
    pub(super) fn round(&mut self, centre: &mut Option<Centre>) -> Result<(), Halt> {
        let is_first = self.seen.is_empty();
        let centre = match centre {
            Some(centre) => centre,
            none => none.insert(super::beside(&self.config.storage)?),
        };
        let reader = Reader::open(&self.outbox)?;
        if is_first {
            self.end_unlisted(&reader)?;
        }
        let sites = centre.sites()?;
        let mut beats = None;
        for (site, state) in &sites {
            if self.config.site(site).is_none() {
                continue;
            }
            for (place, history) in state.histories.iter().enumerate() {
                let key = (site.clone(), history.store);
                let now = (history.through, state.present() == Some(place));
                if self.seen.get(&key) == Some(&now) {
                    continue;
                }
                if self.look_through(centre, &mut beats, &reader, (site, state), place)? {
                    self.seen.insert(key, now);
                }
            }
        }
        Ok(())
    }

    /// Reads what is new of a store; returns false if it is to be looked at again whatever comes.
    fn look_through(
        &mut self,
        centre: &mut Centre,
        beats: &mut Option<BTreeMap<String, Heard>>,
        reader: &Reader,
        (site, state): (&str, &SiteState),
        place: usize,
    ) -> Result<bool, Halt> {
        let Some(history) = state.histories.get(place) else {
            return Ok(true);
        };
        let key = (site.to_owned(), history.store);
        if !self.places.contains_key(&key)
            && let Some(reached) = reader.reached(site, &history.epoch)?
        {
            // A newer program may read what the one before could not.
            let again = told::again(centre, reader, site, history.store)?;
            if !again.notices.is_empty() {
                self.send(site, again, None, None)?;
            }
            self.places.insert(key.clone(), reached);
        }
        if let Some(reached) = self.places.get(&key).cloned() {
            self.read_on(centre, site, history, reached)?;
            return Ok(true);
        }
        if state.present() != Some(place) {
            return Ok(true);
        }
        let beats = match beats {
            Some(beats) => beats,
            none => none.insert(centre.beats()?),
        };
        if !self.is_whole((site, beats.get(site)), state, history, place) {
            return Ok(false);
        }
        let (found, reached) = first_sight(centre, site, history)?;
        let why = "the store that raised it was replaced, and the present one does not have it";
        self.send(site, found, Some(reached.clone()), Some(why))?;
        self.places.retain(|(of, _), _| of != site);
        self.places.insert(key, reached);
        Ok(true)
    }

    fn send(&self, site: &str, told: Told, reached: Option<Reached>, ends: Option<&str>) -> Result<(), Halt> {
        for detail in told.unread {
            self.health.fault(Fault::Forward, detail);
        }
        let relayed = Relayed {
            owner: site.to_owned(),
            events: told.events,
            notices: told.notices,
            reached,
            ends: ends.map(str::to_owned),
        };
        self.to.send(relayed).map_err(|_| Halt::Ended)
    }

    /// Reads the events of a store after a place.
    fn read_on(
        &mut self,
        centre: &mut Centre,
        site: &str,
        history: &History,
        mut reached: Reached,
    ) -> Result<(), Halt> {
        let of = (site, history.store);
        loop {
            let page = |number: i64| [Value::Integer(number), Value::Integer(PAGE as i64)];
            let after = "\"number\" > $3 ORDER BY \"number\" LIMIT $4";
            let events = told::rows(centre, told::EVENTS, after, of, &page(reached.events))?;
            let notices = told::rows(centre, told::NOTICES, after, of, &page(reached.notices))?;
            if events.is_empty() && notices.is_empty() {
                return Ok(());
            }
            let last =
                |rows: &[Vec<Value>], before: i64| rows.last().map_or(before, |row| integer(row.first()));
            reached.events = last(&events, reached.events);
            reached.notices = last(&notices, reached.notices);
            let mut told = Told::default();
            told.take_events(centre, of, &events)?;
            told.take_notices(site, &notices);
            self.send(site, told, Some(reached.clone()), None)?;
            self.places
                .insert((site.to_owned(), history.store), reached.clone());
        }
    }

    /// Ends what stands of sites that are no longer on the list.
    fn end_unlisted(&self, reader: &Reader) -> Result<(), Halt> {
        for site in reader.owners()? {
            if self.config.site(&site).is_none() {
                let why = "its site is no longer on the list of the centre";
                self.send(&site, Told::default(), None, Some(why))?;
            }
        }
        Ok(())
    }

    /// True once all that a store had when it last spoke is here, or all that can be: what is parked may never come. One that took the
    /// place of another finds again what that one knew, and has an hour for it; so has one that is behind and gets nothing.
    fn is_whole(
        &mut self,
        (site, heard): (&str, Option<&Heard>),
        state: &SiteState,
        history: &History,
        place: usize,
    ) -> bool {
        let age_ns = clock::now().as_nanos().saturating_sub(history.began_ns);
        match heard {
            Some(heard) if place == 0 && heard.beat.epoch == history.epoch => {
                let key = (site.to_owned(), history.store);
                let (through, since) = self.waits.entry(key).or_insert((history.through, Instant::now()));
                if *through != history.through {
                    (*through, *since) = (history.through, Instant::now());
                }
                heard.beat.through <= history.through || state.fault.is_some() || since.elapsed() > WHOLE
            }
            _ => i128::from(age_ns) > WHOLE.as_nanos() as i128,
        }
    }
}

/// What stands of a store that is told for the first time, or again.
fn first_sight(centre: &mut Centre, site: &str, history: &History) -> Result<(Told, Reached), Halt> {
    let of = (site, history.store);
    // The places before the rows: what comes meanwhile is read again, and known by its id.
    let mut last = |table: &str| -> Result<i64, Halt> {
        let found = told::rows(
            centre,
            &format!("max(\"number\") FROM \"{table}\""),
            "1 = 1",
            of,
            &[],
        )?;
        Ok(integer(found.first().and_then(|row| row.first())))
    };
    let reached = Reached {
        epoch: history.epoch.clone(),
        events: last("outbox")?,
        notices: last("notice")?,
    };
    let alarms = "\"stands\" = 1 ORDER BY \"raised_ns\", \"id\"";
    let alarms = told::rows(centre, told::ALARMS, alarms, of, &[])?;
    let lasts = "\"what\" = 'raised' AND NOT EXISTS (SELECT 1 FROM \"notice\" AS later WHERE later.\"site\" = t.\"site\"
        AND later.\"store\" = t.\"store\" AND later.\"condition\" = t.\"condition\" AND later.\"what\" = 'cleared') ORDER BY \"number\"";
    let notices = told::rows(centre, told::NOTICES, lasts, of, &[])?;
    let mut told = Told::default();
    told.take_alarms(site, &alarms);
    told.take_notices(site, &notices);
    Ok((told, reached))
}
