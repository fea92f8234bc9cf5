//! Requests of people to a store that may be in use: rows that the fold applies before the rod's next record.

use super::StoreError;
use super::row::Row;
use super::state::{Failure, time};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::site::text;
use rusqlite::Connection;

/// A person's request to a store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    /// Number in the order of requests, from 1.
    pub number: i64,
    /// Rod of the request.
    pub rod: RodId,
    /// Action asked for.
    pub what: Asked,
    /// Time of the request, by the clock of the person's machine.
    pub asked: Timestamp,
}

/// Action that can be asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Asked {
    /// Acknowledge an alarm.
    Acknowledge {
        /// Id of the alarm.
        alarm: String,
        /// Name and note of the person: `NAME: TEXT`.
        said: Option<String>,
    },
    /// Learn a new baseline.
    Rebaseline {
        /// Reason in the person's words.
        reason: Option<String>,
    },
}

impl Asked {
    /// Acknowledgement of an alarm, with the person's name and note kept as `NAME: TEXT`.
    pub fn acknowledge(alarm: &str, by: Option<&str>, note: Option<&str>) -> Self {
        let words = [by, note].into_iter().flatten().map(text::one_line);
        let words: Vec<String> = words
            .map(|words| words.trim().to_owned())
            .filter(|words| !words.is_empty())
            .collect();
        Self::Acknowledge {
            alarm: alarm.to_owned(),
            said: (!words.is_empty()).then(|| words.join(": ")),
        }
    }

    /// Request for a new baseline, with the reason in the person's words.
    pub fn rebaseline(reason: Option<&str>) -> Self {
        Self::Rebaseline {
            reason: reason.map(text::one_line),
        }
    }

    fn code(&self) -> &'static str {
        match self {
            Self::Acknowledge { .. } => "acknowledge",
            Self::Rebaseline { .. } => "rebaseline",
        }
    }
}

/// Appends a request to the queue; returns its number.
pub(super) fn put(
    connection: &Connection,
    rod: &RodId,
    what: &Asked,
    asked: Timestamp,
) -> rusqlite::Result<i64> {
    // One statement at a time may write, so the number is taken inside a transaction that may.
    let transaction =
        rusqlite::Transaction::new_unchecked(connection, rusqlite::TransactionBehavior::Immediate)?;
    let number = append(&transaction, rod, what, asked)?;
    transaction.commit()?;
    Ok(number)
}

/// Appends a request in a transaction that may write; returns its number.
pub(super) fn append(
    transaction: &Connection,
    rod: &RodId,
    what: &Asked,
    asked: Timestamp,
) -> rusqlite::Result<i64> {
    let number: i64 =
        transaction.query_row("SELECT coalesce(max(number), 0) + 1 FROM request", (), |row| {
            row.get(0)
        })?;
    row(number, rod, what, asked, false).insert(transaction)?;
    Ok(number)
}

fn row(number: i64, rod: &RodId, what: &Asked, asked: Timestamp, applied: bool) -> Row {
    let (alarm, reason) = match what {
        Asked::Acknowledge { alarm, said } => (Some(alarm.clone()), said.clone()),
        Asked::Rebaseline { reason } => (None, reason.clone()),
    };
    Row::of("request")
        .with("number", number)
        .with("rod", rod.0.clone())
        .with("what", what.code().to_owned())
        .with("alarm", alarm)
        .with("reason", reason)
        .with("asked", asked.to_string())
        .with("applied", i64::from(applied))
}

/// Waiting requests about a rod, in order.
pub(super) fn waiting(connection: &Connection, rod: &RodId) -> Result<Vec<Request>, Failure> {
    select(
        connection,
        "SELECT number, rod, what, alarm, reason, asked FROM request WHERE applied = 0 AND rod = ? ORDER BY number",
        &rod.0,
    )
}

/// Words with which the alarm of a row was acknowledged, as a part of a query of table `alarm`: those of [`said_of`].
pub(super) const SAID: &str = "(SELECT request.reason FROM request WHERE request.applied = 1
    AND request.what = 'acknowledge' AND request.alarm = alarm.id ORDER BY request.number LIMIT 1)";

/// The words with which an alarm was acknowledged, if any.
pub(super) fn said_of(connection: &Connection, alarm: &str) -> Result<Option<String>, Failure> {
    let found = select(
        connection,
        "SELECT number, rod, what, alarm, reason, asked FROM request \
         WHERE applied = 1 AND what = 'acknowledge' AND alarm = ? ORDER BY number LIMIT 1",
        &alarm,
    )?;
    Ok(found.into_iter().find_map(|request| match request.what {
        Asked::Acknowledge { said, .. } => said,
        Asked::Rebaseline { .. } => None,
    }))
}

/// Reasons given with the applied requests for a baseline of a rod, in order.
pub(super) fn rebaselines(connection: &Connection, rod: &RodId) -> Result<Vec<Option<String>>, Failure> {
    let found = select(
        connection,
        "SELECT number, rod, what, alarm, reason, asked FROM request \
         WHERE applied = 1 AND what = 'rebaseline' AND rod = ? ORDER BY number",
        &rod.0,
    )?;
    Ok(found
        .into_iter()
        .map(|request| match request.what {
            Asked::Rebaseline { reason } => reason,
            Asked::Acknowledge { .. } => None,
        })
        .collect())
}

pub(super) fn mark_applied(connection: &Connection, number: i64) -> Result<(), Failure> {
    let found = select(
        connection,
        "SELECT number, rod, what, alarm, reason, asked FROM request WHERE number = ?",
        &number,
    )?;
    let Some(request) = found.first() else {
        return Err(Failure::Other(StoreError::Unreadable {
            what: format!("request {number}"),
            detail: "there is none".to_owned(),
        }));
    };
    row(number, &request.rod, &request.what, request.asked, true).upsert(connection, &["number"])?;
    Ok(())
}

fn select(
    connection: &Connection,
    sql: &str,
    parameter: &dyn rusqlite::ToSql,
) -> Result<Vec<Request>, Failure> {
    let mut statement = connection.prepare_cached(sql)?;
    let mut rows = statement.query([parameter])?;
    let mut requests = Vec::new();
    while let Some(row) = rows.next()? {
        let (number, what): (i64, String) = (row.get(0)?, row.get(2)?);
        let alarm: Option<String> = row.get(3)?;
        let asked: String = row.get(5)?;
        let what = match (what.as_str(), alarm) {
            ("acknowledge", Some(alarm)) => Asked::Acknowledge {
                alarm,
                said: row.get(4)?,
            },
            ("rebaseline", None) => Asked::Rebaseline { reason: row.get(4)? },
            _ => {
                return Err(Failure::Other(StoreError::Unreadable {
                    what: format!("request {number}"),
                    detail: format!("{what} is not known here"),
                }));
            }
        };
        requests.push(Request {
            number,
            rod: RodId(row.get(1)?),
            what,
            asked: time(&asked)?,
        });
    }
    Ok(requests)
}
