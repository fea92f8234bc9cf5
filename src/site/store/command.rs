//! Commands of a centre in a store that may be in use: number, effect and outcome in one transaction, so that each is carried out
//! at most once.
//!
//! The outcome is a notice, which is copied to the centre in the order of all commits, and told to the site's own sinks.

use super::change::Changed;
use super::request::{self, Asked};
use super::vigil::{ConditionEvent, write_notice};
use super::{StoreError, open};
use crate::analysis::signal::record::{RodId, Timestamp};
use rusqlite::{Connection, Transaction, TransactionBehavior};
use std::path::Path;

/// Kind of the notices with outcomes.
const COMMAND: &str = "command";

/// Id of a command's notice; ids have the order of the numbers.
pub fn command_id(number: i64) -> String {
    format!("{COMMAND}-{number:020}")
}

/// A command that was judged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Judged {
    /// Its number.
    pub number: i64,
    /// Time at which it was given.
    pub issued: Timestamp,
    /// Its person and action in a few words.
    pub about: String,
    /// Request to put, with its rod.
    pub request: Option<(RodId, Asked)>,
    /// Outcome in one sentence; the number of a request follows.
    pub outcome: String,
}

/// Puts a command's request and outcome into a store that another process or thread writes; returns false, and puts nothing,
/// unless its number is larger than those of all commands before.
///
/// # Errors
/// There is no such store, or it cannot be written.
pub fn put_command(path: &Path, command: &Judged, now: Timestamp) -> Result<bool, StoreError> {
    let (connection, path) = open::beside_writer(path)?;
    put(&connection, command, now).map_err(|source| StoreError::Database { path, source })
}

/// Number of the latest command of a store; 0 before any.
///
/// # Errors
/// There is no such store, or it cannot be read.
pub fn latest_command(path: &Path) -> Result<i64, StoreError> {
    let (connection, path) = open::for_reading(path)?;
    latest(&connection).map_err(|source| StoreError::Database { path, source })
}

fn latest(connection: &Connection) -> rusqlite::Result<i64> {
    let id: Option<String> = connection.query_row(
        "SELECT max(condition) FROM notice WHERE fault = ?",
        [COMMAND],
        |row| row.get(0),
    )?;
    let number = id.and_then(|id| id.rsplit('-').next()?.parse().ok());
    Ok(number.unwrap_or(0))
}

fn put(connection: &Connection, command: &Judged, now: Timestamp) -> rusqlite::Result<bool> {
    let transaction = Transaction::new_unchecked(connection, TransactionBehavior::Immediate)?;
    if command.number <= latest(&transaction)? {
        return Ok(false);
    }
    let mut detail = command.outcome.clone();
    if let Some((rod, asked)) = &command.request {
        let number = request::append(&transaction, rod, asked, now)?;
        detail += &format!(" (request {number})");
    }
    let notice = ConditionEvent {
        number: 0,
        condition: command_id(command.number),
        fault: COMMAND.to_owned(),
        about: command.about.clone(),
        is_raised: false,
        raised: command.issued,
        time: now,
        detail,
    };
    let mut changed = Changed::default();
    write_notice(&transaction, &notice, &mut changed)?;
    changed.write(&transaction)?;
    transaction.commit()?;
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::site::store::{Durability, Store};

    #[test]
    fn a_command_is_put_once_with_its_outcome_whatever_is_repeated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site.db");
        let store = Store::open(&path, Durability::Full).unwrap();
        let rod = RodId("north".to_owned());
        let judged = |number| Judged {
            number,
            issued: Timestamp::from_nanos(1),
            about: "M. Rossi: rebaseline north".to_owned(),
            request: Some((rod.clone(), Asked::rebaseline(Some("retensioned")))),
            outcome: "accepted".to_owned(),
        };
        let now = Timestamp::from_nanos(2);
        assert_eq!(latest_command(&path).unwrap(), 0);
        for (number, is_new) in [(9, true), (9, false), (8, false), (10, true), (9, false)] {
            assert_eq!(
                put_command(&path, &judged(number), now).unwrap(),
                is_new,
                "{number}"
            );
        }
        assert_eq!(latest_command(&path).unwrap(), 10);
        assert_eq!(store.waiting(&rod).unwrap().len(), 2);
        let changes = store.changes_after(0, 10).unwrap();
        assert_eq!(changes.len(), 2);
        assert!(changes.iter().all(|change| change.rows[0].table == "notice"));
        // An outcome is no condition that stands.
        assert!(store.standing_notices().unwrap().is_empty());
    }
}
