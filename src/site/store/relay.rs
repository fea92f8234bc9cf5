//! Events of other stores, taken into this one to be told to its sinks: each once, whatever is killed.

use super::change::Changed;
use super::commit::{write_alarm, write_event};
use super::operation::write_delivery;
use super::state::{Failure, plain};
use super::vigil::{ConditionEvent, write_notice};
use super::{Store, StoreError};
use crate::analysis::track::AlarmEvent;
use crate::analysis::track::alarm::What;
use crate::site::clock;
use rusqlite::{Connection, TransactionBehavior};

/// Events of another store, and how far it was read.
///
/// Ids of alarms, conditions and rods are those of the other store behind its name and a slash: two stores may have alarms of one
/// id.
#[derive(Debug, Clone, Default)]
pub struct Relayed {
    /// Changes of alarms, in order.
    pub events: Vec<AlarmEvent>,
    /// Conditions that began or ended, in order.
    pub notices: Vec<ConditionEvent>,
    /// Names under which the places in the other store are kept, with the last number read. No sink has such a name.
    pub marks: Vec<(String, i64)>,
}

impl Store {
    /// Takes events and places in one transaction. Of an event that is here already only the alarm's state is taken: a store that was
    /// replaced tells again what it found again, and nobody may have acknowledged it there.
    ///
    /// # Errors
    /// They cannot be written; nothing was.
    pub fn relay(&mut self, relayed: &Relayed) -> Result<(), StoreError> {
        let write = |connection: &mut Connection| -> Result<(), Failure> {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let mut changed = Changed::default();
            for event in &relayed.events {
                let alarm = &event.alarm;
                if !alarm.is_over() && is_told_no_longer(&transaction, &alarm.id)? {
                    // The receivers know its id as one that ended.
                    let now = clock::now();
                    let mut again = alarm.clone();
                    again.told = now;
                    let again = AlarmEvent {
                        what: What::Repeated,
                        time: now,
                        alarm: again,
                    };
                    write_event(&transaction, &alarm.rod, &again, &mut changed)?;
                } else if is_there(&transaction, event)? {
                    write_alarm(&transaction, &alarm.rod, alarm, &mut changed)?;
                } else {
                    write_event(&transaction, &alarm.rod, event, &mut changed)?;
                }
            }
            for notice in &relayed.notices {
                if !has_notice(&transaction, notice)? {
                    write_notice(&transaction, notice, &mut changed)?;
                }
            }
            for (name, through) in &relayed.marks {
                write_delivery(&transaction, name, *through)?;
            }
            changed.write(&transaction)?;
            Ok(transaction.commit()?)
        };
        write(&mut self.reader.connection).map_err(|failure| self.reader.fault(failure))
    }
}

fn is_there(connection: &Connection, event: &AlarmEvent) -> rusqlite::Result<bool> {
    connection
        .prepare_cached(
            // A new alarm is known by the key alone.
            "SELECT EXISTS (SELECT 1 FROM alarm WHERE id = ?1)
                AND EXISTS (SELECT 1 FROM outbox WHERE alarm = ?1 AND what = ?2 AND time = ?3)",
        )?
        .query_row(
            (&event.alarm.id, plain(&event.what), event.time.to_string()),
            |row| row.get(0),
        )
}

/// Words with which the message of an alarm ends that is told no longer, though its site did not end it.
pub const TOLD_NO_LONGER: &str = "Told no longer: ";

/// True if it was ended so.
fn is_told_no_longer(connection: &Connection, id: &str) -> rusqlite::Result<bool> {
    connection
        .prepare_cached(
            "SELECT EXISTS (SELECT 1 FROM alarm WHERE id = ? AND stands = 0 AND instr(json, ?) > 0)",
        )?
        .query_row((id, TOLD_NO_LONGER), |row| row.get(0))
}

fn has_notice(connection: &Connection, notice: &ConditionEvent) -> rusqlite::Result<bool> {
    let what = if notice.is_raised { "raised" } else { "cleared" };
    connection
        .prepare_cached("SELECT EXISTS (SELECT 1 FROM notice WHERE condition = ? AND what = ?)")?
        .query_row((&notice.condition, what), |row| row.get(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::{RodId, Timestamp};
    use crate::analysis::track::alarm::{Alarm, Kind};

    fn at(s: i64) -> Timestamp {
        Timestamp::from_nanos(1_780_000_000_000_000_000 + s * 1_000_000_000)
    }

    #[test]
    fn an_event_is_taken_once_with_its_place() {
        let mut store = Store::in_memory().unwrap();
        let rod = RodId("todi/nave-1".to_owned());
        let mut alarm = Alarm::new(&rod, Kind::Drift, 1, at(0), "fell".to_owned());
        alarm.id = format!("todi/{}", alarm.id);
        let raised = AlarmEvent {
            what: What::Raised,
            time: at(0),
            alarm: alarm.clone(),
        };
        alarm.cleared = Some(at(60));
        let cleared = AlarmEvent {
            what: What::Cleared,
            time: at(60),
            alarm,
        };
        let mut begun = ConditionEvent::raised("sink", "mail", at(1), "refused");
        begun.condition = format!("todi/{}", begun.condition);
        let mut relayed = Relayed {
            events: vec![raised],
            notices: vec![begun.clone()],
            marks: vec![("from/todi/00ff".to_owned(), 7)],
        };
        for _ in 0..2 {
            store.relay(&relayed).unwrap();
        }
        assert_eq!(
            (store.latest_news().unwrap(), store.latest_notice().unwrap()),
            (1, 1)
        );
        relayed.events.push(cleared);
        relayed.notices.push(begun.cleared(at(9)));
        relayed.marks[0].1 = 8;
        store.relay(&relayed).unwrap();
        assert_eq!(
            (store.latest_news().unwrap(), store.latest_notice().unwrap()),
            (2, 2)
        );
        assert_eq!(store.delivered("from/todi/00ff").unwrap(), Some(8));
        let news = store.news_after(0, 10).unwrap();
        assert_eq!(news[1].rod, rod);
        assert!(store.standing_notices().unwrap().is_empty());
    }

    #[test]
    fn an_alarm_that_was_told_no_longer_is_told_again_when_it_is_found() {
        let mut store = Store::in_memory().unwrap();
        let rod = RodId("todi/nave-1".to_owned());
        let alarm = Alarm::new(&rod, Kind::Drift, 1, at(0), "fell".to_owned());
        let event = |what, time, alarm: &Alarm| Relayed {
            events: vec![AlarmEvent {
                what,
                time,
                alarm: alarm.clone(),
            }],
            ..Relayed::default()
        };
        let raised = event(What::Raised, at(0), &alarm);
        store.relay(&raised).unwrap();
        let mut ended = alarm.clone();
        ended.message += &format!(" {TOLD_NO_LONGER}its store was replaced.");
        (ended.cleared, ended.acknowledged) = (Some(at(60)), Some(at(60)));
        store.relay(&event(What::Cleared, at(60), &ended)).unwrap();
        for _ in 0..2 {
            store.relay(&raised).unwrap();
        }
        let told: Vec<What> = (store.news_after(0, 10).unwrap().into_iter())
            .map(|news| news.event.what)
            .collect();
        assert_eq!(told, [What::Raised, What::Cleared, What::Repeated]);
    }
}
