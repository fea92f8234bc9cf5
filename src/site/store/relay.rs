//! Events of other stores, taken into this one to be told to its sinks: each once, whatever is killed.

use super::change::Changed;
use super::commit::{write_alarm, write_event};
use super::listing::Filter;
use super::operation::write_delivery;
use super::row::Row;
use super::state::{Failure, plain};
use super::vigil::{ConditionEvent, write_notice};
use super::{Reader, Store, StoreError};
use crate::analysis::track::AlarmEvent;
use crate::analysis::track::alarm::What;
use crate::site::clock;
use rusqlite::{Connection, TransactionBehavior};
use std::collections::BTreeSet;

/// Events of another store, and how far it was read.
///
/// Ids of alarms, conditions and rods are those of the other store behind its owner's name and a slash: two stores may have alarms
/// of one id.
#[derive(Debug, Clone, Default)]
pub struct Relayed {
    /// Name of the other store's owner.
    pub owner: String,
    /// Changes of alarms, in order.
    pub events: Vec<AlarmEvent>,
    /// Conditions that began or ended, in order.
    pub notices: Vec<ConditionEvent>,
    /// Place up to which the other store was read.
    pub reached: Option<Reached>,
    /// Reason for which what stands of this owner, and is not among the events and notices, is told no longer. How far its stores
    /// were read is forgotten with it: the next look begins with what stands.
    pub ends: Option<String>,
}

/// Place in another store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reached {
    /// Id of that store.
    pub epoch: String,
    /// Number of its last event.
    pub events: i64,
    /// Number of its last notice.
    pub notices: i64,
}

/// Begin of the names under which places are kept beside those of the sinks, of which none has a slash.
const FROM: &str = "from/";

/// Names of the place in a store: of its events and of its notices.
fn marks(owner: &str, epoch: &str) -> [String; 2] {
    ["alarms", "conditions"].map(|what| format!("{FROM}{owner}/{epoch}/{what}"))
}

impl Reader {
    /// Place up to which a store of an owner was read; `None` if it was not.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn reached(&self, owner: &str, epoch: &str) -> Result<Option<Reached>, StoreError> {
        let [events, notices] = marks(owner, epoch);
        let (events, notices) = (self.delivered(&events)?, self.delivered(&notices)?);
        Ok(events.zip(notices).map(|(events, notices)| Reached {
            epoch: epoch.to_owned(),
            events,
            notices,
        }))
    }

    /// Owners of which stores were read.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn owners(&self) -> Result<BTreeSet<String>, StoreError> {
        let read = || -> rusqlite::Result<BTreeSet<String>> {
            let mut statement = self.connection.prepare("SELECT sink FROM delivery")?;
            let names = statement.query_map((), |row| row.get::<_, String>(0))?;
            let names = names.collect::<rusqlite::Result<Vec<_>>>()?;
            let owner = |name: &String| {
                let (owner, _) = name.strip_prefix(FROM)?.split_once('/')?;
                Some(owner.to_owned())
            };
            Ok(names.iter().filter_map(owner).collect())
        };
        read().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Ends of what stands of the owner and is not told on.
    fn ends(
        &self,
        relayed: &Relayed,
        why: &str,
    ) -> Result<(Vec<AlarmEvent>, Vec<ConditionEvent>), StoreError> {
        let now = clock::now();
        let events = relayed.events.iter().map(|event| event.alarm.id.as_str());
        let notices = relayed.notices.iter().map(|notice| notice.condition.as_str());
        let kept: BTreeSet<&str> = events.chain(notices).collect();
        let is_ended = |id: &str| {
            let is_of_owner = id
                .split_once('/')
                .is_some_and(|(owner, _)| owner == relayed.owner);
            is_of_owner && !kept.contains(id)
        };
        let mut alarms = self.alarms(&Filter::default())?;
        alarms.retain(|alarm| !alarm.is_over() && is_ended(&alarm.id));
        let ended = alarms.into_iter().map(|mut alarm| {
            alarm.message = format!("{} Told no longer: {why}.", alarm.message);
            alarm.cleared = alarm.cleared.or(Some(now));
            // A latched alarm ends no other way.
            alarm.acknowledged = alarm.acknowledged.or(Some(now));
            AlarmEvent {
                what: What::Cleared,
                time: now,
                alarm,
            }
        });
        let mut standing = self.standing_notices()?;
        standing.retain(|begun| is_ended(&begun.condition));
        let over = standing.iter().map(|begun| begun.cleared(now));
        Ok((ended.collect(), over.collect()))
    }
}

