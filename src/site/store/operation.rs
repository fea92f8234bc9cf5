//! State of a daemon's sources and sinks: files read to their end, samples that a journal carries into its
//! next part, events delivered to each sink.

use super::row::Row;
use super::state::Failure;
use super::{Reader, StoreError, state};
use crate::analysis::signal::record::RodId;
use crate::analysis::track::AlarmEvent;
use rusqlite::{Connection, OptionalExtension};
use std::collections::BTreeMap;

/// Result of reading a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FileState {
    /// All of its content is in the store.
    Done,
    /// All of it that could be read is in the store; the rest is lost, for this reason.
    Incomplete(String),
    /// It is no longer read, for this reason.
    Quarantined(String),
}

/// A file as it was when read to its end. The name is no identity: it only saves reading the same bytes
/// again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileMark {
    /// Name below its folder.
    pub name: String,
    /// Size \[bytes\].
    pub size: u64,
    /// Time of its last change \[ns since 1970\].
    pub modified_ns: i64,
    /// Result of reading it.
    pub state: FileState,
}

/// State that the parts of a journal, or the files of a folder, read to their end leave for the next: samples of records still open.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Carry {
    /// Name of what left it.
    pub journal: String,
    /// Number of the part that resumes from it; 0 for a folder.
    pub part: u32,
    /// State as its reader encodes it; an empty one is removed.
    pub body: Vec<u8>,
}

/// An alarm event on its way to the sinks.
#[derive(Debug, Clone, PartialEq)]
pub struct News {
    /// Number in the order of all events.
    pub number: i64,
    /// Rod of the alarm.
    pub rod: RodId,
    /// The alarm event.
    pub event: AlarmEvent,
    /// Words of the person who acknowledged the alarm by then: `NAME: TEXT`.
    pub words: Option<String>,
}

pub(super) fn write_file(connection: &Connection, file: &FileMark) -> rusqlite::Result<()> {
    let (state, detail) = match &file.state {
        FileState::Done => ("done", None),
        FileState::Incomplete(reason) => ("done", Some(reason.clone())),
        FileState::Quarantined(reason) => ("quarantined", Some(reason.clone())),
    };
    Row::of("file")
        .with("name", file.name.clone())
        .with("size", i64::try_from(file.size).unwrap_or(i64::MAX))
        .with("modified_ns", file.modified_ns)
        .with("state", state.to_owned())
        .with("detail", detail)
        .upsert(connection, &["name"])
}

pub(super) fn write_carry(connection: &Connection, carry: &Carry) -> rusqlite::Result<()> {
    if carry.body.is_empty() {
        connection.execute("DELETE FROM carry WHERE journal = ?", [&carry.journal])?;
        return Ok(());
    }
    Row::of("carry")
        .with("journal", carry.journal.clone())
        .with("part", i64::from(carry.part))
        .with("body", carry.body.clone())
        .upsert(connection, &["journal"])
}

pub(super) fn write_delivery(connection: &Connection, sink: &str, through: i64) -> rusqlite::Result<()> {
    Row::of("delivery")
        .with("sink", sink.to_owned())
        .with("through", through)
        .upsert(connection, &["sink"])
}

impl Reader {
    /// Files read to their end, by name.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn files(&self) -> Result<BTreeMap<String, FileMark>, StoreError> {
        let files = || -> rusqlite::Result<BTreeMap<String, FileMark>> {
            let mut statement = self
                .connection
                .prepare("SELECT name, size, modified_ns, state, detail FROM file")?;
            let files = statement.query_map((), |row| {
                let state: String = row.get(3)?;
                let detail: Option<String> = row.get(4)?;
                let mark = FileMark {
                    name: row.get(0)?,
                    size: u64::try_from(row.get::<_, i64>(1)?).unwrap_or(0),
                    modified_ns: row.get(2)?,
                    state: match (state.as_str(), detail) {
                        ("done", None) => FileState::Done,
                        ("done", Some(reason)) => FileState::Incomplete(reason),
                        (_, detail) => FileState::Quarantined(detail.unwrap_or_default()),
                    },
                };
                Ok((mark.name.clone(), mark))
            })?;
            files.collect()
        };
        files().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// State that a journal's parts read so far leave for the next.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn carry(&self, journal: &str) -> Result<Option<Carry>, StoreError> {
        let named = self.carries(journal)?;
        Ok(named.into_iter().find(|carry| carry.journal == journal))
    }

    /// All states whose names begin so.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn carries(&self, beginning: &str) -> Result<Vec<Carry>, StoreError> {
        let carries = || -> rusqlite::Result<Vec<Carry>> {
            let mut statement = self.connection.prepare(
                "SELECT journal, part, body FROM carry WHERE substr(journal, 1, length(?1)) = ?1 ORDER BY journal",
            )?;
            let carries = statement.query_map([beginning], |row| {
                Ok(Carry {
                    journal: row.get(0)?,
                    part: row.get(1)?,
                    body: row.get(2)?,
                })
            })?;
            carries.collect()
        };
        carries().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Number of the latest event delivered to a sink; `None` for an unknown sink.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn delivered(&self, sink: &str) -> Result<Option<i64>, StoreError> {
        let through = || {
            self.connection
                .prepare_cached("SELECT through FROM delivery WHERE sink = ?")?
                .query_row([sink], |row| row.get(0))
                .optional()
        };
        through().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Number of the latest event, 0 without any.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn latest_news(&self) -> Result<i64, StoreError> {
        let latest = || {
            self.connection
                .prepare_cached("SELECT coalesce(max(number), 0) FROM outbox")?
                .query_row((), |row| row.get(0))
        };
        latest().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Events after `number`, in order, at most `limit` of them.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn news_after(&self, number: i64, limit: usize) -> Result<Vec<News>, StoreError> {
        let rows = || -> rusqlite::Result<Vec<(i64, String, String)>> {
            let mut statement = self.connection.prepare_cached(
                "SELECT number, rod, json FROM outbox WHERE number > ? ORDER BY number LIMIT ?",
            )?;
            let limit = i64::try_from(limit).unwrap_or(i64::MAX);
            let rows =
                statement.query_map([number, limit], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
            rows.collect()
        };
        let rows = rows().map_err(|error| self.fault(Failure::Sql(error)))?;
        rows.into_iter()
            .map(|(number, rod, json)| {
                let event: AlarmEvent = state::read(&rod, &json)?;
                Ok(News {
                    number,
                    rod: RodId(rod),
                    words: self.acknowledged_words(&event.alarm)?,
                    event,
                })
            })
            .collect()
    }
}
