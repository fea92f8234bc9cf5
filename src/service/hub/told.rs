//! A site's alarms and conditions at the centre as events for the sinks, with the site's name in front of their ids.
//!
//! An alarm that cannot be read (a newer program wrote it, or it is forged) is told by the columns of its row, as a condition that
//! stands as long as the alarm does; a program that can read it tells the alarm in its place.

use super::centre::{Centre, CentreError};
use super::sql::{integer, text};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::AlarmEvent;
use crate::analysis::track::alarm::{Alarm, What};
use crate::service::telemetry::Fault;
use crate::site::clock;
use crate::site::store::{ConditionEvent, Reader, StoreError};
use rusqlite::types::Value;

/// Columns of events, alarms and notices, each with its table.
pub(super) const EVENTS: &str = "\"number\", \"json\", \"alarm\" FROM \"outbox\"";
pub(super) const ALARMS: &str = "\"id\", \"json\", \"rod\", \"kind\", \"message\", \"stands\" FROM \"alarm\"";
pub(super) const NOTICES: &str = "\"number\", \"condition\", \"fault\", \"about\", \"what\", \"raised\", \"time\", \"detail\" FROM \"notice\"";

/// Begin of the id of a condition that stands for an alarm; the alarm's follows.
const UNREAD: &str = "unread-";

/// Rows of one store's table, called `t`, that meet a condition on further values, from `$3` on.
pub(super) fn rows(
    centre: &mut Centre,
    of_table: &str,
    condition: &str,
    (site, store): (&str, i64),
    more: &[Value],
) -> Result<Vec<Vec<Value>>, CentreError> {
    let sql = format!("SELECT {of_table} AS t WHERE t.\"site\" = $1 AND t.\"store\" = $2 AND {condition}");
    let of = [Value::Text(site.to_owned()), Value::Integer(store)];
    Ok(centre.sql().query(&sql, &[&of[..], more].concat())?)
}

fn alarm_row(centre: &mut Centre, of: (&str, i64), alarm: &str) -> Result<Option<Vec<Value>>, CentreError> {
    let id = [Value::Text(alarm.to_owned())];
    Ok(rows(centre, ALARMS, "\"id\" = $3", of, &id)?.pop())
}

/// What the sinks are told of a site.
#[derive(Debug, Default)]
pub(super) struct Told {
    pub(super) events: Vec<AlarmEvent>,
    pub(super) notices: Vec<ConditionEvent>,
    /// A sentence about each event that could not be read.
    pub(super) unread: Vec<String>,
}

impl Told {
    /// Takes rows of [`EVENTS`].
    pub(super) fn take_events(
        &mut self,
        centre: &mut Centre,
        of: (&str, i64),
        events: &[Vec<Value>],
    ) -> Result<(), CentreError> {
        for row in events {
            match serde_json::from_str(&text(row.get(1))) {
                Ok(event) => self.events.push(behind(of.0, event)),
                Err(error) => {
                    let alarm = text(row.get(2));
                    match alarm_row(centre, of, &alarm)? {
                        Some(row) => self.take_columns(of.0, &row, &error),
                        None => self.unread.push(format!(
                            "site {}: an event of alarm {alarm}, which is not here, cannot be read: {error}",
                            of.0
                        )),
                    }
                }
            }
        }
        Ok(())
    }

    /// Takes rows of [`ALARMS`], as raised.
    pub(super) fn take_alarms(&mut self, site: &str, alarms: &[Vec<Value>]) {
        for row in alarms {
            match serde_json::from_str(&text(row.get(1))) {
                Ok(alarm) => self.events.push(raised(site, alarm)),
                Err(error) => self.take_columns(site, row, &error),
            }
        }
    }

    /// Takes an alarm that cannot be read by its columns.
    fn take_columns(&mut self, site: &str, row: &[Value], error: &serde_json::Error) {
        let of = |place: usize| text(row.get(place));
        let (id, rod, kind, message) = (of(0), of(2), of(3), of(4));
        let now = clock::now();
        let detail = format!(
            "rod {rod}, {kind} (alarm {id}): {message} The hub cannot read the whole of this alarm ({error}): update it, or look at the \
             site's own page"
        );
        self.unread.push(format!("site {site}: {detail}"));
        self.notices.push(ConditionEvent {
            number: 0,
            condition: format!("{site}/{UNREAD}{id}"),
            fault: Fault::Forward.code().to_owned(),
            about: rod,
            is_raised: integer(row.get(5)) == 1,
            raised: now,
            time: now,
            detail,
        });
    }