impl Store {
    /// Takes events and places in one transaction. Of an event that is here already only the alarm's state is taken: a store that was
    /// replaced tells again what it found again, and nobody may have acknowledged it there. What ends is looked up here, by the only
    /// writer: whatever waited before is in the tables by then.
    ///
    /// # Errors
    /// They cannot be written; nothing was.
    pub fn relay(&mut self, relayed: &Relayed) -> Result<(), StoreError> {
        let (events, notices) = match &relayed.ends {
            Some(why) => self.reader.ends(relayed, why)?,
            None => Default::default(),
        };
        let write = |connection: &mut Connection| -> Result<(), Failure> {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let mut changed = Changed::default();
            for event in &events {
                write_event(&transaction, &event.alarm.rod, event, &mut changed)?;
                end(&transaction, &event.alarm.id)?;
            }
            for notice in &notices {
                write_notice(&transaction, notice, &mut changed)?;
                end(&transaction, &notice.condition)?;
            }
            if relayed.ends.is_some() {
                let below = format!("{FROM}{}/", relayed.owner);
                transaction.execute(
                    "DELETE FROM delivery WHERE substr(sink, 1, length(?1)) = ?1",
                    [&below],
                )?;
            }
            for event in &relayed.events {
                take_event(&transaction, event, &mut changed)?;
            }
            for notice in &relayed.notices {
                take_notice(&transaction, notice, &mut changed)?;
            }
            if let Some(reached) = &relayed.reached {
                let [events, notices] = marks(&relayed.owner, &reached.epoch);
                write_delivery(&transaction, &events, reached.events)?;
                write_delivery(&transaction, &notices, reached.notices)?;
            }
            changed.write(&transaction)?;
            Ok(transaction.commit()?)
        };
        write(&mut self.reader.connection).map_err(|failure| self.reader.fault(failure))
    }
}

fn take_event(connection: &Connection, event: &AlarmEvent, changed: &mut Changed) -> Result<(), Failure> {
    let alarm = &event.alarm;
    if !alarm.is_over() && begin_again(connection, &alarm.id)? {
        // The receivers know its id as one that ended.
        let mut again = alarm.clone();
        again.told = clock::now();
        let again = AlarmEvent {
            what: What::Repeated,
            time: again.told,
            alarm: again,
        };
        write_event(connection, &alarm.rod, &again, changed)
    } else if is_there(connection, event)? {
        write_alarm(connection, &alarm.rod, alarm, changed)
    } else {
        write_event(connection, &alarm.rod, event, changed)
    }
}

fn take_notice(
    connection: &Connection,
    notice: &ConditionEvent,
    changed: &mut Changed,
) -> Result<(), Failure> {
    if notice.is_raised && begin_again(connection, &notice.condition)? {
        let mut again = notice.clone();
        again.time = clock::now();
        write_notice(connection, &again, changed)?;
    } else if !has_notice(connection, notice)? {
        write_notice(connection, notice, changed)?;
    }
    Ok(())
}

fn is_there(connection: &Connection, event: &AlarmEvent) -> rusqlite::Result<bool> {
    connection.prepare_cached(IS_THERE)?.query_row(
        (&event.alarm.id, plain(&event.what), event.time.to_string()),
        |row| row.get(0),
    )
}

const IS_THERE: &str = "SELECT EXISTS (SELECT 1 FROM outbox WHERE alarm = ?1 AND what = ?2 AND time = ?3)";

