//! Alarms and conditions of all sites on their way from the centre's tables into the hub's own outbox, which the sinks read.
//!
//! Places are kept by site and store in the transaction of the events: a restart, a rebuild or a stream that was set back tells
//! nothing again. Of a store that is seen for the first time only what stands is told, once all of it is here.

use super::beats::Heard;
use super::centre::{Centre, CentreError, History, SiteState};
use super::sql::{integer, text};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::AlarmEvent;
use crate::analysis::track::alarm::{Alarm, What};
use crate::config::HubConfig;
use crate::service::telemetry::{Fault, Health};
use crate::site::clock;
use crate::site::store::{ConditionEvent, Filter, Reader, Relayed, StoreError, TOLD_NO_LONGER};
use rusqlite::types::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::Duration;

/// Interval of looks for new commits.
const LOOK: Duration = Duration::from_secs(1);
/// Most events read at once.
const PAGE: usize = 500;
/// Time after which a store that sends no heartbeats, or took the place of another, counts as whole \[ns\].
const WHOLE_NS: i64 = 3_600_000_000_000;
/// Subject of the condition of alarms that cannot be read.
const ABOUT: &str = "alarms";

/// Reason why a round ended early.
#[derive(Debug, thiserror::Error)]
enum Halt {
    /// The outbox takes nothing more: the hub ends.
    #[error("the hub ends")]
    Ended,
    #[error(transparent)]
    Centre(#[from] CentreError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// The reader of the centre's tables.
pub(super) struct Relay {
    config: Arc<HubConfig>,
    health: Arc<Health>,
    outbox: PathBuf,
    to: SyncSender<Relayed>,
    /// Last commit of each store that was looked through.
    seen: BTreeMap<(String, i64), i64>,
    /// Numbers of the last event and notice read of each store.
    places: BTreeMap<(String, String), (i64, i64)>,
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

    fn round(&mut self, centre: &mut Option<Centre>) -> Result<(), Halt> {
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
                if self.seen.get(&key) == Some(&history.through) {
                    continue;
                }
                if self.look_through(centre, &mut beats, &reader, (site, state), place)? {
                    self.seen.insert(key, history.through);
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
        let key = (site.to_owned(), history.epoch.clone());
        if !self.places.contains_key(&key)
            && let [Some(events), Some(notices)] =
                marks(site, &history.epoch).map(|name| reader.delivered(&name).transpose())
        {
            self.places.insert(key.clone(), (events?, notices?));
        }
        if let Some(from) = self.places.get(&key).copied() {
            self.read_on(centre, site, history, from)?;
            return Ok(true);
        }
        if state.present() != Some(place) {
            return Ok(true);
        }
        let beats = match beats {
            Some(beats) => beats,
            none => none.insert(centre.beats()?),
        };
        if !is_whole(beats.get(site), history, place) {
            return Ok(false);
        }
        let (relayed, through) = self.first_sight(centre, reader, site, history)?;
        self.send(relayed)?;
        self.places.insert(key, through);
        Ok(true)
    }

    fn send(&self, relayed: Relayed) -> Result<(), Halt> {
        self.to.send(relayed).map_err(|_| Halt::Ended)
    }

    /// Reads the events of a store after a place.
    fn read_on(
        &mut self,
        centre: &mut Centre,
        site: &str,
        history: &History,
        from: (i64, i64),
    ) -> Result<(), Halt> {
        let mut through = from;
        loop {
            let events = rows(
                centre,
                "SELECT \"number\", \"json\" FROM \"outbox\" WHERE \"site\" = $1 AND \"store\" = $2 AND \"number\" > $3
                 ORDER BY \"number\" LIMIT $4",
                (site, history.store),
                Some(through.0),
            )?;
            let notices = rows(
                centre,
                "SELECT \"number\", \"condition\", \"fault\", \"about\", \"what\", \"raised\", \"time\", \"detail\" FROM \"notice\"
                 WHERE \"site\" = $1 AND \"store\" = $2 AND \"number\" > $3 ORDER BY \"number\" LIMIT $4",
                (site, history.store),
                Some(through.1),
            )?;
            if events.is_empty() && notices.is_empty() {
                return Ok(());
            }
            let last =
                |rows: &[Vec<Value>], before: i64| rows.last().map_or(before, |row| integer(row.first()));
            through = (last(&events, through.0), last(&notices, through.1));
            let mut relayed = Relayed {
                marks: kept(site, &history.epoch, through),
                ..Relayed::default()
            };
            for row in &events {
                match serde_json::from_str::<AlarmEvent>(&text(row.get(1))) {
                    Ok(event) => relayed.events.push(behind(site, event)),
                    Err(error) => self.untold(site, &error),
                }
            }
            relayed.notices = self.notices(site, &notices);
            self.send(relayed)?;
            self.places
                .insert((site.to_owned(), history.epoch.clone()), through);
        }
    }

    /// Reads what stands of a store that was not seen before, and ends what stood of the one before it and is not found again.
    fn first_sight(
        &self,
        centre: &mut Centre,
        reader: &Reader,
        site: &str,
        history: &History,
    ) -> Result<(Relayed, (i64, i64)), Halt> {
        let of = (site, history.store);
        // The places before the rows: what comes meanwhile is read again, and known by its id.
        let mut last = |table: &str| -> Result<i64, Halt> {
            let sql =
                format!("SELECT max(\"number\") FROM \"{table}\" WHERE \"site\" = $1 AND \"store\" = $2");
            let found = rows(centre, &sql, of, None)?;
            Ok(integer(found.first().and_then(|row| row.first())))
        };
        let through = (last("outbox")?, last("notice")?);
        let alarms = rows(
            centre,
            "SELECT \"json\" FROM \"alarm\" WHERE \"site\" = $1 AND \"store\" = $2 AND \"stands\" = 1 ORDER BY \"raised_ns\", \"id\"",
            of,
            None,
        )?;
        let notices = rows(
            centre,
            "SELECT \"number\", \"condition\", \"fault\", \"about\", \"what\", \"raised\", \"time\", \"detail\" FROM \"notice\" AS n
             WHERE \"site\" = $1 AND \"store\" = $2 AND \"what\" = 'raised' AND NOT EXISTS (SELECT 1 FROM \"notice\" AS later
                WHERE later.\"site\" = n.\"site\" AND later.\"store\" = n.\"store\" AND later.\"condition\" = n.\"condition\"
                AND later.\"what\" = 'cleared') ORDER BY \"number\"",
            of,
            None,
        )?;
        let mut relayed = Relayed {
            marks: kept(site, &history.epoch, through),
            notices: self.notices(site, &notices),
            ..Relayed::default()
        };
        for row in &alarms {
            match serde_json::from_str::<Alarm>(&text(row.first())) {
                Ok(alarm) => {
                    let raised = AlarmEvent {
                        what: What::Raised,
                        time: alarm.raised,
                        alarm,
                    };
                    relayed.events.push(behind(site, raised));
                }
                Err(error) => self.untold(site, &error),
            }
        }
        let found: BTreeSet<String> = relayed
            .events
            .iter()
            .map(|event| event.alarm.id.clone())
            .collect();
        let lasting: BTreeSet<String> = relayed.notices.iter().map(|one| one.condition.clone()).collect();
        let why = "the store that raised it was replaced, and the present one does not have it";
        let ends = ends(reader, why, |id| {
            is_of(id, site) && !found.contains(id) && !lasting.contains(id)
        })?;
        relayed.events.splice(0..0, ends.events);
        relayed.notices.splice(0..0, ends.notices);
        Ok((relayed, through))
    }

    /// Ends what stands of sites that are no longer on the list.
    fn end_unlisted(&self, reader: &Reader) -> Result<(), Halt> {
        let ends = ends(reader, "its site is no longer on the list of the centre", |id| {
            id.split_once('/')
                .is_some_and(|(site, _)| self.config.site(site).is_none())
        })?;
        if ends.events.is_empty() && ends.notices.is_empty() {
            return Ok(());
        }
        self.send(ends)
    }

    fn notices(&self, site: &str, rows: &[Vec<Value>]) -> Vec<ConditionEvent> {
        let read = |row: &Vec<Value>| -> Result<ConditionEvent, jiff::Error> {
            let of = |place: usize| text(row.get(place));
            Ok(ConditionEvent {
                number: 0,
                condition: format!("{site}/{}", of(1)),
                fault: of(2),
                about: of(3),
                is_raised: of(4) == "raised",
                raised: time(&of(5))?,
                time: time(&of(6))?,
                detail: of(7),
            })
        };
        let mut notices = Vec::new();
        for row in rows {
            match read(row) {
                Ok(notice) => notices.push(notice),
                Err(error) => self.untold(site, &error),
            }
        }
        notices
    }

    /// Reports an event that no sink can be told of: a newer program wrote it, or it is forged.
    fn untold(&self, site: &str, error: &dyn std::fmt::Display) {
        let detail =
            format!("site {site}: an alarm is not told to the sinks, for it cannot be read: {error}");
        self.health.fault(Fault::Forward, detail);
    }
}

/// Names of the places of a store: of its events and of its notices.
fn marks(site: &str, epoch: &str) -> [String; 2] {
    ["alarms", "conditions"].map(|what| format!("from/{site}/{epoch}/{what}"))
}

fn kept(site: &str, epoch: &str, through: (i64, i64)) -> Vec<(String, i64)> {
    let [events, notices] = marks(site, epoch);
    vec![(events, through.0), (notices, through.1)]
}

/// True for the id of an alarm or condition of a site.
fn is_of(id: &str, site: &str) -> bool {
    id.split_once('/').is_some_and(|(of, _)| of == site)
}

/// An event with its site in front of the ids.
fn behind(site: &str, mut event: AlarmEvent) -> AlarmEvent {
    event.alarm.id = format!("{site}/{}", event.alarm.id);
    event.alarm.rod = RodId(format!("{site}/{}", event.alarm.rod.0));
    event
}

fn time(text: &str) -> Result<Timestamp, jiff::Error> {
    let time: jiff::Timestamp = text.parse()?;
    Ok(Timestamp::from_nanos(
        i64::try_from(time.as_nanosecond()).unwrap_or(0),
    ))
}

/// Rows of one store; `after` and the size of a page are the third and fourth value.
fn rows(
    centre: &mut Centre,
    sql: &str,
    (site, store): (&str, i64),
    after: Option<i64>,
) -> Result<Vec<Vec<Value>>, Halt> {
    let mut values = vec![Value::Text(site.to_owned()), Value::Integer(store)];
    if let Some(after) = after {
        values.extend([Value::Integer(after), Value::Integer(PAGE as i64)]);
    }
    let found = centre.sql().query(sql, &values).map_err(CentreError::from)?;
    Ok(found)
}

/// True once all that a store had when it last spoke is here. One that took the place of another finds again what that one knew, and has
/// an hour for it.
fn is_whole(heard: Option<&Heard>, history: &History, place: usize) -> bool {
    let is_old = clock::now().as_nanos().saturating_sub(history.began_ns) > WHOLE_NS;
    match heard {
        Some(heard) if place == 0 && heard.beat.epoch == history.epoch => {
            heard.beat.through <= history.through
        }
        _ => is_old,
    }
}

/// The ends of alarms and conditions of the outbox that stand and meet a condition.
fn ends(reader: &Reader, why: &str, is_ended: impl Fn(&str) -> bool) -> Result<Relayed, Halt> {
    let now = clock::now();
    let mut relayed = Relayed::default();
    for mut alarm in reader.alarms(&Filter::default())? {
        if alarm.is_over() || !is_ended(&alarm.id) {
            continue;
        }
        alarm.message = format!("{} {TOLD_NO_LONGER}{why}.", alarm.message);
        alarm.cleared = alarm.cleared.or(Some(now));
        // A latched alarm ends no other way.
        alarm.acknowledged = alarm.acknowledged.or(Some(now));
        relayed.events.push(AlarmEvent {
            what: What::Cleared,
            time: now,
            alarm,
        });
    }
    for begun in reader.standing_notices()? {
        if is_ended(&begun.condition) {
            relayed.notices.push(begun.cleared(now));
        }
    }
    Ok(relayed)
}