    /// Takes rows of [`NOTICES`].
    pub(super) fn take_notices(&mut self, site: &str, notices: &[Vec<Value>]) {
        let now = clock::now();
        for row in notices {
            let of = |place: usize| text(row.get(place));
            // One whose times are forged is told with the present one.
            let time = |place: usize| {
                of(place)
                    .parse::<jiff::Timestamp>()
                    .ok()
                    .and_then(nanos)
                    .unwrap_or(now)
            };
            self.notices.push(ConditionEvent {
                number: 0,
                condition: format!("{site}/{}", of(1)),
                fault: of(2),
                about: of(3),
                is_raised: of(4) == "raised",
                raised: time(5),
                time: time(6),
                detail: of(7),
            });
        }
    }
}

fn nanos(time: jiff::Timestamp) -> Option<Timestamp> {
    let ns = i64::try_from(time.as_nanosecond()).ok()?;
    Some(Timestamp::from_nanos(ns))
}

/// Alarms of a store that stand by their columns alone, and can be read by now or are over.
pub(super) fn again(centre: &mut Centre, reader: &Reader, site: &str, store: i64) -> Result<Told, Error> {
    let mut told = Told::default();
    let begin = format!("{site}/{UNREAD}");
    for begun in reader.standing_notices()? {
        let Some(id) = begun.condition.strip_prefix(&begin) else {
            continue;
        };
        let Some(row) = alarm_row(centre, (site, store), id)? else {
            continue;
        };
        let stands = integer(row.get(5)) == 1;
        match serde_json::from_str(&text(row.get(1))) {
            Ok(alarm) if stands => told.events.push(raised(site, alarm)),
            Err(_) if stands => continue,
            _ => {}
        }
        told.notices.push(begun.cleared(clock::now()));
    }
    Ok(told)
}

/// Error of the centre's database or of the outbox.
#[derive(Debug, thiserror::Error)]
pub(super) enum Error {
    #[error(transparent)]
    Centre(#[from] CentreError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

fn raised(site: &str, alarm: Alarm) -> AlarmEvent {
    let time = alarm.raised;
    let what = What::Raised;
    behind(site, AlarmEvent { what, time, alarm })
}

/// An event with its site in front of the ids.
fn behind(site: &str, mut event: AlarmEvent) -> AlarmEvent {
    event.alarm.id = format!("{site}/{}", event.alarm.id);
    event.alarm.rod = RodId(format!("{site}/{}", event.alarm.rod.0));
    event
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::track::alarm::Kind;

    fn row(alarm: &Alarm, json: &str, stands: i64) -> Vec<Value> {
        vec![
            Value::Text(alarm.id.clone()),
            Value::Text(json.to_owned()),
            Value::Text(alarm.rod.0.clone()),
            Value::Text("tilt".to_owned()),
            Value::Text(alarm.message.clone()),
            Value::Integer(stands),
        ]
    }

    #[test]
    fn an_alarm_that_cannot_be_read_is_told_by_its_columns() {
        let raised = Timestamp::from_nanos(1_780_000_000_000_000_000);
        let alarm = Alarm::new(
            &RodId("nave-1".into()),
            Kind::Drift,
            1,
            raised,
            "It tilts.".into(),
        );
        let whole = serde_json::to_string(&alarm).unwrap();
        let newer = whole.replace("\"drift\"", "\"tilt\"");
        assert_ne!(whole, newer);
        let mut told = Told::default();
        told.take_alarms(
            "todi",
            &[
                row(&alarm, &whole, 1),
                row(&alarm, &newer, 1),
                row(&alarm, &newer, 0),
            ],
        );
        assert_eq!(told.events.len(), 1);
        assert_eq!(told.events[0].alarm.id, format!("todi/{}", alarm.id));
        let [stands, over] = &told.notices[..] else {
            panic!("{:?}", told.notices)
        };
        assert!(stands.is_raised && !over.is_raised && stands.condition == over.condition);
        assert_eq!(stands.condition, format!("todi/unread-{}", alarm.id));
        for word in ["nave-1", "tilt", "It tilts.", "update it"] {
            assert!(stands.detail.contains(word), "{}", stands.detail);
        }
        assert_eq!(told.unread.len(), 2);
    }

    #[test]
    fn a_notice_with_forged_times_is_told() {
        let of = |raised: &str| {
            let texts = [
                "",
                "id",
                "sink",
                "mail",
                "raised",
                raised,
                "2026-05-28T20:26:40Z",
                "refused",
            ];
            texts.map(|text| Value::Text(text.to_owned())).to_vec()
        };
        let mut told = Told::default();
        told.take_notices(
            "todi",
            &[
                of("2026-05-28T20:26:40Z"),
                of("never"),
                of("-009999-01-02T01:59:59Z"),
            ],
        );
        assert_eq!(told.notices.len(), 3);
        assert_eq!(told.notices[0].raised.as_nanos(), 1_780_000_000_000_000_000);
        assert!(
            told.notices
                .iter()
                .all(|one| one.condition == "todi/id" && one.is_raised)
        );
    }
}