/// Notes an alarm or condition that is told no longer, though its store did not end it.
fn end(connection: &Connection, id: &str) -> rusqlite::Result<()> {
    Row::of("ended")
        .with("id", id.to_owned())
        .upsert(connection, &["id"])
}

/// Forgets that it is told no longer; returns true if it was.
fn begin_again(connection: &Connection, id: &str) -> rusqlite::Result<bool> {
    let forgotten = connection
        .prepare_cached("DELETE FROM ended WHERE id = ?")?
        .execute([id])?;
    Ok(forgotten > 0)
}

/// True if the outbox has a begin of the condition, or an end as the latest of it.
fn has_notice(connection: &Connection, notice: &ConditionEvent) -> rusqlite::Result<bool> {
    connection
        .prepare_cached(
            "SELECT EXISTS (SELECT 1 FROM notice WHERE condition = ?1 AND what = ?2 AND (what = 'raised'
                OR number = (SELECT max(number) FROM notice WHERE condition = ?1)))",
        )?
        .query_row(
            (
                &notice.condition,
                if notice.is_raised { "raised" } else { "cleared" },
            ),
            |row| row.get(0),
        )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::{RodId, Timestamp};
    use crate::analysis::track::alarm::{Alarm, Kind};

    fn at(s: i64) -> Timestamp {
        Timestamp::from_nanos(1_780_000_000_000_000_000 + s * 1_000_000_000)
    }

    fn alarm(rod: &str) -> Alarm {
        let rod = RodId(format!("todi/{rod}"));
        let mut alarm = Alarm::new(&rod, Kind::Drift, 1, at(0), "fell".to_owned());
        alarm.id = format!("todi/{}", alarm.id);
        alarm
    }

    fn event(what: What, time: Timestamp, alarm: &Alarm) -> AlarmEvent {
        let alarm = alarm.clone();
        AlarmEvent { what, time, alarm }
    }

    fn condition(about: &str) -> ConditionEvent {
        let mut begun = ConditionEvent::raised("sink", about, at(1), "refused");
        begun.condition = format!("todi/{}", begun.condition);
        begun
    }

    fn reached(epoch: &str, events: i64, notices: i64) -> Option<Reached> {
        let epoch = epoch.to_owned();
        Some(Reached {
            epoch,
            events,
            notices,
        })
    }

    #[test]
    fn an_event_is_taken_once_with_its_place() {
        let mut store = Store::in_memory().unwrap();
        let (mut one, begun) = (alarm("nave-1"), condition("mail"));
        let mut relayed = Relayed {
            owner: "todi".to_owned(),
            events: vec![event(What::Raised, at(0), &one)],
            notices: vec![begun.clone()],
            reached: reached("00ff", 7, 1),
            ends: None,
        };
        let counts = |store: &Store| (store.latest_news().unwrap(), store.latest_notice().unwrap());
        for _ in 0..2 {
            store.relay(&relayed).unwrap();
        }
        assert_eq!(counts(&store), (1, 1));
        one.cleared = Some(at(60));
        relayed.events.push(event(What::Cleared, at(60), &one));
        relayed.notices.push(begun.cleared(at(9)));
        relayed.reached = reached("00ff", 8, 2);
        for _ in 0..2 {
            store.relay(&relayed).unwrap();
        }
        assert_eq!(counts(&store), (2, 2));
        assert_eq!(store.reached("todi", "00ff").unwrap(), relayed.reached);
        assert_eq!(store.owners().unwrap(), ["todi".to_owned()].into());
        let news = store.news_after(0, 10).unwrap();
        assert_eq!(news[1].rod, one.rod);
        assert!(store.standing_notices().unwrap().is_empty());
    }

    #[test]
    fn what_ends_with_its_store_begins_again_when_it_is_found() {
        let mut store = Store::in_memory().unwrap();
        let (lost, found, mail) = (alarm("nave-1"), alarm("nave-2"), condition("mail"));
        let of = |alarms: &[&Alarm], notices: &[&ConditionEvent], epoch: &str, ends: Option<&str>| Relayed {
            owner: "todi".to_owned(),
            events: alarms
                .iter()
                .map(|alarm| event(What::Raised, at(0), alarm))
                .collect(),
            notices: notices.iter().map(|notice| (*notice).clone()).collect(),
            reached: reached(epoch, 3, 1),
            ends: ends.map(str::to_owned),
        };
        store.relay(&of(&[&lost, &found], &[&mail], "a", None)).unwrap();
        // Another owner's, whose name begins alike, and the centre's own stay.
        let mut other = alarm("nave-1");
        other.id = other.id.replace("todi/", "todi-2/");
        store
            .relay(&Relayed {
                owner: "todi-2".to_owned(),
                events: vec![event(What::Raised, at(0), &other)],
                reached: reached("c", 1, 0),
                ..Relayed::default()
            })
            .unwrap();
        let own = ConditionEvent::raised("forward", "hub/folding", at(0), "no post");
        store.watch(std::slice::from_ref(&own), None).unwrap();
        let standing = |store: &Store| {
            let alarms = store.alarms(&Filter::default()).unwrap();
            let alarms = alarms
                .into_iter()
                .filter(|alarm| !alarm.is_over())
                .map(|alarm| alarm.id);
            let notices = store
                .standing_notices()
                .unwrap()
                .into_iter()
                .map(|notice| notice.condition);
            alarms.chain(notices).collect::<BTreeSet<_>>()
        };
        let ids = |all: &[&String]| all.iter().map(|id| (*id).clone()).collect::<BTreeSet<String>>();
        let (all, left) = (
            ids(&[&lost.id, &found.id, &mail.condition, &other.id, &own.condition]),
            ids(&[&found.id, &other.id, &own.condition]),
        );
        assert_eq!(standing(&store), all);
        store.relay(&of(&[&found], &[], "b", Some("replaced"))).unwrap();
        assert_eq!(standing(&store), left);
        assert_eq!(store.reached("todi", "a").unwrap(), None);
        assert!(
            store.reached("todi", "b").unwrap().is_some() && store.reached("todi-2", "c").unwrap().is_some()
        );
        let before = store.latest_news().unwrap();
        let told = store.news_after(before - 1, 1).unwrap();
        assert!(
            told[0]
                .event
                .alarm
                .message
                .ends_with("fell Told no longer: replaced."),
            "{told:?}"
        );
        // The first store is the present one again: what ended is told as standing, under a time of its own, once.
        for _ in 0..2 {
            store
                .relay(&of(&[&lost, &found], &[&mail], "a", Some("put back")))
                .unwrap();
        }
        assert_eq!(standing(&store), all);
        let told = store.news_after(before, 10).unwrap();
        assert_eq!(
            told.iter()
                .map(|news| (&news.event.alarm.id, news.event.what))
                .collect::<Vec<_>>(),
            [(&lost.id, What::Repeated)]
        );
        let notices = store.notices_after(0, 10).unwrap();
        let of_mail: Vec<_> = notices
            .iter()
            .filter(|one| one.condition == mail.condition)
            .collect();
        assert_eq!(of_mail.len(), 3);
        assert!(
            of_mail[2].is_raised && of_mail[2].time > of_mail[0].time && of_mail[2].raised == mail.raised
        );
        // And its end at the site is one.
        let mut over = of(&[], &[], "a", None);
        over.notices = vec![mail.cleared(at(99))];
        store.relay(&over).unwrap();
        assert!(!standing(&store).contains(&mail.condition));
    }

    #[test]
    fn an_event_is_looked_for_by_an_index() {
        let store = Store::in_memory().unwrap();
        let mut statement = store
            .connection
            .prepare(&format!("EXPLAIN QUERY PLAN {IS_THERE}"))
            .unwrap();
        let steps = statement
            .query_map(("a", "b", "c"), |row| row.get::<_, String>(3))
            .unwrap();
        let steps: Vec<String> = steps.map(Result::unwrap).collect();
        assert!(
            steps.iter().any(|step| step.contains("outbox_of_alarm")),
            "{steps:?}"
        );
    }
}
